"""Compiled conditions of triggers, and the check for changes that the storyboard must see."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator, call-arg"

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import types

from cornercase._common.numba.angles import wrap_angle
from cornercase._common.numba.kernel import kernel
from cornercase._common.numba.late_kernels import LateKernels
from cornercase._common.numba.pointers import call_for_bool
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.simulators.builtin.kernels._box_overlap import entities_overlap
from cornercase.simulators.builtin.kernels._distances import (
    LONGITUDINAL_COMPONENT,
    MAGNITUDE,
    TOLERANCE,
    closing_speed,
    distance_to_entity,
    distance_to_point,
    vector_component,
)
from cornercase.simulators.builtin.kernels._simulation_state import SimulationState
from cornercase.simulators.builtin.world._state_layout import (
    AT_END_SINCE,
    GONE_X,
    GONE_Y,
    HEADING,
    ODOMETER,
    PRESENT,
    PULL_X,
    PULL_Y,
    SPEED,
    STANDING_SINCE,
    X,
    Y,
)

(
    CONSTANT_CONDITION,
    TIME_CONDITION,
    TRAVELED_DISTANCE_CONDITION,
    SPEED_CONDITION,
    RELATIVE_SPEED_CONDITION,
    ACCELERATION_CONDITION,
    STAND_STILL_CONDITION,
    END_OF_ROAD_CONDITION,
    COLLISION_CONDITION,
    REACH_POSITION_CONDITION,
    RELATIVE_DISTANCE_CONDITION,
    DISTANCE_CONDITION,
    TIME_HEADWAY_CONDITION,
    TIME_TO_COLLISION_CONDITION,
    RELATIVE_ANGLE_CONDITION,
) = range(15)
"""Kind of a leaf condition.

