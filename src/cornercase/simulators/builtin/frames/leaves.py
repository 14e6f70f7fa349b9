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
from cornercase.simulators.builtin.frames.scene import CENTER_X, LENGTH, WIDTH
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

ALL_WAYS, ALONG, ACROSS, UPWARDS = range(4)
"""Which component of a velocity is meant."""

EUCLIDEAN, LONGITUDINAL, LATERAL = range(3)
"""How a distance is measured, as seen by the entity; `FREE` is added where it is that between boxes."""
FREE: Final = 3

TOLERANCE: Final = 1e-6
"""By which values may miss each other in a comparison."""
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


@_part
def stays(scene, leaves, n):
    """Whether no trigger fires, and nothing has changed for those to which matters what was before.

    Parameters
    ----------
    scene : Scene
    leaves : Leaves
    n : int
        Scenario.

    Returns
    -------
    bool
    """
    for d in range(leaves.pending.shape[1]):
        if leaves.pending[n, d] <= scene.time[n] - leaves.delay[n, d] + TOLERANCE:
            return False
    for t in range(leaves.triggers.shape[0]):
        if not leaves.watched[n, t]:
            continue
        first, last, plain = leaves.triggers[t]
        for g in range(first, last):
            if _fires(scene, leaves, n, g) if plain else _changes(scene, leaves, n, g):
                return False
    return True


@_kernel
def _fires(scene, leaves, n, g):
    met, last = True, leaves.groups[g, 1]
    c = leaves.groups[g, 0]
    while met and c < last:
        met = _met(scene, leaves, n, c)
        c += 1
    return met


@_kernel
def _met(scene, leaves, n, c):
    """Whether a condition holds of any, or of every, of its entities."""
    first, last, every = leaves.conditions[c]
    k = first
    while k < last:
        e, met = leaves.codes[k, 1], False
        while k < last and leaves.codes[k, 1] == e:
            met = met or holds(scene, leaves, n, k)
            k += 1
        if met != (every > 0):
            return met
    return every > 0


@_kernel
def _changes(scene, leaves, n, g):
    for c in range(leaves.groups[g, 0], leaves.groups[g, 1]):
        for k in range(leaves.conditions[c, 0], leaves.conditions[c, 1]):
            if holds(scene, leaves, n, k) != leaves.truth[n, k]:
                return True
    return False


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


@_kernel
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
    kind, e, other = leaves.codes[k, 0], leaves.codes[k, 1], leaves.codes[k, 2]
    rule, option, v = leaves.codes[k, 3], leaves.codes[k, 4], leaves.values[n, k]
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
    if kind == SPEED_IS:
        asked = f[SPEED, e] if option == ALL_WAYS else _component(f, GONE_X, GONE_Y, e, e, option)
        return _compares(rule, asked, v[0])
    if kind == ACCELERATION_IS:
        if option != ALL_WAYS:
            return _compares(rule, _component(f, PULL_X, PULL_Y, e, e, option), v[0])
        size = math.hypot(f[PULL_X, e], f[PULL_Y, e])
        # Against the heading it is negative.
        return _compares(rule, -size if _component(f, PULL_X, PULL_Y, e, e, ALONG) < 0.0 else size, v[0])
    if kind == STANDS:
        return time - f[STANDING_SINCE, e] > v[0]
    if kind == AT_END:
        return time - f[AT_END_SINCE, e] > v[0] - TOLERANCE
    if kind == REACHES:
        near = math.hypot(v[0] - f[X, e], v[1] - f[Y, e]) < v[3]
        turn = (v[2] - f[HEADING, e] + math.pi) % (2.0 * math.pi) - math.pi
        return near and (option == 0 or abs(turn) < ALIGNED)
    if kind == TURNED:
        heading = f[HEADING, e] if option > 0 else 0.0
        turn = heading - f[HEADING, other] if other >= 0 else heading
        return abs((turn - v[0] + math.pi) % (2.0 * math.pi) - math.pi) < v[1] + TOLERANCE
    if kind == APART_FROM_PLACE:
        return _compares(rule, abs(_gap_to_place(scene, n, e, v[0], v[1], option)), v[2])
    if kind == COLLIDES:
        return overlap(scene, n, e, other)
    if kind == RELATIVE_SPEED:
        apart = f[SPEED, e] - f[SPEED, other]
        if option != ALL_WAYS:
            own = _component(f, GONE_X, GONE_Y, e, other, option)
            apart = own - _component(f, GONE_X, GONE_Y, other, other, option)
        return _compares(rule, apart, v[0]) and scene.flags[n, PRESENT, other]
    gap = gap_to(scene, n, e, other, option)
    if kind == APART:
        return _compares(rule, abs(gap), v[0]) and scene.flags[n, PRESENT, other]
    if kind == HEADWAY:
        defined = gap >= 0.0 and f[SPEED, e] >= TOLERANCE and scene.flags[n, PRESENT, other]
        return defined and _compares(rule, gap / f[SPEED, e], v[0])
    closing = _closing(f, e, other)
    if abs(gap) < TOLERANCE or abs(closing) < TOLERANCE or not scene.flags[n, PRESENT, other]:
        return False
    return gap / closing >= 0.0 and _compares(rule, gap / closing, v[0])


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


