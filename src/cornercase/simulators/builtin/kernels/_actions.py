"""Kernels that apply the actions of one scenario for one time step."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator, call-arg"

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import types

from cornercase._common.numba.kernel import kernel
from cornercase._common.numba.late_kernels import LateKernels
from cornercase._common.numba.pointers import call_for_int
from cornercase._common.numba.tuple_pointers import reference_to
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.simulators.builtin.kernels._action_table import (
    ACTION_APPLIED,
    ACTION_ENDED,
    DISTANCE_ACTION,
    LANE_CHANGE_ACTION,
    LANE_OFFSET_ACTION,
    N_SAVED,
    NEEDS_PYTHON,
    PYTHON_ACTION,
    SPEED_ACTION,
    SYNCHRONIZE_ACTION,
    TRACK_ENDED,
    TRAJECTORY_ACTION,
    ActionTable,
)
from cornercase.simulators.builtin.kernels._move import advance_along_track, place_on_track, set_speed
from cornercase.simulators.builtin.kernels._simulation_state import (
    MAX_ACCELERATION,
    MAX_DECELERATION,
    MAX_SPEED,
    SimulationState,
)
from cornercase.simulators.builtin.kernels._synchronize import apply_distance_action, apply_synchronize_action
from cornercase.simulators.builtin.track_kernels._track_dispatch import (
    pose_on_track,
    trajectory_direction,
    trajectory_distance_at_time,
    trajectory_end_time,
    trajectory_has_heading,
    trajectory_length,
)
from cornercase.simulators.builtin.track_kernels._track_layout import TrackTable
from cornercase.simulators.builtin.world._state_layout import (
    AT_END_SINCE,
    CHANGES_LANES,
    DECIDED,
    DISTANCE,
    DRIVEN,
    HEADING,
    LAST_S,
    MOVED,
    OFFSET,
    PACE,
    ROAD_HEADING,
    SPEED,
    STEERED,
    TARGET_SPEED,
    TRACK,
    TURN,
    X,
    Y,
)

_CUBIC, _SINUSOIDAL, _STEP = 1, 2, 3
_RATE, _DISTANCE = 1, 2
_EPSILON: Final = 1e-6
# Lane offsets, and the extent of a change (s or m), are accurate to about 1e-5.
_EXTENT_TOLERANCE: Final = 1e-4
# rad; purely lateral motion turns the entity by slightly less than a right angle, so that it still points along its
# lane, also in bends, where lane headings are accurate to a fraction of the difference.
_SIDEWAYS_HEADING: Final = 0.5 * math.pi - 1e-3

# State rows of their entity that actions change, if they control the speed, follow a trajectory, or move laterally.
_SPEED_ACTION_ROWS: Final = (TARGET_SPEED, SPEED, LAST_S)
_TRAJECTORY_ACTION_ROWS: Final = (SPEED, X, Y, HEADING, DISTANCE, TURN)
_LATERAL_ACTION_ROWS: Final = (SPEED, X, Y, HEADING, DISTANCE, TURN, OFFSET, PACE, AT_END_SINCE)
# Number of stored values (the first ones) that usually change from step to step.
_N_SAVED_USUALLY: Final = 4

_kernel = kernel(error_model="numpy", _nrt=False)
# Inlined, since it is called once and passing the tables would cost more than the work.
_inlined_kernel = kernel(error_model="numpy", _nrt=False, forceinline=True)


class SavedState(NamedTuple):
    """State of a scenario before each of J actions is applied, from which the actions can be undone."""

    running: IntArray  # (J + 1,): running actions in order, then -1
    floats: FloatArray  # (J, 10)
    flag: BoolArray  # (J,)
    changes_lanes: BoolArray  # (J,)
    memory: FloatArray  # (J, 8)


@kernel(error_model="numpy")
def alloc_saved_state(n_actions):
    """Allocate memory for the state that is saved before each action of a scenario."""
    floats, flag = np.empty((n_actions, len(_LATERAL_ACTION_ROWS) + 1)), np.empty(n_actions, dtype=np.bool_)
    running, memory = np.empty(n_actions + 1, dtype=np.int64), np.empty((n_actions, N_SAVED))
    return SavedState(running, floats, flag, np.empty(n_actions, dtype=np.bool_), memory)


@_inlined_kernel
def list_running_actions(actions, saved, n):
    """Write the indices of the running actions of a scenario to `saved.running`, followed by -1."""
    count = 0
    for j in range(actions.options.shape[0]):
        if actions.is_running[n, j]:
            saved.running[count] = j
            count += 1
    saved.running[count] = -1


@_inlined_kernel
def apply_actions(scene, tracks, roads, actions, saved, n, dt):
    """Apply all running actions of a scenario for one time step.

    Returns `ACTION_APPLIED` if all actions were applied and go on. If an action ends or cannot be applied, undoes the
    changes of all actions and returns the outcome of this action.
    """
    i = 0
    while saved.running[i] >= 0:
        j = saved.running[i]
        _save_state_before_action(scene, actions, saved, n, j)
        outcome = apply_action(scene, tracks, roads, actions, n, j, dt)
        if outcome != ACTION_APPLIED:
            while i >= 0:
                _undo_action(scene, actions, saved, n, saved.running[i])
                i -= 1
            return outcome
        i += 1
    return ACTION_APPLIED


@_inlined_kernel
def apply_action(scene, tracks, roads, actions, n, j, dt):
    """Apply an action of a scenario for one time step of `dt` s; return the outcome, such as `ACTION_APPLIED`."""
    action_type, arguments = actions.options[j, 0], (scene, tracks, roads, actions, n, j, dt)
    if action_type == PYTHON_ACTION:
        return NEEDS_PYTHON
    if action_type == SPEED_ACTION:
        return _apply_speed_action(scene, actions, n, j, dt)
    if action_type == TRAJECTORY_ACTION:
        return _apply_trajectory_action(scene, tracks, actions, n, j, dt)
    if action_type == LANE_CHANGE_ACTION:
        return call_for_int(_apply_lane_change, actions.kernels[LANE_CHANGE_ACTION], arguments)
    if action_type == LANE_OFFSET_ACTION:
        return call_for_int(_apply_lane_offset, actions.kernels[LANE_OFFSET_ACTION], arguments)
    if action_type == SYNCHRONIZE_ACTION:
        return call_for_int(apply_synchronize_action, actions.kernels[SYNCHRONIZE_ACTION], arguments)
    return call_for_int(apply_distance_action, actions.kernels[DISTANCE_ACTION], arguments)


@_inlined_kernel
def _save_state_before_action(scene, actions, saved, n, j):
    state, e, action_type, master = scene.floats[n], actions.options[j, 1], actions.options[j, 0], actions.options[j, 2]
    if action_type == PYTHON_ACTION:
        return
    saved.flag[j] = scene.flags[n, _flag_set_by_action(action_type), e]
    # Loops of a fixed length are fastest.
    if action_type == TRAJECTORY_ACTION:
        for k in range(len(_TRAJECTORY_ACTION_ROWS)):
            saved.floats[j, k] = state[_TRAJECTORY_ACTION_ROWS[k], e]
        for k in range(2):
            saved.memory[j, k] = actions.memory[n, j, k]
        return
    if _is_speed_controlling(action_type):
        for k in range(len(_SPEED_ACTION_ROWS)):
            saved.floats[j, k] = state[_SPEED_ACTION_ROWS[k], e]
    else:
        saved.changes_lanes[j] = scene.flags[n, CHANGES_LANES, e]
        for k in range(len(_LATERAL_ACTION_ROWS)):
            saved.floats[j, k] = state[_LATERAL_ACTION_ROWS[k], e]
    for k in range(_N_SAVED_USUALLY):
        saved.memory[j, k] = actions.memory[n, j, k]
    if action_type == SYNCHRONIZE_ACTION:
        # A synchronize action also locates its master on the road.
        saved.floats[j, len(_LATERAL_ACTION_ROWS)] = state[LAST_S, master]
    elif action_type == SPEED_ACTION:
        for k in range(_N_SAVED_USUALLY, N_SAVED):
            saved.memory[j, k] = actions.memory[n, j, k]


@_inlined_kernel
def _is_speed_controlling(action_type):
    return action_type in (SPEED_ACTION, SYNCHRONIZE_ACTION, DISTANCE_ACTION)


@_inlined_kernel
def _flag_set_by_action(action_type):
    return DECIDED if _is_speed_controlling(action_type) else MOVED


@_kernel
def _undo_action(scene, actions, saved, n, j):
    state, e, action_type, master = scene.floats[n], actions.options[j, 1], actions.options[j, 0], actions.options[j, 2]
    if action_type == PYTHON_ACTION:
        return
    scene.flags[n, _flag_set_by_action(action_type), e] = saved.flag[j]
    if action_type == TRAJECTORY_ACTION:
        for k in range(len(_TRAJECTORY_ACTION_ROWS)):
            state[_TRAJECTORY_ACTION_ROWS[k], e] = saved.floats[j, k]
        for k in range(2):
            actions.memory[n, j, k] = saved.memory[j, k]
        return
    if _is_speed_controlling(action_type):
        for k in range(len(_SPEED_ACTION_ROWS)):
            state[_SPEED_ACTION_ROWS[k], e] = saved.floats[j, k]
    else:
        scene.flags[n, CHANGES_LANES, e] = saved.changes_lanes[j]
        for k in range(len(_LATERAL_ACTION_ROWS)):
            state[_LATERAL_ACTION_ROWS[k], e] = saved.floats[j, k]
    for k in range(N_SAVED if action_type == SPEED_ACTION else _N_SAVED_USUALLY):
        actions.memory[n, j, k] = saved.memory[j, k]
    if action_type == SYNCHRONIZE_ACTION:
        state[LAST_S, master] = saved.floats[j, len(_LATERAL_ACTION_ROWS)]
        state[ROAD_HEADING, e] = state[ROAD_HEADING, master] = math.nan


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
    """Apply a speed action for one time step, and return the outcome.

    While a parameter in s grows from 0 to the span in s, the speed changes from its start value to its end value.
    Stored values: start and end speed, parameter, span, factor by which the change takes longer than the span, whether
    the end is reached, target value in the file, rate of change in the file.
    """
    options, memory, state = actions.options[j], actions.memory[n, j], scene.floats[n]
    e, shape, dimension, reference, factor, continuous = options[1:7]
    limits = scene.dimensions[e]
    if reference >= 0:
        target = state[SPEED, reference] * memory[6] if factor else state[SPEED, reference] + memory[6]
        memory[1] = min(max(target, -limits[MAX_SPEED]), limits[MAX_SPEED])
    if dimension == _RATE and shape != _STEP:
        peak_rate = 1.5 if shape == _CUBIC else 0.5 * math.pi if shape == _SINUSOIDAL else 1.0
        memory[3] = max(peak_rate * abs(memory[1] - memory[0]) / max(abs(memory[7]), _EPSILON), _EPSILON)
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
    return ACTION_ENDED if memory[5] > 0.0 and not continuous else ACTION_APPLIED


@_kernel
def _apply_trajectory_action(scene, tracks, actions, n, j, dt):
    """Apply an action that follows a trajectory for one time step, and return the outcome.

    Stored values: sign, whether the trajectory gave the heading in the previous step, clock offset in s, number of the
    trajectory among the entity's tracks. The sign is -1 if the entity points backwards along the trajectory, so that
    driving forwards takes the entity towards the start of the trajectory; otherwise the sign is 1.
    """
    options, memory, state = actions.options[j], actions.memory[n, j], scene.floats[n]
    e, is_timed = options[1], options[2]
    row = tracks.rows[e, int(memory[3])]
    before, beyond = state[DISTANCE, e], 0.0
    if scene.flags[n, STEERED, e] and scene.flags[n, DRIVEN, e]:
        # The driver has left the trajectory with the entity, or steers the entity to its end.
        if scene.integers[n, TRACK, e] != int(memory[3]):
            return ACTION_ENDED
        return TRACK_ENDED if before > trajectory_length(tracks, row, n) - _EPSILON else ACTION_APPLIED
    if is_timed:
        time, end_time = scene.time[n] + dt + memory[2], trajectory_end_time(tracks, row, n)
        is_over = time > end_time - _EPSILON
        distance = trajectory_distance_at_time(tracks, row, n, time)
        if dt > 0.0 and time < end_time + _EPSILON:
            # An entity that points against the line drives backwards.
            is_against = math.cos(state[HEADING, e] - trajectory_direction(tracks, row, n, before)) < -_EPSILON
            size = abs(distance - before) / dt
            state[SPEED, e] = -size if (distance < before) != is_against else size
        beyond = (time - end_time) * state[SPEED, e]
    else:
        step, length = state[SPEED, e] * memory[0] * dt, trajectory_length(tracks, row, n)
        distance = min(max(before + step, 0.0), length)
        is_at_end = distance > length - _EPSILON and step > 0.0
        is_over = is_at_end or (distance < _EPSILON and step < 0.0)
        # At the start, the rest of the step is dropped, as in esmini.
        beyond = max(abs(step) - abs(distance - before), 0.0) if is_at_end else 0.0
    is_oriented = trajectory_has_heading(tracks, row, n, distance)
    if not is_oriented and memory[1] > 0.0:
        # From here on the line determines the heading: keep the current direction.
        heading, direction = (
            pose_on_track(tracks, row, n, distance, 0.0)[2],
            trajectory_direction(tracks, row, n, distance),
        )
        memory[0] = -1.0 if math.cos(heading - direction) < -_EPSILON else 1.0
    memory[1] = 1.0 if is_oriented else 0.0
    state[TURN, e] = 0.0 if is_oriented or memory[0] > 0.0 else math.pi
    state[DISTANCE, e] = distance
    scene.flags[n, MOVED, e] = True
    track = scene.integers[n, TRACK, e]
    if track >= 0:
        place_on_track(scene, tracks, n, e, tracks.rows[e, track])
    if not is_over:
        return ACTION_APPLIED
    heading = state[HEADING, e] - state[TURN, e]
    state[X, e] += beyond * math.cos(heading)
    state[Y, e] += beyond * math.sin(heading)
    return TRACK_ENDED


@_kernel
def _apply_lane_change(scene, tracks, roads, actions, n, j, dt):
    """Apply a lane change for one time step, and return the outcome.

    Stored values: lateral offset in m at the start and at the end of the change; progress and extent of the change,
    both in s, or both in m if the dimension of the change is distance.
    """
    options, memory, state, flags = actions.options[j], actions.memory[n, j], scene.floats[n], scene.flags[n]
    e, shape, dimension = options[1], options[2], options[3]
    track = scene.integers[n, TRACK, e]
    row = tracks.rows[e, track] if track >= 0 else -1
    begin, end, extent = memory[0], memory[1], memory[3]
    speed, change, has_arrived = state[SPEED, e], end - begin, False
    path = ahead = abs(speed) * dt
    if abs(speed) > _EPSILON:
        offset, turn, is_abrupt = end, 0.0, extent <= _EPSILON
        if not is_abrupt:
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
            offset, memory[2] = begin + fraction * change, done
        has_arrived = is_abrupt or done > extent - _EXTENT_TOLERANCE or abs(offset - end) < _EPSILON
        state[OFFSET, e], state[TURN, e] = offset, 0.0 if has_arrived else turn
        flags[CHANGES_LANES, e] = flags[CHANGES_LANES, e] and not has_arrived
    else:
        ahead = 0.0
    # The entity moves even if it was just placed. A speed set by another action in this frame counts from the next one.
    state[PACE, e] = speed
    flags[MOVED, e] = True
    previous_step = scene.last_step[n]
    arrived = scene.time[n] + previous_step if previous_step > 0.0 else math.inf
    if row >= 0:
        advance_along_track(scene, tracks, n, e, row, ahead if speed > 0.0 else -ahead if speed < 0.0 else 0.0, arrived)
    if has_arrived:
        return ACTION_ENDED
    # At the end of the road the lane change ends, even between lanes.
    is_stuck = abs(speed) > _EPSILON and math.isfinite(state[AT_END_SINCE, e])
    return TRACK_ENDED if is_stuck else ACTION_APPLIED


@_kernel
def _apply_lane_offset(scene, tracks, roads, actions, n, j, dt):
    """Apply a lane offset action for one time step, and return the outcome.

    Stored values: offset at start and end in m; elapsed time and duration in s.
    """
    options, memory, state = actions.options[j], actions.memory[n, j], scene.floats[n]
    e, shape = options[1], options[2]
    begin, end, elapsed, duration = memory[0], memory[1], memory[2], memory[3]
    fraction = elapsed / duration if duration > 0.0 else 1.0
    offset = begin + _transition_value(shape, fraction) * (end - begin)
    has_arrived = elapsed > duration - _EPSILON or abs(offset - end) < _EPSILON
    if has_arrived:
        state[OFFSET, e], state[TURN, e] = end, 0.0
    else:
        slope, speed = (end - begin) / duration * _transition_slope(shape, fraction), state[SPEED, e]
        state[OFFSET, e] = offset
        state[TURN, e] = math.atan(slope / (speed if abs(speed) > _EPSILON else _EPSILON))
    memory[2] = elapsed + dt
    # Later actions of the frame see the new position.
    track = scene.integers[n, TRACK, e]
    if track >= 0:
        place_on_track(scene, tracks, n, e, tracks.rows[e, track])
    return ACTION_ENDED if has_arrived else ACTION_APPLIED


ACTION_KERNELS: Final = LateKernels(
    {
        LANE_CHANGE_ACTION: _apply_lane_change,
        LANE_OFFSET_ACTION: _apply_lane_offset,
        SYNCHRONIZE_ACTION: apply_synchronize_action,
        DISTANCE_ACTION: apply_distance_action,
    },
    types.int64,
)
"""Kernels of the less frequent types of actions, which are compiled only when needed."""


def compile_action_kernels(
    scene: SimulationState, tracks: TrackTable, roads: tuple[object, ...], actions: ActionTable
) -> None:
    """Compile the kernels that the actions in a table need; call this before compiled code applies actions."""
    kinds = types.int64, types.int64, types.float64
    ACTION_KERNELS.compile_needed(actions.options[:, 0].tolist(), scene, tracks, roads, actions, *kinds)


@kernel(interpreted_seconds=lambda *arguments: 5e-5 * arguments[4].size, error_model="numpy")
def apply_action_in_scenarios(scene, tracks, roads, actions, scenarios, j, dt):
    """Apply an action for one time step in K scenarios, and return the outcomes, shape (K,)."""
    outcomes = np.empty(scenarios.size, dtype=np.int64)
    tables = reference_to(scene), reference_to(tracks), reference_to(roads), reference_to(actions)
    for i in range(scenarios.size):
        outcomes[i] = apply_action(tables[0], tables[1], tables[2], tables[3], scenarios[i], j, dt)
    return outcomes
