"""Page of a comparison: one HTML file without external references."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from cornercase._common import arguments
from cornercase._common.files import require_other_file, written_whole
from cornercase._common.typing import FloatArray
from cornercase.metrics import METRICS
from cornercase.recordings import Recording
from cornercase.report.blocks import pack_block, pack_record
from cornercase.report.contents import plain_score, plain_values, tell_against, tell_subject
from cornercase.report.page import REPLAY_SCRIPTS
from cornercase.report.roads import find_roads, pack_roads, recorded_region
from cornercase.report.templates import fill_template
from cornercase.report.versions.charts import draw_charts
from cornercase.scenario import Scenario
from cornercase.study import Study, open_study
from cornercase.suite import NAMED, Comparison, Finding, Telling, name_pair, tell_comparison

_STYLES: Final = ("style.css", "replay.css", "versions.css")
_SCRIPTS: Final = ("store.js", "recordings.js", *REPLAY_SCRIPTS, "versions.js")
_POLICY: Final = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:"


def write_comparison(
    found: Comparison,
    old: Study | Path | str,
    new: Study | Path | str,
    path: Path | str,
    *,
    scenario: Path | str | Scenario | None = None,
) -> Path:
    """Write the page of a comparison: verdict, changes, charts, and replays of example scenarios.

    Parameters
    ----------
    found : Comparison
        Result of `compare` for the two studies.
    old, new : Study or path
        The compared studies.
    path : path
        File to write. The same comparison gives the same bytes.
    scenario : path or Scenario, optional
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
    path = arguments.path("path", path)
    critical = found.critical
    with (
        open_study(old, readonly=True, critical=critical) as before,
        open_study(new, readonly=True, critical=critical) as after,
    ):
        require_other_file(path, before.path)
        require_other_file(path, after.path)
        page = _filled(found, before, after, scenario)
    with written_whole(path) as temporary:
        temporary.write_text(page, encoding="utf-8", errors="backslashreplace", newline="\n")
    return path


def _filled(found: Comparison, old: Study, new: Study, scenario: Path | str | Scenario | None) -> str:
    recordings, records = [], []
    for k, telling in enumerate(found.telling):
        for number, study, scenario_id in _both(k, telling, old, new):
            if study.scores_of(scenario_id):
                recordings.append(study.recording(scenario_id))
                records.append((number, pack_record(number, recordings[-1], _courses(study, scenario_id, found))))
    block, offsets = pack_block([record for _, record in records])
    index = {str(number): [0, offset] for (number, _), offset in zip(records, offsets, strict=True)}
    sections = [section for section in tell_comparison(found) if section.key not in ("answer", "findings", "telling")]
    answer = tell_comparison(found)[0]
    contents = _contents(found, old, new) | {"recordings": index} | _roads(found, old, recordings, scenario)
    return fill_template(
        "versions.html.j2",
        _STYLES,
        _SCRIPTS,
        policy=_POLICY,
        title=f"{found.title}: {found.names[0]} and {found.names[1]}",
        about=f"{found.names[0]} is the old version, {found.names[1]} the new one.",
        answer=answer,
        verdict=found.verdict,
        reason=found.verdict_reason,
        findings=[(title, _findings(findings, found)) for title, findings in _directions(found) if findings],
        sections=sections,
        charts=list(draw_charts(found, old.space.parameters)),
        telling=[(2 * k + 1, 2 * k + 2, example.why, _ids(example)) for k, example in enumerate(found.telling)],
        contents=contents,
        blocks=[base64.b64encode(block).decode()],
    )


def _directions(found: Comparison) -> tuple[tuple[str, tuple[Finding, ...]], ...]:
    return ("Worse", found.worse), ("Better", found.better)


