"""Texts and drawings of one test card, a printed page from which a scenario is driven on a proving ground."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from cornercase._common.errors import InputError
from cornercase._common.text.sanitize import escape_control_characters, quote_name, remove_folders, shorten
from cornercase.drivers._serialization import format_driver
from cornercase.report._road_drawing import add_road_margin, find_road_outline
from cornercase.report.cards._condition_texts import format_speed
from cornercase.report.cards._contact_texts import (
    describe_contacts,
    describe_unmeasured_contacts,
    escape_and_shorten,
    join_names,
    list_contact_rows_by_run,
)
from cornercase.report.cards._layout import MAX_PARTIES, CardTexts, Trigger, choose_layout, format_settings_line
from cornercase.report.cards._movements import Movement, list_movements
from cornercase.report.cards._rounded_runs import CardRun, RoundedRun
from cornercase.report.cards._settable_quantity import SettableQuantity
from cornercase.report.cards._sketch import draw_meeting_closeup, draw_paths_to_meeting
from cornercase.report.cards._start_poses import StartPose, list_start_poses, read_network
from cornercase.report.cards._tolerances import NO_TOLERANCE, find_tolerances
from cornercase.report.text._phrases import append_unit, format_criterion_with_signs, format_value
from cornercase.scenario import Parameter, Value
from cornercase.scenario._file import ScenarioFile
from cornercase.study import StudyFile
from cornercase.study._scenario_digest import find_bounds

# What fits on the page.
_MAX_SCORES: Final = 3
_MAX_REQUIREMENTS: Final = 4
_MAX_REQUIREMENT: Final = 110
_MAX_TRIGGER_TEXT: Final = 160
# Names and values of parameters, which are on several lines if they are long.
_MAX_PARAMETER_NAME: Final = 40
_MAX_VALUE: Final = 64
_COURSE_MM: Final = 128.0
_MEETING_MM: Final = 52.0
_NO_CELL: Final = "–"


@dataclass(frozen=True)
class CardSource:
    """Scenario of a test card, with its run in the study and its run with rounded parameter values.

    `role` and `why` say why the scenario belongs to the reduced set; both are empty for any other scenario.
    """

    scenario_id: int
    original: CardRun
    rounded: RoundedRun
    role: str
    why: str

    @property
    def run(self) -> CardRun:
        """The run that the card shows: the run with rounded parameter values if there is one, else the study's run."""
        return self.rounded.run or self.original


def make_card_values(
    study: StudyFile, source: CardSource, scenario: ScenarioFile | None, quantities: Sequence[SettableQuantity]
) -> dict[str, Any]:
    """Return the values for the page template of one test card, with as many rows as fit on the page."""
    run, meta = source.run, study.meta
    recording, meeting = run.recording, run.meeting
    road, no_road = find_road_outline(study, add_road_margin(find_bounds(recording)), scenario, dict(run.values))
    poses = list_start_poses(recording, read_network(scenario, dict(run.values)))
    rank = _rank_entities(study, source)
    parameters = _parameter_rows(meta.space.parameters, quantities, source)
    parties = _party_rows(sorted(poses, key=lambda pose: rank.get(pose.name, len(rank))), study, source)
    movements, trigger_note = _list_movements(scenario, source.rounded.values)
    fixed, verdict = _fixed_parameters(meta.space.parameters, run), _describe_rounded_outcome(source)
    results, accept = _result_rows(study, source), _list_pass_conditions(study)
    why = escape_and_shorten(f"Kept as {source.role}: {source.why}.", 170) if source.role else ""
    file = escape_and_shorten(meta.files[source.scenario_id - 1] if meta.suite else meta.file_name, 40)
    unmeasured = describe_unmeasured_contacts(
        [run.meeting for run in (source.original, source.rounded.run) if run], meta.ego
    )
    texts = CardTexts(
        lines=(
            verdict["text"],
            f"Under test: {describe_entity_under_test(study)}. {why}",
            fixed, _further_tolerances(parties[:MAX_PARTIES]),
            f"{file} {study.path.name} {meta.simulator}",
        ),
        bold=verdict["kind"] == "changed",
        parameters=parameters,
        parties=parties,
        triggers=_list_triggers(movements),
        trigger_ranks=[min(rank.get(name, len(rank)) for name in item.actors or ("",)) for item in movements],
        results=results,
        below_results=unmeasured,
        conditions=accept,
    )  # fmt: skip
    layout = choose_layout(texts)
    parties, height = parties[: layout.n_parties], layout.drawing_height
    if len(layout.triggers) < len(movements):
        trigger_note = f"And {len(movements) - len(layout.triggers)} more, which the scenario file lists."
    return {
        "id": source.scenario_id,
        "kept_as": why,
        "file": file,
        "verdict": verdict,
        "parameters": parameters[: layout.n_parameters],
        "more_parameters": format_settings_line(parameters[layout.n_parameters :]),
        "fixed": fixed,
        "parties": parties,
        "more_parties": len(poses) - layout.n_parties,
        "further_tolerances": _further_tolerances(parties),
        "triggers": layout.triggers,
        "trigger_note": trigger_note,
        "course": draw_paths_to_meeting(recording, meta.ego, meeting, road, _COURSE_MM, height),
        "meeting": draw_meeting_closeup(recording, meta.ego, meeting, road, _MEETING_MM, height),
        "no_road": escape_control_characters(no_road),
        "at_meeting": "contact" if meeting.collides else "closest approach",
        "results": results,
        "has_rounded": source.rounded.run is not None,
        "unmeasured": unmeasured,
        "accept": accept,
        "drawn": "the rounded scenario" if source.rounded.run is not None else "the run in the study",
    }


