"""State of all entities in all concrete scenarios of a batch.

Arrays are indexed (entity, scenario), so that the values of an entity are contiguous in memory.
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
from cornercase.drivers._function import Body
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
    from cornercase.simulators.builtin.kernels._compiled_world import CompiledWorld

LONGITUDINAL, LATERAL = "longitudinal", "lateral"


class SpeedController(Protocol):
    """Decides the speed of an entity that it controls."""

    def step(self, dt: float) -> None:
        """Decide the entity's speed at the end of the coming time step."""
        ...


@dataclass(frozen=True)
class Entity:
    """Constant properties of an entity.

    `kind`: vehicle category, ``"pedestrian"`` or ``"misc"``. The box is in m; limits are in m/s and m/s², infinite if
    not set. `wheelbase` in m and `max_steering` in rad have defaults if the file has no axles. `slides`: whether it
    follows trajectories with any heading that they define. `polyline_turning`: where its heading turns along a polyline
    (`ALONG_SEGMENTS`, `AT_CORNERS`, `AT_VERTICES`); None if the following mode decides.
    `body`: its element in the file, and the scope to read it in.
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
        """The entity as its driver knows it."""
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
    """A vehicle and a trailer (both rows) that it pulls, or may pull later.

    `hitch` is the distance of the connection ahead of the vehicle's reference point in m; `coupler` is its distance
    ahead of the trailer's reference point.
    """

    vehicle: int
    trailer: int
    hitch: float
    coupler: float


class World:
    """State of E entities in N concrete scenarios; `_state_layout` documents the rows of its tables.

    The arrays (E, N) are views of `floats`, `flags` and `numbers` (N, K, E): write into them, and never replace them.
    `overlapping` (E, E, N) is a view of `overlaps` (N, E, E).

    Time: `time`, `last_step` (N,), `time_step` and the longest `duration` in s. `running` (N,): scenarios in the
    current frame. `changed` (N,): scenarios whose storyboard has changed in this frame. `started`: whether the first
    frame is over, in which nothing moves.

    Motion: `friction` (N,): coefficient of the road, for vehicle models. `step_velocity` in m/s and `step_acceleration`
    in m/s² of the last step, as x and y. `needs_road_check`: whether a condition asks for entities off the road.
    `tracks`: all tracks that each entity has followed. `routes`: all assigned routes, as (road, lane, s).
    `lane_tracks`: cache of tracks along lanes.

    Storyboard: `variables` and `parameters`: values (N,), numbers or texts. `values`: values by scenario (N) that
    differ from those in the file. `signals`: states (N,), texts.
    `selections`: rows of entities. `positioned_entity`: row of the entity whose position is being resolved.
    `current_action`: line and name of the action that acts, for errors. `evaluate_leaves`: evaluates the leaves of all
    conditions in the running scenarios. `has_leaf_values`: whether that was done since an action last changed the
    state.

    Drivers: `drivers`: all that may control entities. `has_fixed_driver` (E): whether the user chose the driver, so
    that the file cannot change it. `seeds`: of random numbers, by scenario.

    Results: `errors`: by scenario. `notices`: sentences on deviations from the file, without full stop, each once.
    `compiled`: the calls to kernels, once the run is prepared.
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
    compiled: CompiledWorld

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
        """Yield each track that an entity follows in some scenarios of a mask: number, track, and these scenarios."""
        for number, track in enumerate(self.tracks[entity]):
            rows = np.flatnonzero(where & (self.track[entity] == number))
            if rows.size:
                yield number, track, rows

    def entities_of_type(self, object_type: str) -> list[int]:
        """Return the rows of all entities of an ``ObjectType``."""
        types = {"pedestrian": "pedestrian", "misc": "miscellaneous"}
        return [e for e, entity in enumerate(self.entities) if types.get(entity.kind, "vehicle") == object_type]

    def update_overlaps(self) -> None:
        """Update which bounding boxes overlap."""
        for a, b in combinations(range(len(self.entities)), 2):
            self.overlapping[a, b] = self.overlapping[b, a] = self.compiled.find_overlaps(a, b)

    def box_corners(self) -> FloatArray:
        """Return the corners of all bounding boxes in m, shape (E, N, 4, 2)."""
        boxes = np.array([(entity.center_x, entity.length, entity.width) for entity in self.entities])
        center_x, length, width = boxes.T[:, :, None]
        x, y = self.x + center_x * np.cos(self.heading), self.y + center_x * np.sin(self.heading)
        return box_corners(x, y, self.heading, length, width)

    def fail(self, where: BoolArray, reason: str | SimulationError) -> None:
        """End the scenarios of a mask with an error."""
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
        """Note that `subject` at `location` (file and line) is not run as written, but as `reason` says."""
        first = np.flatnonzero(where & self.running)
        sentence = f"{label}: {subject} ({location}): {reason}"
        if first.size and not any(notice.startswith(f"{sentence}; ") for notice in self.notices):
            self.notices[f"{sentence}; first at {self.time[first[0]]:.6g} s"] = None

    def update_leaf_values(self) -> None:
        """Evaluate the leaves of all conditions, unless they are up to date."""
        if not self.has_leaf_values:
            self.evaluate_leaves()
            self.has_leaf_values = True

    def set_speed(self, entity: int, where: BoolArray, speed: FloatArray) -> None:
        """Set an entity's speed (or the target speed of its driver) in the scenarios of a mask."""
        self.target_speed[entity][where] = speed[where]
        undriven = where & ~self.driven[entity]
        self.speed[entity][undriven] = speed[undriven]
        self.decided[entity] |= where

    def assign_control(
        self, entity: int, where: BoolArray, driver: int | None = None, activated: bool | None = None
    ) -> None:
        """Assign a driver (-1 for none), or activate or deactivate it; an argument of None changes nothing."""
        if driver is not None:
            self.driver[entity][where] = driver
        if activated is not None:
            self.activated[entity][where] = activated
        self.driven[entity] = self.activated[entity] & (self.driver[entity] >= 0)
