"""Scenarios of another study among the kinds that a study has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering.analysis import Analysis, read_between, read_distances
from cornercase.clustering.comparing import instants_within, make_aspect, require_same_channels, series_in
from cornercase.clustering.density import join_nearest
from cornercase.clustering.estimator import ScenarioClustering
from cornercase.clustering.landmarks import Comparing
from cornercase.clustering.thinning import thinned
from cornercase.dtw import distance_matrix
from cornercase.metrics import METRICS
from cornercase.study import Study


def fit_again(analysis: Analysis, distances: FloatArray) -> ScenarioClustering:
    """Find the clusters of an analysis again, so that others can join them.

    Parameters
    ----------
    analysis : Analysis
    distances : ndarray of float64, shape (m, m)
        Of the scenarios that they were found from, or of the landmarks.

    Returns
    -------
    ScenarioClustering
        Fitted.
    """
    known = analysis.clustering
    axes = known.embedding.shape[1]
    return ScenarioClustering(known.gamma, known.eps, known.min_samples, axes, method=known.method).fit(distances)


def join_kinds(study: Study, analysis: Analysis, other: Study, ids: Sequence[int]) -> IntArray:
    """Find which kinds of a study scenarios of another one belong to, as `ScenarioClustering.predict` does.

    Parameters
    ----------
    study : Study
        Analysed before.
    analysis : Analysis
        Of it.
    other : Study
        Of the same entities, and the same metric where the analysis is by one.
    ids : sequence of int, length n
        Scenarios of the other study that were run.

    Returns
    -------
    ndarray of int64, shape (n,)
        Clusters of the analysis; -1 is noise.

    Raises
    ------
    InputError
        The scenarios cannot be compared by the aspect, or have other time steps where a window is set.
    """
    if not len(ids):
        return np.zeros(0, dtype=np.int64)
    placed = analysis.inexact is not None
    known = analysis.ids[analysis.clustering.landmarks] if placed else analysis.fitted
    earlier = known.tolist()
    series, times = [], []
    for one, scenarios in ((study, earlier), (other, list(ids))):
        found, at = _read(one, analysis.by, scenarios, study.main_other())
        require_same_channels(one, analysis.by, scenarios, found)
        series += found
        times += at
    series, times = ([thinned(each, analysis.every) for each in every] for every in (series, times))
    within = instants_within(times, analysis.window)
    rows, count = analysis.rows_of(earlier), len(earlier)
    if placed:
        comparing = Comparing(series, analysis.every, within)
        to_landmarks = comparing.to(np.arange(count), np.arange(count, len(series)))
        model = fit_again(analysis, read_between(study, analysis.by))
        labelled = replace(model.result_, labels=analysis.labels[rows])
        return join_nearest(model.transform(to_landmarks), labelled)
    # As in `analyze`: to single precision.
    distances = distance_matrix(series, window=within, dtype="float32").astype(np.float64)
    model = fit_again(analysis, read_distances(study, analysis.by)[np.ix_(rows, rows)])
    return model.predict(distances[count:, :count])


def _read(study: Study, by: str, ids: Sequence[int], main: str) -> tuple[list[FloatArray], list[FloatArray]]:
    times = [study.recording(one).time for one in ids]
    if by in study.meta.metrics:
        metric = METRICS.create(by)
        return [metric.capped(study.course(one, by)) for one in ids], times
    aspect = make_aspect(by)
    return [series_in(study, one, study.recording(one), aspect, main) for one in ids], times
