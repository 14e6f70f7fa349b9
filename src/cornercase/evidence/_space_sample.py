"""Sample of concrete scenarios that represents a space."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from cornercase._common.row_keys import row_keys
from cornercase._common.typing import FloatArray, IntArray
from cornercase.evidence.gp._gaussian_process import encode_points
from cornercase.scenario import ParameterSpace

_BLOCK_SIZE: Final = 2**14  # points per block of the sequence
# Constraints reject some points. So blocks are drawn until this many points remain, up to a greatest number of blocks.
_MIN_POINTS, _MAX_BLOCKS = 2**12, 16
# Number of balls, and of points that measure their volumes.
_N_BALLS, _N_VOLUME_POINTS = 512, 8192
_DISTANCE_TOLERANCE: Final = 1e-6  # squared distance that is a rounding error
_GOLDEN_RATIO: Final = (5.0**0.5 - 1.0) / 2.0  # its multiples modulo 1 are spread evenly


@dataclass(frozen=True, eq=False)
class SpaceSample:
    """Distinct concrete scenarios of a space, and the fraction of the space that each represents.

    `points` (n, d) are in the unit cube, in the order of a Sobol' sequence. `encoded_points` (n, e) are coordinates for
    a kernel. `weights` (n,) sum to 1. `is_complete` is True if the sample contains every scenario of the space with a
    probability above 0.
    """

    points: FloatArray
    encoded_points: FloatArray
    weights: FloatArray
    is_complete: bool

    @classmethod
    def from_space(cls, space: ParameterSpace, seed: int) -> SpaceSample:
        """Sample a space: all scenarios if it is small and finite, otherwise quasi-random scenarios."""
        # Imported late, since it takes half a second.
        from scipy.stats import qmc

        complete = is_small_and_finite(space)
        sequence = qmc.Sobol(space.dimension, seed=np.random.default_rng([seed, 1]))
        points = np.zeros((0, space.dimension))
        for _ in range(1 if complete else _MAX_BLOCKS):
            more = space.snap(sequence.random(_BLOCK_SIZE))
            points = np.concatenate([points, more[space.is_admissible(more)]])
            if len(points) >= _MIN_POINTS:
                break
        # In a space of steps and choices scenarios repeat: each is kept once, weighted by its count.
        numbers: dict[bytes, int] = {}
        number = np.array([numbers.setdefault(key, len(numbers)) for key in row_keys(points)])
        first = np.unique(number, return_index=True)[1]
        points, weights = points[first], np.bincount(number) / len(number)
        if complete:
            points, weights = _all_scenarios(space, points, seed)
        return cls(points, encode_points(space, points), weights, complete)

    def subset(self, relevance: FloatArray, count: int) -> tuple[IntArray, FloatArray]:
        """Choose about `count` points, or all if there are fewer.

        Points with a higher `relevance` (n,), above 0, are more probable.

        Returns the indices (m,) and the fraction of the space that each point represents. Sums over the chosen points,
        weighted by these fractions, estimate sums over all points.
        """
        if len(self.weights) <= count:
            return np.arange(len(self.weights)), self.weights
        importance = self.weights * relevance
        probability = np.minimum(count * importance / importance.sum(), 1.0)
        # Points are chosen independently, so that the last digit of one does not affect the others.
        indices = np.flatnonzero(np.arange(len(probability)) * _GOLDEN_RATIO % 1.0 < probability)
        return indices, self.weights[indices] / probability[indices]

    def empty_ball_fractions(self, run: FloatArray) -> FloatArray:
        """Return, for k random centres, the volume (k,) of the largest ball that contains no point of `run` (m, e).

        Volumes are fractions of the space; parts of a ball outside the space do not count.
        """
        # Any contiguous part of the sequence is spread evenly.
        centers, others = self.encoded_points[:_N_BALLS], self.encoded_points[-_N_VOLUME_POINTS:]
        weights = self.weights[-_N_VOLUME_POINTS:] / self.weights[-_N_VOLUME_POINTS:].sum()
        radii = _squared_distances(centers, run).min(axis=1) - _DISTANCE_TOLERANCE
        return np.asarray((_squared_distances(centers, others) < radii[:, None]) @ weights)


def is_small_and_finite(space: ParameterSpace) -> bool:
    """Return whether a space has so few scenarios that its sample contains all of them."""
    sizes = [parameter.size for parameter in space.parameters]
    return None not in sizes and math.prod(size or 1 for size in sizes) <= _BLOCK_SIZE


def _all_scenarios(space: ParameterSpace, first: FloatArray, seed: int) -> tuple[FloatArray, FloatArray]:
    """Return all scenarios of a finite space with a probability above 0, and the fraction that each represents.

    The scenarios in `first` come first.
    """
    points = space.snap(space.full_factorial())
    points = points[space.is_admissible(points)]
    keys = set(row_keys(first))
    rest = points[[key not in keys for key in row_keys(points)]]
    points = np.concatenate([first, np.random.default_rng([seed, 7]).permutation(rest)])
    weights = space.probabilities(points)
    possible = weights > 0.0
    return points[possible], weights[possible] / weights.sum()


def _squared_distances(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return squared distances of all pairs of points, (n, m), in single precision, since only their order matters."""
    a, b = a.astype(np.float32), b.astype(np.float32)
    squares = a @ (-2.0 * b).T
    squares += (a * a).sum(axis=1)[:, None]
    squares += (b * b).sum(axis=1)
    return np.asarray(squares)
