"""Kernels of actions that synchronize an entity with another entity, or keep a distance to another entity."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math
from typing import Final

from cornercase._common.geometry.boxes import COS_RIGHT_ANGLE_TOLERANCE
from cornercase._common.numba.kernel import kernel
from cornercase.roads._kernels.heading import reference_cos_and_sin, reference_heading, stays_on_road
from cornercase.simulators.builtin.kernels._action_table import ACTION_APPLIED, ACTION_ENDED, NEEDS_LOOKUP, NEEDS_PYTHON
from cornercase.simulators.builtin.kernels._distances import FREE_SPACE, LONGITUDINAL_DISTANCE, distance_to_entity
from cornercase.simulators.builtin.kernels._move import set_speed
from cornercase.simulators.builtin.kernels._simulation_state import MAX_SPEED
from cornercase.simulators.builtin.track_kernels._lane_track import road_position_on_lane
from cornercase.simulators.builtin.track_kernels._track_layout import LANE_TRACK
from cornercase.simulators.builtin.world._state_layout import (
    CHANGES_LANES,
    DISTANCE,
    DRIVEN,
    GONE_X,
    GONE_Y,
    HEADING,
    LAST_ROAD,
    LAST_S,
    MAX_LANE_OFFSET,
    OFFSET,
    PRESENT,
    ROAD_HEADING,
    SPEED,
    TRACK,
    TURN,
    X,
    Y,
)

NOT_STARTED, FIRST_PHASE, LAST_PHASE, WAITING_FOR_MASTER, HARD_BRAKING, STANDING_STILL, AT_FINAL_SPEED = range(7)
"""Phase of a synchronization with another entity (the master).

`FIRST_PHASE` and `LAST_PHASE` have constant acceleration. `HARD_BRAKING` is used if the distance is too short for
anything else. `STANDING_STILL` lasts until the last phase begins. In `AT_FINAL_SPEED`, the entity keeps this speed."""

NO_FINAL_SPEED, ABSOLUTE_FINAL_SPEED, FINAL_SPEED_DIFFERENCE, FINAL_SPEED_FACTOR = range(4)
"""Final speed of an action: none, absolute, as difference to the master's speed, or as factor of this speed."""

NEVER_ARRIVES: Final = 1e10
"""s; arrival time of a master that does not approach its destination."""
MAX_BRAKING: Final = 8.0
"""m/s²; deceleration of an entity if the distance is too short for anything else (esmini's value)."""
PASSED_TOLERANCE: Final = 1e-3
"""m; if the distance to the destination grows by more than this in a step, the entity has passed the destination."""
PHASE_SPEED_TOLERANCE: Final = 0.1
"""m/s; the last phase begins if the speed differs by less from the speed at which this phase has to begin."""
DISTANCE_TOLERANCE: Final = 0.1
"""m; a distance action has reached its distance if the error is smaller."""
SPRING_STIFFNESS: Final = 0.4
"""1/m; stiffness of the distance controller, divided by the maximum acceleration in m/s²."""

_EPSILON: Final = 1e-6

# Indices of the values that a synchronize action stores: phase and last distances, both destinations, final speed.
_PHASE, _IS_FASTER_FIRST, _LAST_DISTANCE, _LAST_MASTER_DISTANCE, _OWN_DESTINATION, _MASTER_DESTINATION = (
    0,
    1,
    2,
    3,
    4,
    11,
)
_STEADY_DISTANCE, _STEADY_TIME, _FINAL_SPEED, _IS_LOCATED = 18, 19, 20, 21
# Indices relative to the first value of a destination.
_X, _Y, _ROAD, _S, _TRACK, _DISTANCE_ON_TRACK, _TOLERANCE = range(7)

(
    _ACCELERATION,
    _IS_BEHIND,
    _TARGET_DISTANCE,
    _MAX_ACCELERATION,
    _MAX_DECELERATION,
    _MAX_SPEED,
    _MAX_JERK_UP,
    _MAX_JERK_DOWN,
    _LOCATED_DISTANCE,
) = range(9)

_kernel = kernel(error_model="numpy", _nrt=False)


