"""Temporal operators in discrete time, by RTAMT."""

from __future__ import annotations

import importlib
from math import floor
from typing import Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray, IntArray

_MOST: Final = 100_000
"""Places that instants of uneven distance are laid on at most."""

_CLOSE: Final = 1e-6
"""Share of a step that is rounding."""


def always(values: FloatArray, interval: tuple[float, float] | None, time: FloatArray) -> FloatArray:
    """Least value in an interval ahead of each instant.

    Parameters
    ----------
    values : ndarray of float64, shape (T,)
        Without NaN.
    interval : tuple of two float, or None
        Begin and end in s; inf, or no interval, for the end of the recording.
    time : ndarray of float64, shape (T,)
        s, increasing.

    Returns
    -------
    ndarray of float64, shape (T,)
        inf where no instant is in the interval.

    Raises
    ------
    InputError
        The extra ``stl`` is not installed.
    """
    return _over("always", values, interval, time)


def eventually(values: FloatArray, interval: tuple[float, float] | None, time: FloatArray) -> FloatArray:
    """Greatest value in an interval ahead of each instant.

    Parameters
    ----------
    values, interval, time
        As of `always`.

    Returns
    -------
    ndarray of float64, shape (T,)
        -inf where no instant is in the interval.

    Raises
    ------
    InputError
        The extra ``stl`` is not installed.
    """
    return _over("eventually", values, interval, time)


def until(left: FloatArray, right: FloatArray, interval: tuple[float, float] | None, time: FloatArray) -> FloatArray:
    """How far the left lasts until the right holds at an instant in an interval.

    Parameters
    ----------
    left, right : ndarray of float64, shape (T,)
        Without NaN. The left has to hold at all instants before the one of the right, not at that one.
    interval, time
        As of `always`.

    Returns
    -------
    ndarray of float64, shape (T,)
        -inf where no instant is in the interval.

    Raises
    ------
    InputError
        The extra ``stl`` is not installed.

    Notes
    -----
    RTAMT's own operator with an interval takes the square of the interval's instants for each instant. With the
    rewriting of Donzé, Ferrère and Maler 2013 ("Efficient robust monitoring for STL") the same value takes no more than
    the other operators: the right holds somewhere in the interval, and from its begin on the left lasts until the
    right holds.
    """
    if interval is None:
        return _evaluate("l0 until r0", [("l0", left), ("r0", right)])
    source, place, begin, end = _steps(interval, time)
    one, two = left[source], right[source]
    text = f"eventually[{begin}:{end}](r0) and eventually[{begin}:{begin}](l1 until r1)"
    fed = [("r0", two), ("l1", one), ("r1", two)]
    if begin > 0:
        text += f" and always[0:{begin - 1}](l0)"
        fed.append(("l0", one))
    return _evaluate(text, fed)[place]


def _over(operator: str, values: FloatArray, interval: tuple[float, float] | None, time: FloatArray) -> FloatArray:
    if interval is None:
        return _evaluate(f"{operator}(p0)", [("p0", values)])
    source, place, begin, end = _steps(interval, time)
    return _evaluate(f"{operator}[{begin}:{end}](p0)", [("p0", values[source])])[place]


def _steps(interval: tuple[float, float], time: FloatArray) -> tuple[IntArray, IntArray, int, int]:
    """Which instant each place shows, the place of each instant, and the interval in steps from place to place."""
    count = len(time)
    span = float(time[-1] - time[0])
    # Of one instant, whatever is later is beyond the end.
    step = span / (count - 1) if count > 1 else float(np.finfo(np.float64).tiny)
    source = place = np.arange(count)
    # Even enough that each instant is the one nearest to where it would be.
    if count > 1 and np.abs(time - time[0] - place * step).max() >= 0.5 * step:
        step = float(np.diff(time).min())
        if span / step > _MOST:
            raise InputError(
                f"The recording has instants {step:g} s apart in {span:g} s, which is too uneven for intervals of a"
                " formula; give it even steps."
            )
        place = np.ceil((time - time[0]) / step - _CLOSE).astype(np.intp)
        source = np.searchsorted(place, np.arange(place[-1] + 1), side="right") - 1
    # Beyond the end there is nothing to look at, however far.
    begin, end = (floor(min(bound / step + 0.5, len(source))) for bound in interval)
    return source, place, begin, end


def require_rtamt() -> None:
    """Refuse to go on where RTAMT is not installed.

    Raises
    ------
    InputError
        It is not.
    """
    try:
        importlib.import_module("rtamt")
    except ImportError as error:
        raise InputError(
            "RTAMT, which follows temporal operators, is not installed; it comes with pip install 'cornercase[stl]' and"
            " a Python of 3.12 or earlier."
        ) from error


def _evaluate(text: str, fed: list[tuple[str, FloatArray]]) -> FloatArray:
    require_rtamt()
    import rtamt

    specification = rtamt.StlDiscreteTimeOfflineSpecification()
    for name, _ in fed:
        specification.declare_var(name, "float")
    specification.spec = text
    specification.parse()
    count = len(fed[0][1])
    # It counts in steps, so bounds are whole numbers of them. It pads lists in place, so each variable has one of its
    # own; and it cannot do with a single time.
    data = {name: values.tolist() for name, values in fed} | {"time": list(range(max(count, 2)))}
    return np.array([value for _, value in specification.evaluate(data)][:count], dtype=np.float64)
