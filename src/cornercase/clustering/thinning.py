"""Downsampling of time series, for comparisons that would take too long with all instants."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from cornercase._common.typing import FloatArray

INSTANTS: Final = 100
"""Largest number of instants of a series of median length."""


def instants_apart(lengths: Sequence[int]) -> int:
    """Return the stride, at least 1, that leaves at most 100 instants of a series of median length."""
    return max(1, math.ceil(float(np.median(lengths)) / INSTANTS))


def thinned(series: FloatArray, every: int) -> FloatArray:
    """Take every `every`-th instant of a series, shape (T,) or (T, k), and the last one."""
    if every == 1:
        return series
    return np.concatenate((series[:-1:every], series[-1:]))
