"""Linear algebra by one thread, and several results side by side."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from typing import TypeVar

from threadpoolctl import ThreadpoolController

from cornercase._common.platform import available_cpus

_Value = TypeVar("_Value")
_Result = TypeVar("_Result")


@contextmanager
def one_thread() -> Iterator[None]:
    """Let NumPy and SciPy use one thread, so that sums have one order and results do not depend on their number.

    The libraries are looked up once, which takes longer than many a result here; so whoever uses this has imported
    what of SciPy they call.
    """
    with _libraries().limit(limits=1):
        yield


def side_by_side(function: Callable[[_Value], _Result], values: Iterable[_Value]) -> list[_Result]:
    """Call a function with each of several values, on as many threads as there are CPUs.

    Linear algebra has one thread in each of the calls, so that what comes out does not hang on how many there are.

    Parameters
    ----------
    function : callable
        Of one value; what it does must not hang on other calls.
    values : iterable

    Returns
    -------
    list
        What the calls return, in the order of the values.
    """
    # Held until all have ended: a call that ended within another's would give that one its threads back.
    with one_thread(), ThreadPoolExecutor(available_cpus()) as pool:
        return list(pool.map(function, values))


@cache
def _libraries() -> ThreadpoolController:
    return ThreadpoolController()
