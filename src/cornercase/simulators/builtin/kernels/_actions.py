"""Kernels of actions for one scenario and one time step in which none of them ends; NumPy versions are in `actions`."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from cornercase._common.numba.kernel import kernel
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.simulators.builtin.kernels._action_table import (
    DISTANCE_ACTION,
    LANE_CHANGE_ACTION,
    LANE_OFFSET_ACTION,
    N_SAVED,
    PYTHON_ACTION,
    SPEED_ACTION,
    SYNCHRONIZE_ACTION,
    TRAJECTORY_ACTION,
)
from cornercase.simulators.builtin.kernels._move import advance_along_track, place_on_track, set_speed
from cornercase.simulators.builtin.kernels._simulation_state import MAX_ACCELERATION, MAX_DECELERATION, MAX_SPEED
from cornercase.simulators.builtin.kernels._synchronize import (
    ACTION_APPLIED,
    ACTION_NOT_APPLIED,
    apply_distance_action,
    apply_synchronize_action,
)
from cornercase.simulators.builtin.track_kernels._track_dispatch import (
    trajectory_direction,
    trajectory_distance_at_time,
    trajectory_end_time,
    trajectory_has_heading,
    trajectory_length,
)
from cornercase.simulators.builtin.track_kernels._track_layout import LANE_TRACK, PYTHON_TRACK
from cornercase.simulators.builtin.world._state_layout import (
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
    UNKNOWN_ROAD_SPEED,
    X,
    Y,
)

_CUBIC, _SINUSOIDAL, _STEP = 1, 2, 3
_RATE, _DISTANCE = 1, 2
_EPSILON: Final = 1e-6
# Lane offsets, and the extent of a change (s or m), are accurate to about 1e-5.
_EXTENT_TOLERANCE: Final = 1e-4
# rad; heading of an entity that moves only sideways: a little less than a right angle.
_SIDEWAYS_HEADING: Final = 0.5 * math.pi - 1e-3

# Rows that actions change of their own entity: those that control speed, follow a trajectory, or move laterally.
_SPEED_ACTION_ROWS: Final = (TARGET_SPEED, SPEED, LAST_S)
_TRAJECTORY_ACTION_ROWS: Final = (SPEED, X, Y, HEADING, DISTANCE, TURN)
_LATERAL_ACTION_ROWS: Final = (SPEED, X, Y, HEADING, DISTANCE, TURN, OFFSET, PACE, AT_END_SINCE)
# Number of memory values, the first ones, that usually change from step to step.
_N_SAVED_USUALLY: Final = 4

_kernel = kernel(error_model="numpy", _nrt=False)
# Inlined, since it is called once and passing the tables would cost more than the work.
_inlined_kernel = kernel(error_model="numpy", _nrt=False, forceinline=True)


class SavedState(NamedTuple):
    """What J actions may change of one scenario, saved before each action."""

    running: IntArray  # (J + 1,): running actions in order, then -1
    floats: FloatArray  # (J, 10)
    flag: BoolArray  # (J,)
    memory: FloatArray  # (J, 8)


@kernel(error_model="numpy")
def alloc_saved(n_actions):
    """Allocate the saved state of a scenario's actions."""
    floats, flag = np.empty((n_actions, len(_LATERAL_ACTION_ROWS) + 1)), np.empty(n_actions, dtype=np.bool_)
    return SavedState(np.empty(n_actions + 1, dtype=np.int64), floats, flag, np.empty((n_actions, N_SAVED)))


@_inlined_kernel
def list_running_actions(actions, saved, n):
    """List the running actions of a scenario."""
    count = 0
    for j in range(actions.options.shape[0]):
        if actions.is_running[n, j]:
            saved.running[count] = j
            count += 1
    saved.running[count] = -1


