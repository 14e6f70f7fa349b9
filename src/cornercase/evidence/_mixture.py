"""Mixtures of normal and t distributions, fitted to weighted points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from scipy.special import gammaln, logsumexp

from cornercase._common.typing import FloatArray

_STEPS: Final = 30
_COMPONENT_COUNTS: Final = (1, 2, 3, 4, 6, 8, 12)  # numbers of components that are tried
_PATIENCE: Final = 2  # stop after this many in a row that are no better
# Pseudo-points with isotropic scatter that are added to each component, for each dimension. Without them, few points
# make a component degenerate, and in many dimensions too narrow. Chosen on the half "choose" of benchmarks/rare.py.
_PRIOR_POINTS_PER_DIMENSION: Final = 2.0
# Variance of pseudo-points: the variance of the component, but at least this fraction of that of all components.
_MIN_POOLED_FRACTION: Final = 0.1
# Heavy tails keep the weights of single points small. Degrees of freedom are as many as dimensions, but at least this:
# in many dimensions nearly all points of a normal distribution have the same distance from its mean, and heavier tails
# would spread a proposal far beyond.
_MIN_DEGREES_OF_FREEDOM: Final = 3.0


@dataclass(frozen=True, eq=False)
class TMixture:
    """A mixture of K multivariate t distributions.

    `weights` (K,) sum to 1. `means` (K, d) are the locations. `scale_roots` (K, d, d) are lower triangular; the scale
    matrix of a component is the product of its root and the transpose. `degrees_of_freedom` (K,) are inf for a normal
    distribution.
    """

    weights: FloatArray
    means: FloatArray
    scale_roots: FloatArray
    degrees_of_freedom: FloatArray

    @classmethod
    def normal_around_zero(cls, dimension: int, deviation: float = 1.0) -> Self:
        """Make a normal distribution with mean 0 and the same standard deviation in all directions."""
        return cls(np.ones(1), np.zeros((1, dimension)), deviation * np.eye(dimension)[None], np.array([np.inf]))

    @classmethod
    def from_parts(cls, parts: list[tuple[float, TMixture]]) -> Self:
        """Combine several mixtures into a single mixture; `parts` are pairs of weight and mixture."""
        shares = np.concatenate([weight * part.weights for weight, part in parts])
        return cls(
            shares / shares.sum(),
            np.concatenate([part.means for _, part in parts]),
            np.concatenate([part.scale_roots for _, part in parts]),
            np.concatenate([part.degrees_of_freedom for _, part in parts]),
        )

    @classmethod
    def fit(cls, points: FloatArray, weights: FloatArray, rng: np.random.Generator) -> Self:
        """Fit a mixture to points (n, d) with weights (n,), not all 0; the number of components minimizes the BIC."""
        shares = weights / weights.sum()
        effective = 1.0 / float((shares**2).sum())
        dimension = points.shape[1]
        best: tuple[float, Self] | None = None
        worse = 0
        for count in _COMPONENT_COUNTS:
            free = count * (1 + dimension + dimension * (dimension + 1) / 2) - 1
            if best is not None and (worse >= _PATIENCE or count * (dimension + 2) > effective):
                break
            mixture = cls._fit_components(count, points, shares * effective, rng)
            likelihood = float(shares @ mixture.log_density(points, as_normal=True))
            loss = -2.0 * effective * likelihood + free * np.log(effective)
            worse += 1
            if best is None or loss < best[0]:
                best, worse = (loss, mixture), 0
        assert best is not None
        return best[1]

    @classmethod
    def _fit_components(cls, count: int, points: FloatArray, weights: FloatArray, rng: np.random.Generator) -> Self:
        """Fit a mixture of `count` components by expectation maximization, started by k-means++."""
        dimension = points.shape[1]
        n_prior, freedom = _PRIOR_POINTS_PER_DIMENSION * dimension, max(_MIN_DEGREES_OF_FREEDOM, dimension)
        centers = [points[rng.choice(len(points), p=weights / weights.sum())]]
        for _ in range(count - 1):
            squares = np.min([((points - center) ** 2).sum(1) for center in centers], axis=0) * weights
            total = squares.sum()
            centers.append(points[rng.choice(len(points), p=squares / total if total > 0 else None)])
        nearest = np.argmin([((points - center) ** 2).sum(1) for center in centers], axis=0)
        membership = (nearest[:, None] == np.arange(count)).astype(np.float64)
        for _ in range(_STEPS):
            mass = (membership * weights[:, None]).sum(0) + 1e-12
            means = (membership * weights[:, None]).T @ points / mass[:, None]
            scatters = np.empty((count, dimension, dimension))
            for k in range(count):
                offsets = points - means[k]
                scatters[k] = (offsets * (membership[:, k] * weights)[:, None]).T @ offsets
            own = np.trace(scatters, axis1=1, axis2=2) / (dimension * mass)
            pooled = float(np.trace(scatters, axis1=1, axis2=2).sum() / (dimension * mass.sum()))
            prior = (
                n_prior
                * np.maximum(np.maximum(own, _MIN_POOLED_FRACTION * pooled), 1e-12)[:, None, None]
                * np.eye(dimension)
            )
            roots = np.linalg.cholesky((scatters + prior) / (mass + n_prior)[:, None, None])
            mixture = cls(mass / mass.sum(), means, roots, np.full(count, freedom))
            densities = mixture._component_log_densities(points, as_normal=True)
            updated = np.exp(densities - logsumexp(densities, axis=1, keepdims=True))
            if np.abs(updated - membership).max() < 1e-3:
                break
            membership = updated
        return mixture

    def log_density(self, points: FloatArray, as_normal: bool = False) -> FloatArray:
        """Return the logarithm of the density at points (n, d), shape (n,); `as_normal` makes each component normal."""
        return np.asarray(logsumexp(self._component_log_densities(points, as_normal), axis=1))

    def _component_log_densities(self, points: FloatArray, as_normal: bool = False) -> FloatArray:
        """Return the logarithm of each component's contribution to the density at points (n, d), shape (n, K)."""
        dimension = points.shape[1]
        offsets = (points[None] - self.means[:, None]) @ np.linalg.inv(self.scale_roots).transpose(0, 2, 1)
        square = (offsets**2).sum(-1).T
        widths = np.log(np.diagonal(self.scale_roots, axis1=1, axis2=2)).sum(-1)
        scale = np.log(self.weights) - widths - 0.5 * dimension * np.log(2.0 * np.pi)
        heavy = np.isfinite(self.degrees_of_freedom)
        if as_normal or not heavy.any():
            return np.asarray(scale - 0.5 * square)
        densities = scale - 0.5 * square
        freedom = self.degrees_of_freedom[heavy]
        half = 0.5 * (freedom + dimension)
        scale = scale[heavy] + gammaln(half) - gammaln(0.5 * freedom) - 0.5 * dimension * np.log(0.5 * freedom)
        densities[:, heavy] = scale - half * np.log1p(square[:, heavy] / freedom)
        return np.asarray(densities)

    def draw_points(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Draw `count` points from the mixture, shape (count, d)."""
        which = rng.choice(len(self.weights), size=count, p=self.weights)
        steps = rng.standard_normal((count, self.means.shape[1]))
        heavy = np.isfinite(self.degrees_of_freedom[which])
        freedoms = np.where(heavy, self.degrees_of_freedom[which], 1.0)
        stretch = np.where(heavy, np.sqrt(freedoms / rng.chisquare(freedoms)), 1.0)
        return np.asarray(
            self.means[which] + stretch[:, None] * np.einsum("nij,nj->ni", self.scale_roots[which], steps)
        )
