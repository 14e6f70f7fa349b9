"""Kernels of actions that synchronize an entity with another or keep a distance; NumPy versions are in `actions`."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math
from typing import Final

from cornercase._common.compiling import kernel
from cornercase._common.geometry import ACROSS
from cornercase.roads import road_direction, road_heading, stays_on_road
from cornercase.simulators.builtin.frames.gaps import FREE, LONGITUDINAL, gap_to
from cornercase.simulators.builtin.frames.motion import set_speed
from cornercase.simulators.builtin.frames.scene import MAX_SPEED
from cornercase.simulators.builtin.tracks.lane_kernels import lane_place
from cornercase.simulators.builtin.tracks.pool import LANE
from cornercase.simulators.builtin.world.layout import (
    BESIDE,
    CHANGES_LANES,
    DISTANCE,
    DRIVEN,
    GONE_X,
    GONE_Y,
    HEADING,
    LAST_ROAD,
    LAST_S,
    OFFSET,
    PRESENT,
    ROAD_SPEED,
    SPEED,
    TRACK,
    TURN,
    UNASKED,
    X,
    Y,
)

NEW, FIRST, LAST, WAITING, BRAKING, STANDING, STEADY = range(7)
"""Phase of a synchronization: not started; first of two phases of constant acceleration, below or above the mean speed;
last phase; waiting for the master to move; braking hard; standing until the last phase begins; going on at the final
speed."""

NO_FINAL_SPEED, FINAL_SPEED, FINAL_DIFFERENCE, FINAL_FACTOR = range(4)
"""Kind of an action's final speed: none, absolute, difference to the master's, factor of the master's."""

NEVER: Final = 1e10
"""s; arrival time of a master that does not approach."""
HARDEST: Final = 8.0
"""m/s²; deceleration of an entity that has no room for anything else (esmini's value)."""
AWAY: Final = 1e-3
"""m; an entity whose distance has grown by more than this in a step has passed its destination."""
ON_LINE: Final = 0.1
"""m/s; the last phase begins if the speed differs from its speed by less."""
REACHED: Final = 0.1
"""m; tolerance within which a distance is reached."""
SPRING: Final = 0.4
"""1/m; stiffness of the distance controller, per m/s² of maximum acceleration."""

ENDED, ACTED, LOST = range(3)
"""Outcome of an action in a frame: it ends or cannot be applied here; applied; an entity has to be located on its track
or road first."""

_TINY: Final = 1e-6

# Memory layout: phase and last distances, both destinations, final speed.
_MODE, _CONVEX, _LAST_WAY, _LAST_WAY_MASTER, _OWN, _MASTER = 0, 1, 2, 3, 4, 11
_STEADY_DISTANCE, _STEADY_TIME, _FINAL = 18, 19, 20
# Offsets within each destination.
_PLACE_X, _PLACE_Y, _ROAD, _S, _ITS_TRACK, _ALONG, _TOLERANCE = range(7)

_ACCELERATION, _BEHIND, _DISTANCE, _UP, _DOWN, _FASTEST, _JERK_UP, _JERK_DOWN = range(8)

_kernel = kernel(error_model="numpy", forceinline=True, _nrt=False)


@_kernel
def synchronise(scene, tracks, roads, actions, n, j, dt):
    """Apply a `SynchronizeAction` for one time step; NumPy version: `SynchronizeAction.step`.

    Returns `ACTION_NOT_APPLIED` (it ends or cannot act here), `ACTION_APPLIED` or `NEEDS_LOOKUP`.
    """
    e, master, final_kind = actions.options[j, 1], actions.options[j, 2], actions.options[j, 3]
    memory, state, has_driver = actions.memory[n, j], scene.floats[n], scene.flags[n, DRIVEN, e]
    master_outcome, signed_distance = _way(scene, tracks, roads, memory, _MASTER, n, master)
    outcome, distance = _way(scene, tracks, roads, memory, _OWN, n, e)
    if outcome != ACTED or master_outcome != ACTED:
        return ENDED if ENDED in (outcome, master_outcome) else LOST
    distance, master_distance = abs(distance), abs(signed_distance)
    if distance < memory[_OWN + _TOLERANCE] + _TINY or master_distance < memory[_MASTER + _TOLERANCE] + _TINY:
        return ENDED
    if distance > memory[_LAST_WAY] + AWAY or master_distance > memory[_LAST_WAY_MASTER] + AWAY:
        return ENDED
    memory[_LAST_WAY], memory[_LAST_WAY_MASTER] = distance, master_distance
    distance = max(distance - memory[_OWN + _TOLERANCE], _TINY)
    master_distance = max(master_distance - memory[_MASTER + _TOLERANCE], _TINY)
    # Only the master's speed along its road and towards its destination counts.
    is_known, master_speed = _speed_along(scene, tracks, roads, n, master)
    if not is_known:
        return LOST
    # Usually it does not turn off its path.
    direction = signed_distance if state[TURN, master] == 0.0 else signed_distance * math.cos(state[TURN, master])
    direction = 1.0 if direction > 0.0 else -1.0 if direction < 0.0 else direction
    master_speed = _sign(state[SPEED, master]) * direction * master_speed
    is_approaching = master_speed > _TINY
    time = master_distance / master_speed if is_approaching else NEVER
    if is_approaching and time < dt:
        return ENDED
    if final_kind == NO_FINAL_SPEED:
        wanted = _arrive(state[SPEED, e], has_driver, memory, distance, time, is_approaching, dt)
    else:
        final = memory[_FINAL]
        if final_kind == FINAL_DIFFERENCE:
            final = state[SPEED, master] + final
        elif final_kind == FINAL_FACTOR:
            final = state[SPEED, master] * final
        is_known, road_speed = _speed_along(scene, tracks, roads, n, e)
        if not is_known:
            return LOST
        wanted = _arrive_with(
            state[SPEED, e], _sign(state[SPEED, e]) * road_speed, memory, distance, time, final, is_approaching, dt
        )
    if has_driver:
        # An entity with a driver gets a target speed that it can reach.
        wanted = min(max(wanted, 0.0), scene.boxes[e, MAX_SPEED])
    elif not math.isfinite(wanted):
        wanted = state[SPEED, e]
    set_speed(scene, n, e, wanted)
    return ACTED


