"""State of all entities of all concrete scenarios of a batch.

Arrays are (entity, scenario), so that one entity's row is contiguous over the scenarios.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
from lxml import etree

from cornercase._common.errors import SimulationError
from cornercase._common.ledger import Label
from cornercase._common.parts import format_instant
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.roads import RoadNetwork
from cornercase.scenario import Scope
from cornercase.simulators.builtin.tracks.lane import LaneTrack
from cornercase.simulators.builtin.tracks.track import Track
from cornercase.simulators.builtin.world.layout import (
    FLAGS,
    FLOATS,
    GONE_X,
    GONE_Y,
    NUMBERS,
    PULL_X,
    PULL_Y,
    ROWS_OF_FLOATS,
)
from cornercase.simulators.builtin.world.signals import SignalController

LONGITUDINAL, LATERAL = "longitudinal", "lateral"


class Decision(Protocol):
    """Decides the speed of an entity while in charge of it."""

    def step(self, dt: float) -> None:
        """Decide the entity's speed at the end of the coming time step."""
        ...


@dataclass(frozen=True)
class Entity:
    """What does not change about an entity.

    Attributes
    ----------
    name : str
    kind : str
        Vehicle category, ``"pedestrian"`` or ``"misc"``.
    length, width, center_x : float
        Bounding box in m.
    max_speed, max_acceleration, max_deceleration : float
        m/s, m/s², m/s²; infinite where the file sets no limit.
    slides : bool
        Whether it goes along trajectories whatever heading they give it.
    turning : str
        Where its heading turns along a polyline, if its properties say so: one of `ALONG_LEGS`, `AT_CORNERS` and
        `AT_VERTICES`; else empty, and the following mode decides.
    body : tuple of (lxml element, Scope) or None
        Where it stands in the file, and what its parameters are there.
    """

    name: str
    kind: str
    length: float
    width: float
    center_x: float
    max_speed: float
    max_acceleration: float
    max_deceleration: float
    slides: bool = False
    turning: str = ""
    body: tuple[etree._Element, Scope] | None = field(default=None, repr=False, compare=False)


@dataclass(frozen=True)
class Tow:
    """A vehicle and what it pulls, or may come to pull.

    Attributes
    ----------
    vehicle, trailer : int
        Rows of the entities.
    hitch : float
        Where the trailer hangs on the vehicle, ahead of the vehicle's reference point, in m.
    coupler : float
        How far ahead of the trailer's reference point that is, in m.
    """

    vehicle: int
    trailer: int
    hitch: float
    coupler: float