@_kernel
def _component(f, x, y, e, axes, option):
    """Component of an entity's velocity or acceleration along or across the heading of another, or upwards."""
    cos, sin = math.cos(f[HEADING, axes]), math.sin(f[HEADING, axes])
    if option == ALONG:
        return f[x, e] * cos + f[y, e] * sin
    return f[y, e] * cos - f[x, e] * sin if option == ACROSS else 0.0


@_kernel
def _closing(f, e, other):
    """How fast the gap to another closes, measured along the way that the other goes."""
    x, y = f[GONE_X, other], f[GONE_Y, other]
    if abs(x) < TOLERANCE and abs(y) < TOLERANCE:
        return f[SPEED, e]
    own = (f[GONE_X, e] * x + f[GONE_Y, e] * y) / math.hypot(x, y)
    backwards = (f[SPEED, e] < 0.0) != (own < 0.0)
    return (own - abs(f[SPEED, other])) * (-1.0 if backwards else 1.0)


@_kernel
def gap_to(scene, n, e, other, option):
    """Signed distance to another entity, as seen by the entity.

    Parameters
    ----------
    scene : Scene
    n, e, other : int
        Scenario and rows of the entities.
    option : int
        Kind of distance, but for the Euclidean one between boxes.

    Returns
    -------
    float
        m; negative behind, and lateral ones to the right.
    """
    f = scene.floats[n]
    cos, sin = math.cos(f[HEADING, e]), math.sin(f[HEADING, e])
    dx, dy = f[X, other] - f[X, e], f[Y, other] - f[Y, e]
    if option == EUCLIDEAN:
        return math.hypot(dx, dy) if dx * cos + dy * sin > 0.0 else -math.hypot(dx, dy)
    if option == LONGITUDINAL:
        return dx * cos + dy * sin
    if option == LATERAL:
        return dy * cos - dx * sin
    near, far = _extent(scene, n, e, other, option == LATERAL + FREE)
    half = 0.5 * scene.boxes[e, WIDTH if option == LATERAL + FREE else LENGTH]
    if near > half:
        return near - half
    return far + half if far < -half else 0.0


@_kernel
def _extent(scene, n, e, other, across):
    """Least and largest coordinate of another's box ahead of, or to the left of, an entity's centre."""
    f, boxes = scene.floats[n], scene.boxes
    cos, sin = math.cos(f[HEADING, e]), math.sin(f[HEADING, e])
    turned_cos, turned_sin = math.cos(f[HEADING, other]), math.sin(f[HEADING, other])
    x, y = f[X, other] + boxes[other, CENTER_X] * turned_cos, f[Y, other] + boxes[other, CENTER_X] * turned_sin
    own_x, own_y = f[X, e] + boxes[e, CENTER_X] * cos, f[Y, e] + boxes[e, CENTER_X] * sin
    near, far = math.inf, -math.inf
    for k in range(4):
        along = 0.5 * boxes[other, LENGTH] * (1.0 if k < 2 else -1.0)
        aside = 0.5 * boxes[other, WIDTH] * (1.0 if k == 1 or k == 2 else -1.0)
        dx = x + turned_cos * along - turned_sin * aside - own_x
        dy = y + turned_sin * along + turned_cos * aside - own_y
        place = dy * cos - dx * sin if across else dx * cos + dy * sin
        near, far = min(near, place), max(far, place)
    return near, far


@_kernel
def _gap_to_place(scene, n, e, x, y, option):
    """Signed distance to a place, as seen by the entity."""
    f, box, free = scene.floats[n], scene.boxes[e], option >= FREE
    dx, dy = x - f[X, e], y - f[Y, e]
    cos, sin = math.cos(f[HEADING, e]), math.sin(f[HEADING, e])
    along, across = dx * cos + dy * sin, dy * cos - dx * sin
    if option == EUCLIDEAN:
        return math.hypot(dx, dy) if along > 0.0 else -math.hypot(dx, dy)
    if option == EUCLIDEAN + FREE:
        along -= box[CENTER_X]
        beyond = max(abs(along) - 0.5 * box[LENGTH], 0.0)
        size = math.hypot(beyond, max(abs(across) - 0.5 * box[WIDTH], 0.0))
        return -size if along < -0.5 * box[LENGTH] else size
    if option == LATERAL or option == LATERAL + FREE:
        size = max(abs(across) - (0.5 * box[WIDTH] if free else 0.0), 0.0)
        return math.copysign(size, across)
    if not free:
        return along
    front, rear = 0.5 * box[LENGTH] + box[CENTER_X], 0.5 * box[LENGTH] - box[CENTER_X]
    return max(along - front, 0.0) if along > 0.0 else min(along + rear, 0.0)