@_kernel
def keep_distance(scene, actions, n, j, dt):
    """Apply a `LongitudinalDistanceAction` with limits along the heading; False if it ends.

    NumPy version: `LongitudinalDistanceAction.step`.
    """
    e, other, continuous = actions.options[j, 1], actions.options[j, 2], actions.options[j, 3]
    between_boxes, is_time_gap = actions.options[j, 4], actions.options[j, 5]
    memory, state = actions.memory[n, j], scene.floats[n]
    wanted = abs(abs(state[SPEED, other]) * memory[_DISTANCE] if is_time_gap else memory[_DISTANCE])
    distance = gap_to(scene, n, e, other, LONGITUDINAL + FREE if between_boxes else LONGITUDINAL)
    if not math.isfinite(distance):
        return True
    error = distance - (wanted if memory[_BEHIND] > 0.0 else -wanted)
    stiffness = SPRING * (memory[_UP] if error < 0.0 else memory[_DOWN])
    acceleration = error * stiffness - 2.0 * math.sqrt(stiffness) * (state[SPEED, e] - state[SPEED, other])
    acceleration = min(max(acceleration, -memory[_DOWN]), memory[_UP])
    previous = memory[_ACCELERATION]
    if acceleration < 0.0 and acceleration < previous:
        acceleration = max(acceleration, previous - memory[_JERK_DOWN] * dt)
    elif acceleration >= 0.0 and acceleration > previous:
        acceleration = min(acceleration, previous + memory[_JERK_UP] * dt)
    memory[_ACCELERATION] = acceleration
    set_speed(scene, n, e, min(max(state[SPEED, e] + acceleration * dt, -memory[_FASTEST]), memory[_FASTEST]))
    return not (abs(error) < REACHED and not continuous)


@_kernel
def _sign(speed):
    return -1.0 if speed < 0.0 else 1.0


@_kernel
def _lane_of(scene, tracks, n, e, row):
    """Road and s of an entity on a lane; -1 if it has to be located on the road."""
    state, flags = scene.floats[n], scene.flags[n]
    if not flags[PRESENT, e] or (flags[CHANGES_LANES, e] and not abs(state[OFFSET, e]) < BESIDE):
        return -1, 0.0
    road, _, s, _ = lane_place(tracks, row, state[DISTANCE, e])
    return road, s


@_kernel
def _way(scene, tracks, roads, m, place, n, e):
    """Outcome, and signed distance in m to the entity's destination of a `SynchronizeAction`."""
    state, track = scene.floats[n], scene.numbers[n, TRACK, e]
    row = tracks.row[e, track] if track >= 0 else -1
    x, y = m[place + _PLACE_X], m[place + _PLACE_Y]
    if not math.isfinite(x + y):
        return ENDED, math.nan
    if row >= 0 and tracks.kind[row] == LANE and roads.length.size > 0:
        road, s = _lane_of(scene, tracks, n, e, row)
        if road < 0 or not roads.known[road]:
            return ENDED, math.nan
        if road == m[place + _ROAD]:
            signed_distance = m[place + _S] - s
            return ACTED, signed_distance if math.cos(
                state[HEADING, e] - road_heading(roads, road, s)
            ) > -ACROSS else -signed_distance
    signed = math.inf
    if row >= 0:
        if m[place + _ITS_TRACK] != track or math.isnan(m[place + _ALONG]):
            return LOST, math.nan
        signed = m[place + _ALONG] - state[DISTANCE, e]
    return ACTED, signed if math.isfinite(signed) else math.hypot(x - state[X, e], y - state[Y, e])


