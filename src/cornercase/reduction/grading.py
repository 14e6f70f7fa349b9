"""Evaluation of the selected scenarios of a study, by each aspect of its analyses."""

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
    """All finished scenarios and analyses of a study; rows by id, scores by metric and id, the rest by aspect."""

    study: Study
    rows: dict[int, Row]
    scores: dict[str, dict[int, float]]
    analyses: dict[str, Analysis]
    distances: dict[str, Distances]

    def points(self, analysis: Analysis) -> FloatArray:
        """Return the parameters of the scenarios of an analysis in the unit cube, shape (n, d)."""
        return np.array([self.rows[i].point for i in analysis.ids.tolist()])


def read_ran(study: Study) -> Ran:
    """Load all finished scenarios and analyses of a study."""
    rows = {row.id: row for row in study.done()}
    scores = {name: dict(zip(rows, study.scores(name).tolist(), strict=True)) for name in study.meta.metrics}
    analyses = read_analyses(study)
    return Ran(study, rows, scores, analyses, {name: read_distances(study, name) for name in analyses})


def hold_out(ran: Ran, trials: Sequence[Trial]) -> dict[str, HeldOutGaps | None]:
    """Measure the distances of held-out scenarios to the sets of their folds, by aspect; folds are given by id."""
    return {
        name: measure_held_out_gaps(
            ran.distances[name],
            [Trial(*(analysis.rows_of(ids) for ids in (fold.chosen_from, fold.kept, fold.judging))) for fold in trials],
        )
        for name, analysis in ran.analyses.items()
    }


def find_gaps(ran: Ran, kept: Sequence[int]) -> dict[str, Gaps]:
    """Measure the distances to the selected ids and to baselines, by aspect.

    Aspects by which no selected scenario was analysed are left out.
    """
    rows = {name: analysis.rows_of(list(kept)) for name, analysis in ran.analyses.items()}
    return {name: measure_gaps(ran.distances[name], index) for name, index in rows.items() if len(index)}


def grade(
    ran: Ran, kept: Sequence[int], held_out: Mapping[str, HeldOutGaps | None], gaps: Mapping[str, Gaps] | None = None
) -> dict[str, Coverage]:
    """Measure how well the selected ids represent all scenarios, by aspect.

    `nearest_distances` saves computing them again. Aspects by which no selected scenario was analysed are left out.
    """
    coverage = {}
    for name, analysis in ran.analyses.items():
        index = analysis.rows_of(list(kept))
        if len(index):
            known_gaps = None if gaps is None else gaps[name]
            in_sample = measure_coverage(ran.distances[name], index, ids=analysis.ids, gaps=known_gaps)
            coverage[name] = replace(in_sample, held_out=judge(held_out[name]))
    return coverage


def grade_critical(
    ran: Ran,
    kept: Sequence[int],
    held_out: Mapping[str, HeldOutGaps | None],
    within: float,
    gaps: Mapping[str, Gaps] | None = None,
    alike: Mapping[str, float] | None = None,
) -> dict[str, CriticalCoverage]:
    """Measure how well the selected ids represent the critical scenarios, by aspect; empty without a threshold.

    `similarity` is the share of the median distance within clusters up to which two scenarios are similar, unless
    `similar_distances` has the distance itself. Random selections are redrawn with the seed of the study.
    """
    meta, space = ran.study.meta, ran.study.space
    objective = Objective.of_study(meta)
    if ran.study.critical is None or objective.pareto or not kept:
        return {}
    oriented = dict(zip(ran.rows, objective.oriented_of(ran.study).tolist(), strict=True))
    threshold = objective.flip(ran.study.critical)
    coverage: dict[str, CriticalCoverage] = {}
    critical_sets: dict[tuple[int, ...], CriticalSet] = {}
    for name, analysis in ran.analyses.items():
        ids, distances = tuple(analysis.ids.tolist()), ran.distances[name]
        index = analysis.rows_of(list(kept))
        if not len(index):
            continue
        points, scores = ran.points(analysis), np.array([oriented[i] for i in ids])
        # Aspects of the same scenarios share a critical set.
        if ids not in critical_sets:
            with suppress(ValueError):
                critical_sets[ids] = CriticalSet(space, points, scores, threshold, meta.seed)
        similar_distance = (
            alike[name] if alike and name in alike else distance_alike(distances, analysis.labels, within)
        )
        gaps_of_aspect = measure_gaps(distances, index) if gaps is None else gaps[name]
        coverage[name] = judge_gaps(
            space,
            points,
            scores,
            threshold,
            redrawn(gaps_of_aspect, distances, index, meta.seed),
            similar_distance,
            seed=meta.seed,
            critical_set=critical_sets.get(ids),
            held_out=held_out.get(name),
        )
    return coverage


def grade_anew(study: Study, reduced: ReducedSet) -> ReducedSet:
    """Reevaluate a reduced set with the threshold of the opened study, if it was selected with another one.

    Nothing is said about held-out scenarios: they evaluated selections with the other threshold.
    """
    if reduced.threshold == study.critical or not reduced.kept:
        return reduced
    similar_distances = {name: coverage.within for name, coverage in reduced.critical.items()}
    return replace(reduced, critical=grade_critical(read_ran(study), reduced.ids, {}, WITHIN, alike=similar_distances))
