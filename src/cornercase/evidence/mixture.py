"""Mixtures of normal and t distributions that are fitted to weighted points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from scipy.special import gammaln, logsumexp

from cornercase._common.typing import FloatArray

_STEPS: Final = 30
# Numbers of components that are tried.
_COUNTS: Final = (1, 2, 3, 4, 6, 8, 12)
# After so many in a row that are no better, no more are.
_MOST_WORSE: Final = 2
# So many points that scatter alike in all directions are added to each component, so that few give no needle.
_PRIOR_POINTS: Final = 2.0
# Their variance is that of the component, but never below this share of that of all components.
_LEAST_OF_ALL: Final = 0.1
# Light tails would let single points weigh much.
_FREEDOM: Final = 3.0


@dataclass(frozen=True, eq=False)
class Mixture:
    """A mixture of K multivariate t distributions.

    Attributes
    ----------
    shares : ndarray of float64, shape (K,)
        They sum to 1.
    means : ndarray of float64, shape (K, d)
    roots : ndarray of float64, shape (K, d, d)
        Lower triangular; each times its transpose is the scale of a component.
    freedoms : ndarray of float64, shape (K,)
        Degrees of freedom; inf for a normal distribution.
    """

    shares: FloatArray
    means: FloatArray
    roots: FloatArray
    freedoms: FloatArray

    @classmethod
    def around_zero(cls, dimension: int, deviation: float = 1.0) -> Self:
        """Make the normal distribution around 0 with the same deviation in all directions.

        Parameters
        ----------
        dimension : int
        deviation : float, default 1.0

        Returns
        -------
        Mixture
            Of one component.
        """
        return cls(np.ones(1), np.zeros((1, dimension)), deviation * np.eye(dimension)[None], np.array([np.inf]))

    @classmethod
    def together(cls, parts: list[tuple[float, Mixture]]) -> Self:
        """Mix mixtures.

        Parameters
        ----------
        parts : list of (float, Mixture)
            Each with its weight.

        Returns
        -------
        Mixture
        """
        shares = np.concatenate([weight * one.shares for weight, one in parts])
        rest = [np.concatenate([getattr(one, name) for _, one in parts]) for name in ("means", "roots", "freedoms")]
        return cls(shares / shares.sum(), *rest)

    @classmethod
    def fitted(cls, points: FloatArray, weights: FloatArray, rng: np.random.Generator) -> Self:
        """Fit a mixture to weighted points, with as many components as the Bayesian information criterion wants.

        Parameters
        ----------
        points : ndarray of float64, shape (n, d)
        weights : ndarray of float64, shape (n,)
            Not negative, and not all 0.
        rng : Generator

        Returns
        -------
        Mixture
        """
        shares = weights / weights.sum()
        effective = 1.0 / float((shares**2).sum())
        dimension = points.shape[1]
        best: tuple[float, Self] | None = None
        worse = 0
        for count in _COUNTS:
            free = count * (1 + dimension + dimension * (dimension + 1) / 2) - 1
            if best is not None and (worse >= _MOST_WORSE or count * (dimension + 2) > effective):
                break
            one = cls._with(count, points, shares * effective, rng)
            loss = -2.0 * effective * float(shares @ one.log_density(points, normal=True)) + free * np.log(effective)
            worse += 1
            if best is None or loss < best[0]:
                best, worse = (loss, one), 0
        assert best is not None
        return best[1]

    @classmethod
    def _with(cls, count: int, points: FloatArray, weights: FloatArray, rng: np.random.Generator) -> Self:
        """Fit so many components by expectation and maximisation, begun as k-means++ begins."""
        dimension = points.shape[1]
        chosen = [points[rng.choice(len(points), p=weights / weights.sum())]]
        for _ in range(count - 1):
            apart = np.min([((points - one) ** 2).sum(1) for one in chosen], axis=0) * weights
            total = apart.sum()
            chosen.append(points[rng.choice(len(points), p=apart / total if total > 0 else None)])
        nearest = np.argmin([((points - one) ** 2).sum(1) for one in chosen], axis=0)
        belongs = (nearest[:, None] == np.arange(count)).astype(np.float64)
        for _ in range(_STEPS):
            mass = (belongs * weights[:, None]).sum(0) + 1e-12
            means = (belongs * weights[:, None]).T @ points / mass[:, None]
            scatters = np.empty((count, dimension, dimension))
            for k in range(count):
                apart = points - means[k]
                scatters[k] = (apart * (belongs[:, k] * weights)[:, None]).T @ apart
            own = np.trace(scatters, axis1=1, axis2=2) / (dimension * mass)
            pooled = float(np.trace(scatters, axis1=1, axis2=2).sum() / (dimension * mass.sum()))
            prior = (
                _PRIOR_POINTS
                * np.maximum(np.maximum(own, _LEAST_OF_ALL * pooled), 1e-12)[:, None, None]
                * np.eye(dimension)
            )
            roots = np.linalg.cholesky((scatters + prior) / (mass + _PRIOR_POINTS)[:, None, None])
            one = cls(mass / mass.sum(), means, roots, np.full(count, _FREEDOM))
            each = one._log_densities(points, normal=True)
            new = np.exp(each - logsumexp(each, axis=1, keepdims=True))
            if np.abs(new - belongs).max() < 1e-3:
                break
            belongs = new
        return one

    def log_density(self, points: FloatArray, normal: bool = False) -> FloatArray:
        """Return the logarithm of the density.

        Parameters
        ----------
        points : ndarray of float64, shape (n, d)
        normal : bool, default False
            Take all components for normal ones.

        Returns
        -------
        ndarray of float64, shape (n,)
        """
        return np.asarray(logsumexp(self._log_densities(points, normal), axis=1))

    def _log_densities(self, points: FloatArray, normal: bool = False) -> FloatArray:
        """Logarithm of each component's share of the density, (n, K)."""
        dimension = points.shape[1]
        away = (points[None] - self.means[:, None]) @ np.linalg.inv(self.roots).transpose(0, 2, 1)
        square = (away**2).sum(-1).T
        widths = np.log(np.diagonal(self.roots, axis1=1, axis2=2)).sum(-1)
        scale = np.log(self.shares) - widths - 0.5 * dimension * np.log(2.0 * np.pi)
        heavy = np.isfinite(self.freedoms)
        if normal or not heavy.any():
            return np.asarray(scale - 0.5 * square)
        found = scale - 0.5 * square
        freedom = self.freedoms[heavy]
        half = 0.5 * (freedom + dimension)
        scale = scale[heavy] + gammaln(half) - gammaln(0.5 * freedom) - 0.5 * dimension * np.log(0.5 * freedom)
        found[:, heavy] = scale - half * np.log1p(square[:, heavy] / freedom)
        return np.asarray(found)

    def draw(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Draw points.

        Parameters
        ----------
        count : int
        rng : Generator

        Returns
        -------
        ndarray of float64, shape (count, d)
        """
        which = rng.choice(len(self.shares), size=count, p=self.shares)
        steps = rng.standard_normal((count, self.means.shape[1]))
        heavy = np.isfinite(self.freedoms[which])
        freedoms = np.where(heavy, self.freedoms[which], 1.0)
        stretch = np.where(heavy, np.sqrt(freedoms / rng.chisquare(freedoms)), 1.0)
        return np.asarray(self.means[which] + stretch[:, None] * np.einsum("nij,nj->ni", self.roots[which], steps))
