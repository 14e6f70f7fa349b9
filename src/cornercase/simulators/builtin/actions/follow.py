"""Following a trajectory."""

from __future__ import annotations

import numpy as np
from lxml import etree

from cornercase._common.typing import BoolArray, FloatArray
from cornercase.scenario import Scope
from cornercase.simulators.builtin.paths.positions import read_position
from cornercase.simulators.builtin.paths.trajectory_shapes import read_trajectory
from cornercase.simulators.builtin.tracks.track import Trajectory
from cornercase.simulators.builtin.world.lanes import attach_to_lane, follow_track
from cornercase.simulators.builtin.world.motion import settle_on_track
from cornercase.simulators.builtin.world.state import LATERAL, LONGITUDINAL, World


class FollowTrajectoryAction:
    """Moves an entity along a trajectory, at its own speed or at given times."""

    def __init__(self, element: etree._Element, scope: Scope, world: World, entity: int) -> None:
        self._entity, self._id = entity, world.number_action()
        holder = element.find("TrajectoryRef")
        self._shape = read_trajectory(element if holder is None else holder, scope, world, read_position)
        mode = element.find("TrajectoryFollowingMode")
        self._smooth = mode is not None and scope.text(mode, "followingMode", "position") == "follow"
        reference = element.find("TimeReference")
        kind = None if reference is None else next(reference.iterchildren("*"), None)
        timing = kind if kind is not None and kind.tag == "Timing" else None
        self._absolute = False
        self._scale: FloatArray | None = None
        self._shift: FloatArray | None = None
        if timing is not None:
            self._absolute = scope.text(timing, "domainAbsoluteRelative", "relative") == "absolute"
            self._scale, self._shift = scope.number(timing, "scale", 1.0), scope.number(timing, "offset", 0.0)
        self._skip = scope.number(element, "initialDistanceOffset", 0.0)
        self._since = np.zeros(scope.scenarios)
        self._track: Trajectory | None = None
        # 1 where driving forwards leads along the trajectory, -1 where against it.
        self._sign = np.ones(scope.scenarios)

    def start(self, world: World, where: BoolArray) -> None:
        e, rows = self._entity, np.flatnonzero(where)
        track = self._shape(world, self._smooth, self._scale, self._shift, e)
        # All scenarios share one track, whenever each starts it, since each step loops over an entity's tracks.
        if self._track is None:
            self._track = track
        else:
            self._track.adopt(track, where)
            track = self._track
        world.claim(LATERAL, e, self._id, where)
        if self._scale is not None:
            world.claim(LONGITUDINAL, e, self._id, where)
        world.present[e] |= where
        follow_track(world, e, track, self._skip, where)
        world.offset[e][where] = world.turn[e][where] = 0.0
        world.frozen[e][where] = False
        self._since[where] = 0.0 if self._absolute else world.time
        x, y, heading = track.at(self._skip[rows], np.zeros(len(rows)), rows)
        against = np.cos(heading - track.direction(self._skip[rows], rows)) < -1e-6
        against &= not world.entities[e].slides
        if self._scale is None:
            # An entity that drives backwards is turned round, unless the file gives its heading.
            back = (world.speed[e][rows] < 0) & ~track.oriented(self._skip[rows], rows)
            world.turn[e][rows[back]] = np.pi
            heading = heading + np.where(back, np.pi, 0.0)
            against = against | back
        else:
            speed = track.distance_at(world.time - self._since)[1][rows]
            turned = against & track.oriented(self._skip[rows], rows)
            world.speed[e][rows] = np.where(turned, -speed, speed)
        self._sign[rows] = np.where(against, -1.0, 1.0)
        if world.time == 0.0:
            world.x[e][where], world.y[e][where], world.heading[e][where] = x, y, heading

    def step(self, world: World, dt: float, where: BoolArray) -> BoolArray:
        e = self._entity
        acting = where & world.controls(LATERAL, e, self._id)
        track = self._track
        if track is None or not acting.any():
            return np.asarray(where & ~acting)
        timed = acting & world.controls(LONGITUDINAL, e, self._id) & (self._scale is not None)
        arrived = np.zeros_like(where)
        if timed.any():
            arrived |= self._keep_time(world, track, dt, timed)
        if (acting & ~timed).any():
            arrived |= self._go(world, track, dt, acting & ~timed)
        return np.asarray(where & (arrived | ~acting))

    def _keep_time(self, world: World, track: Trajectory, dt: float, rows: BoolArray) -> BoolArray:
        e = self._entity
        time = world.time + dt - self._since
        along, speed = track.distance_at(time)
        assert track.time is not None
        if dt > 0:
            speed = (along - world.distance[e]) / dt
        # A heading against the trajectory means driving backwards.
        heading = world.heading[e]
        every = np.arange(world.scenarios)
        backwards = np.cos(heading - track.direction(along, every)) < -1e-6
        backwards &= track.oriented(along, every)
        over = rows & (time > track.time[:, -1] - 1e-6)
        going = rows & ~(over & (time > track.time[:, -1] + 1e-6))
        world.speed[e][going] = np.where(backwards, -speed, speed)[going]
        world.distance[e][rows] = along[rows]
        world.moved[e] |= rows
        settle_on_track(world, e, rows)
        if over.any():
            rest = np.maximum(time - track.time[:, -1], 0.0) * np.abs(world.speed[e])
            self._leave(world, track, track.lengths, rest, over)
        return over

    def _go(self, world: World, track: Trajectory, dt: float, rows: BoolArray) -> BoolArray:
        e = self._entity
        way = world.speed[e] * self._sign * dt
        distance = world.distance[e] + way
        reached = rows & (distance > track.lengths - 1e-6) & (way > 0)
        begun = rows & (distance < 1e-6) & (way < 0)
        world.distance[e][rows] = distance[rows]
        world.moved[e] |= rows
        settle_on_track(world, e, rows)
        if reached.any():
            self._leave(world, track, track.lengths, distance - track.lengths, reached)
        if begun.any():
            self._leave(world, track, np.zeros(world.scenarios), np.maximum(-distance, 0.0), begun)
        return np.asarray(reached | begun)

    def _leave(self, world: World, track: Trajectory, end: FloatArray, beyond: FloatArray, where: BoolArray) -> None:
        """Go the rest of the step straight on, and from there along the road, with the heading kept."""
        e, rows = self._entity, np.flatnonzero(where)
        x, y, heading = track.at(end[rows], np.zeros(len(rows)), rows)
        heading = heading + world.turn[e][rows]
        x, y = x + beyond[rows] * np.cos(heading), y + beyond[rows] * np.sin(heading)
        world.x[e][rows], world.y[e][rows], world.heading[e][rows] = x, y, heading
        world.moved[e] |= where
        attach_to_lane(world, e, where)
        world.frozen[e][where] = True
