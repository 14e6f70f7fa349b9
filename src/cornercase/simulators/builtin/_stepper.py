"""Time steps of all scenarios of a batch: mostly compiled code; storyboards and users' drivers run in Python."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from threading import Lock
from typing import Any, Final, Protocol
from weakref import proxy

import numpy as np
from numba import int64, typeof
from numba._dispatcher import compute_fingerprint
from numba.core.dispatcher import Dispatcher

from cornercase._common.masks import any_true
from cornercase._common.typing import BoolArray
from cornercase.drivers._compiled import build_fleet, set_half_widths, set_route
from cornercase.drivers._kernels.structs import Fleet
from cornercase.roads._kernels.heading import build_road_tables
from cornercase.simulators.builtin._gil import release_gil_lock
from cornercase.simulators.builtin.actions._controller import DriverControl
from cornercase.simulators.builtin.kernels._action_table import build_action_table
from cornercase.simulators.builtin.kernels._actions import ACTION_KERNELS
from cornercase.simulators.builtin.kernels._conditions import ConditionSpec, build_condition_table
from cornercase.simulators.builtin.kernels._kernel_interface import KernelInterface
from cornercase.simulators.builtin.kernels._loop import (
    ACT,
    ACTION_ENDED,
    ACTIONS_DONE,
    EVALUATE_LEAVES,
    FINISHED,
    IDLE,
    MOVE,
    NEEDS_DRIVER,
    NEEDS_LANE,
    NEEDS_LOOKUP_ACT,
    NEEDS_LOOKUP_MOVE,
    NEEDS_STORYBOARD,
    LoopOptions,
    LoopState,
    run_until_storyboard,
)
from cornercase.simulators.builtin.kernels._run import compile_loop_kernels, run_scenarios
from cornercase.simulators.builtin.kernels._simulation_state import SimulationState, make_state_arrays
from cornercase.simulators.builtin.storyboard._storyboard import Storyboard
from cornercase.simulators.builtin.storyboard._triggers import Condition, DelayBuffer
from cornercase.simulators.builtin.track_kernels._track_layout import TrackTable
from cornercase.simulators.builtin.tracks._lane import LaneTrack
from cornercase.simulators.builtin.tracks._track import Trajectory
from cornercase.simulators.builtin.tracks._track_pool import TrackPool
from cornercase.simulators.builtin.world._lane_following import follow_lane_at_position, half_lane_widths
from cornercase.simulators.builtin.world._track_motion import extend_lane_paths, update_off_road_since
from cornercase.simulators.builtin.world._trailers import place_trailers
from cornercase.simulators.builtin.world._world import World

# Calls a function of two integers for each pair of two lists.
_ParallelMap = Callable[[Callable[[int, int], object], list[int], list[int]], Iterable[object]]

# State that the storyboard assumes for scenarios whose need for a lane or a lookup was not met.
_FALLBACK_STATE: Final = np.arange(NEEDS_LOOKUP_MOVE + 1, dtype=np.int8)
_FALLBACK_STATE[[NEEDS_LANE, NEEDS_LOOKUP_ACT, NEEDS_LOOKUP_MOVE]] = NEEDS_STORYBOARD, ACTION_ENDED, NEEDS_STORYBOARD
# Scenarios that are worth a thread.
_MIN_SCENARIOS_PER_THREAD: Final = 32
# The compiled time loop, by numba's key for the types of its arguments.
_COMPILED_LOOPS: Final = dict[bytes, Any]()


class Coupling(Protocol):
    """Another simulator that moves some of the entities, in step with the storyboard."""

    def step(self, world: World, dt: float) -> None:
        """Move the other simulator's entities by a time step of `dt` s; with 0, only add entities to it."""
        ...


