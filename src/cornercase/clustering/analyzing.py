"""From scenarios that were run to kinds of scenario."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from cornercase._common.arguments import texts
from cornercase._common.dask_client import connected
from cornercase._common.errors import InputError
from cornercase._common.memory import DEFAULT_MEMORY, MemoryLimit
from cornercase._common.progress import ProgressBar, bars_wanted
from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering.agreement import agree_with_facts, find_facts
from cornercase.clustering.analysis import Analysis, read_analysis, read_between, read_distances, stored_analysis
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
from cornercase.clustering.landmarks import MOST_COMPARED, Comparing, find_by_landmarks, join_landmarks
from cornercase.clustering.outcomes import Outcome, find_outcome
from cornercase.clustering.places import Distances, PlacedDistances
from cornercase.clustering.profiles import describe_clusters
from cornercase.clustering.thinning import instants_apart, thinned
from cornercase.clustering.traits import measure_traits
from cornercase.study import Study, open_study

if TYPE_CHECKING:
    from distributed import Client

# Recordings that say how long all are, and how much memory they take.
_LOOKED_AT: Final = 100
# Bytes: of a pair in the matrix and in what is made of it, of a pair by an aspect that is not stored yet, and of a
# scenario beside its series.
_OF_A_PAIR: Final = 80
_OF_A_STORED_PAIR: Final = 20
_OF_A_SCENARIO: Final = 8_000


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
    critical: float | None = None,
    workers: int = 1,
    cluster: str | Client | None = None,
    memory: str | float = DEFAULT_MEMORY,
    progress: bool = False,
) -> dict[str, Analysis]:
    """Cluster the scenarios of a study by behaviour and by criticality, and store the result in it.

    For each aspect, the scenarios are compared by Dynamic Time Warping, and `ScenarioClustering` clusters them by
    these distances. Of more than 2,000 scenarios, each is compared with 500 of them, the landmarks, which are drawn at
    random; of their series so many instants are taken that the typical one has 100 at most. The clusters of the
    landmarks are found, and the others join them. Distances between others follow from places, by landmark
    multidimensional scaling; `Analysis.inexact` says how well.

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
    critical : float, optional
        Score from which a scenario is critical, for what the clusters say of that; by default that of the study, which
        stays as it is.
    workers : int, default 1
        Processes of a local cluster.
    cluster : str or distributed.Client, optional
        Dask cluster that computes the distances: ``"local"`` for `workers` processes here, the address of a scheduler,
        the file that a scheduler wrote, or a connection, which stays open. The result is the same to the bit.
    memory : str or float, default "4 GB"
        That the process may take, in bytes or in words; more scenarios than fit are refused.
    progress : bool, default False
        Show a progress bar.

    Returns
    -------
    dict of str to Analysis
        By aspect.

    Raises
    ------
    InputError
        Fewer than two scenarios were run, the study cannot be compared by an aspect, a setting is out of range or
        given for clusters that are kept, or the series do not fit in the memory.

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
    limit = MemoryLimit.of(memory)
    chosen = None if by is None else tuple(dict.fromkeys(texts("by", by)))
    with open_study(study, critical=critical) as opened:
        aspects = default_aspects(opened) if chosen is None else chosen
        for one in aspects:
            require_aspect(opened, one)
        known = set(aspects) & set(opened.analyses())
        if keep and known and ({gamma, eps, min_samples} != {"auto"} or method is not None or window is not None):
            raise InputError(
                "`keep`: kept clusters keep their settings;"
                " leave out `gamma`, `eps`, `min_samples`, `method` and `window`."
            )
        with bars_wanted(progress), connected(cluster, workers, else_none=True) as client:
            return _analyzed(opened, aspects, model, window, keep, limit, client, progress)


@dataclass(frozen=True, eq=False)
class _Seen:
    """What was read of the scenarios that were run."""

    outcomes: list[Outcome]
    account: Account
    times: list[FloatArray]
    """Instants of each; empty where no window is asked for."""
    series: dict[str, list[FloatArray]]
    """By aspect that is no metric."""


def _analyzed(
    study: Study,
    aspects: Sequence[str],
    model: ScenarioClustering,
    window: float | None,
    keep: bool,
    limit: MemoryLimit,
    client: Client | None,
    progress: bool,
) -> dict[str, Analysis]:
    ids = np.array([row.id for row in study.done()], dtype=np.int64)
    if len(ids) < 2:
        ran, failed = "1 scenario was" if len(ids) else "no scenario was", study.failed()
        why = f", {len(failed)} failed, the first one as {failed[0].error}" if failed else ""
        raise InputError(f"{study.path}: {ran} run{why}; at least 2 can be clustered.")
    begun = time.monotonic()
    earlier = {one: read_analysis(study, one) for one in aspects if keep and one in study.analyses()}
    usual = _instants_apart(study, ids)
    every = {one: earlier[one].every if one in earlier else usual for one in aspects}
    bar = ProgressBar(len(ids), "reading", "scenarios") if progress and len(ids) > MOST_COMPARED else None
    try:
        seen = _read(study, ids, every, limit, bar, with_times=window is not None or keep)
    finally:
        if bar:
            bar.stop()
    instants_within(seen.times, window)
    facts = find_facts(study, seen.outcomes)
    spent = {"read": time.monotonic() - begun, "compare": 0.0, "cluster": 0.0}
    results, to_store = {}, {}
    for by in aspects:
        begun = time.monotonic()
        before = earlier.pop(by, None)
        within = window if before is None else before.window
        series = seen.series.pop(by) if by in seen.series else [thinned(one, every[by]) for one in series_of(study, by)]
        instants = instants_within([thinned(one, every[by]) for one in seen.times], within)
        comparing = Comparing(series, every[by], instants, client, by if progress else None)
        found, fitted, stored, known, inexact = _clustered(study, ids, comparing, model, by, before)
        profiles = describe_clusters(study, found.labels, seen.account, known)
        tells = agree_with_facts(found.labels, facts)
        unit = unit_of(study, by)
        results[by] = Analysis(by, unit, within, ids, found, fitted, profiles, tells, every[by], inexact)
        to_store[by] = stored_analysis(study, results[by], stored, known)
        spent["compare"] += comparing.seconds
        spent["cluster"] += time.monotonic() - begun - comparing.seconds
    outcomes = {i: one.text for i, one in zip(ids.tolist(), seen.outcomes, strict=True)}
    study.writer.save_analyses(to_store, outcomes)
    study.writer.add_all_elapsed(spent)
    return results


