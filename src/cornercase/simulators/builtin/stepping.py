"""Stepping all scenarios of a batch: the storyboard looks where something happens, compiled code does the rest."""

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

# Calls a function of two numbers for each pair of two lists.
_Share = Callable[[Callable[[int, int], object], list[int], list[int]], Iterable[object]]

# What the storyboard makes of what becomes of a scenario, where nothing else is done about it.
_UNRESOLVED: Final = np.arange(LOST_GOING + 1, dtype=np.int8)
_UNRESOLVED[[ELSEWHERE, LOST_ACTING, LOST_GOING]] = WAITS, ENDS, WAITS
# So many scenarios are worth a thread.
_WORTH_A_THREAD: Final = 32


class Coupling(Protocol):
    """Another simulator that moves some of the entities, in step with the storyboard."""

    def step(self, world: World, dt: float) -> None:
        """Move its entities to the end of the coming time step; with a step of 0, only see where all begin."""
        ...


class Stepper:
    """Runs N scenarios of one file, each by a clock of its own.

    A scenario runs in compiled code as long as nothing happens in its storyboard: no condition changes, no action ends.
    Then its storyboard looks, with those of all others that wait for theirs.

    Parameters
    ----------
    world : World
    storyboard : Storyboard
    time_step : float
        s.
    duration : float
        s after which a scenario ends at the latest.
    stop_at_collision : bool
    coupling : Coupling, optional
        Another simulator that moves some of the entities.

    Attributes
    ----------
    scene : Scene
        With what is recorded.
    most : int
        Frames of a scenario that lasts the longest duration.
    halted : bool
        Whether nobody waits for the rest any more.
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
        most = max(int(np.ceil((duration + 1e-9) / time_step)), 1)
        while most * time_step < duration + 1e-9:
            most += 1
        while most > 1 and (most - 1) * time_step >= duration + 1e-9:
            most -= 1
        self.most = most
        self.scene: Scene = scene_of(world, most)
        self.halted = False
        self._drivings = [one for one in world.drivers if isinstance(one, Driving)]
        self._fleet = _fleet_of(world, self._drivings)
        by_hand = bool((self._fleet.kind == FOREIGN).any()) or len(self._drivings) < len(world.drivers)
        self._rules = Rules(time_step, most, stop_at_collision, not by_hand)
        # What the storyboard has to look at in each frame, whatever happens.
        self._by_hand = by_hand or coupling is not None or world.watches_roads or bool(world.signal_controllers)
        self._actions = gather_actions([one.action for one in storyboard.actions], world.scenarios)
        self._read_triggers()
        self._roads = road_tables([]) if world.network is None else world.network.tables
        self._pool, self._planned = TrackPool(), dict[tuple[int, int], int]()
        driven = np.array([one.entity for one in self._drivings], dtype=np.int64)
        status = np.full(world.scenarios, RESTS, dtype=np.int8)
        # When somebody was last looked up: if that does not help, the storyboard acts.
        self._looked_up = np.full(world.scenarios, -1.0)
        self._bounds = [0, world.scenarios]
        self._share: _Share = map
        self._turn: Lock | None = None
        self._course = Course(status, np.zeros(world.scenarios, dtype=np.bool_), driven)

    def _read_triggers(self) -> None:
        """Make tables of all triggers, and remember what of them is no matter of tables alone."""
        asked, self._unknown = [], set[int]()
        self._pasts: list[Past] = []
        self._constants: list[tuple[int, Condition]] = []
        count = 0
        for t, (trigger, _) in enumerate(self._storyboard.waits()):
            groups = [[(condition, condition.asked) for condition in group] for group in trigger.groups]
            if any(found is None for group in groups for _, found in group):
                self._unknown.add(t)
                groups = []
            for condition, found in (one for group in groups for one in group):
                if condition.constant(self._world) is not None:
                    self._constants.append((count, condition))
                count += len(found.leaves)
            self._pasts += [one.past for group in trigger.groups for one in group if one.past is not None]
            asked.append([[found for _, found in group] for group in groups])
        self._leaves = gather_leaves(asked, [past.delay for past in self._pasts], self._world.scenarios)

    def run(self, threads: int, turn: Lock | None = None) -> None:
        """Step until every scenario has ended, by so many threads at most; gives up its turn while kernels run."""
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
        world, course, first = self._world, self._course, True
        looking, dt = world.running.copy(), 0.0
        while looking.any() and not self.halted:
            world.running[:] = looking
            world.stirred[:] = False
            world.before[:, looking] = world.speed[:, looking]
            for controller in world.signal_controllers.values():
                controller.switch(world.signals, world.time, looking)
            self._storyboard.look(dt)
            begun = world.running.copy()
            settled = np.full_like(course.status, RESTS)
            if not (first or self._by_hand):
                # As a rule no other action ends in the frame.
                self._storyboard.end_momentary()
                course.looks[:] = self._watch()
                self._go(np.where(begun, ACTS, RESTS), settled)
                world.running[:] = settled == ENDS
            if world.running.any():
                self._act(dt)
                course.looks[:] = self._watch() | first | self._by_hand
                self._go(np.where(world.running, BEGUN, RESTS), settled)
            if world.watches_roads:
                watch_roads(world, begun)
            looking, dt, first = settled == WAITS, self._rules.time_step, False
        world.running[:] = False

    def _act(self, dt: float) -> None:
        """Let all act that are not compiled, in the scenarios that take part."""
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
        """Tell compiled code what the storyboard waits for; where it has to look itself in the next frame."""
        world, leaves = self._world, self._leaves
        itself = self._storyboard.starting()
        for t, (_, waits) in enumerate(self._storyboard.waits()):
            leaves.watched[:, t] = waits
            if t in self._unknown:
                itself |= waits
            elif not leaves.triggers[t, 2]:
                # What was before matters: one more look tells whether anything comes of it.
                itself |= waits & world.stirred
        for k, condition in self._constants:
            leaves.values[:, k, 0] = condition.constant(world)
        for d, past in enumerate(self._pasts):
            leaves.pending[:, d] = past.pending()
        for j, action in enumerate(self._storyboard.actions):
            self._actions.running[:, j] = action.state == RUNNING
        return itself

    def _go(self, status: npt.NDArray[np.int8], settled: npt.NDArray[np.int8]) -> None:
        """Run on from a status; who has to go on along another lane, or to be looked up, does and is, and runs on.

        Tells what becomes of each.
        """
        world, course = self._world, self._course
        course.status[:] = status
        while True:
            self._run_on()
            became = course.status.copy()
            ran, elsewhere = became != RESTS, became == ELSEWHERE
            settled[ran] = _UNRESOLVED[became[ran]]
            lost = ((became == LOST_ACTING) | (became == LOST_GOING)) & (self._looked_up < world.time)
            if not (anywhere(elsewhere) or anywhere(lost)):
                return
            course.status[:] = np.where(elsewhere & ~course.looks, GOES, RESTS)
            if anywhere(elsewhere):
                world.running[:] = elsewhere
                go_on_along_lanes(world)
            if anywhere(lost):
                self._looked_up[lost] = world.time[lost]
                self._storyboard.look_up(lost)
                course.status[lost] = np.where(became == LOST_ACTING, ACTS, GOES)[lost]

    def _run_on(self) -> None:
        tracks = self._pool.gather(self._world.tracks)
        self._plan_routes()
        who = (self.scene, tracks, self._roads, self._fleet, self._actions, self._leaves)
        run = partial(run_on, *who, self._course, self._rules)
        with turn_given_up(self._turn):
            list(self._share(run, self._bounds[:-1], self._bounds[1:]))

    def _plan_routes(self) -> None:
        """Let built-in drivers plan along all that they follow now."""
        world = self._world
        if not self._rules.drives:
            return
        for driving in self._drivings:
            e, d = driving.entity, driving.number
            in_charge = world.present[e] & world.driven[e] & (world.driver[e] == d)
            for k in sorted(set(world.track[e][in_charge].tolist())):
                track = world.tracks[e][k] if k >= 0 else None
                if track is None or (isinstance(track, Trajectory) and track.time is not None):
                    continue
                version = track.version if isinstance(track, Trajectory) else 0
                if self._planned.get((d, k)) != version:
                    self._fleet = with_route(self._fleet, d, k, driving.path(k, track))
                    self._planned[d, k] = version


def _fleet_of(world: World, drivings: list[Driving]) -> Fleet:
    boxes = np.array([(one.length, one.width, one.center_x) for one in world.entities]).reshape(-1, 3)
    return form_fleet(
        [one.driver for one in drivings],
        [one.entity for one in drivings],
        world.scenarios,
        boxes[:, 0],
        boxes[:, 1],
        boxes[:, 2],
        [one.kind for one in world.entities],
    )