@_inlined_kernel
def apply_actions(scene, tracks, roads, actions, saved, n, dt):
    """Apply all actions of a scenario for one time step.

    Returns `ACTION_APPLIED`, or the outcome of the first action that could not be applied; then all changes are undone.
    """
    i = 0
    while saved.running[i] >= 0:
        j = saved.running[i]
        action_type, is_applied, outcome = actions.options[j, 0], False, ACTION_NOT_APPLIED
        _save(scene, actions, saved, n, j)
        if action_type == SPEED_ACTION:
            is_applied = _apply_speed_action(scene, actions, n, j, dt)
        elif action_type == TRAJECTORY_ACTION:
            is_applied = _apply_trajectory_action(scene, tracks, actions, n, j, dt)
        elif action_type == LANE_CHANGE_ACTION:
            is_applied = _apply_lane_change(scene, tracks, actions, n, j, dt)
        elif action_type == LANE_OFFSET_ACTION:
            is_applied = _apply_lane_offset(scene, tracks, actions, n, j, dt)
        elif action_type == SYNCHRONIZE_ACTION:
            outcome = apply_synchronize_action(scene, tracks, roads, actions, n, j, dt)
            is_applied = outcome == ACTION_APPLIED
        elif action_type == DISTANCE_ACTION:
            is_applied = apply_distance_action(scene, actions, n, j, dt)
        if not is_applied:
            while i >= 0:
                _restore(scene, actions, saved, n, saved.running[i])
                i -= 1
            return outcome
        i += 1
    return ACTION_APPLIED


@_inlined_kernel
def _save(scene, actions, saved, n, j):
    state, e, action_type, master = scene.floats[n], actions.options[j, 1], actions.options[j, 0], actions.options[j, 2]
    if action_type == PYTHON_ACTION:
        return
    saved.flag[j] = scene.flags[n, _flag_row(action_type), e]
    # Loops of a fixed length are fastest.
    if action_type == TRAJECTORY_ACTION:
        for k in range(len(_TRAJECTORY_ACTION_ROWS)):
            saved.floats[j, k] = state[_TRAJECTORY_ACTION_ROWS[k], e]
        saved.memory[j, 1] = actions.memory[n, j, 1]
        return
    if _is_speed_controlling(action_type):
        for k in range(len(_SPEED_ACTION_ROWS)):
            saved.floats[j, k] = state[_SPEED_ACTION_ROWS[k], e]
    else:
        for k in range(len(_LATERAL_ACTION_ROWS)):
            saved.floats[j, k] = state[_LATERAL_ACTION_ROWS[k], e]
    for k in range(_N_SAVED_USUALLY):
        saved.memory[j, k] = actions.memory[n, j, k]
    if action_type == SYNCHRONIZE_ACTION:
        # It also locates its master on the road.
        saved.floats[j, len(_LATERAL_ACTION_ROWS)] = state[LAST_S, master]
    elif action_type == SPEED_ACTION:
        for k in range(_N_SAVED_USUALLY, N_SAVED):
            saved.memory[j, k] = actions.memory[n, j, k]


@_inlined_kernel
def _is_speed_controlling(action_type):
    return action_type in (SPEED_ACTION, SYNCHRONIZE_ACTION, DISTANCE_ACTION)


@_inlined_kernel
def _flag_row(action_type):
    return DECIDED if _is_speed_controlling(action_type) else MOVED


@_kernel
def _restore(scene, actions, saved, n, j):
    state, e, action_type, master = scene.floats[n], actions.options[j, 1], actions.options[j, 0], actions.options[j, 2]
    if action_type == PYTHON_ACTION:
        return
    scene.flags[n, _flag_row(action_type), e] = saved.flag[j]
    if action_type == TRAJECTORY_ACTION:
        for k in range(len(_TRAJECTORY_ACTION_ROWS)):
            state[_TRAJECTORY_ACTION_ROWS[k], e] = saved.floats[j, k]
        actions.memory[n, j, 1] = saved.memory[j, 1]
        return
    if _is_speed_controlling(action_type):
        for k in range(len(_SPEED_ACTION_ROWS)):
            state[_SPEED_ACTION_ROWS[k], e] = saved.floats[j, k]
    else:
        for k in range(len(_LATERAL_ACTION_ROWS)):
            state[_LATERAL_ACTION_ROWS[k], e] = saved.floats[j, k]
    for k in range(N_SAVED if action_type == SPEED_ACTION else _N_SAVED_USUALLY):
        actions.memory[n, j, k] = saved.memory[j, k]
    if action_type == SYNCHRONIZE_ACTION:
        state[LAST_S, master] = saved.floats[j, len(_LATERAL_ACTION_ROWS)]
        state[ROAD_SPEED, e] = state[ROAD_SPEED, master] = UNKNOWN_ROAD_SPEED


