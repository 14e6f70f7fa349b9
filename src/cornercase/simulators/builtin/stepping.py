"""Step all scenarios of a batch: storyboards are evaluated in Python when needed, compiled code does the rest."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from threading import Lock
from typing import Final, Protocol

import numpy as np
import numpy.typing as npt

from cornercase._common.masks import anywhere
from cornercase._common.typing import BoolArray
from cornercase.drivers import FOREIGN, Fleet, form_fleet, with_route
from cornercase.roads import road_tables
from cornercase.simulators.builtin.actions.controller import Driving
from cornercase.simulators.builtin.frames.leaves import gather_leaves
from cornercase.simulators.builtin.frames.running import (
    ACTS,
    BEGUN,
    ELSEWHERE,
    ENDS,
    GOES,
    LOST_ACTING,
    LOST_GOING,
    RESTS,
    WAITS,
    Course,
    Rules,
    run_on,
)
from cornercase.simulators.builtin.frames.scene import Scene, scene_of
from cornercase.simulators.builtin.frames.table import gather_actions
from cornercase.simulators.builtin.storyboard.element import RUNNING
from cornercase.simulators.builtin.storyboard.storyboard import Storyboard
from cornercase.simulators.builtin.storyboard.triggers import Condition, Past
from cornercase.simulators.builtin.tracks.pool import TrackPool
from cornercase.simulators.builtin.tracks.track import Trajectory
from cornercase.simulators.builtin.turns import turn_given_up
from cornercase.simulators.builtin.world.motion import go_on_along_lanes, watch_roads
from cornercase.simulators.builtin.world.state import World
from cornercase.simulators.builtin.world.towing import place_trailers

# Calls a function of two integers for each pair of two lists.
_Share = Callable[[Callable[[int, int], object], list[int], list[int]], Iterable[object]]

# State that the storyboard assumes for scenarios whose need for a lane or a lookup was not met.
_UNRESOLVED: Final = np.arange(LOST_GOING + 1, dtype=np.int8)
_UNRESOLVED[[ELSEWHERE, LOST_ACTING, LOST_GOING]] = WAITS, ENDS, WAITS
# Scenarios that are worth a thread.
_WORTH_A_THREAD: Final = 32


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
        self.most = max_frames
        self.scene: Scene = scene_of(world, max_frames)
        self.halted = False
        self._drivings = [driver for driver in world.drivers if isinstance(driver, Driving)]
        self._fleet = _fleet_of(world, self._drivings)
        needs_python = bool((self._fleet.kind == FOREIGN).any()) or len(self._drivings) < len(world.drivers)
        self._rules = Rules(time_step, max_frames, stop_at_collision, not needs_python)
        # Whether the storyboard has to be evaluated in each frame.
        self._by_hand = needs_python or coupling is not None or world.watches_roads or bool(world.signal_controllers)
        self._actions = gather_actions([running.action for running in storyboard.actions], world.scenarios)
        self._read_triggers()
        self._roads = road_tables([]) if world.network is None else world.network.tables
        self._pool, self._planned = TrackPool(), dict[tuple[int, int], int]()
        driven_entities = np.array([driver.entity for driver in self._drivings], dtype=np.int64)
        status = np.full(world.scenarios, RESTS, dtype=np.int8)
        # Time of the last lookup: if it did not help, the storyboard handles the scenario.
        self._looked_up = np.full(world.scenarios, -1.0)
        self._bounds = [0, world.scenarios]
        self._share: _Share = map
        self._turn: Lock | None = None
        self._course = Course(status, np.zeros(world.scenarios, dtype=np.bool_), driven_entities)

    def _read_triggers(self) -> None:
        """Make the condition tables of all triggers; remember the conditions that tables cannot express."""
        specs, self._unknown = [], set[int]()
        self._pasts: list[Past] = []
        self._constants: list[tuple[int, Condition]] = []
        n_conditions = 0
        for t, (trigger, _) in enumerate(self._storyboard.waits()):
            groups = [[(condition, condition.asked) for condition in group] for group in trigger.groups]
            if any(spec is None for group in groups for _, spec in group):
                self._unknown.add(t)
                groups = []
            for condition, spec in (item for group in groups for item in group):
                if condition.constant(self._world) is not None:
                    self._constants.append((n_conditions, condition))
                n_conditions += len(spec.leaves)
            self._pasts += [
                condition.past for group in trigger.groups for condition in group if condition.past is not None
            ]
            specs.append([[spec for _, spec in group] for group in groups])
        self._leaves = gather_leaves(specs, [past.delay for past in self._pasts], self._world.scenarios)

    def run(self, threads: int, turn: Lock | None = None) -> None:
        """Step until every scenario has ended, in at most `n_threads` threads; release `gil_lock` in kernels."""
        self._turn = turn
        threads = min(threads, self._world.scenarios // _WORTH_A_THREAD)
        if threads < 2:
            self._run(map)
            return
        self._bounds = np.linspace(0, self._world.scenarios, 4 * threads + 1).astype(int).tolist()
        with ThreadPoolExecutor(threads) as pool:
            self._run(pool.map)

    def _run(self, share: _Share) -> None:
        self._share = share
        world, loop, is_first = self._world, self._course, True
        evaluated, dt = world.running.copy(), 0.0
        while evaluated.any() and not self.halted:
            world.running[:] = evaluated
            world.stirred[:] = False
            world.before[:, evaluated] = world.speed[:, evaluated]
            for controller in world.signal_controllers.values():
                controller.switch(world.signals, world.time, evaluated)
            self._storyboard.look(dt)
            started = world.running.copy()
            settled = np.full_like(loop.status, RESTS)
            if not (is_first or self._by_hand):
                # Usually no other action ends in this frame.
                self._storyboard.end_momentary()
                loop.looks[:] = self._watch()
                self._go(np.where(started, ACTS, RESTS), settled)
                world.running[:] = settled == ENDS
            if world.running.any():
                self._act(dt)
                loop.looks[:] = self._watch() | is_first | self._by_hand
                self._go(np.where(world.running, BEGUN, RESTS), settled)
            if world.watches_roads:
                watch_roads(world, started)
            evaluated, dt, is_first = settled == WAITS, self._rules.time_step, False
        world.running[:] = False

    def _act(self, dt: float) -> None:
        world = self._world
        self._storyboard.act(dt)
        if not self._rules.drives:
            for driving in world.drivers:
                driving.step(dt)
        if self._coupling is not None:
            self._coupling.step(world, dt)
        place_trailers(world)
        world.begun = True

    def _watch(self) -> BoolArray:
        """Publish pending triggers to the compiled loop.

        Return the scenarios whose triggers must be evaluated in Python in the next frame.
        """
        world, leaves = self._world, self._leaves
        in_python = self._storyboard.starting()
        for t, (_, waits) in enumerate(self._storyboard.waits()):
            leaves.watched[:, t] = waits
            if t in self._unknown:
                in_python |= waits
            elif not leaves.triggers[t, 2]:
                # Depends on earlier values: one more evaluation shows whether the condition fires.
                in_python |= waits & world.stirred
        for k, condition in self._constants:
            leaves.values[:, k, 0] = condition.constant(world)
        for d, past in enumerate(self._pasts):
            leaves.pending[:, d] = past.pending()
        for j, action in enumerate(self._storyboard.actions):
            self._actions.running[:, j] = action.state == RUNNING
        return in_python

    def _go(self, status: npt.NDArray[np.int8], settled: npt.NDArray[np.int8]) -> None:
        """Run the compiled loop from a status, and store in `settled` the state that each scenario reached.

        Scenarios that need another lane, or an entity located on its road, get it and continue.
        """
        world, loop = self._world, self._course
        loop.status[:] = status
        while True:
            self._run_on()
            state = loop.status.copy()
            has_run, needs_lane = state != RESTS, state == ELSEWHERE
            settled[has_run] = _UNRESOLVED[state[has_run]]
            needs_lookup = ((state == LOST_ACTING) | (state == LOST_GOING)) & (self._looked_up < world.time)
            if not (anywhere(needs_lane) or anywhere(needs_lookup)):
                return
            loop.status[:] = np.where(needs_lane & ~loop.looks, GOES, RESTS)
            if anywhere(needs_lane):
                world.running[:] = needs_lane
                go_on_along_lanes(world)
            if anywhere(needs_lookup):
                self._looked_up[needs_lookup] = world.time[needs_lookup]
                self._storyboard.look_up(needs_lookup)
                loop.status[needs_lookup] = np.where(state == LOST_ACTING, ACTS, GOES)[needs_lookup]

    def _run_on(self) -> None:
        tracks = self._pool.gather(self._world.tracks)
        self._plan_routes()
        arguments = (self.scene, tracks, self._roads, self._fleet, self._actions, self._leaves)
        run = partial(run_on, *arguments, self._course, self._rules)
        with turn_given_up(self._turn):
            list(self._share(run, self._bounds[:-1], self._bounds[1:]))

    def _plan_routes(self) -> None:
        """Let compiled drivers plan their routes along the tracks they follow now."""
        world = self._world
        if not self._rules.drives:
            return
        for driving in self._drivings:
            e, d = driving.entity, driving.number
            is_driving = world.present[e] & world.driven[e] & (world.driver[e] == d)
            for k in sorted(set(world.track[e][is_driving].tolist())):
                track = world.tracks[e][k] if k >= 0 else None
                if track is None or (isinstance(track, Trajectory) and track.time is not None):
                    continue
                version = track.version if isinstance(track, Trajectory) else 0
                if self._planned.get((d, k)) != version:
                    self._fleet = with_route(self._fleet, d, k, driving.path(k, track))
                    self._planned[d, k] = version


def _fleet_of(world: World, drivings: list[Driving]) -> Fleet:
    boxes = np.array([(entity.length, entity.width, entity.center_x) for entity in world.entities]).reshape(-1, 3)
    return form_fleet(
        [entity.driver for entity in drivings],
        [entity.entity for entity in drivings],
        world.scenarios,
        boxes[:, 0],
        boxes[:, 1],
        boxes[:, 2],
        [entity.kind for entity in world.entities],
    )
