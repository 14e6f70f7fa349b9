"""Temporal operators of logical expressions in discrete time."""

from __future__ import annotations

from math import floor
from typing import Final

import numpy as np
from scipy.ndimage import minimum_filter1d

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray, IntArray

_MAX_GRID_SIZE: Final = 100_000  # points of the even grid that uneven instants are put on
_STEP_TOLERANCE: Final = 1e-6  # fraction of a step


def always(values: FloatArray, interval: tuple[float, float] | None, time: FloatArray) -> FloatArray:
    """Return the smallest value in an interval after each instant, shape (T,).

    `interval` is start and end in s after the instant, each rounded to steps of the grid from `_even_grid`. If it is
    None, or the end is inf, it extends to the end of the recording. The result is inf if the rounded interval begins
    after the last instant.
    """
    if interval is None:
        return np.asarray(np.minimum.accumulate(values[::-1])[::-1])
    source, index, begin, end = _even_grid(interval, time)
    return _least_ahead(values[source], begin, end)[index]


def until(left: FloatArray, right: FloatArray, interval: tuple[float, float] | None, time: FloatArray) -> FloatArray:
    """Return the robustness of ``left until right`` from each instant on, shape (T,).

    `right` has to hold at an instant in the interval, and `left` at all instants before that instant. `interval` is as
    in `always`; the result is -inf if the rounded interval begins after the last instant.

    With an interval the formula is rewritten as in Donzé, Ferrère and Maler 2013 ("Efficient robust monitoring for
    STL"), as a conjunction of three parts: `right` holds at some time in the interval; `left` holds before the
    interval; from the start of the interval on, `left` holds until `right` does.
    """
    if interval is None:
        return _until_the_end(left, right)
    source, index, begin, end = _even_grid(interval, time)
    left, right = left[source], right[source]
    later = np.full(len(left), -np.inf)
    later[: max(0, len(left) - begin)] = _until_the_end(left, right)[begin:]
    held = _least_ahead(left, 0, begin - 1) if begin else np.inf
    return np.minimum(np.minimum(-_least_ahead(-right, begin, end), later), held)[index]


def _until_the_end(left: FloatArray, right: FloatArray) -> FloatArray:
    robustness, value = np.empty(len(left)), -np.inf
    for k in range(len(left) - 1, -1, -1):
        robustness[k] = value = max(right[k], min(left[k], value))
    return robustness


def _least_ahead(values: FloatArray, begin: int, end: int) -> FloatArray:
    """Return the smallest of the values that are `begin` to `end` steps ahead of each value.

    Beyond the last value, all values count as inf.
    """
    count = len(values)
    padded = np.full(count + end + 1, np.inf)
    padded[:count] = values
    size = end - begin + 1
    # The filter's window begins size // 2 before the index; values beyond the array count as the last, which is inf.
    least = minimum_filter1d(padded[begin:], size, mode="nearest", origin=-(size // 2))
    return np.concatenate([least[:count], np.full(max(0, count - len(least)), np.inf)])


def _even_grid(interval: tuple[float, float], time: FloatArray) -> tuple[IntArray, IntArray, int, int]:
    """Map the instants to an even grid of times, and convert the interval to steps of this grid.

    Return the instant of each grid point, the grid point of each instant, and the first and last step of the interval.
    """
    count = len(time)
    span = float(time[-1] - time[0])
    # With a single instant, everything later is beyond the end.
    step = span / (count - 1) if count > 1 else float(np.finfo(np.float64).tiny)
    source = index = np.arange(count)
    # Use the instants as grid if each is nearest to its own point of an even grid.
    if count > 1 and np.abs(time - time[0] - index * step).max() >= 0.5 * step:
        step = float(np.diff(time).min())
        if span / step > _MAX_GRID_SIZE:
            raise InputError(
                f"The time steps of the recording are too uneven for intervals of an expression: the shortest step has"
                f" {step:g} s in a recording of {span:g} s; resample the recording with even steps."
            )
        index = np.ceil((time - time[0]) / step - _STEP_TOLERANCE).astype(np.intp)
        source = np.searchsorted(index, np.arange(index[-1] + 1), side="right") - 1
    # Limited to the length of the grid, since nothing lies beyond the end.
    begin, end = (floor(min(limit / step + 0.5, len(source))) for limit in interval)
    return source, index, begin, end
