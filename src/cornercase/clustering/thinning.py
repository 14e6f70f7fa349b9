"""Every so many instants of a series, for comparisons that would take too long with all."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from cornercase._common.typing import FloatArray

INSTANTS: Final = 100
"""Instants of a typical series that are compared, at most."""


def instants_apart(lengths: Sequence[int]) -> int:
    """Say of how many instants one is enough.

    Parameters
    ----------
    lengths : sequence of int
        Instants of some of the recordings.

    Returns
    -------
    int
        At least 1: as many as leave the recording of median length 100 instants at most.
    """
    return max(1, math.ceil(float(np.median(lengths)) / INSTANTS))


def thinned(series: FloatArray, every: int) -> FloatArray:
    """Take every so-many-th instant, and the last.

    Parameters
    ----------
    series : ndarray of float64, shape (T,) or (T, k)
    every : int
        At least 1.

    Returns
    -------
    ndarray of float64, shape (S,) or (S, k)
    """
    if every == 1:
        return series
    return np.concatenate((series[:-1:every], series[-1:]))
