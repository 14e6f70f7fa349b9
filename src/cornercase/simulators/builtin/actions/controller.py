"""Drivers in control of entities, and the actions that assign them."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np
from lxml import etree

from cornercase._common.arguments import shown
from cornercase._common.errors import InputError, PartError, SimulationError
from cornercase._common.interrupts import requests_heard
from cornercase._common.parts import failure_of, format_instant, is_built_in, raise_if_request
from cornercase._common.recorded_xml import named, unrecorded
from cornercase._common.texts import quoted_name
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.drivers import DrivenPath, Driver, Situation, decides_in_fleet, driver_of_file, limit_driver
from cornercase.roads import LanePath
from cornercase.scenario import DRIVER_PROPERTY, Scope
from cornercase.simulators.builtin.actions.action import Action
from cornercase.simulators.builtin.tracks.lane import LaneTrack
from cornercase.simulators.builtin.tracks.track import Track, Trajectory
from cornercase.simulators.builtin.world.state import World

# Trajectories for drivers, in m: sample spacing, straight extension beyond the end, and longest length.
_SPACING, _BEYOND, _LONGEST = 0.5, 200.0, 2000.0

# Excess in m/s² that may come from rounding.
_ROUNDING = 1e-9

_DRIVEN: WeakKeyDictionary[LanePath, DrivenPath] = WeakKeyDictionary()


class DriverError(Exception):
    """A driver raised an exception, or returned no acceleration, for several scenarios at once.

    `error` is for the scenario at fault. `can_bisect`: whether a run with half of the scenarios shows which half is at
    fault; otherwise only single runs do.
    """

    def __init__(self, error: SimulationError, splits: bool) -> None:
        super().__init__(str(error))
        self.error, self.splits = error, splits


class Driving:
    """One entity of a batch and the driver that decides its speed along lanes and trajectories while active.

    A trajectory with times leaves the driver nothing to decide. `number` is its index in `World.drivers`; `in_fleet`
    says whether kernels decide for it. `limit_notices`: by limit of the vehicle that the driver exceeded, a sentence
    without a full stop for a notice; what distinguishes notices of one limit follows a semicolon.
    """

    def __init__(self, world: World, entity: int, driver: Driver) -> None:
        self._world, self.entity, self.driver = world, entity, driver
        self.number = len(world.drivers)
        world.drivers.append(self)
        self._others = [a for a in range(len(world.entities)) if a != entity]
        self._paths: dict[int, DrivenPath] = {}
        self._begun: dict[int, int] = {}
        self.exceeded: dict[str, str] = {}
        self.in_fleet = decides_in_fleet(driver)
        self._failure: DriverError | None = None
        if self.in_fleet:
            self._join_fleet()

    def _join_fleet(self) -> None:
        driver, entity = self.driver, self._world.entities[self.entity]
        assert decides_in_fleet(driver)
        try:
            self._start()
        except DriverError as failure:
            # The fleet needs a started driver.
            self._failure = failure
            built_in = next(base for base in type(driver).__mro__ if is_built_in(base) and issubclass(base, Driver))
            built_in.start(driver, self._world.scenarios, len(self._others))
        for limit, value in limit_driver(driver, entity.max_acceleration, entity.max_deceleration).items():
            self._note(limit, f"it would go up to {value:.6g} m/s²")

    def begin(self) -> None:
        """Reset the driver when the batch starts; user code may fail or end the process here."""
        if self._failure is not None:
            raise self._failure
        if not self.in_fleet:
            self._start()

    def _start(self) -> None:
        requests = requests_heard()
        try:
            self.driver.start(self._world.scenarios, len(self._others))
        except BaseException as error:
            raise DriverError(failure_of(self._name, error, requests, 0.0), splits=True) from error

    @property
    def _name(self) -> str:
        """Name of the driver in errors and notices."""
        driver_class, entity = type(self.driver), quoted_name(self._world.names[self.entity])
        return f"the driver of {entity}" + (
            "" if is_built_in(driver_class) else f" ({driver_class.__module__}:{driver_class.__qualname__})"
        )

    def step(self, dt: float) -> None:
        """Decide the entity's speed at the end of the coming time step."""
        world, e = self._world, self.entity
        active = world.running & world.present[e] & world.driven[e] & (world.driver[e] == self.number)
        if dt == 0.0 or not active.any():
            return
        for k, track in enumerate(world.tracks[e]):
            rows = active & (world.track[e] == k)
            timed = isinstance(track, Trajectory) and track.time is not None
            if rows.any() and not timed:
                situation = self._situation(k, track, dt, rows)
                acceleration = self._decided(situation)
                for i in np.flatnonzero(rows & ~np.isfinite(acceleration)).tolist():
                    instant = format_instant(situation.time)
                    why = f"{self._name} returned {acceleration[i]:g}{instant}, which is not an acceleration in m/s²"
                    world.fail(np.arange(world.scenarios) == i, PartError(why))
                if not self.in_fleet:
                    acceleration = self._possible(acceleration, rows & np.isfinite(acceleration), situation.time)
                speed = np.maximum(world.speed[e] + acceleration * dt, 0.0)
                world.speed[e][rows] = np.minimum(speed, world.entities[e].max_speed)[rows]

    def _decided(self, situation: Situation) -> FloatArray:
        """Call the driver, which may be user code, and check its accelerations."""
        expected, requests = self._world.scenarios, requests_heard()
        try:
            returned = self.driver.acceleration(situation)
        except BaseException as error:
            raise DriverError(failure_of(self._name, error, requests, situation.time), splits=True) from error
        try:
            acceleration: FloatArray = np.asarray(returned).astype(np.float64, casting="same_kind")
            # A single number would be broadcast to all scenarios.
            if acceleration.shape != (expected,):
                raise ValueError
            return acceleration
        except BaseException as error:
            raise_if_request(error, requests)
            expectation = "for the scenario" if expected == 1 else f"for each of {expected} scenarios"
            instant = format_instant(situation.time)
            why = f"{self._name} returned no acceleration {expectation}{instant}, but {_shown(returned)}"
            raise DriverError(PartError(why), splits=False) from error

    def _possible(self, acceleration: FloatArray, rows: BoolArray, time: float) -> FloatArray:
        """Clip accelerations to what the vehicle can do."""
        entity = self._world.entities[self.entity]
        highest, lowest = entity.max_acceleration, -entity.max_deceleration
        for limit, excess in (("acceleration", acceleration - highest), ("deceleration", lowest - acceleration)):
            worst = float(excess[rows].max(initial=0.0))
            if limit not in self.exceeded and worst > _ROUNDING:
                requested = worst + (entity.max_acceleration if limit == "acceleration" else entity.max_deceleration)
                self._note(limit, f"first {requested:.6g} m/s²{format_instant(time)}")
        return np.clip(acceleration, lowest, highest)

    def _note(self, limit: str, asked: str) -> None:
        entity = self._world.entities[self.entity]
        bound = entity.max_acceleration if limit == "acceleration" else entity.max_deceleration
        self.exceeded[limit] = (
            f"{self._name} exceeds the {limit} of {bound:.6g} m/s² in <Performance>, and is limited to it; {asked}"
        )

    def _situation(self, k: int, track: Track, dt: float, rows: BoolArray) -> Situation:
        world, e, others = self._world, self.entity, self._others
        box, boxes = world.entities[e], [world.entities[a] for a in others]
        is_visible = (world.present & world.visible)[others].T
        # A driver may store or modify its input: pass copies.
        return Situation(
            time=float(world.time[rows].max()),
            time_step=dt,
            path=self.path(k, track),
            distance=world.distance[e].copy(),
            x=world.x[e].copy(),
            y=world.y[e].copy(),
            heading=world.heading[e].copy(),
            speed=world.speed[e].copy(),
            acceleration=world.acceleration[e].copy(),
            length=box.length,
            width=box.width,
            center_x=box.center_x,
            target_speed=world.target_speed[e].copy(),
            others_x=np.where(is_visible, world.x[others].T, np.nan),
            others_y=np.where(is_visible, world.y[others].T, np.nan),
            others_heading=np.where(is_visible, world.heading[others].T, np.nan),
            others_speed=np.where(is_visible, world.speed[others].T, np.nan),
            others_length=np.array([other.length for other in boxes]),
            others_width=np.array([other.width for other in boxes]),
            others_center_x=np.array([other.center_x for other in boxes]),
            others_kind=tuple(other.kind for other in boxes),
            active=rows.copy(),
        )

    def path(self, k: int, track: Track) -> DrivenPath:
        """Path for the driver of one of its entity's tracks."""
        if isinstance(track, LaneTrack):
            if k not in self._paths:
                self._paths[k] = _along_lane(track.path)
        elif isinstance(track, Trajectory) and self._begun.get(k) != track.version:
            # A restarted trajectory may have another shape.
            self._paths[k], self._begun[k] = _sampled(track), track.version
        return self._paths[k]


