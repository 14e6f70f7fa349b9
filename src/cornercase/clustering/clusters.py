"""Clusters of scenarios, and the settings that they were found with."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from cornercase._common.typing import FloatArray, IntArray

NOISE: Final = -1
"""Label of a scenario that is in no cluster."""

ClusteringMethod = Literal["dbscan", "hdbscan"]
"""How clusters are found in the kernel space."""


@dataclass(frozen=True)
class Candidate:
    """One setting that was tried.

    Attributes
    ----------
    gamma, eps : float
        Kernel width and neighbourhood.
    clusters : int
        Number of clusters found.
    noise : float
        Share of the scenarios in none.
    dbcv, silhouette : float
        Validity on the given distances, -1 to 1; NaN where it was not computed.
    stability : float
        Mean adjusted Rand index of these clusters with those found in ten random parts of 80 %; 1 by construction where
        all scenarios are one group, or noise. As validity, it is computed for those that could be the best and for the
        best of a few numbers of clusters, and NaN for others.
    score : float
        What ``"auto"`` maximises; -inf where nothing was searched. Without stability an upper bound of it.
    n_components, min_samples : int
        Dimensions of the embedding, and scenarios in a dense neighbourhood; 0 in a study of an early version.
    agreement : float
        How well these clusters match the kinds that the distances show, 0 to 1: the mean F-measure over kinds, or over
        clusters where that is less, so that small ones count as large ones. NaN where none were looked for.
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
    """Clusters of n scenarios.

    Attributes
    ----------
    labels : ndarray of int64, shape (n,)
        Cluster of each scenario, the largest cluster is 0; -1 is noise.
    embedding : ndarray of float64, shape (n, n_components)
        Coordinates in kernel space. The sign of an axis is such that its entry of largest magnitude is
        positive.
    gamma, eps : float
        Given or found.
    min_samples : int
        Given or found.
    scale : float
        Divisor of the distances; 0 where all distances are 0.
    explained : float
        Share of the variance in kernel space that the embedding keeps, 0 to 1.
    candidates : tuple of Candidate
        All settings that were tried.
    method : {"dbscan", "hdbscan"}
    landmarks : ndarray of int64, shape (m,)
        Scenarios that span the kernel space; empty where all do.
    error : float
        Of the approximation by landmarks: the root of the mean squared difference of kernel and approximated kernel
        over that of the kernel, between scenarios that are no landmarks; 0 without landmarks.
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
        """Mean adjusted Rand index with the clusters of random parts; None where it was not computed, or says nothing.

        Of settings by which all scenarios are one group, or noise, so are those of every part: that is 1 by
        construction. It also helps to choose among settings, so that it is no evidence of its own.
        """
        if len(np.unique(self.labels)) < 2:
            return None
        for one in self.candidates:
            chosen = (one.gamma, one.eps) == (self.gamma, self.eps)
            # A study of an early version does not say with how many each was tried.
            chosen = chosen and one.min_samples in (0, self.min_samples)
            chosen = chosen and one.n_components in (0, self.embedding.shape[1])
            if chosen and not math.isnan(one.stability):
                return one.stability
        return None

    @property
    def n_clusters(self) -> int:
        """Number of clusters, without noise."""
        return int(self.labels.max(initial=NOISE)) + 1

    @property
    def noise(self) -> float:
        """Share of the scenarios that are in no cluster."""
        return float(np.mean(self.labels == NOISE)) if len(self.labels) else 0.0

    def __repr__(self) -> str:
        return (
            f"Clustering({len(self.labels)} scenarios, {self.n_clusters} clusters, {self.noise:.0%} noise,"
            f" {self.method}, gamma={self.gamma:.4g}, eps={self.eps:.4g}, min_samples={self.min_samples})"
        )