@kernel(error_model="numpy", _nrt=False)
def apply_synchronize_action(scene, tracks, roads, actions, n, j, dt):
    """Apply a `SynchronizeAction` for one time step, and return the outcome, such as `ACTION_APPLIED`.

    The action controls the speed of an entity so that it reaches its destination together with a master entity.
    """
    e, master, final_kind = actions.options[j, 1], actions.options[j, 2], actions.options[j, 3]
    memory, state, has_driver = actions.memory[n, j], scene.floats[n], scene.flags[n, DRIVEN, e]
    outcome, distance = _distance_to_destination(scene, tracks, roads, memory, _OWN_DESTINATION, n, e)
    master_outcome, signed_distance = _distance_to_destination(
        scene, tracks, roads, memory, _MASTER_DESTINATION, n, master
    )
    if outcome != ACTION_APPLIED or master_outcome != ACTION_APPLIED:
        return NEEDS_PYTHON if NEEDS_PYTHON in (outcome, master_outcome) else NEEDS_LOOKUP
    # Only the master's speed along its road and towards its destination counts.
    is_known, master_speed = _speed_along_road(scene, tracks, roads, n, master)
    if not is_known:
        return NEEDS_LOOKUP
    distance, master_distance = abs(distance), abs(signed_distance)
    if not math.isfinite(distance + master_distance):
        # A destination relative to an absent entity is nowhere.
        set_speed(scene, n, e, state[SPEED, e])
        return ACTION_APPLIED
    has_ended = (
        distance < memory[_OWN_DESTINATION + _TOLERANCE] + _EPSILON
        or master_distance < memory[_MASTER_DESTINATION + _TOLERANCE] + _EPSILON
        or distance > memory[_LAST_DISTANCE] + PASSED_TOLERANCE
        or master_distance > memory[_LAST_MASTER_DISTANCE] + PASSED_TOLERANCE
    )
    last_distance, last_master_distance = distance, master_distance
    distance = max(distance - memory[_OWN_DESTINATION + _TOLERANCE], _EPSILON)
    master_distance = max(master_distance - memory[_MASTER_DESTINATION + _TOLERANCE], _EPSILON)
    # Usually the master does not turn away from its path.
    direction = signed_distance if state[TURN, master] == 0.0 else signed_distance * math.cos(state[TURN, master])
    direction = 1.0 if direction > 0.0 else -1.0 if direction < 0.0 else direction
    master_speed = _sign(state[SPEED, master]) * direction * master_speed
    is_approaching = master_speed > _EPSILON and dt > 0.0
    time = master_distance / master_speed if is_approaching else NEVER_ARRIVES
    has_ended = has_ended or (is_approaching and time < dt)
    keeps_speed = False
    if final_kind == NO_FINAL_SPEED:
        # An arriving entity keeps its speed, unless its master has just stopped approaching.
        keeps_speed = has_ended and (is_approaching or memory[_PHASE] == WAITING_FOR_MASTER)
        wanted = _speed_for_arrival(state[SPEED, e], has_driver, memory, distance, time, is_approaching, dt)
    else:
        wanted = memory[_FINAL_SPEED]
        if final_kind == FINAL_SPEED_DIFFERENCE:
            wanted = state[SPEED, master] + wanted
        elif final_kind == FINAL_SPEED_FACTOR:
            wanted = state[SPEED, master] * wanted
        if not has_ended:
            is_known, road_speed = _speed_along_road(scene, tracks, roads, n, e)
            if not is_known:
                return NEEDS_LOOKUP
            wanted = _speed_for_arrival_with_final_speed(
                state[SPEED, e], _sign(state[SPEED, e]) * road_speed, memory, distance, time, wanted, is_approaching, dt
            )
    memory[_LAST_DISTANCE], memory[_LAST_MASTER_DISTANCE] = last_distance, last_master_distance
    memory[_IS_LOCATED] = 0.0
    state[ROAD_HEADING, e] = state[ROAD_HEADING, master] = math.nan
    if has_driver:
        # An entity with a driver gets a target speed that it can reach.
        wanted = min(max(wanted, 0.0), scene.dimensions[e, MAX_SPEED])
    elif not math.isfinite(wanted):
        wanted = state[SPEED, e]
    if not keeps_speed:
        set_speed(scene, n, e, wanted)
    return ACTION_ENDED if has_ended else ACTION_APPLIED


