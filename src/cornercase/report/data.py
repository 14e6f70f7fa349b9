"""All data that a report shows."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cornercase._common.memory import MemoryLimit, state_need
from cornercase._common.typing import BoolArray, Float32Array, FloatArray, IntArray
from cornercase.clustering import Analysis, read_distances
from cornercase.exploration import Objective
from cornercase.metrics import METRICS, Metric
from cornercase.recordings import Recording
from cornercase.reduction import Gaps, measure_gaps
from cornercase.report.course_lines import COURSE_POINTS, draw_course
from cornercase.report.knowledge import MissedAfter, find_missed
from cornercase.report.roads import recorded_region
from cornercase.report.summary import Summary, summarize_with, touched_by_ego
from cornercase.roads import Region
from cornercase.scenario import Parameter
from cornercase.study import Row, Study
from cornercase.suite import Verdict, verdicts_of

# Measured memory of one scenario until the page is written.
_PER_SCENARIO: Final = 10_000


@dataclass(frozen=True, eq=False)
class ReportData:
    """All data that a report of a study shows; `n` scenarios were run."""

    study: str  # name of the study's file
    summary: Summary
    rows: tuple[Row, ...]  # run scenarios
    failed: tuple[Row, ...]  # failed scenarios
    metrics: tuple[Metric, ...]
    scores: Mapping[str, FloatArray]  # by metric, shape (n,)
    other: str  # the other whose clusters are described
    against: Mapping[str, Mapping[int, str | None]]  # other a score belongs to, by metric and id; empty with one other
    times: Mapping[int, FloatArray]  # instants of each recording by id, in s, shape (T,)
    lines: Mapping[str, Mapping[int, FloatArray]]  # resampled courses by metric and id, shape (COURSE_POINTS,)
    courses: Mapping[str, Mapping[int, Float32Array]]  # capped courses by metric and id, shape (T,); only for figures
    touched: Mapping[int, frozenset[str]]  # entities the ego collides with, by id
    examples: Mapping[int, Recording]  # recordings of the clusters' examples, by id
    values: FloatArray  # parameters, shape (n, d); indices for choices
    influential: tuple[int, ...]  # parameters by influence on the first metric; the first two in their own order
    critical: BoolArray  # shape (n,); all False without a threshold
    gaps: Mapping[str, Gaps]  # by aspect; empty before the study was reduced
    verdicts: Mapping[int, Sequence[Verdict]]  # by id, one per requirement; empty without requirements
    outcomes: Mapping[int, str]  # endings by id; empty before the study was analyzed
    notes: Mapping[int, str]  # user notes by id
    missed: tuple[MissedAfter, ...]  # empty if unknown
    region: Region | None  # x_min, y_min, x_max, y_max around all motion, in m

    @property
    def parameters(self) -> Sequence[Parameter]:
        """Parameters of the space."""
        return self.summary.meta.space.parameters

    def metric_of(self, aspect: str) -> Metric:
        """Return the metric of an aspect, or the first metric if the aspect is none."""
        names = [metric.name for metric in self.metrics]
        return self.metrics[names.index(aspect) if aspect in names else 0]

    def rows_of(self, ids: Sequence[int]) -> IntArray:
        """Return the row indices of scenarios by id, shape (m,)."""
        index_by_id = {row.id: k for k, row in enumerate(self.rows)}
        return np.array([index_by_id[scenario] for scenario in ids], dtype=np.int64)


def read_report_data(
    study: Study, *, figures: bool = False, memory: MemoryLimit | None = None, tell: Callable[[int], None] | None = None
) -> ReportData:
    """Read all data of a report in one pass over the recordings; InputError if it exceeds the memory limit.

    `figures` also keeps whole courses; `on_read` is called with the number of recordings read so far.
    """
    rows = study.done()
    metrics = tuple(METRICS.create(name) for name in study.meta.metrics)
    scores = {metric.name: study.scores(metric.name) for metric in metrics}
    values = np.array([[parameter.read_number(row.values) for parameter in study.space.parameters] for row in rows])
    times: dict[int, FloatArray] = {}
    shared_times: dict[bytes, FloatArray] = {}
    lines: dict[str, dict[int, FloatArray]] = {metric.name: {} for metric in metrics}
    courses: dict[str, dict[int, Float32Array]] = {metric.name: {} for metric in metrics}
    touched: dict[int, frozenset[str]] = {}
    region: Region | None = None
    # One recording at a time: those of a large study would not fit into memory.
    for count, (scenario, recording, score_courses) in enumerate(study.recorded()):
        if not count and memory is not None:
            _require_room(memory, len(rows), len(metrics), len(recording.time) if figures else 0, tell is not None)
        # Most scenarios share the same instants.
        times[scenario] = shared_times.setdefault(recording.time.tobytes(), recording.time)
        for metric in metrics:
            course = metric.capped(score_courses[metric.name]).astype(np.float32)
            lines[metric.name][scenario] = draw_course(recording.time, course, metric.lower_is_critical)
            if figures:
                courses[metric.name][scenario] = course
        touched[scenario] = touched_by_ego(study.meta, recording.collisions)
        region = _joined(region, recorded_region([recording]))
        if tell is not None:
            tell(count + 1)
    summary = summarize_with(study, list(touched.values()))
    return ReportData(
        study=study.path.name,
        summary=summary,
        rows=tuple(rows),
        failed=tuple(study.failed()),
        metrics=metrics,
        scores=scores,
        other=study.main_other(),
        against={name: study.against(name) for name in scores if len(study.meta.others) > 1},
        times=times,
        lines=lines,
        courses=courses,
        touched=touched,
        examples=_examples(study, summary.analyses),
        values=values,
        influential=_influential(values, scores[metrics[0].name]),
        critical=Objective.of_study(study.meta).critical_of(study),
        gaps={} if summary.reduced is None else _gaps(study, summary.analyses, summary.reduced.ids),
        verdicts=verdicts_of(study),
        outcomes=study.outcomes(),
        notes=study.notes(),
        missed=tuple(find_missed(study, summary.knowledge)),
        region=region,
    )


def _require_room(memory: MemoryLimit, scenarios: int, metrics: int, instants: int, tells: bool) -> None:
    """Raise if the contents do not fit into the memory limit."""
    need = scenarios * (_PER_SCENARIO + metrics * (8 * COURSE_POINTS + 4 * instants))
    instead = "give more, or leave out `figures`" if instants else "give more"
    memory.require(need, f"the contents of a report of {scenarios:,} scenarios", instead)
    if tells:
        state_need(f"The contents of a report of {scenarios:,} scenarios", need)


def _joined(one: Region | None, two: Region | None) -> Region | None:
    if one is None or two is None:
        return one or two
    return (min(one[0], two[0]), min(one[1], two[1]), max(one[2], two[2]), max(one[3], two[3]))


def _examples(study: Study, analyses: Mapping[str, Analysis]) -> dict[int, Recording]:
    ids = {profile.example for analysis in analyses.values() for profile in analysis.profiles}
    other = study.main_other()
    return {
        scenario: study.recording(scenario).with_absent([other])
        for scenario in sorted(scenario for scenario in ids if scenario is not None)
    }


def _influential(values: FloatArray, scores: FloatArray) -> tuple[int, ...]:
    """Order parameters by the share of the score's variance that ten quantile bins of each explain."""
    shares = []
    for column in values.T:
        bins = np.searchsorted(np.quantile(column, np.linspace(0, 1, 11)[1:-1]), column)
        means = np.array([scores[bins == b].mean() for b in np.unique(bins)])
        counts = np.array([(bins == b).sum() for b in np.unique(bins)])
        shares.append(float((counts * (means - scores.mean()) ** 2).sum()))
    order = sorted(range(len(shares)), key=lambda j: (-shares[j], j))
    return (*sorted(order[:2]), *order[2:])


def _gaps(study: Study, analyses: Mapping[str, Analysis], kept: list[int]) -> dict[str, Gaps]:
    gaps = {}
    for name, analysis in analyses.items():
        index = analysis.rows_of(kept)
        if len(index):
            gaps[name] = measure_gaps(read_distances(study, name), index)
    return gaps
