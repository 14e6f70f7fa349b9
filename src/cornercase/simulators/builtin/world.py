"""State of all entities of all concrete scenarios of a batch.

Arrays are (entity, scenario), so that one entity's row is contiguous over the scenarios.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from cornercase._common.geometry import box_corners, boxes_overlap
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.roads import RoadNetwork
from cornercase.simulators.builtin.paths.tracks import FREE, LaneTrack, Pose, Track

LONGITUDINAL, LATERAL = "longitudinal", "lateral"

# Headings that differ by less, in rad, are the same.
_ALIGNED: Final = 1e-3

# From this far beside the middle of its lane on, in m, an entity's lane is looked up.
_BESIDE: Final = 1.0

# Who comes to the end of a road to this in m is at it.
_ON_END: Final = 1e-3

# A target further from a track, in m, is not on it.
_ASTRAY: Final = 20.0

if TYPE_CHECKING:
    from cornercase.simulators.builtin.actions.controller import Driving


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


class World:
    """State of E entities in N concrete scenarios.

    Attributes
    ----------
    time : float
        s; the same for all, since they run in lock-step.
    x, y, heading, speed, acceleration : ndarray of float64, shape (E, N)
    odometer : ndarray of float64, shape (E, N)
        Travelled distance in m, as the sum of chords.
    standing_since : ndarray of float64, shape (E, N)
        Time at which the entity came to rest; infinite while it moves.
    present : ndarray of bool, shape (E, N)
    running : ndarray of bool, shape (N,)
        Scenarios that have not ended.
    touching : ndarray of bool, shape (E, E, N)
        Which entities' boxes overlap, as of the last row.
    distance, offset : ndarray of float64, shape (E, N)
        Place along the entity's track, and to the left of it, in m.
    turn : ndarray of float64, shape (E, N)
        Heading relative to the track, in rad.
    turn_rate : ndarray of float64, shape (E, N)
        rad/s.
    frozen : ndarray of bool, shape (E, N)
        Whether the heading stays as it is wherever the track leads.
    sideways : ndarray of float64, shape (E, N)
        What of the coming step's way goes across the track, in m.
    pace : ndarray of float64, shape (E, N)
        Speed in m/s with which the coming step is made where an action decided that before the speed changed, or NaN.
    velocity : ndarray of float64, shape (E, N)
        What the last step covered, in m/s.
    moved : ndarray of bool, shape (E, N)
        Entities whose place at the end of the step an action has decided already.
    route : ndarray of int64, shape (E, N)
        Route that the entity was given, as index into `routes`.
    last_road : ndarray of int64, shape (E, N)
        Road on which an entity that follows no lane was when that was last asked, or -1.
    last_s : ndarray of float64, shape (E, N)
        Its s there, in m.
    at_end_since : ndarray of float64, shape (E, N)
        Time at which the entity came to the end of its road; infinite before.
    variables, parameters : dict of str to ndarray, each (N,)
        The file's variables, and its parameters as conditions see them, as numbers or as texts.
    signals : dict of str to ndarray, each (N,)
        States of the traffic signals that were switched, as texts.
    selections : dict of str to list of int
        Rows of the entities of each selection.
    actor : int or None
        Row of the entity for which a position is being resolved.
    target_speed : ndarray of float64, shape (E, N)
        What speed actions ask of an entity; infinite where they ask nothing.
    drivers : list of Driving
        All that may be in charge of an entity.
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
    errors : dict of int to str
        Why scenarios failed.
    """

    def __init__(self, entities: tuple[Entity, ...], scenarios: int, network: RoadNetwork | None) -> None:
        shape = (len(entities), scenarios)
        self.entities = entities
        self.names = [entity.name for entity in entities]
        self.scenarios = scenarios
        self.network = network
        self.time = 0.0
        self.x, self.y, self.heading = (np.full(shape, np.nan) for _ in range(3))
        self.speed, self.acceleration, self.odometer = (np.zeros(shape) for _ in range(3))
        self.standing_since = np.zeros(shape)
        self.present = np.zeros(shape, dtype=np.bool_)
        self.running = np.ones(scenarios, dtype=np.bool_)
        self.touching = np.zeros((len(entities), *shape), dtype=np.bool_)
        self.distance, self.offset = np.zeros(shape), np.zeros(shape)
        self.target_speed = np.full(shape, np.inf)
        self.signals: dict[str, npt.NDArray[np.str_]] = {}
        self.drivers: list[Driving] = []
        self.driver = np.full(shape, -1)
        self.activated, self.driven = (np.zeros(shape, dtype=np.bool_) for _ in range(2))
        self.kept = [False] * len(entities)
        self.visible = np.ones(shape, dtype=np.bool_)
        self.tracks: list[list[Track]] = [[] for _ in entities]
        self.track = np.full(shape, FREE)
        self.turn, self.turn_rate, self.sideways, self.velocity = (np.zeros(shape) for _ in range(4))
        self.pace = np.full(shape, np.nan)
        self._from_x, self._from_y, self._from_heading = (np.full(shape, np.nan) for _ in range(3))
        self._gone = (np.zeros(shape), np.zeros(shape))
        self.frozen, self.moved = (np.zeros(shape, dtype=np.bool_) for _ in range(2))
        self.routes: list[tuple[tuple[int, int, float], ...]] = [()]
        self.route = np.zeros(shape, dtype=np.int64)
        self.at_end_since = np.full(shape, np.inf)
        self.last_road, self.last_s = np.full(shape, -1), np.zeros(shape)
        self.variables: dict[str, Any] = {}
        self.parameters: dict[str, Any] = {}
        self.selections: dict[str, list[int]] = {}
        self.actor: int | None = None
        self._lanes: dict[tuple[object, ...], LaneTrack | None] = {}
        self._dt = 0.0
        self.errors: dict[int, str] = {}
        self._owner = {domain: np.full(shape, -1) for domain in (LONGITUDINAL, LATERAL)}

    def fail(self, where: BoolArray, why: str) -> None:
        """End the scenarios of a mask with an error."""
        for i in np.flatnonzero(where & self.running):
            self.errors[int(i)] = why
        self.running &= ~where

    def claim(self, domain: str, entity: int, action: int, where: BoolArray) -> None:
        """Give an action the control of one of the entity's domains, and so end the one that had it."""
        self._owner[domain][entity][where] = action

    def controls(self, domain: str, entity: int, action: int) -> BoolArray:
        """Scenarios in which the action still has the control that it claimed, shape (N,)."""
        return np.asarray(self._owner[domain][entity] == action)

    def place(self, entity: int, pose: Pose, where: BoolArray) -> None:
        """Put an entity somewhere; from there it follows its lane, or its heading where there is none."""
        self.fail(
            where & ~np.isfinite(pose.x + pose.y + pose.heading),
            f"{self.names[entity]} is placed off the map",
        )
        where = where & self.running
        for state, value in ((self.x, pose.x), (self.y, pose.y), (self.heading, pose.heading)):
            state[entity][where] = value[where]
        # A jump is no way.
        self._from_x[entity][where], self._from_y[entity][where] = pose.x[where], pose.y[where]
        self.present[entity] |= where
        self.moved[entity] |= where & (self.time > 0.0)
        # Who follows a trajectory goes on with it.
        self.attach(entity, where & ((self.track[entity] == FREE) | self.on_lane(entity)), pose)

    def pull(self, entity: int, x: FloatArray, y: FloatArray, heading: FloatArray, speed: FloatArray) -> None:
        """Put an entity where somebody else has moved it in the coming step, each shape (N,), along its track."""
        every = np.arange(self.scenarios)
        self.x[entity], self.y[entity], self.heading[entity], self.speed[entity] = x, y, heading, speed
        self.moved[entity] = True
        for k, track in enumerate(self.tracks[entity]):
            at = every[(self.track[entity] == k) & self.running]
            if at.size:
                along = track.nearest(x[at], y[at], at, self.distance[entity][at])
                on_x, on_y, ahead = track.at(along, np.zeros(len(at)), at)
                self.distance[entity][at] = along
                self.offset[entity][at] = (y[at] - on_y) * np.cos(ahead) - (x[at] - on_x) * np.sin(ahead)
                self.turn[entity][at] = (heading[at] - ahead + np.pi) % (2 * np.pi) - np.pi

    def attach(self, entity: int, where: BoolArray, pose: Pose | None = None) -> None:
        """Make an entity follow the lane that it is on, the way that its heading points, where it is now."""
        self.track[entity][where] = FREE
        self.frozen[entity][where] = False
        if self.network is None:
            return
        if pose is None or pose.lane is None or pose.road is None:
            place = self.network.locate(self.x[entity], self.y[entity])
            pose = Pose(self.x[entity], self.y[entity], self.heading[entity], *place)
        assert pose.road is not None
        assert pose.s is not None
        assert pose.lane is not None
        assert pose.offset is not None
        road, section, along = self._direction(pose, where)
        route = self.route[entity]
        keys = np.stack([road, section, pose.lane, along, route])[:, where]
        for one in np.unique(keys, axis=1).T:
            rows = where & (np.stack([road, section, pose.lane, along, route]) == one[:, None]).all(axis=0)
            first = int(np.flatnonzero(rows)[0])
            track = self.lane_track(int(one[0]), int(one[2]), float(pose.s[first]), bool(one[3]), int(one[4]))
            if track is None:
                continue
            distance = np.zeros(self.scenarios)
            distance[rows] = track.distance_of(pose.s[rows])
            self.follow(entity, track, distance, rows)
            self.offset[entity][rows] = pose.offset[rows] if one[3] else -pose.offset[rows]
            _, _, ahead = track.at(distance[rows], np.zeros(int(rows.sum())), np.flatnonzero(rows))
            turn = (pose.heading[rows] - ahead + np.pi) % (2 * np.pi) - np.pi
            # Lines are sampled: a heading that differs this little is the lane's own.
            self.turn[entity][rows] = np.where(np.abs(turn) < _ALIGNED, 0.0, turn)

    def lane_track(self, road: int, lane: int, s: float, along: bool, route: int) -> LaneTrack | None:
        """Track along a lane and what follows it, the same object for the same lane; None where there is no lane."""
        assert self.network is not None
        section = int(self.network.roads[road].section_at(np.array([s]))[0])
        key = (road, section, lane, along, route)
        if key not in self._lanes:
            self._lanes[key] = LaneTrack.of_lane(self.network, road, lane, s, along, self.routes[route])
        return self._lanes[key]

    def change_lane(self, entity: int, lane: IntArray, where: BoolArray) -> BoolArray:
        """Make an entity follow another lane of its road from beside it; where that lane exists, shape (N,)."""
        assert self.network is not None
        pose = self.lane_of(entity)
        assert pose.s is not None
        road, section, along = self._direction(pose, where)
        route = self.route[entity]
        done = np.zeros_like(where)
        keys = np.stack([road, section, lane, along, route])
        for one in np.unique(keys[:, where], axis=1).T:
            rows = where & (keys == one[:, None]).all(axis=0)
            s = float(pose.s[int(np.flatnonzero(rows)[0])])
            track = self.lane_track(int(one[0]), int(one[2]), s, bool(one[3]), int(one[4]))
            if track is None:
                continue
            at = np.flatnonzero(rows)
            distance = np.zeros(self.scenarios)
            distance[at] = track.nearest(self.x[entity][at], self.y[entity][at], at)
            x, y, heading = track.at(distance[at], np.zeros(len(at)), at)
            self.follow(entity, track, distance, rows)
            dx, dy = self.x[entity][at] - x, self.y[entity][at] - y
            self.offset[entity][at] = dy * np.cos(heading) - dx * np.sin(heading)
            self.turn[entity][at] = 0.0
            self.frozen[entity][at] = False
            done |= rows
        return done

    def follow(self, entity: int, track: Track, distance: FloatArray, where: BoolArray) -> None:
        """Make an entity follow `track` from `distance` on."""
        tracks = self.tracks[entity]
        if track not in tracks:
            tracks.append(track)
        self.track[entity][where] = tracks.index(track)
        self.distance[entity][where] = distance[where]

    def assign_route(self, entity: int, roads: tuple[int, ...], where: BoolArray) -> None:
        """Make an entity pass roads, where it can, and go on as before where it is already on its way."""
        via = tuple((road, 0, 0.0) for road in roads)
        if via not in self.routes:
            self.routes.append(via)
        self.route[entity][where] = self.routes.index(via)
        onward = where & self.on_lane(entity)
        if onward.any():
            pose, turn, offset = self.lane_of(entity), self.turn[entity].copy(), self.offset[entity].copy()
            self.attach(entity, onward, pose)
            self.turn[entity][onward], self.offset[entity][onward] = turn[onward], offset[onward]

    def on_lane(self, entity: int) -> BoolArray:
        """Whether the entity follows a lane, shape (N,)."""
        result = np.zeros(self.scenarios, dtype=np.bool_)
        for k, track in enumerate(self.tracks[entity]):
            if isinstance(track, LaneTrack):
                result |= self.track[entity] == k
        return result

    def lane_of(self, entity: int) -> Pose:
        """Where an entity is on the roads."""
        pose = Pose(self.x[entity].copy(), self.y[entity].copy(), self.heading[entity].copy())
        if self.network is None:
            return pose
        place = self.network.locate(self.x[entity], self.y[entity])
        pose = Pose(pose.x, pose.y, pose.heading, *place)
        for k, track in enumerate(self.tracks[entity]):
            if isinstance(track, LaneTrack):
                # Who is far from the middle may be on another lane by now.
                near = np.abs(self.offset[entity]) < _BESIDE
                rows = np.flatnonzero((self.track[entity] == k) & near & self.present[entity])
                if rows.size:
                    pose = track.lane_pose(pose, rows, self.distance[entity][rows], self.offset[entity][rows])
        return pose

    def road_heading(self, pose: Pose) -> FloatArray:
        """Direction of the road's s at a pose, shape (N,)."""
        assert self.network is not None
        assert pose.road is not None
        assert pose.s is not None
        heading = np.zeros(self.scenarios)
        for road in np.unique(pose.road):
            rows = pose.road == road
            heading[rows] = self.network.roads[int(road)].reference(pose.s[rows])[2]
        return heading

    def remaining(self, entity: int, target: Pose, known: dict[int, FloatArray] | None = None) -> FloatArray:
        """Distance along the entity's track to a target, in m, shape (N,); negative once it is passed.

        Where the entity has no track that leads there it is the distance as the crow flies. For a target that stays
        where it is, `known` keeps its place on each track from one call to the next.
        """
        result = np.hypot(target.x - self.x[entity], target.y - self.y[entity])
        known = {} if known is None else known
        for k, track in enumerate(self.tracks[entity]):
            rows = np.flatnonzero(self.track[entity] == k)
            if rows.size:
                places = known.setdefault(k, np.full(self.scenarios, np.nan))
                new = rows[np.isnan(places[rows])]
                if new.size:
                    along = track.nearest(target.x[new], target.y[new], new, self.distance[entity][new])
                    x, y, _ = track.at(along, np.zeros(len(new)), new)
                    leads = np.hypot(x - target.x[new], y - target.y[new]) < _ASTRAY
                    places[new] = np.where(leads, along, np.inf)
                way = places[rows] - self.distance[entity][rows]
                result[rows] = np.where(np.isfinite(way), way, result[rows])
        return np.asarray(result)

    def ahead(self, entity: int, other: int) -> FloatArray:
        """How far ahead of an entity another is, between reference points along its heading, shape (N,)."""
        dx, dy = self.x[other] - self.x[entity], self.y[other] - self.y[entity]
        return np.asarray(dx * np.cos(self.heading[entity]) + dy * np.sin(self.heading[entity]))

    def beside(self, entity: int, other: int) -> FloatArray:
        """How far to the left of an entity another is, between reference points, shape (N,)."""
        dx, dy = self.x[other] - self.x[entity], self.y[other] - self.y[entity]
        return np.asarray(dy * np.cos(self.heading[entity]) - dx * np.sin(self.heading[entity]))

    def extent(self, entity: int, other: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Least and largest coordinate of another's box ahead of and to the left of an entity's centre, each (N,)."""
        corners = self.corners()[other]
        one = self.entities[entity]
        cos, sin = np.cos(self.heading[entity]), np.sin(self.heading[entity])
        x = corners[..., 0] - (self.x[entity] + one.center_x * cos)[:, None]
        y = corners[..., 1] - (self.y[entity] + one.center_x * sin)[:, None]
        along, across = x * cos[:, None] + y * sin[:, None], y * cos[:, None] - x * sin[:, None]
        return along.min(axis=1), along.max(axis=1), across.min(axis=1), across.max(axis=1)

    def longitudinal_gap(self, entity: int, other: int) -> FloatArray:
        """Signed free space to another's box along an entity's heading, 0 where they are abreast, shape (N,)."""
        near, far, _, _ = self.extent(entity, other)
        half = 0.5 * self.entities[entity].length
        return np.where(near > half, near - half, np.where(far < -half, far + half, 0.0))

    def lateral_gap(self, entity: int, other: int) -> FloatArray:
        """Signed free space to another's box across an entity's heading, positive to the left, shape (N,)."""
        _, _, near, far = self.extent(entity, other)
        half = 0.5 * self.entities[entity].width
        return np.where(near > half, near - half, np.where(far < -half, far + half, 0.0))

    def longitudinal_reach(self, entity: int, other: int) -> tuple[float, float]:
        """What of a distance between reference points two boxes fill, with the other ahead and with it behind."""
        one, two = self.entities[entity], self.entities[other]
        fronts = [0.5 * box.length + box.center_x for box in (one, two)]
        rears = [0.5 * box.length - box.center_x for box in (one, two)]
        return fronts[0] + rears[1], rears[0] + fronts[1]

    def on_road(self, entity: int) -> BoolArray:
        """Whether an entity's reference point lies within the width of a road, shape (N,)."""
        assert self.network is not None
        place = self.network.locate(self.x[entity], self.y[entity])
        width = np.zeros(self.scenarios)
        for road, lane in sorted({*zip(place.road.tolist(), place.lane.tolist(), strict=True)}):
            rows = (place.road == road) & (place.lane == lane)
            one = self.network.roads[road]
            section = one.section_at(place.s[rows])
            width[rows] = [
                float(one.width(int(k), lane, place.s[rows][i : i + 1])[0]) for i, k in enumerate(section.tolist())
            ]
        return np.asarray(np.abs(place.offset) <= 0.5 * width + 1e-6)

    def lanes_between(self, one: Pose, two: Pose) -> IntArray:
        """How many lanes further to the left of a pose another is, as it drives, shape (N,)."""
        assert one.lane is not None
        assert two.lane is not None
        # There is no lane 0.
        apart = two.lane - one.lane
        crossing = np.sign(one.lane) != np.sign(two.lane)
        apart = apart - np.where(crossing, np.sign(apart), 0)
        return np.asarray(apart * np.where(np.cos(one.heading - self.road_heading(one)) > -1e-6, 1, -1))

    def has_lane_between(self, pose: Pose, first: int, last: int, opposite: bool) -> BoolArray:
        """Whether a drivable lane lies within a range of lanes from a pose, shape (N,)."""
        assert self.network is not None
        assert pose.road is not None
        assert pose.lane is not None
        assert pose.s is not None
        result = np.zeros(self.scenarios, dtype=np.bool_)
        for road in np.unique(pose.road):
            rows = np.flatnonzero(pose.road == road)
            one = self.network.roads[int(road)]
            for k in np.unique(section := one.section_at(pose.s[rows])):
                at = rows[section == k]
                lane = pose.lane[at]
                for number, other in one.sections[int(k)][1].items():
                    there = (number >= lane + first) & (number <= lane + last) & other.drivable
                    result[at] |= there & (opposite | (np.sign(number) == np.sign(lane)))
        return result

    def offset_from(self, entity: int, other: int) -> FloatArray:
        """Offset that another entity would have from this one's track, shape (N,); positive to the left."""
        result = self.beside(entity, other) + self.offset[entity]
        for k, track in enumerate(self.tracks[entity]):
            rows = np.flatnonzero((self.track[entity] == k) & self.present[other])
            if rows.size:
                x, y = self.x[other][rows], self.y[other][rows]
                along = track.nearest(x, y, rows)
                at_x, at_y, heading = track.at(along, np.zeros(len(rows)), rows)
                result[rows] = (y - at_y) * np.cos(heading) - (x - at_x) * np.sin(heading)
        return np.asarray(result)

    def speed_along_road(self, entity: int, where: BoolArray) -> FloatArray:
        """Speed along the road that an entity is on, without sign, in m/s, shape (N,).

        Off a lane it is that of the last step as it was gone, which on a bend is a chord.
        """
        speed = np.abs(self.speed[entity] * np.cos(np.where(where, self.turn[entity], 0.0)))
        at = np.flatnonzero(where & ~self.on_lane(entity))
        if self.network is not None and at.size:
            x, y, heading = self.x[entity][at], self.y[entity][at], self.heading[entity][at]
            road, s = self.network.road_from(self.last_road[entity][at], self.last_s[entity][at], x, y, heading)
            self.last_road[entity][at], self.last_s[entity][at] = road, s
            for one in np.unique(road):
                mine = road == one
                direction = self.network.roads[int(one)].reference(s[mine])[2]
                gone_x, gone_y = self._gone[0][entity][at[mine]], self._gone[1][entity][at[mine]]
                speed[at[mine]] = np.abs(gone_x * np.cos(direction) + gone_y * np.sin(direction))
        return np.asarray(speed)

    def lateral_speed(self, entity: int) -> FloatArray:
        """Speed across the entity's track in m/s, shape (N,); positive to the left."""
        return np.asarray(self.speed[entity] * np.sin(self.turn[entity]))

    def set_speed(self, entity: int, where: BoolArray, speed: FloatArray) -> None:
        """Give an entity a speed in the scenarios of the mask, or tell its driver to want it."""
        self.target_speed[entity][where] = speed[where]
        own = where & ~self.driven[entity]
        self.speed[entity][own] = speed[own]

    def control(self, entity: int, where: BoolArray, driver: int | None = None, activated: bool | None = None) -> None:
        """Assign a driver (-1 for none) or activate control along the way; None leaves it as it is."""
        if driver is not None:
            self.driver[entity][where] = driver
        if activated is not None:
            self.activated[entity][where] = activated
        self.driven[entity] = self.activated[entity] & (self.driver[entity] >= 0)

    def move(self, dt: float) -> None:
        """Advance every entity by one time step with its present speed, then the clock."""
        before_heading, self._dt = self._from_heading, dt
        for e in range(len(self.entities)):
            rows = self.running & self.present[e]
            way = np.where(np.isnan(self.pace[e]), self.speed[e], self.pace[e]) * dt
            way = np.sign(way) * np.sqrt(np.maximum(way**2 - self.sideways[e] ** 2, 0.0))
            way = np.where(rows & ~self.moved[e], way, 0.0)
            for k, track in enumerate(self.tracks[e]):
                at = np.flatnonzero(rows & ~self.moved[e] & (self.track[e] == k))
                if at.size:
                    self._advance(e, track, at, way[at])
            free = rows & (self.track[e] == FREE)
            if not free.any():
                continue
            # Who has come to the end of a trajectory and has no road to go on by stops.
            lost = free & self.frozen[e] & ~self.moved[e]
            self.speed[e][lost], way = 0.0, np.where(lost, 0.0, way)
            self.x[e] += np.where(free, way * np.cos(self.heading[e]), 0.0)
            self.y[e] += np.where(free, way * np.sin(self.heading[e]), 0.0)
        gone_x, gone_y = self.x - self._from_x, self.y - self._from_y
        chord = np.hypot(gone_x, gone_y)
        if dt > 0:
            self._gone = (gone_x / dt, gone_y / dt)
            chord = np.where(np.isfinite(chord), chord, 0.0)
            self.odometer += chord
            self.velocity = chord / dt
        self.time += dt
        self._from_x, self._from_y, self._from_heading = self.x.copy(), self.y.copy(), self.heading.copy()
        self.moved[:] = False
        self.pace[:] = np.nan
        self.sideways[:] = 0.0
        if dt > 0:
            self.turn_rate = ((self.heading - before_heading + np.pi) % (2 * np.pi) - np.pi) / dt
        moving = np.abs(self.speed) > 1e-6
        self.standing_since = np.where(moving, np.inf, np.minimum(self.standing_since, self.time))

    def settle(self, entity: int, where: BoolArray) -> None:
        """Put an entity where its place on its track is, before the step ends."""
        for k, track in enumerate(self.tracks[entity]):
            at = np.flatnonzero(where & (self.track[entity] == k))
            if at.size:
                self._advance(entity, track, at, np.zeros(at.size))

    def _advance(self, e: int, track: Track, at: IntArray, way: FloatArray) -> None:
        offset = self.offset[e][at]
        if isinstance(track, LaneTrack) and offset.any():
            # Who goes beside the line on the inside of a bend gets on faster along it.
            way = way / np.maximum(1.0 - track.curvature(self.distance[e][at], at) * offset, 0.1)
        distance = self.distance[e][at] + way
        if isinstance(track, LaneTrack):
            over = (distance >= track.length - _ON_END) | ((distance <= _ON_END) & (way < 0.0))
            distance = np.clip(distance, 0.0, track.length)
            # Who still wants to go on from there stops, as in esmini with the second step.
            late = self.at_end_since[e][at] < self.time - 1.5 * self._dt
            self.speed[e][at[over & late & np.isnan(self.pace[e][at])]] = 0.0
            self.at_end_since[e][at] = np.where(over, np.minimum(self.at_end_since[e][at], self.time), np.inf)
        self.distance[e][at] = distance
        x, y, heading = track.at(distance, offset, at)
        self.x[e][at], self.y[e][at] = x, y
        self.heading[e][at] = np.where(self.frozen[e][at], self.heading[e][at], heading + self.turn[e][at])

    def corners(self) -> FloatArray:
        """Corners of all boxes, shape (E, N, 4, 2)."""
        ahead = np.array([[entity.center_x] for entity in self.entities])
        length = np.array([[entity.length] for entity in self.entities])
        width = np.array([[entity.width] for entity in self.entities])
        x = self.x + ahead * np.cos(self.heading)
        y = self.y + ahead * np.sin(self.heading)
        return box_corners(x, y, self.heading, length, width)

    def find_contacts(self) -> None:
        """Update which boxes overlap."""
        ahead = np.array([[entity.center_x] for entity in self.entities])
        x = np.where(self.present, self.x + ahead * np.cos(self.heading), np.nan)
        y = np.where(self.present, self.y + ahead * np.sin(self.heading), np.nan)
        reach = [0.5 * float(np.hypot(entity.length, entity.width)) for entity in self.entities]
        corners = None
        for a in range(len(self.entities)):
            for b in range(a + 1, len(self.entities)):
                gap = np.hypot(x[a] - x[b], y[a] - y[b])
                near = np.flatnonzero(gap <= reach[a] + reach[b])
                self.touching[a, b] = False
                if near.size:
                    corners = self.corners() if corners is None else corners
                    self.touching[a, b, near] = boxes_overlap(corners[a][near], corners[b][near])
                self.touching[b, a] = self.touching[a, b]

    def _direction(self, pose: Pose, where: BoolArray) -> tuple[IntArray, IntArray, BoolArray]:
        """Road, lane section, and whether the heading points along s, each (N,)."""
        assert self.network is not None
        assert pose.road is not None
        assert pose.s is not None
        section = np.zeros(self.scenarios, dtype=np.int64)
        along = np.zeros(self.scenarios, dtype=np.bool_)
        for road in np.unique(pose.road[where]):
            rows = where & (pose.road == road)
            one = self.network.roads[int(road)]
            section[rows] = one.section_at(pose.s[rows])
            along[rows] = np.cos(pose.heading[rows] - one.reference(pose.s[rows])[2]) > -1e-6
        return pose.road, section, along
