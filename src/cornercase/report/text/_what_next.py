"""Sentences on what to do next: what to hand to other people, and which scenarios to drive on a proving ground."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from cornercase.report._collision_boundary import BoundaryPair, find_collision_boundary
from cornercase.report._near_misses import sort_near_misses
from cornercase.report._report_data import ReportData
from cornercase.report.text._phrases import append_unit, format_value, join_with_and
from cornercase.scenario import Parameter, Value
from cornercase.study._import_recordings import IMPORTED_SIMULATOR
from cornercase.suite._verdict import worst_state

# Most scenarios to be driven on a proving ground, where driving them costs a day.
_MAX_ON_TRACK: Final = 5
_OWN_FAULT: Final = ("ego", "both")


def describe_next_steps(data: ReportData) -> tuple[str, tuple[str, ...]]:
    """Describe, as a text and list items, what to give to developers, decision makers and the proving ground."""
    scenario, what = _worst_scenario(data)
    pairs = find_collision_boundary(data, _MAX_ON_TRACK)
    text = f"Give scenario {scenario}, {what}, to the developer"
    if pairs:
        listed = join_with_and([f"scenario {data.rows[pair.without_collision].id}" for pair in pairs])
        text += f", and drive {listed} on the proving ground: their values are nearest to those of a collision"
    elif misses := sort_near_misses(data.approaches, data.hardest_impacts)[:_MAX_ON_TRACK]:
        listed = join_with_and([f"scenario {scenario}" for scenario, _ in misses])
        text += f", and drive {listed} on the proving ground: the nearest misses"
    points = [
        *_describe_for_developer(data, scenario),
        *_describe_for_deciders(data),
        *_describe_for_proving_ground(data, pairs),
    ]
    return f"{text}.", tuple(points)


def describe_next_steps_after_suite(data: ReportData) -> tuple[str, tuple[str, ...]]:
    """Describe, as a text and list items, what to do after a run of a suite with its failed and critical scenarios."""
    states = {scenario: worst_state(verdicts) for scenario, verdicts in data.verdicts.items()}
    failed = [scenario for scenario, state in states.items() if state == "failed"]
    critical = [row.id for row, is_critical in zip(data.rows, data.is_critical.tolist(), strict=True) if is_critical]
    narrow = [scenario for scenario in critical if states[scenario] == "passed"]
    unjudged = [scenario for scenario in critical if states[scenario] == "inconclusive"]
    parts = [
        f"{count} that {what}"
        for count, what in (
            (len(failed), "failed"),
            (len(narrow), "passed but is critical" if len(narrow) == 1 else "passed but are critical"),
            (len(unjudged), "is critical but inconclusive" if len(unjudged) == 1 else "are critical but inconclusive"),
        )
        if count
    ]
    track = [*failed, *narrow, *unjudged][:_MAX_ON_TRACK]
    text = f"Give the developer {join_with_and(parts)}." if parts else "Nothing failed, and nothing is critical."
    study = shlex.quote(data.file_name)
    points = [f"Developer: the file, and 'cornercase replay {study} {track[0]} -o run.html'."] if track else []
    points.append(
        "Safety and authority: this page, the suite with its manifest.json, and the report of the study that the suite"
        " was made from, which says what it leaves out."
    )
    if track:
        listed = join_with_and([f"scenario {scenario}" for scenario in track])
        points.append(f"Proving ground: {_format_cards_command(data, track)} of {listed}.")
    return text, tuple(points)


def describe_repeatability(data: ReportData) -> str:
    """Describe whether a second run of a suite would give the same results."""
    meta = data.summary.meta
    if meta.nondeterminism_text:
        return f"Runs differ: {meta.nondeterminism_text}. A verdict near its limit may be another the next time."
    if meta.may_draw_random_numbers:
        return "Recordings may depend on the seed: a driver is a class of its own, or a sensor is random."
    if meta.repeatability.get("same"):
        return "The first scenario was run twice, with the same recording: verdicts should be the same the next time."
    return "It is not known whether a second run gives the same; --repeats runs each scenario several times."


def _worst_scenario(data: ReportData) -> tuple[int, str]:
    """Return the id of the worst scenario, and why it is the worst: ``"the hardest collision"``."""
    hardest = data.hardest_first
    if hardest:
        # The developer of the ego may not have to fix collisions for which the ego is not at fault.
        own = [(scenario, impact) for scenario, impact in hardest if impact.fault and impact.fault.who in _OWN_FAULT]
        if own and own[0] != hardest[0]:
            return own[0][0], f"the hardest collision for which {data.summary.meta.ego} is at fault"
        return hardest[0][0], "the hardest collision"
    misses = sort_near_misses(data.approaches, {})
    if misses and not data.is_critical.any():
        return misses[0][0], "the nearest miss"
    return data.summary.metrics[data.metrics[0].name].most_critical_id, f"the most critical {data.metrics[0].name}"


def _describe_for_developer(data: ReportData, scenario: int) -> Iterator[str]:
    study = shlex.quote(data.file_name)
    replay = f"'cornercase replay {study} {scenario} -o run.html' writes its replay"
    reduced = data.summary.reduced_set
    file = next((item.file for item in (reduced.scenarios if reduced else ()) if item.id == scenario), None)
    if file is not None:
        yield f"Developer: scenario {scenario} is {file} of the reduced set; {replay}."
    elif data.summary.meta.simulator == IMPORTED_SIMULATOR or data.summary.meta.suite:
        yield f"Developer: {replay}."
    else:
        yield (f"Developer: 'cornercase reduce {study} --ids {scenario} -o chosen' writes it as .xosc, {replay}.")


def _describe_for_deciders(data: ReportData) -> Iterator[str]:
    study = shlex.quote(data.file_name)
    page = f"Safety and authority: one page, by 'cornercase report {study} --one-page -o summary.html'"
    if data.summary.reduced_set is not None:
        yield f"{page}, with manifest.json of the reduced set, and this page for the details."
    else:
        yield f"{page}, and this page for the details; 'cornercase reduce' would add the few scenarios to keep."


def _describe_for_proving_ground(data: ReportData, pairs: Sequence[BoundaryPair]) -> Iterator[str]:
    if not pairs:
        misses = sort_near_misses(data.approaches, data.hardest_impacts)[:_MAX_ON_TRACK]
        yield (
            "Proving ground: no two scenarios lie on both sides of a collision"
            + (
                f". {_format_cards_command(data, [scenario for scenario, _ in misses])} of the nearest misses."
                if misses
                else "."
            )
        )
        return
    repeatable = ""
    if data.summary.meta.repeats == 1 and data.summary.meta.nondeterminism_text:
        repeatable = " Runs differ, so repeat each before."
    cards = _format_cards_command(data, [data.rows[pair.without_collision].id for pair in pairs])
    yield (
        "Proving ground: scenarios without a collision, and the nearest ones with a collision; the border lies between"
        f" them.{repeatable} {cards} of the former."
    )
    for pair in pairs:
        safe, hit = data.rows[pair.without_collision], data.rows[pair.with_collision]
        values = ", ".join(
            f"{parameter.name} {_format_parameter_value(parameter, safe.values)}" for parameter in data.parameters
        )
        steps = ", ".join(_describe_parameter_changes(data.parameters, safe.values, hit.values))
        yield f"Scenario {safe.id}: {values}; it collides in scenario {hit.id}, with {steps}."


def _format_cards_command(data: ReportData, scenarios: Sequence[int]) -> str:
    ids = ",".join(map(str, scenarios))
    study = shlex.quote(data.file_name)
    return f"'cornercase report {study} --test-cards --ids {ids} -o cards.html' writes a page for each"


def _format_parameter_value(parameter: Parameter, values: Mapping[str, Value]) -> str:
    return append_unit(format_value(parameter.extract_value(values), 4), parameter.unit)


def _describe_parameter_changes(
    parameters: Sequence[Parameter], start: Mapping[str, Value], end: Mapping[str, Value]
) -> Iterator[str]:
    """Yield the change of each parameter from `start` to `end` in its unit; equal parameters are left out."""
    for parameter in parameters:
        old, new = (parameter.extract_value(values) for values in (start, end))
        if old == new:
            continue
        if isinstance(old, str) or isinstance(new, str):
            yield f"{parameter.name} {new}"
        else:
            yield f"{parameter.name} {append_unit(f'{new - old:+.3g}', parameter.unit)}"
