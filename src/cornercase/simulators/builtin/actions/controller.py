"""How a driver's decisions move an entity, and who is in charge of it."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np
from lxml import etree

from cornercase._common.arguments import shown
from cornercase._common.errors import InputError
from cornercase._common.recorded_xml import named, unrecorded
from cornercase._common.texts import in_one_line
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.drivers import DrivenPath, Driver, Situation, driver_of_file
from cornercase.roads import LanePath
from cornercase.scenario import DRIVER_PROPERTY, Scope
from cornercase.simulators.builtin.actions.action import Action
from cornercase.simulators.builtin.tracks.lane import LaneTrack
from cornercase.simulators.builtin.tracks.track import Track, Trajectory
from cornercase.simulators.builtin.world.state import World

# A driver is given trajectories as samples, in m: their spacing, how far they go straight on beyond the end, and how
# much of a closed trajectory is given.
_SPACING, _BEYOND, _LONGEST = 0.5, 200.0, 2000.0

_DRIVEN: WeakKeyDictionary[LanePath, DrivenPath] = WeakKeyDictionary()


class Driving:
    """One entity of a batch, and the driver that decides its speed along lanes and trajectories while in charge.

    A trajectory with times leaves the driver nothing to decide.

    Parameters
    ----------
    world : World
        It becomes one of its drivers.
    entity : int
        Row of the entity.
    driver : Driver

    Attributes
    ----------
    number : int
        Of the driver in the world.
    """

    def __init__(self, world: World, entity: int, driver: Driver) -> None:
        self._world, self.entity, self.driver = world, entity, driver
        self.number = len(world.drivers)
        world.drivers.append(self)
        self._others = [a for a in range(len(world.entities)) if a != entity]
        self._paths: dict[int, DrivenPath] = {}
        self._begun: dict[int, int] = {}
        driver.start(world.scenarios, len(self._others))

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
                acceleration = self._decided(self._situation(k, track, dt, rows))
                lost = rows & ~np.isfinite(acceleration)
                world.fail(lost, f"the driver of {world.names[e]} gave an acceleration that is not a finite number")
                speed = np.maximum(world.speed[e] + acceleration * dt, 0.0)
                world.speed[e][rows] = np.minimum(speed, world.entities[e].max_speed)[rows]

    def _decided(self, situation: Situation) -> FloatArray:
        """What the driver gives, which may be a class of anybody."""
        place = f"The driver of {self._world.names[self.entity]}"
        try:
            given = self.driver.acceleration(situation)
        except InputError:
            raise
        except Exception as error:
            raise InputError(f"{place} failed: {in_one_line(error)}.") from error
        expected = self._world.scenarios
        try:
            return np.broadcast_to(np.asarray(given).astype(np.float64, casting="same_kind"), (expected,))
        except (TypeError, ValueError):
            raise InputError(
                f"{place} gave no acceleration for each of {expected} scenarios, but {shown(given)}."
            ) from None

    def _situation(self, k: int, track: Track, dt: float, rows: BoolArray) -> Situation:
        world, e, others = self._world, self.entity, self._others
        box, boxes = world.entities[e], [world.entities[a] for a in others]
        there = (world.present & world.visible)[others].T
        # A driver may keep what it is told, or write into it.
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
            others_x=np.where(there, world.x[others].T, np.nan),
            others_y=np.where(there, world.y[others].T, np.nan),
            others_heading=np.where(there, world.heading[others].T, np.nan),
            others_speed=np.where(there, world.speed[others].T, np.nan),
            others_length=np.array([one.length for one in boxes]),
            others_width=np.array([one.width for one in boxes]),
            others_center_x=np.array([one.center_x for one in boxes]),
            others_kind=tuple(one.kind for one in boxes),
            active=rows.copy(),
        )

    def path(self, k: int, track: Track) -> DrivenPath:
        """What a driver is given of one of its entity's tracks, by its number."""
        if isinstance(track, LaneTrack):
            if k not in self._paths:
                self._paths[k] = _along_lane(track.path)
        elif isinstance(track, Trajectory) and self._begun.get(k) != track.version:
            # A trajectory that is begun again may run elsewhere.
            self._paths[k], self._begun[k] = _sampled(track), track.version
        return self._paths[k]


def _along_lane(line: LanePath) -> DrivenPath:
    """The same object for the same line, so that what is planned along it serves all batches."""
    if line not in _DRIVEN:
        _DRIVEN[line] = DrivenPath(line.distance, line.x, line.y, line.heading, line.curvature)
    return _DRIVEN[line]


def _sampled(track: Trajectory) -> DrivenPath:
    """Samples of a trajectory that may run otherwise in each scenario.

    They are at the same distances in each, and go on further than a driver looks, so that what a driver sees in one
    scenario does not depend on the others.
    """
    ends = np.minimum(track.lengths, _LONGEST)
    places = _SPACING * np.arange(int(np.ceil((ends.max() + _BEYOND) / _SPACING)) + 1)
    every = np.arange(len(ends))
    x, y, heading, curvature = (np.empty((len(ends), len(places))) for _ in range(4))
    for k, place in enumerate(places):
        at = np.full(len(ends), place)
        x[:, k], y[:, k], heading[:, k] = track.at(at, np.zeros(len(ends)), every)
        curvature[:, k] = np.where(at <= ends, track.curvature(at, every), 0.0)
    return DrivenPath(np.tile(places, (len(ends), 1)), x, y, np.unwrap(heading, axis=1), curvature)


class ControllerAction(Action):
    """Assigns a controller to an entity, or activates the one that it has.

    Of controllers those with the property ``cornercase.driver`` act; any other leaves the entity to the
    storyboard. A driver that was chosen by who runs the file stays in charge.
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
        # Of other programs' controllers is said that they have no effect, so that they do not count as read.
        holder = next(iter(unrecorded(assign, "ObjectController")), assign)
        controller = next(iter(unrecorded(holder, "Controller")), None)
        reference = holder.find("CatalogReference")
        if controller is None and reference is not None:
            controller, scope = scope.from_catalog(reference, "Controller")
        if controller is None:
            return -1
        item = named(unrecorded(controller, "Properties", "Property"), DRIVER_PROPERTY)
        if item is None:
            return -1
        driver = registered_driver(scope.text(item, "value"), scope.source)
        return Driving(world, self._entity, driver).number


class VisibilityAction(Action):
    """Hides an entity from the others in the traffic, or shows it again."""

    def __init__(self, element: etree._Element, scope: Scope, world: World, entity: int) -> None:
        self._entity, self._seen = entity, scope.flag(element, "traffic", True)

    def start(self, world: World, where: BoolArray) -> None:
        world.visible[self._entity][where] = self._seen


def registered_driver(name: str, where: str) -> Driver:
    """Build a driver that a file asks for by its registered name.

    Parameters
    ----------
    name : str
    where : str
        Who asks, for messages.

    Returns
    -------
    Driver

    Raises
    ------
    InputError
        There is none; a file cannot name a class to load.
    """
    try:
        return driver_of_file(name)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def _flag(element: etree._Element, name: str, scope: Scope) -> bool | None:
    return None if element.get(name) is None else scope.flag(element, name, False)
