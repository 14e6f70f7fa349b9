"""Scenarios run from one happening of their storyboard to the next."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cornercase._common.compiling import kernel
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.drivers import Driven, Workspace, accelerate, route_row, workspace
from cornercase.simulators.builtin.frames.acting import Kept, act, room_to_keep, take_up
from cornercase.simulators.builtin.frames.leaves import Watched, pick, room_to_watch, stays, take_down
from cornercase.simulators.builtin.frames.motion import AWAKE, MOVED_BY_OTHERS, move, record
from cornercase.simulators.builtin.frames.scene import MAX_SPEED
from cornercase.simulators.builtin.frames.synchronising import ACTED, LOST
from cornercase.simulators.builtin.frames.table import UNKNOWN
from cornercase.simulators.builtin.world.layout import (
    BEFORE,
    DISTANCE,
    DRIVEN,
    DRIVER,
    HEADING,
    PRESENT,
    SPEED,
    TARGET_SPEED,
    TRACK,
    VISIBLE,
    X,
    Y,
)

RESTS, ACTS, BEGUN, GOES, ENDS, WAITS, ELSEWHERE, OVER, LOST_ACTING, LOST_GOING = range(10)
"""What becomes of a scenario: nothing; its storyboard has looked; its actions have acted, too; it goes on; an action
ends, or cannot act here; its storyboard has to look; an entity needs a new part of its way; it has ended; it acts, or
goes on, once an entity has been looked up."""

_kernel = kernel(error_model="numpy", _nrt=False)
# Passing the tables on costs more than what a small kernel does; what is called in one place grows no code by this.
_part = kernel(error_model="numpy", _nrt=False, forceinline=True)


class Course(NamedTuple):
    """How N scenarios are to be run.

    Attributes
    ----------
    status : ndarray of int8, shape (N,)
        `ACTS`, `BEGUN`, `GOES` or `RESTS` before; what has become of it after.
    looks : ndarray of bool, shape (N,)
        Whether the storyboard has to look in each frame.
    driven : ndarray of int64, shape (D,)
        Row of the entity of each driver.
    """

    status: npt.NDArray[np.int8]
    looks: BoolArray
    driven: IntArray


class Rules(NamedTuple):
    """What holds for all scenarios.

    Attributes
    ----------
    time_step : float
        s.
    most : int
        How many frames a scenario has at most.
    stop_at_collision : bool
    drives : bool
        Whether drivers decide here.
    """

    time_step: float
    most: int
    stop_at_collision: bool
    drives: bool


class Desk(NamedTuple):
    """What a thread needs to run one scenario of E entities after the other.

    Attributes
    ----------
    first, last : int
        The scenarios, the last one not included.
    kept : Kept
    watched : Watched
    rest : ndarray of int8, shape (E,)
        `AWAKE` and so on.
    others : ndarray of float64, shape (4, E - 1)
        x, y, heading and speed of who a driver may see.
    work : Workspace
        Of a driver.
    """

    first: int
    last: int
    kept: Kept
    watched: Watched
    rest: npt.NDArray[np.int8]
    others: FloatArray
    work: Workspace


@kernel(error_model="numpy")
def run_on(scene, tracks, roads, fleet, actions, leaves, course, rules, first, last):
    """Run scenarios on until their storyboard has to look.

    Each is run by itself, so that it does not matter how they are shared among threads.

    Parameters
    ----------
    scene : Scene
    tracks : Tracks
    roads : RoadTables
    fleet : Fleet
    actions : Actions
    leaves : Leaves
    course : Course
    rules : Rules
    first, last : int
        Scenarios, the last one not included; always the same ones together.
    """
    entities = scene.floats.shape[2]
    kept, rest = room_to_keep(actions.options.shape[0]), np.empty(entities, dtype=np.int8)
    others, watched = np.empty((4, entities - 1)), room_to_watch(leaves)
    desk = Desk(first, last, kept, watched, rest, others, workspace(entities - 1))
    _run_all(scene, tracks, roads, fleet, actions, leaves, course, rules, desk)


# Where memory is reserved, numba counts who refers to each array, in each frame, with atomic operations.
@_kernel
def _run_all(scene, tracks, roads, fleet, actions, leaves, course, rules, desk):
    for n in range(desk.first, desk.last):
        status = course.status[n]
        if status == RESTS:
            continue
        _wake(scene, actions, course, n, desk)
        pick(leaves, desk.watched, n)
        while status in (GOES, ACTS, BEGUN):
            begun, dt = status != GOES, rules.time_step if scene.frames[n] > 0 else 0.0
            if status == GOES:
                if scene.frames[n] >= rules.most:
                    status = OVER
                    break
                if not stays(scene, leaves, desk.watched, n):
                    status = WAITS
                    break
                _note_speeds(scene, n)
            became = ACTED
            if status != BEGUN:
                became = act(scene, tracks, roads, actions, desk.kept, n, dt)
            if became == LOST:
                status = LOST_ACTING if begun else LOST_GOING
                break
            if became != ACTED:
                status = ENDS if begun else WAITS
                break
            status = _finish(scene, tracks, fleet, course, rules, n, dt, desk)
            if begun and course.looks[n] and status == GOES:
                status = WAITS
        if status == WAITS and scene.frames[n] >= rules.most:
            status = OVER
        if status == WAITS or course.looks[n]:
            take_down(scene, leaves, n)
        course.status[n] = status


@_part
def _wake(scene, actions, course, n, desk):
    """Take note of the actions that run, of who is moved by others than itself, and that nobody may rest yet."""
    rest, live = desk.rest, desk.kept.live
    for e in range(rest.size):
        rest[e] = AWAKE
    take_up(actions, desk.kept, n)
    i = 0
    while live[i] >= 0:
        if actions.options[live[i], 0] != UNKNOWN:
            rest[actions.options[live[i], 1]] = MOVED_BY_OTHERS
        i += 1
    for d in range(course.driven.size):
        rest[course.driven[d]] = MOVED_BY_OTHERS
    for t in range(scene.tows.shape[0]):
        rest[int(scene.tows[t, 0])] = rest[int(scene.tows[t, 1])] = MOVED_BY_OTHERS


@_part
def _note_speeds(scene, n):
    for e in range(scene.floats.shape[2]):
        scene.floats[n, BEFORE, e] = scene.floats[n, SPEED, e]


@_part
def _finish(scene, tracks, fleet, course, rules, n, dt, desk):
    """Do the part of a frame that comes after the storyboard; what becomes of the scenario then."""
    if rules.drives and dt > 0.0:
        for d in range(course.driven.shape[0]):
            _drive(scene, tracks, fleet, n, d, course.driven[d], dt, desk)
    elsewhere = move(scene, tracks, n, dt, desk.rest)
    collides = record(scene, n, desk.first, dt, desk.rest)
    if collides and rules.stop_at_collision:
        return OVER
    return ELSEWHERE if elsewhere else GOES


@_part
def _drive(scene, tracks, fleet, n, d, e, dt, desk):
    """Let a driver decide the speed of its entity at the end of the coming time step, where it is in charge."""
    f, b, numbers, others = scene.floats[n], scene.flags[n], scene.numbers[n], desk.others
    track = numbers[TRACK, e]
    if not (b[PRESENT, e] and b[DRIVEN, e] and numbers[DRIVER, e] == d and track >= 0):
        return
    # A trajectory with times leaves the driver nothing to decide.
    route = route_row(fleet, d, track, n)
    if tracks.timed[tracks.row[e, track]] or route < 0:
        return
    for a in range(others.shape[1]):
        k = a if a < e else a + 1
        there = b[PRESENT, k] and b[VISIBLE, k]
        others[0, a] = f[X, k] if there else math.nan
        others[1, a] = f[Y, k] if there else math.nan
        others[2, a] = f[HEADING, k] if there else math.nan
        others[3, a] = f[SPEED, k] if there else math.nan
    driven = Driven(f[DISTANCE, e], f[X, e], f[Y, e], f[HEADING, e], f[SPEED, e], f[TARGET_SPEED, e])
    acceleration = accelerate(fleet, d, n, route, scene.time[n], dt, driven, others, desk.work)
    f[SPEED, e] = min(max(f[SPEED, e] + acceleration * dt, 0.0), scene.boxes[e, MAX_SPEED])
