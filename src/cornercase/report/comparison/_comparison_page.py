"""Page that compares two studies: one HTML file without external references."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from cornercase._common import validation
from cornercase._common.io.files import check_output_differs_from_source
from cornercase._common.text.sanitize import quote_name
from cornercase.recordings import Recording
from cornercase.report._report_page import REPLAY_SCRIPTS
from cornercase.report._report_payload import parameter_columns, round_score, score_source_column, study_info_payload
from cornercase.report._road_drawing import encode_road_outline, find_road_outline, recorded_bounds
from cornercase.report.comparison._charts import draw_charts
from cornercase.report.comparison._next_steps import describe_next_steps
from cornercase.report.comparison._replayed_pairs import MAX_CHARACTERS, ReplayedPairs, read_replayed_pairs
from cornercase.report.comparison._study_origins import describe_study_origins
from cornercase.report.html._templates import render_template, write_page
from cornercase.scenario._file import ScenarioFile
from cornercase.study import StudyFile
from cornercase.study._study_file import open_study
from cornercase.suite import Comparison, Example, Finding, ScenarioPair
from cornercase.suite.compare._describe_comparison import describe_comparison

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
    """Write a page that compares two studies: verdict, changes, charts, and replays of scenarios that differ.

    Parameters
    ----------
    comparison : Comparison
        Result of `compare` for the two studies.
    old, new : Study or path
        The compared studies.
    path : path
        File to write. The same comparison gives the same bytes.
    scenario : path or ScenarioFile, optional
        Scenario file, to draw the road. By default the file is searched where this machine explored it, then beside
        the old study and in the current folder.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    InputError
        The file cannot be written, a study cannot be read, or `scenario` is not the explored file.

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
    comparison: Comparison,
    old: StudyFile,
    new: StudyFile,
    scenario: Path | str | ScenarioFile | None,
    max_characters: int = MAX_CHARACTERS,
) -> str:
    replayed = read_replayed_pairs(comparison, old, new, max_characters)
    sections = {section.key: section for section in describe_comparison(comparison)}
    changes = sections["changes"]
    contents = (
        _replay_payload(comparison, replayed.pairs, old, new)
        | {"recordings": list(replayed.texts), "events": replayed.events, "differences": replayed.differences}
        | _road_payload(comparison, old, replayed.recordings, scenario)
    )
    return render_template(
        "versions.html.j2",
        _STYLES,
        _SCRIPTS,
        policy=_POLICY,
        title=f"{comparison.title}: {comparison.names[0]} and {comparison.names[1]}",
        about=f"{comparison.names[0]} is the old version, {comparison.names[1]} the new one.",
        answer=sections["answer"],
        heading=changes.title,
        changes=[replayed.link_sentence(sentence) for sentence in changes.sentences],
        verdict=comparison.verdict,
        reason=comparison.verdict_reason,
        findings=[
            (title, _findings_payload(findings, replayed))
            for title, findings in (("Worse", comparison.worse), ("Better", comparison.better))
            if findings
        ],
        steps=[
            (question, [replayed.link_sentence(sentence) for sentence in sentences])
            for question, sentences in describe_next_steps(comparison, new)
        ],
        sections=[
            section
            for section in describe_comparison(comparison)
            if section.key not in ("answer", "changes", "findings", "telling")
        ],
        replayed=replayed,
        left_out=_describe_left_out(comparison, replayed),
        charts=list(draw_charts(comparison, old.space.parameters)),
        examples=[
            (replayed.numbers_by_ids[example.pair.ids], example.reason, _format_ids(example))
            for example in comparison.examples
            if example.pair.ids in replayed.numbers_by_ids
        ],
        origins=describe_study_origins(comparison, old, new),
        contents=contents,
        recordings=replayed.texts,
    )


def _describe_left_out(comparison: Comparison, replayed: ReplayedPairs) -> str:
    """Describe how many differing scenarios have no replay on the page; the text is empty if all have a replay."""
    if not replayed.n_left_out:
        return ""
    return (
        f"{replayed.n_left_out} more scenarios differ, whose replays would make this page too large; their numbers are"
        f" no links. See one with: cornercase replay {quote_name(comparison.names[1])} ID -o run.html"
    )


def _findings_payload(findings: Sequence[Finding], replayed: ReplayedPairs) -> list[dict[str, Any]]:
    """Return findings (changes that the comparison found) as texts, with links to replays of their scenarios."""
    return [
        {"what": finding.change_text, "test": finding.describe_test(), "scenarios": replayed.link_all(finding.ids)}
        for finding in findings
    ]


def _format_ids(example: Example) -> str:
    first, second = example.pair.ids
    return f"Scenario {first}" if first == second else f"Scenarios {first} and {second}"


def _replay_payload(
    comparison: Comparison, pairs: Sequence[ScenarioPair], old: StudyFile, new: StudyFile
) -> dict[str, Any]:
    """Return the contents of the replays as JSON values; old and new scenario of a pair have separate numbers."""
    rows = [{row.id: row for row in study.rows()} for study in (old, new)]
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
