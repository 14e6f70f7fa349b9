"""Concrete scenarios that stand for a space."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from cornercase._common.rows import row_keys
from cornercase._common.typing import FloatArray, IntArray
from cornercase.evidence.gaussian_process import encoded
from cornercase.scenario import ParameterSpace

_PLACES: Final = 2**14
# Constraints leave some of them; where that is fewer, as many are drawn again, at most so often.
_FEWEST, _MOST_TIMES = 2**12, 16
# Places around which balls are laid, and how many of the others say how large these are.
_CENTRES, _AROUND = 512, 8192
_SAME: Final = 1e-6
# Its multiples fill an interval evenly.
_GOLDEN: Final = (5.0**0.5 - 1.0) / 2.0


@dataclass(frozen=True, eq=False)
class Places:
    """Concrete scenarios of a space, each once, and the share of the space that each stands for.

    Attributes
    ----------
    points : ndarray of float64, shape (n, d)
        In the unit cube, in the order in which a Sobol' sequence meets them.
    encoded : ndarray of float64, shape (n, e)
        For a kernel.
    weights : ndarray of float64, shape (n,)
        They add up to 1.
    complete : bool
        Whether they are all scenarios of the space that have a probability.
    """

    points: FloatArray
    encoded: FloatArray
    weights: FloatArray
    complete: bool

    @classmethod
    def of(cls, space: ParameterSpace, seed: int) -> Places:
        """Choose places that stand for a space: all scenarios of a small one of steps and choices, else some.

        Parameters
        ----------
        space : ParameterSpace
        seed : int

        Returns
        -------
        Places
        """
        # The package takes half a second to load.
        from scipy.stats import qmc

        sizes = [one.size for one in space.parameters]
        complete = None not in sizes and math.prod(one or 1 for one in sizes) <= _PLACES
        sequence, points = qmc.Sobol(space.dimension, seed=np.random.default_rng([seed, 1])), np.zeros((0, len(sizes)))
        for _ in range(1 if complete else _MOST_TIMES):
            more = space.snap(sequence.random(_PLACES))
            points = np.concatenate([points, more[space.admits(more)]])
            if len(points) >= _FEWEST:
                break
        # Of a space of steps and choices the same scenario comes again: it is one place, which counts that often.
        number: dict[bytes, int] = {}
        of = np.array([number.setdefault(key, len(number)) for key in row_keys(points)])
        first = np.unique(of, return_index=True)[1]
        points, weights = points[first], np.bincount(of) / len(of)
        if complete:
            points, weights = _every(space, points, seed)
        return cls(points, encoded(space, points), weights, complete)

    def chosen(self, matters: FloatArray, count: int) -> tuple[IntArray, FloatArray]:
        """Choose some of the places, those above all that matter, so that sums over them stand for all.

        Parameters
        ----------
        matters : ndarray of float64, shape (n,)
            Above 0.
        count : int
            About how many, at most.

        Returns
        -------
        ndarray of int64, shape (m,)
        ndarray of float64, shape (m,)
            Share of the space that each stands for.
        """
        if len(self.weights) <= count:
            return np.arange(len(self.weights)), self.weights
        wanted = self.weights * matters
        share = np.minimum(count * wanted / wanted.sum(), 1.0)
        # Each place is chosen by itself, so that a last digit of one does not change which others are.
        at = np.flatnonzero(np.arange(len(share)) * _GOLDEN % 1.0 < share)
        return at, self.weights[at] / share[at]

    def empty(self, ran: FloatArray) -> FloatArray:
        """Shares of the space that the largest balls take which hold nothing that was run, around random places.

        A ball is all of the space that is no farther from its centre than so much; what would lie outside the space
        does not count.

        Parameters
        ----------
        ran : ndarray of float64, shape (m, e)
            Encoded.

        Returns
        -------
        ndarray of float64, shape (k,)
        """
        # Places of the sequence in their order are spread evenly, those around them too.
        centres, around = self.encoded[:_CENTRES], self.encoded[-_AROUND:]
        weights = self.weights[-_AROUND:] / self.weights[-_AROUND:].sum()
        # What is a rounding error away is the same place.
        nearest = _squares(centres, ran).min(axis=1) - _SAME
        return np.asarray((_squares(centres, around) < nearest[:, None]) @ weights)


def _every(space: ParameterSpace, met: FloatArray, seed: int) -> tuple[FloatArray, FloatArray]:
    """All scenarios of a finite space, those that were met first, and the share of the space that each stands for."""
    points = space.snap(space.lattice())
    points = points[space.admits(points)]
    known = set(row_keys(met))
    rest = points[[key not in known for key in row_keys(points)]]
    points = np.concatenate([met, np.random.default_rng([seed, 7]).permutation(rest)])
    weights = space.shares(points)
    there = weights > 0.0
    return points[there], weights[there] / weights.sum()


def _squares(a: FloatArray, b: FloatArray) -> FloatArray:
    """Squared distances, of which only the order matters: single precision is enough."""
    a, b = a.astype(np.float32), b.astype(np.float32)
    found = a @ (-2.0 * b).T
    found += (a * a).sum(axis=1)[:, None]
    found += (b * b).sum(axis=1)
    return np.asarray(found)