@_kernel
def _transition_value(shape, fraction):
    fraction = min(max(fraction, 0.0), 1.0)
    if shape == _CUBIC:
        return fraction * fraction * (3.0 - 2.0 * fraction)
    return 0.5 - 0.5 * math.cos(math.pi * fraction) if shape == _SINUSOIDAL else fraction


@_kernel
def _transition_slope(shape, fraction):
    fraction = min(max(fraction, 0.0), 1.0)
    if shape == _CUBIC:
        return 6.0 * fraction * (1.0 - fraction)
    return 0.5 * math.pi * math.sin(math.pi * fraction) if shape == _SINUSOIDAL else 1.0


@_kernel
def _apply_speed_action(scene, actions, n, j, dt):
    """NumPy version: `SpeedAction.step`. Memory: from, to, parameter, span, stretch, reached, value, rate."""
    options, memory, state = actions.options[j], actions.memory[n, j], scene.floats[n]
    e, shape, dimension, reference, factor, continuous = options[1:7]
    limits = scene.dimensions[e]
    if reference >= 0:
        target = state[SPEED, reference] * memory[6] if factor else state[SPEED, reference] + memory[6]
        memory[1] = min(max(target, -limits[MAX_SPEED]), limits[MAX_SPEED])
        if dimension == _RATE:
            peak_rate = 1.5 if shape == _CUBIC else 0.5 * math.pi if shape == _SINUSOIDAL else 1.0
            memory[3] = (
                0.0
                if shape == _STEP
                else max(peak_rate * abs(memory[1] - memory[0]) / max(abs(memory[7]), _EPSILON), _EPSILON)
            )
    begin, end, span, stretch = memory[0], memory[1], memory[3], memory[4]
    current, has_driver = state[SPEED, e], scene.flags[n, DRIVEN, e]
    is_complete = span > 0.0 and memory[2] > span - _EPSILON
    parameter = min(max(memory[2] + dt / stretch, 0.0), span)
    is_immediate = span < _EPSILON and (shape == _STEP or dimension != _RATE)
    wanted = end if is_immediate else begin + _transition_value(shape, parameter / max(span, _EPSILON)) * (end - begin)
    requested = end if is_complete else wanted
    if has_driver:
        speed = requested
    elif dt > 0.0:
        speed = min(max(requested, current - limits[MAX_DECELERATION] * dt), current + limits[MAX_ACCELERATION] * dt)
    else:
        speed = current if is_complete else wanted
    is_late = abs(speed - requested) > _EPSILON * dt and not is_complete and dt > 0.0
    if is_complete:
        parameter = memory[2]
    elif is_late:
        # A change that exceeds the vehicle's limits takes longer: the parameter falls behind the time.
        progress = (speed - current) / (wanted - current)
        parameter = min(max(parameter - dt * (1.0 - progress) / stretch, 0.0), span)
    else:
        speed = requested
    memory[2] = parameter
    if parameter > span - _EPSILON and abs(speed - end) < _EPSILON:
        memory[5], speed = 1.0, end
    set_speed(scene, n, e, speed)
    if scene.time[n] == 0.0:
        state[SPEED, e] = speed
    return continuous or not memory[5] > 0.0


@_kernel
def _apply_trajectory_action(scene, tracks, actions, n, j, dt):
    """NumPy version: `FollowTrajectoryAction.step`. Memory: sign, whether it was oriented, clock offset."""
    options, memory, state = actions.options[j], actions.memory[n, j], scene.floats[n]
    e, is_timed = options[1], options[2]
    track = scene.integers[n, TRACK, e]
    row = tracks.rows[e, track] if track >= 0 else -1
    if row < 0 or tracks.kind[row] == LANE_TRACK or tracks.kind[row] == PYTHON_TRACK:
        return False
    before = state[DISTANCE, e]
    if is_timed:
        time, end_time = scene.time[n] + dt + memory[2], trajectory_end_time(tracks, row, n)
        if time > end_time - _EPSILON:
            return False
        distance = trajectory_distance_at_time(tracks, row, n, time)
        if dt > 0.0:
            is_against = math.cos(state[HEADING, e] - trajectory_direction(tracks, row, n, before)) < -_EPSILON
            size = abs(distance - before) / dt
            state[SPEED, e] = -size if (distance < before) != is_against else size
    else:
        step, length = state[SPEED, e] * memory[0] * dt, trajectory_length(tracks, row, n)
        distance = min(max(before + step, 0.0), length)
        if (distance > length - _EPSILON and step > 0.0) or (distance < _EPSILON and step < 0.0):
            return False
    is_oriented = trajectory_has_heading(tracks, row, n, distance)
    if not is_oriented and memory[1] > 0.0:
        # From here on only the line gives the heading; the storyboard handles that.
        return False
    memory[1] = 1.0 if is_oriented else 0.0
    state[TURN, e] = 0.0 if is_oriented or memory[0] > 0.0 else math.pi
    state[DISTANCE, e] = distance
    scene.flags[n, MOVED, e] = True
    place_on_track(scene, tracks, n, e, row)
    return True


