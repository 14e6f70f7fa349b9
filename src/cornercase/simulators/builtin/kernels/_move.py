"""Move all entities of one scenario along their tracks by one time step, and record the result."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math
from typing import Final

from cornercase._common.numba.kernel import kernel
from cornercase.simulators.builtin.kernels._box_overlap import entities_overlap
from cornercase.simulators.builtin.kernels._simulation_state import PAGE_LENGTH
from cornercase.simulators.builtin.track_kernels._lane_track import advance_on_lane, needs_next_lane
from cornercase.simulators.builtin.track_kernels._track_dispatch import pose_on_track
from cornercase.simulators.builtin.track_kernels._track_layout import LANE_TRACK
from cornercase.simulators.builtin.world._state_layout import (
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

EXTERNALLY_MOVED, AWAKE, SETTLED, RESTING = range(4)
"""Activity of an entity.

`EXTERNALLY_MOVED`: moved by an action or by a driver, or a trailer or a vehicle that can tow one. `AWAKE`: moves by
itself. `SETTLED`: has not moved along its track in the last frame. `RESTING`: frames change nothing."""

# m; an entity that is closer to the end of a road counts as at the end.
_END_TOLERANCE: Final = 1e-3
# m/s; an entity that is slower stands still.
_STANDSTILL_SPEED: Final = 1e-6
# m/s; a standing entity that drifts more slowly keeps its speed of 0.
_MIN_DRIFT_SPEED: Final = 1e-3

_kernel = kernel(error_model="numpy", _nrt=False)
# Inlined, since it is called once and passing the tables would cost more than the work.
_inlined_kernel = kernel(error_model="numpy", _nrt=False, forceinline=True)


@_inlined_kernel
def move_entities(scene, tracks, n, dt, activity):
    """Move all entities of a scenario by one time step at their present speeds, and advance the clock by `dt` s.

    With `dt` 0, entities are only placed on their tracks. Updates the activity of each entity, such as `AWAKE`, in
    `activity` (E,). Returns whether an entity needs the next part of its lane path.
    """
    state, flags, numbers = scene.floats[n], scene.flags[n], scene.integers[n]
    entities, needs_lane = state.shape[1], False
    for t in range(scene.trailers.shape[0]):
        if numbers[PULLED_BY, int(scene.trailers[t, 1])] == int(scene.trailers[t, 0]):
            flags[MOVED, int(scene.trailers[t, 1])] = True
    for e in range(entities):
        if activity[e] == RESTING or not flags[PRESENT, e]:
            continue
        track = numbers[TRACK, e]
        row = tracks.rows[e, track] if track >= 0 else -1
        if not flags[MOVED, e]:
            distance, at_end_since = state[DISTANCE, e], state[AT_END_SINCE, e]
            _move_along_track(scene, tracks, n, e, row, dt)
            if activity[e] == AWAKE and state[DISTANCE, e] == distance and state[AT_END_SINCE, e] == at_end_since:
                activity[e] = SETTLED
        if row >= 0 and tracks.kind[row] == LANE_TRACK:
            needs_lane = needs_lane or needs_next_lane(tracks, row, state[DISTANCE, e])
    _stop_at_road_ends(scene, tracks, n, dt, activity)
    for t in range(scene.trailers.shape[0]):
        if numbers[PULLED_BY, int(scene.trailers[t, 1])] == int(scene.trailers[t, 0]):
            _move_trailer(scene, n, t)
    for e in range(entities):
        if activity[e] != RESTING:
            _update_kinematics(state, flags, e, dt)
    scene.time[n] += dt
    scene.last_step[n] = dt
    # As in esmini, no standstill begins before the first frame with a duration.
    now = scene.time[n] if dt > 0.0 else math.inf
    for e in range(entities):
        if activity[e] == RESTING:
            continue
        if activity[e] == SETTLED:
            activity[e] = RESTING if dt > 0.0 and _is_resting(state, flags, e) else AWAKE
        moving = abs(state[SPEED, e]) > _STANDSTILL_SPEED
        state[STANDING_SINCE, e] = math.inf if moving else min(state[STANDING_SINCE, e], now)
        state[FROM_X, e], state[FROM_Y, e], state[FROM_HEADING, e] = state[X, e], state[Y, e], state[HEADING, e]
        flags[MOVED, e] = flags[JUMPED, e] = flags[DECIDED, e] = False
        state[PACE, e], state[SIDEWAYS, e] = math.nan, 0.0
    return needs_lane


@_inlined_kernel
def _is_resting(state, flags, e):
    """Return whether an entity has not moved in this step nor in the step before, so the next frame changes nothing."""
    is_moving = (
        state[SPEED, e] != 0.0 or state[VELOCITY, e] != 0.0 or state[GONE_X, e] != 0.0 or state[GONE_Y, e] != 0.0
    )
    is_changing = state[PULL_X, e] != 0.0 or state[PULL_Y, e] != 0.0 or state[HEADING, e] != state[FROM_HEADING, e]
    return not (is_moving or is_changing or flags[JUMPED, e])


@_inlined_kernel
def _move_along_track(scene, tracks, n, e, row, dt):
    state, flags = scene.floats[n], scene.flags[n]
    step = (state[SPEED, e] if math.isnan(state[PACE, e]) else state[PACE, e]) * dt
    size = math.sqrt(max(step * step - state[SIDEWAYS, e] * state[SIDEWAYS, e], 0.0))
    step = math.copysign(size, step) if step != 0.0 else 0.0
    if row >= 0:
        advance_along_track(scene, tracks, n, e, row, step, scene.time[n] + dt if dt > 0.0 else math.inf)
        return
    # An entity stops at the end of its trajectory if there is no road on which to continue.
    if flags[STRANDED, e]:
        state[SPEED, e], step = 0.0, 0.0
    if step == 0.0:
        return
    state[X, e] += step * math.cos(state[HEADING, e])
    state[Y, e] += step * math.sin(state[HEADING, e])


@_kernel
def advance_along_track(scene, tracks, n, e, row, step, arrival_time):
    """Move an entity along its track by `step` m (negative: backwards), and place it at its lateral offset.

    `arrival_time` is the time in s that is stored as its arrival if it reaches the end of the road.
    """
    state = scene.floats[n]
    if tracks.kind[row] == LANE_TRACK:
        distance = advance_on_lane(tracks, row, state[DISTANCE, e], state[OFFSET, e], step)
        at_end_since = state[AT_END_SINCE, e]
        is_backwards = step < 0.0 or (step == 0.0 and math.isfinite(at_end_since))
        is_at_end = distance >= tracks.length[row] - _END_TOLERANCE or (distance <= _END_TOLERANCE and is_backwards)
        state[AT_END_SINCE, e] = min(at_end_since, arrival_time) if is_at_end else math.inf
        state[DISTANCE, e] = distance
    else:
        state[DISTANCE, e] += step
    place_on_track(scene, tracks, n, e, row)


@_kernel
def place_on_track(scene, tracks, n, e, row):
    """Set the pose of an entity from its distance along its track and its lateral offset."""
    state = scene.floats[n]
    x, y, heading = pose_on_track(tracks, row, n, state[DISTANCE, e], state[OFFSET, e])
    state[X, e], state[Y, e], state[HEADING, e] = x, y, heading + state[TURN, e]


@_kernel
def set_speed(scene, n, e, speed):
    """Set the target speed of an entity in m/s, and also its speed unless a driver controls the entity."""
    state, flags = scene.floats[n], scene.flags[n]
    state[TARGET_SPEED, e] = speed
    if not flags[DRIVEN, e]:
        state[SPEED, e] = speed
    flags[DECIDED, e] = True


@_inlined_kernel
def _stop_at_road_ends(scene, tracks, n, dt, activity):
    """Set the speed to 0 for entities at a road's end that did not move in the previous step, as esmini does."""
    state, flags = scene.floats[n], scene.flags[n]
    for e in range(state.shape[1]):
        if activity[e] == RESTING or not (flags[PRESENT, e] and state[AT_END_SINCE, e] < scene.time[n] + 0.5 * dt):
            continue
        track = scene.integers[n, TRACK, e]
        on_lane = track >= 0 and tracks.kind[tracks.rows[e, track]] == LANE_TRACK
        if on_lane and math.hypot(state[GONE_X, e], state[GONE_Y, e]) < _STANDSTILL_SPEED:
            state[SPEED, e], flags[DECIDED, e] = 0.0, True


