"""Everything that a report shows of a study."""

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

# Bytes that the rows, instants and contents of a scenario take until the page is written, as measured.
_PER_SCENARIO: Final = 10_000


@dataclass(frozen=True, eq=False)
class ReportData:
    """Everything that a report shows of a study.

    Attributes
    ----------
    study : str
        Name of the study's file.
    summary : Summary
    rows, failed : tuple of Row
        The n scenarios that were run, and those that could not be run.
    metrics : tuple of Metric
    scores : mapping of str to ndarray of float64, shape (n,)
        By metric.
    other : str
        Of several others the one that kinds are told of.
    against : mapping of str to mapping of int to (str or None)
        By metric and id, whom of several others a score is against; empty where there is one.
    times : mapping of int to ndarray of float64, shape (T,)
        Instants of each recording by id, in s.
    lines : mapping of str to mapping of int to ndarray of float64, shape (COURSE_POINTS,)
        By metric and id, the capped courses as the page draws them.
    courses : mapping of str to mapping of int to ndarray of float32, shape (T,)
        Capped courses by metric and id; empty where no figures are drawn of them.
    touched : mapping of int to frozenset of str
        By id, whom the ego collides with.
    examples : mapping of int to Recording
        Of the examples of the kinds, by id.
    values : ndarray of float64, shape (n, d)
        Parameters; of choices their number.
    influential : tuple of int
        Parameters by their influence on the first metric: the two strongest in their own order, then the others.
    critical : ndarray of bool, shape (n,)
        Critical scenarios; none where no threshold says what is critical.
    gaps : mapping of str to Gaps
        By aspect, what the kept scenarios leave out; empty before the study was reduced.
    verdicts : mapping of int to sequence of Verdict
        By id of each scenario that ended, one for each requirement that is for it; empty where nothing is required.
    outcomes : mapping of int to str
        How scenarios ended, by id; empty before the study was analysed.
    notes : mapping of int to str
        What somebody noted of scenarios, by id.
    missed : tuple of MissedAfter
        How much of the critical set was not found after some of the scenarios; empty where nothing is known of it.
    region : tuple of float, or None
        Least x and y, and greatest x and y, in m, of a region around all that moves; None where nothing exists.
    """

    study: str
    summary: Summary
    rows: tuple[Row, ...]
    failed: tuple[Row, ...]
    metrics: tuple[Metric, ...]
    scores: Mapping[str, FloatArray]
    other: str
    against: Mapping[str, Mapping[int, str | None]]
    times: Mapping[int, FloatArray]
    lines: Mapping[str, Mapping[int, FloatArray]]
    courses: Mapping[str, Mapping[int, Float32Array]]
    touched: Mapping[int, frozenset[str]]
    examples: Mapping[int, Recording]
    values: FloatArray
    influential: tuple[int, ...]
    critical: BoolArray
    gaps: Mapping[str, Gaps]
    verdicts: Mapping[int, Sequence[Verdict]]
    outcomes: Mapping[int, str]
    notes: Mapping[int, str]
    missed: tuple[MissedAfter, ...]
    region: Region | None

    @property
    def parameters(self) -> Sequence[Parameter]:
        """Parameters of the space."""
        return self.summary.meta.space.parameters

    def metric_of(self, aspect: str) -> Metric:
        """Return the metric whose courses are shown for an aspect.

        Parameters
        ----------
        aspect : str
            What scenarios were compared by.

        Returns
        -------
        Metric
            That of the aspect, or the first one where it is none.
        """
        names = [metric.name for metric in self.metrics]
        return self.metrics[names.index(aspect) if aspect in names else 0]

    def rows_of(self, ids: Sequence[int]) -> IntArray:
        """Return the rows of scenarios that were run.

        Parameters
        ----------
        ids : sequence of int, length m
            Ids of the scenarios.

        Returns
        -------
        ndarray of int64, shape (m,)
            Rows, in the order of the ids.
        """
        place = {row.id: k for k, row in enumerate(self.rows)}
        return np.array([place[scenario] for scenario in ids], dtype=np.int64)


def read_report_data(
    study: Study,
    *,
    figures: bool = False,
    memory: MemoryLimit | None = None,
    tell: Callable[[int], None] | None = None,
) -> ReportData:
    """Read everything that a report shows.

    Parameters
    ----------
    study : Study
        In which a scenario was run.
    figures : bool, default False
        Read what the figures draw beyond that: whole courses.
    memory : MemoryLimit, optional
        What it may take; by default whatever it takes.
    tell : callable, optional
        Called with the number of recordings that have been read.

    Returns
    -------
    ReportData
        Everything at once.

    Raises
    ------
    InputError
        It does not fit into the memory.
    """
    rows = study.done()
    metrics = tuple(METRICS.create(name) for name in study.meta.metrics)
    scores = {metric.name: study.scores(metric.name) for metric in metrics}
    values = np.array([[one.read_number(row.values) for one in study.space.parameters] for row in rows])
    times: dict[int, FloatArray] = {}
    known: dict[bytes, FloatArray] = {}
    lines: dict[str, dict[int, FloatArray]] = {one.name: {} for one in metrics}
    courses: dict[str, dict[int, Float32Array]] = {one.name: {} for one in metrics}
    touched: dict[int, frozenset[str]] = {}
    region: Region | None = None
    # One recording after the other: all of a large study would not fit into memory.
    for count, (scenario, recording, each) in enumerate(study.recorded()):
        if not count and memory is not None:
            _require_room(memory, len(rows), len(metrics), len(recording.time) if figures else 0, tell is not None)
        # Most scenarios have the same instants.
        times[scenario] = known.setdefault(recording.time.tobytes(), recording.time)
        for one in metrics:
            course = one.capped(each[one.name]).astype(np.float32)
            lines[one.name][scenario] = draw_course(recording.time, course, one.lower_is_critical)
            if figures:
                courses[one.name][scenario] = course
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
    """Refuse more scenarios than fit, each with lines of its metrics and so many instants of whole courses."""
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
    ids = {profile.example for one in analyses.values() for profile in one.profiles}
    other = study.main_other()
    return {
        scenario: study.recording(scenario).with_absent([other])
        for scenario in sorted(one for one in ids if one is not None)
    }


def _influential(values: FloatArray, scores: FloatArray) -> tuple[int, ...]:
    """Parameters by the share of the score's variance that ten bins of each explain."""
    shares = []
    for column in values.T:
        bins = np.searchsorted(np.quantile(column, np.linspace(0, 1, 11)[1:-1]), column)
        means = np.array([scores[bins == b].mean() for b in np.unique(bins)])
        counts = np.array([(bins == b).sum() for b in np.unique(bins)])
        shares.append(float((counts * (means - scores.mean()) ** 2).sum()))
    order = sorted(range(len(shares)), key=lambda j: (-shares[j], j))
    return (*sorted(order[:2]), *order[2:])


def _gaps(study: Study, analyses: Mapping[str, Analysis], kept: list[int]) -> dict[str, Gaps]:
    found = {}
    for name, one in analyses.items():
        index = one.rows_of(kept)
        if len(index):
            found[name] = measure_gaps(read_distances(study, name), index)
    return found