@kernel(error_model="numpy", _nrt=False)
def apply_distance_action(scene, tracks, roads, actions, n, j, dt):
    """Apply a `LongitudinalDistanceAction` with limits on the motion for one time step, and return the outcome.

    The action behaves like a critically damped spring. Python measures distances along roads in each frame.
    """
    e, other, continuous = actions.options[j, 1], actions.options[j, 2], actions.options[j, 3]
    between_boxes, is_time_gap, is_along_roads = actions.options[j, 4], actions.options[j, 5], actions.options[j, 6]
    memory, state = actions.memory[n, j], scene.floats[n]
    wanted = abs(abs(state[SPEED, other]) * memory[_TARGET_DISTANCE] if is_time_gap else memory[_TARGET_DISTANCE])
    if is_along_roads:
        distance, memory[_LOCATED_DISTANCE] = memory[_LOCATED_DISTANCE], math.nan
        if math.isnan(distance):
            return NEEDS_PYTHON
    else:
        distance = distance_to_entity(
            scene, n, e, other, LONGITUDINAL_DISTANCE + FREE_SPACE if between_boxes else LONGITUDINAL_DISTANCE
        )
    # Without a connecting road there is no distance: keep the speed.
    if not math.isfinite(distance):
        return ACTION_APPLIED
    error = distance - (wanted if memory[_IS_BEHIND] > 0.0 else -wanted)
    stiffness = SPRING_STIFFNESS * (memory[_MAX_ACCELERATION] if error < 0.0 else memory[_MAX_DECELERATION])
    acceleration = error * stiffness - 2.0 * math.sqrt(stiffness) * (state[SPEED, e] - state[SPEED, other])
    acceleration = min(max(acceleration, -memory[_MAX_DECELERATION]), memory[_MAX_ACCELERATION])
    previous = memory[_ACCELERATION]
    if acceleration < 0.0 and acceleration < previous:
        acceleration = max(acceleration, previous - memory[_MAX_JERK_DOWN] * dt)
    elif acceleration >= 0.0 and acceleration > previous:
        acceleration = min(acceleration, previous + memory[_MAX_JERK_UP] * dt)
    memory[_ACCELERATION] = acceleration
    set_speed(scene, n, e, min(max(state[SPEED, e] + acceleration * dt, -memory[_MAX_SPEED]), memory[_MAX_SPEED]))
    return ACTION_ENDED if abs(error) < DISTANCE_TOLERANCE and not continuous else ACTION_APPLIED


@_kernel
def _sign(speed):
    return -1.0 if speed < 0.0 else 1.0


@_kernel
def _road_position(scene, tracks, n, e, row):
    """Return road index and s in m of an entity on a lane; road -1 if Python must locate the entity first."""
    state, flags = scene.floats[n], scene.flags[n]
    if not flags[PRESENT, e] or (flags[CHANGES_LANES, e] and not abs(state[OFFSET, e]) < MAX_LANE_OFFSET):
        return -1, 0.0
    road, _, s, _ = road_position_on_lane(tracks, row, state[DISTANCE, e])
    return road, s


@_kernel
def _distance_to_destination(scene, tracks, roads, memory, destination, n, e):
    """Return an outcome, and the distance in m from an entity to its destination (negative once passed).

    If entity and destination are on the same road, the distance is measured along the reference line, otherwise along
    the entity's track. Without a track that leads to the destination, the straight distance is used. The outcome
    `ACTION_APPLIED` means success. `NEEDS_PYTHON`: first, Python must locate the entity on its road, after the actions
    that come earlier in this frame. `NEEDS_LOOKUP`: first, Python must locate the destination on the track.
    """
    state, track = scene.floats[n], scene.integers[n, TRACK, e]
    row = tracks.rows[e, track] if track >= 0 else -1
    x, y = memory[destination + _X], memory[destination + _Y]
    if row >= 0 and tracks.kind[row] == LANE_TRACK and roads.length.size > 0:
        road, s = _road_position(scene, tracks, n, e, row)
        if road >= 0 and roads.heading_known[road]:
            heading = reference_heading(roads, road, s)
        elif memory[_IS_LOCATED] > 0.0:
            road, s, heading = scene.integers[n, LAST_ROAD, e], state[LAST_S, e], state[ROAD_HEADING, e]
        else:
            return NEEDS_PYTHON, math.nan
        if road == memory[destination + _ROAD]:
            signed = memory[destination + _S] - s
            is_forward = math.cos(state[HEADING, e] - heading) > -COS_RIGHT_ANGLE_TOLERANCE
            return ACTION_APPLIED, signed if is_forward else -signed
    signed = math.inf
    if row >= 0 and math.isfinite(x + y):
        if memory[destination + _TRACK] != track or math.isnan(memory[destination + _DISTANCE_ON_TRACK]):
            return NEEDS_LOOKUP, math.nan
        signed = memory[destination + _DISTANCE_ON_TRACK] - state[DISTANCE, e]
    return ACTION_APPLIED, signed if math.isfinite(signed) else math.hypot(x - state[X, e], y - state[Y, e])