def describe_entity_under_test(study: StudyFile) -> str:
    """Format the ego and its driver, ``"Ego, driven by NAME"``, or only the ego if the study sets no driver."""
    driver = study.meta.ego_driver
    text = f"{study.meta.ego}, driven by {format_driver(driver)}" if driver else study.meta.ego
    return escape_and_shorten(text, 80)


def _rank_entities(study: StudyFile, source: CardSource) -> dict[str, int]:
    """Return the rank of each entity: 0 for the ego, then entities that the ego meets or touches, then the others."""
    touched = [
        name
        for run in (source.run, source.original)
        for name, _ in run.meeting.further_contacts + run.meeting.unmeasured_contacts
    ]
    met = source.run.meeting.other, source.original.meeting.other
    names = dict.fromkeys((study.meta.ego, *met, *touched, *study.meta.others))
    return {name: k for k, name in enumerate(names)}


def _describe_rounded_outcome(source: CardSource) -> dict[str, str]:
    """Return a text on whether the rounded scenario ends as in the study, and the kind of result, for the style."""
    rounded = source.rounded
    if rounded.run is None:
        text = f"The rounded scenario was not run again: {_clean_reason(rounded.reason, 200)}."
        if rounded.n_tried > 1:
            text += f" {_describe_tried(rounded).capitalize()}."
        return {"kind": "unknown", "text": text}
    how = _describe_outcome(rounded.run)
    if rounded.keeps_outcome:
        text = f"The rounded scenario was run again and ends as the study's: {how}."
        if not rounded.is_nearest:
            why = (
                f"The nearest rounding could not be run ({_clean_reason(rounded.reason, 120)})"
                if rounded.reason
                else "Rounding to the nearest steps changed the outcome"
            )
            text += f" {why}, so some values are rounded the other way."
        return {"kind": "kept", "text": text}
    other = _describe_outcome(source.original)
    text = f"ROUNDING CHANGES THE OUTCOME: in the study {other}; rounded {how}; {_describe_tried(rounded)}."
    return {"kind": "changed", "text": text}


def _clean_reason(text: str, length: int) -> str:
    """Shorten an error message to a part of a sentence; folders in paths are removed, since they are private."""
    return escape_and_shorten(remove_folders(text), length).rstrip(".")


def _describe_tried(rounded: RoundedRun) -> str:
    """Describe, as part of a sentence, that none of the tried roundings keeps the outcome."""
    if rounded.n_possible == 1:
        return "there is no other rounding (1 tried)"
    n_tried, are_all = rounded.n_tried, rounded.n_tried == rounded.n_possible
    if rounded.n_failed == n_tried:
        return f"none of the {n_tried} nearest roundings could be run"
    if rounded.n_failed:
        which = (
            f"the {n_tried} roundings up or down"
            if are_all
            else f"the {n_tried} nearest of {rounded.n_possible} roundings"
        )
        return f"of {which}, {rounded.n_failed} could not be run, and no other one keeps the outcome"
    if not are_all:
        return (
            f"none of the {n_tried} roundings nearest to the study's values, of {rounded.n_possible}, keeps the outcome"
        )
    return f"no rounding up or down keeps the outcome ({n_tried} tried)"


