"""Page of a comparison: one HTML file without external references."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from cornercase._common import validation
from cornercase._common.io.files import check_output_differs_from_source
from cornercase._common.typing import FloatArray
from cornercase.recordings import Recording
from cornercase.recordings._rounded import encode_rounded
from cornercase.report._event_payload import find_events_of_scenario
from cornercase.report._page import REPLAY_SCRIPTS
from cornercase.report._payload import parameter_columns, round_score, score_source_column, study_info_payload
from cornercase.report._road_drawing import encode_road_outline, find_road_outline, recorded_bounds
from cornercase.report.comparison._charts import draw_charts
from cornercase.report.html._templates import render_template, write_page
from cornercase.scenario._file import ScenarioFile
from cornercase.study import StudyFile
from cornercase.study._study_file import open_study
from cornercase.suite import Comparison, Example, Finding
from cornercase.suite.compare._comparison import format_pair_ids
from cornercase.suite.compare._describe_comparison import MAX_TABLE_SCENARIOS, describe_comparison

_STYLES: Final = ("style.css", "replay.css", "versions.css")
_SCRIPTS: Final = ("store.js", "recordings.js", *REPLAY_SCRIPTS, "versions.js")
_POLICY: Final = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:"


def write_comparison(
    comparison: Comparison,
    old: StudyFile | Path | str,
    new: StudyFile | Path | str,
    path: Path | str,
    *,
    scenario: Path | str | ScenarioFile | None = None,
) -> Path:
    """Write the page of a comparison: verdict, changes, charts, and replays of example scenarios.

    Parameters
    ----------
    comparison : Comparison
        Result of `compare` for the two studies.
    old, new : Study or path
        The compared studies.
    path : path
        File to write. The same comparison gives the same bytes.
    scenario : path or ScenarioFile, optional
        Scenario file, to draw the road; by default it is searched beside the old study and in the current folder.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    InputError
        The file cannot be written, a study cannot be read, or `scenario` is not the explored one.

    Examples
    --------
    >>> import cornercase as cc
    >>> from cornercase.report import write_comparison
    >>> write_comparison(cc.compare("old.db", "new.db"), "old.db", "new.db", "compare.html")  # doctest: +SKIP
    PosixPath('compare.html')
    """
    path = validation.check_path("path", path)
    critical = comparison.critical
    with (
        open_study(old, readonly=True, critical=critical) as before,
        open_study(new, readonly=True, critical=critical) as after,
    ):
        check_output_differs_from_source(path, before.path)
        check_output_differs_from_source(path, after.path)
        page = _render_page(comparison, before, after, scenario)
    write_page(path, page)
    return path


def _render_page(
    comparison: Comparison, old: StudyFile, new: StudyFile, scenario: Path | str | ScenarioFile | None
) -> str:
    recordings, texts, events = [], {}, {}
    for k, telling in enumerate(comparison.examples):
        for number, study, scenario_id in _scenarios_of_example(k, telling, old, new):
            if study.scenario_scores(scenario_id):
                recordings.append(study.recording(scenario_id))
                packed = encode_rounded(recordings[-1], _read_courses(study, scenario_id, comparison))
                texts[number] = base64.b64encode(packed).decode()
                events[str(number)] = find_events_of_scenario(study, scenario_id, recordings[-1])
    sections = [
        section
        for section in describe_comparison(comparison)
        if section.key not in ("answer", "changes", "findings", "telling")
    ]
    answer = describe_comparison(comparison)[0]
    contents = (
        _replay_payload(comparison, old, new)
        | {"recordings": list(texts), "events": events}
        | _road_payload(comparison, old, recordings, scenario)
    )
    return render_template(
        "versions.html.j2",
        _STYLES,
        _SCRIPTS,
        policy=_POLICY,
        title=f"{comparison.title}: {comparison.names[0]} and {comparison.names[1]}",
        about=f"{comparison.names[0]} is the old version, {comparison.names[1]} the new one.",
        answer=answer,
        verdict=comparison.verdict,
        reason=comparison.verdict_reason,
        findings=[
            (title, _findings_payload(findings, comparison))
            for title, findings in _findings_by_direction(comparison)
            if findings
        ],
        sections=sections,
        charts=list(draw_charts(comparison, old.space.parameters)),
        telling=[
            (2 * k + 1, 2 * k + 2, example.reason, _format_ids(example))
            for k, example in enumerate(comparison.examples)
        ],
        contents=contents,
        recordings=texts,
    )


def _findings_by_direction(comparison: Comparison) -> tuple[tuple[str, tuple[Finding, ...]], ...]:
    return ("Worse", comparison.worse), ("Better", comparison.better)


def _findings_payload(findings: Sequence[Finding], comparison: Comparison) -> list[dict[str, Any]]:
    """Return the texts of findings, with the page's numbers of the example scenarios that show them."""
    page_numbers = {example.pair.ids: (2 * k + 1, 2 * k + 2) for k, example in enumerate(comparison.examples)}
    return [
        {
            "what": finding.change_text,
            "test": finding.describe_test(),
            "scenarios": [
                (format_pair_ids(ids), *page_numbers.get(ids, (None, None)))
                for ids in finding.ids[:MAX_TABLE_SCENARIOS]
            ],
            "more": max(len(finding.ids) - MAX_TABLE_SCENARIOS, 0),
        }
        for finding in findings
    ]