@_kernel
def _speed_along_road(scene, tracks, roads, n, e):
    """Return whether an entity's speed along the road is known, and the absolute value of this speed in m/s.

    The mean velocity in the last step is projected onto the direction of the road at the end of the step. Without
    roads, the velocity is projected onto the entity's heading.
    """
    state, numbers = scene.floats[n], scene.integers[n]
    track = numbers[TRACK, e]
    row = tracks.rows[e, track] if track >= 0 else -1
    if not math.isnan(state[ROAD_HEADING, e]):
        cos, sin = math.cos(state[ROAD_HEADING, e]), math.sin(state[ROAD_HEADING, e])
    elif roads.length.size > 0 and row >= 0 and tracks.kind[row] == LANE_TRACK:
        road, s = _road_position(scene, tracks, n, e, row)
        if road < 0 or not roads.heading_known[road]:
            return False, math.nan
        cos, sin = reference_cos_and_sin(roads, road, s)
    elif roads.length.size > 0 and scene.flags[n, PRESENT, e]:
        road = numbers[LAST_ROAD, e]
        if road < 0 or not roads.position_known[road]:
            return False, math.nan
        is_on_road, s = stays_on_road(roads, road, state[LAST_S, e], state[X, e], state[Y, e])
        if not is_on_road:
            return False, math.nan
        state[LAST_S, e] = s
        cos, sin = reference_cos_and_sin(roads, road, s)
    else:
        cos, sin = math.cos(state[HEADING, e]), math.sin(state[HEADING, e])
    return True, abs(state[GONE_X, e] * cos + state[GONE_Y, e] * sin)


@_kernel
def _speed_for_arrival(speed, has_driver, memory, distance, time, is_approaching, dt):
    """Return the speed in m/s at the end of the step, for arrival in `time` s without a given final speed.

    The acceleration is constant. A driver of the entity chooses the acceleration itself, and gets the mean speed until
    arrival as target speed. While the master does not approach its destination, the entity waits.
    """
    mean_speed = distance / time
    if has_driver:
        return mean_speed
    if is_approaching:
        memory[_PHASE] = LAST_PHASE
        return speed + 2.0 * (mean_speed - speed) / time * dt
    was_waiting, memory[_PHASE] = memory[_PHASE] == WAITING_FOR_MASTER, WAITING_FOR_MASTER
    return speed if was_waiting else 0.0


