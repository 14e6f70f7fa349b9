"""The space of a Gaussian kernel of distances, and where scenarios lie in it."""

from __future__ import annotations

from typing import Self

import numpy as np
from scipy.linalg import eigvalsh, lstsq
from sklearn.decomposition import KernelPCA

from cornercase._common.typing import FloatArray


class KernelSpace:
    """Leading components of the kernel ``exp(-gamma * d**2)``, by kernel PCA.

    Parameters
    ----------
    gamma : float
        The larger, the narrower is the kernel.
    n_components : int
        Axes beyond the rank of the kernel are 0.

    Attributes
    ----------
    embedding : ndarray of float64, shape (n, n_components)
        Coordinates of the scenarios that it was fitted to.
    explained : float
        Share of the variance in kernel space that the components keep, 0 to 1.

    Notes
    -----
    S. Mika et al., "Kernel PCA and de-noising in feature spaces", 1998. New scenarios are placed as C. Williams, M.
    Seeger, "Using the Nyström method to speed up kernel machines", 2001, say.
    """

    def __init__(self, gamma: float, n_components: int) -> None:
        self._gamma, self._n_components = gamma, n_components
        self.embedding: FloatArray = np.zeros((0, n_components))
        self.explained = 1.0

    def fit(self, distances: FloatArray) -> Self:
        """Find the components.

        Parameters
        ----------
        distances : ndarray of float64, shape (n, n)
            Divided by their scale.

        Returns
        -------
        KernelSpace
            Itself.
        """
        kernel = self._kernel(distances)
        n = len(kernel)
        self._known = kernel
        self.embedding, self.explained, self._pca = np.zeros((n, self._n_components)), 1.0, None
        centred = kernel - kernel.mean(axis=0)
        variance = float(np.trace(centred - centred.mean(axis=1)[:, None]))
        # Without variance there is nothing to project on.
        if n >= 2 and variance > 1e-12 * n:
            self._pca, found = _fitted(kernel, centred - centred.mean(axis=1)[:, None], min(self._n_components, n))
            self.embedding[:, : found.shape[1]] = found
            self.explained = float(min(1.0, self._pca.eigenvalues_.sum() / variance))
        return self

    def transform(self, distances: FloatArray) -> FloatArray:
        """Place further scenarios.

        Parameters
        ----------
        distances : ndarray of float64, shape (m, n)
            From each of them to those that were fitted, divided by the same scale.

        Returns
        -------
        ndarray of float64, shape (m, n_components)
            Coordinates in kernel space.
        """
        placed = np.zeros((len(distances), self._n_components))
        if self._pca is not None and len(distances):
            found = self._pca.transform(self._kernel(distances))
            placed[:, : found.shape[1]] = found
        return placed

    def error(self, to_known: FloatArray, between: FloatArray, smallest: float = 1e-10) -> float:
        """How much of the kernel of further scenarios is lost when it is rebuilt from the fitted ones.

        Parameters
        ----------
        to_known : ndarray of float64, shape (m, n)
            Distances from the further scenarios to the fitted ones.
        between : ndarray of float64, shape (m, m)
            Distances of the further scenarios from each other.
        smallest : float, default 1e-10
            Singular values of the kernel that are less than this share of the largest one count as rounding.

        Returns
        -------
        float
            Frobenius norm of the difference over that of the kernel.
        """
        cross, kernel = self._kernel(to_known), self._kernel(between)
        weights = lstsq(self._known, cross.T, cond=smallest)[0]
        return float(np.linalg.norm(kernel - cross @ weights) / np.linalg.norm(kernel))

    def _kernel(self, distances: FloatArray) -> FloatArray:
        # As far apart as that is as good as infinitely far.
        with np.errstate(over="ignore"):
            return np.asarray(np.exp(-self._gamma * distances**2))


def _fitted(kernel: FloatArray, centred: FloatArray, count: int) -> tuple[KernelPCA, FloatArray]:
    """Kernel PCA with so many components, or with as many as there are."""
    model = KernelPCA(count, kernel="precomputed", random_state=0)
    try:
        return model, model.fit_transform(kernel)
    except ValueError:
        # A kernel of warped distances need not be positive: beyond its positive axes there are none to project on.
        values = eigvalsh(centred)
        model = KernelPCA(max(1, int((values > 1e-9 * values[-1]).sum())), kernel="precomputed", random_state=0)
        return model, model.fit_transform(kernel)