@_kernel
def _apply_lane_change(scene, tracks, actions, n, j, dt):
    """NumPy version: `LaneChangeAction.step`. Memory: from, to, done, extent."""
    options, memory, state, flags = actions.options[j], actions.memory[n, j], scene.floats[n], scene.flags[n]
    e, shape, dimension = options[1], options[2], options[3]
    track = scene.integers[n, TRACK, e]
    row = tracks.rows[e, track] if track >= 0 else -1
    begin, end, extent = memory[0], memory[1], memory[3]
    if row < 0 or extent <= _EPSILON:
        return False
    speed, change = state[SPEED, e], end - begin
    path = ahead = abs(speed) * dt
    if abs(speed) > _EPSILON:
        rate = change / extent * _transition_slope(shape, memory[2] / extent)
        if dimension == _DISTANCE:
            ahead = path / math.sqrt(1.0 + rate * rate)
            done = memory[2] + ahead
            fraction = _transition_value(shape, done / extent)
            # As in esmini, the heading is that of driving forwards, even if the entity drives backwards.
            turn = math.atan(rate)
        else:
            across = min(dt * abs(rate), path)
            side = 1.0 if rate > 0.0 else -1.0 if rate < 0.0 else 0.0
            ahead = math.sqrt(max(path * path - across * across, 0.0))
            if dt * abs(rate) > path + _EPSILON:
                # An entity that is too slow for the change moves only sideways, at constant speed.
                done = memory[2] + path * extent / abs(change)
                fraction, turn = min(max(done / extent, 0.0), 1.0), side * _SIDEWAYS_HEADING
            else:
                done = memory[2] + dt
                fraction, turn = _transition_value(shape, done / extent), math.atan2(side * across, ahead)
            turn = turn if speed > 0.0 else -turn
        offset = begin + fraction * change
        if done > extent - _EXTENT_TOLERANCE or abs(offset - end) < _EPSILON:
            return False
        memory[2], state[OFFSET, e], state[TURN, e] = done, offset, turn
    else:
        ahead = 0.0
    state[PACE, e] = speed
    flags[MOVED, e] = True
    previous_step = scene.last_step[n]
    arrived = scene.time[n] + previous_step if previous_step > 0.0 else math.inf
    advance_along_track(scene, tracks, n, e, row, ahead if speed > 0.0 else -ahead if speed < 0.0 else 0.0, arrived)
    # It ends at the end of the road, even between lanes.
    return not (abs(speed) > _EPSILON and math.isfinite(state[AT_END_SINCE, e]))


@_kernel
def _apply_lane_offset(scene, tracks, actions, n, j, dt):
    """NumPy version: `LaneOffsetAction.step`. Memory: from, to, elapsed, duration."""
    options, memory, state = actions.options[j], actions.memory[n, j], scene.floats[n]
    e, shape = options[1], options[2]
    begin, end, elapsed, duration = memory[0], memory[1], memory[2], memory[3]
    if not duration > 0.0 or elapsed > duration - _EPSILON:
        return False
    offset = begin + _transition_value(shape, elapsed / duration) * (end - begin)
    if abs(offset - end) < _EPSILON:
        return False
    slope = (end - begin) / duration * _transition_slope(shape, elapsed / duration)
    speed = state[SPEED, e]
    state[OFFSET, e] = offset
    state[TURN, e] = math.atan(slope / (speed if abs(speed) > _EPSILON else _EPSILON))
    memory[2] = elapsed + dt
    track = scene.integers[n, TRACK, e]
    if track >= 0:
        place_on_track(scene, tracks, n, e, tracks.rows[e, track])
    return True
