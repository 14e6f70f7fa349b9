"""Step all scenarios of a batch: storyboards are evaluated in Python when needed, compiled code does the rest."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from threading import Lock
from typing import Final, Protocol

import numpy as np
import numpy.typing as npt

from cornercase._common.masks import any_true
from cornercase._common.typing import BoolArray
from cornercase.drivers._compiled import build_fleet, set_route
from cornercase.drivers._kernels.structs import NOT_COMPILED, Fleet
from cornercase.roads._kernels.heading import build_road_tables
from cornercase.simulators.builtin._gil import release_gil_lock
from cornercase.simulators.builtin.actions._controller import DriverControl
from cornercase.simulators.builtin.kernels._action_table import build_action_table
from cornercase.simulators.builtin.kernels._compiled_world import CompiledWorld
from cornercase.simulators.builtin.kernels._conditions import build_condition_table
from cornercase.simulators.builtin.kernels._loop import (
    ACT,
    ACTION_ENDED,
    ACTIONS_DONE,
    IDLE,
    MOVE,
    NEEDS_LANE,
    NEEDS_LOOKUP_ACT,
    NEEDS_LOOKUP_MOVE,
    NEEDS_STORYBOARD,
    LoopOptions,
    LoopState,
    run_until_storyboard,
)
from cornercase.simulators.builtin.kernels._simulation_state import SimulationState, make_state_arrays
from cornercase.simulators.builtin.storyboard._element import RUNNING
from cornercase.simulators.builtin.storyboard._storyboard import Storyboard
from cornercase.simulators.builtin.storyboard._triggers import Condition, DelayBuffer
from cornercase.simulators.builtin.tracks._track import Trajectory
from cornercase.simulators.builtin.tracks._track_pool import TrackPool
from cornercase.simulators.builtin.world._track_motion import extend_lane_paths, update_off_road_times
from cornercase.simulators.builtin.world._trailers import place_trailers
from cornercase.simulators.builtin.world._world import World

# Calls a function of two integers for each pair of two lists.
_ParallelMap = Callable[[Callable[[int, int], object], list[int], list[int]], Iterable[object]]

# State that the storyboard assumes for scenarios whose need for a lane or a lookup was not met.
_FALLBACK_STATE: Final = np.arange(NEEDS_LOOKUP_MOVE + 1, dtype=np.int8)
_FALLBACK_STATE[[NEEDS_LANE, NEEDS_LOOKUP_ACT, NEEDS_LOOKUP_MOVE]] = NEEDS_STORYBOARD, ACTION_ENDED, NEEDS_STORYBOARD
# Scenarios that are worth a thread.
_MIN_SCENARIOS_PER_THREAD: Final = 32


class Coupling(Protocol):
    """Another simulator that moves some of the entities, in step with the storyboard."""

    def step(self, world: World, dt: float) -> None:
        """Move its entities to the end of the coming time step; with a step of 0, only read their initial state."""
        ...


class Stepper:
    """Runs N scenarios of one file, each with a clock of its own.

    A scenario runs in compiled code until a condition changes or an action ends. Then its storyboard is evaluated,
    together with all others that wait for it. `scene` holds the state and the recordings; `max_frames` is the maximum
    number of frames; `is_cancelled` is True once nobody waits for results.
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
        needs_python = bool((self._fleet.kind == NOT_COMPILED).any()) or len(self._driver_actions) < len(world.drivers)
        self._options = LoopOptions(time_step, max_frames, stop_at_collision, not needs_python)
        # Whether the storyboard has to be evaluated in each frame.
        self._python_step = (
            needs_python or coupling is not None or world.needs_road_check or bool(world.signal_controllers)
        )
        self._actions = build_action_table([running.action for running in storyboard.actions], world.scenarios)
        self._read_triggers()
        self._roads = build_road_tables([]) if world.network is None else world.network.road_tables
        self._track_pool, self._planned_routes = TrackPool(), dict[tuple[int, int], int]()
        self._compiled_world = CompiledWorld(world, self.scene, self._track_pool, self._roads, self._actions)
        driven_entities = np.array([driver.entity for driver in self._driver_actions], dtype=np.int64)
        status = np.full(world.scenarios, IDLE, dtype=np.int8)
        # Time of the last lookup: if it did not help, the storyboard handles the scenario.
        self._last_lookup = np.full(world.scenarios, -1.0)
        self._bounds = [0, world.scenarios]
        self._parallel_map: _ParallelMap = map
        self._gil_lock: Lock | None = None
        self._loop_state = LoopState(status, np.zeros(world.scenarios, dtype=np.bool_), driven_entities)

    def _read_triggers(self) -> None:
        """Make the condition tables of all triggers; remember the conditions that tables cannot express."""
        specs, self._python_triggers = [], set[int]()
        self._condition_histories: list[DelayBuffer] = []
        self._constant_conditions: list[tuple[int, Condition]] = []
        n_conditions = 0
        for t, (trigger, _) in enumerate(self._storyboard.iter_pending_triggers()):
            groups = [[(condition, condition.kernel_spec) for condition in group] for group in trigger.groups]
            if any(spec is None for group in groups for _, spec in group):
                self._python_triggers.add(t)
                groups = []
            for condition, spec in (item for group in groups for item in group):
                if condition.constant_value(self._world) is not None:
                    self._constant_conditions.append((n_conditions, condition))
                n_conditions += len(spec.leaves)
            self._condition_histories += [
                condition.delay_buffer
                for group in trigger.groups
                for condition in group
                if condition.delay_buffer is not None
            ]
            specs.append([[spec for _, spec in group] for group in groups])
        self._condition_table = build_condition_table(
            specs, [past.delay for past in self._condition_histories], self._world.scenarios
        )

    def run(self, n_threads: int, gil_lock: Lock | None = None) -> None:
        """Step until every scenario has ended, in at most `n_threads` threads; release `gil_lock` in kernels."""
        self._gil_lock = gil_lock
        n_threads = min(n_threads, self._world.scenarios // _MIN_SCENARIOS_PER_THREAD)
        if n_threads < 2:
            self._run_all(map)
            return
        self._bounds = np.linspace(0, self._world.scenarios, 4 * n_threads + 1).astype(int).tolist()
        with ThreadPoolExecutor(n_threads) as pool:
            self._run_all(pool.map)

    def _run_all(self, parallel_map: _ParallelMap) -> None:
        self._parallel_map = parallel_map
        world, loop, is_first = self._world, self._loop_state, True
        evaluated, dt = world.running.copy(), 0.0
        while evaluated.any() and not self.is_cancelled:
            world.running[:] = evaluated
            world.changed[:] = False
            world.before[:, evaluated] = world.speed[:, evaluated]
            for controller in world.signal_controllers.values():
                controller.update_signals(world.signals, world.time, evaluated)
            self._storyboard.evaluate_triggers(dt)
            started = world.running.copy()
            settled = np.full_like(loop.status, IDLE)
            if not (is_first or self._python_step):
                # Usually no other action ends in this frame.
                self._storyboard.end_instantaneous_actions()
                loop.evaluates_each_frame[:] = self._publish_triggers()
                self._run_until_settled(np.where(started, ACT, IDLE), settled)
                world.running[:] = settled == ACTION_ENDED
            if world.running.any():
                self._run_python_actions(dt)
                loop.evaluates_each_frame[:] = self._publish_triggers() | is_first | self._python_step
                self._run_until_settled(np.where(world.running, ACTIONS_DONE, IDLE), settled)
            if world.needs_road_check:
                update_off_road_times(world, started)
            evaluated, dt, is_first = settled == NEEDS_STORYBOARD, self._options.time_step, False
        world.running[:] = False

    def _run_python_actions(self, dt: float) -> None:
        world = self._world
        self._storyboard.step_actions(dt)
        if not self._options.drives_compiled:
            for driving in world.drivers:
                driving.step(dt)
        if self._coupling is not None:
            self._coupling.step(world, dt)
        place_trailers(world)
        world.started = True

    def _publish_triggers(self) -> BoolArray:
        """Publish pending triggers to the compiled loop.

        Return the scenarios whose triggers must be evaluated in Python in the next frame.
        """
        world, leaves = self._world, self._condition_table
        in_python = self._storyboard.waits_without_trigger()
        for t, (_, waits) in enumerate(self._storyboard.iter_pending_triggers()):
            leaves.is_watched[:, t] = waits
            if t in self._python_triggers:
                in_python |= waits
            elif not leaves.triggers[t, 2]:
                # Depends on earlier values: one more evaluation shows whether the condition fires.
                in_python |= waits & world.changed
        for k, condition in self._constant_conditions:
            leaves.values[:, k, 0] = condition.constant_value(world)
        for d, past in enumerate(self._condition_histories):
            leaves.pending_since[:, d] = past.oldest_pending_time()
        for j, action in enumerate(self._storyboard.actions):
            self._actions.is_running[:, j] = action.state == RUNNING
        return in_python

    def _run_until_settled(self, status: npt.NDArray[np.int8], settled: npt.NDArray[np.int8]) -> None:
        """Run the compiled loop from a status, and store in `settled` the state that each scenario reached.

        Scenarios that need another lane, or an entity located on its road, get it and continue.
        """
        world, loop = self._world, self._loop_state
        loop.status[:] = status
        while True:
            self._run_compiled_loop()
            state = loop.status.copy()
            has_run, needs_lane = state != IDLE, state == NEEDS_LANE
            settled[has_run] = _FALLBACK_STATE[state[has_run]]
            needs_lookup = ((state == NEEDS_LOOKUP_ACT) | (state == NEEDS_LOOKUP_MOVE)) & (
                self._last_lookup < world.time
            )
            if not (any_true(needs_lane) or any_true(needs_lookup)):
                return
            loop.status[:] = np.where(needs_lane & ~loop.evaluates_each_frame, MOVE, IDLE)
            if any_true(needs_lane):
                world.running[:] = needs_lane
                extend_lane_paths(world)
            if any_true(needs_lookup):
                self._last_lookup[needs_lookup] = world.time[needs_lookup]
                self._storyboard.look_up_positions(needs_lookup)
                loop.status[needs_lookup] = np.where(state == NEEDS_LOOKUP_ACT, ACT, MOVE)[needs_lookup]

    def _run_compiled_loop(self) -> None:
        tracks = self._track_pool.update(self._world.tracks)
        self._plan_routes()
        arguments = (self.scene, tracks, self._roads, self._fleet, self._actions, self._condition_table)
        run = partial(run_until_storyboard, *arguments, self._loop_state, self._options)
        with release_gil_lock(self._gil_lock):
            list(self._parallel_map(run, self._bounds[:-1], self._bounds[1:]))

    def _plan_routes(self) -> None:
        """Let compiled drivers plan their routes along the tracks they follow now."""
        world = self._world
        if not self._options.drives_compiled:
            return
        for driving in self._driver_actions:
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


def _build_driver_fleet(world: World, driver_actions: list[DriverControl]) -> Fleet:
    boxes = np.array([(entity.length, entity.width, entity.center_x) for entity in world.entities]).reshape(-1, 3)
    return build_fleet(
        [entity.driver for entity in driver_actions],
        [entity.entity for entity in driver_actions],
        world.scenarios,
        boxes[:, 0],
        boxes[:, 1],
        boxes[:, 2],
        [entity.kind for entity in world.entities],
    )
