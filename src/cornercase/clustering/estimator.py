"""Kinds of scenario: kernel PCA and DBSCAN on a distance matrix, as an estimator like those of scikit-learn."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Final, Literal, Self, get_args

import numpy as np
import numpy.typing as npt
from sklearn.base import BaseEstimator, ClusterMixin
from threadpoolctl import threadpool_limits

from cornercase._common.errors import InputError, suggestion
from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering.clusters import Clustering, ClusteringMethod
from cornercase.clustering.density import join_nearest, order_by_size
from cornercase.clustering.kernel_space import KernelSpace
from cornercase.clustering.search import MOST_SCORED, canonical_order, search_settings

# Beyond so many scenarios the kernel space is that of so many landmarks.
MOST_EXACT: Final = 5000
LANDMARKS: Final = 2000
# Singular values of a kernel of distances in single precision that are rounding, as a share of the largest.
_SMALLEST: Final = 1e-7


class ScenarioClustering(ClusterMixin, BaseEstimator):  # type: ignore[misc]
    """Cluster scenarios by their distances, and assign new ones to the clusters that are there.

    As in [1]_, the distances d become a Gaussian kernel ``exp(-gamma * (d / scale)**2)``, kernel PCA [2]_ projects it
    to a few dimensions, and DBSCAN [3]_ finds the dense regions there. `scale` is the median distance of two
    scenarios that differ. So `gamma` has no unit and means the same for trajectories in metres and courses in seconds:
    at 1 the kernel has fallen to 1/e at the typical distance.

    Parameters
    ----------
    gamma : float or "auto", default "auto"
        Kernel width, without unit.
    eps : float or "auto", default "auto"
        Radius of DBSCAN's neighbourhood in the embedding, without unit; of HDBSCAN the distance below which clusters
        are not divided.
    min_samples : int or "auto", default "auto"
        Scenarios in a neighbourhood, itself included, that make it dense. ``"auto"`` is ``ln(n)``, rounded up and at
        least 3 [4]_; 3, or twice as many, where that shows the kinds better.
    n_components : int or "auto", default "auto"
        Dimensions of the embedding; the paper takes 3. ``"auto"`` is 3, or 6, 12 or 24 where more kinds than fit into
        three dimensions show better there.
    method : {"dbscan", "hdbscan"}, default "dbscan"
        Algorithm that finds the clusters in the embedding. HDBSCAN [5]_ takes regions of different density.
    landmarks : int, "auto" or None, default "auto"
        Number of scenarios that span the kernel space; the others are projected on it [10]_ and join the cluster of the
        nearest dense landmark. None for all; ``"auto"`` is 2,000 where there are more than 5,000 scenarios.

    Attributes
    ----------
    labels_ : ndarray of int64, shape (n,)
        The largest cluster is 0; -1 is noise.
    embedding_ : ndarray of float64, shape (n, n_components)
    gamma_, eps_ : float
    min_samples_ : int
        Settings that were given or chosen.
    candidates_ : tuple of Candidate
        All settings that were tried.
    landmarks_ : ndarray of int64, shape (m,)
        Scenarios that span the kernel space; empty where all do.
    result_ : Clustering
        All of these, and how well the embedding keeps the kernel.
    n_features_in_ : int
        n.

    See Also
    --------
    cornercase.clustering.cluster : The same as a function.
    cornercase.analyze : Clusters the scenarios of a study.

    Notes
    -----
    What a person does by looking, ``"auto"`` does in two steps.

    First, which kinds there are, is judged on the given distances, split by split (`cornercase.clustering.kinds`): the
    hierarchy of mutual reachability [5]_ merges scenarios from the nearest on, and two groups stay apart where the gap
    between them would hold clearly more neighbours of each group's members than chance lets a gap hold in scenarios of
    one kind. Chance depends on the number of scenarios and on their intrinsic dimension [7]_. A gap of less than 5 % of
    the median distance is no difference in kind. So one kind is the rule, and each further one needs evidence; four
    scenarios can be one if they are far enough from the others. Of up to a hundred scenarios, all gaps are judged
    together first, as none of several may be clear by itself; there three can be a kind.

    Then the settings are searched with which the paper's chain shows these kinds: `gamma` on a fixed grid, `eps`
    between the steps within kinds and those across. A candidate scores the mean F-measure of its clusters and the
    kinds, less the share of noise, less up to 0.1 where other clusters are found in random parts of 80 % of the
    scenarios with the same settings [9]_, and a little more where the gap is wide in the embedding. The best score
    wins. Where its clusters are found again with an adjusted Rand index of less than 0.5 only, all are one cluster; so
    they are with fewer than 5 scenarios. Each candidate's agreement with the kinds says how well it shows them. DBCV
    [6]_ and silhouette [8]_ are told for comparison; they choose nothing.

    References
    ----------
    .. [1] B. Schütt, S. Otten, E. Sax, "Clustering-based criticality analysis for testing of automated driving
       systems", 2023.
    .. [2] S. Mika et al., "Kernel PCA and de-noising in feature spaces", 1998.
    .. [3] M. Ester et al., "A density-based algorithm for discovering clusters in large spatial databases with noise",
       1996.
    .. [4] D. Birant, A. Kut, "ST-DBSCAN: An algorithm for clustering spatial-temporal data", 2007.
    .. [5] R. Campello, D. Moulavi, J. Sander, "Density-based clustering based on hierarchical density estimates", 2013.
    .. [6] D. Moulavi et al., "Density-based clustering validation", 2014.
    .. [7] E. Levina, P. Bickel, "Maximum likelihood estimation of intrinsic dimension", 2005.
    .. [8] P. Rousseeuw, "Silhouettes: a graphical aid to the interpretation and validation of cluster analysis", 1987.
    .. [9] U. von Luxburg, "Clustering stability: an overview", 2010.
    .. [10] C. Williams, M. Seeger, "Using the Nyström method to speed up kernel machines", 2001.

    Examples
    --------
    >>> import numpy as np
    >>> from cornercase import ScenarioClustering
    >>> place = np.r_[np.linspace(0, 1, 20), np.linspace(9, 10, 20)]
    >>> distances = abs(place[:, None] - place)
    >>> model = ScenarioClustering().fit(distances)
    >>> model.predict(abs(np.array([0.5, 9.5])[:, None] - place)).tolist() == [model.labels_[0], model.labels_[-1]]
    True
    """

    def __init__(
        self,
        gamma: float | Literal["auto"] = "auto",
        eps: float | Literal["auto"] = "auto",
        min_samples: int | Literal["auto"] = "auto",
        n_components: int | Literal["auto"] = "auto",
        method: ClusteringMethod = "dbscan",
        landmarks: int | Literal["auto"] | None = "auto",
    ) -> None:
        self.gamma, self.eps, self.min_samples = gamma, eps, min_samples
        self.n_components, self.method, self.landmarks = n_components, method, landmarks

    def fit(self, distances: npt.ArrayLike, y: Any = None) -> Self:
        """Cluster.

        Parameters
        ----------
        distances : array_like, shape (n, n)
            Symmetric, zero on the diagonal, finite, in any unit.
        y : None
            Not used.

        Returns
        -------
        ScenarioClustering
            Itself.

        Raises
        ------
        InputError
            Not a distance matrix, or a parameter out of range.
        """
        self.require_settings()
        matrix = _checked(distances)
        # A scenario that two clusters touch joins the one that is found first: no order but this one may decide it.
        self._spanning = canonical_order(matrix)
        count = self._landmark_count(len(matrix))
        if count < len(matrix):
            self._spanning = self._spanning[np.sort(np.random.default_rng(0).choice(len(matrix), count, replace=False))]
        within = matrix[np.ix_(self._spanning, self._spanning)]
        self._known = search_settings(
            within,
            gamma=self.gamma if self.gamma == "auto" else float(self.gamma),
            eps=self.eps if self.eps == "auto" else float(self.eps),
            min_samples=self.min_samples if self.min_samples == "auto" else int(self.min_samples),
            n_components=self.n_components if self.n_components == "auto" else int(self.n_components),
            method=self.method,
        )
        self._scale = self._known.scale or 1.0
        with threadpool_limits(limits=1):
            self._space = KernelSpace(self._known.gamma, self._known.embedding.shape[1]).fit(within / self._scale)
            found = self._extended(matrix) if count < len(matrix) else self._as_given()
        self.result_: Clustering = found
        self.labels_, self.embedding_, self.candidates_ = found.labels, found.embedding, found.candidates
        self.gamma_, self.eps_, self.min_samples_ = found.gamma, found.eps, found.min_samples
        self.landmarks_, self.n_features_in_ = found.landmarks, len(matrix)
        return self

    def require_settings(self) -> None:
        """Refuse settings that are out of range; `fit` does it too.

        Raises
        ------
        InputError
            One is.
        """
        if self.method not in get_args(ClusteringMethod):
            raise InputError(f"`method` {self.method}: {suggestion(str(self.method), get_args(ClusteringMethod))}")
        if not _whole(self.n_components, 1) and self.n_components != "auto":
            raise InputError(f"`n_components` {self.n_components!r}: give a whole number of at least 1, or 'auto'.")
        # HDBSCAN takes a radius of 0: then it merges no clusters.
        for name, value, least in (("gamma", self.gamma, False), ("eps", self.eps, self.method == "hdbscan")):
            if isinstance(value, str) and value == "auto":
                continue
            number = isinstance(value, (int, float, np.number)) and not isinstance(value, bool)
            if not number or not (0 < value < math.inf or (least and value == 0)):
                raise InputError(f"`{name}` {value!r}: give a number above 0, or 'auto'.")
        if not _whole(self.min_samples, 1) and self.min_samples != "auto":
            raise InputError(f"`min_samples` {self.min_samples!r}: give a whole number of at least 1, or 'auto'.")
        if self.landmarks not in ("auto", None) and not _whole(self.landmarks, 2):
            raise InputError(f"`landmarks` {self.landmarks!r}: give a whole number of at least 2, None or 'auto'.")

    def transform(self, distances: npt.ArrayLike) -> FloatArray:
        """Place new scenarios in the kernel space.

        Parameters
        ----------
        distances : array_like, shape (m, n)
            From each new scenario to those that were clustered.

        Returns
        -------
        ndarray of float64, shape (m, n_components)
            Coordinates in kernel space.

        Raises
        ------
        InputError
            There are not n distances of each, or one is not finite or negative.
        """
        matrix = np.asarray(distances, dtype=np.float64)
        if matrix.ndim != 2 or matrix.shape[1] != self.n_features_in_:
            raise InputError(
                f"Distances of shape {matrix.shape} do not fit the {self.n_features_in_} scenarios that were clustered."
            )
        if not np.isfinite(matrix).all() or (matrix < 0.0).any():
            raise InputError("A distance is negative or not finite; give finite distances of at least 0.")
        with threadpool_limits(limits=1):
            return self._space.transform(matrix[:, self._spanning] / self._scale)

    def predict(self, distances: npt.ArrayLike) -> IntArray:
        """Assign new scenarios to the clusters that are there, without changing these.

        As DBSCAN would, each goes to the cluster of the nearest dense scenario within its neighbourhood, and is noise
        where there is none.

        Parameters
        ----------
        distances : array_like, shape (m, n)
            From each new scenario to those that were clustered.

        Returns
        -------
        ndarray of int64, shape (m,)
            Cluster of each; -1 is noise.

        Raises
        ------
        InputError
            As `transform`.
        """
        return join_nearest(self.transform(distances), self._known)

    def kernel_lost(self, distances: FloatArray, between: FloatArray) -> float:
        """Measure how much of the kernel of new scenarios is lost when it is rebuilt from that of those clustered.

        Parameters
        ----------
        distances : ndarray of float64, shape (m, n)
            From each new scenario to those that were clustered.
        between : ndarray of float64, shape (m, m)
            Between the new ones.

        Returns
        -------
        float
            As `Clustering.error`.
        """
        with threadpool_limits(limits=1):
            return self._space.error(distances[:, self._spanning] / self._scale, between / self._scale, _SMALLEST)

    def _as_given(self) -> Clustering:
        """Clusters of all scenarios, in the order in which these were given."""
        place = np.argsort(self._spanning)
        return replace(self._known, labels=self._known.labels[place], embedding=self._known.embedding[place])

    def _extended(self, matrix: FloatArray) -> Clustering:
        """Clusters of the landmarks, joined by all others."""
        landmarks = self._spanning
        embedding = self._space.transform(matrix[:, landmarks] / self._scale)
        embedding[landmarks] = self._known.embedding
        labels = join_nearest(embedding, self._known)
        labels[landmarks] = self._known.labels
        others = np.setdiff1d(np.arange(len(matrix)), landmarks)
        some = others[:: math.ceil(len(others) / MOST_SCORED)]
        error = self._space.error(
            matrix[np.ix_(some, landmarks)] / self._scale, matrix[np.ix_(some, some)] / self._scale
        )
        labels = order_by_size(labels)
        # The order of sizes may be another with all scenarios; new ones join under the final labels.
        self._known = replace(self._known, labels=labels[landmarks])
        return replace(self._known, labels=labels, embedding=embedding, landmarks=np.sort(landmarks), error=error)

    def _landmark_count(self, n: int) -> int:
        if self.landmarks == "auto":
            return LANDMARKS if n > MOST_EXACT else n
        return n if self.landmarks is None else int(self.landmarks)


def cluster(
    distances: npt.ArrayLike,
    *,
    gamma: float | Literal["auto"] = "auto",
    eps: float | Literal["auto"] = "auto",
    min_samples: int | Literal["auto"] = "auto",
    n_components: int | Literal["auto"] = "auto",
    method: ClusteringMethod = "dbscan",
    landmarks: int | Literal["auto"] | None = "auto",
) -> Clustering:
    """Cluster scenarios by their distances.

    Parameters
    ----------
    distances : array_like, shape (n, n)
        Symmetric, zero on the diagonal, finite, in any unit.
    gamma, eps : float or "auto"
        Kernel width, and radius of the neighbourhood in the embedding.
    min_samples : int or "auto"
        Least number of scenarios in a dense neighbourhood.
    n_components : int or "auto"
        Dimensions of the embedding.
    method : {"dbscan", "hdbscan"}
        Algorithm that finds the clusters.
    landmarks : int, "auto" or None
        Number of scenarios that span the kernel space. All settings as in `ScenarioClustering`.

    Returns
    -------
    Clustering
        The clusters, and the settings that they were found with.

    Raises
    ------
    InputError
        Not a distance matrix, or a parameter out of range.

    See Also
    --------
    ScenarioClustering : The estimator behind it, which also assigns new scenarios.
    """
    model = ScenarioClustering(
        gamma=gamma,
        eps=eps,
        min_samples=min_samples,
        n_components=n_components,
        method=method,
        landmarks=landmarks,
    )
    return model.fit(distances).result_


def _whole(value: object, least: int) -> bool:
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool) and bool(value >= least)


def _checked(distances: npt.ArrayLike) -> FloatArray:
    matrix = np.asarray(distances, dtype=np.float64)
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or not len(matrix):
        raise InputError(f"A distance matrix of shape {matrix.shape} is not square; give shape (n, n), n >= 1.")
    if not np.isfinite(matrix).all() or (matrix < 0).any():
        i, j = np.argwhere(~np.isfinite(matrix) | (matrix < 0))[0]
        raise InputError(f"The distance of {i} and {j} is {matrix[i, j]}; give finite distances of at least 0.")
    if not np.array_equal(matrix, matrix.T) or matrix.diagonal().any():
        raise InputError("The distance matrix is not symmetric with a zero diagonal; give distances both ways.")
    return matrix
