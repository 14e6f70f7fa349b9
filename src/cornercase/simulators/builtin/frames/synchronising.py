"""Actions that keep an entity in time or at a distance with another, for one scenario: twins of those in `actions`."""

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
"""What an entity does on its way to its place: nothing yet; the first of two phases of constant acceleration, below or
above the mean speed; the last phase; waiting for the master to move; braking hard; standing until the last phase
begins; going on at the final speed."""

NO_FINAL_SPEED, FINAL_SPEED, FINAL_DIFFERENCE, FINAL_FACTOR = range(4)
"""What an action says of the final speed: nothing; the speed; how much more than the master's; how many times that."""

NEVER: Final = 1e10
"""s; when a master arrives that does not come."""
HARDEST: Final = 8.0
"""m/s²; how hard an entity brakes that has no room for anything else. esmini's figure."""
AWAY: Final = 1e-3
"""So much further from its place than in the last step, in m, an entity has passed it."""
ON_LINE: Final = 0.1
"""A speed that differs from that of the last phase by less, in m/s, begins it."""
REACHED: Final = 0.1
"""A distance that is kept within this, in m, is reached."""
SPRING: Final = 0.4
"""Stiffness of the spring that keeps a distance, in 1/m, times the largest acceleration."""

ENDED, ACTED, LOST = range(3)
"""What becomes of an action in a frame: it ends, or cannot act here; it has acted; first, an entity has to be looked up
on its track or its road."""

_TINY: Final = 1e-6

# Places in memory: what is done and was, the entity's place and its master's, what is asked.
_MODE, _CONVEX, _LAST_WAY, _LAST_WAY_MASTER, _OWN, _MASTER = 0, 1, 2, 3, 4, 11
_STEADY_DISTANCE, _STEADY_TIME, _FINAL = 18, 19, 20
# Of each of the two places, counted from its first.
_PLACE_X, _PLACE_Y, _ROAD, _S, _ITS_TRACK, _ALONG, _TOLERANCE = range(7)

_ACCELERATION, _BEHIND, _DISTANCE, _UP, _DOWN, _FASTEST, _JERK_UP, _JERK_DOWN = range(8)

_kernel = kernel(error_model="numpy", forceinline=True, _nrt=False)


@_kernel
def synchronise(scene, tracks, roads, actions, n, j, dt):
    """Twin of `SynchronizeAction.step`.

    Parameters
    ----------
    scene : Scene
    tracks : Tracks
    roads : RoadTables
    actions : Actions
    n, j : int
        Scenario and action.
    dt : float
        s; above 0.

    Returns
    -------
    int
        `ENDED`, `ACTED` or `LOST`.
    """
    e, master, of_final = actions.options[j, 1], actions.options[j, 2], actions.options[j, 3]
    m, f, driven = actions.memory[n, j], scene.floats[n], scene.flags[n, DRIVEN, e]
    found_master, signed = _way(scene, tracks, roads, m, _MASTER, n, master)
    found, way = _way(scene, tracks, roads, m, _OWN, n, e)
    if found != ACTED or found_master != ACTED:
        return ENDED if ENDED in (found, found_master) else LOST
    way, way_master = abs(way), abs(signed)
    if way < m[_OWN + _TOLERANCE] + _TINY or way_master < m[_MASTER + _TOLERANCE] + _TINY:
        return ENDED
    if way > m[_LAST_WAY] + AWAY or way_master > m[_LAST_WAY_MASTER] + AWAY:
        return ENDED
    m[_LAST_WAY], m[_LAST_WAY_MASTER] = way, way_master
    way = max(way - m[_OWN + _TOLERANCE], _TINY)
    way_master = max(way_master - m[_MASTER + _TOLERANCE], _TINY)
    # Of the master's speed, the part along its road and towards its target counts.
    known, speed_master = _speed_along(scene, tracks, roads, n, master)
    if not known:
        return LOST
    # As a rule it is turned by nothing from its way.
    towards = signed if f[TURN, master] == 0.0 else signed * math.cos(f[TURN, master])
    towards = 1.0 if towards > 0.0 else -1.0 if towards < 0.0 else towards
    speed_master = _sign(f[SPEED, master]) * towards * speed_master
    comes = speed_master > _TINY
    time = way_master / speed_master if comes else NEVER
    if comes and time < dt:
        return ENDED
    if of_final == NO_FINAL_SPEED:
        wanted = _arrive(f[SPEED, e], driven, m, way, time, comes, dt)
    else:
        final = m[_FINAL]
        if of_final == FINAL_DIFFERENCE:
            final = f[SPEED, master] + final
        elif of_final == FINAL_FACTOR:
            final = f[SPEED, master] * final
        known, shown = _speed_along(scene, tracks, roads, n, e)
        if not known:
            return LOST
        wanted = _arrive_with(f[SPEED, e], _sign(f[SPEED, e]) * shown, m, way, time, final, comes, dt)
    if driven:
        # An entity with a driver is asked for a speed that it can reach.
        wanted = min(max(wanted, 0.0), scene.boxes[e, MAX_SPEED])
    elif not math.isfinite(wanted):
        wanted = f[SPEED, e]
    set_speed(scene, n, e, wanted)
    return ACTED


