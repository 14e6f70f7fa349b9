"""Temporal operators in discrete time, evaluated by RTAMT."""

from __future__ import annotations

import importlib
from math import floor
from typing import Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray, IntArray

_MAX_GRID_SIZE: Final = 100_000  # points of the even grid that uneven instants are put on
_STEP_TOLERANCE: Final = 1e-6  # fraction of a step


def always(values: FloatArray, interval: tuple[float, float] | None, time: FloatArray) -> FloatArray:
    """Least of the values (T,) in an interval ahead of each instant; inf if no instant is in the interval.

    `interval` is start and end in s; an end of inf, or no interval, means the end of the recording. InputError if the
    extra ``stl`` is not installed.
    """
    return _apply_operator("always", values, interval, time)


def eventually(values: FloatArray, interval: tuple[float, float] | None, time: FloatArray) -> FloatArray:
    """Greatest of the values (T,) in an interval ahead of each instant, as `always`; -inf if no instant is in it."""
    return _apply_operator("eventually", values, interval, time)


def until(left: FloatArray, right: FloatArray, interval: tuple[float, float] | None, time: FloatArray) -> FloatArray:
    """Robustness of `left` until `right` at an instant in an interval, as `always`; -inf if no instant is in it.

    `left` has to hold at all instants before the one of `right`, not at that one. RTAMT's own operator with an interval
    has a cost per instant of the square of the interval's instants. The rewriting of Donzé, Ferrère and Maler 2013
    ("Efficient robust monitoring for STL") costs no more than the other operators: `right` holds somewhere in the
    interval, and from the start of the interval on `left` holds until `right` does.
    """
    if interval is None:
        return _evaluate_with_rtamt("l0 until r0", [("l0", left), ("r0", right)])
    source, index, begin, end = _even_grid(interval, time)
    left, right = left[source], right[source]
    text = f"eventually[{begin}:{end}](r0) and eventually[{begin}:{begin}](l1 until r1)"
    variables = [("r0", right), ("l1", left), ("r1", right)]
    if begin > 0:
        text += f" and always[0:{begin - 1}](l0)"
        variables.append(("l0", left))
    return _evaluate_with_rtamt(text, variables)[index]


def _apply_operator(
    operator: str, values: FloatArray, interval: tuple[float, float] | None, time: FloatArray
) -> FloatArray:
    if interval is None:
        return _evaluate_with_rtamt(f"{operator}(p0)", [("p0", values)])
    source, index, begin, end = _even_grid(interval, time)
    return _evaluate_with_rtamt(f"{operator}[{begin}:{end}](p0)", [("p0", values[source])])[index]


def _even_grid(interval: tuple[float, float], time: FloatArray) -> tuple[IntArray, IntArray, int, int]:
    """Instant of each grid point, grid point of each instant, and the interval in steps of the grid."""
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
                f"The recording has instants {step:g} s apart in {span:g} s, which is too uneven for intervals of a"
                " formula; give it even steps."
            )
        index = np.ceil((time - time[0]) / step - _STEP_TOLERANCE).astype(np.intp)
        source = np.searchsorted(index, np.arange(index[-1] + 1), side="right") - 1
    # Limited to the length of the grid, since nothing lies beyond the end.
    begin, end = (floor(min(limit / step + 0.5, len(source))) for limit in interval)
    return source, index, begin, end


def require_rtamt() -> None:
    """Raise InputError if RTAMT is not installed."""
    try:
        importlib.import_module("rtamt")
    except ImportError as error:
        raise InputError(
            "RTAMT, which evaluates temporal operators, is not installed; install it with pip install"
            " 'cornercase[stl]', on Python 3.12 or earlier."
        ) from error


def _evaluate_with_rtamt(text: str, variables: list[tuple[str, FloatArray]]) -> FloatArray:
    require_rtamt()
    import rtamt

    specification = rtamt.StlDiscreteTimeOfflineSpecification()
    for name, _ in variables:
        specification.declare_var(name, "float")
    specification.spec = text
    specification.parse()
    count = len(variables[0][1])
    # RTAMT counts in steps. It pads lists in place, so each variable needs its own list. It needs at least two times.
    data = {name: values.tolist() for name, values in variables} | {"time": list(range(max(count, 2)))}
    return np.array([value for _, value in specification.evaluate(data)][:count], dtype=np.float64)