def _shown(given: object) -> str:
    try:
        return shown(given)
    except Exception:
        return f"a {type(given).__name__}"


def _along_lane(line: LanePath) -> DrivenPath:
    """Path along a lane, cached so that plans along it serve all batches."""
    if line not in _DRIVEN:
        _DRIVEN[line] = DrivenPath(line.distance, line.x, line.y, line.heading, line.curvature)
    return _DRIVEN[line]


def _sampled(track: Trajectory) -> DrivenPath:
    """Samples of a trajectory that may differ between scenarios.

    Distances are the same in all scenarios and extend further than a driver looks, so that what it sees in one scenario
    does not depend on the others.
    """
    ends = np.minimum(track.lengths, _LONGEST)
    distances = _SPACING * np.arange(int(np.ceil((ends.max() + _BEYOND) / _SPACING)) + 1)
    scenarios = np.arange(len(ends))
    x, y, heading, curvature = (np.empty((len(ends), len(distances))) for _ in range(4))
    for k, distance in enumerate(distances):
        at = np.full(len(ends), distance)
        x[:, k], y[:, k], heading[:, k] = track.at(at, np.zeros(len(ends)), scenarios)
        curvature[:, k] = np.where(at <= ends, track.curvature(at, scenarios), 0.0)
    return DrivenPath(np.tile(distances, (len(ends), 1)), x, y, np.unwrap(heading, axis=1), curvature)