@_kernel
def keep_distance(scene, actions, n, j, dt):
    """Twin of `LongitudinalDistanceAction.step` with limits, along the entity's heading.

    Parameters
    ----------
    scene : Scene
    actions : Actions
    n, j : int
        Scenario and action.
    dt : float
        s; above 0.

    Returns
    -------
    bool
        False where it ends.
    """
    e, other, continuous = actions.options[j, 1], actions.options[j, 2], actions.options[j, 3]
    between_boxes, timed = actions.options[j, 4], actions.options[j, 5]
    m, f = actions.memory[n, j], scene.floats[n]
    wanted = abs(abs(f[SPEED, other]) * m[_DISTANCE] if timed else m[_DISTANCE])
    way = gap_to(scene, n, e, other, LONGITUDINAL + FREE if between_boxes else LONGITUDINAL)
    if not math.isfinite(way):
        return True
    error = way - (wanted if m[_BEHIND] > 0.0 else -wanted)
    stiffness = SPRING * (m[_UP] if error < 0.0 else m[_DOWN])
    a = error * stiffness - 2.0 * math.sqrt(stiffness) * (f[SPEED, e] - f[SPEED, other])
    a = min(max(a, -m[_DOWN]), m[_UP])
    before = m[_ACCELERATION]
    if a < 0.0 and a < before:
        a = max(a, before - m[_JERK_DOWN] * dt)
    elif a >= 0.0 and a > before:
        a = min(a, before + m[_JERK_UP] * dt)
    m[_ACCELERATION] = a
    set_speed(scene, n, e, min(max(f[SPEED, e] + a * dt, -m[_FASTEST]), m[_FASTEST]))
    return not (abs(error) < REACHED and not continuous)


@_kernel
def _sign(speed):
    return -1.0 if speed < 0.0 else 1.0


@_kernel
def _lane_of(scene, tracks, n, e, row):
    """Road and s of an entity on a lane; -1 where it has to be looked up."""
    f, b = scene.floats[n], scene.flags[n]
    if not b[PRESENT, e] or (b[CHANGES_LANES, e] and not abs(f[OFFSET, e]) < BESIDE):
        return -1, 0.0
    road, _, s, _ = lane_place(tracks, row, f[DISTANCE, e])
    return road, s


