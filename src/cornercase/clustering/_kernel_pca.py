"""Kernel PCA of a Gaussian kernel of distances, with projection of new scenarios."""

from __future__ import annotations

from typing import Self

import numpy as np
from scipy.linalg import eigvalsh, lstsq
from sklearn.decomposition import KernelPCA

from cornercase._common.typing import FloatArray


class KernelPca:
    """Kernel PCA with the Gaussian kernel ``exp(-gamma * d**2)`` of distances d.

    After `fit`, `embedding`, shape (n, n_components), has the coordinates; they are 0 on axes beyond the rank of the
    kernel. `explained` is the share of the variance that the components explain. S. Mika et al., "Kernel PCA and
    de-noising in feature spaces", 1998. New scenarios are projected as in C. Williams, M. Seeger, "Using the Nyström
    method to speed up kernel machines", 2001.
    """

    def __init__(self, gamma: float, n_components: int) -> None:
        self._gamma, self._n_components = gamma, n_components
        self.embedding: FloatArray = np.zeros((0, n_components))
        self.explained = 1.0

    def fit(self, distances: FloatArray) -> Self:
        """Fit the components to distances, shape (n, n), which the caller has divided by their scale (a median)."""
        kernel = self._gaussian_kernel(distances)
        n = len(kernel)
        self._fitted_kernel = kernel
        self.embedding, self.explained, self._pca = np.zeros((n, self._n_components)), 1.0, None
        # The trace of the centred kernel.
        variance = float(np.trace(kernel) - n * kernel.mean()) if n else 0.0
        # Without variance there is no component.
        if n >= 2 and variance > 1e-12 * n:
            self._pca, coordinates = _fit_kernel_pca(kernel, min(self._n_components, n))
            self.embedding[:, : coordinates.shape[1]] = coordinates
            self.explained = float(min(1.0, self._pca.eigenvalues_.sum() / variance))
        return self

    def transform(self, distances: FloatArray) -> FloatArray:
        """Return the coordinates of further scenarios, shape (m, n_components).

        `distances`, shape (m, n), lead from the further scenarios to the fitted scenarios. The caller has divided them
        by the same number as the distances for `fit`.
        """
        embedding = np.zeros((len(distances), self._n_components))
        if self._pca is not None and len(distances):
            coordinates = self._pca.transform(self._gaussian_kernel(distances))
            embedding[:, : coordinates.shape[1]] = coordinates
        return embedding

    def approximation_error(self, to_fitted: FloatArray, between: FloatArray, tolerance: float = 1e-10) -> float:
        """Return the relative error (Frobenius norm) of approximating the kernel between further scenarios.

        The approximation (Nyström) knows only the kernel between further and fitted scenarios. `to_fitted`, shape (m,
        n), are the distances from the m further to the n fitted scenarios; `between`, shape (m, m), are the distances
        between the further scenarios. Singular values below `tolerance` times the largest singular value are ignored as
        rounding errors.
        """
        cross, kernel = self._gaussian_kernel(to_fitted), self._gaussian_kernel(between)
        weights = lstsq(self._fitted_kernel, cross.T, cond=tolerance)[0]
        return float(np.linalg.norm(kernel - cross @ weights) / np.linalg.norm(kernel))

    def _gaussian_kernel(self, distances: FloatArray) -> FloatArray:
        # The kernel of a distance whose square overflows is 0.
        with np.errstate(over="ignore"):
            exponents: FloatArray = distances * distances
            exponents *= -self._gamma
            return np.exp(exponents, out=exponents)


def _fit_kernel_pca(kernel: FloatArray, n_components: int) -> tuple[KernelPCA, FloatArray]:
    """Fit a kernel PCA, and return the model and the coordinates of the scenarios.

    There are `n_components` components, or fewer if fewer eigenvalues are positive.
    """
    model = KernelPCA(n_components, kernel="precomputed", random_state=0)
    try:
        return model, model.fit_transform(kernel)
    except ValueError:
        # A kernel of DTW distances need not be positive definite; only axes with positive eigenvalues are usable.
        centred = kernel - kernel.mean(axis=0)
        values = eigvalsh(centred - centred.mean(axis=1)[:, None])
        model = KernelPCA(max(1, int((values > 1e-9 * values[-1]).sum())), kernel="precomputed", random_state=0)
        return model, model.fit_transform(kernel)
