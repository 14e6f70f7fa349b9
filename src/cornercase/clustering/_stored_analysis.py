"""Analyses of a study: clusters of its scenarios by one aspect (what they are compared by), stored and read back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from cornercase._common.text.notebook_html import render_html_table
from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering._agreement import mutual_information_with_critical
from cornercase.clustering._clustering import Candidate, Clustering
from cornercase.clustering._embedding import Distances, EmbeddedDistances
from cornercase.clustering.naming._profiles import Profile
from cornercase.clustering.naming._rules import Rule
from cornercase.study import StudyFile
from cornercase.study._damage import dataclass_from_json, require_condition, reraise_read_errors
from cornercase.study._study_file import open_study

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False, repr=False)
class Analysis:
    """Clusters of a study's scenarios by one aspect, as stored in the study.

    The distances are stored separately; `read_distances` returns them.

    Attributes
    ----------
    by : str
        The aspect: one of `cornercase.clustering.ASPECTS`, or the name of a metric.
    unit : str
        Unit of the distances; ``"1"`` if they have no unit.
    window : float or None
        Largest difference in time, in s, of two instants that Dynamic Time Warping may match; None for any difference.
    ids : ndarray of int64, shape (n,)
        Ids of the scenarios.
    clustering : Clustering
        Clusters of the scenarios, in the order of `ids`.
    fitted_ids : ndarray of int64, shape (m,)
        Ids of the scenarios in which the clusters were found; other scenarios were assigned to the clusters later.
    profiles : tuple of Profile
        What the scenarios of each cluster have in common, noise last; empty in a study of an early version.
    fact_agreement : mapping of str to float
        Adjusted mutual information of the clusters and facts about the scenarios, by name of the fact, such as
        ``"collision"``; empty in a study of an early version.
    stride : int
        Every `stride`-th instant was compared.
    embedding_error : float or None
        None if all pairs of scenarios were compared. Otherwise, only some scenarios, the landmarks, were all compared
        with each other, and each other scenario with some of the landmarks. All other distances are approximate: their
        mean error, as a share of the mean distance.

    Examples
    --------
    >>> import cornercase as cc
    >>> analysis = cc.analyze("study.db", ["interaction"])["interaction"]  # doctest: +SKIP
    >>> analysis.sizes, analysis.labels[:5]  # doctest: +SKIP
    ([146, 54], array([1, 0, 1, 0, 0]))
    >>> analysis.table()["name"].loc[1]  # doctest: +SKIP
    'Ego passes before Pedestrian'
    """

    by: str
    unit: str
    window: float | None
    ids: IntArray
    clustering: Clustering
    fitted_ids: IntArray
    profiles: tuple[Profile, ...]
    fact_agreement: Mapping[str, float] = field(default_factory=dict)
    stride: int = 1
    embedding_error: float | None = None

    @property
    def labels(self) -> IntArray:
        """Number of the cluster of each scenario, shape (n,): 0 is the largest cluster, -1 is noise."""
        return self.clustering.labels

    @property
    def sizes(self) -> list[int]:
        """Number of scenarios in each cluster, without noise."""
        counts = np.bincount(self.labels[self.labels >= 0], minlength=self.clustering.n_clusters)
        return [int(count) for count in counts]

    def rows_of(self, scenario_ids: IntArray | list[int]) -> IntArray:
        """Return the positions of some scenarios in `ids`.

        Parameters
        ----------
        scenario_ids : ndarray of int64 or list of int, shape (m,)
            Ids of scenarios; scenarios that were not analysed are left out.

        Returns
        -------
        ndarray of int64, shape (k,)
            Positions, in the order of `scenario_ids`.
        """
        row_of = {scenario: row for row, scenario in enumerate(self.ids.tolist())}
        return np.array([row_of[int(i)] for i in scenario_ids if int(i) in row_of], dtype=np.int64)

    def table(self) -> pd.DataFrame:
        """Make a table of the clusters.

        Returns
        -------
        DataFrame
            One row per cluster; the index is the number of the cluster, -1 for noise. The columns are ``name``,
            ``size``, ``collisions`` (number of scenarios in which the ego collides), ``example`` (id of the medoid;
            empty if the cluster has no name), and for each metric ``median …``, the median score.

        See Also
        --------
        cornercase.Study.table : The cluster of each scenario.
        """
        import pandas as pd

        profiles = self.profiles
        columns: dict[str, Any] = {
            "name": pd.Series([profile.name for profile in profiles], dtype=object),
            "size": pd.Series([profile.size for profile in profiles], dtype="int64"),
            "collisions": pd.Series([profile.collisions for profile in profiles], dtype="int64"),
            "example": pd.Series([profile.example for profile in profiles], dtype="Int64"),
        }
        for metric in profiles[0].scores if profiles else ():
            columns[f"median {metric}"] = pd.Series([profile.scores[metric][1] for profile in profiles])
        clusters = pd.Index([profile.cluster for profile in profiles], dtype="int64", name="cluster")
        return pd.DataFrame(columns).set_index(clusters)

    def _repr_html_(self) -> str:
        """Return an HTML table of the clusters, for notebooks."""
        return render_html_table(repr(self), self.table())

    def __repr__(self) -> str:
        clustering = self.clustering
        return (
            f"<Analysis by {self.by}: {len(self.ids)} scenarios, clusters of {self.sizes},"
            f" {clustering.noise:.0%} noise, {clustering.method}, gamma={clustering.gamma:.4g},"
            f" eps={clustering.eps:.4g}, min_samples={clustering.min_samples}>"
        )


def analysis_to_storage(
    study: StudyFile, analysis: Analysis, dtw_distances: FloatArray, distances: Distances
) -> tuple[dict[str, npt.ArrayLike], dict[str, Any]]:
    """Convert an analysis to the arrays and the info that `StudyFile.save_analysis` stores.

    `dtw_distances` are the distances by Dynamic Time Warping between all scenarios or between the landmarks.
    `distances` are the distances between all scenarios.
    """
    clustering = analysis.clustering
    arrays: dict[str, npt.ArrayLike] = {"ids": analysis.ids, "distances": dtw_distances}
    if isinstance(distances, EmbeddedDistances):
        arrays = {"ids": analysis.ids, "between": dtw_distances, "places": distances.coordinates}
    arrays |= {
        "labels": clustering.labels,
        "embedding": clustering.embedding,
        "landmarks": clustering.landmarks,
    }
    info = {
        "unit": analysis.unit,
        "window": analysis.window,
        "gamma": clustering.gamma,
        "eps": clustering.eps,
        "min_samples": clustering.min_samples,
        "scale": clustering.scale,
        "explained": clustering.explained,
        "method": clustering.method,
        "stability": clustering.stability,
        "landmarks": len(clustering.landmarks),
        "error": clustering.error,
        "candidates": [asdict(item) for item in clustering.candidates],
        "fitted": analysis.fitted_ids.tolist(),
        "profiles": [asdict(item) for item in analysis.profiles],
        "tells": dict(analysis.fact_agreement),
    }
    if analysis.embedding_error is not None:
        info |= {"every": analysis.stride, "inexact": analysis.embedding_error}
    if study.critical != study.meta.critical:
        info["critical_threshold"] = study.critical
    return arrays, info


def read_analysis(study: StudyFile | Path | str, by: str) -> Analysis:
    """Read the stored analysis of a study by one aspect.

    Parameters
    ----------
    study : Study, StudyFile or path
        Study that was analysed before.
    by : str
        Aspect: one of `cornercase.clustering.ASPECTS`, or the name of a metric.

    Returns
    -------
    Analysis
        The same as `analyze` returned.

    Raises
    ------
    InputError
        The study was not analysed by this aspect, or the stored analysis is damaged.

    Examples
    --------
    >>> from cornercase.clustering import read_analysis
    >>> read_analysis("study.db", "interaction").sizes  # doctest: +SKIP
    [146, 54]
    """
    with open_study(study, readonly=True) as opened:
        return _read_analysis(opened, by)


def _read_analysis(study: StudyFile, by: str) -> Analysis:
    run = {row.id for row in study.finished_rows()}
    arrays, info = study.read_analysis(by, "ids", "labels", "embedding", "landmarks")
    with reraise_read_errors(study.path):
        ids, labels, embedding = arrays["ids"], arrays["labels"], arrays["embedding"]
        n = len(ids)
        require_condition(
            {array.dtype.kind for array in (ids, labels, arrays["landmarks"])} == {"i"}, "labels that are no integers"
        )
        require_condition(
            ids.ndim == 1 and set(ids.tolist()) <= run and len(set(ids.tolist())) == n, "scenarios that were not run"
        )
        require_condition(n > 0, "an analysis without scenarios")
        require_condition(
            labels.shape == (n,) and labels.min(initial=-1) >= -1 and labels.max(initial=-1) < n, "unsuitable labels"
        )
        require_condition(
            embedding.ndim == 2 and len(embedding) == n and embedding.dtype.kind == "f", "an unsuitable embedding"
        )
        window = None if info["window"] is None else float(info["window"])
        fact_agreement = {str(fact): float(mutual) for fact, mutual in info["tells"].items()}
        clustering, profiles = _clustering_from_storage(arrays, info), _profiles_from_storage(info)
        fitted = np.array([int(i) for i in info["fitted"]], dtype=np.int64)
        clusters, sizes = np.unique(labels, return_counts=True)
        described = sorted((profile.cluster, profile.size) for profile in profiles)
        require_condition(
            described in ([], list(zip(clusters.tolist(), sizes.tolist(), strict=True))), "profiles of other clusters"
        )
        require_condition(
            {profile.example for profile in profiles} <= {None, *ids.tolist()}, "an example that is not a scenario"
        )
        require_condition(isinstance(info["unit"], str), "a unit that is not a string")
        stride, embedding_error = int(info.get("every", 1)), info.get("inexact")
        require_condition(stride >= 1, "a stride below 1")
        embedding_error = None if embedding_error is None else float(embedding_error)
        analysis = Analysis(
            by, info["unit"], window, ids, clustering, fitted, profiles, fact_agreement, stride, embedding_error
        )
        threshold = info.get("critical_threshold", study.meta.critical)
    if not fact_agreement or threshold == study.critical:
        return analysis
    facts = {fact: mutual for fact, mutual in fact_agreement.items() if fact != "critical"}
    return replace(analysis, fact_agreement=facts | mutual_information_with_critical(study, ids, labels))


def _clustering_from_storage(arrays: Mapping[str, Any], info: Mapping[str, Any]) -> Clustering:
    numbers = {name: float(info[name]) for name in ("gamma", "eps", "scale", "explained", "error")}
    require_condition(info["method"] in ("dbscan", "hdbscan"), "an unknown clustering method")
    return Clustering(
        labels=arrays["labels"],
        embedding=arrays["embedding"],
        min_samples=int(info["min_samples"]),
        candidates=tuple(dataclass_from_json(Candidate, item) for item in info["candidates"]),
        method=info["method"],
        landmarks=arrays["landmarks"],
        **numbers,
    )


def _profiles_from_storage(info: Mapping[str, Any]) -> tuple[Profile, ...]:
    profiles = []
    for item in info["profiles"]:
        scores = {name: (float(low), float(mid), float(high)) for name, (low, mid, high) in item["scores"].items()}
        outcomes = {outcome: int(count) for outcome, count in item["outcomes"].items()}
        require_condition(min(outcomes.values(), default=0) >= 0, "a negative number of scenarios")
        rules = tuple(dataclass_from_json(Rule, rule) for rule in item["rules"])
        profiles.append(dataclass_from_json(Profile, {**item, "scores": scores, "outcomes": outcomes, "rules": rules}))
    return tuple(profiles)


def read_analyses(study: StudyFile | Path | str) -> dict[str, Analysis]:
    """Read all stored analyses of a study.

    Parameters
    ----------
    study : Study, StudyFile or path
        Study that was analysed before.

    Returns
    -------
    dict of str to Analysis
        Analyses by aspect: the ego's trajectory first, the metrics last.

    Examples
    --------
    >>> from cornercase.clustering import read_analyses
    >>> {by: analysis.sizes for by, analysis in read_analyses("study.db").items()}  # doctest: +SKIP
    {'ego-trajectory': [200], 'bearing': [146, 54], 'interaction': [146, 54], 'wttc': [200]}
    """
    with open_study(study, readonly=True) as opened:
        return {by: _read_analysis(opened, by) for by in opened.analyzed_aspects()}


def read_distances(study: StudyFile | Path | str, by: str) -> Distances:
    """Read the distances by which the scenarios of a study were clustered.

    Parameters
    ----------
    study : Study, StudyFile or path
        Study that was analysed before.
    by : str
        Aspect: one of `cornercase.clustering.ASPECTS`, or the name of a metric.

    Returns
    -------
    ndarray of float64, shape (n, n), or EmbeddedDistances
        Distances by Dynamic Time Warping between the scenarios in `Analysis.ids`, in the unit of the aspect. If not
        all pairs of scenarios were compared (`Analysis.embedding_error`), an `EmbeddedDistances` computes the distances
        on demand from an embedding; index the object by rows and columns or by ``numpy.ix_``.

    Raises
    ------
    InputError
        The study was not analysed by this aspect, or the stored analysis is damaged.

    Examples
    --------
    >>> from cornercase.clustering import read_analysis, read_distances
    >>> distances = read_distances("study.db", "interaction")  # doctest: +SKIP
    >>> ids = read_analysis("study.db", "interaction").ids  # doctest: +SKIP
    >>> distances.shape, int(ids[distances[0].argsort()[1]])  # doctest: +SKIP
    ((200, 200), 81)
    """
    with open_study(study, readonly=True) as opened:
        return _read_distances(opened, by)


def _read_distances(study: StudyFile, by: str) -> Distances:
    if study.read_analysis(by, "ids")[1].get("inexact") is not None:
        arrays, _ = study.read_analysis(by, "ids", "places")
        with reraise_read_errors(study.path):
            coordinates = arrays["places"]
            require_condition(
                coordinates.ndim == 2 and len(coordinates) == len(arrays["ids"]), "an unsuitable embedding"
            )
            require_condition(
                coordinates.dtype.kind == "f" and bool(np.isfinite(coordinates).all()), "an embedding without numbers"
            )
            return EmbeddedDistances(coordinates)
    arrays, _ = study.read_analysis(by, "ids", "distances")
    distances: FloatArray = arrays["distances"]
    with reraise_read_errors(study.path):
        _require_distances(distances, len(arrays["ids"]))
    return distances


def read_landmark_distances(study: StudyFile, by: str) -> FloatArray:
    """Read the distances between the landmarks of an analysis, shape (m, m).

    Landmarks are scenarios that were all compared with each other; others were compared with some landmarks only.
    """
    arrays, _ = study.read_analysis(by, "landmarks", "between")
    distances: FloatArray = arrays["between"]
    with reraise_read_errors(study.path):
        _require_distances(distances, len(arrays["landmarks"]))
    return distances


def _require_distances(distances: FloatArray, n_scenarios: int) -> None:
    require_condition(
        distances.shape == (n_scenarios, n_scenarios) and distances.dtype.kind == "f", "distances of other scenarios"
    )
    require_condition(
        bool((np.isfinite(distances) & (distances >= 0.0)).all()), "distances that are negative or not finite"
    )
