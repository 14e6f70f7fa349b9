"""What a driver sees, and what it remembers of it."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, no-untyped-call, untyped-decorator, call-arg, no-any-return"

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cornercase._common.compiling import kernel
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.drivers.base import Situation

# The eye is behind the windscreen: this part of the box's length ahead of the box's centre.
EYE_AHEAD = 0.25

# Time constant in s of the rate of turn as perceived.
TURN_MEAN = 0.2


def in_sight(situation: Situation, *, field_of_view: float, sight_range: float) -> BoolArray:
    """Find which other entities the driven one sees.

    The eye is in the middle of the box's width, a quarter of its length ahead of its centre. An entity is
    seen when at least one of five points of its box, the centre and the corners, is within range and field
    of view and the line to it meets no third entity's box. Boxes have no height: every entity hides what is
    behind it.

    Parameters
    ----------
    situation : Situation
    field_of_view : float
        Full angle in rad, symmetric about the heading.
    sight_range : float
        m.

    Returns
    -------
    ndarray of bool, shape (N, A)
    """
    s = situation
    eye = _Eye(_dense(s.x), _dense(s.y), _dense(s.heading), s.center_x + EYE_AHEAD * s.length)
    motion = _Motion(*map(_dense, (s.others_x, s.others_y, s.others_heading, s.others_speed)))
    sizes = (_dense(s.others_length), _dense(s.others_width), _dense(s.others_center_x))
    seen: BoolArray = _in_sight(eye, 0.5 * field_of_view, sight_range, motion, sizes)
    return seen


class Perceived(NamedTuple):
    """What a driver knows of A others in N scenarios, each array (N, A).

    Attributes
    ----------
    first_seen, last_seen : ndarray of float64
        Times in s.
    noticed : ndarray of bool
        Seen now, or not yet forgotten.
    known : ndarray of bool
        Noticed, and seen for the reaction time.
    x, y, heading, speed, turn : ndarray of float64
        Perceived motion of the reference points in m, rad, m/s and rad/s; meaningful where noticed. The rate of turn
        is a running mean.
    """

    first_seen: FloatArray
    last_seen: FloatArray
    noticed: BoolArray
    known: BoolArray
    x: FloatArray
    y: FloatArray
    heading: FloatArray
    speed: FloatArray
    turn: FloatArray


class _Eye(NamedTuple):
    """Reference point and heading of who looks, each (N,), and how far ahead of that point its eye is."""

    x: FloatArray
    y: FloatArray
    heading: FloatArray
    ahead: float


class _Motion(NamedTuple):
    """True motion of the others, each (N, A)."""

    x: FloatArray
    y: FloatArray
    heading: FloatArray
    speed: FloatArray


class Perception:
    """What a driver is aware of, for N scenarios and A others.

    An entity is known once it has been seen for the reaction time. When it gets out of sight it is taken to
    go on straight at its last speed for as long as the memory lasts, and is then forgotten; a shorter loss of
    sight does not start the reaction time again.

    Parameters
    ----------
    scenarios, others : int
    reaction_time, memory : float
        s.

    Attributes
    ----------
    state : Perceived
    """

    def __init__(self, scenarios: int, others: int, reaction_time: float, memory: float) -> None:
        shape = (scenarios, others)
        self._reaction_time, self._memory = reaction_time, memory
        self.state = Perceived(
            first_seen=np.full(shape, np.inf),
            last_seen=np.full(shape, -np.inf),
            noticed=np.zeros(shape, dtype=np.bool_),
            known=np.zeros(shape, dtype=np.bool_),
            x=np.full(shape, np.nan),
            y=np.full(shape, np.nan),
            heading=np.full(shape, np.nan),
            speed=np.full(shape, np.nan),
            turn=np.zeros(shape),
        )

    def update(self, situation: Situation, seen: BoolArray) -> None:
        """Take in what is seen, (N, A), in the active scenarios."""
        s = situation
        motion = _Motion(*map(_dense, (s.others_x, s.others_y, s.others_heading, s.others_speed)))
        _perceive(
            s.time, s.time_step, self._reaction_time, self._memory, _dense(s.active), _dense(seen), motion, self.state
        )


def _dense(values):
    return np.ascontiguousarray(values)


@kernel(error_model="numpy")
def _in_sight(eye, half_view, sight_range, motion, sizes):
    scenarios, others = motion.x.shape
    length, width, center_x = sizes
    seen = np.zeros((scenarios, others), dtype=np.bool_)
    box = np.empty((others, 4))
    for n in range(scenarios):
        cos, sin = math.cos(eye.heading[n]), math.sin(eye.heading[n])
        eye_x, eye_y = eye.x[n] + eye.ahead * cos, eye.y[n] + eye.ahead * sin
        for a in range(others):
            box[a, 2], box[a, 3] = math.cos(motion.heading[n, a]), math.sin(motion.heading[n, a])
            box[a, 0] = motion.x[n, a] + center_x[a] * box[a, 2]
            box[a, 1] = motion.y[n, a] + center_x[a] * box[a, 3]
        for a in range(others):
            for point in range(5):
                along, across = 0.0, 0.0
                if point < 4:
                    along = 0.5 * length[a] * (1.0 if point < 2 else -1.0)
                    across = 0.5 * width[a] * (1.0 if point % 2 == 0 else -1.0)
                to_x = box[a, 0] + along * box[a, 2] - across * box[a, 3] - eye_x
                to_y = box[a, 1] + along * box[a, 3] + across * box[a, 2] - eye_y
                if not math.hypot(to_x, to_y) <= sight_range:
                    continue
                if abs(math.atan2(cos * to_y - sin * to_x, cos * to_x + sin * to_y)) > half_view:
                    continue
                hidden = False
                for b in range(others):
                    if b != a and _meets(eye_x, eye_y, to_x, to_y, box[b], 0.5 * length[b], 0.5 * width[b]):
                        hidden = True
                        break
                if not hidden:
                    seen[n, a] = True
                    break
    return seen


@kernel(error_model="numpy")
def _meets(eye_x, eye_y, to_x, to_y, box, half_length, half_width):
    """Whether the line from the eye meets a box (slabs); a box around the eye itself hides nothing."""
    if math.isnan(box[0]):
        return False
    from_x, from_y = eye_x - box[0], eye_y - box[1]
    enters, leaves = 0.0, 1.0
    inside = True
    for axis in range(2):
        if axis == 0:
            start, step, half = from_x * box[2] + from_y * box[3], to_x * box[2] + to_y * box[3], half_length
        else:
            start, step, half = from_y * box[2] - from_x * box[3], to_y * box[2] - to_x * box[3], half_width
        if step == 0.0 and abs(start) > half:
            return False
        inside = inside and abs(start) <= half
        if step != 0.0:
            first, last = (-half - start) / step, (half - start) / step
            enters, leaves = max(enters, min(first, last)), min(leaves, max(first, last))
    return enters < leaves and not inside


@kernel(error_model="numpy")
def _perceive(time, time_step, reaction_time, memory, active, seen, true, state):
    first_seen, last_seen, noticed, known, x, y, heading, speed, turn = state
    scenarios, others = seen.shape
    for n in range(scenarios):
        if not active[n]:
            continue
        for a in range(others):
            if seen[n, a]:
                if not time - last_seen[n, a] <= memory + 1e-9:
                    first_seen[n, a] = time
                    turn[n, a] = 0.0
                else:
                    since = max(time - last_seen[n, a], time_step)
                    change = (true.heading[n, a] - heading[n, a] + math.pi) % (2.0 * math.pi) - math.pi
                    turn[n, a] += (change / since - turn[n, a]) * min(since / TURN_MEAN, 1.0)
                last_seen[n, a] = time
                x[n, a], y[n, a] = true.x[n, a], true.y[n, a]
                heading[n, a], speed[n, a] = true.heading[n, a], true.speed[n, a]
            else:
                way = speed[n, a] * time_step
                x[n, a] += way * math.cos(heading[n, a])
                y[n, a] += way * math.sin(heading[n, a])
            # The tolerance absorbs rounding errors in the sums of time steps.
            noticed[n, a] = time - last_seen[n, a] <= memory + 1e-9 and not math.isnan(true.x[n, a])
            known[n, a] = noticed[n, a] and last_seen[n, a] - first_seen[n, a] >= reaction_time - 1e-9
