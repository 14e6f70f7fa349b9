"""State of all entities in all concrete scenarios of a batch.

Arrays are indexed (entity, scenario); their first axis is the entity.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import numpy.typing as npt
from lxml import etree

from cornercase._common.errors import SimulationError
from cornercase._common.geometry.boxes import box_corners
from cornercase._common.io.support_table import NoticeLabel
from cornercase._common.plugin_errors import format_time_of_failure
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.drivers._driving_function import Body
from cornercase.roads._network import RoadNetwork
from cornercase.scenario import Value
from cornercase.scenario._scope import Scope
from cornercase.simulators.builtin.tracks._lane import LaneTrack
from cornercase.simulators.builtin.tracks._track import Track
from cornercase.simulators.builtin.world._state_layout import (
    FLAG_ROWS,
    FLOAT_ROWS,
    GONE_X,
    GONE_Y,
    INTEGER_ROWS,
    N_FLOAT_ROWS,
    PULL_X,
    PULL_Y,
)
from cornercase.simulators.builtin.world._traffic_signals import SignalController

if TYPE_CHECKING:
    from cornercase.simulators.builtin.kernels._kernel_interface import KernelInterface

LONGITUDINAL, LATERAL = "longitudinal", "lateral"


class SpeedController(Protocol):
    """Controller that decides the speed of an entity."""

    def step(self, dt: float) -> None:
        """Decide the speed of the entity at the end of the coming time step of `dt` s."""
        ...


@dataclass(frozen=True)
class Entity:
    """Constant properties of an entity.

    `kind`: vehicle category, ``"pedestrian"`` or ``"misc"``. The bounding box is in m; limits are in m/s and m/s², and
    infinite if not set (but 0 for the speed of a misc object). `wheelbase` in m and `max_steering` in rad have defaults
    if the file has no axles. `slides`: True if the entity goes along a trajectory with any heading that the trajectory
    defines. `polyline_turning`: where the heading changes along a polyline (`ALONG_SEGMENTS`, `AT_CORNERS` or
    `AT_VERTICES`); None if the ``followingMode`` of the action decides. `body`: XML element of the entity, and the
    scope in which to read it.
    """

    name: str
    kind: str
    length: float
    width: float
    center_x: float
    max_speed: float
    max_acceleration: float
    max_deceleration: float
    wheelbase: float
    max_steering: float
    slides: bool = False
    polyline_turning: int | None = None
    body: tuple[etree._Element, Scope] | None = field(default=None, repr=False, compare=False)

    @property
    def driven_body(self) -> Body:
        """Properties of the entity, as given to its driver."""
        return Body(
            self.name,
            self.kind,
            self.length,
            self.width,
            self.center_x,
            self.wheelbase,
            self.max_steering,
            self.max_speed,
            self.max_acceleration,
            self.max_deceleration,
        )


@dataclass(frozen=True)
class Tow:
    """Connection of a vehicle and a trailer that the vehicle pulls, or may pull later.

    `vehicle` and `trailer` are indices of entities. `hitch` and `coupler` are the distances in m of the connection
    ahead of the reference points of vehicle and trailer.
    """

    vehicle: int
    trailer: int
    hitch: float
    coupler: float


class World:
    """State of E entities in N concrete scenarios; the module `_state_layout` lists the rows of its tables.

    The arrays (E, N) are views of the tables `floats`, `flags` and `numbers` (N, K, E): write into these arrays, and
    never replace them. `overlapping` (E, E, N) is a view of `overlaps` (N, E, E).

    Time in s: `time` and `last_step` (N,), `time_step`, and the longest `duration`. `running` (N,): scenarios that take
    part in the current frame. `changed` (N,): scenarios whose storyboard has changed in this frame. `started`: True
    after the first frame, in which nothing moves.

    Motion: `friction` (N,): friction coefficient of the road, for vehicle models. `step_velocity` in m/s and
    `step_acceleration` in m/s²: x and y components in the last step. `needs_road_check`: True if a condition asks for
    entities off the road. `tracks`: all tracks that each entity has followed. `routes`: all assigned routes and
    what remains of them, each as points (road, lane, s). `lane_tracks`: cache of tracks along lanes.

    Storyboard: `variables` and `parameters`: values (N,), numbers or texts. `values`: parameter values that differ from
    the file, by scenario. `signals`: states of traffic signals (N,), texts. `selections`: indices of entities, by name.
    `positioned_entity`: index of the entity whose position is being resolved. `current_action`: line and name of the
    action that acts, for errors. `evaluate_leaves`: function that evaluates all leaf conditions (the simple
    parts of conditions that compiled code evaluates) in the running scenarios. `has_leaf_values`: True if leaf
    conditions were evaluated since an action last changed the state.

    Drivers: `drivers`: all drivers that may control entities. `has_fixed_driver` (E): True if the user chose the
    driver, so that the file cannot change it. `seeds`: seeds of random numbers, by scenario.

    Results: `errors`: errors by scenario. `notices`: sentences on deviations from the file, without full stop, each
    once. `compiled`: access to kernels, set when the run is prepared.
    """

    x: FloatArray
    y: FloatArray
    heading: FloatArray
    speed: FloatArray
    acceleration: FloatArray
    odometer: FloatArray
    standing_since: FloatArray
    distance: FloatArray
    offset: FloatArray
    turn: FloatArray
    sideways: FloatArray
    pace: FloatArray
    velocity: FloatArray
    last_s: FloatArray
    road_heading: FloatArray
    at_end_since: FloatArray
    off_road_since: FloatArray
    target_speed: FloatArray
    from_x: FloatArray
    from_y: FloatArray
    from_heading: FloatArray
    before: FloatArray
    present: BoolArray
    changes_lanes: BoolArray
    stranded: BoolArray
    moved: BoolArray
    decided: BoolArray
    activated: BoolArray
    driven: BoolArray
    visible: BoolArray
    jumped: BoolArray
    steered: BoolArray
    track: IntArray
    route: IntArray
    last_road: IntArray
    driver: IntArray
    pulled_by: IntArray
    compiled: KernelInterface

    def __init__(
        self,
        entities: tuple[Entity, ...],
        scenarios: int,
        network: RoadNetwork | None,
        tows: tuple[Tow, ...] = (),
        time_step: float = 0.05,
        duration: float = 60.0,
    ) -> None:
        self.entities, self.tows = entities, tows
        self.time_step, self.duration = time_step, duration
        self.names = [entity.name for entity in entities]
        self.scenarios = scenarios
        self.network = network
        self.time, self.last_step = np.zeros(scenarios), np.zeros(scenarios)
        self.running = np.ones(scenarios, dtype=np.bool_)
        self.changed = np.zeros(scenarios, dtype=np.bool_)
        self.started = False
        self.floats = np.zeros((scenarios, N_FLOAT_ROWS, len(entities)))
        self.flags = np.zeros((scenarios, len(FLAG_ROWS), len(entities)), dtype=np.bool_)
        self.numbers = np.zeros((scenarios, len(INTEGER_ROWS), len(entities)), dtype=np.int64)
        for table, rows in ((self.floats, FLOAT_ROWS), (self.flags, FLAG_ROWS), (self.numbers, INTEGER_ROWS)):
            for name, (row, value) in rows.items():
                table[:, row] = value
                setattr(self, name, table[:, row].T)
        self.step_velocity = (self.floats[:, GONE_X].T, self.floats[:, GONE_Y].T)
        self.step_acceleration = (self.floats[:, PULL_X].T, self.floats[:, PULL_Y].T)
        self.overlaps = np.zeros((scenarios, len(entities), len(entities)), dtype=np.bool_)
        self.overlapping = self.overlaps.transpose(1, 2, 0)
        self.friction = np.ones(scenarios)
        self.signals: dict[str, npt.NDArray[np.str_]] = {}
        self.seeds: Sequence[int] = (0,) * scenarios
        self.signal_controllers: dict[str, SignalController] = {}
        self.drivers: list[SpeedController] = []
        self.has_fixed_driver = [False] * len(entities)
        self.tracks: list[list[Track]] = [[] for _ in entities]
        self.routes: list[tuple[tuple[int, int, float], ...]] = [()]
        self.needs_road_check = False
        self.variables: dict[str, Any] = {}
        self.parameters: dict[str, Any] = {}
        self.values: Sequence[Mapping[str, Value]] = [{}] * scenarios
        self.selections: dict[str, list[int]] = {}
        self.positioned_entity: int | None = None
        self.lane_tracks: dict[tuple[object, ...], LaneTrack | None] = {}
        self.errors: dict[int, SimulationError] = {}
        self.current_action: str | None = None
        self.evaluate_leaves: Callable[[], None] = lambda: None
        self.has_leaf_values = False
        self.notices: dict[str, None] = {}
        for tow in tows:
            self.pulled_by[tow.trailer] = tow.vehicle

    def iter_followed_tracks(self, entity: int, where: BoolArray) -> Iterator[tuple[int, Track, IntArray]]:
        """Yield each track that an entity follows in scenarios of a mask: number, track, and scenario indices."""
        for number, track in enumerate(self.tracks[entity]):
            rows = np.flatnonzero(where & (self.track[entity] == number))
            if rows.size:
                yield number, track, rows

    def entities_of_type(self, object_type: str) -> list[int]:
        """Return the indices of all entities of an ``ObjectType``: pedestrian, miscellaneous or vehicle."""
        types = {"pedestrian": "pedestrian", "misc": "miscellaneous"}
        return [e for e, entity in enumerate(self.entities) if types.get(entity.kind, "vehicle") == object_type]

    def update_overlaps(self) -> None:
        """Update in `overlapping` which bounding boxes of entities overlap now."""
        for a, b in combinations(range(len(self.entities)), 2):
            self.overlapping[a, b] = self.overlapping[b, a] = self.compiled.find_overlaps(a, b)

    def box_corners(self) -> FloatArray:
        """Return the corners of all bounding boxes in m, shape (E, N, 4, 2)."""
        boxes = np.array([(entity.center_x, entity.length, entity.width) for entity in self.entities])
        center_x, length, width = boxes.T[:, :, None]
        x, y = self.x + center_x * np.cos(self.heading), self.y + center_x * np.sin(self.heading)
        return box_corners(x, y, self.heading, length, width)

    def fail(self, where: BoolArray, reason: str | SimulationError) -> None:
        """Store an error for the running scenarios of a mask, and end these scenarios."""
        for i in np.flatnonzero(where & self.running).tolist():
            if isinstance(reason, SimulationError):
                self.errors[i] = reason
            else:
                acting = "" if self.current_action is None else f"{self.current_action}: "
                instant = "" if self.current_action is None else format_time_of_failure(float(self.time[i]))
                self.errors[i] = SimulationError(f"{acting}{reason}{instant}")
        self.running &= ~where

    def add_notice(
        self,
        location: str,
        subject: str,
        reason: str,
        where: BoolArray,
        label: NoticeLabel = NoticeLabel.ADAPTED,
    ) -> None:
        """Add a notice that `subject` at `location` (file and line) is not run as written; `reason` says what happens.

        The same notice is added only once.
        """
        first = np.flatnonzero(where & self.running)
        sentence = f"{label}: {subject} ({location}): {reason}"
        if first.size and not any(notice.startswith(f"{sentence}; ") for notice in self.notices):
            self.notices[f"{sentence}; first at {self.time[first[0]]:.6g} s"] = None

    def update_leaf_values(self) -> None:
        """Evaluate all leaf conditions in the running scenarios, unless their values are up to date."""
        if not self.has_leaf_values:
            self.evaluate_leaves()
            self.has_leaf_values = True

    def set_speed(self, entity: int, where: BoolArray, speed: FloatArray) -> None:
        """Set the target speed of an entity in m/s in the scenarios of a mask.

        Unless a driver controls the entity, also set its speed.
        """
        self.target_speed[entity][where] = speed[where]
        undriven = where & ~self.driven[entity]
        self.speed[entity][undriven] = speed[undriven]
        self.decided[entity] |= where

    def assign_control(
        self, entity: int, where: BoolArray, driver: int | None = None, activated: bool | None = None
    ) -> None:
        """Assign a driver to an entity (-1: none), or activate or deactivate the driver; None changes nothing."""
        if driver is not None:
            self.driver[entity][where] = driver
        if activated is not None:
            self.activated[entity][where] = activated
        self.driven[entity] = self.activated[entity] & (self.driver[entity] >= 0)
