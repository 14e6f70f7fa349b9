"""What the kept scenarios of a study leave out, by each aspect that it was analysed by."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from cornercase._common.threads import side_by_side
from cornercase._common.typing import FloatArray
from cornercase.clustering import Analysis, read_analyses, read_distances
from cornercase.evidence import CriticalSet
from cornercase.exploration import Objective
from cornercase.reduction.coverage import Coverage, measure_coverage
from cornercase.reduction.critical_coverage import CriticalCoverage, distance_alike, measure_critical_coverage
from cornercase.reduction.held_out import HeldOutGaps, Trial, judge, measure_held_out_gaps
from cornercase.study import Row, Study


@dataclass(frozen=True, eq=False)
class Ran:
    """Everything that was run and analysed in a study.

    Attributes
    ----------
    study : Study
    rows : dict of int to Row
        Scenarios that were run, by id.
    scores : dict of str to dict of int to float
        By metric and id.
    analyses : dict of str to Analysis
    distances : dict of str to ndarray of float64, shape (n, n)
        Both by aspect.
    """

    study: Study
    rows: dict[int, Row]
    scores: dict[str, dict[int, float]]
    analyses: dict[str, Analysis]
    distances: dict[str, FloatArray]

    def points(self, analysis: Analysis) -> FloatArray:
        """Return the parameters of analysed scenarios.

        Parameters
        ----------
        analysis : Analysis
            Says which scenarios, and their order.

        Returns
        -------
        ndarray of float64, shape (n, d)
            In the unit cube.
        """
        return np.array([self.rows[i].point for i in analysis.ids.tolist()])


def read_ran(study: Study) -> Ran:
    """Read everything that was run and analysed.

    Parameters
    ----------
    study : Study
        Analysed before.

    Returns
    -------
    Ran
        Everything at once.
    """
    rows = {row.id: row for row in study.done()}
    scores = {name: dict(zip(rows, study.scores(name).tolist(), strict=True)) for name in study.meta.metrics}
    analyses = read_analyses(study)
    return Ran(study, rows, scores, analyses, {name: read_distances(study, name) for name in analyses})


def hold_out(ran: Ran, trials: Sequence[Trial]) -> dict[str, HeldOutGaps | None]:
    """Measure how far scenarios are from sets that they did not choose.

    Parameters
    ----------
    ran : Ran
        What was run and analysed.
    trials : sequence of Trial
        By id.

    Returns
    -------
    dict of str to HeldOutGaps or None
        By aspect; by row of the analysis.
    """

    def measured(name: str) -> HeldOutGaps | None:
        rows_of = ran.analyses[name].rows_of
        return measure_held_out_gaps(
            ran.distances[name],
            [Trial(*(rows_of(each) for each in (one.chosen_from, one.kept, one.judging))) for one in trials],
        )

    return dict(zip(ran.analyses, side_by_side(measured, ran.analyses), strict=True))


def grade(ran: Ran, kept: Sequence[int], held_out: Mapping[str, HeldOutGaps | None]) -> dict[str, Coverage]:
    """Measure how well kept scenarios represent others.

    Parameters
    ----------
    ran : Ran
        What was run and analysed.
    kept : sequence of int
        Ids.
    held_out : mapping of str to HeldOutGaps or None
        As `hold_out` gives it.

    Returns
    -------
    dict of str to Coverage
        By aspect; without those that no kept scenario was analysed by.
    """
    found = {}
    for name, one in ran.analyses.items():
        index = one.rows_of(list(kept))
        if len(index):
            whole = measure_coverage(ran.distances[name], index, ids=one.ids)
            found[name] = replace(whole, held_out=judge(held_out[name]))
    return found


def grade_critical(
    ran: Ran, kept: Sequence[int], held_out: Mapping[str, HeldOutGaps | None], within: float
) -> dict[str, CriticalCoverage]:
    """Measure how well kept scenarios represent the critical ones.

    Parameters
    ----------
    ran : Ran
        What was run and analysed.
    kept : sequence of int
        Ids.
    held_out : mapping of str to HeldOutGaps or None
        As `hold_out` gives it.
    within : float
        Share of the median distance within clusters up to which two scenarios are alike.

    Returns
    -------
    dict of str to CriticalCoverage
        By aspect; empty where no threshold says what is critical.
    """
    meta, space = ran.study.meta, ran.study.space
    objective = Objective.of_study(meta)
    if meta.critical is None or objective.pareto or not kept:
        return {}
    oriented = dict(zip(ran.rows, objective.oriented_of(ran.study).tolist(), strict=True))
    threshold = objective.flip(meta.critical)
    known: dict[tuple[int, ...], CriticalSet] = {}
    shown = [name for name, one in ran.analyses.items() if len(one.rows_of(list(kept)))]
    for name in shown:
        one = ran.analyses[name]
        ids = tuple(one.ids.tolist())
        # Aspects of the same scenarios have one critical set.
        if ids not in known:
            with suppress(ValueError):
                known[ids] = CriticalSet(space, ran.points(one), _scores(one, oriented), threshold, meta.seed)

    def graded(name: str) -> CriticalCoverage:
        one, distances = ran.analyses[name], ran.distances[name]
        return measure_critical_coverage(
            space,
            ran.points(one),
            _scores(one, oriented),
            threshold,
            distances,
            one.rows_of(list(kept)),
            distance_alike(distances, one.labels, within),
            seed=meta.seed,
            critical_set=known.get(tuple(one.ids.tolist())),
            held_out=held_out[name],
        )

    return dict(zip(shown, side_by_side(graded, shown), strict=True))


def _scores(analysis: Analysis, oriented: Mapping[int, float]) -> FloatArray:
    return np.array([oriented[i] for i in analysis.ids.tolist()])
