"""Function `analyze`, which clusters the scenarios of a study."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.memory import DEFAULT_MEMORY, MemoryLimit
from cornercase._common.process.dask import open_connection
from cornercase._common.progress import ProgressBar, show_bars
from cornercase._common.typing import FloatArray, IntArray
from cornercase._common.unknown_names import suggest_arguments
from cornercase._common.validation import check_str_sequence
from cornercase.clustering._agreement import collect_facts, mutual_information_with_facts
from cornercase.clustering._assign import refit
from cornercase.clustering._clustering import Clustering, ClusteringMethod
from cornercase.clustering._embedding import Distances, EmbeddedDistances
from cornercase.clustering._landmarks import MAX_ALL_PAIRS, PairwiseComparer, assign_by_landmarks, cluster_by_landmarks
from cornercase.clustering._scenario_clustering import ScenarioClustering
from cornercase.clustering._series import (
    compute_aspect_series,
    create_aspect,
    default_aspects,
    distance_unit,
    require_known_aspect,
    require_same_channels,
    series_from_digest,
    window_in_instants,
)
from cornercase.clustering._stored_analysis import (
    Analysis,
    analysis_to_storage,
    read_analysis,
    read_distances,
    read_landmark_distances,
)
from cornercase.clustering.naming._predicates import NamingFacts
from cornercase.clustering.naming._profiles import profile_clusters
from cornercase.metrics._outcome import Outcome
from cornercase.study import StudyFile
from cornercase.study._scenario_digest import downsample, downsampling_stride
from cornercase.study._study_file import open_study

if TYPE_CHECKING:
    from distributed import Client

# Recordings from which the length and memory of all are estimated.
_SAMPLED_RECORDINGS: Final = 100
# Estimated bytes: per pair of scenarios for the matrix and everything derived from it, per pair for each further aspect
# that waits to be stored, and per scenario in addition to its series.
_BYTES_PER_PAIR: Final = 80
_BYTES_PER_WAITING_PAIR: Final = 20
_BYTES_PER_SCENARIO: Final = 8_000


@suggest_arguments
def analyze(
    study: StudyFile | Path | str,
    by: str | Sequence[str] | None = None,
    *,
    gamma: float | Literal["auto"] = "auto",
    eps: float | Literal["auto"] = "auto",
    min_samples: int | Literal["auto"] = "auto",
    method: ClusteringMethod | None = None,
    window: float | None = None,
    keep_clusters: bool = False,
    critical: float | None = None,
    workers: int = 1,
    cluster: str | Client | None = None,
    memory: str | float = DEFAULT_MEMORY,
    progress: bool = False,
) -> dict[str, Analysis]:
    """Cluster the scenarios of a study by behaviour and by criticality, and store the result in it.

    Scenarios are compared by several aspects, such as the trajectory of the ego. For each aspect, the distance of two
    scenarios is the Dynamic Time Warping distance of their time series, and `ScenarioClustering` finds the clusters.

    Comparing all pairs of more than 2,000 scenarios would take too long. Then only 500 random scenarios, the landmarks,
    are compared with each other and clustered. Each other scenario is compared with 100 landmarks, and joins a cluster
    of the landmarks. The distances of all other pairs are estimated by landmark multidimensional scaling;
    `Analysis.embedding_error` is the error of these estimates. Also, all series are downsampled so that a series of
    median length has at most 101 instants.

    Parameters
    ----------
    study : Study, StudyFile or path
        Study that is open for writing, or its file.
    by : str or sequence of str, optional
        Aspects: any of `cornercase.clustering.ASPECTS`, and metrics of the study. By default the ego's trajectory,
        the direction from the ego to the other entity (``"bearing"``), the interaction of both, and all metrics.
    gamma, eps : float or "auto", default "auto"
        Factor of the Gaussian kernel (the larger, the narrower the kernel), and radius of DBSCAN's neighbourhood. Both
        are without unit; `ScenarioClustering` defines them.
    min_samples : int or "auto", default "auto"
        Smallest number of scenarios in a dense neighbourhood.
    method : {"dbscan", "hdbscan"}, optional
        Algorithm that finds the clusters; by default DBSCAN.
    window : float, optional
        Largest difference in time, in s, of two instants that are matched. If one recording is longer than the other,
        the difference of their lengths is added. By default any difference is allowed, as in the paper; then waiting
        adds nothing to a distance.
    keep_clusters : bool, default False
        Keep the existing clusters of the study, and assign scenarios that were run later to these clusters as
        `ScenarioClustering.predict` does.
    critical : float, optional
        Threshold of the score that makes scenarios critical. The result says how well the clusters agree with being
        critical. By default the threshold of the study; the study keeps its own threshold in any case.
    workers : int, default 1
        Number of processes of a local Dask cluster.
    cluster : str or distributed.Client, optional
        Dask cluster that computes the distances: ``"local"`` for `workers` local processes, the address of a scheduler,
        the file that a scheduler wrote, or a client, which stays open. The result is the same to the bit.
    memory : str or float, default "4 GB"
        Memory limit of the process, in bytes, or as a text such as ``"4 GB"``. More scenarios than fit are refused.
    progress : bool, default False
        Show a progress bar.

    Returns
    -------
    dict of str to Analysis
        Analysis by aspect.

    Raises
    ------
    InputError
        Fewer than two scenarios were run, the study cannot be compared by an aspect, a setting is out of range or
        given for clusters that are kept, or the series do not fit in the memory.

    See Also
    --------
    ScenarioClustering : The clustering of any distances.
    cornercase.reduce : Selects a few scenarios of each cluster.

    References
    ----------
    B. Schütt, S. Otten, E. Sax, "Clustering-based criticality analysis for testing of automated driving systems",
    2023, section "Scenario Clustering".

    Examples
    --------
    >>> import cornercase as cc
    >>> analyses = cc.analyze("study.db", ["interaction", "wttc"])  # doctest: +SKIP
    >>> analyses["interaction"].labels  # doctest: +SKIP
    """
    model = ScenarioClustering(gamma, eps, min_samples, method="dbscan" if method is None else method)
    model.check_settings()
    limit = MemoryLimit.from_value(memory)
    requested = None if by is None else tuple(dict.fromkeys(check_str_sequence("by", by)))
    with open_study(study, critical=critical) as opened:
        aspects = default_aspects(opened) if requested is None else requested
        for aspect in aspects:
            require_known_aspect(opened, aspect)
        existing = set(aspects) & set(opened.analyzed_aspects())
        if (
            keep_clusters
            and existing
            and ({gamma, eps, min_samples} != {"auto"} or method is not None or window is not None)
        ):
            raise InputError(
                "`keep_clusters`: the settings of kept clusters cannot change;"
                " leave out `gamma`, `eps`, `min_samples`, `method` and `window`."
            )
        with show_bars(progress), open_connection(cluster, workers, workers_need_cluster=True) as client:
            return _analyze_by_aspects(opened, aspects, model, window, keep_clusters, limit, client, progress)


@dataclass(frozen=True, eq=False)
class _AnalysisInputs:
    """Time series and other inputs of all scenarios that were run.

    Stored digests (downsampled recordings) contain most inputs; the other inputs are read from the recordings.
    """

    outcomes: list[Outcome]
    naming_facts: NamingFacts
    times: list[FloatArray]
    """Times of each recording in s; empty without a window."""
    series: dict[str, list[FloatArray]]
    """Downsampled time series of each scenario, by aspect."""


def _analyze_by_aspects(
    study: StudyFile,
    aspects: Sequence[str],
    model: ScenarioClustering,
    window: float | None,
    keep_clusters: bool,
    memory_limit: MemoryLimit,
    client: Client | None,
    progress: bool,
) -> dict[str, Analysis]:
    ids = np.array([row.id for row in study.finished_rows()], dtype=np.int64)
    if len(ids) < 2:
        ran, failed = "1 scenario was" if len(ids) else "no scenario was", study.failed_rows()
        failures = f", {len(failed)} failed, the first one with: {failed[0].error}" if failed else ""
        raise InputError(f"{study.path}: {ran} run{failures}; clustering needs at least 2.")
    start = time.monotonic()
    previous = {
        aspect: read_analysis(study, aspect)
        for aspect in aspects
        if keep_clusters and aspect in study.analyzed_aspects()
    }
    stride = _choose_stride(study, ids)
    strides = {aspect: previous[aspect].stride if aspect in previous else stride for aspect in aspects}
    bar = ProgressBar(len(ids), "reading", "scenarios") if progress and len(ids) > MAX_ALL_PAIRS else None
    try:
        has_window = window is not None or any(analysis.window is not None for analysis in previous.values())
        inputs = _read_inputs(study, ids, strides, memory_limit, bar, with_times=has_window)
    finally:
        if bar:
            bar.stop()
    window_in_instants(inputs.times, window)
    facts = collect_facts(study, inputs.outcomes)
    spent = {"read": time.monotonic() - start, "compare": 0.0, "cluster": 0.0}
    results, to_store = {}, {}
    for name in aspects:
        start = time.monotonic()
        existing = previous.pop(name, None)
        dtw_window = window if existing is None else existing.window
        series = inputs.series.pop(name)
        window_instants = window_in_instants([downsample(times, strides[name]) for times in inputs.times], dtw_window)
        comparing = PairwiseComparer(series, strides[name], window_instants, client, name if progress else None)
        clustering, fitted, stored_distances, distances, embedding_error = _cluster_by_aspect(
            study, ids, comparing, model, name, existing
        )
        profiles = profile_clusters(study, clustering.labels, inputs.naming_facts, distances)
        agreements = mutual_information_with_facts(clustering.labels, facts)
        unit = distance_unit(study, name)
        results[name] = Analysis(
            name, unit, dtw_window, ids, clustering, fitted, profiles, agreements, strides[name], embedding_error
        )
        to_store[name] = analysis_to_storage(study, results[name], stored_distances, distances)
        spent["compare"] += comparing.seconds
        spent["cluster"] += time.monotonic() - start - comparing.seconds
    outcomes = {i: outcome.text for i, outcome in zip(ids.tolist(), inputs.outcomes, strict=True)}
    study.writer.save_analyses(to_store, outcomes)
    study.writer.add_elapsed_times(spent)
    return results


def _choose_stride(study: StudyFile, ids: IntArray) -> int:
    """Choose the stride for downsampling the series from the lengths of some recordings.

    The stride is 1 if there are few enough scenarios to compare all pairs.
    """
    if len(ids) <= MAX_ALL_PAIRS:
        return 1
    sample = ids[np.linspace(0, len(ids) - 1, _SAMPLED_RECORDINGS).astype(np.int64)]
    return downsampling_stride([study.digest(scenario).n_instants for scenario in sample.tolist()])


def _read_inputs(
    study: StudyFile,
    ids: IntArray,
    strides: dict[str, int],
    memory_limit: MemoryLimit,
    bar: ProgressBar | None,
    *,
    with_times: bool,
    n_sampled: int = _SAMPLED_RECORDINGS,
) -> _AnalysisInputs:
    """Read the inputs of all scenarios; after `n_sampled` of them, refuse what will not fit in memory."""
    outcomes, traits, times = [], [], []
    main = study.primary_other()
    main_index = study.meta.others.index(main)
    metrics = {name: study.meta.create_metric(name) for name in strides if name in study.meta.metrics}
    aspects = {name: create_aspect(name) for name in strides if name not in metrics}
    series_by_aspect: dict[str, list[FloatArray]] = {name: [] for name in strides}
    for count, (i, digest) in enumerate(study.iter_digests(("series", "courses")), 1):
        outcomes.append(digest.outcomes[main_index])
        traits.append(digest.features[main_index])
        recording = None
        for name, stride in strides.items():
            series = None
            if digest.can_downsample_to(stride):
                series = (
                    metrics[name].clip_course(digest.courses[:, study.meta.metrics.index(name)])
                    if name in metrics
                    else series_from_digest(digest, aspects[name], main_index)
                )
            if series is not None:
                series_by_aspect[name].append(digest.downsample(series, stride))
                continue
            if name in metrics:
                series = metrics[name].clip_course(study.course(i, name))
            else:
                recording = recording or study.recording(i).with_absent_entities(study.meta.others)
                series = compute_aspect_series(study, i, recording, aspects[name], main)
            series_by_aspect[name].append(downsample(series, stride))
        if with_times:
            times.append(digest.time if digest.stride == 1 else study.recording(i).time)
        if count == n_sampled:
            _require_memory(study, series_by_aspect, len(strides), len(ids), memory_limit)
        if bar:
            bar.update(count, "read")
    for name in aspects:
        require_same_channels(study, name, ids.tolist(), series_by_aspect[name])
    values = [row.values for row in study.finished_rows()]
    naming_facts = NamingFacts.from_scenarios(outcomes, traits, study.space, values)
    return _AnalysisInputs(outcomes, naming_facts, times, series_by_aspect)


def _require_memory(
    study: StudyFile,
    series_by_aspect: dict[str, list[FloatArray]],
    n_aspects: int,
    n_scenarios: int,
    memory_limit: MemoryLimit,
) -> None:
    """Raise an error if the series will not fit in memory, estimated from the first scenarios."""
    first = max(map(len, series_by_aspect.values()), default=0)
    series = sum(values.nbytes for series in series_by_aspect.values() for values in series) / max(first, 1)
    pairs = min(n_scenarios, MAX_ALL_PAIRS) ** 2 * (_BYTES_PER_PAIR + (n_aspects - 1) * _BYTES_PER_WAITING_PAIR)
    advice = (
        ", or analyze by fewer aspects at a time with `by`"
        if n_scenarios * series > pairs and len(series_by_aspect) > 1
        else ""
    )
    memory_limit.check_fits(
        pairs + n_scenarios * (series + _BYTES_PER_SCENARIO),
        f"{study.path}: the series of {n_scenarios} scenarios",
        f"give more{advice}",
    )


def _cluster_by_aspect(
    study: StudyFile,
    ids: IntArray,
    comparer: PairwiseComparer,
    model: ScenarioClustering,
    by: str,
    existing: Analysis | None,
) -> tuple[Clustering, IntArray, FloatArray, Distances, float | None]:
    """Cluster scenarios by one aspect (what scenarios are compared by).

    Returns five things: the clusters; the ids of the scenarios of the analysis that found the clusters; the distances
    to store (between all scenarios or between the landmarks); the distances between all scenarios; and the error of the
    latter, None if they are exact.
    """
    if existing is None and len(ids) > MAX_ALL_PAIRS:
        result = cluster_by_landmarks(comparer, model)
        return (
            result.clustering,
            ids,
            result.landmark_distances,
            EmbeddedDistances(result.embedding),
            result.embedding_error,
        )
    if existing is not None and (existing.embedding_error is not None or len(ids) > MAX_ALL_PAIRS):
        # An analysis without landmarks uses all its scenarios as landmarks.
        references = (
            existing.ids[existing.clustering.landmarks] if existing.embedding_error is not None else existing.fitted_ids
        )
        rows = existing.rows_of(references.tolist())
        if existing.embedding_error is not None:
            stored = read_landmark_distances(study, by)
        else:
            stored = read_distances(study, by)[np.ix_(rows, rows)]
        landmarks = np.flatnonzero(np.isin(ids, references))
        result = assign_by_landmarks(comparer, landmarks, stored, existing.clustering, existing.labels[rows])
        return (
            result.clustering,
            existing.fitted_ids,
            stored,
            EmbeddedDistances(result.embedding),
            result.embedding_error,
        )
    distances = comparer.distances_between(np.arange(len(ids)), show_progress=True)
    if existing is None:
        return model.fit(distances).result_, ids, distances, distances, None
    # Stored distances are reused, since the kept clusters were found with these distances to the last digit.
    stored_indices, rows = np.flatnonzero(np.isin(ids, existing.ids)), existing.rows_of(ids.tolist())
    distances[np.ix_(stored_indices, stored_indices)] = read_distances(study, by)[np.ix_(rows, rows)]
    return *_extend_clusters(existing, ids, distances), distances, distances, None


def _extend_clusters(existing: Analysis, ids: IntArray, distances: FloatArray) -> tuple[Clustering, IntArray]:
    """Assign scenarios that were run after an earlier analysis to the clusters of this analysis.

    Returns the extended clusters, and the ids of the scenarios in which the clusters were found.
    """
    # A failed scenario may have been run again, so scenarios of the earlier analysis need not come first.
    is_fitted = np.isin(ids, existing.fitted_ids)
    clustering = existing.clustering
    model = refit(existing, distances[np.ix_(is_fitted, is_fitted)])
    labels, embedding = np.empty(len(ids), dtype=np.int64), np.empty((len(ids), clustering.embedding.shape[1]))
    labels[is_fitted], embedding[is_fitted] = model.labels_, model.embedding_
    to_earlier = distances[np.ix_(~is_fitted, is_fitted)]
    labels[~is_fitted], embedding[~is_fitted] = model.predict(to_earlier), model.transform(to_earlier)
    extended = replace(
        model.result_,
        labels=labels,
        embedding=embedding,
        candidates=clustering.candidates,
        landmarks=np.flatnonzero(is_fitted)[model.landmarks_],
    )
    return extended, ids[is_fitted]
