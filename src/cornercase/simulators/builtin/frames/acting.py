"""Actions of one scenario, for one time step in which none of them ends: twins of those in `actions`."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from cornercase._common.compiling import kernel
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.simulators.builtin.frames.motion import advance, set_speed, settle
from cornercase.simulators.builtin.frames.scene import MAX_ACCELERATION, MAX_DECELERATION, MAX_SPEED
from cornercase.simulators.builtin.frames.synchronising import ACTED, ENDED, keep_distance, synchronise
from cornercase.simulators.builtin.frames.table import (
    CHANGING,
    DISTANCE_ACTION,
    LANE_CHANGE,
    LANE_OFFSET,
    SPEED_ACTION,
    SYNCHRONISATION,
    TRAJECTORY_ACTION,
    UNKNOWN,
)
from cornercase.simulators.builtin.tracks.place_kernels import (
    trajectory_direction,
    trajectory_distance_at,
    trajectory_end,
    trajectory_length,
    trajectory_oriented,
)
from cornercase.simulators.builtin.tracks.pool import LANE, OTHER
from cornercase.simulators.builtin.world.layout import (
    AT_END_SINCE,
    DECIDED,
    DISTANCE,
    DRIVEN,
    HEADING,
    LAST_S,
    MOVED,
    OFFSET,
    PACE,
    ROAD_SPEED,
    SPEED,
    TARGET_SPEED,
    TRACK,
    TURN,
    UNASKED,
    X,
    Y,
)

_CUBIC, _SINUSOIDAL, _STEP = 1, 2, 3
_RATE, _DISTANCE = 1, 2
_TINY: Final = 1e-6
# Offsets from a lane's middle are known to some 1e-5 m, and so is how long a change takes, in s or m.
_SHORT: Final = 1e-4
# rad; who moves only sideways is turned by a little less than a quarter.
_SIDEWAYS: Final = 0.5 * math.pi - 1e-3

# All that actions change of their own entity: those that decide its speed, those that follow a trajectory, and those
# that move it beside its lane.
_OF_SPEED: Final = (TARGET_SPEED, SPEED, LAST_S)
_OF_TRAJECTORY: Final = (SPEED, X, Y, HEADING, DISTANCE, TURN)
_OF_PLACE: Final = (SPEED, X, Y, HEADING, DISTANCE, TURN, OFFSET, PACE, AT_END_SINCE)
# How many numbers of their memory, the first ones, can change from step to step.
_FEW: Final = 4

_kernel = kernel(error_model="numpy", _nrt=False)
# What is called in one place: passing the tables on costs more than what it does.
_part = kernel(error_model="numpy", _nrt=False, forceinline=True)


class Kept(NamedTuple):
    """What J actions may change of one scenario, each as it was before the action.

    Attributes
    ----------
    live : ndarray of int64, shape (J + 1,)
        The actions that run in the scenario, in their order, and then -1.
    floats : ndarray of float64, shape (J, 10)
    flag : ndarray of bool, shape (J,)
    memory : ndarray of float64, shape (J, 8)
    """

    live: IntArray
    floats: FloatArray
    flag: BoolArray
    memory: FloatArray


@kernel(error_model="numpy")
def room_to_keep(actions):
    """Make room for what the actions of a scenario may change.

    Parameters
    ----------
    actions : int

    Returns
    -------
    Kept
    """
    floats, flag = np.empty((actions, len(_OF_PLACE) + 1)), np.empty(actions, dtype=np.bool_)
    return Kept(np.empty(actions + 1, dtype=np.int64), floats, flag, np.empty((actions, CHANGING)))


@_part
def take_up(actions, kept, n):
    """Take note of which actions run in a scenario.

    Parameters
    ----------
    actions : Actions
    kept : Kept
    n : int
        Scenario.
    """
    count = 0
    for j in range(actions.options.shape[0]):
        if actions.running[n, j]:
            kept.live[count] = j
            count += 1
    kept.live[count] = -1


@_part
def act(scene, tracks, roads, actions, kept, n, dt):
    """Let all actions of a scenario act for one time step.

    Parameters
    ----------
    scene : Scene
    tracks : Tracks
    roads : RoadTables
    actions : Actions
    kept : Kept
    n : int
        Scenario.
    dt : float
        s.

    Returns
    -------
    int
        `ACTED`, or what has become of the first that has not acted: then none has.
    """
    i = 0
    while kept.live[i] >= 0:
        j = kept.live[i]
        kind, goes_on, became = actions.options[j, 0], False, ENDED
        _keep(scene, actions, kept, n, j)
        if kind == SPEED_ACTION:
            goes_on = _change_speed(scene, actions, n, j, dt)
        elif kind == TRAJECTORY_ACTION:
            goes_on = _follow_trajectory(scene, tracks, actions, n, j, dt)
        elif kind == LANE_CHANGE:
            goes_on = _change_lane(scene, tracks, actions, n, j, dt)
        elif kind == LANE_OFFSET:
            goes_on = _change_offset(scene, tracks, actions, n, j, dt)
        elif kind == SYNCHRONISATION:
            became = synchronise(scene, tracks, roads, actions, n, j, dt)
            goes_on = became == ACTED
        elif kind == DISTANCE_ACTION:
            goes_on = keep_distance(scene, actions, n, j, dt)
        if not goes_on:
            while i >= 0:
                _take_back(scene, actions, kept, n, kept.live[i])
                i -= 1
            return became
        i += 1
    return ACTED


@_part
def _keep(scene, actions, kept, n, j):
    f, e, kind, master = scene.floats[n], actions.options[j, 1], actions.options[j, 0], actions.options[j, 2]
    if kind == UNKNOWN:
        return
    kept.flag[j] = scene.flags[n, _flag_of(kind), e]
    # Loops of a fixed length cost least.
    if kind == TRAJECTORY_ACTION:
        for k in range(len(_OF_TRAJECTORY)):
            kept.floats[j, k] = f[_OF_TRAJECTORY[k], e]
        kept.memory[j, 1] = actions.memory[n, j, 1]
        return
    if _decides_speed(kind):
        for k in range(len(_OF_SPEED)):
            kept.floats[j, k] = f[_OF_SPEED[k], e]
    else:
        for k in range(len(_OF_PLACE)):
            kept.floats[j, k] = f[_OF_PLACE[k], e]
    for k in range(_FEW):
        kept.memory[j, k] = actions.memory[n, j, k]
    if kind == SYNCHRONISATION:
        # It looks its master up on the road, too.
        kept.floats[j, len(_OF_PLACE)] = f[LAST_S, master]
    elif kind == SPEED_ACTION:
        for k in range(_FEW, CHANGING):
            kept.memory[j, k] = actions.memory[n, j, k]


@_part
def _decides_speed(kind):
    return kind in (SPEED_ACTION, SYNCHRONISATION, DISTANCE_ACTION)


@_part
def _flag_of(kind):
    return DECIDED if _decides_speed(kind) else MOVED


@_kernel
def _take_back(scene, actions, kept, n, j):
    f, e, kind, master = scene.floats[n], actions.options[j, 1], actions.options[j, 0], actions.options[j, 2]
    if kind == UNKNOWN:
        return
    scene.flags[n, _flag_of(kind), e] = kept.flag[j]
    if kind == TRAJECTORY_ACTION:
        for k in range(len(_OF_TRAJECTORY)):
            f[_OF_TRAJECTORY[k], e] = kept.floats[j, k]
        actions.memory[n, j, 1] = kept.memory[j, 1]
        return
    if _decides_speed(kind):
        for k in range(len(_OF_SPEED)):
            f[_OF_SPEED[k], e] = kept.floats[j, k]
    else:
        for k in range(len(_OF_PLACE)):
            f[_OF_PLACE[k], e] = kept.floats[j, k]
    for k in range(CHANGING if kind == SPEED_ACTION else _FEW):
        actions.memory[n, j, k] = kept.memory[j, k]
    if kind == SYNCHRONISATION:
        f[LAST_S, master] = kept.floats[j, len(_OF_PLACE)]
        f[ROAD_SPEED, e] = f[ROAD_SPEED, master] = UNASKED


@_kernel
def _shaped(shape, part):
    part = min(max(part, 0.0), 1.0)
    if shape == _CUBIC:
        return part * part * (3.0 - 2.0 * part)
    return 0.5 - 0.5 * math.cos(math.pi * part) if shape == _SINUSOIDAL else part


@_kernel
def _steepness(shape, part):
    part = min(max(part, 0.0), 1.0)
    if shape == _CUBIC:
        return 6.0 * part * (1.0 - part)
    return 0.5 * math.pi * math.sin(math.pi * part) if shape == _SINUSOIDAL else 1.0


@_kernel
def _change_speed(scene, actions, n, j, dt):
    """Twin of `SpeedAction.step`: from, to, parameter, span, stretch, reached, value, rate are remembered."""
    options, m, f = actions.options[j], actions.memory[n, j], scene.floats[n]
    e, shape, dimension, reference, factor, continuous = options[1:7]
    box = scene.boxes[e]
    if reference >= 0:
        target = f[SPEED, reference] * m[6] if factor else f[SPEED, reference] + m[6]
        m[1] = min(max(target, -box[MAX_SPEED]), box[MAX_SPEED])
        if dimension == _RATE:
            peak = 1.5 if shape == _CUBIC else 0.5 * math.pi if shape == _SINUSOIDAL else 1.0
            m[3] = 0.0 if shape == _STEP else max(peak * abs(m[1] - m[0]) / max(abs(m[7]), _TINY), _TINY)
    begin, end, span, stretch = m[0], m[1], m[3], m[4]
    now, driven = f[SPEED, e], scene.flags[n, DRIVEN, e]
    settled = span > 0.0 and m[2] > span - _TINY
    parameter = min(max(m[2] + dt / stretch, 0.0), span)
    at_once = span < _TINY and (shape == _STEP or dimension != _RATE)
    wanted = end if at_once else begin + _shaped(shape, parameter / max(span, _TINY)) * (end - begin)
    asked = end if settled else wanted
    if driven:
        speed = asked
    elif dt > 0.0:
        speed = min(max(asked, now - box[MAX_DECELERATION] * dt), now + box[MAX_ACCELERATION] * dt)
    else:
        speed = now if settled else wanted
    late = abs(speed - asked) > _TINY * dt and not settled and dt > 0.0
    if settled:
        parameter = m[2]
    elif late:
        # A change that the vehicle is too slow for takes longer: the parameter falls back behind the time.
        share = (speed - now) / (wanted - now)
        parameter = min(max(parameter - dt * (1.0 - share) / stretch, 0.0), span)
    else:
        speed = asked
    m[2] = parameter
    if parameter > span - _TINY and abs(speed - end) < _TINY:
        m[5], speed = 1.0, end
    set_speed(scene, n, e, speed)
    if scene.time[n] == 0.0:
        f[SPEED, e] = speed
    return continuous or not m[5] > 0.0


@_kernel
def _follow_trajectory(scene, tracks, actions, n, j, dt):
    """Twin of `FollowTrajectoryAction.step`: sign, whether it was oriented, and its clock are remembered."""
    options, m, f = actions.options[j], actions.memory[n, j], scene.floats[n]
    e, timed = options[1], options[2]
    track = scene.numbers[n, TRACK, e]
    row = tracks.row[e, track] if track >= 0 else -1
    if row < 0 or tracks.kind[row] == LANE or tracks.kind[row] == OTHER:
        return False
    before = f[DISTANCE, e]
    if timed:
        time, last = scene.time[n] + dt + m[2], trajectory_end(tracks, row, n)
        if time > last - _TINY:
            return False
        along = trajectory_distance_at(tracks, row, n, time)
        if dt > 0.0:
            against = math.cos(f[HEADING, e] - trajectory_direction(tracks, row, n, before)) < -_TINY
            gone = abs(along - before) / dt
            f[SPEED, e] = -gone if (along < before) != against else gone
    else:
        way, length = f[SPEED, e] * m[0] * dt, trajectory_length(tracks, row, n)
        along = min(max(before + way, 0.0), length)
        if (along > length - _TINY and way > 0.0) or (along < _TINY and way < 0.0):
            return False
    oriented = trajectory_oriented(tracks, row, n, along)
    if not oriented and m[1] > 0.0:
        # From here on the line alone gives the heading: settled by the storyboard.
        return False
    m[1] = 1.0 if oriented else 0.0
    f[TURN, e] = 0.0 if oriented or m[0] > 0.0 else math.pi
    f[DISTANCE, e] = along
    scene.flags[n, MOVED, e] = True
    settle(scene, tracks, n, e, row)
    return True


@_kernel
def _change_lane(scene, tracks, actions, n, j, dt):
    """Twin of `LaneChangeAction.step`: from, to, done and extent are remembered."""
    options, m, f, b = actions.options[j], actions.memory[n, j], scene.floats[n], scene.flags[n]
    e, shape, dimension = options[1], options[2], options[3]
    track = scene.numbers[n, TRACK, e]
    row = tracks.row[e, track] if track >= 0 else -1
    begin, end, extent = m[0], m[1], m[3]
    if row < 0 or extent <= _TINY:
        return False
    speed, change = f[SPEED, e], end - begin
    way = ahead = abs(speed) * dt
    if abs(speed) > _TINY:
        rate = change / extent * _steepness(shape, m[2] / extent)
        if dimension == _DISTANCE:
            ahead = way / math.sqrt(1.0 + rate * rate)
            done = m[2] + ahead
            part = _shaped(shape, done / extent)
            # As in esmini, the heading is that of driving forwards even where the entity drives backwards.
            turn = math.atan(rate)
        else:
            across = min(dt * abs(rate), way)
            side = 1.0 if rate > 0.0 else -1.0 if rate < 0.0 else 0.0
            ahead = math.sqrt(max(way * way - across * across, 0.0))
            if dt * abs(rate) > way + _TINY:
                # An entity that is too slow for the change moves only sideways, at constant speed.
                done = m[2] + way * extent / abs(change)
                part, turn = min(max(done / extent, 0.0), 1.0), side * _SIDEWAYS
            else:
                done = m[2] + dt
                part, turn = _shaped(shape, done / extent), math.atan2(side * across, ahead)
            turn = turn if speed > 0.0 else -turn
        offset = begin + part * change
        if done > extent - _SHORT or abs(offset - end) < _TINY:
            return False
        m[2], f[OFFSET, e], f[TURN, e] = done, offset, turn
    else:
        ahead = 0.0
    f[PACE, e] = speed
    b[MOVED, e] = True
    last = scene.last_step[n]
    arrived = scene.time[n] + last if last > 0.0 else math.inf
    advance(scene, tracks, n, e, row, ahead if speed > 0.0 else -ahead if speed < 0.0 else 0.0, arrived)
    # At the end of the road it is over, wherever between the lanes that is.
    return not (abs(speed) > _TINY and math.isfinite(f[AT_END_SINCE, e]))


@_kernel
def _change_offset(scene, tracks, actions, n, j, dt):
    """Twin of `LaneOffsetAction.step`: from, to, elapsed and duration are remembered."""
    options, m, f = actions.options[j], actions.memory[n, j], scene.floats[n]
    e, shape = options[1], options[2]
    begin, end, elapsed, duration = m[0], m[1], m[2], m[3]
    if not duration > 0.0 or elapsed > duration - _TINY:
        return False
    offset = begin + _shaped(shape, elapsed / duration) * (end - begin)
    if abs(offset - end) < _TINY:
        return False
    slope = (end - begin) / duration * _steepness(shape, elapsed / duration)
    speed = f[SPEED, e]
    f[OFFSET, e] = offset
    f[TURN, e] = math.atan(slope / (speed if abs(speed) > _TINY else _TINY))
    m[2] = elapsed + dt
    track = scene.numbers[n, TRACK, e]
    if track >= 0:
        settle(scene, tracks, n, e, tracks.row[e, track])
    return True
