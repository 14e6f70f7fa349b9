"""Assignment of new scenarios to the clusters of an analysis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering.analysis import Analysis, read_between, read_distances
from cornercase.clustering.comparing import instants_within, series_of, thinned
from cornercase.clustering.density import join_nearest
from cornercase.clustering.estimator import ScenarioClustering
from cornercase.clustering.landmarks import Comparing
from cornercase.dtw import distance_matrix
from cornercase.study import Study


def fit_again(analysis: Analysis, distances: FloatArray) -> ScenarioClustering:
    """Refit the clusters of an analysis, so that further scenarios can be assigned to them.

    `distances`, shape (m, m), are those of the scenarios that it was fitted on, or of the landmarks.
    """
    clustering = analysis.clustering
    dimensions = clustering.embedding.shape[1]
    return ScenarioClustering(
        clustering.gamma, clustering.eps, clustering.min_samples, dimensions, method=clustering.method
    ).fit(distances)


def join_kinds(study: Study, analysis: Analysis, other: Study, ids: Sequence[int]) -> IntArray:
    """Assign scenarios `ids` of another study to the clusters of an analysis; -1 is noise.

    Works as `ScenarioClustering.predict`. The other study has the same entities, and the same metric if the analysis is
    by one.
    """
    if not len(ids):
        return np.zeros(0, dtype=np.int64)
    uses_landmarks = analysis.inexact is not None
    reference_ids = analysis.ids[analysis.clustering.landmarks] if uses_landmarks else analysis.fitted
    references = reference_ids.tolist()
    series: list[FloatArray] = []
    times: list[FloatArray] = []
    for source, scenarios in ((study, references), (other, list(ids))):
        series += series_of(source, analysis.by, scenarios, study.main_other())
        times += [source.recording(scenario).time for scenario in scenarios]
    series, times = ([thinned(values, analysis.every) for values in columns] for columns in (series, times))
    window = instants_within(times, analysis.window)
    rows, count = analysis.rows_of(references), len(references)
    if uses_landmarks:
        comparing = Comparing(series, analysis.every, window)
        to_landmarks = comparing.to(np.arange(count), np.arange(count, len(series)))
        model = fit_again(analysis, read_between(study, analysis.by))
        reference_clustering = replace(model.result_, labels=analysis.labels[rows])
        return join_nearest(model.transform(to_landmarks), reference_clustering)
    # In single precision, as in `analyze`.
    distances = distance_matrix(series, window=window, dtype="float32").astype(np.float64)
    model = fit_again(analysis, read_distances(study, analysis.by)[np.ix_(rows, rows)])
    return model.predict(distances[count:, :count])
