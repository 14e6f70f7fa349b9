"""All data that a report shows."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.memory import MemoryLimit, report_memory_need
from cornercase._common.typing import BoolArray, Float32Array, FloatArray, IntArray
from cornercase.clustering import Analysis
from cornercase.metrics import Metric
from cornercase.metrics._outcome import Impact
from cornercase.recordings import Recording
from cornercase.reduction._coverage import CoverageCurves
from cornercase.reduction._reduced_set_manifest import read_coverage_curves
from cornercase.report._estimates import MissedFractionAfterRuns, estimate_missed_fractions
from cornercase.report._near_misses import ClosestApproach, find_closest_approach
from cornercase.report._road_drawing import add_road_margin
from cornercase.report._summary import Summary, entities_hit_by_ego, summarize_with_collisions
from cornercase.roads._outline import Region
from cornercase.scenario import Parameter
from cornercase.study import ScenarioRecord, StudyFile
from cornercase.study._scenario_digest import COURSE_POINTS, DigestPart
from cornercase.study._scenario_file import find_explored_scenario
from cornercase.suite import Verdict
from cornercase.suite._judge import judge_study, measure_margins

# Measured memory of one scenario until the page is written.
_BYTES_PER_SCENARIO: Final = 10_000


@dataclass(frozen=True, eq=False)
class ReportData:
    """All data that a report of a study shows; arrays have a row for each of the `n` scenarios that ran."""

    file_name: str  # name of the study's file
    summary: Summary
    rows: tuple[ScenarioRecord, ...]  # scenarios that ran
    failed: tuple[ScenarioRecord, ...]  # failed scenarios
    metrics: tuple[Metric, ...]
    scores: Mapping[str, FloatArray]  # by metric, shape (n,)
    reference_other: str  # most important other entity, for which outcomes are described
    score_sources: Mapping[
        str, Mapping[int, str | None]
    ]  # other entity that a score is measured against, by metric and id; empty if there is only one
    times: Mapping[int, FloatArray]  # instants of each recording by id, in s, shape (T,); only for figures
    time_spans: Mapping[int, tuple[float, float]]  # begin and end of each recording by id, in s
    course_lines: Mapping[str, Mapping[int, FloatArray]]  # resampled courses by metric and id, shape (COURSE_POINTS,)
    courses: Mapping[str, Mapping[int, Float32Array]]  # capped courses by metric and id, shape (T,); only for figures
    entities_hit: Mapping[int, frozenset[str]]  # entities that the ego collides with, by id
    impacts: Mapping[int, Sequence[Impact]]  # collisions of the ego, by id
    approaches: Mapping[int, ClosestApproach]  # closest approach of the ego to one of the others, by id
    examples: Mapping[int, Recording]  # recordings of the clusters' examples, by id
    values: FloatArray  # parameters, shape (n, d); indices for choices
    influential_parameters: tuple[
        int, ...
    ]  # indices of parameters, the most influential on the first metric first; the first two are sorted
    is_critical: BoolArray  # shape (n,); all False without a threshold
    coverage_curves: Mapping[str, CoverageCurves]  # by aspect; empty before the study was reduced
    verdicts: Mapping[int, Sequence[Verdict]]  # by id, one per requirement; empty without requirements
    margins: Mapping[int, Mapping[str, float]]  # by id and requirement, if it has a margin; negative if violated
    outcomes: Mapping[int, str]  # endings by id; empty before the study was analyzed
    notes: Mapping[int, str]  # user notes by id
    missed_fractions: tuple[MissedFractionAfterRuns, ...]  # empty if unknown
    fixed_parameters: Mapping[str, str]  # parameters of the scenario file that were not varied
    region: Region | None  # x_min, y_min, x_max, y_max around all motion, with a margin, in m

    @property
    def parameters(self) -> Sequence[Parameter]:
        """Parameters of the explored space."""
        return self.summary.meta.space.parameters

    @property
    def collides(self) -> BoolArray:
        """Mask, shape (n,), of the scenarios in which the ego collides with an entity that the metrics consider."""
        others = self.summary.meta.others
        return np.array([not self.entities_hit[row.id].isdisjoint(others) for row in self.rows], dtype=np.bool_)

    @cached_property
    def hardest_impacts(self) -> dict[int, Impact]:
        """Fastest collision of the ego with any entity in each scenario with a collision, by id."""
        return _find_hardest_impacts(self.impacts)

    @cached_property
    def hardest_measured_impacts(self) -> dict[int, Impact]:
        """Fastest collision of the ego with an entity that the metrics consider, by id of the scenario."""
        others = self.summary.meta.others
        return _find_hardest_impacts(
            {scenario: [hit for hit in hits if hit.entity in others] for scenario, hits in self.impacts.items()}
        )

    @property
    def hardest_first(self) -> list[tuple[int, Impact]]:
        """Items of `hardest_measured_impacts`, pairs of id and collision, the fastest collision first."""
        return sorted(self.hardest_measured_impacts.items(), key=lambda item: (-np.nan_to_num(item[1].speed), item[0]))

    def metric_for_aspect(self, aspect: str) -> Metric:
        """Return the metric with the same name as an aspect (what scenarios are compared by), else the first metric."""
        names = [metric.name for metric in self.metrics]
        return self.metrics[names.index(aspect) if aspect in names else 0]

    def row_indices(self, ids: Sequence[int]) -> IntArray:
        """Return the row indices of the scenarios with the given ids, shape (m,)."""
        index_by_id = {row.id: k for k, row in enumerate(self.rows)}
        return np.array([index_by_id[scenario] for scenario in ids], dtype=np.int64)


def read_report_data(
    study: StudyFile,
    *,
    charts: bool = True,
    figures: bool = False,
    memory: MemoryLimit | None = None,
    on_read: Callable[[int], None] | None = None,
) -> ReportData:
    """Read all data that the report of a study shows; InputError if the data exceed the memory limit.

    With `figures`, the courses (values of metrics over time) are read at full length, too. Without `charts`, only the
    data that sentences need are read: no courses, no recordings of examples, no coverage curves and no missed fractions
    during the search. `on_read` is called with the number of scenarios read so far.
    """
    rows = study.finished_rows()
    metrics = study.meta.create_metrics()
    scores = {metric.name: study.scores(metric.name) for metric in metrics}
    values = np.array([[parameter.extract_number(row.values) for parameter in study.space.parameters] for row in rows])
    times: dict[int, FloatArray] = {}
    shared_times: dict[bytes, FloatArray] = {}
    time_spans: dict[int, tuple[float, float]] = {}
    lines: dict[str, dict[int, FloatArray]] = {metric.name: {} for metric in metrics}
    courses: dict[str, dict[int, Float32Array]] = {metric.name: {} for metric in metrics}
    touched: dict[int, frozenset[str]] = {}
    impacts: dict[int, tuple[Impact, ...]] = {}
    approaches: dict[int, ClosestApproach] = {}
    region: Region | None = None
    parts: tuple[DigestPart, ...] = ("lines",) if charts else ()
    for count, (scenario, digest) in enumerate(study.iter_digests(parts)):
        if not count and memory is not None:
            _check_memory(memory, len(rows), len(metrics), digest.n_instants if figures else 0, on_read is not None)
        time_spans[scenario] = (digest.begin, digest.end)
        for metric, line in zip(metrics, digest.lines, strict=True) if charts else ():
            lines[metric.name][scenario] = line
        touched[scenario] = entities_hit_by_ego(study.meta, digest.collisions)
        impacts[scenario] = digest.outcomes[0].impacts
        if (approach := find_closest_approach(digest.features, study.meta.others, digest.begin)) is not None:
            approaches[scenario] = approach
        region = _union_region(region, digest.bounds)
        if on_read is not None:
            on_read(count + 1)
    # One recording at a time: all recordings of a large study would not fit into memory.
    for scenario, recording, score_courses in study.iter_recordings() if figures else ():
        # Most scenarios share the same instants.
        times[scenario] = shared_times.setdefault(recording.time.tobytes(), recording.time)
        for metric in metrics:
            courses[metric.name][scenario] = metric.clip_course(score_courses[metric.name]).astype(np.float32)
    verdicts = judge_study(study)
    summary = summarize_with_collisions(study, list(touched.values()), list(impacts.values()))
    return ReportData(
        file_name=study.path.name,
        summary=summary,
        rows=tuple(rows),
        failed=tuple(study.failed_rows()),
        metrics=metrics,
        scores=scores,
        reference_other=study.primary_other(),
        score_sources={name: study.score_sources(name) for name in scores if len(study.meta.others) > 1},
        times=times,
        time_spans=time_spans,
        course_lines=lines,
        courses=courses,
        entities_hit=touched,
        impacts=impacts,
        approaches=approaches,
        examples=_read_examples(study, summary.analyses) if charts else {},
        values=values,
        influential_parameters=order_parameters_by_influence(values, scores[metrics[0].name]),
        is_critical=study.critical_mask(),
        coverage_curves={}
        if summary.reduced_set is None or not charts
        else read_coverage_curves(study, summary.analyses, summary.reduced_set.ids),
        verdicts=verdicts,
        margins=measure_margins(study, verdicts),
        outcomes=study.outcomes(),
        notes=study.notes(),
        missed_fractions=tuple(estimate_missed_fractions(study, summary.estimates)) if charts else (),
        fixed_parameters=_read_fixed_parameters(study),
        region=add_road_margin(region),
    )


def _find_hardest_impacts(impacts: Mapping[int, Sequence[Impact]]) -> dict[int, Impact]:
    return {
        scenario: max(hits, key=lambda impact: np.nan_to_num(impact.speed))
        for scenario, hits in impacts.items()
        if hits
    }


def _read_fixed_parameters(study: StudyFile) -> dict[str, str]:
    """Read the parameters of the scenario file that were not varied; empty for suites, imports and missing files."""
    with suppress(InputError):
        scenario = None if study.meta.suite else find_explored_scenario(study, search_remembered_path=False)
        if scenario is not None:
            varied = {name for parameter in study.space.parameters for name in parameter.assigned_names}
            declared = scenario.root.iterfind("ParameterDeclarations/ParameterDeclaration")
            return {
                name: element.get("value", "")
                for element in declared
                if (name := element.get("name", "")) not in varied
            }
    return {}


def _check_memory(memory: MemoryLimit, scenarios: int, metrics: int, course_length: int, is_announced: bool) -> None:
    """Raise InputError if the data of a report do not fit into the memory limit."""
    need = scenarios * (_BYTES_PER_SCENARIO + metrics * (8 * COURSE_POINTS + 4 * course_length))
    instead = "give more, or leave out `figures`" if course_length else "give more"
    memory.check_fits(need, f"the contents of a report of {scenarios:,} scenarios", instead)
    if is_announced:
        report_memory_need(f"The contents of a report of {scenarios:,} scenarios", need)


def _union_region(first: Region | None, second: Region | None) -> Region | None:
    if first is None or second is None:
        return first or second
    return (min(first[0], second[0]), min(first[1], second[1]), max(first[2], second[2]), max(first[3], second[3]))


def _read_examples(study: StudyFile, analyses: Mapping[str, Analysis]) -> dict[int, Recording]:
    ids = {profile.example for analysis in analyses.values() for profile in analysis.profiles}
    other = study.primary_other()
    return {
        scenario: study.recording(scenario).with_absent_entities([other])
        for scenario in sorted(scenario for scenario in ids if scenario is not None)
    }


def order_parameters_by_influence(values: FloatArray, scores: FloatArray) -> tuple[int, ...]:
    """Return the indices of the parameters, ordered by influence on the score, the most influential first.

    The first two, which charts use as axes, are an exception: they come in the order of their columns in `values`.
    Influence is the fraction of the variance of the score that ten quantile bins of the parameter explain. Shapes:
    `values` (n, d), `scores` (n,).
    """
    shares = []
    for column in values.T:
        bins = np.searchsorted(np.quantile(column, np.linspace(0, 1, 11)[1:-1]), column)
        means = np.array([scores[bins == b].mean() for b in np.unique(bins)])
        counts = np.array([(bins == b).sum() for b in np.unique(bins)])
        shares.append(float((counts * (means - scores.mean()) ** 2).sum()))
    order = sorted(range(len(shares)), key=lambda j: (-shares[j], j))
    return (*sorted(order[:2]), *order[2:])