def _instants_apart(study: Study, ids: IntArray) -> int:
    """Of how many instants one is compared, by some of the recordings."""
    if len(ids) <= MOST_COMPARED:
        return 1
    some = ids[np.linspace(0, len(ids) - 1, _LOOKED_AT).astype(np.int64)]
    return instants_apart([len(study.recording(one).time) for one in some.tolist()])


def _read(
    study: Study,
    ids: IntArray,
    every: dict[str, int],
    limit: MemoryLimit,
    bar: ProgressBar | None,
    *,
    with_times: bool,
) -> _Seen:
    outcomes, traits, times = [], [], []
    main = study.main_other()
    compared = {one: make_aspect(one) for one in every if one not in study.meta.metrics}
    seen: dict[str, list[FloatArray]] = {one: [] for one in compared}
    # Each recording is unpacked once.
    for count, i in enumerate(ids.tolist(), 1):
        recording = study.recording(i).with_absent(study.meta.others)
        outcomes.append(find_outcome(recording, study.meta.ego, main))
        traits.append(measure_traits(recording, outcomes[-1]))
        if with_times:
            times.append(recording.time)
        for one, aspect in compared.items():
            seen[one].append(thinned(series_in(study, i, recording, aspect, main), every[one]))
        if count == _LOOKED_AT:
            _require_memory(study, seen, len(every), len(ids), limit)
        if bar:
            bar.update(count, "read")
    for one, series in seen.items():
        require_same_channels(study, one, ids.tolist(), series)
    account = Account.of(outcomes, traits, study.space, [row.values for row in study.done()])
    return _Seen(outcomes, account, times, seen)


def _require_memory(
    study: Study, seen: dict[str, list[FloatArray]], aspects: int, count: int, limit: MemoryLimit
) -> None:
    """Refuse what will not fit, by the first scenarios."""
    first = max(map(len, seen.values()), default=0)
    series = sum(one.nbytes for series in seen.values() for one in series) / max(first, 1)
    pairs = min(count, MOST_COMPARED) ** 2 * (_OF_A_PAIR + (aspects - 1) * _OF_A_STORED_PAIR)
    fewer = ", or analyze by fewer aspects at a time with `by`" if count * series > pairs and len(seen) > 1 else ""
    limit.require(
        pairs + count * (series + _OF_A_SCENARIO), f"{study.path}: the series of {count} scenarios", f"give more{fewer}"
    )


def _clustered(
    study: Study, ids: IntArray, comparing: Comparing, model: ScenarioClustering, by: str, before: Analysis | None
) -> tuple[Clustering, IntArray, FloatArray, Distances, float | None]:
    """Clusters, what they were found from, the distances to store, all distances, and how inexact these are."""
    if before is None and len(ids) > MOST_COMPARED:
        compared = find_by_landmarks(comparing, model)
        return compared.clustering, ids, compared.between, PlacedDistances(compared.places), compared.error
    if before is not None and (before.inexact is not None or len(ids) > MOST_COMPARED):
        # Of an analysis without landmarks all scenarios are.
        chosen = before.ids[before.clustering.landmarks] if before.inexact is not None else before.fitted
        rows = before.rows_of(chosen.tolist())
        if before.inexact is not None:
            stored = read_between(study, by)
        else:
            stored = read_distances(study, by)[np.ix_(rows, rows)]
        landmarks = np.flatnonzero(np.isin(ids, chosen))
        compared = join_landmarks(comparing, landmarks, stored, before.clustering, before.labels[rows])
        return compared.clustering, before.fitted, stored, PlacedDistances(compared.places), compared.error
    distances = comparing.between(np.arange(len(ids)), shown=True)
    if before is None:
        return model.fit(distances).result_, ids, distances, distances, None
    # What is kept was found from these, to the last digit.
    kept, rows = np.flatnonzero(np.isin(ids, before.ids)), before.rows_of(ids.tolist())
    distances[np.ix_(kept, kept)] = read_distances(study, by)[np.ix_(rows, rows)]
    return *_joined(before, ids, distances), distances, distances, None


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
