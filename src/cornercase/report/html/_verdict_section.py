"""Section with the verdicts (passed, failed or inconclusive) on the scenarios of a suite."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from typing import Final

from cornercase._common.text.sanitize import escape_control_characters
from cornercase.report._repeat_command import format_repeat_command
from cornercase.report._report_data import ReportData
from cornercase.report.html._scenario_links import link_scenarios
from cornercase.report.html._tables import Section, make_section
from cornercase.report.text._phrases import append_unit, format_criterion_with_signs
from cornercase.suite import Requirement, Verdict

# Verdicts that need attention come first.
_ORDER: Final = ("failed", "inconclusive", "passed")
_HEAD: Final = (
    "verdict",
    "file",
    "why",
    "requirement",
    "margin",
    "nearest",
    "critical",
    "kind when chosen",
    "scenario",
)
_MAX_LISTED: Final = 6


@dataclass(frozen=True)
class _VerdictRow:
    """Row of the table of verdicts: one verdict on a scenario, and facts about the scenario.

    `margin`, in `unit`, is the distance from the limit of the requirement, negative if the requirement is missed.
    `nearest` describes the closest approach to another entity, and `gap` is the smallest gap in m. In scenarios with a
    contact, or without a known approach, `nearest` is empty and `gap` infinite. `impact_speed`, in m/s, says how bad a
    contact is if the verdict is a failure without a margin; else None.
    """

    scenario: int
    verdict: Verdict
    file: str
    kind: str
    margin: float | None
    unit: str
    nearest: str
    gap: float
    is_critical: bool
    impact_speed: float | None

    @property
    def severity(self) -> tuple[int, float, float, int]:
        """Sort key, the worst first: state of the verdict, impact speed, margin, and scenario id."""
        hit = -self.impact_speed if self.impact_speed is not None else 0.0
        return _ORDER.index(self.verdict.state), hit, math.inf if self.margin is None else self.margin, self.scenario

    @property
    def margin_text(self) -> str:
        """The margin of the requirement, as ``"missed by 0.5 s"``; empty if there is no finite margin."""
        if self.margin is None or not math.isfinite(self.margin):
            return ""
        size = append_unit(f"{abs(self.margin):.3g}", self.unit)
        return f"missed by {size}" if self.margin < 0.0 else f"met by {size}"

    def cells(self) -> tuple[str, ...]:
        """Return the cells of this row, in the order of the table head."""
        return (
            self.verdict.state, self.file, self.verdict.reason, self.verdict.requirement, self.margin_text,
            self.nearest, "yes" if self.is_critical else "", self.kind, str(self.scenario),
        )  # fmt: skip


def render_verdicts(data: ReportData) -> Iterator[Section]:
    """Yield the section with all verdicts, the worst first, and what to fix; nothing if there are no verdicts."""
    if not data.verdicts:
        return
    rows = sorted(_build_rows(data), key=lambda row: (row.severity[:3], row.gap, row.scenario))
    cells = [row.cells() for row in rows]
    columns = [k for k in range(len(_HEAD)) if any(texts[k] for texts in cells)]
    head = "".join(f"<th scope=col class=text>{_HEAD[k]}</th>" for k in columns)
    body = "".join(
        f"<tr data-verdict='{texts[0]}'>{''.join(_render_cell(texts, k) for k in columns)}</tr>" for texts in cells
    )
    label = ", ".join(_HEAD[k] for k in columns[:3])
    table = f"<table><tr>{head}</tr>{body}</table>"
    yield make_section(
        "verdicts",
        "Verdicts",
        [
            *_render_fixes(data, rows),
            *_render_passed_but_critical(data, rows),
            f"<div class='wide' tabindex='0' role='region' aria-label='table: {label}'>{table}</div>",
        ],
    )


def _build_rows(data: ReportData) -> Iterator[_VerdictRow]:
    meta = data.summary.meta
    critical = {row.id for row, is_critical in zip(data.rows, data.is_critical, strict=True) if is_critical}
    for scenario, verdicts in data.verdicts.items():
        file, kind = (column[scenario - 1] if scenario <= len(column) else "" for column in (meta.files, meta.kinds))
        impact, approach = data.hardest_impacts.get(scenario), data.approaches.get(scenario)
        nearest, gap = ("", math.inf) if approach is None or impact is not None else (approach.describe(), approach.gap)
        for verdict in verdicts or (Verdict("inconclusive", "", "no requirement applies"),):
            margin = data.margins.get(scenario, {}).get(verdict.requirement)
            unit = Requirement.parse(verdict.requirement).expression.unit if margin is not None else ""
            # If there is a margin, it says how bad a failure is; else the impact speed does.
            hits = verdict.state == "failed" and margin is None and impact is not None
            yield _VerdictRow(
                scenario, verdict, file, kind, margin, unit, nearest, gap, scenario in critical,
                impact.speed if hits and impact is not None and math.isfinite(impact.speed) else None,
            )  # fmt: skip


def _render_fixes(data: ReportData, rows: Sequence[_VerdictRow]) -> Iterator[str]:
    """Yield up to six failed scenarios, the worst first, and the commands to replay them and to run the suite again."""
    failed = [row for row in rows if row.verdict.state == "failed"]
    scenarios = list(dict.fromkeys(row.scenario for row in failed))
    if not scenarios:
        return
    more = f", the worst {_MAX_LISTED} of {len(scenarios)} scenarios" if len(scenarios) > _MAX_LISTED else ""
    yield f"<h3>What to fix{more}</h3><ul class='fixes'>"
    study = shlex.quote(data.file_name)
    for scenario in scenarios[:_MAX_LISTED]:
        own = [row for row in failed if row.scenario == scenario]
        text = f"Scenario {scenario}{f' ({own[0].file})' if own[0].file else ''}: " + "; ".join(
            map(_describe_missed_requirement, own)
        )
        impact = data.hardest_impacts.get(scenario)
        if impact is not None and impact.fault is not None:
            text += f"; {impact.fault.describe(data.summary.meta.ego, impact.entity)}"
            text += f": {', '.join(impact.fault.reasons)}" if impact.fault.reasons else ""
        yield (
            f"<li>{link_scenarios(escape_control_characters(text))}. <code>cornercase replay {escape(study)} {scenario}"
            f" -o run-{scenario}.html</code></li>"
        )
    yield "</ul>"
    again = escape(escape_control_characters(format_repeat_command(data.summary.meta)))
    yield f"<p>After a mend, run all again: <code>{again}</code></p>"
    yield f"<p>What it changed: <code>cornercase compare {escape(study)} study.db</code></p>"


def _describe_missed_requirement(row: _VerdictRow) -> str:
    missed = row.margin_text or "failed"
    return f"“{row.verdict.requirement}” {missed}, as {row.verdict.reason}"


def _render_passed_but_critical(data: ReportData, rows: Sequence[_VerdictRow]) -> Iterator[str]:
    """Yield the scenarios that passed although they are critical, the most critical first."""
    states: dict[int, set[str]] = {}
    for row in rows:
        states.setdefault(row.scenario, set()).add(row.verdict.state)
    searched, critical = data.metrics[0], data.summary.estimates.critical
    if critical is None:
        return
    scores = {row.id: float(score) for row, score in zip(data.rows, data.scores[searched.name], strict=True)}
    passed = {row.scenario: row for row in rows if row.is_critical and states[row.scenario] == {"passed"}}
    condition = format_criterion_with_signs(critical.criterion, data.summary.objective)
    n_passed = sum(state == {"passed"} for state in states.values())
    if not n_passed:
        return
    if not passed:
        yield f"<p>None of the {n_passed} scenarios that passed is critical ({escape(condition)}).</p>"
        return
    more = f", the first {_MAX_LISTED}" if len(passed) > _MAX_LISTED else ""
    yield (
        f"<h3>Passed, but critical: {len(passed)} of {n_passed} that passed ({escape(condition)}){more}</h3>"
        "<ul class='narrow'>"
    )
    order = sorted(passed, key=lambda scenario: (float(searched.to_minimize(scores[scenario])), scenario))
    for scenario in order[:_MAX_LISTED]:
        row = passed[scenario]
        score = append_unit(f"{scores[scenario]:.3g}", searched.unit)
        facts = [f"{searched.name} {score}", *([f"nearest {row.nearest}"] if row.nearest else [])]
        facts += [f"{row.verdict.requirement} {row.margin_text}"] if row.margin_text else []
        text = f"Scenario {scenario}{f' ({row.file})' if row.file else ''}: {'; '.join(facts)}."
        yield f"<li>{link_scenarios(escape_control_characters(text))}</li>"
    yield "</ul>"


def _render_cell(texts: Sequence[str], column: int) -> str:
    """Render a cell of the table; the file name, or the scenario id if there is no name, links to the replay."""
    text = escape(escape_control_characters(texts[column]))
    if _HEAD[column] == ("file" if texts[1] else "scenario"):
        text = f"<a href='#id={texts[-1]}'>{text}</a>"
    label = f" data-label='{_HEAD[column]}'" if column > 1 else ""
    return f"<td class=text{label}>{text}</td>"
