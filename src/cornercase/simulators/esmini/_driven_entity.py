"""Entities in esmini whose speed a driver of cornercase decides."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from cornercase._common.errors import InputError, SimulationError
from cornercase._common.typing import FloatArray
from cornercase.drivers import DrivenPath, Driver, Situation
from cornercase.drivers._attached_driver import AttachedDriver, DriverError
from cornercase.drivers._driving_function import Start
from cornercase.drivers._parameters import read_parameters
from cornercase.scenario import Value
from cornercase.scenario._file import ScenarioFile
from cornercase.scenario._seeds import ScenarioSeeds
from cornercase.simulators.builtin._batch import split_off_driver_parameters
from cornercase.simulators.builtin._entities import read_entities
from cornercase.simulators.builtin._prepared_file import PreparedScenario
from cornercase.simulators.builtin.actions._controller import create_file_driver
from cornercase.simulators.builtin.paths._positions import read_position
from cornercase.simulators.builtin.paths._trajectory_shapes import read_trajectory
from cornercase.simulators.builtin.tracks._track import Trajectory
from cornercase.simulators.builtin.world._world import Entity, World
from cornercase.simulators.esmini._driver_support import find_initial_trajectory_action, has_initial_speed
from cornercase.simulators.esmini._followed_path import FollowedPath
from cornercase.simulators.esmini._library import ObjectState, register_move_callback

# Bit of `ObjectState.visible`: others see the entity.
_SEEN_BY_TRAFFIC: Final = 2
# Distance in m that a driver's pose may be from where esmini moves the entity, besides what it goes in the step.
_MAX_DEVIATION: Final = 1.0


def start_drivers(
    lib: ctypes.CDLL,
    drivers: Mapping[str, str | Driver],
    scenario: ScenarioFile,
    values: Mapping[str, Value],
    seed: int,
    states: Mapping[str, ObjectState],
    time_step: float,
) -> list[DrivenEntity]:
    """Start the drivers of a scenario that esmini has loaded; return the driven entities in the order of the file.

    `drivers`: drivers or their names, by entity. `states`: initial states in esmini, by entity. `time_step`: in s.
    Raises `DriverError` if a driver fails.
    """
    if not drivers:
        return []
    parameters, (values,) = split_off_driver_parameters(scenario, [values])
    prepared, scope = PreparedScenario.from_scenario(scenario), scenario.scope([values])
    network = prepared.road_network(scenario.road_reference_for(values))
    entities, tows = read_entities(list(scenario.root.iterfind("Entities/ScenarioObject")), scope)
    world = World(entities, 1, network, tows, time_step)
    names = scope.parameter_values.keys() - scenario.path_parameters
    seeds = ScenarioSeeds([seed], {name: scope.parameter_values[name] for name in names})
    driven = list[DrivenEntity]()
    try:
        for e, entity in enumerate(entities):
            if (driver := drivers.get(entity.name)) is None:
                continue
            if entity.name in states:
                if states[entity.name].ctrl_type != 0:
                    raise InputError(
                        f"{scenario.path}: '{entity.name}' has both a driver and one of esmini's controllers; leave out"
                        " the driver, or turn esmini's controllers off with `simulator` esmini:controllers=false."
                    )
                world.speed[e] = states[entity.name].speed
            created = create_file_driver(driver, str(scenario.path)) if isinstance(driver, str) else driver
            own, problems = read_parameters(entity.name, created, parameters.get(entity.name, ({}, []))[1])
            if problems:
                raise DriverError(SimulationError(problems[0]), splits=False)
            others = [other for other in entities if other is not entity]
            path = FollowedPath(lib, network, _read_trajectory(scenario, values, world, e))
            driven.append(
                DrivenEntity(lib, created, entity, others, path, has_initial_speed(scenario, entity.name), time_step)
            )
            driven[-1].start(
                Start(
                    body=entity.driven_body,
                    time_step=time_step,
                    parameters=own,
                    values=(values,),
                    seeds=seeds,
                    others=tuple(other.name for other in others),
                    network=network,
                    friction=np.ones(1),
                )
            )
    except BaseException:
        for started in driven:
            started.release()
        raise
    return driven


def _read_trajectory(
    scenario: ScenarioFile, values: Mapping[str, Value], world: World, entity: int
) -> Trajectory | None:
    """Return the trajectory that an entity follows from the start; None if it follows lanes."""
    action, scope = find_initial_trajectory_action(scenario, world.names[entity]), scenario.scope([values])
    if action is None:
        return None
    holder, mode = action.find("TrajectoryRef"), action.find("TrajectoryFollowingMode")
    build = read_trajectory(action if holder is None else holder, scope, world, read_position)
    is_smooth = mode is None or scope.read_text(mode, "followingMode", "follow") == "follow"
    trajectory = build(world, is_smooth, None, entity)
    if not np.isfinite(trajectory.lengths).all():
        raise scope.error_at(
            action,
            f"<FollowTrajectoryAction>: '{world.names[entity]}' has a driver, and in esmini its trajectory must neither"
            " be closed nor depend on other entities; change it, or leave out the driver.",
        )
    return trajectory


class DrivenEntity:
    """An entity in esmini whose speed a driver decides, and also its pose if the driver steers.

    If the driver does not steer, esmini keeps the entity on its lane or trajectory.

    In each time step, esmini first gets the speed that the driver wants at the end of the step, and moves the entity
    with this speed. If an action of the storyboard sets another speed in this step, the action's speed becomes the
    target speed of the driver, and the entity is moved to the position that it reaches with the driver's speed.

    `sets_speed`: whether an initial action sets the speed. `was_moved`: whether this class has moved the entity in the
    last step, which is after esmini looked for collisions.
    """

    def __init__(
        self,
        lib: ctypes.CDLL,
        driver: Driver,
        entity: Entity,
        others: Sequence[Entity],
        path: FollowedPath,
        sets_speed: bool,
        time_step: float,
    ) -> None:
        self._lib, self._entity, self._others, self._path = lib, entity, others, path
        self.name = entity.name
        self._attached_driver = AttachedDriver(driver, entity.name)
        self._time_step = time_step
        self._sets_speed = sets_speed
        self._target_speed = math.inf
        self._previous_speed: float | None = None
        # What the driver has decided for this step, and what esmini is told until it has moved the entity.
        self._speed: float | None = None
        self._pose: tuple[float, float, float] | None = None
        self.was_moved = False
        self._has_moved = False
        self._marked_speed = math.nan
        self._error: BaseException | None = None

    @property
    def limit_notices(self) -> Mapping[str, str]:
        """Sentences without full stop, one for each limit that the driver exceeded, as in `AttachedDriver`."""
        return self._attached_driver.limit_notices

    def start(self, start: Start) -> None:
        """Start the driver at the beginning of a run; raise `DriverError` if the driver fails."""
        self._attached_driver.start(start)

    def release(self) -> None:
        """Release the resources of the driver at the end of a run."""
        self._attached_driver.release()

    def decide(
        self, states: Mapping[str, ObjectState], speeds: dict[str, float], time: float
    ) -> SimulationError | None:
        """Let the driver decide the speed at the end of the coming step; return the error if the driver fails.

        `states`: states of all entities, by name. `speeds`: speeds in m/s that drivers have decided for this step, by
        entity; the speed of this entity is added. `time`: in s.
        """
        state = states.get(self.name)
        self._speed = self._pose = None
        self.was_moved = self._has_moved = False
        if state is None:
            return None
        if self._previous_speed is None:
            register_move_callback(self._lib, state.id, self._after_move)
            self._previous_speed = state.speed
            if self._sets_speed:
                self._target_speed = state.speed
        self._path.update(state)
        if self._path.path is None:
            return None
        situation = self._make_situation(self._path.path, state, states, speeds, time)
        self._previous_speed = state.speed
        try:
            decision = self._attached_driver.step(situation)
        except DriverError as error:
            return error.error
        if 0 in decision.failures:
            return decision.failures[0]
        motion = decision.motion.state
        self._speed = speeds[self.name] = float(motion.speed[0])
        if decision.motion.is_steered[0]:
            self._pose = float(motion.x[0]), float(motion.y[0]), float(motion.heading[0])
        # No action sets exactly this speed, not even one that stops an entity that stands.
        self._marked_speed = math.nextafter(self._speed, math.inf)
        self._lib.SE_ReportObjectSpeed(state.id, self._marked_speed)
        return None

    def raise_step_error(self) -> None:
        """Raise the exception that occurred while esmini made the step, if any.

        Also raises `InputError` if esmini has not reported that it has moved the entity.
        """
        if self._error is not None:
            raise self._error
        if self._speed is not None and not self._has_moved:
            raise InputError(
                f"esmini's library does not say when it has moved '{self.name}', so that no driver can drive it; use"
                " esmini 3.6."
            )

    def _after_move(self, state: ObjectState) -> None:
        """Correct the motion that esmini has just computed, before esmini derives velocities from it."""
        try:
            self._has_moved = True
            if self._speed is not None:
                self._correct_motion(state, self._speed)
                self._lib.SE_ReportObjectSpeed(state.id, self._speed)
        except BaseException as error:
            # An exception must not pass through esmini.
            self._error = error

    def _correct_motion(self, state: ObjectState, speed: float) -> None:
        if self._pose is not None:
            x, y, heading = self._pose
            # If it is further away, an action has just placed it there.
            if math.hypot(state.x - x, state.y - y) <= (speed + abs(state.speed)) * self._time_step + _MAX_DEVIATION:
                self.was_moved = True
                self._lib.SE_ReportObjectPosXYH(state.id, x, y, heading)
        if state.speed == self._marked_speed:
            return
        self._path.update(state)
        if state.speed == 0.0 and self._path.is_at_road_end:
            # No action, but the end of the road.
            self._speed = 0.0
            return
        self._target_speed = state.speed
        if self._pose is None:
            self.was_moved = True
            self._path.move(state, (speed - state.speed) * self._time_step)

    def _make_situation(
        self,
        path: DrivenPath,
        state: ObjectState,
        states: Mapping[str, ObjectState],
        speeds: Mapping[str, float],
        time: float,
    ) -> Situation:
        own, others = self._entity, np.full((4, 1, len(self._others)), np.nan)
        for k, entity in enumerate(self._others):
            other = states.get(entity.name)
            if other is not None and other.visible & _SEEN_BY_TRAFFIC:
                others[:, 0, k] = other.x, other.y, other.h, speeds.get(entity.name, other.speed)
        others_x, others_y, others_heading, others_speed = others
        boxes = np.array([(other.length, other.width, other.center_x) for other in self._others])
        others_length, others_width, others_center_x = boxes.reshape(-1, 3).T.copy()
        assert self._previous_speed is not None

        def row(value: float) -> FloatArray:
            return np.array([value])

        return Situation(
            time=time,
            time_step=self._time_step,
            path=path,
            distance=row(self._path.distance),
            x=row(state.x),
            y=row(state.y),
            heading=row(state.h),
            speed=row(state.speed),
            acceleration=row((state.speed - self._previous_speed) / self._time_step),
            length=own.length,
            width=own.width,
            center_x=own.center_x,
            target_speed=row(self._target_speed),
            others_x=others_x,
            others_y=others_y,
            others_heading=others_heading,
            others_speed=others_speed,
            others_length=others_length,
            others_width=others_width,
            others_center_x=others_center_x,
            others_object_type=tuple(other.kind for other in self._others),
            active=np.ones(1, dtype=np.bool_),
            others_name=tuple(other.name for other in self._others),
        )
