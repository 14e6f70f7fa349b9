"""Clusters of scenarios, and the settings with which they were found."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from cornercase._common.typing import FloatArray, IntArray

NOISE_LABEL: Final = -1
"""Label of a scenario that is in no cluster."""

ClusteringMethod = Literal["dbscan", "hdbscan"]
"""Algorithm that finds the clusters in kernel space."""


@dataclass(frozen=True)
class Candidate:
    """Settings that the search tried, and how good the resulting clusters are.

    Attributes
    ----------
    gamma, eps : float
        Factor of the Gaussian kernel (the larger, the narrower the kernel), and radius of DBSCAN's neighbourhood.
    clusters : int
        Number of clusters.
    noise : float
        Share of the scenarios in no cluster.
    dbcv, silhouette : float
        Validity indices of the clusters, computed from the given distances, -1 to 1; NaN if not computed.
    stability : float
        Ten random parts of 80 % of the scenarios, but of at most 1,000, are clustered with the same settings
        (`min_samples` is reduced in proportion). The stability is the mean adjusted Rand index of the clusters of all
        scenarios and those of a part. If all scenarios are in one cluster, or all are noise, it is the share of the
        parts that are not divided either. Stability and validity are computed only for the candidates with the highest
        scores, and for the best candidate of some numbers of clusters; they are NaN for other candidates.
    score : float
        Objective that ``"auto"`` maximizes; -inf without a search. If the stability is NaN, this is an upper bound.
    n_components, min_samples : int
        Dimensions of the embedding, and smallest number of scenarios in a dense neighbourhood. Both are 0 in a study
        that an early version of cornercase wrote.
    agreement : float
        Match of the candidate's clusters with the clusters expected from the distances, 0 to 1; NaN without a search.
        Each cluster is compared with the most similar cluster of the other clustering by the F-measure. The match is
        the mean over the candidate's clusters or over the expected clusters, whichever mean is lower. So small clusters
        count as much as large clusters.

    Examples
    --------
    >>> import numpy as np
    >>> from cornercase.clustering import cluster
    >>> x = np.r_[np.linspace(0, 1, 20), np.linspace(9, 10, 10)]
    >>> candidates = cluster(abs(x[:, None] - x)).candidates
    >>> best = max(candidates, key=lambda candidate: candidate.score)
    >>> best.clusters, best.noise, len(candidates) > 1
    (2, 0.0, True)
    """

    gamma: float
    eps: float
    clusters: int
    noise: float
    dbcv: float
    silhouette: float
    stability: float
    score: float
    n_components: int = 0
    min_samples: int = 0
    agreement: float = math.nan


@dataclass(frozen=True, eq=False, repr=False)
class Clustering:
    """Clusters of n scenarios, and the settings with which they were found.

    Attributes
    ----------
    labels : ndarray of int64, shape (n,)
        Number of the cluster of each scenario: 0 is the largest cluster, -1 is noise.
    embedding : ndarray of float64, shape (n, n_components)
        Coordinates in kernel space. Each axis is signed so that its entry of largest magnitude is positive, among the
        scenarios that span the space.
    gamma, eps : float
        Factor of the Gaussian kernel and radius of DBSCAN's neighbourhood, as given or found.
    min_samples : int
        Smallest number of scenarios in a dense neighbourhood, as given or found.
    scale : float
        Median of the distances above 0, by which all distances are divided; 0 if all distances are 0.
    explained : float
        Share of the variance in kernel space that the embedding keeps, 0 to 1.
    candidates : tuple of Candidate
        All settings that were tried.
    method : {"dbscan", "hdbscan"}
        Algorithm that found the clusters in kernel space.
    landmarks : ndarray of int64, shape (m,)
        Indices of the scenarios that span the kernel space; empty if all scenarios in which the clusters were found
        span it.
    error : float
        Relative error that landmarks cause: the kernel between other scenarios is approximated from their kernel with
        the landmarks. The error is the root mean square of the approximate minus the exact kernel, divided by the root
        mean square of the exact kernel. It is 0 without landmarks.

    Examples
    --------
    >>> import numpy as np
    >>> from cornercase.clustering import cluster
    >>> x = np.r_[np.linspace(0, 1, 20), np.linspace(9, 10, 10)]
    >>> clustering = cluster(abs(x[:, None] - x))
    >>> clustering.n_clusters, clustering.noise, clustering.labels[[0, -1]]
    (2, 0.0, array([0, 1]))
    """

    labels: IntArray
    embedding: FloatArray
    gamma: float
    eps: float
    min_samples: int
    scale: float
    explained: float
    candidates: tuple[Candidate, ...]
    method: ClusteringMethod
    landmarks: IntArray
    error: float

    @property
    def stability(self) -> float | None:
        """Mean adjusted Rand index of these clusters and those of random parts of the scenarios, -1 to 1.

        The stability is None if it was not computed, if all scenarios are in one cluster, or if all are noise. The
        search also uses the stability to choose the settings, so the stability is no independent evidence.
        """
        if len(np.unique(self.labels)) < 2:
            return None
        for candidate in self.candidates:
            is_chosen = (candidate.gamma, candidate.eps) == (self.gamma, self.eps)
            # Studies of early versions store 0 for both.
            is_chosen = is_chosen and candidate.min_samples in (0, self.min_samples)
            is_chosen = is_chosen and candidate.n_components in (0, self.embedding.shape[1])
            if is_chosen and not math.isnan(candidate.stability):
                return candidate.stability
        return None

    @property
    def n_clusters(self) -> int:
        """Number of clusters, without noise."""
        return int(self.labels.max(initial=NOISE_LABEL)) + 1

    @property
    def noise(self) -> float:
        """Share of the scenarios that are in no cluster."""
        return float(np.mean(self.labels == NOISE_LABEL)) if len(self.labels) else 0.0

    def __repr__(self) -> str:
        clusters = "1 cluster" if self.n_clusters == 1 else f"{self.n_clusters} clusters"
        return (
            f"<Clustering: {len(self.labels)} scenarios, {clusters}, {self.noise:.0%} noise,"
            f" {self.method}, gamma={self.gamma:.4g}, eps={self.eps:.4g}, min_samples={self.min_samples}>"
        )
