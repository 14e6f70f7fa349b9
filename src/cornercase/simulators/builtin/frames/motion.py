"""Moving all entities of one scenario along their tracks by one time step, and recording where they are then."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math
from typing import Final

from cornercase._common.compiling import kernel
from cornercase.simulators.builtin.frames.boxes import overlap
from cornercase.simulators.builtin.frames.scene import PAGE
from cornercase.simulators.builtin.tracks.lane_kernels import advance_lane, goes_over
from cornercase.simulators.builtin.tracks.place_kernels import place_on
from cornercase.simulators.builtin.tracks.pool import LANE, OTHER
from cornercase.simulators.builtin.world.layout import (
    ACCELERATION,
    AT_END_SINCE,
    BEFORE,
    DECIDED,
    DISTANCE,
    DRIVEN,
    FROM_HEADING,
    FROM_X,
    FROM_Y,
    GONE_X,
    GONE_Y,
    HEADING,
    JUMPED,
    MOVED,
    ODOMETER,
    OFFSET,
    PACE,
    PRESENT,
    PULL_X,
    PULL_Y,
    PULLED_BY,
    SIDEWAYS,
    SPEED,
    STANDING_SINCE,
    STRANDED,
    TARGET_SPEED,
    TRACK,
    TURN,
    VELOCITY,
    X,
    Y,
)

MOVED_BY_OTHERS, AWAKE, SETTLED, RESTING = range(4)
"""How an entity of a scenario stands: an action, a driver or what it tows decides where it goes; only it itself does;
so, and the last frame has left it where it was on its track; so, and no frame changes anything of it any more."""

# An entity this close to the end of a road, in m, is at the end.
_ON_END: Final = 1e-3
# Slower than this, in m/s, it stands.
_STILL: Final = 1e-6
# Slower than this, in m/s, who stands is not moved sideways, but looked up anew.
_DRIFT: Final = 1e-3

_kernel = kernel(error_model="numpy", _nrt=False)
# What is called in one place: passing the tables on costs more than what it does.
_part = kernel(error_model="numpy", _nrt=False, forceinline=True)


@_part
def move(scene, tracks, n, dt, rest):
    """Advance every entity of a scenario by one time step with its present speed, then the clock.

    Parameters
    ----------
    scene : Scene
    tracks : Tracks
    n : int
        Scenario.
    dt : float
        s; with 0 entities are only put on their tracks.
    rest : ndarray of int8, shape (E,)
        `MOVED_BY_OTHERS` and so on; brought up to date.

    Returns
    -------
    bool
        Whether an entity is near the place where its lane's path is cut.
    """
    f, b, numbers = scene.floats[n], scene.flags[n], scene.numbers[n]
    entities, beyond = f.shape[1], False
    for t in range(scene.tows.shape[0]):
        if numbers[PULLED_BY, int(scene.tows[t, 1])] == int(scene.tows[t, 0]):
            b[MOVED, int(scene.tows[t, 1])] = True
    for e in range(entities):
        if rest[e] == RESTING or not b[PRESENT, e]:
            continue
        track = numbers[TRACK, e]
        row = tracks.row[e, track] if track >= 0 else -1
        if not b[MOVED, e]:
            distance, since = f[DISTANCE, e], f[AT_END_SINCE, e]
            _go(scene, tracks, n, e, row, dt)
            if rest[e] == AWAKE and f[DISTANCE, e] == distance and f[AT_END_SINCE, e] == since:
                rest[e] = SETTLED
        if row >= 0 and tracks.kind[row] == LANE:
            beyond = beyond or goes_over(tracks, row, f[DISTANCE, e])
    _stop_at_ends(scene, tracks, n, dt, rest)
    for t in range(scene.tows.shape[0]):
        if numbers[PULLED_BY, int(scene.tows[t, 1])] == int(scene.tows[t, 0]):
            _pull_trailer(scene, n, t)
    for e in range(entities):
        if rest[e] != RESTING:
            _measure(f, b, e, dt)
    scene.time[n] += dt
    scene.last_step[n] = dt
    # As in esmini, nobody stands before the first frame that takes time.
    now = scene.time[n] if dt > 0.0 else math.inf
    for e in range(entities):
        if rest[e] == RESTING:
            continue
        if rest[e] == SETTLED:
            rest[e] = RESTING if dt > 0.0 and _rests(f, b, e) else AWAKE
        moving = abs(f[SPEED, e]) > _STILL
        f[STANDING_SINCE, e] = math.inf if moving else min(f[STANDING_SINCE, e], now)
        f[FROM_X, e], f[FROM_Y, e], f[FROM_HEADING, e] = f[X, e], f[Y, e], f[HEADING, e]
        b[MOVED, e] = b[JUMPED, e] = b[DECIDED, e] = False
        f[PACE, e], f[SIDEWAYS, e] = math.nan, 0.0
    return beyond


@_part
def _rests(f, b, e):
    """Whether one that has stayed where it was stood before, too, so that the next frame computes the same from it."""
    moves = f[SPEED, e] != 0.0 or f[VELOCITY, e] != 0.0 or f[GONE_X, e] != 0.0 or f[GONE_Y, e] != 0.0
    pulled = f[PULL_X, e] != 0.0 or f[PULL_Y, e] != 0.0 or f[HEADING, e] != f[FROM_HEADING, e]
    return not (moves or pulled or b[JUMPED, e])


@_part
def _go(scene, tracks, n, e, row, dt):
    f, b = scene.floats[n], scene.flags[n]
    way = (f[SPEED, e] if math.isnan(f[PACE, e]) else f[PACE, e]) * dt
    size = math.sqrt(max(way * way - f[SIDEWAYS, e] * f[SIDEWAYS, e], 0.0))
    way = math.copysign(size, way) if way != 0.0 else 0.0
    if row >= 0:
        advance(scene, tracks, n, e, row, way, scene.time[n] + dt if dt > 0.0 else math.inf)
        return
    # An entity stops at the end of its trajectory if there is no road on which to continue.
    if b[STRANDED, e]:
        f[SPEED, e], way = 0.0, 0.0
    if way == 0.0:
        return
    f[X, e] += way * math.cos(f[HEADING, e])
    f[Y, e] += way * math.sin(f[HEADING, e])


@_kernel
def advance(scene, tracks, n, e, row, way, arrived):
    """Move an entity along its track, and to its offset beside it.

    Parameters
    ----------
    scene : Scene
    tracks : Tracks
    n, e, row : int
        Scenario, entity, and row of the track that it follows.
    way : float
        m; negative backwards.
    arrived : float
        Time in s since when it is at the end of its road, if it comes there.
    """
    f = scene.floats[n]
    if tracks.kind[row] == LANE:
        distance = advance_lane(tracks, row, f[DISTANCE, e], f[OFFSET, e], way)
        since = f[AT_END_SINCE, e]
        back = way < 0.0 or (way == 0.0 and math.isfinite(since))
        there = distance >= tracks.length[row] - _ON_END or (distance <= _ON_END and back)
        f[AT_END_SINCE, e] = min(since, arrived) if there else math.inf
        f[DISTANCE, e] = distance
    elif tracks.kind[row] == OTHER:
        return
    else:
        f[DISTANCE, e] += way
    settle(scene, tracks, n, e, row)


@_kernel
def settle(scene, tracks, n, e, row):
    """Put an entity where it is on its track.

    Parameters
    ----------
    scene : Scene
    tracks : Tracks
    n, e, row : int
        Scenario, entity, and row of the track that it follows.
    """
    f = scene.floats[n]
    x, y, heading = place_on(tracks, row, n, f[DISTANCE, e], f[OFFSET, e])
    f[X, e], f[Y, e], f[HEADING, e] = x, y, heading + f[TURN, e]


@_kernel
def set_speed(scene, n, e, speed):
    """Give an entity a speed, or tell its driver to want it.

    Parameters
    ----------
    scene : Scene
    n, e : int
        Scenario and entity.
    speed : float
        m/s.
    """
    f, b = scene.floats[n], scene.flags[n]
    f[TARGET_SPEED, e] = speed
    if not b[DRIVEN, e]:
        f[SPEED, e] = speed
    b[DECIDED, e] = True


@_part
def _stop_at_ends(scene, tracks, n, dt, rest):
    """Stop who is at the end of its road once the last step has moved it neither on nor sideways, as in esmini."""
    f, b = scene.floats[n], scene.flags[n]
    for e in range(f.shape[1]):
        if rest[e] == RESTING or not (b[PRESENT, e] and f[AT_END_SINCE, e] < scene.time[n] + 0.5 * dt):
            continue
        track = scene.numbers[n, TRACK, e]
        on_lane = track >= 0 and tracks.kind[tracks.row[e, track]] == LANE
        if on_lane and math.hypot(f[GONE_X, e], f[GONE_Y, e]) < _STILL:
            f[SPEED, e], b[DECIDED, e] = 0.0, True


@_kernel
def _pull_trailer(scene, n, t):
    """Bring a trailer to where it is pulled: its axle comes after the hitch as on a rod."""
    f, b = scene.floats[n], scene.flags[n]
    e, trailer = int(scene.tows[t, 0]), int(scene.tows[t, 1])
    hitch, coupler = scene.tows[t, 2], scene.tows[t, 3]
    b[PRESENT, trailer] = b[PRESENT, e]
    if not b[PRESENT, trailer]:
        return
    x = f[X, e] + hitch * math.cos(f[HEADING, e])
    y = f[Y, e] + hitch * math.sin(f[HEADING, e])
    heading = math.atan2(y - f[Y, trailer], x - f[X, trailer])
    # No full turn from one step to the next.
    f[HEADING, trailer] += (heading - f[HEADING, trailer] + math.pi) % (2.0 * math.pi) - math.pi
    f[X, trailer], f[Y, trailer] = x - coupler * math.cos(heading), y - coupler * math.sin(heading)
    f[SPEED, trailer] = f[SPEED, e]


@_part
def _measure(f, b, e, dt):
    """Take down which way an entity has gone in the step, and how fast."""
    if not dt > 0.0:
        f[GONE_X, e], f[GONE_Y, e] = _held(f, e)
        return
    gone_x, gone_y = f[X, e] - f[FROM_X, e], f[Y, e] - f[FROM_Y, e]
    chord = math.hypot(gone_x, gone_y)
    # A jump counts neither as a way nor as a velocity.
    if b[JUMPED, e] or not math.isfinite(chord):
        chord = 0.0
    before_x, before_y = f[GONE_X, e], f[GONE_Y, e]
    f[GONE_X, e], f[GONE_Y, e] = _held(f, e) if b[JUMPED, e] else (gone_x / dt, gone_y / dt)
    f[PULL_X, e], f[PULL_Y, e] = (f[GONE_X, e] - before_x) / dt, (f[GONE_Y, e] - before_y) / dt
    f[ODOMETER, e] += chord
    f[VELOCITY, e] = chord / dt
    # Who stands and is only moved sideways has from then on the speed of that, as in esmini.
    if abs(f[SPEED, e]) < _STILL and f[VELOCITY, e] > _DRIFT and not (b[DECIDED, e] or b[MOVED, e] or b[DRIVEN, e]):
        f[SPEED, e] = f[VELOCITY, e]


@_part
def _held(f, e):
    """Velocity with which an entity goes on along its heading."""
    return f[SPEED, e] * math.cos(f[HEADING, e]), f[SPEED, e] * math.sin(f[HEADING, e])


@_part
def record(scene, n, first, dt, rest):
    """Record where all entities of a scenario are, and who has begun to touch whom.

    Parameters
    ----------
    scene : Scene
    n, first : int
        Scenario, and the first of those that are run together with it.
    dt : float
        Length in s of the step that led here.
    rest : ndarray of int8, shape (E,)
        As in `move`.

    Returns
    -------
    bool
        Whether a collision has begun.
    """
    f, b, numbers, frame = scene.floats[n], scene.flags[n], scene.numbers[n], scene.frames[n]
    entities = f.shape[1]
    number, line = frame // PAGE, frame % PAGE
    if line == 0:
        scene.page[n, number] = first * scene.page.shape[1] + scene.taken[first]
        scene.taken[first] += 1
    page = scene.pages[scene.page[n, number]]
    for e in range(entities):
        if dt > 0.0:
            f[ACCELERATION, e] = (f[SPEED, e] - f[BEFORE, e]) / dt
        for q in range(5):
            row = (X, Y, HEADING, SPEED, ACCELERATION)[q]
            page[q, e, line] = f[row, e] if b[PRESENT, e] else math.nan
    scene.frames[n] = frame + 1
    collides = False
    for one in range(entities):
        for other in range(one + 1, entities):
            if rest[one] == RESTING and rest[other] == RESTING:
                continue
            touches = overlap(scene, n, one, other)
            # Who overlaps from the start collides in the first row.
            coupled = numbers[PULLED_BY, one] == other or numbers[PULLED_BY, other] == one
            begins = touches and not coupled and not (frame > 0 and scene.overlaps[n, one, other])
            scene.overlaps[n, one, other] = scene.overlaps[n, other, one] = touches
            if begins:
                collides = True
                if math.isnan(scene.collided[n, one, other]):
                    scene.collided[n, one, other] = scene.time[n]
    return collides