class Stepper:
    """Runs N scenarios of one file, each with a clock of its own.

    A scenario runs in compiled code until a condition changes, an action ends, or a driver without compiled code has to
    decide. Then the storyboard or the driver runs in Python, for all waiting scenarios together. `scene` holds the
    state and the recordings. `max_frames` is the maximum number of frames. `is_cancelled` is True once nobody waits for
    results.
    """

    def __init__(
        self,
        world: World,
        storyboard: Storyboard,
        time_step: float,
        duration: float,
        stop_at_collision: bool,
        coupling: Coupling | None,
    ) -> None:
        self._world, self._storyboard, self._coupling = world, storyboard, coupling
        max_frames = max(int(np.ceil((duration + 1e-9) / time_step)), 1)
        while max_frames * time_step < duration + 1e-9:
            max_frames += 1
        while max_frames > 1 and (max_frames - 1) * time_step >= duration + 1e-9:
            max_frames -= 1
        self.max_frames = max_frames
        self.scene: SimulationState = make_state_arrays(world, max_frames)
        self.is_cancelled = False
        self._driver_actions = [driver for driver in world.drivers if isinstance(driver, DriverControl)]
        self._fleet = _build_driver_fleet(world, self._driver_actions)
        # What moves entities in Python, in the order of the drivers.
        self._movers: list[Callable[[float], None]] = [driver.step for driver in self._driver_actions]
        if coupling is not None:
            self._movers.append(partial(coupling.step, world))
        # Which of them kernels replace, except for a vehicle that steers along something else than lanes.
        self._is_compiled = [driver.in_fleet for driver in self._driver_actions] + [False] * (coupling is not None)
        self._options = LoopOptions(time_step, max_frames, stop_at_collision, coupling is not None)
        # Whether the storyboard has to be evaluated in each frame.
        self._python_step = world.needs_road_check
        self._actions = build_action_table(
            [running.action for running in storyboard.actions], world.scenarios, ACTION_KERNELS.addresses
        )
        self._read_triggers()
        self._roads = build_road_tables([]) if world.network is None else world.network.road_tables
        self._track_pool, self._planned_routes = TrackPool(), dict[tuple[int, int], int]()
        self._tracks = self._track_pool.update(world.tracks)
        self._kernel_interface = KernelInterface(world, self.scene, self._track_pool, self._roads, self._actions)
        # Time of the last lookup: if it did not help, the storyboard handles the scenario.
        self._last_lookup = np.full(world.scenarios, -1.0)
        self._bounds = [0, world.scenarios]
        self._parallel_map: _ParallelMap = map
        self._gil_lock: Lock | None = None
        self._bound_tables: tuple[TrackTable | None, Fleet | None] = None, None
        self._loop_state = LoopState(
            status=np.full(world.scenarios, IDLE, dtype=np.int8),
            evaluates_each_frame=np.zeros(world.scenarios, dtype=np.bool_),
            driven_entities=np.array([driver.entity for driver in self._driver_actions], dtype=np.int64),
            next_driver=np.zeros(world.scenarios, dtype=np.int64),
            may_have_left_lane=np.zeros(world.scenarios, dtype=np.bool_),
        )

    def _read_triggers(self) -> None:
        """Make the condition table for compiled code; list the triggers with conditions that only Python evaluates."""
        specs, self._python_triggers = [], list[int]()
        in_tables, others = list[tuple[Condition, ConditionSpec]](), list[tuple[Condition, ConditionSpec]]()
        # With indices of triggers.
        self._condition_histories: list[tuple[int, DelayBuffer]] = []
        for t, trigger in enumerate(self._storyboard.triggers):
            groups = [[(condition, condition.kernel_spec) for condition in group] for group in trigger.groups]
            compiled = [[(condition, spec) for condition, spec in group if spec is not None] for group in groups]
            conditions = [pair for group in compiled for pair in group]
            if compiled == groups:
                specs.append([[spec for _, spec in group] for group in compiled])
                in_tables += conditions
            else:
                self._python_triggers.append(t)
                specs.append([])
                others += conditions
            self._condition_histories += [
                (t, condition.delay_buffer)
                for group in trigger.groups
                for condition in group
                if condition.delay_buffer is not None
            ]
        controllers, scenarios = self._world.signal_controllers.values(), self._world.scenarios
        delays = [past.delay for _, past in self._condition_histories] + [np.zeros(scenarios) for _ in controllers]
        table = build_condition_table(specs, [spec for _, spec in others], delays, scenarios)
        self._constant_conditions: list[tuple[int, Condition]] = []
        first = 0
        for condition, spec in in_tables + others:
            condition.use_leaf_values(table.last_values[:, first : first + len(spec.leaves)])
            if condition.value_until_next_event(self._world) is not None:
                self._constant_conditions.append((first, condition))
            first += len(spec.leaves)
        self._condition_table = table
        has_memory = table.triggers[:, 2] == 0
        has_memory[self._python_triggers] = False
        self._triggers_with_memory = np.flatnonzero(has_memory)
        # Weak, so that the recordings are freed as soon as the batch is.
        self._world.evaluate_leaves = partial(Stepper._evaluate_leaves, proxy(self))

    def run(self, n_threads: int, gil_lock: Lock | None = None) -> None:
        """Step until every scenario has ended, in at most `n_threads` threads; compiled code releases `gil_lock`."""
        self._gil_lock = gil_lock
        n_threads = min(n_threads, self._world.scenarios // _MIN_SCENARIOS_PER_THREAD)
        # Between two questions to a driver there is too little to do for several threads.
        if n_threads < 2 or not all(self._is_compiled):
            self._run_all(map)
            return
        self._bounds = np.linspace(0, self._world.scenarios, 4 * n_threads + 1).astype(int).tolist()
        with ThreadPoolExecutor(n_threads) as pool:
            self._run_all(pool.map)

    def _run_all(self, parallel_map: _ParallelMap) -> None:
        self._parallel_map = parallel_map
        world, status, is_first = self._world, self._loop_state.status, True
        status[world.running] = NEEDS_STORYBOARD
        while not self.is_cancelled:
            if any_true(waiting := status == NEEDS_STORYBOARD):
                self._evaluate_storyboard(waiting, is_first)
                is_first = False
            elif any_true(waiting := status == NEEDS_DRIVER):
                self._call_python_drivers(waiting)
            else:
                break
        if world.needs_road_check:
            update_off_road_since(world, status == FINISHED)
        # Whether a storyboard would go on is asked later.
        world.running[:] = True
        world.has_leaf_values = False
        world.update_leaf_values()
        world.running[:] = False

    def _evaluate_storyboard(self, evaluated: BoolArray, is_first: bool) -> None:
        """Evaluate the storyboard in the scenarios of a mask, then run these until they end or need Python again."""
        world, loop, dt = self._world, self._loop_state, 0.0 if is_first else self._options.time_step
        if world.needs_road_check and not is_first:
            update_off_road_since(world, evaluated)
        world.running[:] = evaluated
        world.changed[:] = False
        world.before[:, evaluated] = world.speed[:, evaluated]
        for controller in world.signal_controllers.values():
            controller.update_signals(world.signals, world.time, evaluated)
        loop.status[evaluated] = IDLE
        self._storyboard.evaluate_triggers(dt)
        if not (is_first or self._python_step):
            # Usually no other action ends in this frame.
            self._storyboard.end_instantaneous_actions()
            loop.evaluates_each_frame[evaluated] = self._pass_triggers_to_kernels()[evaluated]
            loop.status[world.running] = ACT
            self._run_until_stopped()
            world.running[:] = loop.status == ACTION_ENDED
            loop.status[world.running] = IDLE
        if any_true(world.running):
            acting = world.running.copy()
            self._storyboard.step_actions(dt)
            if is_first and self._coupling is not None:
                self._coupling.step(world, dt)
            place_trailers(world)
            world.started = True
            evaluates_next = self._pass_triggers_to_kernels() | is_first | self._python_step
            loop.evaluates_each_frame[acting] = evaluates_next[acting]
            loop.status[world.running] = ACTIONS_DONE
            self._run_until_stopped()

    def _evaluate_leaves(self) -> None:
        """Let compiled code evaluate all conditions that it supports, in the running scenarios."""
        self._loop_state.status[self._world.running] = EVALUATE_LEAVES
        self._bind_tables()
        # In this thread: handing so little work to others would take longer.
        self._run_range(0, self._world.scenarios)

    def _call_python_drivers(self, waiting: BoolArray) -> None:
        """Let drivers in Python decide for one time step, in those waiting scenarios that have the fewest frames."""
        world, loop, frames = self._world, self._loop_state, self.scene.n_frames
        waiting = waiting & (frames == frames[waiting].min())
        number = int(loop.next_driver[waiting].min())
        deciding, n_tracks = np.zeros_like(waiting), self._count_tracks()
        for move in self._movers[number:]:
            if deciding.any() and self._is_compiled[number]:
                break
            deciding |= waiting & (loop.next_driver == number)
            loop.status[deciding] = IDLE
            world.running[:] = deciding
            move(self._options.time_step)
            # Scenarios that failed are no longer running.
            deciding &= world.running
            number += 1
        loop.next_driver[deciding] = number
        loop.status[deciding] = ACTIONS_DONE
        self._run_until_stopped(has_new_tracks=self._count_tracks() > n_tracks)

    def _count_tracks(self) -> int:
        return sum(map(len, self._world.tracks))

    def _pass_triggers_to_kernels(self) -> BoolArray:
        """Pass pending triggers to the compiled loop; return the scenarios in which Python evaluates the next frame."""
        world, leaves, waiting = self._world, self._condition_table, self._storyboard.find_waiting_triggers()
        leaves.is_watched[:] = waiting.T
        # Triggers that depend on earlier values: one more evaluation shows whether they fire.
        in_python = waiting[self._triggers_with_memory].any(axis=0) & world.changed
        in_python |= waiting[self._python_triggers].any(axis=0) | self._storyboard.find_triggerless_standby()
        for k, condition in self._constant_conditions:
            leaves.values[:, k, 0] = condition.value_until_next_event(world)
        times = [np.where(waiting[t], past.oldest_pending_time(), np.inf) for t, past in self._condition_histories]
        times += [controller.next_phase_start(world.time) for controller in world.signal_controllers.values()]
        for d, pending_since in enumerate(times):
            leaves.pending_since[:, d] = pending_since
        self._actions.is_running[:] = self._storyboard.find_running_actions().T
        return np.asarray(in_python)

    def _run_until_stopped(self, has_new_tracks: bool = True) -> None:
        """Run the compiled loop until all scenarios have stopped; look up lanes and positions that the loop lacks."""
        world, status = self._world, self._loop_state.status
        while True:
            if has_new_tracks:
                self._tracks = self._track_pool.update(world.tracks)
                self._update_driver_routes()
            self._bind_tables()
            with release_gil_lock(self._gil_lock):
                list(self._parallel_map(self._run_range, self._bounds[:-1], self._bounds[1:]))
            if status.max() < ACTION_ENDED:
                return
            needs_lane = status == NEEDS_LANE
            needs_act, needs_move = status == NEEDS_LOOKUP_ACT, status == NEEDS_LOOKUP_MOVE
            needs_lookup = (needs_act | needs_move) & (self._last_lookup < world.time)
            status[:] = _FALLBACK_STATE[status]
            status[needs_lane & (self.scene.n_frames >= self.max_frames)] = FINISHED
            if not (any_true(needs_lane) or any_true(needs_lookup)):
                return
            if any_true(needs_lane):
                world.running[:] = needs_lane
                self._attach_steered_entities_to_lanes()
                extend_lane_paths(world)
                status[(status == NEEDS_STORYBOARD) & needs_lane & ~self._loop_state.evaluates_each_frame] = MOVE
            if any_true(needs_lookup):
                self._last_lookup[needs_lookup] = world.time[needs_lookup]
                self._storyboard.look_up_positions(needs_lookup)
                status[needs_lookup & needs_act], status[needs_lookup & needs_move] = ACT, MOVE
            has_new_tracks = True

    def _bind_tables(self) -> None:
        tracks, fleet = self._tracks, self._fleet
        if self._bound_tables[0] is not tracks or self._bound_tables[1] is not fleet:
            tables = self.scene, tracks, self._roads, fleet, self._actions, self._condition_table
            self._run_range, is_compiled = _bind_arguments(*tables, self._loop_state, self._options)
            if is_compiled:
                self._bound_tables = tracks, fleet

    def _update_driver_routes(self) -> None:
        """Set the routes of compiled drivers along the tracks (paths) that their entities follow now."""
        world = self._world
        for driving in self._driver_actions:
            if not driving.in_fleet:
                continue
            e, d = driving.entity, driving.number
            is_driving = world.present[e] & world.driven[e] & (world.driver[e] == d)
            for k in sorted(set(world.track[e][is_driving].tolist())):
                track = world.tracks[e][k] if k >= 0 else None
                if track is None or (isinstance(track, Trajectory) and track.times is not None):
                    continue
                version = track.version if isinstance(track, Trajectory) else 0
                if self._planned_routes.get((d, k)) != version:
                    self._fleet = set_route(self._fleet, d, k, driving.path_of_track(k, track))
                    self._planned_routes[d, k] = version
                    if driving.steers and isinstance(track, LaneTrack) and world.network is not None:
                        self._fleet = set_half_widths(self._fleet, d, k, half_lane_widths(world.network, track.path))

    def _attach_steered_entities_to_lanes(self) -> None:
        """Make entities that compiled drivers steer follow the lane at their position, in the running scenarios."""
        world = self._world
        for driving in self._driver_actions:
            if driving.in_fleet and driving.steers:
                rows = driving.find_scenarios_in_charge()
                follow_lane_at_position(world, driving.entity, rows, is_tracked=rows)


def _bind_arguments(*arguments: Any) -> tuple[Callable[[int, int], object], bool]:
    """Bind all arguments of the time loop except the range of scenarios; also return whether the loop is compiled.

    Without this, Numba would inspect the types of all arrays in each call of the loop. That would take longer than one
    frame of a scenario.
    """
    # numba computes this key, which says the types of all arrays, much faster than their types.
    fingerprint = compute_fingerprint(arguments)
    compiled = _COMPILED_LOOPS.get(fingerprint)
    if compiled is None and isinstance(run_until_storyboard, Dispatcher) and run_until_storyboard.overloads:
        compiled = run_until_storyboard.overloads.get((*map(typeof, arguments), int64, int64))
        if compiled is not None:
            _COMPILED_LOOPS[fingerprint] = compiled
    if compiled is not None:
        compile_loop_kernels(*arguments[:6])
        return partial(compiled.entry_point, *arguments), True
    return partial(run_scenarios, *arguments), False


def _build_driver_fleet(world: World, driver_actions: list[DriverControl]) -> Fleet:
    boxes = np.array([(entity.length, entity.width, entity.center_x) for entity in world.entities]).reshape(-1, 3)
    return build_fleet(
        [control.driver if control.in_fleet else None for control in driver_actions],
        [control.entity for control in driver_actions],
        world.scenarios,
        boxes[:, 0],
        boxes[:, 1],
        boxes[:, 2],
        [entity.kind for entity in world.entities],
        [control.attached_driver.compiled_vehicle if control.in_fleet else None for control in driver_actions],
        world.friction,
    )
