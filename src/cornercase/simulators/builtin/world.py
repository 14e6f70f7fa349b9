"""State of all entities of all concrete scenarios of a batch.

Arrays are (entity, scenario), so that one entity's row is contiguous over the scenarios.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cornercase.geometry import box_corners, boxes_overlap
from cornercase.scenario.opendrive import RoadNetwork
from cornercase.simulators.builtin.tracks import FREE, LaneTrack, Pose, Track
from cornercase.typing import BoolArray, FloatArray, IntArray

LONGITUDINAL, LATERAL = "longitudinal", "lateral"


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
    """

    name: str
    kind: str
    length: float
    width: float
    center_x: float
    max_speed: float
    max_acceleration: float
    max_deceleration: float


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
    target_speed : ndarray of float64, shape (E, N)
        What speed actions ask of an entity with a driver; infinite where they ask nothing.
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
        self.driven = np.zeros(len(entities), dtype=np.bool_)
        self.tracks: list[list[Track]] = [[] for _ in entities]
        self.track = np.full(shape, FREE)
        self.timed = np.zeros(shape, dtype=np.bool_)
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
        self.present[entity] |= where
        self.track[entity][where] = FREE
        if self.network is not None and pose.lane is not None and pose.road is not None:
            for road, lane in sorted({*zip(pose.road[where].tolist(), pose.lane[where].tolist(), strict=True)}):
                rows = where & (pose.road == road) & (pose.lane == lane)
                self._follow_lane(entity, road, lane, pose, rows)

    def follow(self, entity: int, track: Track, distance: FloatArray, where: BoolArray) -> None:
        """Make an entity follow `track` from `distance` on."""
        tracks = self.tracks[entity]
        if track not in tracks:
            tracks.append(track)
        self.track[entity][where] = tracks.index(track)
        self.distance[entity][where] = distance[where]

    def leave_track(self, entity: int, where: BoolArray) -> None:
        """Let an entity go straight on from where it is."""
        self.track[entity][where] = FREE

    def lane_of(self, entity: int) -> Pose:
        """Where an entity is on the roads."""
        pose = Pose(self.x[entity].copy(), self.y[entity].copy(), self.heading[entity].copy())
        if self.network is None:
            return pose
        place = self.network.locate(self.x[entity], self.y[entity])
        pose = Pose(pose.x, pose.y, pose.heading, place.road, place.lane, place.s, place.offset)
        for k, track in enumerate(self.tracks[entity]):
            rows = np.flatnonzero(self.track[entity] == k)
            if isinstance(track, LaneTrack) and rows.size:
                pose = track.lane_pose(pose, rows, self.distance[entity][rows], self.offset[entity][rows])
        return pose

    def remaining(self, entity: int, target: Pose) -> FloatArray:
        """Distance along the entity's track to a target, in m, shape (N,); negative once it is passed.

        Where the entity has no track it is the distance as the crow flies.
        """
        result = np.hypot(target.x - self.x[entity], target.y - self.y[entity])
        for k, track in enumerate(self.tracks[entity]):
            rows = np.flatnonzero(self.track[entity] == k)
            if rows.size:
                along = track.nearest(target.x[rows], target.y[rows], rows)
                result[rows] = along - self.distance[entity][rows]
        return np.asarray(result)

    def move(self, dt: float) -> None:
        """Advance every entity by one time step with its present speed, then the clock."""
        before_x, before_y = self.x.copy(), self.y.copy()
        for e in range(len(self.entities)):
            rows = self.running & self.present[e]
            step = np.where(rows & ~self.timed[e], self.speed[e] * dt, 0.0)
            self.distance[e] += step
            for k, track in enumerate(self.tracks[e]):
                at = np.flatnonzero(rows & (self.track[e] == k))
                if at.size:
                    self._clamp(e, track, at)
                    x, y, heading = track.at(self.distance[e][at], self.offset[e][at], at)
                    self.x[e][at], self.y[e][at], self.heading[e][at] = x, y, heading
            free = self.track[e] == FREE
            self.x[e] += np.where(free, step * np.cos(self.heading[e]), 0.0)
            self.y[e] += np.where(free, step * np.sin(self.heading[e]), 0.0)
        chord = np.hypot(self.x - before_x, self.y - before_y)
        if dt > 0:
            self.odometer += np.where(np.isfinite(chord), chord, 0.0)
        self.time += dt
        self.timed[:] = False
        moving = np.abs(self.speed) > 1e-6
        self.standing_since = np.where(moving, np.inf, np.minimum(self.standing_since, self.time))

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

    def _follow_lane(self, entity: int, road: int, lane: int, pose: Pose, where: BoolArray) -> None:
        assert self.network is not None
        assert pose.s is not None
        assert pose.offset is not None
        key = (road, lane)
        track = next((t for t in self.tracks[entity] if isinstance(t, LaneTrack) and t.key == key), None)
        track = track or LaneTrack.of_lane(self.network, road, lane)
        if track is None:
            return
        distance = track.distance_of(pose.s)
        where = where & track.agrees(distance, pose.heading)
        self.follow(entity, track, distance, where)
        self.offset[entity][where] = track.side * pose.offset[where]

    def _clamp(self, entity: int, track: Track, at: IntArray) -> None:
        if not track.ends:
            return
        over = at[self.distance[entity][at] >= track.length]
        self.distance[entity][over] = track.length
        self.speed[entity][over] = 0.0
