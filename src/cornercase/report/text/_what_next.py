"""Sentences on what to do next with what was found: what to give to others, and what to drive on a track."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

import numpy as np

from cornercase.report._boundary import BoundaryPair, find_collision_boundary
from cornercase.report._near_misses import sort_near_misses
from cornercase.report._report_data import ReportData
from cornercase.report.text._phrases import append_unit, format_value, join_with_and
from cornercase.scenario import Parameter, Value
from cornercase.study._import_recordings import IMPORTED_SIMULATOR

# Scenarios to be driven on a proving ground, which costs a day.
_MAX_ON_TRACK: Final = 5


def describe_next_steps(data: ReportData) -> tuple[str, tuple[str, ...]]:
    """Say what to give to the developer, to whoever decides, and to the proving ground."""
    scenario, what = _worst_scenario(data)
    pairs = find_collision_boundary(data, _MAX_ON_TRACK)
    text = f"Give scenario {scenario}, {what}, to the developer"
    if pairs:
        listed = join_with_and([f"scenario {data.rows[pair.without_collision].id}" for pair in pairs])
        text += f", and drive {listed} on the proving ground: these are nearest to a collision"
    points = [
        *_describe_for_developer(data, scenario),
        *_describe_for_deciders(data),
        *_describe_for_track(data, pairs),
    ]
    return f"{text}. In commands, STUDY.db stands for this study.", tuple(points)


def _worst_scenario(data: ReportData) -> tuple[int, str]:
    """Return the id of the scenario to look at first, and what it is."""
    hardest = sorted(data.hardest_impacts.items(), key=lambda item: (-np.nan_to_num(item[1].speed), item[0]))
    if hardest:
        return hardest[0][0], "the hardest collision"
    misses = sort_near_misses(data.approaches, {})
    if misses and not data.is_critical.any():
        return misses[0][0], "the nearest miss"
    return data.summary.metrics[data.metrics[0].name].most_critical_id, f"the most critical {data.metrics[0].name}"


def _describe_for_developer(data: ReportData, scenario: int) -> Iterator[str]:
    replay = f"'cornercase replay STUDY.db {scenario} -o run.html' writes its replay"
    reduced = data.summary.reduced_set
    file = next((item.file for item in (reduced.scenarios if reduced else ()) if item.id == scenario), None)
    if file is not None:
        yield f"Developer: scenario {scenario} is {file} of the reduced set; {replay}."
    elif data.summary.meta.simulator == IMPORTED_SIMULATOR or data.summary.meta.suite:
        yield f"Developer: {replay}."
    else:
        yield (f"Developer: 'cornercase reduce STUDY.db --ids {scenario} -o chosen' writes it as .xosc, {replay}.")


def _describe_for_deciders(data: ReportData) -> Iterator[str]:
    page = "Safety and authority: one page, by 'cornercase report STUDY.db --one-page -o summary.html'"
    if data.summary.reduced_set is not None:
        yield f"{page}, with manifest.json of the reduced set, and this page for the details."
    else:
        yield f"{page}, and this page for the details; 'cornercase reduce' would add the few scenarios to keep."


def _describe_for_track(data: ReportData, pairs: Sequence[BoundaryPair]) -> Iterator[str]:
    if not pairs:
        yield "Proving ground: nothing to name, since no two scenarios lie on both sides of a collision."
        return
    repeatable = ""
    if data.summary.meta.repeats == 1 and data.summary.meta.nondeterminism_text:
        repeatable = " Runs differ, so repeat each before."
    ids = ",".join(str(data.rows[pair.without_collision].id) for pair in pairs)
    yield (
        "Proving ground: scenarios without a collision, and the nearest ones with a collision; the border lies between"
        f" them.{repeatable} 'cornercase report STUDY.db --test-cards --ids {ids} -o cards.html' writes a page for"
        " each."
    )
    for pair in pairs:
        safe, hit = data.rows[pair.without_collision], data.rows[pair.with_collision]
        values = ", ".join(f"{parameter.name} {_format(parameter, safe.values)}" for parameter in data.parameters)
        steps = ", ".join(_describe_steps(data.parameters, safe.values, hit.values))
        yield f"Scenario {safe.id}: {values}; it collides in scenario {hit.id}, with {steps}."


def _format(parameter: Parameter, values: Mapping[str, Value]) -> str:
    return append_unit(format_value(parameter.extract_value(values), 4), parameter.unit)


def _describe_steps(
    parameters: Sequence[Parameter], start: Mapping[str, Value], end: Mapping[str, Value]
) -> Iterator[str]:
    """Yield how far each parameter is from its value beyond the boundary, in its unit."""
    for parameter in parameters:
        old, new = (parameter.extract_value(values) for values in (start, end))
        if old == new:
            continue
        if isinstance(old, str) or isinstance(new, str):
            yield f"{parameter.name} {new}"
        else:
            yield f"{parameter.name} {append_unit(f'{new - old:+.3g}', parameter.unit)}"