class ControllerAction(Action):
    """Assigns a controller to an entity, or activates the assigned one.

    Only controllers with the property ``cornercase.driver`` act; any other leaves the entity to the storyboard. A
    driver chosen by the user who runs the file stays in control.
    """

    def __init__(self, element: etree._Element, scope: Scope, world: World, entity: int) -> None:
        self._entity = entity
        assign = element if element.tag == "AssignControllerAction" else element.find("AssignControllerAction")
        activate = element if element.tag == "ActivateControllerAction" else element.find("ActivateControllerAction")
        self._driver, self._activated = None, None
        if assign is not None:
            self._driver = self._assigned(assign, scope, world)
            self._activated = _flag(assign, "activateLongitudinal", scope)
        if activate is not None:
            self._activated = _flag(activate, "longitudinal", scope)

    def start(self, world: World, where: BoolArray) -> None:
        if not world.kept[self._entity]:
            world.control(self._entity, where, self._driver, self._activated)

    def _assigned(self, assign: etree._Element, scope: Scope, world: World) -> int:
        # Other programs' controllers are reported as having no effect, so they must not count as read.
        holder = next(iter(unrecorded(assign, "ObjectController")), assign)
        controller = next(iter(unrecorded(holder, "Controller")), None)
        reference = holder.find("CatalogReference")
        if controller is None and reference is not None:
            controller, scope = scope.from_catalog(reference, "Controller")
        if controller is None:
            return -1
        property_element = named(unrecorded(controller, "Properties", "Property"), DRIVER_PROPERTY)
        if property_element is None:
            return -1
        driver = registered_driver(scope.text(property_element, "value"), scope.source)
        return Driving(world, self._entity, driver).number


class VisibilityAction(Action):
    """Hides an entity from others in the traffic, or shows it again."""

    def __init__(self, element: etree._Element, scope: Scope, world: World, entity: int) -> None:
        self._entity, self._seen = entity, scope.flag(element, "traffic", True)

    def start(self, world: World, where: BoolArray) -> None:
        world.visible[self._entity][where] = self._seen


def registered_driver(name: str, where: str) -> Driver:
    """Create the registered driver that a file names; `location` starts the error message."""
    try:
        return driver_of_file(name)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def _flag(element: etree._Element, name: str, scope: Scope) -> bool | None:
    return None if element.get(name) is None else scope.flag(element, name, False)