@_kernel
def _way(scene, tracks, roads, m, place, n, e):
    """How far it is to the entity's place of an action, in m, where that is found: `ACTED`."""
    f, track = scene.floats[n], scene.numbers[n, TRACK, e]
    row = tracks.row[e, track] if track >= 0 else -1
    x, y = m[place + _PLACE_X], m[place + _PLACE_Y]
    if not math.isfinite(x + y):
        return ENDED, math.nan
    if row >= 0 and tracks.kind[row] == LANE and roads.length.size > 0:
        road, s = _lane_of(scene, tracks, n, e, row)
        if road < 0 or not roads.known[road]:
            return ENDED, math.nan
        if road == m[place + _ROAD]:
            ahead = m[place + _S] - s
            return ACTED, ahead if math.cos(f[HEADING, e] - road_heading(roads, road, s)) > -ACROSS else -ahead
    way = math.inf
    if row >= 0:
        if m[place + _ITS_TRACK] != track or math.isnan(m[place + _ALONG]):
            return LOST, math.nan
        way = m[place + _ALONG] - f[DISTANCE, e]
    return ACTED, way if math.isfinite(way) else math.hypot(x - f[X, e], y - f[Y, e])


@_kernel
def _speed_along(scene, tracks, roads, n, e):
    """Whether an entity's speed along its road is known, and that speed in m/s: twin of `speed_along_road`."""
    f, numbers = scene.floats[n], scene.numbers[n]
    speed = f[ROAD_SPEED, e]
    if speed != UNASKED:
        f[ROAD_SPEED, e] = UNASKED
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
        stays, s = stays_on_road(roads, road, f[LAST_S, e], f[X, e], f[Y, e])
        if not stays:
            return False, math.nan
        f[LAST_S, e] = s
        cos, sin = road_direction(roads, road, s)
    else:
        cos, sin = math.cos(f[HEADING, e]), math.sin(f[HEADING, e])
    return True, abs(f[GONE_X, e] * cos + f[GONE_Y, e] * sin)


@_kernel
def _arrive(speed, driven, m, way, time, comes, dt):
    """Speed at the end of the step, with one constant acceleration."""
    mean = way / time
    if driven:
        return mean
    if comes:
        m[_MODE] = LAST
        return speed + 2.0 * (mean - speed) / time * dt
    waited, m[_MODE] = m[_MODE] == WAITING, WAITING
    return speed if waited else 0.0


@_kernel
def _arrive_with(v0, shown, m, way, time, final, comes, dt):
    """Speed at the end of the step, with a final speed; `shown` is the entity's along its road."""
    safe = max(abs(final), 1e-9)
    steady_way = m[_STEADY_TIME] * final if m[_STEADY_TIME] > 0.0 else m[_STEADY_DISTANCE]
    if steady_way > 0.0 and m[_MODE] != STEADY:
        steady_time = steady_way / safe
        if way - steady_way < _TINY or time - steady_time < _TINY:
            m[_MODE] = STEADY
        else:
            way, time = way - steady_way, time - steady_time
    if m[_MODE] == STEADY:
        return final
    if not comes:
        waited, m[_MODE] = m[_MODE] == WAITING, WAITING
        return v0 if waited else 0.0
    if m[_MODE] == WAITING:
        # An entity that waited begins anew; with a steady state the last phase comes next, as in esmini.
        if not (v0 > 0.0 or steady_way <= 0.0):
            m[_MODE] = LAST
            return 0.0
        m[_MODE] = NEW
    if m[_MODE] == BRAKING:
        if v0 - HARDEST * dt < 0.0:
            m[_MODE] = NEW
        return max(v0 - HARDEST * dt, 0.0)
    if m[_MODE] == STANDING:
        if not time < 2.0 * way / safe:
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
    """Twin of the function of that name in `actions.synchronise`."""
    mean = way / time
    if abs(v1 - v0) < _TINY:
        apex = 2.0 * mean - v0
        return 2.0 * (apex - v0) / time, apex
    root = math.sqrt(max(2.0 * (2.0 * (mean * mean) - 2.0 * (v0 + v1) * mean + v0 * v0 + v1 * v1), 0.0))
    for k in range(2):
        sign = -1.0 if k == 0 else 1.0
        x = -time * (2.0 * mean - 2.0 * v1 - sign * root) / (2.0 * (v1 - v0))
        if x > 0.0 and x < time:
            apex = mean + 0.5 * sign * root
            return (apex - v0) / x, apex
    return 0.0, 0.0
