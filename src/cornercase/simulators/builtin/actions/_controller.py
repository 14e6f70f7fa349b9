"""Drivers that control entities, and the actions that assign them."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError, PluginError, SimulationError
from cornercase._common.io.tracked_xml import find_by_name, find_untracked
from cornercase._common.masks import any_true
from cornercase._common.plugin_errors import (
    format_time_of_failure,
    is_built_in,
    make_scenario_failure,
    reraise_termination_request,
)
from cornercase._common.process.signals import count_requests
from cornercase._common.text.sanitize import quote_name
from cornercase._common.typing import BoolArray, FloatArray
from cornercase._common.validation import repr_short
from cornercase.drivers import DrivenPath, Driver, Situation
from cornercase.drivers._compiled import is_compiled, limit_driver_acceleration
from cornercase.drivers._resolve import create_driver_named_in_file
from cornercase.roads._lane_path import LanePath
from cornercase.scenario._file import DRIVER_PROPERTY
from cornercase.scenario._scope import Scope
from cornercase.simulators.builtin.actions._action import Action
from cornercase.simulators.builtin.kernels._driver_inputs import OTHERS_ROWS, OWN_ROWS, copy_driver_inputs
from cornercase.simulators.builtin.tracks._lane import LaneTrack
from cornercase.simulators.builtin.tracks._track import Track, Trajectory
from cornercase.simulators.builtin.world._world import World

# Trajectories for drivers, in m: sample spacing, straight extension beyond the end, and longest length.
_SAMPLE_SPACING, _EXTENSION_LENGTH, _MAX_LENGTH = 0.5, 200.0, 2000.0
# Number of points of trajectories that are computed at once.
_MAX_POINTS = 10_000

# Excess in m/s² that may come from rounding.
_ROUNDING = 1e-9

_LANE_PATH_CACHE: WeakKeyDictionary[LanePath, DrivenPath] = WeakKeyDictionary()


class DriverError(Exception):
    """A driver raised an exception or returned no acceleration, for several scenarios at once.

    `error` is the error of the scenario at fault. `can_bisect`: whether runs of half of the scenarios can find that
    scenario; otherwise only single runs can.
    """

    def __init__(self, error: SimulationError, splits: bool) -> None:
        super().__init__(str(error))
        self.error, self.can_bisect = error, splits


class DriverControl:
    """An entity of a batch, and the driver that decides its speed on lanes and trajectories while it is active.

    On a trajectory with times there is nothing to decide. `number` is the index in `World.drivers`. `in_fleet` says
    whether kernels make the decisions. `limit_notices` has a sentence without full stop for each vehicle limit that the
    driver exceeded; a semicolon precedes what differs between notices about the same limit.
    """

    def __init__(self, world: World, entity: int, driver: Driver) -> None:
        self._world, self.entity, self.driver = world, entity, driver
        self.number = len(world.drivers)
        world.drivers.append(self)
        self._others = [other for e, other in enumerate(world.entities) if e != entity]
        boxes = [(other.length, other.width, other.center_x) for other in self._others]
        self._others_boxes = np.array(boxes, dtype=np.float64).reshape(-1, 3).T.copy()
        self._others_object_type = tuple(other.kind for other in self._others)
        self._paths: dict[int, DrivenPath] = {}
        self._sampled_versions: dict[int, int] = {}
        self.limit_notices: dict[str, str] = {}
        self.in_fleet = is_compiled(driver)
        self._failure: DriverError | None = None
        if self.in_fleet:
            self._join_fleet()

    def _join_fleet(self) -> None:
        driver, entity = self.driver, self._world.entities[self.entity]
        assert is_compiled(driver)
        try:
            self._start_driver()
        except DriverError as failure:
            # The fleet needs a started driver.
            self._failure = failure
            built_in = next(base for base in type(driver).__mro__ if is_built_in(base) and issubclass(base, Driver))
            built_in.start(driver, self._world.scenarios, len(self._others))
        for limit, value in limit_driver_acceleration(driver, entity.max_acceleration, entity.max_deceleration).items():
            self._record_exceeded_limit(limit, f"it would go up to {value:.6g} m/s²")

    def reset_driver(self) -> None:
        """Reset the driver when the batch starts; this may be user code, which may fail."""
        if self._failure is not None:
            raise self._failure
        if not self.in_fleet:
            self._start_driver()

    def _start_driver(self) -> None:
        requests = count_requests()
        try:
            self.driver.start(self._world.scenarios, len(self._others))
        except BaseException as error:
            raise DriverError(make_scenario_failure(self._display_name, error, requests, 0.0), splits=True) from error

    @property
    def _display_name(self) -> str:
        driver_class, entity = type(self.driver), quote_name(self._world.names[self.entity])
        return f"the driver of {entity}" + (
            "" if is_built_in(driver_class) else f" ({driver_class.__module__}:{driver_class.__qualname__})"
        )

    def step(self, dt: float) -> None:
        """Let the driver decide the entity's speed at the end of the coming time step."""
        world, e = self._world, self.entity
        active = world.running & world.present[e] & world.driven[e] & (world.driver[e] == self.number)
        track_numbers = world.track[e]
        for k, track in enumerate(world.tracks[e]):
            rows = active & (track_numbers == k)
            if any_true(rows) and not (isinstance(track, Trajectory) and track.times is not None):
                self._set_speed(self._make_situation(k, track, dt, rows), rows)

    def _set_speed(self, situation: Situation, rows: BoolArray) -> None:
        """Set the speed that the driver decides in the scenarios of a mask; those without a valid acceleration fail."""
        world, speed = self._world, self._world.speed[self.entity]
        acceleration = self._call_driver(situation)
        is_missing = rows & ~np.isfinite(acceleration)
        if any_true(is_missing):
            for i in np.flatnonzero(is_missing).tolist():
                instant = format_time_of_failure(situation.time)
                returned = f"{self._display_name} returned {acceleration[i]:g}{instant}"
                is_failing = np.arange(world.scenarios) == i
                world.fail(is_failing, PluginError(f"{returned}, which is not an acceleration in m/s²"))
            rows = rows & ~is_missing
        acceleration = self._clip_acceleration(acceleration, rows, situation.time)
        next_speed = np.maximum(speed + acceleration * situation.time_step, 0.0)
        np.copyto(speed, np.minimum(next_speed, world.entities[self.entity].max_speed), where=rows)

    def _call_driver(self, situation: Situation) -> FloatArray:
        """Call the driver, which may be user code, and check its accelerations."""
        expected, requests = self._world.scenarios, count_requests()
        try:
            returned = self.driver.acceleration(situation)
        except BaseException as error:
            raise DriverError(
                make_scenario_failure(self._display_name, error, requests, situation.time), splits=True
            ) from error
        try:
            acceleration: FloatArray = np.asarray(returned).astype(np.float64, casting="same_kind")
            # A single number would be broadcast to all scenarios.
            if acceleration.shape != (expected,):
                raise ValueError
            return acceleration
        except BaseException as error:
            reraise_termination_request(error, requests)
            expectation = "for the scenario" if expected == 1 else f"for each of {expected} scenarios"
            instant = format_time_of_failure(situation.time)
            why = f"{self._display_name} returned no acceleration {expectation}{instant}, but {_safe_repr(returned)}"
            raise DriverError(PluginError(why), splits=False) from error

    def _clip_acceleration(self, acceleration: FloatArray, rows: BoolArray, time: float) -> FloatArray:
        entity = self._world.entities[self.entity]
        highest, lowest = entity.max_acceleration, -entity.max_deceleration
        if highest == np.inf == -lowest:
            return acceleration
        clipped = acceleration.clip(lowest, highest)
        if len(self.limit_notices) < 2 and any_true(rows & (clipped != acceleration)):
            for limit, excess in (("acceleration", acceleration - highest), ("deceleration", lowest - acceleration)):
                worst = float(excess[rows].max())
                if limit not in self.limit_notices and worst > _ROUNDING:
                    requested = worst + (highest if limit == "acceleration" else -lowest)
                    self._record_exceeded_limit(limit, f"first {requested:.6g} m/s²{format_time_of_failure(time)}")
        return clipped

    def _record_exceeded_limit(self, limit: str, requested: str) -> None:
        entity = self._world.entities[self.entity]
        bound = entity.max_acceleration if limit == "acceleration" else entity.max_deceleration
        self.limit_notices[limit] = (
            f"{self._display_name} exceeds the {limit} of {bound:.6g} m/s² in <Performance>, and is"
            f" limited to it; {requested}"
        )

    def _make_situation(self, track_number: int, track: Track, dt: float, rows: BoolArray) -> Situation:
        world, e, box = self._world, self.entity, self._world.entities[self.entity]
        # A driver may store or modify its input: give it arrays of its own.
        own = np.empty((len(OWN_ROWS), world.scenarios))
        others = np.empty((len(OTHERS_ROWS), len(self._others), world.scenarios))
        copy_driver_inputs(world.floats, world.flags, e, own, others)
        distance, x, y, heading, speed, acceleration, target_speed = own
        others_x, others_y, others_heading, others_speed = others.transpose(0, 2, 1)
        others_length, others_width, others_center_x = self._others_boxes.copy()
        return Situation(
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
        )

    def path_of_track(self, track_number: int, track: Track) -> DrivenPath:
        """Return the path along one of the entity's tracks, in the form that drivers get."""
        if isinstance(track, LaneTrack):
            if track_number not in self._paths:
                self._paths[track_number] = _lane_path(track.path)
        elif isinstance(track, Trajectory) and self._sampled_versions.get(track_number) != track.version:
            # A restarted trajectory may have another shape.
            self._paths[track_number], self._sampled_versions[track_number] = _sample_trajectory(track), track.version
        return self._paths[track_number]