@_kernel
def _move_trailer(scene, n, tow):
    """Move a trailer behind its vehicle; the axle of the trailer follows the hitch as if pulled by a rod."""
    state, flags = scene.floats[n], scene.flags[n]
    e, trailer = int(scene.trailers[tow, 0]), int(scene.trailers[tow, 1])
    hitch, coupler = scene.trailers[tow, 2], scene.trailers[tow, 3]
    flags[PRESENT, trailer] = flags[PRESENT, e]
    if not flags[PRESENT, trailer]:
        return
    x = state[X, e] + hitch * math.cos(state[HEADING, e])
    y = state[Y, e] + hitch * math.sin(state[HEADING, e])
    heading = math.atan2(y - state[Y, trailer], x - state[X, trailer])
    # Avoid a full turn from one step to the next.
    state[HEADING, trailer] += (heading - state[HEADING, trailer] + math.pi) % (2.0 * math.pi) - math.pi
    state[X, trailer], state[Y, trailer] = x - coupler * math.cos(heading), y - coupler * math.sin(heading)
    state[SPEED, trailer] = state[SPEED, e]


@_inlined_kernel
def _update_kinematics(state, flags, e, dt):
    """Update velocity, acceleration and odometer of an entity from its displacement in the last step."""
    if not dt > 0.0:
        state[GONE_X, e], state[GONE_Y, e] = _velocity_along_heading(state, e)
        return
    moved_x, moved_y = state[X, e] - state[FROM_X, e], state[Y, e] - state[FROM_Y, e]
    chord = math.hypot(moved_x, moved_y)
    # A jump counts neither as distance nor as velocity.
    if flags[JUMPED, e] or not math.isfinite(chord):
        chord = 0.0
    previous_x, previous_y = state[GONE_X, e], state[GONE_Y, e]
    state[GONE_X, e], state[GONE_Y, e] = (
        _velocity_along_heading(state, e) if flags[JUMPED, e] else (moved_x / dt, moved_y / dt)
    )
    state[PULL_X, e], state[PULL_Y, e] = (state[GONE_X, e] - previous_x) / dt, (state[GONE_Y, e] - previous_y) / dt
    state[ODOMETER, e] += chord
    state[VELOCITY, e] = chord / dt
    # As in esmini, a standing entity that only moves sideways gets its lateral velocity as speed.
    if (
        abs(state[SPEED, e]) < _STANDSTILL_SPEED
        and state[VELOCITY, e] > _MIN_DRIFT_SPEED
        and not (flags[DECIDED, e] or flags[MOVED, e] or flags[DRIVEN, e])
    ):
        state[SPEED, e] = state[VELOCITY, e]