def _scenarios_of_example(
    index: int, example: Example, old: StudyFile, new: StudyFile
) -> tuple[tuple[int, StudyFile, int], ...]:
    """Return old and new scenario of example `index`, each as its number on the page, its study and its id."""
    return (2 * index + 1, old, example.pair.ids[0]), (2 * index + 2, new, example.pair.ids[1])


def _format_ids(example: Example) -> str:
    first, second = example.pair.ids
    return f"Scenario {first}" if first == second else f"Scenarios {first} and {second}"


def _read_courses(study: StudyFile, scenario: int, comparison: Comparison) -> dict[str, FloatArray]:
    names = [score.metric for score in comparison.scores]
    return {name: comparison.metrics[name].clip_course(study.course(scenario, name)) for name in names}


def _replay_payload(comparison: Comparison, old: StudyFile, new: StudyFile) -> dict[str, Any]:
    """Return the contents of the replays; both scenarios of each example have numbers of their own on the page."""
    rows = [{row.id: row for row in study.rows()} for study in (old, new)]
    pairs = [example.pair for example in comparison.examples]
    outcomes = sorted({outcome for pair in pairs for outcome in pair.outcomes if outcome})
    metrics = [score.metric for score in comparison.scores]
    members = [(pair, side, rows[side][pair.ids[side]]) for pair in pairs for side in (0, 1)]
    errors = {str(k + 1): row.error or "" for k, (_, _, row) in enumerate(members) if row.state == "failed"}
    meta = old.meta
    subject = study_info_payload(meta, old.path.name)
    criterion = None if meta.weights else old.criterion
    metrics_of_page = [metric for metric in subject["metrics"] if metric["name"] in metrics] or subject["metrics"]
    sources = [(old, new)[side].scenario_score_sources(row.id) for _, side, row in members]
    return subject | {
        "metrics": metrics_of_page,
        "searched": meta.metrics[0] if criterion is not None else "",
        "critical": None if criterion is None else asdict(criterion),
        "outcomes": outcomes,
        "called": {
            str(k + 1): f"{('Old', 'New')[side]}: scenario {row.id} of {comparison.names[side]}"
            for k, (_, side, row) in enumerate(members)
        },
        "scenarios": {
            "id": list(range(1, len(members) + 1)),
            "round": [row.round for _, _, row in members],
            "failed": [int(row.state == "failed") for _, _, row in members],
            "values": parameter_columns(old.space.parameters, [row for _, _, row in members]),
            "scores": {
                name: [_score_of_side(pair.scores, name, side) for pair, side, _ in members] for name in metrics
            },
            "critical": [int(bool(pair.is_critical and pair.is_critical[side])) for pair, side, _ in members],
            "outcome": [
                outcomes.index(pair.outcomes[side]) if pair.outcomes[side] else None for pair, side, _ in members
            ],
            "kept": [0] * len(members),
        }
        | score_source_column(meta, [[source.get(metric["name"]) for metric in metrics_of_page] for source in sources]),
        "kept": {},
        "errors": errors,
        "kinds": {},
    }


def _score_of_side(scores: Mapping[str, tuple[float, float]], name: str, side: int) -> float | None:
    return round_score(scores[name][side]) if name in scores else None


def _road_payload(
    comparison: Comparison, old: StudyFile, recordings: list[Recording], scenario: Path | str | ScenarioFile | None
) -> dict[str, Any]:
    values = comparison.examples[0].pair.values if comparison.examples else None
    road, missing = find_road_outline(old, recorded_bounds(recordings), scenario, values)
    return {"roads": None if road is None else encode_road_outline(road), "roads_missing": missing}
