"""Selection of scenarios that kill as many mutants of a driver as possible."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray
from cornercase.reduction.exposure import ExposingChoice, Exposure
from cornercase.reduction.kept import ALIKE
from cornercase.reduction.reduced_set import ReducedSet

# Factor of a mutant's weight for each selected scenario that kills it.
_AGAIN: Final = 0.5

# Number of mutants that are named as the reason for a scenario.
_NAMED: Final = 3

# Tolerance for ties between gains.
_SAME: Final = 1e-12


def choose_exposing(exposed: BoolArray, apart: Callable[[Sequence[int]], FloatArray], size: int) -> list[int]:
    """Select at most `size` scenarios that kill as many mutants as possible, each of them several times.

    Greedily adds the scenario that kills most, where a mutant counts half as much with each selected scenario that
    kills it already. The sum of these counts is submodular, so the result reaches at least 63 % of the maximum (G. L.
    Nemhauser, L. A. Wolsey, M. L. Fisher, "An analysis of approximations for maximizing submodular set functions",
    1978). Ties go to the scenario farthest from the selected ones; similar ones are skipped. `kills`, shape (n, m),
    says which scenario kills which mutant; `distances_to` returns distances to all, like `Selection.distances_to`.
    """
    n_kills = np.zeros(exposed.shape[1])
    is_candidate = exposed.any(axis=1)
    selected: list[int] = []
    gap = np.full(len(exposed), np.inf)
    while len(selected) < size and is_candidate.any():
        gains = np.where(is_candidate, exposed @ _AGAIN**n_kills, 0.0)
        best = np.flatnonzero(gains >= gains.max() - _SAME)
        selected.append(int(best[gap[best].argmax()]))
        is_candidate[selected[-1]] = False
        n_kills += exposed[selected[-1]]
        np.minimum(gap, apart(selected[-1:])[0], out=gap)
        is_candidate &= gap > ALIKE
    return selected


def with_exposure(reduced: ReducedSet, exposure: Exposure, without: Sequence[int]) -> ReducedSet:
    """Add to a reduced set which mutants it kills, compared with the scenarios selected without mutants."""
    scenarios, already_killed = [], np.zeros(len(exposure.mutants), dtype=np.bool_)
    for scenario, exposed in zip(reduced.kept, exposure.rows_of(reduced.ids), strict=True):
        scenarios.append(
            replace(scenario, why=_why(exposure, exposed, already_killed)) if scenario.role == "exposing" else scenario
        )
        already_killed |= exposed
    other_mutants = exposure.held_out
    choice = ExposingChoice(
        driver=exposure.driver,
        requirements=exposure.requirements,
        candidates=len(exposure.scenarios),
        chosen_by=exposure.grade(reduced.ids),
        held_out=None if other_mutants is None else other_mutants.grade(reduced.ids),
        without=None if other_mutants is None else other_mutants.grade(without),
    )
    return replace(reduced, kept=tuple(scenarios), exposing=choice)


def _why(exposure: Exposure, exposed: BoolArray, known: BoolArray) -> str:
    text = f"exposes {int(exposed.sum())} of {len(exposed)} mutants of {exposure.driver}"
    newly_killed = [exposure.mutants[i].driver for i in np.flatnonzero(exposed & ~known)]
    if not newly_killed:
        return f"{text}, all of which others expose too"
    more = f" and {len(newly_killed) - _NAMED} more" if len(newly_killed) > _NAMED else ""
    return f"{text}, as the first {', '.join(newly_killed[:_NAMED])}{more}"
