"""What the kept scenarios of a study leave out, by each aspect that it was analysed by."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.clustering import Analysis, Distances, read_analyses, read_distances
from cornercase.evidence import CriticalSet
from cornercase.exploration import Objective
from cornercase.reduction.coverage import Coverage, Gaps, measure_coverage, measure_gaps, redrawn
from cornercase.reduction.critical_coverage import WITHIN, CriticalCoverage, distance_alike, judge_gaps
from cornercase.reduction.held_out import HeldOutGaps, Trial, judge, measure_held_out_gaps
from cornercase.reduction.reduced_set import ReducedSet
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
    distances : dict of str to ndarray of float64, shape (n, n), or PlacedDistances
        Both by aspect.
    """

    study: Study
    rows: dict[int, Row]
    scores: dict[str, dict[int, float]]
    analyses: dict[str, Analysis]
    distances: dict[str, Distances]

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
    return {
        name: measure_held_out_gaps(
            ran.distances[name],
            [Trial(*(one.rows_of(each) for each in (t.chosen_from, t.kept, t.judging))) for t in trials],
        )
        for name, one in ran.analyses.items()
    }


def find_gaps(ran: Ran, kept: Sequence[int]) -> dict[str, Gaps]:
    """Measure how far scenarios are from kept ones, and from other choices.

    Parameters
    ----------
    ran : Ran
        What was run and analysed.
    kept : sequence of int
        Ids.

    Returns
    -------
    dict of str to Gaps
        By aspect; without those that no kept scenario was analysed by.
    """
    rows = {name: one.rows_of(list(kept)) for name, one in ran.analyses.items()}
    return {name: measure_gaps(ran.distances[name], index) for name, index in rows.items() if len(index)}


def grade(
    ran: Ran, kept: Sequence[int], held_out: Mapping[str, HeldOutGaps | None], gaps: Mapping[str, Gaps] | None = None
) -> dict[str, Coverage]:
    """Measure how well kept scenarios represent others.

    Parameters
    ----------
    ran : Ran
        What was run and analysed.
    kept : sequence of int
        Ids.
    held_out : mapping of str to HeldOutGaps or None
        As `hold_out` gives it.
    gaps : mapping of str to Gaps, optional
        As `find_gaps` gives it.

    Returns
    -------
    dict of str to Coverage
        By aspect; without those that no kept scenario was analysed by.
    """
    found = {}
    for name, one in ran.analyses.items():
        index = one.rows_of(list(kept))
        if len(index):
            known = None if gaps is None else gaps[name]
            whole = measure_coverage(ran.distances[name], index, ids=one.ids, gaps=known)
            found[name] = replace(whole, held_out=judge(held_out[name]))
    return found


def grade_critical(
    ran: Ran,
    kept: Sequence[int],
    held_out: Mapping[str, HeldOutGaps | None],
    within: float,
    gaps: Mapping[str, Gaps] | None = None,
    alike: Mapping[str, float] | None = None,
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
    gaps : mapping of str to Gaps, optional
        As `find_gaps` gives it; the random choices are drawn by the seed of the study.
    alike : mapping of str to float, optional
        By aspect the distance up to which two scenarios are alike, where it is known already.

    Returns
    -------
    dict of str to CriticalCoverage
        By aspect; empty where no threshold says what is critical.
    """
    meta, space = ran.study.meta, ran.study.space
    objective = Objective.of_study(meta)
    if ran.study.critical is None or objective.pareto or not kept:
        return {}
    oriented = dict(zip(ran.rows, objective.oriented_of(ran.study).tolist(), strict=True))
    threshold = objective.flip(ran.study.critical)
    found: dict[str, CriticalCoverage] = {}
    known: dict[tuple[int, ...], CriticalSet] = {}
    for name, one in ran.analyses.items():
        ids, distances = tuple(one.ids.tolist()), ran.distances[name]
        index = one.rows_of(list(kept))
        if not len(index):
            continue
        points, scores = ran.points(one), np.array([oriented[i] for i in ids])
        # Aspects of the same scenarios have one critical set.
        if ids not in known:
            with suppress(ValueError):
                known[ids] = CriticalSet(space, points, scores, threshold, meta.seed)
        near = alike[name] if alike and name in alike else distance_alike(distances, one.labels, within)
        mine = measure_gaps(distances, index) if gaps is None else gaps[name]
        found[name] = judge_gaps(
            space,
            points,
            scores,
            threshold,
            redrawn(mine, distances, index, meta.seed),
            near,
            seed=meta.seed,
            critical_set=known.get(ids),
            held_out=held_out.get(name),
        )
    return found


def grade_anew(study: Study, reduced: ReducedSet) -> ReducedSet:
    """Grade a reduced set by what the study is asked to call critical, where it was chosen by another threshold.

    Parameters
    ----------
    study : Study
        That was reduced.
    reduced : ReducedSet

    Returns
    -------
    ReducedSet
        The same scenarios. Nothing is said of scenarios that were held out: they judged choices by the other threshold.
    """
    if reduced.threshold == study.critical or not reduced.kept:
        return reduced
    alike = {name: one.within for name, one in reduced.critical.items()}
    return replace(reduced, critical=grade_critical(read_ran(study), reduced.ids, {}, WITHIN, alike=alike))
