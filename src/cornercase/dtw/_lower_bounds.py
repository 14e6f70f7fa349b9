"""Lower bounds of DTW distances, with which distant pairs of series are skipped without computing their distance."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator, call-arg"

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from cornercase._common.numba.kernel import kernel
from cornercase._common.typing import BoolArray

# Relative rounding error of a bound.
_ROUNDING = 1e-9
_TINY = 1e-150


def find_pairs_within_distance(
    series: Sequence[npt.NDArray[np.floating[Any]]], distance: float, squared: bool
) -> BoolArray:
    """Return the mask of the pairs of series that may be at most `distance` apart, shape (n, n), symmetric.

    Each point of a series is matched with some point of the other series. So the cost of this match is at least the
    distance of the point to the bounding box of the other series. The sum of these costs is a lower bound, with any
    window. If costs are `squared`, the bound is the root of the sum.
    """
    lengths = np.array([len(values_of_series) for values_of_series in series], dtype=np.int64)
    starts = np.concatenate(([0], np.cumsum(lengths)))
    points = np.concatenate(series).astype(np.float64)
    low = np.stack([values_of_series.min(axis=0) for values_of_series in series]).astype(np.float64)
    high = np.stack([values_of_series.max(axis=0) for values_of_series in series]).astype(np.float64)
    possible = np.ones((len(series), len(series)), dtype=np.bool_)
    limit = distance * (1.0 + _ROUNDING) + _TINY
    _exclude_distant_pairs(points, starts, low, high, limit * limit if squared else limit, squared, possible)
    return possible & possible.T


@kernel()
def _exclude_distant_pairs(values, starts, low, high, limit, squared, possible):
    dims = low.shape[1]
    for i in range(len(low)):
        for j in range(len(low)):
            total = 0.0
            for t in range(starts[i], starts[i + 1]):
                cost = 0.0
                for d in range(dims):
                    excess = max(low[j, d] - values[t, d], values[t, d] - high[j, d], 0.0)
                    cost += excess * excess
                total += cost if squared else math.sqrt(cost)
                if total > limit:
                    possible[i, j] = False
                    break