class World:
    """State of E entities in N concrete scenarios.

    Attributes
    ----------
    time : ndarray of float64, shape (N,)
        s; each scenario has a clock of its own.
    x, y, heading, speed, acceleration : ndarray of float64, shape (E, N)
    odometer : ndarray of float64, shape (E, N)
        Travelled distance in m, as the sum of chords.
    standing_since : ndarray of float64, shape (E, N)
        Time at which the entity came to rest; infinite while it moves.
    present : ndarray of bool, shape (E, N)
    running : ndarray of bool, shape (N,)
        Scenarios that take part in the present frame.
    touching : ndarray of bool, shape (E, E, N)
        Which entities' boxes overlap, as of the last row.
    distance, offset : ndarray of float64, shape (E, N)
        Place along the entity's track, and to the left of it, in m.
    changes_lanes : ndarray of bool, shape (E, N)
        Entities on their way from lane to lane, whose `offset` is that from the new one.
    turn : ndarray of float64, shape (E, N)
        Heading relative to the track, in rad.
    stranded : ndarray of bool, shape (E, N)
        Entities whose trajectory has ended where no road goes on.
    sideways : ndarray of float64, shape (E, N)
        What of the coming step's way goes across the track, in m.
    pace : ndarray of float64, shape (E, N)
        Speed in m/s with which the coming step is made where an action decided that before the speed changed, or NaN.
    velocity : ndarray of float64, shape (E, N)
        What the last step covered, in m/s.
    moved : ndarray of bool, shape (E, N)
        Entities whose place at the end of the step an action has decided already.
    decided : ndarray of bool, shape (E, N)
        Entities whose speed in the coming step is set, if to that which they have.
    route : ndarray of int64, shape (E, N)
        Route that the entity was given, as index into `routes`.
    last_road : ndarray of int64, shape (E, N)
        Road on which an entity that follows no lane was when that was last asked, or -1.
    last_s : ndarray of float64, shape (E, N)
        Its s there, in m.
    road_speed : ndarray of float64, shape (E, N)
        Speed along its road in m/s that was looked up for the coming frame, or `UNASKED`.
    at_end_since : ndarray of float64, shape (E, N)
        Time at which the entity came to the end of its road; infinite before.
    watches_roads : bool
        Whether a condition asks for entities beside the road.
    off_road_since : ndarray of float64, shape (E, N)
        Time at which the entity left the road, where that is watched; infinite on it.
    variables, parameters : dict of str to ndarray, each (N,)
        The file's variables, and its parameters as conditions see them, as numbers or as texts.
    signals : dict of str to ndarray, each (N,)
        States of the traffic signals that were switched, as texts.
    signal_controllers : dict of str to SignalController
        By name.
    selections : dict of str to list of int
        Rows of the entities of each selection.
    actor : int or None
        Row of the entity for which a position is being resolved.
    target_speed : ndarray of float64, shape (E, N)
        What speed actions ask of an entity; infinite where they ask nothing.
    drivers : list of Decision
        Everybody who may be in charge of an entity.
    driver : ndarray of int64, shape (E, N)
        Which of them is assigned to the entity; -1 for none.
    activated : ndarray of bool, shape (E, N)
        Whether the controller of the entity may act along its way.
    driven : ndarray of bool, shape (E, N)
        Whether a driver is in charge: it is told what speed to want, and decides.
    kept : list of bool, length E
        Whether the driver was chosen by who runs the file, which the file cannot change.
    visible : ndarray of bool, shape (E, N)
        Whether others in the traffic can see the entity.
    from_x, from_y, from_heading : ndarray of float64, shape (E, N)
        Where the entity was when the last step ended.
    gone : tuple of two ndarray of float64, each (E, N)
        Velocity along x and y, in m/s, as the last step covered it.
    pull : tuple of two ndarray of float64, each (E, N)
        Change of that velocity in the last step, in m/s².
    jumped : ndarray of bool, shape (E, N)
        Entities that were put somewhere in this step.
    stirred : ndarray of bool, shape (N,)
        Scenarios in whose storyboard something has changed in the present frame.
    begun : bool
        Whether the first frame, in which nothing moves, is over.
    last_step : ndarray of float64, shape (N,)
        Length of the last time step in s.
    before : ndarray of float64, shape (E, N)
        Speed in m/s with which the frame began.
    floats, flags, numbers : ndarray, each (N, K, E)
        The tables that hold all of this; rows are named in `layout`. The arrays above are views of them, to be written
        to and never replaced.
    overlaps : ndarray of bool, shape (N, E, E)
        The table behind `touching`.
    tracks : list of list of Track
        By entity, all that it has followed.
    pulled_by : ndarray of int64, shape (E, N)
        Row of the entity that pulls this one, or -1.
    track : ndarray of int64, shape (E, N)
        Which of them it follows, or `FREE`.
    routes : list of tuple
        All routes that were assigned, each as (road, lane, s) of what it passes.
    lane_tracks : dict
        Tracks along lanes, by where they begin, so that the same lane is the same object.
    acting : str or None
        Line and name of the action that acts, which failures meanwhile name, with the instant.
    errors : dict of int to SimulationError
        Why scenarios failed.
    remarks : dict of str to None
        Sentences on what is not as the file says, each once, without a full stop.
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
    road_speed: FloatArray
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
    track: IntArray
    route: IntArray
    last_road: IntArray
    driver: IntArray
    pulled_by: IntArray

    def __init__(
        self,
        entities: tuple[Entity, ...],
        scenarios: int,
        network: RoadNetwork | None,
        tows: tuple[Tow, ...] = (),
    ) -> None:
        self.entities, self.tows = entities, tows
        self.names = [entity.name for entity in entities]
        self.scenarios = scenarios
        self.network = network
        self.time, self.last_step = np.zeros(scenarios), np.zeros(scenarios)
        self.running = np.ones(scenarios, dtype=np.bool_)
        self.stirred = np.zeros(scenarios, dtype=np.bool_)
        self.begun = False
        self.floats = np.zeros((scenarios, ROWS_OF_FLOATS, len(entities)))
        self.flags = np.zeros((scenarios, len(FLAGS), len(entities)), dtype=np.bool_)
        self.numbers = np.zeros((scenarios, len(NUMBERS), len(entities)), dtype=np.int64)
        for table, rows in ((self.floats, FLOATS), (self.flags, FLAGS), (self.numbers, NUMBERS)):
            for name, (row, value) in rows.items():
                table[:, row] = value
                setattr(self, name, table[:, row].T)
        self.gone = (self.floats[:, GONE_X].T, self.floats[:, GONE_Y].T)
        self.pull = (self.floats[:, PULL_X].T, self.floats[:, PULL_Y].T)
        self.overlaps = np.zeros((scenarios, len(entities), len(entities)), dtype=np.bool_)
        self.touching = self.overlaps.transpose(1, 2, 0)
        self.signals: dict[str, npt.NDArray[np.str_]] = {}
        self.signal_controllers: dict[str, SignalController] = {}
        self.drivers: list[Decision] = []
        self.kept = [False] * len(entities)
        self.tracks: list[list[Track]] = [[] for _ in entities]
        self.routes: list[tuple[tuple[int, int, float], ...]] = [()]
        self.watches_roads = False
        self.variables: dict[str, Any] = {}
        self.parameters: dict[str, Any] = {}
        self.selections: dict[str, list[int]] = {}
        self.actor: int | None = None
        self.lane_tracks: dict[tuple[object, ...], LaneTrack | None] = {}
        self.errors: dict[int, SimulationError] = {}
        self.acting: str | None = None
        self.remarks: dict[str, None] = {}
        for tow in tows:
            self.pulled_by[tow.trailer] = tow.vehicle

    def followed(self, entity: int, where: BoolArray) -> Iterator[tuple[int, Track, IntArray]]:
        """Tracks that an entity follows in scenarios of the mask: number, track, and in which of them."""
        for number, track in enumerate(self.tracks[entity]):
            rows = np.flatnonzero(where & (self.track[entity] == number))
            if rows.size:
                yield number, track, rows

    def fail(self, where: BoolArray, why: str | SimulationError) -> None:
        """End the scenarios of a mask with an error."""
        for i in np.flatnonzero(where & self.running).tolist():
            if isinstance(why, SimulationError):
                self.errors[i] = why
            else:
                acting = "" if self.acting is None else f"{self.acting}: "
                instant = "" if self.acting is None else format_instant(float(self.time[i]))
                self.errors[i] = SimulationError(f"{acting}{why}{instant}")
        self.running &= ~where

    def remark(self, place: str, what: str, why: str, where: BoolArray) -> None:
        """Note that something is read other than it stands in the file, in the scenarios of a mask.

        Parameters
        ----------
        place : str
            File and line.
        what : str
            The part of the file.
        why : str
            What happens instead.
        where : ndarray of bool, shape (N,)
        """
        first = np.flatnonzero(where & self.running)
        sentence = f"{Label.ADAPTED}: {what} ({place}): {why}"
        if first.size and not any(one.startswith(f"{sentence}; ") for one in self.remarks):
            self.remarks[f"{sentence}; first at {self.time[first[0]]:.6g} s"] = None

    def set_speed(self, entity: int, where: BoolArray, speed: FloatArray) -> None:
        """Give an entity a speed in the scenarios of the mask, or tell its driver to want it."""
        self.target_speed[entity][where] = speed[where]
        own = where & ~self.driven[entity]
        self.speed[entity][own] = speed[own]
        self.decided[entity] |= where

    def control(self, entity: int, where: BoolArray, driver: int | None = None, activated: bool | None = None) -> None:
        """Assign a driver (-1 for none) or activate control along the way; None leaves it as it is."""
        if driver is not None:
            self.driver[entity][where] = driver
        if activated is not None:
            self.activated[entity][where] = activated
        self.driven[entity] = self.activated[entity] & (self.driver[entity] >= 0)
