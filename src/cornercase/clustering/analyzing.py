"""From scenarios that were run to kinds of scenario."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from cornercase._common.arguments import texts
from cornercase._common.dask_client import connected
from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering.agreement import agree_with_facts, find_facts
from cornercase.clustering.analysis import Analysis, read_analysis, read_distances, save_analysis
from cornercase.clustering.clauses import Account
from cornercase.clustering.clusters import Clustering, ClusteringMethod
from cornercase.clustering.comparing import (
    default_aspects,
    instants_within,
    make_aspect,
    require_aspect,
    require_same_channels,
    series_in,
    series_of,
    unit_of,
)
from cornercase.clustering.estimator import ScenarioClustering
from cornercase.clustering.joining import fit_again
from cornercase.clustering.outcomes import find_outcome
from cornercase.clustering.profiles import describe_clusters
from cornercase.clustering.traits import measure_traits
from cornercase.dtw import distance_matrix
from cornercase.study import Study, open_study

if TYPE_CHECKING:
    from distributed import Client


def analyze(
    study: Study | Path | str,
    by: str | Sequence[str] | None = None,
    *,
    gamma: float | Literal["auto"] = "auto",
    eps: float | Literal["auto"] = "auto",
    min_samples: int | Literal["auto"] = "auto",
    method: ClusteringMethod | None = None,
    window: float | None = None,
    keep: bool = False,
    workers: int = 1,
    cluster: str | Client | None = None,
    progress: bool = False,
) -> dict[str, Analysis]:
    """Cluster the scenarios of a study by behaviour and by criticality, and store the result in it.

    For each aspect, the scenarios are compared by Dynamic Time Warping, and `ScenarioClustering` clusters them by
    these distances.

    Parameters
    ----------
    study : Study or path
        Open for writing, or the file.
    by : str or sequence of str, optional
        Aspects: any of `cornercase.clustering.ASPECTS`, and metrics of the study. By default the ego's trajectory,
        the bearing of the other and the interaction of both, and all metrics of the study.
    gamma, eps : float or "auto", default "auto"
        Kernel width and radius of the neighbourhood, without unit.
    min_samples : int or "auto", default "auto"
        Least number of scenarios in a dense neighbourhood.
    method : {"dbscan", "hdbscan"}, optional
        Algorithm that finds the clusters; by default DBSCAN.
    window : float, optional
        s; how far apart in time two instants may be that are matched, beyond the difference of the recordings'
        lengths. By default any, as in the paper: then waiting costs nothing by itself.
    keep : bool, default False
        Keep the clusters that the study has, and let the scenarios that were run since join them, as in
        `ScenarioClustering.predict`.
    workers : int, default 1
        Processes of a local cluster.
    cluster : str or distributed.Client, optional
        Dask cluster that computes the distances: ``"local"`` for `workers` processes here, the address of a scheduler,
        the file that a scheduler wrote, or a connection, which stays open. The result is the same to the bit.
    progress : bool, default False
        Show a progress bar.

    Returns
    -------
    dict of str to Analysis
        By aspect.

    Raises
    ------
    InputError
        Fewer than two scenarios were run, the study cannot be compared by an aspect, a setting is out of range, or
        given for clusters that are kept.

    See Also
    --------
    ScenarioClustering : The clustering of any distances.
    cornercase.reduce : Keeps a few scenarios of each cluster.

    References
    ----------
    B. Schütt, S. Otten, E. Sax, "Clustering-based criticality analysis for testing of automated driving systems",
    2023, section "Scenario Clustering".
    """
    model = ScenarioClustering(gamma, eps, min_samples, method="dbscan" if method is None else method)
    model.require_settings()
    chosen = None if by is None else tuple(dict.fromkeys(texts("by", by)))
    with open_study(study) as opened:
        aspects = default_aspects(opened) if chosen is None else chosen
        for one in aspects:
            require_aspect(opened, one)
        known = set(aspects) & set(opened.analyses())
        if keep and known and ({gamma, eps, min_samples} != {"auto"} or method is not None or window is not None):
            raise InputError(
                "`keep`: kept clusters keep their settings;"
                " leave out `gamma`, `eps`, `min_samples`, `method` and `window`."
            )
        with connected(cluster, workers, else_none=True) as client:
            return _analyzed(opened, aspects, model, window, keep, client, progress)


def _analyzed(
    study: Study,
    aspects: Sequence[str],
    model: ScenarioClustering,
    window: float | None,
    keep: bool,
    client: Client | None,
    progress: bool,
) -> dict[str, Analysis]:
    ids = np.array([row.id for row in study.done()], dtype=np.int64)
    if len(ids) < 2:
        ran, failed = "1 scenario was" if len(ids) else "no scenario was", study.failed()
        why = f", {len(failed)} failed, the first one as {failed[0].error}" if failed else ""
        raise InputError(f"{study.path}: {ran} run{why}; at least 2 can be clustered.")
    begun = time.monotonic()
    outcomes, traits, times = [], [], []
    main = study.main_other()
    compared = {one: make_aspect(one) for one in aspects if one not in study.meta.metrics}
    seen: dict[str, list[FloatArray]] = {one: [] for one in compared}
    # Each recording is unpacked once.
    for i in ids.tolist():
        recording = study.recording(i).with_absent(study.meta.others)
        outcomes.append(find_outcome(recording, study.meta.ego, main))
        traits.append(measure_traits(recording, outcomes[-1]))
        times.append(recording.time)
        for one, aspect in compared.items():
            seen[one].append(series_in(study, i, recording, aspect, main))
    for one, series in seen.items():
        require_same_channels(study, one, ids.tolist(), series)
    instants_within(times, window)
    account = Account.of(outcomes, traits, study.space, [row.values for row in study.done()])
    facts = find_facts(study, outcomes)
    study.save_outcomes({i: one.text for i, one in zip(ids.tolist(), outcomes, strict=True)})
    study.add_elapsed("read", time.monotonic() - begun)
    results = {}
    for by in aspects:
        begun = time.monotonic()
        before = read_analysis(study, by) if keep and by in study.analyses() else None
        within = window if before is None else before.window
        series = seen.pop(by) if by in seen else series_of(study, by)
        # In single precision, several times as fast: the seventh digit of a distance decides nothing here.
        distances = distance_matrix(
            series, window=instants_within(times, within), dtype="float32", client=client, progress=progress
        ).astype(np.float64)
        measured = time.monotonic()
        if before is not None:
            # What is kept was found from these, to the last digit.
            kept, rows = np.flatnonzero(np.isin(ids, before.ids)), before.rows_of(ids.tolist())
            distances[np.ix_(kept, kept)] = read_distances(study, by)[np.ix_(rows, rows)]
            found, fitted = _joined(before, ids, distances)
        else:
            found, fitted = model.fit(distances).result_, ids
        profiles = describe_clusters(study, found.labels, account, distances)
        tells = agree_with_facts(found.labels, facts)
        results[by] = Analysis(by, unit_of(study, by), within, ids, found, fitted, profiles, tells)
        save_analysis(study, results[by], distances)
        study.add_elapsed("compare", measured - begun)
        study.add_elapsed("cluster", time.monotonic() - measured)
    return results


def _joined(before: Analysis, ids: IntArray, distances: FloatArray) -> tuple[Clustering, IntArray]:
    """Clusters that a study has, joined by the scenarios that were run since, and those that they were found from."""
    # A scenario that failed may have been run again since; so the earlier ones need not be the first.
    earlier = np.isin(ids, before.fitted)
    known = before.clustering
    model = fit_again(before, distances[np.ix_(earlier, earlier)])
    labels, embedding = np.empty(len(ids), dtype=np.int64), np.empty((len(ids), known.embedding.shape[1]))
    labels[earlier], embedding[earlier] = model.labels_, model.embedding_
    to_earlier = distances[np.ix_(~earlier, earlier)]
    labels[~earlier], embedding[~earlier] = model.predict(to_earlier), model.transform(to_earlier)
    found = replace(
        model.result_,
        labels=labels,
        embedding=embedding,
        candidates=known.candidates,
        landmarks=np.flatnonzero(earlier)[model.landmarks_],
    )
    return found, ids[earlier]