def _safe_repr(value: object) -> str:
    try:
        return repr_short(value)
    except Exception:
        return f"a {type(value).__name__}"


def _lane_path(lane_path: LanePath) -> DrivenPath:
    """Return the path along a lane for drivers; it is cached, so that plans along it serve all batches."""
    if lane_path not in _LANE_PATH_CACHE:
        _LANE_PATH_CACHE[lane_path] = DrivenPath(
            lane_path.distance, lane_path.x, lane_path.y, lane_path.heading, lane_path.curvature
        )
    return _LANE_PATH_CACHE[lane_path]


def _sample_trajectory(track: Trajectory) -> DrivenPath:
    """Return samples of a trajectory, which may differ between scenarios, as a path for drivers.

    Distances are the same in all scenarios, and extend further than a driver looks. So what the driver sees in a
    scenario does not depend on the other scenarios.
    """
    ends = np.minimum(track.lengths, _MAX_LENGTH)
    distances = _SAMPLE_SPACING * np.arange(int(np.ceil((ends.max() + _EXTENSION_LENGTH) / _SAMPLE_SPACING)) + 1)
    x, y, heading, curvature = (np.empty((len(ends), len(distances))) for _ in range(4))
    # Some at a time: a call takes long, and all points at once need much memory.
    n_columns = max(_MAX_POINTS // len(ends), 1)
    for first in range(0, len(distances), n_columns):
        columns = slice(first, first + n_columns)
        at = np.tile(distances[columns], len(ends))
        rows = np.repeat(np.arange(len(ends)), len(distances[columns]))
        pose = track.pose_at(at, np.zeros(len(at)), rows)
        bend = np.where(at <= ends[rows], track.curvature_at(at, rows), 0.0)
        for samples, values in zip((x, y, heading, curvature), (*pose, bend), strict=True):
            samples[:, columns] = values.reshape(len(ends), -1)
    return DrivenPath(np.tile(distances, (len(ends), 1)), x, y, np.unwrap(heading, axis=1), curvature)


class ControllerAction(Action):
    """Assigns a controller to an entity, or activates its controller.

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
    """Hides an entity from the drivers of other entities, or shows it again."""

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