def _describe_outcome(run: CardRun) -> str:
    contact = describe_contacts(run.meeting)
    if run.is_critical is None:
        return contact
    return f"{contact}, {'critical' if run.is_critical else 'not critical'}"


def _parameter_rows(
    parameters: Sequence[Parameter], quantities: Sequence[SettableQuantity], source: CardSource
) -> list[list[str]]:
    rows = []
    for parameter, quantity in zip(parameters, quantities, strict=True):
        if parameter.size == 1:
            continue
        before = parameter.extract_value(source.original.values)
        after = parameter.extract_value(source.rounded.values)
        rows.append(
            [
                escape_and_shorten(parameter.name, _MAX_PARAMETER_NAME),
                escape_and_shorten(append_unit(_format_plain(before), quantity.unit), _MAX_VALUE),
                escape_and_shorten(_format_setting(after, quantity), _MAX_VALUE),
                _format_change(before, after, quantity),
                _parameter_tolerance(parameter, quantity),
            ]
        )
    return rows


def _fixed_parameters(parameters: Sequence[Parameter], run: CardRun) -> str:
    """Format the parameters whose range is a single value, in one line."""
    values = [
        (parameter.name, _format_plain(parameter.extract_value(run.values)))
        for parameter in parameters
        if parameter.size == 1
    ]
    texts = [f"{escape_and_shorten(name)} {escape_and_shorten(value, 24)}" for name, value in values]
    return shorten(", ".join(texts), 150)


def _format_plain(value: Value) -> str:
    """Format a parameter value without its unit; file paths are cut to file names, since folders are private."""
    if not isinstance(value, str):
        return format_value(value)
    return ", ".join(piece.strip().replace("\\", "/").rpartition("/")[2] for piece in value.split(","))


def _parameter_tolerance(parameter: Parameter, quantity: SettableQuantity) -> str:
    if parameter.choices:
        return _NO_CELL
    return "as of its party, below" if quantity.is_speed and not quantity.is_narrow_speed else NO_TOLERANCE


def _format_setting(value: Value, quantity: SettableQuantity) -> str:
    if isinstance(value, str) or not quantity.is_speed:
        return append_unit(_format_plain(value), quantity.unit)
    kmh = quantity.to_kmh(float(value))
    return f"{round(kmh, 3):g} km/h ({kmh / 3.6:.2f} m/s)"


def _format_change(before: Value, after: Value, quantity: SettableQuantity) -> str:
    if isinstance(before, str) or isinstance(after, str):
        return _NO_CELL
    if quantity.step is None:
        return f"not rounded, {quantity.note}"
    change = float(after) - float(before)
    return "none" if abs(change) < 1e-9 else append_unit(f"{change:+.2g}", quantity.unit).replace("-", "−")


def _party_rows(poses: Sequence[StartPose], study: StudyFile, source: CardSource) -> list[dict[str, str]]:
    """Return the table cells for each entity: start pose and speed, size, and tolerances."""
    meta, meeting = study.meta, source.run.meeting
    rows = []
    for pose in poses:
        crosses = meeting.crosses if pose.name == meeting.other else None
        tolerances = find_tolerances(pose.object_type, is_ego=pose.name == meta.ego, crosses=crosses)
        rows.append(
            {
                "name": escape_and_shorten(pose.name, 16),
                "kind": pose.object_type + (f" ({tolerances.target})" if tolerances else ""),
                "speed": f"{pose.speed * 3.6:.1f} km/h ({pose.speed:.2f} m/s)",
                "place": _format_road_position(pose),
                "position": f"{_format_fixed(pose.x, 1)}, {_format_fixed(pose.y, 1)} m",
                "heading": f"{_format_fixed(pose.heading, 1)}°",
                "size": f"{pose.length:.2f} × {pose.width:.2f} m",
                "time": "" if pose.time < 1e-9 else f"from {pose.time:.2f} s on",
                "speed_tolerance": tolerances.speed if tolerances else NO_TOLERANCE,
                "lateral_tolerance": tolerances.lateral if tolerances else NO_TOLERANCE,
                "more": "; ".join(tolerances.others) if tolerances else "",
            }
        )
    return rows


def _further_tolerances(parties: Sequence[dict[str, str]]) -> str:
    return "; ".join(f"{party['name']}: {party['more']}" for party in parties if party["more"])