@_kernel
def _speed_for_arrival_with_final_speed(speed, road_speed, memory, distance, time, final_speed, is_approaching, dt):
    """Return the speed in m/s at the end of the step, for arrival in `time` s with a given final speed.

    `road_speed` is the present speed along the road in m/s.
    """
    divisor = max(abs(final_speed), 1e-9)
    steady_distance = memory[_STEADY_TIME] * final_speed if memory[_STEADY_TIME] > 0.0 else memory[_STEADY_DISTANCE]
    if steady_distance > 0.0 and memory[_PHASE] != AT_FINAL_SPEED:
        steady_time = steady_distance / divisor
        if distance - steady_distance < _EPSILON or time - steady_time < _EPSILON:
            memory[_PHASE] = AT_FINAL_SPEED
        else:
            distance, time = distance - steady_distance, time - steady_time
    if memory[_PHASE] == AT_FINAL_SPEED:
        return final_speed
    if not is_approaching:
        was_waiting, memory[_PHASE] = memory[_PHASE] == WAITING_FOR_MASTER, WAITING_FOR_MASTER
        return speed if was_waiting else 0.0
    if memory[_PHASE] == WAITING_FOR_MASTER:
        # An entity that waited starts anew; with a steady state the last phase comes next, as in esmini.
        if not (speed > 0.0 or steady_distance <= 0.0):
            memory[_PHASE] = LAST_PHASE
            return 0.0
        memory[_PHASE] = NOT_STARTED
    if memory[_PHASE] == HARD_BRAKING:
        if speed - MAX_BRAKING * dt < 0.0:
            memory[_PHASE] = NOT_STARTED
        return max(speed - MAX_BRAKING * dt, 0.0)
    if memory[_PHASE] == STANDING_STILL:
        if not time < 2.0 * distance / divisor:
            return 0.0
        memory[_PHASE] = LAST_PHASE
    if memory[_PHASE] == LAST_PHASE:
        return 0.0 if time < 1e-3 or distance < 1e-3 else max(2.0 * distance / time - max(final_speed, 0.0), 0.0)
    if memory[_PHASE] == FIRST_PHASE and abs(speed - (2.0 * distance / time - final_speed)) < PHASE_SPEED_TOLERANCE:
        memory[_PHASE] = LAST_PHASE
        return speed
    if memory[_PHASE] == NOT_STARTED:
        memory[_PHASE], memory[_IS_FASTER_FIRST] = (
            FIRST_PHASE,
            1.0 if (final_speed + speed) / 2.0 < distance / time else 0.0,
        )
    return _speed_in_first_phase(speed, road_speed, memory, distance, time, final_speed, dt)


@_kernel
def _speed_in_first_phase(speed, road_speed, memory, distance, time, final_speed, dt):
    """Return the speed in m/s at the end of the step, in the first of two phases of constant acceleration."""
    rate, apex = _solve_first_phase(road_speed, final_speed, distance, time)
    if (rate < 0.0) if memory[_IS_FASTER_FIRST] > 0.0 else (rate > 0.0):
        memory[_PHASE] = LAST_PHASE
        return speed
    if apex < 0.0:
        # Instead of driving backwards it stops, waits, and continues in time.
        stop_time = 2.0 * road_speed * distance / (road_speed * road_speed + final_speed * final_speed)
        rate = -road_speed / stop_time if stop_time > _EPSILON else 0.0
        if stop_time * road_speed / 2.0 > distance / 2.0:
            rate, memory[_PHASE] = -MAX_BRAKING, HARD_BRAKING
        if road_speed + rate * dt < 0.0:
            memory[_PHASE] = STANDING_STILL
            return 0.0
    return speed + rate * dt


@_kernel
def _solve_first_phase(start_speed, end_speed, distance, time):
    """Return the acceleration in the first of two phases in m/s², and the speed in m/s at the end of this phase.

    The phases have opposite accelerations. Together they cover `distance` in `time`, from the start speed v0 to the end
    speed v1. Between the phases, at the time x, the speed is vx. These equations are solved for x and vx:
    distance = x (v0 + vx) / 2 + (time - x) (v1 + vx) / 2, and (vx - v0) / x = (vx - v1) / (time - x).
    """
    mean_speed = distance / time
    if abs(end_speed - start_speed) < _EPSILON:
        apex = 2.0 * mean_speed - start_speed
        return 2.0 * (apex - start_speed) / time, apex
    root = math.sqrt(
        max(
            2.0
            * (
                2.0 * (mean_speed * mean_speed)
                - 2.0 * (start_speed + end_speed) * mean_speed
                + start_speed * start_speed
                + end_speed * end_speed
            ),
            0.0,
        )
    )
    for k in range(2):
        sign = -1.0 if k == 0 else 1.0
        x = -time * (2.0 * mean_speed - 2.0 * end_speed - sign * root) / (2.0 * (end_speed - start_speed))
        if x > 0.0 and x < time:
            apex = mean_speed + 0.5 * sign * root
            return (apex - start_speed) / x, apex
    return 0.0, 0.0
