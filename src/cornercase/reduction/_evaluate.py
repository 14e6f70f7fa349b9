"""Evaluation of the selected scenarios of a study, by each aspect (what scenarios are compared by)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.clustering import Analysis, read_analyses, read_distances
from cornercase.clustering._embedding import Distances
from cornercase.evidence._critical_set_estimate import CriticalSet
from cornercase.reduction._coverage import (
    Coverage,
    NearestDistances,
    measure_coverage,
    measure_distances_to_random,
    measure_nearest_distances,
)
from cornercase.reduction._critical_coverage import (
    DEFAULT_SIMILARITY,
    CriticalCoverage,
    max_similar_distance,
    measure_critical_coverage,
)
from cornercase.reduction._held_out_coverage import (
    Fold,
    HeldOutDistances,
    measure_held_out_distances,
    summarize_held_out,
)
from cornercase.reduction._reduced_set import ReducedSet
from cornercase.study import ScenarioRecord, StudyFile


@dataclass(frozen=True, eq=False)
class StudyData:
    """Finished scenarios and analyses of a study.

    `rows` maps scenario ids to scenarios, and `scores` maps metrics to scores by scenario id. `analyses` and
    `distances` map each aspect (what scenarios are compared by) to its clustering and its distances.
    """

    study: StudyFile
    rows: dict[int, ScenarioRecord]
    scores: dict[str, dict[int, float]]
    analyses: dict[str, Analysis]
    distances: dict[str, Distances]

    def parameter_points(self, analysis: Analysis) -> FloatArray:
        """Return the parameters of the scenarios of an analysis as points in the unit cube, shape (n, d)."""
        return np.array([self.rows[i].point for i in analysis.ids.tolist()])


def load_study_data(study: StudyFile) -> StudyData:
    """Load all finished scenarios and analyses of a study."""
    rows = {row.id: row for row in study.finished_rows()}
    scores = {name: dict(zip(rows, study.scores(name).tolist(), strict=True)) for name in study.meta.metrics}
    analyses = read_analyses(study)
    return StudyData(study, rows, scores, analyses, {name: read_distances(study, name) for name in analyses})


def measure_held_out_by_aspect(data: StudyData, folds: Sequence[Fold]) -> dict[str, HeldOutDistances | None]:
    """Measure, for each aspect, the distances of held-out scenarios to the set selected without them.

    `folds` are the folds of a cross-validation, with scenarios given by id.
    """
    return {
        name: measure_held_out_distances(
            data.distances[name],
            [Fold(*(analysis.rows_of(ids) for ids in (fold.training, fold.selected, fold.held_out))) for fold in folds],
        )
        for name, analysis in data.analyses.items()
    }


def measure_nearest_distances_by_aspect(data: StudyData, selected: Sequence[int]) -> dict[str, NearestDistances]:
    """Measure, for each aspect, the distances from all scenarios to the selected ones (by id) and to baselines.

    An aspect (what scenarios are compared by) is left out if no selected scenario was analysed by it.
    """
    rows = {name: analysis.rows_of(list(selected)) for name, analysis in data.analyses.items()}
    return {name: measure_nearest_distances(data.distances[name], index) for name, index in rows.items() if len(index)}


def evaluate_coverage(
    data: StudyData,
    selected: Sequence[int],
    held_out: Mapping[str, HeldOutDistances | None],
    nearest_distances: Mapping[str, NearestDistances] | None = None,
) -> dict[str, Coverage]:
    """Measure, for each aspect, how well the selected scenarios represent all scenarios.

    `selected` are ids. `held_out` comes from `measure_held_out_by_aspect`. If the caller has computed the distances to
    the selected scenarios already, they are given as `nearest_distances`. An aspect (what scenarios are compared by) is
    left out if no selected scenario was analysed by it.
    """
    coverage = {}
    for name, analysis in data.analyses.items():
        index = analysis.rows_of(list(selected))
        if len(index):
            known_gaps = None if nearest_distances is None else nearest_distances[name]
            in_sample = measure_coverage(data.distances[name], index, ids=analysis.ids, nearest_distances=known_gaps)
            coverage[name] = replace(in_sample, held_out=summarize_held_out(held_out[name]))
    return coverage


def evaluate_critical_coverage(
    data: StudyData,
    selected: Sequence[int],
    held_out: Mapping[str, HeldOutDistances | None],
    similarity: float,
    nearest_distances: Mapping[str, NearestDistances] | None = None,
    similar_distances: Mapping[str, float] | None = None,
) -> dict[str, CriticalCoverage]:
    """Measure, for each aspect, how well the selected scenarios represent the critical scenarios.

    `selected` are ids. The result is empty if the study has no threshold. Two scenarios are similar if their distance
    is at most the value for the aspect in `similar_distances`, by default `similarity` times the median distance within
    clusters. The random selections that serve as a baseline are drawn with the seed of the study.
    """
    meta, space = data.study.meta, data.study.space
    objective = data.study.objective
    if (criterion := objective.criterion) is None or not selected:
        return {}
    oriented = dict(zip(data.rows, objective.minimized_scores(data.study).tolist(), strict=True))
    coverage: dict[str, CriticalCoverage] = {}
    critical_sets: dict[tuple[int, ...], CriticalSet] = {}
    for name, analysis in data.analyses.items():
        ids, distances = tuple(analysis.ids.tolist()), data.distances[name]
        index = analysis.rows_of(list(selected))
        if not len(index):
            continue
        points, scores = data.parameter_points(analysis), np.array([oriented[i] for i in ids])
        # Aspects of the same scenarios share a critical set.
        if ids not in critical_sets:
            with suppress(ValueError):
                critical_sets[ids] = CriticalSet(space, points, scores, criterion, meta.seed)
        similar_distance = (
            similar_distances[name]
            if similar_distances and name in similar_distances
            else max_similar_distance(distances, analysis.labels, similarity)
        )
        gaps_of_aspect = (
            measure_nearest_distances(distances, index) if nearest_distances is None else nearest_distances[name]
        )
        coverage[name] = measure_critical_coverage(
            space,
            points,
            scores,
            criterion,
            gaps_of_aspect,
            similar_distance,
            seed=meta.seed,
            critical_set=critical_sets.get(ids),
            held_out=held_out.get(name),
            # With seed 0 these are the random selections of the coverage.
            random_distances=measure_distances_to_random(
                distances, index, np.flatnonzero(criterion.is_critical(scores)), seed=meta.seed
            )
            if meta.seed
            else None,
        )
    return coverage


def evaluate_with_study_threshold(study: StudyFile, reduced: ReducedSet) -> ReducedSet:
    """Evaluate a reduced set again if it was selected with another threshold than the opened study has.

    The new evaluation has no values for held-out scenarios, since these would need new selections.
    """
    if reduced.threshold == study.critical or not reduced.scenarios:
        return reduced
    similar_distances = {name: coverage.within for name, coverage in reduced.critical.items()}
    return replace(
        reduced,
        critical=evaluate_critical_coverage(
            load_study_data(study), reduced.ids, {}, DEFAULT_SIMILARITY, similar_distances=similar_distances
        ),
    )
