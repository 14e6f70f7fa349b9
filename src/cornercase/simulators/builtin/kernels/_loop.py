"""The compiled time loop, which runs scenarios until Python has to evaluate a storyboard or to ask a driver."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator, call-arg"

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cornercase._common.numba.kernel import kernel
from cornercase._common.numba.tuple_pointers import reference_to
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.drivers._kernels.decide import (
    change_vehicle_speed,
    compute_acceleration,
    find_route_row,
    make_workspace,
)
from cornercase.drivers._kernels.structs import NOT_COMPILED, DrivenState, Workspace
from cornercase.drivers._steered_vehicle import has_steered_vehicle
from cornercase.simulators.builtin.kernels._action_table import ACTION_APPLIED, NEEDS_LOOKUP, PYTHON_ACTION
from cornercase.simulators.builtin.kernels._actions import (
    SavedState,
    alloc_saved_state,
    apply_actions,
    list_running_actions,
)
from cornercase.simulators.builtin.kernels._conditions import (
    Watchlist,
    alloc_watchlist,
    fill_watchlist,
    is_unchanged,
    store_leaf_values,
)
from cornercase.simulators.builtin.kernels._move import AWAKE, EXTERNALLY_MOVED, move_entities, record_frame
from cornercase.simulators.builtin.kernels._simulation_state import MAX_ACCELERATION, MAX_DECELERATION, MAX_SPEED
from cornercase.simulators.builtin.kernels._steered_entity import steer_along_lane
from cornercase.simulators.builtin.track_kernels._track_layout import LANE_TRACK
from cornercase.simulators.builtin.world._state_layout import (
    ACCELERATION,
    BEFORE,
    DISTANCE,
    DRIVEN,
    DRIVER,
    HEADING,
    PACE,
    PRESENT,
    SPEED,
    TARGET_SPEED,
    TRACK,
    VISIBLE,
    X,
    Y,
)

(
    IDLE,
    ACT,
    ACTIONS_DONE,
    MOVE,
    EVALUATE_LEAVES,
    FINISHED,
    NEEDS_STORYBOARD,
    NEEDS_DRIVER,
    ACTION_ENDED,
    NEEDS_LANE,
    NEEDS_LOOKUP_ACT,
    NEEDS_LOOKUP_MOVE,
) = range(12)
"""State of a scenario in the loop.

The loop skips a scenario in the state `IDLE`. The loop runs a scenario from three states: `ACT` (the storyboard of the
frame has been evaluated), `ACTIONS_DONE` (the actions of the frame have been applied, too) and `MOVE` (the next frame
needs no storyboard so far). In the state `EVALUATE_LEAVES`, the loop only evaluates all leaf conditions.

