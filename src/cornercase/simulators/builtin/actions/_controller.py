"""Drivers that control entities, and the actions that assign them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.io.tracked_xml import find_by_name, find_untracked
from cornercase._common.masks import any_true
from cornercase._common.plugin_errors import is_built_in
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.drivers import DrivenPath, Driver, PlanarMotion, Situation
from cornercase.drivers._attached_driver import AttachedDriver, Decision, DriverError
from cornercase.drivers._driving_function import Start
from cornercase.drivers._lanes import driven_path
from cornercase.drivers._resolve import create_driver_named_in_file
from cornercase.drivers._view import FARTHEST_ON_TRAJECTORY
from cornercase.scenario._file import DRIVER_PROPERTY
from cornercase.scenario._scope import Scope
from cornercase.simulators.builtin.actions._action import Action
from cornercase.simulators.builtin.kernels._entity_state_copy import OTHERS_ROWS, OWN_ROWS, copy_driver_inputs
from cornercase.simulators.builtin.tracks._lane import LaneTrack
from cornercase.simulators.builtin.tracks._track import Track, Trajectory
from cornercase.simulators.builtin.world._lane_following import follow_lane_at_position
from cornercase.simulators.builtin.world._track_motion import move_to_pose, shift_along_trajectory
from cornercase.simulators.builtin.world._world import World

# Trajectories for drivers, in m: sample spacing, and straight extension beyond the end, farther than anybody looks.
_SAMPLE_SPACING, _EXTENSION_LENGTH = 0.5, FARTHEST_ON_TRAJECTORY
# m/s, of an entity without a limit.
_MAX_SPEED = 100.0
# Number of points of trajectories that are computed at once.
_MAX_POINTS = 10_000


class DriverControl:
    """Control of one entity by a driver, in all scenarios of a batch.

    The driver moves the entity along lanes and trajectories, or steers it. On a trajectory with times, the driver
    decides nothing, since the times determine the motion. `parameters` has values of the driver's parameters by name,
    one value per scenario. `number` is the index in `World.drivers`. `in_fleet` says whether compiled code makes the
    driver's decisions.
    """

    def __init__(
        self, world: World, entity: int, driver: Driver, parameters: Mapping[str, FloatArray] | None = None
    ) -> None:
        self._world, self.entity, self._parameters = world, entity, parameters or {}
        self.attached_driver = AttachedDriver(driver, world.names[entity])
        self.in_fleet = self.attached_driver.is_compiled
        self.driver = self.attached_driver.driver if self.in_fleet else driver
        self.number = len(world.drivers)
        world.drivers.append(self)
        self._others = [other for e, other in enumerate(world.entities) if e != entity]
        boxes = [(other.length, other.width, other.center_x) for other in self._others]
        self._others_boxes = np.array(boxes, dtype=np.float64).reshape(-1, 3).T.copy()
        self._others_object_type = tuple(other.kind for other in self._others)
        self._others_name = tuple(other.name for other in self._others)
        self._paths: dict[int, DrivenPath] = {}
        self._sampled_versions: dict[int, int] = {}
        self._failure: DriverError | None = None
        if self.in_fleet:
            self._join_fleet()

    @property
    def limit_notices(self) -> dict[str, str]:
        """Sentences without full stop on limits (of the vehicle or its lanes) that the driver exceeded, by limit."""
        return self.attached_driver.limit_notices

    def _join_fleet(self) -> None:
        driver = self.driver
        try:
            self.attached_driver.start(self._make_start())
            self.driver = self.attached_driver.driver
        except DriverError as failure:
            # The fleet needs a started driver.
            self._failure = failure
            built_in = next(base for base in type(driver).__mro__ if is_built_in(base) and issubclass(base, Driver))
            built_in.start(driver, self._world.scenarios, len(self._others))

    def reset_driver(self) -> None:
        """Start the driver, unless it was started for compiled code; raises `DriverError` if either start fails."""
        if self._failure is not None:
            raise self._failure
        if not self.in_fleet:
            self.attached_driver.start(self._make_start())

    def free_driver_resources(self) -> None:
        """Let the driver release its resources when the batch has ended."""
        self.attached_driver.release()

    def _make_start(self) -> Start:
        world, entity = self._world, self._world.entities[self.entity]
        return Start(
            body=entity.driven_body,
            time_step=world.time_step,
            parameters=self._parameters,
            values=tuple(world.values),
            seeds=world.seeds,
            others=self._others_name,
            network=world.network,
            friction=world.friction,
        )

    @property
    def steers(self) -> bool:
        """Whether the entity has a vehicle model that steers."""
        return self.attached_driver.vehicle is not None and self.attached_driver.vehicle.steers

    def find_scenarios_in_charge(self) -> BoolArray:
        """Return the running scenarios in which the driver drives the entity, as a mask."""
        world, e = self._world, self.entity
        return np.asarray(world.running & world.present[e] & world.driven[e] & (world.driver[e] == self.number))

    def step(self, dt: float) -> None:
        """Let the driver decide the entity's motion in the coming time step."""
        world, e = self._world, self.entity
        active = self.find_scenarios_in_charge()
        # A steered entity may follow another track afterwards.
        track_numbers = world.track[e].copy()
        for k, track in enumerate([*world.tracks[e]]):
            rows = active & (track_numbers == k)
            if any_true(rows) and not (isinstance(track, Trajectory) and track.times is not None):
                self._apply_decision(self.attached_driver.step(*self._make_situation(k, track, dt, rows)), rows)

    def _apply_decision(self, decision: Decision, rows: BoolArray) -> None:
        """Move the entity as the driver has decided, in the scenarios of a mask."""
        world, e, motion = self._world, self.entity, decision.motion
        for n, failure in decision.failures.items():
            world.fail(np.arange(world.scenarios) == n, failure)
        rows = rows & world.running
        world.steered[e][rows] = motion.is_steered[rows]
        if self.attached_driver.vehicle is not None:
            world.pace[e][rows] = 0.5 * (world.speed[e] + motion.state.speed)[rows]
        if self.attached_driver.sees_start_of_step and any_true(goes := rows & world.moved[e] & ~motion.is_steered):
            # The storyboard has moved it along a trajectory by the speed that it had.
            pace = world.pace[e] if self.attached_driver.vehicle is not None else motion.state.speed
            covered = pace * world.time_step
            shift_along_trajectory(world, e, goes, covered - world.speed[e] * world.time_step)
        np.copyto(world.speed[e], motion.state.speed, where=rows)
        if any_true(steered := rows & motion.is_steered):
            move_to_pose(world, e, motion.state.x, motion.state.y, motion.state.heading, steered)
            follow_lane_at_position(world, e, steered, is_tracked=motion.is_tracked)

    def _make_situation(
        self, track_number: int, track: Track, dt: float, rows: BoolArray
    ) -> tuple[Situation, PlanarMotion]:
        """Return the input of the driver, and the motion of the entity at the start of the time step."""
        world, e, box = self._world, self.entity, self._world.entities[self.entity]
        # A driver may store or modify its input: give it arrays of its own.
        own = np.empty((len(OWN_ROWS), world.scenarios))
        others = np.empty((len(OTHERS_ROWS), len(self._others), world.scenarios))
        begin = np.empty((3, world.scenarios))
        copy_driver_inputs(world.floats, world.flags, e, self.attached_driver.sees_start_of_step, begin, own, others)
        distance, x, y, heading, speed, acceleration, target_speed = own
        others_x, others_y, others_heading, others_speed = others.transpose(0, 2, 1)
        others_length, others_width, others_center_x = self._others_boxes.copy()
        situation = Situation(
            time=float(world.time[rows].max()),
            time_step=dt,
            path=self.path_of_track(track_number, track),
            distance=distance,
            x=x,
            y=y,
            heading=heading,
            speed=speed,
            acceleration=acceleration,
            length=box.length,
            width=box.width,
            center_x=box.center_x,
            target_speed=target_speed,
            others_x=others_x,
            others_y=others_y,
            others_heading=others_heading,
            others_speed=others_speed,
            others_length=others_length,
            others_width=others_width,
            others_center_x=others_center_x,
            others_object_type=self._others_object_type,
            active=rows.copy(),
            others_name=self._others_name,
            signals=world.signals,
        )
        begin_x, begin_y, begin_heading = begin
        return situation, PlanarMotion(begin_x, begin_y, begin_heading, speed.copy(), acceleration.copy())

    def path_of_track(self, track_number: int, track: Track) -> DrivenPath:
        """Return the path along one of the entity's tracks, in the form that drivers get."""
        if isinstance(track, LaneTrack):
            if track_number not in self._paths:
                self._paths[track_number] = driven_path(track.path)
        elif isinstance(track, Trajectory) and self._sampled_versions.get(track_number) != track.version:
            # A restarted trajectory may have another shape.
            path = sample_trajectory(track, self._estimate_reach_along(track_number))
            self._paths[track_number], self._sampled_versions[track_number] = path, track.version
        return self._paths[track_number]

    def _estimate_reach_along(self, track_number: int) -> float:
        """Return the distance in m along a track that the entity can reach until the end of the run."""
        world, max_speed = self._world, self._world.entities[self.entity].max_speed
        begins = world.distance[self.entity][world.track[self.entity] == track_number]
        return float(begins.max(initial=0.0)) + min(max_speed, _MAX_SPEED) * world.duration