@_inlined_kernel
def _velocity_along_heading(state, e):
    return state[SPEED, e] * math.cos(state[HEADING, e]), state[SPEED, e] * math.sin(state[HEADING, e])


@_inlined_kernel
def record_frame(scene, n, first_scenario, dt, activity):
    """Record the state of all entities of a scenario; return whether a collision has begun.

    `first_scenario` is the first of the scenarios that the same thread runs. `activity` (E,) has the activity of
    each entity, such as `AWAKE`.
    """
    state, flags, numbers, frame = scene.floats[n], scene.flags[n], scene.integers[n], scene.n_frames[n]
    entities = state.shape[1]
    number, column = frame // PAGE_LENGTH, frame % PAGE_LENGTH
    if column == 0:
        scene.page_numbers[n, number] = (
            first_scenario * scene.page_numbers.shape[1] + scene.n_pages_used[first_scenario]
        )
        scene.n_pages_used[first_scenario] += 1
    page = scene.pages[scene.page_numbers[n, number]]
    for e in range(entities):
        if dt > 0.0:
            state[ACCELERATION, e] = (state[SPEED, e] - state[BEFORE, e]) / dt
        for q in range(5):
            row = (X, Y, HEADING, SPEED, ACCELERATION)[q]
            page[q, e, column] = state[row, e] if flags[PRESENT, e] else math.nan
    scene.n_frames[n] = frame + 1
    collides = False
    for first_entity in range(entities):
        for other in range(first_entity + 1, entities):
            if activity[first_entity] == RESTING and activity[other] == RESTING:
                continue
            is_overlapping = entities_overlap(scene, n, first_entity, other)
            # Entities that overlap from the start collide in the first frame.
            is_coupled = numbers[PULLED_BY, first_entity] == other or numbers[PULLED_BY, other] == first_entity
            is_new = is_overlapping and not is_coupled and not (frame > 0 and scene.overlaps[n, first_entity, other])
            scene.overlaps[n, first_entity, other] = scene.overlaps[n, other, first_entity] = is_overlapping
            if is_new:
                collides = True
                if math.isnan(scene.collision_time[n, first_entity, other]):
                    scene.collision_time[n, first_entity, other] = scene.time[n]
    return collides
