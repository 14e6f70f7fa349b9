"""Assignment of new scenarios to the clusters of an analysis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering._anchors import LandmarkDistanceEstimator
from cornercase.clustering._density import assign_to_nearest_cluster
from cornercase.clustering._landmarks import PairwiseComparer
from cornercase.clustering._scenario_clustering import ScenarioClustering
from cornercase.clustering._series import read_series, window_in_instants
from cornercase.clustering._stored_analysis import Analysis, read_distances, read_landmark_distances
from cornercase.dtw import distance_matrix
from cornercase.study import StudyFile
from cornercase.study._scenario_digest import downsample


def refit(analysis: Analysis, distances: FloatArray) -> ScenarioClustering:
    """Fit the clusters of an analysis again, so that further scenarios can be assigned to them.

    `distances`, shape (m, m), are the distances between the scenarios that the analysis was fitted on, or between its
    landmarks.
    """
    clustering = analysis.clustering
    dimensions = clustering.embedding.shape[1]
    return ScenarioClustering(
        clustering.gamma,
        clustering.eps,
        clustering.min_samples,
        dimensions,
        method=clustering.method,
        landmarks=len(clustering.landmarks) or None,
    ).fit(distances)


def assign_to_clusters(study: StudyFile, analysis: Analysis, other_study: StudyFile, ids: Sequence[int]) -> IntArray:
    """Return the cluster of each of the scenarios `ids` of another study, among the clusters of an analysis of `study`.

    As in `ScenarioClustering.predict`, a scenario joins the cluster of the nearest dense scenario (one with many
    neighbours). If no dense scenario is near enough, the scenario is noise, -1. The other study must have the same
    entities. If the analysis is by a metric, the other study must have this metric.
    """
    if not len(ids):
        return np.zeros(0, dtype=np.int64)
    uses_landmarks = analysis.embedding_error is not None
    reference_ids = analysis.ids[analysis.clustering.landmarks] if uses_landmarks else analysis.fitted_ids
    rows = analysis.rows_of(reference_ids.tolist())
    if uses_landmarks:
        landmark_distances = read_landmark_distances(study, analysis.by)
        completion = LandmarkDistanceEstimator(landmark_distances)
        reference_ids = reference_ids[completion.anchors]
    series: list[FloatArray] = []
    times: list[FloatArray] = []
    for source, scenarios in ((study, reference_ids.tolist()), (other_study, list(ids))):
        series += read_series(source, analysis.by, scenarios, study.primary_other())
        times += [source.recording(scenario).time for scenario in scenarios]
    series, times = ([downsample(values, analysis.stride) for values in columns] for columns in (series, times))
    window, count = window_in_instants(times, analysis.window), len(reference_ids)
    if uses_landmarks:
        comparing = PairwiseComparer(series, analysis.stride, window)
        to_anchors = comparing.distances_to(np.arange(count), np.arange(count, len(series)))
        model = refit(analysis, landmark_distances)
        reference_clustering = replace(model.result_, labels=analysis.labels[rows])
        return assign_to_nearest_cluster(
            model.transform(completion.estimate_to_all_landmarks(to_anchors)), reference_clustering
        )
    # In single precision, as in `analyze`.
    distances = distance_matrix(series, window=window, dtype="float32").astype(np.float64)
    model = refit(analysis, read_distances(study, analysis.by)[np.ix_(rows, rows)])
    return model.predict(distances[count:, :count])