All other states say why a scenario has stopped. `FINISHED`: it has ended. `NEEDS_STORYBOARD`: Python has to evaluate
the storyboard. `NEEDS_DRIVER`: Python has to ask a driver. `ACTION_ENDED`: an action ends or cannot be applied.
`NEEDS_LANE`: an entity needs the next part of its lane path, or may have left its lane. `NEEDS_LOOKUP_ACT` and
`NEEDS_LOOKUP_MOVE`: Python has to locate an entity on its road; then the scenario goes on as in `ACT` or `MOVE`."""

_kernel = kernel(error_model="numpy", _nrt=False)
# Inlined: passing the tables would take longer than the work. The code does not grow, since each is called once.
_inlined_kernel = kernel(error_model="numpy", _nrt=False, forceinline=True)


class LoopState(NamedTuple):
    """State of the time loop for N scenarios and D drivers."""

    status: npt.NDArray[np.int8]  # (N,): `ACT` and so on
    evaluates_each_frame: BoolArray  # (N,): whether Python has to evaluate the storyboard in each frame
    driven_entities: IntArray  # (D,): entity of each driver
    next_driver: IntArray  # (N,): driver that decides next in the frame; D for another simulator that moves entities
    may_have_left_lane: BoolArray  # (N,): whether an entity that was steered in the frame may have left its lane


class LoopOptions(NamedTuple):
    """Options of the time loop."""

    time_step: float  # s
    max_frames: int  # maximum number of frames
    stop_at_collision: bool
    is_coupled: bool  # whether another simulator decides in each frame, after all drivers


class ThreadBuffers(NamedTuple):
    """Buffers of a thread that runs the scenarios [first, last) with E entities one after the other."""

    first: int
    last: int
    saved: SavedState
    watchlist: Watchlist
    activity: npt.NDArray[np.int8]  # (E,): `AWAKE` and so on
    visible_entities: FloatArray  # (4, E - 1): x, y, heading and speed of entities that a driver may see
    driver_workspace: Workspace  # of a driver
    motion: FloatArray  # (5,): x, y, heading, speed and acceleration of a vehicle that steers


@kernel(error_model="numpy")
def run_until_storyboard(scene, tracks, roads, fleet, actions, conditions, loop, options, first, last):
    """Run the scenarios [first, last), each until it has ended or Python has to do something for it.

    Python evaluates storyboards, asks drivers without compiled code, and looks up lanes and roads for entities.

    Scenarios do not affect each other, so the number of threads does not change the results.
    """
    entities = scene.floats.shape[2]
    saved, rest = alloc_saved_state(actions.options.shape[0]), np.empty(entities, dtype=np.int8)
    others, watchlist, motion = np.empty((4, entities - 1)), alloc_watchlist(conditions), np.empty(5)
    buffers = ThreadBuffers(first, last, saved, watchlist, rest, others, make_workspace(entities - 1), motion)
    _run_scenarios(
        reference_to(scene),
        reference_to(tracks),
        reference_to(roads),
        reference_to(fleet),
        reference_to(actions),
        reference_to(conditions),
        reference_to(loop),
        options,
        reference_to(buffers),
    )


# A kernel of its own, since in a kernel that allocates, numba counts the references of all arrays in each frame.
@_kernel
def _run_scenarios(scene, tracks, roads, fleet, actions, conditions, loop, options, buffers):
    for n in range(buffers.first, buffers.last):
        status = loop.status[n]
        if status == EVALUATE_LEAVES:
            store_leaf_values(scene, conditions, n)
            loop.status[n] = IDLE
            continue
        if status not in (MOVE, ACT, ACTIONS_DONE):
            continue
        _list_actions_and_wake_entities(scene, actions, loop, n, buffers)
        fill_watchlist(conditions, buffers.watchlist, n)
        while status in (MOVE, ACT, ACTIONS_DONE):
            is_acting, dt = status != MOVE, options.time_step if scene.n_frames[n] > 0 else 0.0
            if status == MOVE:
                if scene.n_frames[n] >= options.max_frames:
                    status = FINISHED
                    break
                if not is_unchanged(scene, conditions, buffers.watchlist, n):
                    status = NEEDS_STORYBOARD
                    break
                for e in range(scene.floats.shape[2]):
                    scene.floats[n, BEFORE, e] = scene.floats[n, SPEED, e]
            outcome = ACTION_APPLIED
            if status != ACTIONS_DONE:
                outcome = apply_actions(scene, tracks, roads, actions, buffers.saved, n, dt)
            if outcome == NEEDS_LOOKUP:
                status = NEEDS_LOOKUP_ACT if is_acting else NEEDS_LOOKUP_MOVE
                break
            if outcome != ACTION_APPLIED:
                status = ACTION_ENDED if is_acting else NEEDS_STORYBOARD
                break
            status = _move_and_record_frame(scene, tracks, fleet, loop, options, n, dt, buffers)
            if is_acting and loop.evaluates_each_frame[n] and status == MOVE:
                status = NEEDS_STORYBOARD
        if status == NEEDS_STORYBOARD and scene.n_frames[n] >= options.max_frames:
            status = FINISHED
        loop.status[n] = status


@_inlined_kernel
def _list_actions_and_wake_entities(scene, actions, loop, n, buffers):
    """List the running actions, and mark each entity as `EXTERNALLY_MOVED` or as `AWAKE`.

    Externally moved are the entities of compiled actions and of drivers, and vehicles with their trailers.
    """
    rest, running = buffers.activity, buffers.saved.running
    for e in range(rest.size):
        rest[e] = AWAKE
    list_running_actions(actions, buffers.saved, n)
    i = 0
    while running[i] >= 0:
        if actions.options[running[i], 0] != PYTHON_ACTION:
            rest[actions.options[running[i], 1]] = EXTERNALLY_MOVED
        i += 1
    for d in range(loop.driven_entities.size):
        rest[loop.driven_entities[d]] = EXTERNALLY_MOVED
    for t in range(scene.trailers.shape[0]):
        rest[int(scene.trailers[t, 0])] = rest[int(scene.trailers[t, 1])] = EXTERNALLY_MOVED


@_inlined_kernel
def _move_and_record_frame(scene, tracks, fleet, loop, options, n, dt, buffers):
    """Let drivers decide, move all entities and record the frame; return the new state of the scenario."""
    if dt > 0.0:
        d, drivers = loop.next_driver[n], loop.driven_entities.shape[0]
        while d < drivers:
            e = loop.driven_entities[d]
            if _does_driver_decide_speed(scene, tracks, n, d, e):
                if not _can_kernels_move_entity(scene, tracks, fleet, n, d, e):
                    loop.next_driver[n] = d
                    return NEEDS_DRIVER
                if _apply_driver(scene, tracks, fleet, n, d, e, dt, buffers):
                    loop.may_have_left_lane[n] = True
            d += 1
        if options.is_coupled and d == drivers:
            loop.next_driver[n] = d
            return NEEDS_DRIVER
        loop.next_driver[n] = 0
    needs_lane = move_entities(scene, tracks, n, dt, buffers.activity) or loop.may_have_left_lane[n]
    loop.may_have_left_lane[n] = False
    collides = record_frame(scene, n, buffers.first, dt, buffers.activity)
    if collides and options.stop_at_collision:
        return FINISHED
    return NEEDS_LANE if needs_lane else MOVE


@_inlined_kernel
def _does_driver_decide_speed(scene, tracks, n, driver, e):
    """Return whether a driver decides the speed of entity `e` now.

    On a trajectory with times, no driver decides, since the times give the speed.
    """
    flags, numbers = scene.flags[n], scene.integers[n]
    is_driving = flags[PRESENT, e] and flags[DRIVEN, e] and numbers[DRIVER, e] == driver and numbers[TRACK, e] >= 0
    return is_driving and not tracks.has_times[tracks.rows[e, numbers[TRACK, e]]]


@_inlined_kernel
def _can_kernels_move_entity(scene, tracks, fleet, n, driver, e):
    """Return whether kernels can move the entity of a driver; otherwise Python has to move the entity.

    The driver has to be compiled. If the driver steers a vehicle model, the entity must also be on a lane.
    """
    if fleet.kind[driver] == NOT_COMPILED:
        return False
    lane = tracks.rows[e, scene.integers[n, TRACK, e]]
    return tracks.kind[lane] == LANE_TRACK or not has_steered_vehicle(fleet, driver)


@_inlined_kernel
def _apply_driver(scene, tracks, fleet, n, driver, e, dt, buffers):
    """Let a compiled driver steer its entity, or set the entity's speed at the end of the time step.

    Returns whether the entity may have left its lane.
    """
    state, flags, others = scene.floats[n], scene.flags[n], buffers.visible_entities
    route = find_route_row(fleet, driver, scene.integers[n, TRACK, e], n)
    if route < 0:
        return False
    for i in range(others.shape[1]):
        k = i if i < e else i + 1
        is_visible = flags[PRESENT, k] and flags[VISIBLE, k]
        others[0, i] = state[X, k] if is_visible else math.nan
        others[1, i] = state[Y, k] if is_visible else math.nan
        others[2, i] = state[HEADING, k] if is_visible else math.nan
        others[3, i] = state[SPEED, k] if is_visible else math.nan
    driven = DrivenState(
        state[DISTANCE, e], state[X, e], state[Y, e], state[HEADING, e], state[SPEED, e], state[TARGET_SPEED, e]
    )
    acceleration = compute_acceleration(
        fleet, driver, n, route, scene.time[n], dt, driven, others, buffers.driver_workspace
    )
    speed = state[SPEED, e]
    if fleet.first_vehicle[driver] < 0:
        state[SPEED, e] = min(max(speed + acceleration * dt, 0.0), scene.dimensions[e, MAX_SPEED])
        return False
    # These limits apply to any driver. A driver that plans ahead may exceed them if its entity goes backwards.
    acceleration = min(max(acceleration, -scene.dimensions[e, MAX_DECELERATION]), scene.dimensions[e, MAX_ACCELERATION])
    if has_steered_vehicle(fleet, driver):
        return steer_along_lane(scene, tracks, fleet, n, driver, e, acceleration, dt, buffers.motion)
    state[SPEED, e] = change_vehicle_speed(fleet, driver, n, speed, state[ACCELERATION, e], acceleration, dt)
    state[PACE, e] = 0.5 * (speed + state[SPEED, e])
    return False