@_kernel
def _speed_along(scene, tracks, roads, n, e):
    """Whether an entity's speed along its road is known, and the speed in m/s; NumPy version: `speed_along_road`."""
    state, numbers = scene.floats[n], scene.numbers[n]
    speed = state[ROAD_SPEED, e]
    if speed != UNASKED:
        state[ROAD_SPEED, e] = UNASKED
        return True, speed
    track = numbers[TRACK, e]
    row = tracks.row[e, track] if track >= 0 else -1
    if roads.length.size > 0 and row >= 0 and tracks.kind[row] == LANE:
        road, s = _lane_of(scene, tracks, n, e, row)
        if road < 0 or not roads.known[road]:
            return False, math.nan
        cos, sin = road_direction(roads, road, s)
    elif roads.length.size > 0 and scene.flags[n, PRESENT, e]:
        road = numbers[LAST_ROAD, e]
        if road < 0 or not roads.plain[road]:
            return False, math.nan
        is_on_road, s = stays_on_road(roads, road, state[LAST_S, e], state[X, e], state[Y, e])
        if not is_on_road:
            return False, math.nan
        state[LAST_S, e] = s
        cos, sin = road_direction(roads, road, s)
    else:
        cos, sin = math.cos(state[HEADING, e]), math.sin(state[HEADING, e])
    return True, abs(state[GONE_X, e] * cos + state[GONE_Y, e] * sin)


@_kernel
def _arrive(speed, driven, m, way, time, comes, dt):
    """Speed at the end of the step, with one constant acceleration."""
    mean_speed = way / time
    if driven:
        return mean_speed
    if comes:
        m[_MODE] = LAST
        return speed + 2.0 * (mean_speed - speed) / time * dt
    was_waiting, m[_MODE] = m[_MODE] == WAITING, WAITING
    return speed if was_waiting else 0.0


@_kernel
def _arrive_with(v0, shown, m, way, time, final, comes, dt):
    """Speed at the end of the step, with a final speed; `road_speed` is the speed along the road."""
    divisor = max(abs(final), 1e-9)
    steady_distance = m[_STEADY_TIME] * final if m[_STEADY_TIME] > 0.0 else m[_STEADY_DISTANCE]
    if steady_distance > 0.0 and m[_MODE] != STEADY:
        steady_time = steady_distance / divisor
        if way - steady_distance < _TINY or time - steady_time < _TINY:
            m[_MODE] = STEADY
        else:
            way, time = way - steady_distance, time - steady_time
    if m[_MODE] == STEADY:
        return final
    if not comes:
        was_waiting, m[_MODE] = m[_MODE] == WAITING, WAITING
        return v0 if was_waiting else 0.0
    if m[_MODE] == WAITING:
        # An entity that waited starts anew; with a steady state the last phase comes next, as in esmini.
        if not (v0 > 0.0 or steady_distance <= 0.0):
            m[_MODE] = LAST
            return 0.0
        m[_MODE] = NEW
    if m[_MODE] == BRAKING:
        if v0 - HARDEST * dt < 0.0:
            m[_MODE] = NEW
        return max(v0 - HARDEST * dt, 0.0)
    if m[_MODE] == STANDING:
        if not time < 2.0 * way / divisor:
            return 0.0
        m[_MODE] = LAST
    if m[_MODE] == LAST:
        return 0.0 if time < 1e-3 or way < 1e-3 else max(2.0 * way / time - max(final, 0.0), 0.0)
    if m[_MODE] == FIRST and abs(v0 - (2.0 * way / time - final)) < ON_LINE:
        m[_MODE] = LAST
        return v0
    if m[_MODE] == NEW:
        m[_MODE], m[_CONVEX] = FIRST, 1.0 if (final + v0) / 2.0 < way / time else 0.0
    return _begin(v0, shown, m, way, time, final, dt)


@_kernel
def _begin(v0, shown, m, way, time, final, dt):
    """Speed at the end of the step in the first of two phases."""
    rate, apex = _first_phase(shown, final, way, time)
    if (rate < 0.0) if m[_CONVEX] > 0.0 else (rate > 0.0):
        m[_MODE] = LAST
        return v0
    if apex < 0.0:
        # Instead of driving backwards it stops, waits, and continues in time.
        stop_time = 2.0 * shown * way / (shown * shown + final * final)
        rate = -shown / stop_time if stop_time > _TINY else 0.0
        if stop_time * shown / 2.0 > way / 2.0:
            rate, m[_MODE] = -HARDEST, BRAKING
        if shown + rate * dt < 0.0:
            m[_MODE] = STANDING
            return 0.0
    return v0 + rate * dt


@_kernel
def _first_phase(v0, v1, way, time):
    """Acceleration and speed at the end of the first phase; NumPy version: same name in `actions.synchronise`."""
    mean_speed = way / time
    if abs(v1 - v0) < _TINY:
        apex = 2.0 * mean_speed - v0
        return 2.0 * (apex - v0) / time, apex
    root = math.sqrt(
        max(2.0 * (2.0 * (mean_speed * mean_speed) - 2.0 * (v0 + v1) * mean_speed + v0 * v0 + v1 * v1), 0.0)
    )
    for k in range(2):
        sign = -1.0 if k == 0 else 1.0
        x = -time * (2.0 * mean_speed - 2.0 * v1 - sign * root) / (2.0 * (v1 - v0))
        if x > 0.0 and x < time:
            apex = mean_speed + 0.5 * sign * root
            return (apex - v0) / x, apex
    return 0.0, 0.0