A `CONSTANT_CONDITION` holds if its first value is above 0; only the storyboard changes this value."""

GREATER, LESS, EQUAL, GREATER_OR_EQUAL, LESS_OR_EQUAL, NOT_EQUAL = range(6)
"""Rule by which a condition compares two values."""

MAX_HEADING_DIFFERENCE: Final = 0.05
"""rad; a position with an orientation is reached if the difference of headings is below this (esmini's value)."""

N_VALUES: Final = 4
"""Number of values that parametrize a leaf condition in each scenario."""

_kernel = kernel(error_model="numpy", _nrt=False)
# Inlined, since it is called once and passing the tables would cost more than the work.
_inlined_kernel = kernel(error_model="numpy", _nrt=False, forceinline=True)


class LeafCondition(NamedTuple):
    """A condition on an entity or a value, without the edge and the delay that a ``Condition`` in a file adds."""

    kind: int  # `TIME_CONDITION` and so on
    other: int = -1  # index of the other entity, or -1
    rule: int = 0  # `GREATER` and so on
    option: int = 0  # velocity component, kind of distance, or whether a heading is tested
    values: tuple[FloatArray, ...] = ()  # each (N,)


class ConditionSpec(NamedTuple):
    """A ``Condition`` of a trigger, expressed by leaf conditions on its triggering entities."""

    leaves: list[tuple[int, LeafCondition]]  # with indices of entities (-1: none); any leaf of an entity has to hold
    for_every_entity: bool  # whether it has to hold for all entities, not any
    is_memoryless: bool  # whether its leaves alone decide, since it has neither edge nor delay


class ConditionTable(NamedTuple):
    """Conditions of N scenarios as arrays for kernels.

    All T triggers together have G groups, all groups have C conditions, and all conditions have L leaf conditions.
    D is the number of delayed conditions plus signal controllers; both change at times that are known beforehand.
    """

    codes: IntArray  # (L, 5): kind, entity (-1 for none), other entity, rule, option
    values: FloatArray  # (N, L, 4)
    last_values: BoolArray  # (N, L): values when the storyboard was last evaluated
    conditions: IntArray  # (C, 3): range [first, last) of leaves, whether it has to hold for every entity
    groups: IntArray  # (G, 2): range [first, last) of conditions
    triggers: IntArray  # (T, 3): range [first, last) of groups, whether it is independent of earlier values
    is_watched: BoolArray  # (N, T): whether something waits for the trigger
    # (N, D): time in s of the oldest change that waits for its delay; inf for none. Signal controllers come last: for
    # them it is the start of the next phase, with a delay of 0.
    pending_since: FloatArray
    delay: FloatArray  # (N, D), s
    kernels: IntArray  # (1,): address of the kernel for the less frequent kinds of leaves


def build_condition_table(
    specs: list[list[list[ConditionSpec]]],
    others: list[ConditionSpec],
    delays: list[FloatArray],
    n_scenarios: int,
) -> ConditionTable:
    """Build the table of conditions for kernels.

    `specs` holds the conditions of each group of each trigger. `others` are the conditions that belong to triggers that
    Python evaluates; the leaf conditions of `others` come last in the table. `delays` has an array (N,) in s for each
    delayed condition and signal controller.
    """
    leaves: list[tuple[int, LeafCondition]] = []
    conditions: list[tuple[int, int, bool]] = []
    groups: list[tuple[int, int]] = []
    triggers: list[tuple[int, int, bool]] = []
    for trigger in specs:
        first_group = len(groups)
        for group in trigger:
            first_condition = len(conditions)
            for spec in group:
                conditions.append((len(leaves), len(leaves) + len(spec.leaves), spec.for_every_entity))
                leaves += spec.leaves
            groups.append((first_condition, len(conditions)))
        triggers.append((first_group, len(groups), all(spec.is_memoryless for group in trigger for spec in group)))
    leaves += [leaf for spec in others for leaf in spec.leaves]
    codes = [(leaf.kind, e, leaf.other, leaf.rule, leaf.option) for e, leaf in leaves]
    values = np.zeros((n_scenarios, len(leaves), N_VALUES))
    for c, (_, leaf) in enumerate(leaves):
        for k, value in enumerate(leaf.values):
            values[:, c, k] = value
    return ConditionTable(
        codes=np.array(codes, dtype=np.int64).reshape(-1, 5),
        values=values,
        last_values=np.zeros((n_scenarios, len(leaves)), dtype=np.bool_),
        conditions=np.array(conditions, dtype=np.int64).reshape(-1, 3),
        groups=np.array(groups, dtype=np.int64).reshape(-1, 2),
        triggers=np.array(triggers, dtype=np.int64).reshape(-1, 3),
        is_watched=np.zeros((n_scenarios, len(triggers)), dtype=np.bool_),
        pending_since=np.full((n_scenarios, len(delays)), np.inf),
        delay=np.array(delays, dtype=np.float64).reshape(len(delays), n_scenarios).T.copy(),
        kernels=_REMAINING_KERNEL.addresses,
    )


class Watchlist(NamedTuple):
    """Conditions of a scenario that can change before Python evaluates its storyboard the next time."""

    groups: IntArray  # (G + 1,): condition groups that may become true, then -1
    leaves: IntArray  # (L + 1,): leaves that may change, then -1


@kernel(error_model="numpy")
def alloc_watchlist(table):
    """Allocate a watchlist (conditions that can change) that is long enough for all conditions in a table."""
    groups, changing = table.groups.shape[0] + 1, table.codes.shape[0] + 1
    return Watchlist(np.empty(groups, dtype=np.int64), np.empty(changing, dtype=np.int64))


@_kernel
def fill_watchlist(table, watchlist, n):
    """Select the conditions of a scenario that can change before its storyboard is evaluated.

    Only the storyboard changes constant conditions. In a trigger with memory, a constant condition is left out unless
    its value has changed since the last evaluation. In any other trigger, a group is left out if one does not hold.
    """
    n_groups = n_leaves = 0
    for t in range(table.triggers.shape[0]):
        if not table.is_watched[n, t]:
            continue
        first, last, is_memoryless = table.triggers[t]
        for g in range(first, last):
            if not is_memoryless:
                for c in range(table.groups[g, 0], table.groups[g, 1]):
                    for k in range(table.conditions[c, 0], table.conditions[c, 1]):
                        if (
                            table.codes[k, 0] != CONSTANT_CONDITION
                            or (table.values[n, k, 0] > 0.0) != table.last_values[n, k]
                        ):
                            watchlist.leaves[n_leaves] = k
                            n_leaves += 1
            elif not _is_never_met(table, n, g):
                watchlist.groups[n_groups] = g
                n_groups += 1
    watchlist.groups[n_groups] = watchlist.leaves[n_leaves] = -1


@_kernel
def _is_never_met(table, n, group):
    for c in range(table.groups[group, 0], table.groups[group, 1]):
        k = table.conditions[c, 0]
        # A constant condition has one leaf.
        if k < table.conditions[c, 1] and table.codes[k, 0] == CONSTANT_CONDITION and not table.values[n, k, 0] > 0.0:
            return True
    return False


@_inlined_kernel
def is_unchanged(scene, table, watchlist, n):
    """Return False if Python has to evaluate the storyboard of a scenario now, otherwise True.

    Python has to do this if a trigger fires, if a condition changes in a trigger with memory (an edge or a delay), if a
    delay is over, or if a traffic signal controller begins a phase.
    """
    for d in range(table.pending_since.shape[1]):
        if table.pending_since[n, d] <= scene.time[n] - table.delay[n, d] + TOLERANCE:
            return False
    i = 0
    while watchlist.leaves[i] >= 0:
        if leaf_holds(scene, table, n, watchlist.leaves[i]) != table.last_values[n, watchlist.leaves[i]]:
            return False
        i += 1
    i = 0
    while watchlist.groups[i] >= 0:
        if _group_holds(scene, table, n, watchlist.groups[i]):
            return False
        i += 1
    return True


@_inlined_kernel
def _group_holds(scene, table, n, group):
    """Return whether all conditions of a group hold.

    A condition must hold for all of its entities or for at least one, as the scenario file says.
    """
    for c in range(table.groups[group, 0], table.groups[group, 1]):
        first, last, for_every = table.conditions[c]
        k, holding = first, for_every > 0
        while k < last and holding == (for_every > 0):
            e, holding = table.codes[k, 1], False
            while k < last and table.codes[k, 1] == e:
                holding = holding or leaf_holds(scene, table, n, k)
                k += 1
        if not holding:
            return False
    return True


@_kernel
def store_leaf_values(scene, table, n):
    """Store for all leaf conditions of a scenario whether they hold now."""
    for k in range(table.codes.shape[0]):
        if table.codes[k, 0] == COLLISION_CONDITION:
            # An action may have moved an entity since the last frame was recorded.
            table.last_values[n, k] = entities_overlap(scene, n, table.codes[k, 1], table.codes[k, 2])
        else:
            table.last_values[n, k] = leaf_holds(scene, table, n, k)


@_inlined_kernel
def leaf_holds(scene, table, n, leaf):
    """Return whether a leaf condition holds for its entity now."""
    kind, e, rule, values = table.codes[leaf, 0], table.codes[leaf, 1], table.codes[leaf, 3], table.values[n, leaf]
    time = scene.time[n]
    if kind == CONSTANT_CONDITION:
        return values[0] > 0.0
    if kind == TIME_CONDITION:
        return _compare(rule, time, values[0])
    state = scene.floats[n]
    if not scene.flags[n, PRESENT, e]:
        return False
    if kind == TRAVELED_DISTANCE_CONDITION:
        return state[ODOMETER, e] >= values[0]
    if kind == STAND_STILL_CONDITION:
        return time - state[STANDING_SINCE, e] > values[0]
    if kind == END_OF_ROAD_CONDITION:
        return time - state[AT_END_SINCE, e] > values[0] - TOLERANCE
    if kind == COLLISION_CONDITION:
        # The overlap with the lower row as first entity was computed when the last frame was recorded.
        other = table.codes[leaf, 2]
        return scene.overlaps[n, e, other] if e < other else entities_overlap(scene, n, e, other)
    return call_for_bool(_infrequent_leaf_holds, table.kernels[0], (scene, table, n, leaf))


@_kernel
def _infrequent_leaf_holds(scene, table, n, leaf):
    """Return whether a leaf condition of one of the less frequent kinds holds; its entity must be present."""
    kind, e, other = table.codes[leaf, 0], table.codes[leaf, 1], table.codes[leaf, 2]
    rule, option, values = table.codes[leaf, 3], table.codes[leaf, 4], table.values[n, leaf]
    state = scene.floats[n]
    if kind == SPEED_CONDITION:
        value = state[SPEED, e] if option == MAGNITUDE else vector_component(state, GONE_X, GONE_Y, e, e, option)
        return _compare(rule, value, values[0])
    if kind == ACCELERATION_CONDITION:
        if option != MAGNITUDE:
            return _compare(rule, vector_component(state, PULL_X, PULL_Y, e, e, option), values[0])
        size = math.hypot(state[PULL_X, e], state[PULL_Y, e])
        # Negative if against the heading.
        return _compare(
            rule,
            -size if vector_component(state, PULL_X, PULL_Y, e, e, LONGITUDINAL_COMPONENT) < 0.0 else size,
            values[0],
        )
    if kind == REACH_POSITION_CONDITION:
        is_near = math.hypot(values[0] - state[X, e], values[1] - state[Y, e]) < values[3]
        return is_near and (option == 0 or abs(wrap_angle(values[2] - state[HEADING, e])) < MAX_HEADING_DIFFERENCE)
    if kind == RELATIVE_ANGLE_CONDITION:
        heading = state[HEADING, e] if option > 0 else 0.0
        turn = heading - state[HEADING, other] if other >= 0 else heading
        return abs(wrap_angle(turn - values[0])) < values[1] + TOLERANCE
    if kind == DISTANCE_CONDITION:
        return _compare(rule, abs(distance_to_point(scene, n, e, values[0], values[1], option)), values[2])
    if kind == RELATIVE_SPEED_CONDITION:
        difference = state[SPEED, e] - state[SPEED, other]
        if option != MAGNITUDE:
            own_component = vector_component(state, GONE_X, GONE_Y, e, other, option)
            difference = own_component - vector_component(state, GONE_X, GONE_Y, other, other, option)
        return _compare(rule, difference, values[0]) and scene.flags[n, PRESENT, other]
    gap = distance_to_entity(scene, n, e, other, option)
    if kind == RELATIVE_DISTANCE_CONDITION:
        return _compare(rule, abs(gap), values[0]) and scene.flags[n, PRESENT, other]
    if kind == TIME_HEADWAY_CONDITION:
        is_defined = gap >= 0.0 and state[SPEED, e] >= TOLERANCE and scene.flags[n, PRESENT, other]
        return is_defined and _compare(rule, gap / state[SPEED, e], values[0])
    closing = closing_speed(state, e, other)
    if abs(gap) < TOLERANCE or abs(closing) < TOLERANCE or not scene.flags[n, PRESENT, other]:
        return False
    return gap / closing >= 0.0 and _compare(rule, gap / closing, values[0])


_REMAINING_KERNEL: Final = LateKernels({0: _infrequent_leaf_holds}, types.boolean)
_FREQUENT_KINDS: Final = (
    CONSTANT_CONDITION,
    TIME_CONDITION,
    TRAVELED_DISTANCE_CONDITION,
    STAND_STILL_CONDITION,
    END_OF_ROAD_CONDITION,
    COLLISION_CONDITION,
)


def compile_condition_kernel(scene: SimulationState, table: ConditionTable) -> None:
    """Compile the kernel of less frequent conditions if the table has any; call this before a compiled run."""
    are_needed = not set(table.codes[:, 0].tolist()).issubset(_FREQUENT_KINDS)
    _REMAINING_KERNEL.compile_needed([0] if are_needed else [], scene, table, types.int64, types.int64)


@_kernel
def _compare(rule, a, b):
    if rule == GREATER:
        return a > b + TOLERANCE
    if rule == LESS:
        return a < b - TOLERANCE
    if rule == GREATER_OR_EQUAL:
        return a >= b - TOLERANCE
    if rule == LESS_OR_EQUAL:
        return a <= b + TOLERANCE
    return (abs(a - b) <= TOLERANCE) == (rule == EQUAL)
