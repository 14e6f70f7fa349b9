"""Conditions as compiled code asks for them: whether anything that a trigger looks at has changed."""

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
"""What is asked: what only the storyboard itself changes (the first value says whether it holds), the time …"""

GREATER, LESS, EQUAL, GREATER_OR_EQUAL, LESS_OR_EQUAL, NOT_EQUAL = range(6)
"""How two values compare."""

ALIGNED: Final = 0.05
"""A position with an orientation is reached with a heading that differs by less, in rad; esmini's figure."""

VALUES: Final = 4
"""How many numbers a leaf has in each scenario."""

_kernel = kernel(error_model="numpy", _nrt=False)
# What is called in one place: passing the tables on costs more than what it does.
_part = kernel(error_model="numpy", _nrt=False, forceinline=True)


class Leaf(NamedTuple):
    """What one condition asks, without its edge and delay.

    Attributes
    ----------
    kind : int
        `CLOCK` and so on.
    other : int
        Row of the other entity, or -1.
    rule : int
        `GREATER` and so on.
    option : int
        Component, or kind of distance, or whether a heading is asked for.
    values : tuple of ndarray of float64, each (N,)
    """

    kind: int
    other: int = -1
    rule: int = 0
    option: int = 0
    values: tuple[FloatArray, ...] = ()


class Asked(NamedTuple):
    """A condition of a trigger, as compiled code asks for it.

    Attributes
    ----------
    leaves : list of (int, Leaf)
        Each with the row of its entity, or -1; those of one entity follow each other, and one of them is enough.
    every : bool
        Whether it has to hold of every entity, rather than of one.
    plain : bool
        Whether it holds where its leaves do, whatever was before.
    """

    leaves: list[tuple[int, Leaf]]
    every: bool
    plain: bool


class Leaves(NamedTuple):
    """T triggers of N scenarios with G groups of C conditions with L leaves, D of which hold with a delay.

    Attributes
    ----------
    codes : ndarray of int64, shape (L, 5)
        Kind, entity (-1 for none), other, rule, option.
    values : ndarray of float64, shape (N, L, 4)
    truth : ndarray of bool, shape (N, L)
        As of the last frame that the storyboard has seen.
    conditions : ndarray of int64, shape (C, 3)
        First and last leaf, the last one not included, and whether it has to hold of every entity.
    groups : ndarray of int64, shape (G, 2)
        First and last condition, the last one not included.
    triggers : ndarray of int64, shape (T, 3)
        First and last group, the last one not included, and whether nothing that was before matters to it.
    watched : ndarray of bool, shape (N, T)
        Whether something waits for it.
    pending, delay : ndarray of float64, shape (N, D)
        Time in s of the oldest change that waits for its delay, infinite for none; the delay in s.
    """

    codes: IntArray
    values: FloatArray
    truth: BoolArray
    conditions: IntArray
    groups: IntArray
    triggers: IntArray
    watched: BoolArray
    pending: FloatArray
    delay: FloatArray


def gather_leaves(found: list[list[list[Asked]]], delays: list[FloatArray], scenarios: int) -> Leaves:
    """Make the tables of triggers.

    Parameters
    ----------
    found : list of list of list of Asked
        By trigger and group.
    delays : list of ndarray of float64, each (N,)
    scenarios : int
        N.

    Returns
    -------
    Leaves
    """
    leaves: list[tuple[int, Leaf]] = []
    conditions: list[tuple[int, int, bool]] = []
    groups: list[tuple[int, int]] = []
    triggers: list[tuple[int, int, bool]] = []
    for trigger in found:
        first_group = len(groups)
        for group in trigger:
            first_condition = len(conditions)
            for asked in group:
                conditions.append((len(leaves), len(leaves) + len(asked.leaves), asked.every))
                leaves += asked.leaves
            groups.append((first_condition, len(conditions)))
        triggers.append((first_group, len(groups), all(asked.plain for group in trigger for asked in group)))
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
    """What of the triggers can come to pass in a scenario before its storyboard looks.

    Attributes
    ----------
    groups : ndarray of int64, shape (G + 1,)
        Groups of which none may be met, and then -1.
    leaves : ndarray of int64, shape (L + 1,)
        Leaves of which none may change, and then -1.
    """

    groups: IntArray
    leaves: IntArray


@kernel(error_model="numpy")
def room_to_watch(leaves):
    """Make room for what is watched in a scenario.

    Parameters
    ----------
    leaves : Leaves

    Returns
    -------
    Watched
    """
    groups, changing = leaves.groups.shape[0] + 1, leaves.codes.shape[0] + 1
    return Watched(np.empty(groups, dtype=np.int64), np.empty(changing, dtype=np.int64))


@_kernel
def pick(leaves, watched, n):
    """Pick what can come to pass in a scenario: what is constant is what it is until the storyboard looks.

    Parameters
    ----------
    leaves : Leaves
    watched : Watched
    n : int
        Scenario.
    """
    groups = changing = 0
    for t in range(leaves.triggers.shape[0]):
        if not leaves.watched[n, t]:
            continue
        first, last, plain = leaves.triggers[t]
        for g in range(first, last):
            if not plain:
                for c in range(leaves.groups[g, 0], leaves.groups[g, 1]):
                    for k in range(leaves.conditions[c, 0], leaves.conditions[c, 1]):
                        if leaves.codes[k, 0] != CONSTANT or (leaves.values[n, k, 0] > 0.0) != leaves.truth[n, k]:
                            watched.leaves[changing] = k
                            changing += 1
            elif not _never_met(leaves, n, g):
                watched.groups[groups] = g
                groups += 1
    watched.groups[groups] = watched.leaves[changing] = -1


