"""Selection of scenarios that kill (expose) as many mutants of a driver as possible."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray
from cornercase.reduction._kill_matrix import KillMatrix, MutantSelection
from cornercase.reduction._reduced_set import ReducedSet
from cornercase.reduction._selection_state import SIMILAR_SHARE

# Factor of a mutant's weight for each selected scenario that kills it.
_REPEATED_KILL_WEIGHT: Final = 0.5

# Number of mutants that are named as the reason for a scenario.
_MAX_NAMED_MUTANTS: Final = 3

# Tolerance for ties between gains.
_GAIN_TOLERANCE: Final = 1e-12


def select_killing(kills: BoolArray, distances_to: Callable[[Sequence[int]], FloatArray], size: int) -> list[int]:
    """Select at most `size` scenarios that kill as many mutants as possible, preferably more than once.

    A mutant is a driver made worse in one respect. A scenario kills a mutant if, in this scenario, the mutant violates
    a requirement and the original driver violates none. Step by step, the scenario whose killed mutants have the
    largest total weight is added. The weight of a mutant begins at 1, and is halved by each selected scenario that
    kills the mutant. If tied, the scenario farthest from the selected ones is added. Scenarios similar to a selected
    one are skipped. Without skipping, such a greedy selection reaches at least 63 % of the largest possible total (G.
    L. Nemhauser, L. A. Wolsey, M. L. Fisher, "An analysis of approximations for maximizing submodular set functions",
    1978).

    `kills`, shape (n, m), says which scenario kills which mutant. `distances_to` returns distances from the given
    scenarios to all scenarios, like `Selection.distances_to`.
    """
    n_kills = np.zeros(kills.shape[1])
    is_candidate = kills.any(axis=1)
    selected: list[int] = []
    gap = np.full(len(kills), np.inf)
    while len(selected) < size and is_candidate.any():
        gains = np.where(is_candidate, kills @ _REPEATED_KILL_WEIGHT**n_kills, 0.0)
        best = np.flatnonzero(gains >= gains.max() - _GAIN_TOLERANCE)
        selected.append(int(best[gap[best].argmax()]))
        is_candidate[selected[-1]] = False
        n_kills += kills[selected[-1]]
        np.minimum(gap, distances_to(selected[-1:])[0], out=gap)
        is_candidate &= gap > SIMILAR_SHARE
    return selected


def add_mutant_selection(
    reduced: ReducedSet, kill_matrix: KillMatrix, ids_without_mutants: Sequence[int]
) -> ReducedSet:
    """Add to a reduced set its mutation scores, and the scores of the set that was selected without mutants."""
    scenarios, already_killed = [], np.zeros(len(kill_matrix.mutants), dtype=np.bool_)
    for scenario, exposed in zip(reduced.scenarios, kill_matrix.kills_of(reduced.ids), strict=True):
        scenarios.append(
            replace(scenario, why=_describe_killed_mutants(kill_matrix, exposed, already_killed))
            if scenario.role == "exposing"
            else scenario
        )
        already_killed |= exposed
    other_mutants = kill_matrix.held_out
    choice = MutantSelection(
        driver=kill_matrix.driver,
        requirements=kill_matrix.requirements,
        candidates=len(kill_matrix.scenarios),
        chosen_by=kill_matrix.mutation_score(reduced.ids),
        held_out=None if other_mutants is None else other_mutants.mutation_score(reduced.ids),
        without=None if other_mutants is None else other_mutants.mutation_score(ids_without_mutants),
    )
    return replace(reduced, scenarios=tuple(scenarios), exposing=choice)


def _describe_killed_mutants(kill_matrix: KillMatrix, kills: BoolArray, already_killed: BoolArray) -> str:
    text = f"exposes {int(kills.sum())} of {len(kills)} mutants of {kill_matrix.driver}"
    newly_killed = [kill_matrix.mutants[i].driver for i in np.flatnonzero(kills & ~already_killed)]
    if not newly_killed:
        return f"{text}, all of which others expose too"
    more = f" and {len(newly_killed) - _MAX_NAMED_MUTANTS} more" if len(newly_killed) > _MAX_NAMED_MUTANTS else ""
    return f"{text}, as the first {', '.join(newly_killed[:_MAX_NAMED_MUTANTS])}{more}"
