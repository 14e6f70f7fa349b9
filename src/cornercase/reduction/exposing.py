"""Scenarios that expose as many mutants of a driver as possible."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray
from cornercase.reduction.exposure import ExposingChoice, Exposure
from cornercase.reduction.kept import ALIKE
from cornercase.reduction.reduced_set import ReducedSet

# How much a mutant counts with each chosen scenario more that exposes it.
_AGAIN: Final = 0.5

# So many mutants are named as what a scenario is kept for.
_NAMED: Final = 3

# Sums of halves that differ by less are the same.
_SAME: Final = 1e-12


def choose_exposing(exposed: BoolArray, apart: Callable[[Sequence[int]], FloatArray], size: int) -> list[int]:
    """Choose scenarios that expose as many mutants as possible, and each of them several times.

    One after the other, the scenario is added that exposes most, where a mutant counts half as much with each chosen
    scenario that exposes it already. The sum of these counts is submodular, so what is chosen reaches at least 63 % of
    the largest [1]_. Of scenarios that add the same, the one that is farthest from the chosen ones is taken, and none
    that is like a chosen one.

    Parameters
    ----------
    exposed : ndarray of bool, shape (n, m)
        Which scenario exposes which mutant.
    apart : callable, giving an ndarray of float64, shape (k, n)
        Gives for indices of scenarios the distances to all, of shape (k, n), as `Selection.apart` does.
    size : int
        At most so many.

    Returns
    -------
    list of int
        Indices in the order in which they were chosen; fewer where no other scenario exposes anything.

    References
    ----------
    .. [1] G. L. Nemhauser, L. A. Wolsey, M. L. Fisher, "An analysis of approximations for maximizing submodular set
       functions", 1978.
    """
    times = np.zeros(exposed.shape[1])
    left = exposed.any(axis=1)
    chosen: list[int] = []
    gap = np.full(len(exposed), np.inf)
    while len(chosen) < size and left.any():
        gains = np.where(left, exposed @ _AGAIN**times, 0.0)
        best = np.flatnonzero(gains >= gains.max() - _SAME)
        chosen.append(int(best[gap[best].argmax()]))
        left[chosen[-1]] = False
        times += exposed[chosen[-1]]
        np.minimum(gap, apart(chosen[-1:])[0], out=gap)
        left &= gap > ALIKE
    return chosen


def with_exposure(reduced: ReducedSet, exposure: Exposure, without: Sequence[int]) -> ReducedSet:
    """Say of a reduced set which mutants it exposes, and what that is worth.

    Parameters
    ----------
    reduced : ReducedSet
        Chosen by the mutants.
    exposure : Exposure
    without : sequence of int
        Ids of the scenarios that are kept without mutants.

    Returns
    -------
    ReducedSet
    """
    kept, known = [], np.zeros(len(exposure.mutants), dtype=np.bool_)
    for one, exposed in zip(reduced.kept, exposure.rows_of(reduced.ids), strict=True):
        kept.append(replace(one, why=_why(exposure, exposed, known)) if one.role == "exposing" else one)
        known |= exposed
    judge = exposure.held_out
    choice = ExposingChoice(
        driver=exposure.driver,
        requirements=exposure.requirements,
        candidates=len(exposure.scenarios),
        chosen_by=exposure.grade(reduced.ids),
        held_out=None if judge is None else judge.grade(reduced.ids),
        without=None if judge is None else judge.grade(without),
    )
    return replace(reduced, kept=tuple(kept), exposing=choice)


def _why(exposure: Exposure, exposed: BoolArray, known: BoolArray) -> str:
    said = f"exposes {int(exposed.sum())} of {len(exposed)} mutants of {exposure.driver}"
    first = [exposure.mutants[i].driver for i in np.flatnonzero(exposed & ~known)]
    if not first:
        return f"{said}, all of which others expose too"
    more = f" and {len(first) - _NAMED} more" if len(first) > _NAMED else ""
    return f"{said}, as the first {', '.join(first[:_NAMED])}{more}"
