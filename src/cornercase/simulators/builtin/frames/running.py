"""The compiled time loop: runs scenarios until their storyboard has to be evaluated."""

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
"""State of a scenario in the loop: idle; storyboard evaluated; actions applied, too; moving on; an action ends or
cannot be applied; the storyboard has to be evaluated; an entity needs the next part of its lane path; finished; an
entity has to be located on its road before its actions are applied, or before it moves on."""

_kernel = kernel(error_model="numpy", _nrt=False)
# Inlined: passing the tables would cost more than the work, and code that is called once does not grow.
_part = kernel(error_model="numpy", _nrt=False, forceinline=True)


class Course(NamedTuple):
    """State of the loop for N scenarios."""

    status: npt.NDArray[np.int8]  # (N,): `ACT`, `ACTIONS_DONE`, `MOVE` or `IDLE` before; the state reached after
    looks: BoolArray  # (N,): whether the storyboard has to be evaluated in each frame
    driven: IntArray  # (D,): entity of each driver


class Rules(NamedTuple):
    """Options of the loop."""

    time_step: float  # s
    most: int  # maximum number of frames
    stop_at_collision: bool
    drives: bool  # whether drivers decide in the loop


class Desk(NamedTuple):
    """Buffers of a thread that runs scenarios [first, last) of E entities, one after the other."""

    first: int
    last: int
    kept: Kept
    watched: Watched
    rest: npt.NDArray[np.int8]  # (E,): `AWAKE` and so on
    others: FloatArray  # (4, E - 1): x, y, heading and speed of entities that a driver may see
    work: Workspace  # of a driver


@kernel(error_model="numpy")
def run_on(scene, tracks, roads, fleet, actions, leaves, course, rules, first, last):
    """Run scenarios [first, last) until their storyboard has to be evaluated.

    Each runs on its own, so the distribution to threads does not matter; a range is always the same.
    """
    entities = scene.floats.shape[2]
    saved, rest = room_to_keep(actions.options.shape[0]), np.empty(entities, dtype=np.int8)
    others, watchlist = np.empty((4, entities - 1)), room_to_watch(leaves)
    buffers = Desk(first, last, saved, watchlist, rest, others, workspace(entities - 1))
    _run_all(scene, tracks, roads, fleet, actions, leaves, course, rules, buffers)


# In a kernel that allocates, numba would count references of each array, in each frame, with atomic operations.
@_kernel
def _run_all(scene, tracks, roads, fleet, actions, leaves, course, rules, desk):
    for n in range(desk.first, desk.last):
        status = course.status[n]
        if status == RESTS:
            continue
        _wake(scene, actions, course, n, desk)
        pick(leaves, desk.watched, n)
        while status in (GOES, ACTS, BEGUN):
            is_acting, dt = status != GOES, rules.time_step if scene.frames[n] > 0 else 0.0
            if status == GOES:
                if scene.frames[n] >= rules.most:
                    status = OVER
                    break
                if not stays(scene, leaves, desk.watched, n):
                    status = WAITS
                    break
                for e in range(scene.floats.shape[2]):
                    scene.floats[n, BEFORE, e] = scene.floats[n, SPEED, e]
            outcome = ACTED
            if status != BEGUN:
                outcome = act(scene, tracks, roads, actions, desk.kept, n, dt)
            if outcome == LOST:
                status = LOST_ACTING if is_acting else LOST_GOING
                break
            if outcome != ACTED:
                status = ENDS if is_acting else WAITS
                break
            status = _finish(scene, tracks, fleet, course, rules, n, dt, desk)
            if is_acting and course.looks[n] and status == GOES:
                status = WAITS
        if status == WAITS and scene.frames[n] >= rules.most:
            status = OVER
        if status == WAITS or course.looks[n]:
            take_down(scene, leaves, n)
        course.status[n] = status


@_part
def _wake(scene, actions, course, n, desk):
    """List the running actions, note who is moved by something else than itself, and wake all entities."""
    rest, running = desk.rest, desk.kept.live
    for e in range(rest.size):
        rest[e] = AWAKE
    take_up(actions, desk.kept, n)
    i = 0
    while running[i] >= 0:
        if actions.options[running[i], 0] != UNKNOWN:
            rest[actions.options[running[i], 1]] = MOVED_BY_OTHERS
        i += 1
    for d in range(course.driven.size):
        rest[course.driven[d]] = MOVED_BY_OTHERS
    for t in range(scene.tows.shape[0]):
        rest[int(scene.tows[t, 0])] = rest[int(scene.tows[t, 1])] = MOVED_BY_OTHERS


@_part
def _finish(scene, tracks, fleet, course, rules, n, dt, desk):
    """Do the part of a frame after the storyboard: drivers, motion, recording. Return the new state."""
    if rules.drives and dt > 0.0:
        for d in range(course.driven.shape[0]):
            _drive(scene, tracks, fleet, n, d, course.driven[d], dt, desk)
    needs_lane = move(scene, tracks, n, dt, desk.rest)
    collides = record(scene, n, desk.first, dt, desk.rest)
    if collides and rules.stop_at_collision:
        return OVER
    return ELSEWHERE if needs_lane else GOES


@_part
def _drive(scene, tracks, fleet, n, d, e, dt, desk):
    """Let a compiled driver set the speed of its entity at the end of the time step, if it is in charge."""
    state, flags, numbers, others = scene.floats[n], scene.flags[n], scene.numbers[n], desk.others
    track = numbers[TRACK, e]
    if not (flags[PRESENT, e] and flags[DRIVEN, e] and numbers[DRIVER, e] == d and track >= 0):
        return
    # A trajectory with times leaves the driver nothing to decide.
    route = route_row(fleet, d, track, n)
    if tracks.timed[tracks.row[e, track]] or route < 0:
        return
    for i in range(others.shape[1]):
        k = i if i < e else i + 1
        is_visible = flags[PRESENT, k] and flags[VISIBLE, k]
        others[0, i] = state[X, k] if is_visible else math.nan
        others[1, i] = state[Y, k] if is_visible else math.nan
        others[2, i] = state[HEADING, k] if is_visible else math.nan
        others[3, i] = state[SPEED, k] if is_visible else math.nan
    driven = Driven(
        state[DISTANCE, e], state[X, e], state[Y, e], state[HEADING, e], state[SPEED, e], state[TARGET_SPEED, e]
    )
    acceleration = accelerate(fleet, d, n, route, scene.time[n], dt, driven, others, desk.work)
    state[SPEED, e] = min(max(state[SPEED, e] + acceleration * dt, 0.0), scene.boxes[e, MAX_SPEED])