def _findings(findings: Sequence[Finding], found: Comparison) -> list[dict[str, Any]]:
    """Return the texts of findings, with the page's numbers of their scenarios if they can be replayed."""
    page_numbers = {example.pair.ids: (2 * k + 1, 2 * k + 2) for k, example in enumerate(found.telling)}
    return [
        {
            "what": finding.what,
            "test": finding.tell_test(),
            "scenarios": [(name_pair(ids), *page_numbers.get(ids, (None, None))) for ids in finding.ids[:NAMED]],
            "more": max(len(finding.ids) - NAMED, 0),
        }
        for finding in findings
    ]


def _both(k: int, telling: Telling, old: Study, new: Study) -> tuple[tuple[int, Study, int], ...]:
    """Return the page's number, study and scenario id of each scenario of example `index`."""
    return (2 * k + 1, old, telling.pair.ids[0]), (2 * k + 2, new, telling.pair.ids[1])


def _ids(telling: Telling) -> str:
    first, second = telling.pair.ids
    return f"Scenario {first}" if first == second else f"Scenarios {first} and {second}"


def _courses(study: Study, scenario: int, found: Comparison) -> dict[str, FloatArray]:
    names = [score.metric for score in found.scores]
    return {name: METRICS.create(name).capped(study.course(scenario, name)) for name in names}


def _contents(found: Comparison, old: Study, new: Study) -> dict[str, Any]:
    """Return the contents of the replays; the two scenarios of each pair have numbers of the page's own."""
    rows = [{row.id: row for row in study.rows()} for study in (old, new)]
    pairs = [example.pair for example in found.telling]
    outcomes = sorted({outcome for pair in pairs for outcome in pair.outcomes if outcome})
    metrics = [score.metric for score in found.scores]
    members = [(pair, side, rows[side][pair.ids[side]]) for pair in pairs for side in (0, 1)]
    errors = {str(k + 1): row.error or "" for k, (_, _, row) in enumerate(members) if row.state == "failed"}
    meta = old.meta
    subject = tell_subject(meta, old.path.name)
    critical = None
    if old.critical is not None and not meta.weights and not meta.pareto:
        first = METRICS.create(meta.metrics[0])
        critical = {"threshold": old.critical, "lower_is_critical": first.lower_is_critical, "unit": first.unit}
    metrics_of_page = [metric for metric in subject["metrics"] if metric["name"] in metrics] or subject["metrics"]
    sources = [(old, new)[side].against_of(row.id) for _, side, row in members]
    return subject | {
        "metrics": metrics_of_page,
        "searched": meta.metrics[0] if critical is not None else "",
        "critical": critical,
        "outcomes": outcomes,
        "called": {
            str(k + 1): f"{('Old', 'New')[side]}: scenario {row.id} of {found.names[side]}"
            for k, (_, side, row) in enumerate(members)
        },
        "scenarios": {
            "id": list(range(1, len(members) + 1)),
            "round": [row.round for _, _, row in members],
            "failed": [int(row.state == "failed") for _, _, row in members],
            "values": plain_values(old.space.parameters, [row for _, _, row in members]),
            "scores": {name: [_score(pair.scores, name, side) for pair, side, _ in members] for name in metrics},
            "critical": [int(bool(pair.critical and pair.critical[side])) for pair, side, _ in members],
            "outcome": [
                outcomes.index(pair.outcomes[side]) if pair.outcomes[side] else None for pair, side, _ in members
            ],
            "kept": [0] * len(members),
        }
        | tell_against(meta, [[source.get(metric["name"]) for metric in metrics_of_page] for source in sources]),
        "kept": {},
        "errors": errors,
        "kinds": {},
    }


def _score(scores: Mapping[str, tuple[float, float]], name: str, side: int) -> float | None:
    return plain_score(scores[name][side]) if name in scores else None


def _roads(
    found: Comparison, old: Study, recordings: list[Recording], scenario: Path | str | Scenario | None
) -> dict[str, Any]:
    values = found.telling[0].pair.values if found.telling else None
    road, missing = find_roads(old, recorded_region(recordings), scenario, values)
    return {"roads": None if road is None else pack_roads(road), "roads_missing": missing}
