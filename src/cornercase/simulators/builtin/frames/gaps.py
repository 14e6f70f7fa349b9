"""How far apart two entities of one scenario are, and how fast they come nearer: compiled."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math
from typing import Final

from cornercase._common.compiling import kernel
from cornercase.simulators.builtin.frames.scene import CENTER_X, LENGTH, WIDTH
from cornercase.simulators.builtin.world.layout import GONE_X, GONE_Y, HEADING, SPEED, X, Y

ALL_WAYS, ALONG, ACROSS, UPWARDS = range(4)
"""Which component of a velocity is meant."""

EUCLIDEAN, LONGITUDINAL, LATERAL = range(3)
"""How a distance is measured, as seen by the entity; `FREE` is added where it is that between boxes."""
FREE: Final = 3

TOLERANCE: Final = 1e-6
"""By which values may miss each other in a comparison."""

_kernel = kernel(error_model="numpy", _nrt=False)


@_kernel
def component(f, x, y, e, axes, option):
    """Component of an entity's velocity or acceleration along or across the heading of another, or upwards.

    Parameters
    ----------
    f : ndarray of float64, shape (K, E)
        Numbers of the scenario.
    x, y : int
        Rows of the vectors.
    e, axes : int
        Rows of the entities.
    option : int
        `ALONG`, `ACROSS` or `UPWARDS`.

    Returns
    -------
    float
    """
    cos, sin = math.cos(f[HEADING, axes]), math.sin(f[HEADING, axes])
    if option == ALONG:
        return f[x, e] * cos + f[y, e] * sin
    return f[y, e] * cos - f[x, e] * sin if option == ACROSS else 0.0


@_kernel
def closing_speed(f, e, other):
    """How fast the gap to another closes, measured along the way that the other goes.

    Parameters
    ----------
    f : ndarray of float64, shape (K, E)
        Numbers of the scenario.
    e, other : int
        Rows of the entities.

    Returns
    -------
    float
        m/s.
    """
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
def gap_to_place(scene, n, e, x, y, option):
    """Signed distance to a place, as seen by the entity.

    Parameters
    ----------
    scene : Scene
    n, e : int
        Scenario and row of the entity.
    x, y : float
        m.
    option : int
        Kind of distance.

    Returns
    -------
    float
        m; negative behind, and lateral ones to the right.
    """
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