@_kernel
def _never_met(leaves, n, g):
    for c in range(leaves.groups[g, 0], leaves.groups[g, 1]):
        k = leaves.conditions[c, 0]
        # There is one of what is constant.
        if k < leaves.conditions[c, 1] and leaves.codes[k, 0] == CONSTANT and not leaves.values[n, k, 0] > 0.0:
            return True
    return False


@_part
def stays(scene, leaves, watched, n):
    """Whether no trigger fires, and nothing has changed for those to which matters what was before.

    Parameters
    ----------
    scene : Scene
    leaves : Leaves
    watched : Watched
    n : int
        Scenario.

    Returns
    -------
    bool
    """
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
    """Whether all conditions of a group hold, each of any, or of every, of its entities."""
    for c in range(leaves.groups[g, 0], leaves.groups[g, 1]):
        first, last, every = leaves.conditions[c]
        k, holding = first, every > 0
        while k < last and holding == (every > 0):
            e, holding = leaves.codes[k, 1], False
            while k < last and leaves.codes[k, 1] == e:
                holding = holding or holds(scene, leaves, n, k)
                k += 1
        if not holding:
            return False
    return True


@_kernel
def take_down(scene, leaves, n):
    """Keep what holds in a scenario now, to be compared with.

    Parameters
    ----------
    scene : Scene
    leaves : Leaves
    n : int
        Scenario.
    """
    for k in range(leaves.codes.shape[0]):
        leaves.truth[n, k] = holds(scene, leaves, n, k)


@_part
def holds(scene, leaves, n, k):
    """Whether a leaf holds of its entity in a scenario now.

    Parameters
    ----------
    scene : Scene
    leaves : Leaves
    n, k : int
        Scenario and leaf.

    Returns
    -------
    bool
    """
    kind, e, rule, v = leaves.codes[k, 0], leaves.codes[k, 1], leaves.codes[k, 3], leaves.values[n, k]
    time = scene.time[n]
    if kind == CONSTANT:
        return v[0] > 0.0
    if kind == CLOCK:
        return _compares(rule, time, v[0])
    f = scene.floats[n]
    if not scene.flags[n, PRESENT, e]:
        return False
    if kind == TRAVELED:
        return f[ODOMETER, e] >= v[0]
    if kind == STANDS:
        return time - f[STANDING_SINCE, e] > v[0]
    if kind == AT_END:
        return time - f[AT_END_SINCE, e] > v[0] - TOLERANCE
    if kind == COLLIDES:
        # Of each two, the one with the lower row was asked for the other when the last frame was recorded.
        other = leaves.codes[k, 2]
        return scene.overlaps[n, e, other] if e < other else overlap(scene, n, e, other)
    return _holds_besides(scene, leaves, n, k)


@_kernel
def _holds_besides(scene, leaves, n, k):
    """Whether a leaf of another kind holds of its entity, which is there."""
    kind, e, other = leaves.codes[k, 0], leaves.codes[k, 1], leaves.codes[k, 2]
    rule, option, v = leaves.codes[k, 3], leaves.codes[k, 4], leaves.values[n, k]
    f = scene.floats[n]
    if kind == SPEED_IS:
        asked = f[SPEED, e] if option == ALL_WAYS else component(f, GONE_X, GONE_Y, e, e, option)
        return _compares(rule, asked, v[0])
    if kind == ACCELERATION_IS:
        if option != ALL_WAYS:
            return _compares(rule, component(f, PULL_X, PULL_Y, e, e, option), v[0])
        size = math.hypot(f[PULL_X, e], f[PULL_Y, e])
        # Against the heading it is negative.
        return _compares(rule, -size if component(f, PULL_X, PULL_Y, e, e, ALONG) < 0.0 else size, v[0])
    if kind == REACHES:
        near = math.hypot(v[0] - f[X, e], v[1] - f[Y, e]) < v[3]
        return near and (option == 0 or abs(_within_half_turn(v[2] - f[HEADING, e])) < ALIGNED)
    if kind == TURNED:
        heading = f[HEADING, e] if option > 0 else 0.0
        turn = heading - f[HEADING, other] if other >= 0 else heading
        return abs(_within_half_turn(turn - v[0])) < v[1] + TOLERANCE
    if kind == APART_FROM_PLACE:
        return _compares(rule, abs(gap_to_place(scene, n, e, v[0], v[1], option)), v[2])
    if kind == RELATIVE_SPEED:
        apart = f[SPEED, e] - f[SPEED, other]
        if option != ALL_WAYS:
            own = component(f, GONE_X, GONE_Y, e, other, option)
            apart = own - component(f, GONE_X, GONE_Y, other, other, option)
        return _compares(rule, apart, v[0]) and scene.flags[n, PRESENT, other]
    gap = gap_to(scene, n, e, other, option)
    if kind == APART:
        return _compares(rule, abs(gap), v[0]) and scene.flags[n, PRESENT, other]
    if kind == HEADWAY:
        defined = gap >= 0.0 and f[SPEED, e] >= TOLERANCE and scene.flags[n, PRESENT, other]
        return defined and _compares(rule, gap / f[SPEED, e], v[0])
    closing = closing_speed(f, e, other)
    if abs(gap) < TOLERANCE or abs(closing) < TOLERANCE or not scene.flags[n, PRESENT, other]:
        return False
    return gap / closing >= 0.0 and _compares(rule, gap / closing, v[0])


@_part
def _within_half_turn(angle):
    turn = angle + math.pi
    # Division costs most of it, and as a rule changes nothing.
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