def sample_trajectory(track: Trajectory, reach: float) -> DrivenPath:
    """Sample a trajectory up to the distance `reach` in m, and return the samples as a path for drivers.

    The trajectory may have another shape in each scenario. The distances of the samples are the same in all scenarios,
    and extend farther than a driver looks. So the driver's view in one scenario does not depend on other scenarios.
    """
    ends = np.minimum(track.lengths, reach)
    distances = _SAMPLE_SPACING * np.arange(int(np.ceil((ends.max() + _EXTENSION_LENGTH) / _SAMPLE_SPACING)) + 1)
    x, y, heading, curvature = (np.empty((len(ends), len(distances))) for _ in range(4))
    # Some at a time: a call takes long, and all points at once need much memory.
    n_columns = max(_MAX_POINTS // len(ends), 1)
    for first in range(0, len(distances), n_columns):
        columns = slice(first, first + n_columns)
        at = np.tile(distances[columns], len(ends))
        rows = np.repeat(np.arange(len(ends)), len(distances[columns]))
        pose = track.pose_at(at, np.zeros(len(at)), rows)
        bend = np.where(at <= track.lengths[rows], track.curvature_at(at, rows), 0.0)
        for samples, values in zip((x, y, heading, curvature), (*pose, bend), strict=True):
            samples[:, columns] = values.reshape(len(ends), -1)
    return DrivenPath(np.tile(distances, (len(ends), 1)), x, y, np.unwrap(heading, axis=1), curvature)


class ControllerAction(Action):
    """Action that assigns a controller to an entity, or switches the entity's controller on or off.

    A controller only has an effect if it has the property ``cornercase.driver``; otherwise the storyboard moves the
    entity. A driver that the user chose for the entity stays in control.
    """

    def __init__(self, element: etree._Element, scope: Scope, world: World, entity: int) -> None:
        self._entity = entity
        assign = element if element.tag == "AssignControllerAction" else element.find("AssignControllerAction")
        activate = element if element.tag == "ActivateControllerAction" else element.find("ActivateControllerAction")
        self._driver, self._activated = None, None
        if assign is not None:
            self._driver = self._read_assigned_driver(assign, scope, world)
            self._activated = _read_optional_flag(assign, "activateLongitudinal", scope)
        if activate is not None:
            self._activated = _read_optional_flag(activate, "longitudinal", scope)

    def start(self, world: World, where: BoolArray) -> None:
        if not world.has_fixed_driver[self._entity]:
            world.assign_control(self._entity, where, self._driver, self._activated)

    def _read_assigned_driver(self, assign: etree._Element, scope: Scope, world: World) -> int:
        # Other programs' controllers are reported as having no effect, so they must not count as read.
        holder = next(iter(find_untracked(assign, "ObjectController")), assign)
        controller = next(iter(find_untracked(holder, "Controller")), None)
        reference = holder.find("CatalogReference")
        if controller is None and reference is not None:
            controller, scope = scope.resolve_catalog_reference(reference, "Controller")
        if controller is None:
            return -1
        property_element = find_by_name(find_untracked(controller, "Properties", "Property"), DRIVER_PROPERTY)
        if property_element is None:
            return -1
        driver = create_file_driver(scope.read_text(property_element, "value"), scope.file_name)
        return DriverControl(world, self._entity, driver).number


class VisibilityAction(Action):
    """Action that hides an entity from the drivers of other entities, or shows the entity again."""

    def __init__(self, element: etree._Element, scope: Scope, world: World, entity: int) -> None:
        self._entity, self._seen = entity, scope.read_boolean(element, "traffic", True)

    def start(self, world: World, where: BoolArray) -> None:
        world.visible[self._entity][where] = self._seen


def create_file_driver(name: str, location: str) -> Driver:
    """Create the registered driver that a file names; `location` starts the error message."""
    try:
        return create_driver_named_in_file(name)
    except InputError as error:
        raise InputError(f"{location}: {error}") from None


def _read_optional_flag(element: etree._Element, name: str, scope: Scope) -> bool | None:
    return None if element.get(name) is None else scope.read_boolean(element, name, False)
