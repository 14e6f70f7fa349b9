"""Conditions in compiled code: whether anything that a trigger depends on has changed."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from cornercase._common.compiling import kernel
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.simulators.builtin.frames.boxes import overlap
from cornercase.simulators.builtin.frames.gaps import (
    ALL_WAYS,
    ALONG,
    TOLERANCE,
    closing_speed,
    component,
    gap_to,
    gap_to_place,
)
from cornercase.simulators.builtin.world.layout import (
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
    CONSTANT, CLOCK, TRAVELED, SPEED_IS, RELATIVE_SPEED, ACCELERATION_IS, STANDS, AT_END, COLLIDES, REACHES, APART,
    APART_FROM_PLACE, HEADWAY, TIME_TO_COLLISION, TURNED,
) = range(15)  # fmt: skip
"""Kind of a leaf. `CONSTANT_CONDITION`: only the storyboard changes it; its first value says whether it holds."""

GREATER, LESS, EQUAL, GREATER_OR_EQUAL, LESS_OR_EQUAL, NOT_EQUAL = range(6)
"""Rule of a comparison."""

ALIGNED: Final = 0.05
"""rad; a position with an orientation is reached if the heading differs by less (esmini's value)."""

VALUES: Final = 4
"""Number of values of a leaf in each scenario."""

_kernel = kernel(error_model="numpy", _nrt=False)
# Inlined, since it is called once and passing the tables would cost more than the work.
_part = kernel(error_model="numpy", _nrt=False, forceinline=True)


class Leaf(NamedTuple):
    """A by-entity or by-value condition without edge and delay."""

    kind: int  # `TIME_CONDITION` and so on
    other: int = -1  # row of the other entity, or -1
    rule: int = 0  # `GREATER` and so on
    option: int = 0  # velocity component, kind of distance, or whether a heading is tested
    values: tuple[FloatArray, ...] = ()  # each (N,)


class Asked(NamedTuple):
    """A condition of a trigger, made of leaf conditions."""

    leaves: list[tuple[int, Leaf]]  # with rows of entities (-1 for none); any leaf of an entity has to hold
    every: bool  # whether it has to hold for all entities, not any
    plain: bool  # whether it holds if its leaves do, without edge and delay


class Leaves(NamedTuple):
    """T triggers of N scenarios with G groups of C conditions with L leaves, D of which hold with a delay."""

    codes: IntArray  # (L, 5): kind, entity (-1 for none), other entity, rule, option
    values: FloatArray  # (N, L, 4)
    truth: BoolArray  # (N, L): values in the last frame that the storyboard has evaluated
    conditions: IntArray  # (C, 3): range [first, last) of leaves, whether it has to hold for every entity
    groups: IntArray  # (G, 2): range [first, last) of conditions
    triggers: IntArray  # (T, 3): range [first, last) of groups, whether it is independent of earlier values
    watched: BoolArray  # (N, T): whether something waits for the trigger
    pending: FloatArray  # (N, D): time in s of the oldest change that waits for its delay; inf for none
    delay: FloatArray  # (N, D), s


def gather_leaves(found: list[list[list[Asked]]], delays: list[FloatArray], scenarios: int) -> Leaves:
    """Build the condition tables of triggers, given by trigger and group, and the delays, arrays (N,)."""
    leaves: list[tuple[int, Leaf]] = []
    conditions: list[tuple[int, int, bool]] = []
    groups: list[tuple[int, int]] = []
    triggers: list[tuple[int, int, bool]] = []
    for trigger in found:
        first_group = len(groups)
        for group in trigger:
            first_condition = len(conditions)
            for spec in group:
                conditions.append((len(leaves), len(leaves) + len(spec.leaves), spec.every))
                leaves += spec.leaves
            groups.append((first_condition, len(conditions)))
        triggers.append((first_group, len(groups), all(spec.plain for group in trigger for spec in group)))
    codes = [(leaf.kind, e, leaf.other, leaf.rule, leaf.option) for e, leaf in leaves]
    values = np.zeros((scenarios, len(leaves), VALUES))
    for c, (_, leaf) in enumerate(leaves):
        for k, value in enumerate(leaf.values):
            values[:, c, k] = value
    return Leaves(
        codes=np.array(codes, dtype=np.int64).reshape(-1, 5),
        values=values,
        truth=np.zeros((scenarios, len(leaves)), dtype=np.bool_),
        conditions=np.array(conditions, dtype=np.int64).reshape(-1, 3),
        groups=np.array(groups, dtype=np.int64).reshape(-1, 2),
        triggers=np.array(triggers, dtype=np.int64).reshape(-1, 3),
        watched=np.zeros((scenarios, len(triggers)), dtype=np.bool_),
        pending=np.full((scenarios, len(delays)), np.inf),
        delay=np.array(delays, dtype=np.float64).reshape(len(delays), scenarios).T.copy(),
    )


class Watched(NamedTuple):
    """Conditions that can change in a scenario before its storyboard is evaluated."""

    groups: IntArray  # (G + 1,): condition groups that may become true, then -1
    leaves: IntArray  # (L + 1,): leaves that may change, then -1


@kernel(error_model="numpy")
def room_to_watch(leaves):
    """Allocate a `Watchlist`."""
    groups, changing = leaves.groups.shape[0] + 1, leaves.codes.shape[0] + 1
    return Watched(np.empty(groups, dtype=np.int64), np.empty(changing, dtype=np.int64))


@_kernel
def pick(leaves, watched, n):
    """Select what can change in a scenario; constants do not change until the storyboard is evaluated."""
    n_groups = n_leaves = 0
    for t in range(leaves.triggers.shape[0]):
        if not leaves.watched[n, t]:
            continue
        first, last, is_memoryless = leaves.triggers[t]
        for g in range(first, last):
            if not is_memoryless:
                for c in range(leaves.groups[g, 0], leaves.groups[g, 1]):
                    for k in range(leaves.conditions[c, 0], leaves.conditions[c, 1]):
                        if leaves.codes[k, 0] != CONSTANT or (leaves.values[n, k, 0] > 0.0) != leaves.truth[n, k]:
                            watched.leaves[n_leaves] = k
                            n_leaves += 1
            elif not _never_met(leaves, n, g):
                watched.groups[n_groups] = g
                n_groups += 1
    watched.groups[n_groups] = watched.leaves[n_leaves] = -1


@_kernel
def _never_met(leaves, n, g):
    for c in range(leaves.groups[g, 0], leaves.groups[g, 1]):
        k = leaves.conditions[c, 0]
        # A constant condition has one leaf.
        if k < leaves.conditions[c, 1] and leaves.codes[k, 0] == CONSTANT and not leaves.values[n, k, 0] > 0.0:
            return True
    return False


@_part
def stays(scene, leaves, watched, n):
    """Whether no trigger fires, and nothing has changed for triggers that depend on earlier values."""
    for d in range(leaves.pending.shape[1]):
        if leaves.pending[n, d] <= scene.time[n] - leaves.delay[n, d] + TOLERANCE:
            return False
    i = 0
    while watched.leaves[i] >= 0:
        if holds(scene, leaves, n, watched.leaves[i]) != leaves.truth[n, watched.leaves[i]]:
            return False
        i += 1
    i = 0
    while watched.groups[i] >= 0:
        if _met(scene, leaves, n, watched.groups[i]):
            return False
        i += 1
    return True


@_part
def _met(scene, leaves, n, g):
    """Whether all conditions of a group hold, each for any or every one of its entities."""
    for c in range(leaves.groups[g, 0], leaves.groups[g, 1]):
        first, last, for_every = leaves.conditions[c]
        k, holding = first, for_every > 0
        while k < last and holding == (for_every > 0):
            e, holding = leaves.codes[k, 1], False
            while k < last and leaves.codes[k, 1] == e:
                holding = holding or holds(scene, leaves, n, k)
                k += 1
        if not holding:
            return False
    return True


@_kernel
def take_down(scene, leaves, n):
    """Store the current values of all leaves of a scenario, to be compared with later."""
    for k in range(leaves.codes.shape[0]):
        leaves.truth[n, k] = holds(scene, leaves, n, k)


@_part
def holds(scene, leaves, n, k):
    """Whether a leaf condition holds for its entity now."""
    kind, e, rule, values = leaves.codes[k, 0], leaves.codes[k, 1], leaves.codes[k, 3], leaves.values[n, k]
    time = scene.time[n]
    if kind == CONSTANT:
        return values[0] > 0.0
    if kind == CLOCK:
        return _compares(rule, time, values[0])
    state = scene.floats[n]
    if not scene.flags[n, PRESENT, e]:
        return False
    if kind == TRAVELED:
        return state[ODOMETER, e] >= values[0]
    if kind == STANDS:
        return time - state[STANDING_SINCE, e] > values[0]
    if kind == AT_END:
        return time - state[AT_END_SINCE, e] > values[0] - TOLERANCE
    if kind == COLLIDES:
        # The overlap with the lower row as first entity was computed when the last frame was recorded.
        other = leaves.codes[k, 2]
        return scene.overlaps[n, e, other] if e < other else overlap(scene, n, e, other)
    return _holds_besides(scene, leaves, n, k)


@_kernel
def _holds_besides(scene, leaves, n, k):
    """Whether a leaf of the remaining kinds holds for its entity, which is present."""
    kind, e, other = leaves.codes[k, 0], leaves.codes[k, 1], leaves.codes[k, 2]
    rule, option, values = leaves.codes[k, 3], leaves.codes[k, 4], leaves.values[n, k]
    state = scene.floats[n]
    if kind == SPEED_IS:
        value = state[SPEED, e] if option == ALL_WAYS else component(state, GONE_X, GONE_Y, e, e, option)
        return _compares(rule, value, values[0])
    if kind == ACCELERATION_IS:
        if option != ALL_WAYS:
            return _compares(rule, component(state, PULL_X, PULL_Y, e, e, option), values[0])
        size = math.hypot(state[PULL_X, e], state[PULL_Y, e])
        # Negative if against the heading.
        return _compares(rule, -size if component(state, PULL_X, PULL_Y, e, e, ALONG) < 0.0 else size, values[0])
    if kind == REACHES:
        is_near = math.hypot(values[0] - state[X, e], values[1] - state[Y, e]) < values[3]
        return is_near and (option == 0 or abs(_within_half_turn(values[2] - state[HEADING, e])) < ALIGNED)
    if kind == TURNED:
        heading = state[HEADING, e] if option > 0 else 0.0
        turn = heading - state[HEADING, other] if other >= 0 else heading
        return abs(_within_half_turn(turn - values[0])) < values[1] + TOLERANCE
    if kind == APART_FROM_PLACE:
        return _compares(rule, abs(gap_to_place(scene, n, e, values[0], values[1], option)), values[2])
    if kind == RELATIVE_SPEED:
        difference = state[SPEED, e] - state[SPEED, other]
        if option != ALL_WAYS:
            own_component = component(state, GONE_X, GONE_Y, e, other, option)
            difference = own_component - component(state, GONE_X, GONE_Y, other, other, option)
        return _compares(rule, difference, values[0]) and scene.flags[n, PRESENT, other]
    gap = gap_to(scene, n, e, other, option)
    if kind == APART:
        return _compares(rule, abs(gap), values[0]) and scene.flags[n, PRESENT, other]
    if kind == HEADWAY:
        is_defined = gap >= 0.0 and state[SPEED, e] >= TOLERANCE and scene.flags[n, PRESENT, other]
        return is_defined and _compares(rule, gap / state[SPEED, e], values[0])
    closing = closing_speed(state, e, other)
    if abs(gap) < TOLERANCE or abs(closing) < TOLERANCE or not scene.flags[n, PRESENT, other]:
        return False
    return gap / closing >= 0.0 and _compares(rule, gap / closing, values[0])


@_part
def _within_half_turn(angle):
    turn = angle + math.pi
    # The division is the most expensive part, and rarely needed.
    return (turn if turn >= 0.0 and turn < 2.0 * math.pi else turn % (2.0 * math.pi)) - math.pi


@_kernel
def _compares(rule, a, b):
    if rule == GREATER:
        return a > b + TOLERANCE
    if rule == LESS:
        return a < b - TOLERANCE
    if rule == GREATER_OR_EQUAL:
        return a >= b - TOLERANCE
    if rule == LESS_OR_EQUAL:
        return a <= b + TOLERANCE
    return (abs(a - b) <= TOLERANCE) == (rule == EQUAL)
