"""Clustering of scenarios by kernel PCA and DBSCAN on a distance matrix, as a scikit-learn estimator."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Final, Literal, Self, get_args

import numpy as np
import numpy.typing as npt
from sklearn.base import BaseEstimator, ClusterMixin

from cornercase._common.errors import InputError, suggest_name
from cornercase._common.numba.blas import single_threaded_blas
from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering._auto_settings import MAX_SCORED, canonical_order, search_settings
from cornercase.clustering._clustering import Clustering, ClusteringMethod
from cornercase.clustering._density import assign_to_nearest_cluster, renumber_by_size
from cornercase.clustering._kernel_pca import KernelPca

# With more than MAX_WITHOUT_LANDMARKS scenarios, N_KERNEL_LANDMARKS of them span the kernel space.
MAX_WITHOUT_LANDMARKS: Final = 5000
N_KERNEL_LANDMARKS: Final = 2000
# Singular values below this share of the largest are rounding errors of single-precision distances.
_SINGULAR_VALUE_TOLERANCE: Final = 1e-7


class ScenarioClustering(ClusterMixin, BaseEstimator):  # type: ignore[misc]
    """Estimator that clusters scenarios by their distances, and assigns new scenarios to the existing clusters.

    The distances d become a Gaussian kernel ``exp(-gamma * (d / scale)**2)``, as in [1]_. Kernel PCA [2]_ projects the
    kernel to a few dimensions, and DBSCAN [3]_ finds the dense regions there. `scale` is the median distance of two
    scenarios that differ. So `gamma` has no unit and means the same for trajectories in metres and for courses of a
    metric in seconds. With `gamma` 1, the kernel has fallen to 1/e at the median distance; the larger `gamma`, the
    narrower the kernel.

    Parameters
    ----------
    gamma : float or "auto", default "auto"
        Factor in the exponent of the kernel, without unit.
    eps : float or "auto", default "auto"
        Radius of DBSCAN's neighbourhood in the embedding, without unit. HDBSCAN keeps parts of a cluster together if
        their distance is below `eps`.
    min_samples : int or "auto", default "auto"
        Number of scenarios that make a neighbourhood dense, including the scenario at its centre. ``"auto"`` first
        tries ``ln(n)`` of the n scenarios, rounded up and at least 3 [4]_. It takes 3 or twice the first number instead
        if the clusters then show better.
    n_components : int or "auto", default "auto"
        Dimensions of the embedding; the paper takes 3. ``"auto"`` is 3, or 6, 12 or 24 if there are more clusters than
        three dimensions can separate.
    method : {"dbscan", "hdbscan"}, default "dbscan"
        Algorithm that finds the clusters in the embedding. HDBSCAN [5]_ allows clusters of different density.
    landmarks : int, "auto" or None, default "auto"
        Number of scenarios, the landmarks, that span the kernel space. All other scenarios are projected onto this
        space [10]_ and join the cluster of the nearest dense landmark. None: there are no landmarks, and all scenarios
        span the space. ``"auto"``: 2,000 landmarks if there are more than 5,000 scenarios, otherwise no landmarks.

    Attributes
    ----------
    labels_ : ndarray of int64, shape (n,)
        Number of the cluster of each scenario: 0 is the largest cluster, -1 is noise.
    embedding_ : ndarray of float64, shape (n, n_components)
        Coordinates of the scenarios in kernel space.
    gamma_, eps_ : float
    min_samples_ : int
        Settings that were given or chosen.
    candidates_ : tuple of Candidate
        All settings that were tried.
    landmarks_ : ndarray of int64, shape (m,)
        Indices of the scenarios that span the kernel space; empty if all scenarios span it.
    result_ : Clustering
        All of these results, and how well the embedding represents the kernel.
    n_features_in_ : int
        Number n of scenarios.

    See Also
    --------
    cornercase.clustering.cluster : The same as a function.
    cornercase.analyze : Clusters the scenarios of a study.

    Notes
    -----
    ``"auto"`` has two steps.

    First, the clusters are estimated from the given distances. The hierarchy of mutual reachability [5]_ merges
    scenarios, the nearest first. Two groups stay separate if the gap between them is wide: in each group, a typical
    member has clearly more neighbours within the width of the gap than chance gives in a single cluster. What chance
    gives depends on the number of scenarios and on their intrinsic dimension [7]_. A gap of less than 5 % of the median
    distance does not separate clusters. So a single cluster is the default, and each further cluster needs evidence. A
    cluster can be as small as four scenarios if they are far enough from the other scenarios. For up to a hundred
    scenarios, all gaps are first tested together, since each single gap may be unclear. In this test, a cluster can be
    as small as three scenarios.

    Second, the search looks for settings with which kernel PCA and DBSCAN find these expected clusters: `gamma` on a
    fixed grid, and `eps` between the distances within clusters and the distances between clusters. The score of a
    candidate is the mean F-measure of its clusters and the expected clusters, less the share of noise. Up to 0.1 is
    subtracted if the same settings find other clusters in random parts of 80 % of the scenarios, at most 1,000 [9]_. Up
    to 0.02 is added for a wide gap between the clusters in the embedding. The highest score wins. All scenarios are one
    cluster if there are fewer than 5 scenarios, if the best candidate has a score below 0, or if its clusters and those
    of the random parts have a mean adjusted Rand index below 0.5. `Candidate.agreement` is how well each candidate
    matches the expected clusters. DBCV [6]_ and silhouette [8]_ are computed for comparison only.

    If `gamma` and `eps` are both given, nothing is searched: ``"auto"`` then stands for ``ln(n)``, rounded up and at
    least 3, as `min_samples`, and for 3 as `n_components`.

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
    >>> from cornercase.clustering import ScenarioClustering
    >>> x = np.r_[np.linspace(0, 1, 20), np.linspace(9, 10, 20)]
    >>> distances = abs(x[:, None] - x)
    >>> model = ScenarioClustering().fit(distances)
    >>> model.predict(abs(np.array([0.5, 9.5])[:, None] - x)).tolist() == [model.labels_[0], model.labels_[-1]]
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
        """Find the clusters of scenarios.

        Parameters
        ----------
        distances : array_like, shape (n, n)
            Symmetric, zero on the diagonal, finite, in any unit.
        y : None
            Not used.

        Returns
        -------
        ScenarioClustering
            This estimator.

        Raises
        ------
        InputError
            The array is no distance matrix, or a setting is out of range.
        """
        self.check_settings()
        matrix = _check_distance_matrix(distances)
        # The canonical order decides to which of two touching clusters a border point belongs.
        self._kernel_rows = canonical_order(matrix)
        count = self._choose_n_landmarks(len(matrix))
        if count < len(matrix):
            self._kernel_rows = self._kernel_rows[
                np.sort(np.random.default_rng(0).choice(len(matrix), count, replace=False))
            ]
        within = matrix[np.ix_(self._kernel_rows, self._kernel_rows)]
        self._fitted_clustering = search_settings(
            within,
            gamma=self.gamma if self.gamma == "auto" else float(self.gamma),
            eps=self.eps if self.eps == "auto" else float(self.eps),
            min_samples=self.min_samples if self.min_samples == "auto" else int(self.min_samples),
            n_components=self.n_components if self.n_components == "auto" else int(self.n_components),
            method=self.method,
        )
        self._scale = self._fitted_clustering.scale or 1.0
        with single_threaded_blas():
            self._space = KernelPca(self._fitted_clustering.gamma, self._fitted_clustering.embedding.shape[1]).fit(
                within / self._scale
            )
            result = self._extend_to_all(matrix) if count < len(matrix) else self._in_given_order()
        self.result_: Clustering = result
        self.labels_, self.embedding_, self.candidates_ = result.labels, result.embedding, result.candidates
        self.gamma_, self.eps_, self.min_samples_ = result.gamma, result.eps, result.min_samples
        self.landmarks_, self.n_features_in_ = result.landmarks, len(matrix)
        return self

    def check_settings(self) -> None:
        """Check the settings; `fit` checks them too.

        Raises
        ------
        InputError
            A setting is out of range.
        """
        if self.method not in get_args(ClusteringMethod):
            raise InputError(f"`method` {self.method}: {suggest_name(str(self.method), get_args(ClusteringMethod))}")
        if not _is_int_at_least(self.n_components, 1) and self.n_components != "auto":
            raise InputError(f"`n_components` {self.n_components!r}: give a whole number of at least 1, or 'auto'.")
        # For HDBSCAN a radius of 0 is valid: then it merges no clusters.
        for name, value, zero_allowed in (("gamma", self.gamma, False), ("eps", self.eps, self.method == "hdbscan")):
            if isinstance(value, str) and value == "auto":
                continue
            is_number = isinstance(value, (int, float, np.number)) and not isinstance(value, bool)
            if not is_number or not (0 < value < math.inf or (zero_allowed and value == 0)):
                raise InputError(f"`{name}` {value!r}: give a number above 0, or 'auto'.")
        if not _is_int_at_least(self.min_samples, 1) and self.min_samples != "auto":
            raise InputError(f"`min_samples` {self.min_samples!r}: give a whole number of at least 1, or 'auto'.")
        if self.landmarks not in ("auto", None) and not _is_int_at_least(self.landmarks, 2):
            raise InputError(f"`landmarks` {self.landmarks!r}: give a whole number of at least 2, None or 'auto'.")

    def transform(self, distances: npt.ArrayLike) -> FloatArray:
        """Embed new scenarios in the kernel space.

        Parameters
        ----------
        distances : array_like, shape (m, n)
            Distances from each new scenario to the scenarios that were clustered.

        Returns
        -------
        ndarray of float64, shape (m, n_components)
            Coordinates in kernel space.

        Raises
        ------
        InputError
            The shape is not (m, n), or a distance is negative or not finite.
        """
        matrix = np.asarray(distances, dtype=np.float64)
        if matrix.ndim != 2 or matrix.shape[1] != self.n_features_in_:
            raise InputError(
                f"Distances of shape {matrix.shape} do not fit the {self.n_features_in_} scenarios that were"
                f" clustered; give shape (m, {self.n_features_in_})."
            )
        if not np.isfinite(matrix).all() or (matrix < 0.0).any():
            raise InputError("A distance is negative or not finite; give finite distances of at least 0.")
        with single_threaded_blas():
            return self._space.transform(matrix[:, self._kernel_rows] / self._scale)

    def predict(self, distances: npt.ArrayLike) -> IntArray:
        """Assign new scenarios to the existing clusters, without changing the clusters.

        As in DBSCAN, a scenario is dense if at least `min_samples` scenarios are within the radius `eps`. A new
        scenario joins the cluster of the nearest dense scenario, or is noise if no dense scenario is within `eps`. With
        HDBSCAN, every scenario in a cluster counts as dense, and the radius is the largest distance from a scenario in
        a cluster to its `min_samples`-th neighbour, itself being the first, or to the second if `min_samples` is 1.

        Parameters
        ----------
        distances : array_like, shape (m, n)
            Distances from each new scenario to the scenarios that were clustered.

        Returns
        -------
        ndarray of int64, shape (m,)
            Number of the cluster of each new scenario; -1 is noise.

        Raises
        ------
        InputError
            The shape is not (m, n), or a distance is negative or not finite.
        """
        return assign_to_nearest_cluster(self.transform(distances), self._fitted_clustering)

    def kernel_approximation_error(self, distances: FloatArray, distances_between_new: FloatArray) -> float:
        """Return the relative error of approximating the kernel between new scenarios from the clustered scenarios.

        Parameters
        ----------
        distances : ndarray of float64, shape (m, n)
            Distances from each new scenario to the scenarios that were clustered.
        distances_between_new : ndarray of float64, shape (m, m)
            Distances between the new scenarios.

        Returns
        -------
        float
            Relative error, as in `Clustering.error`.
        """
        with single_threaded_blas():
            return self._space.approximation_error(
                distances[:, self._kernel_rows] / self._scale,
                distances_between_new / self._scale,
                _SINGULAR_VALUE_TOLERANCE,
            )

    def _in_given_order(self) -> Clustering:
        """Return the clusters of all scenarios, in the order in which the scenarios were given."""
        order = np.argsort(self._kernel_rows)
        return replace(
            self._fitted_clustering,
            labels=self._fitted_clustering.labels[order],
            embedding=self._fitted_clustering.embedding[order],
        )

    def _extend_to_all(self, matrix: FloatArray) -> Clustering:
        """Assign all scenarios to the clusters of the landmarks; return the clusters of all scenarios."""
        landmarks = self._kernel_rows
        embedding = self._space.transform(matrix[:, landmarks] / self._scale)
        embedding[landmarks] = self._fitted_clustering.embedding
        labels = assign_to_nearest_cluster(embedding, self._fitted_clustering)
        labels[landmarks] = self._fitted_clustering.labels
        others = np.setdiff1d(np.arange(len(matrix)), landmarks)
        sample = others[:: math.ceil(len(others) / MAX_SCORED)]
        error = self._space.approximation_error(
            matrix[np.ix_(sample, landmarks)] / self._scale, matrix[np.ix_(sample, sample)] / self._scale
        )
        labels = renumber_by_size(labels)
        # With all scenarios, another cluster may be the largest; new scenarios get the final numbers of clusters.
        self._fitted_clustering = replace(self._fitted_clustering, labels=labels[landmarks])
        return replace(
            self._fitted_clustering, labels=labels, embedding=embedding, landmarks=np.sort(landmarks), error=error
        )

    def _choose_n_landmarks(self, n: int) -> int:
        if self.landmarks == "auto":
            return N_KERNEL_LANDMARKS if n > MAX_WITHOUT_LANDMARKS else n
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
    gamma, eps, min_samples, n_components, method, landmarks : float, int or str
        Settings, as in `ScenarioClustering`.

    Returns
    -------
    Clustering
        The clusters, and the settings with which they were found.

    Raises
    ------
    InputError
        The array is no distance matrix, or a setting is out of range.

    See Also
    --------
    ScenarioClustering : The estimator behind this function, which also assigns new scenarios.

    Examples
    --------
    >>> import numpy as np
    >>> from cornercase.clustering import cluster
    >>> x = np.r_[np.linspace(0, 1, 20), np.linspace(9, 10, 10)]
    >>> cluster(abs(x[:, None] - x)).n_clusters
    2
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


def _is_int_at_least(value: object, minimum: int) -> bool:
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool) and bool(value >= minimum)


def _check_distance_matrix(distances: npt.ArrayLike) -> FloatArray:
    array = np.asarray(distances, dtype=np.float64)
    if array.ndim != 2 or array.shape[0] != array.shape[1] or not len(array):
        raise InputError(f"A distance matrix of shape {array.shape} is not square; give shape (n, n), n >= 1.")
    if not np.isfinite(array).all() or (array < 0).any():
        i, j = np.argwhere(~np.isfinite(array) | (array < 0))[0]
        raise InputError(
            f"The distance of scenarios {i} and {j} is {array[i, j]}; give finite distances of at least 0."
        )
    if not np.array_equal(array, array.T) or array.diagonal().any():
        raise InputError("The distance matrix has to be symmetric, with zeros on its diagonal.")
    return array