def _format_road_position(pose: StartPose) -> str:
    if not pose.road:
        return "on no lane, or unknown"
    lane, offset = pose.lane.replace("-", "−"), _format_fixed(pose.offset, 1)
    return f"road {escape_and_shorten(pose.road, 12)}, lane {lane}, s {_format_fixed(pose.s, 1)} m, offset {offset} m"


def _format_fixed(value: float, digits: int) -> str:
    """Format a number; negative numbers get the minus sign ``−``, and numbers that round to 0 get no sign."""
    text = f"{value:.{digits}f}"
    return (text.lstrip("-") if float(text) == 0.0 else text).replace("-", "−")


def _list_movements(scenario: ScenarioFile | None, values: Mapping[str, Value]) -> tuple[list[Movement], str]:
    """Return the events that move entities, and a note if there are none or they are unknown."""
    if scenario is None:
        return [], "Not known: the scenario file was not found, or there is none."
    try:
        movements = list_movements(scenario, values)
    except InputError as error:
        return [], f"Not known: {_clean_reason(str(error), _MAX_TRIGGER_TEXT)}."
    return movements, "" if movements else "No event of the storyboard moves anybody."


def _list_triggers(movements: Sequence[Movement]) -> list[Trigger]:
    return [
        (
            escape_and_shorten(item.who, 24),
            escape_and_shorten(item.what, _MAX_TRIGGER_TEXT),
            escape_and_shorten(item.when, _MAX_TRIGGER_TEXT),
        )
        for item in movements
    ]


def _result_rows(study: StudyFile, source: CardSource) -> list[tuple[str, str, str]]:
    """Return table rows of results: name, value in the study, value in the rounded run."""
    runs = source.original, source.rounded.run
    contacts = list_contact_rows_by_run([None if run is None else run.meeting for run in runs])
    columns = [
        {} if run is None else contact | _format_run_results(study, run)
        for run, contact in zip(runs, contacts, strict=True)
    ]
    names = list(dict.fromkeys(name for column in columns for name in column))
    return [(name, columns[0].get(name, _NO_CELL), columns[1].get(name, _NO_CELL)) for name in names]


def _format_run_results(study: StudyFile, run: CardRun) -> dict[str, str]:
    meeting, meta = run.meeting, study.meta
    rows = {
        "smallest gap": "0 m" if meeting.collides else f"{meeting.gap:.2f} m to {escape_and_shorten(meeting.other, 12)}"
    }
    rows["time of that"] = f"{meeting.time:.2f} s"
    rows[f"speed of {escape_and_shorten(meta.ego, 16)}"] = format_speed(meeting.speed)
    rows[f"speed of {escape_and_shorten(meeting.other, 16)}"] = format_speed(meeting.other_speed)
    rows["relative speed"] = format_speed(meeting.relative_speed)
    if meeting.sides is not None:
        names = escape_and_shorten(meta.ego, 16), escape_and_shorten(meeting.other, 16)
        rows["sides that touch"] = ", ".join(
            f"{name} {side or '?'}" for name, side in zip(names, meeting.sides, strict=True)
        )
    if meeting.point is not None:
        rows["impact point x, y"] = ", ".join(_format_fixed(value, 2) for value in meeting.point) + " m"
    for metric in study.metrics()[:_MAX_SCORES]:
        if metric.name in run.scores and math.isfinite(run.scores[metric.name]):
            rows[escape_and_shorten(metric.name)] = append_unit(f"{run.scores[metric.name]:.3g}", metric.unit)
    return rows


def _list_pass_conditions(study: StudyFile) -> list[str]:
    """Return the conditions for a run to pass: the requirements of a suite.

    Without requirements, a run passes if it has no contact and is not critical.
    """
    meta = study.meta
    if meta.requirements:
        texts = [
            escape_and_shorten(f"Requirement: {text}", _MAX_REQUIREMENT)
            for text in meta.requirements[:_MAX_REQUIREMENTS]
        ]
        n_more = len(meta.requirements) - len(texts)
        return [*texts, *([f"And {n_more} more requirements, which the report lists."] if n_more else [])]
    texts = [f"No contact of {quote_name(escape_and_shorten(meta.ego))} with {join_names(meta.others, 'or')}."]
    criterion = study.criterion
    if criterion is not None and meta.condition != "collision":
        critical = format_criterion_with_signs(criterion, study.objective.label)
        texts.append(f"The run is not critical as the study defines it: {escape_and_shorten(critical, 120)}.")
    return texts
