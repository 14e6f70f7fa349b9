"""The action that follows a trajectory."""

from __future__ import annotations

from typing import Final

import numpy as np
from lxml import etree

from cornercase._common.typing import BoolArray, FloatArray
from cornercase.scenario._scope import Scope
from cornercase.simulators.builtin.actions._action import Action
from cornercase.simulators.builtin.kernels._action_table import TRAJECTORY_ACTION
from cornercase.simulators.builtin.paths._positions import read_position
from cornercase.simulators.builtin.paths._trajectory_shapes import TimeConversion, has_times, read_trajectory
from cornercase.simulators.builtin.tracks._track import NO_TRACK, Trajectory
from cornercase.simulators.builtin.world._lane_following import attach_to_lane, follow_track
from cornercase.simulators.builtin.world._track_motion import update_pose_on_track
from cornercase.simulators.builtin.world._world import LATERAL, LONGITUDINAL, World

# Tolerance of distances and times in m and s.
_TINY: Final = 1e-6
# A larger lateral gap to a sampled lane, in m, exists in the road file too.
_LANE_TOLERANCE: Final = 0.01


class FollowTrajectoryAction(Action):
    """Moves an entity along a trajectory, at its own speed or at given times."""

    domains: tuple[str, ...] = (LATERAL,)
    memory_attributes = ("_sign", "_was_oriented", "_ahead")

    def __init__(self, element: etree._Element, scope: Scope, world: World, entity: int) -> None:
        self._entity = entity
        holder = element.find("TrajectoryRef")
        self._shape = read_trajectory(element if holder is None else holder, scope, world, read_position)
        mode = element.find("TrajectoryFollowingMode")
        reference = element.find("TimeReference")
        timing_element = None if reference is None else next(reference.iterchildren("*"), None)
        timing = timing_element if timing_element is not None and timing_element.tag == "Timing" else None
        self._smooth = mode is None or scope.read_text(mode, "followingMode", "follow") == "follow"
        self._absolute = False
        self._clock: TimeConversion | None = None
        # Constant times are ignored.
        if timing is not None and has_times(element if holder is None else holder, scope):
            self._absolute = scope.read_text(timing, "domainAbsoluteRelative", "relative") == "absolute"
            self._clock = TimeConversion(
                scope.read_numbers(timing, "scale", 1.0), scope.read_numbers(timing, "offset", 0.0)
            )
            self.domains = (LATERAL, LONGITUDINAL)
            self.has_own_timing = True
        self._skip = scope.read_numbers(element, "initialDistanceOffset", 0.0)
        # Time of the trajectory's clock at simulation time 0.
        self._ahead = np.zeros(scope.n_scenarios)
        self._track: Trajectory | None = None
        # -1 if the entity points against the line, so that driving forwards leads back along it.
        self._sign = np.ones(scope.n_scenarios)
        self._was_oriented = np.zeros(scope.n_scenarios)

    def kernel_options(self) -> tuple[int, ...]:
        return TRAJECTORY_ACTION, self._entity, self._clock is not None

    def start(self, world: World, where: BoolArray) -> None:
        e, scenarios = self._entity, np.arange(world.scenarios)
        track = self._shape(world, self._smooth, self._clock, e)
        # All scenarios share one track, as each step loops over an entity's tracks.
        if self._track is None:
            self._track = track
        else:
            self._track.copy_rows_from(track, where)
            track = self._track
        world.present[e] |= where
        follow_track(world, e, track, self._skip, where)
        world.offset[e][where] = world.turn[e][where] = 0.0
        world.stranded[e][where] = False
        x, y, heading = track.pose_at(self._skip, np.zeros(world.scenarios), scenarios)
        line, oriented = track.direction_at(self._skip, scenarios), track.has_heading_at(self._skip, scenarios)
        backwards = world.speed[e] < 0.0
        if track.times is not None:
            decreases = (np.diff(track.times) < -_TINY).any(axis=1)
            world.fail(where & decreases, f"the times of a trajectory of {world.names[e]} must not decrease")
        if self._clock is not None:
            clock, speed = track.time_and_speed_at(self._skip)
            clock_offset = np.zeros_like(clock) if self._absolute else clock - self._clock.shift - world.time
            self._ahead[where] = clock_offset[where]
            backwards = oriented & _is_opposite_heading(heading, line)
            world.speed[e][where] = np.where(backwards, -speed, speed)[where]
        # Without a prescribed heading, an entity that drives backwards is turned around.
        heading = np.where(oriented, heading, line + np.where(backwards, np.pi, 0.0))
        is_reversed = _is_opposite_heading(heading, line) & ~(oriented & world.entities[e].slides)
        self._sign[where] = np.where(is_reversed, -1.0, 1.0)[where]
        self._was_oriented[where] = oriented[where]
        world.x[e][where], world.y[e][where], world.heading[e][where] = x[where], y[where], heading[where]

    def step(self, world: World, dt: float, where: BoolArray) -> BoolArray:
        track = self._track
        if track is None:
            return np.zeros_like(where)
        arrived = (
            self._follow_at_own_speed(world, track, dt, where)
            if self._clock is None
            else self._follow_at_times(world, track, dt, where)
        )
        return np.asarray(where & arrived)

    def release(self, world: World, where: BoolArray) -> None:
        attach_to_lane(world, self._entity, where)

    def _follow_at_times(self, world: World, track: Trajectory, dt: float, rows: BoolArray) -> BoolArray:
        e, before = self._entity, world.distance[self._entity].copy()
        assert track.times is not None
        time, last = world.time + dt + self._ahead, track.times[:, -1]
        is_over = rows & (time > last - _TINY)
        distance = track.distance_at_time(time)
        if dt > 0:
            # An entity that points against the line drives backwards.
            against = _is_opposite_heading(world.heading[e], track.direction_at(before, np.arange(world.scenarios)))
            signed_speed = (
                np.where(distance < before, -1.0, 1.0) * np.where(against, -1.0, 1.0) * np.abs(distance - before) / dt
            )
            moves = rows & (time < last + _TINY)
            world.speed[e][moves] = signed_speed[moves]
        self._move_to_distance(world, track, distance, rows)
        if is_over.any():
            self._continue_beyond_end(world, track, (time - last) * world.speed[e], is_over)
        return is_over

    def _follow_at_own_speed(self, world: World, track: Trajectory, dt: float, rows: BoolArray) -> BoolArray:
        e, before = self._entity, world.distance[self._entity].copy()
        step = world.speed[e] * self._sign * dt
        distance = np.clip(before + step, 0.0, track.lengths)
        self._move_to_distance(world, track, distance, rows)
        reached = rows & (distance > track.lengths - _TINY) & (step > 0)
        at_start = rows & (distance < _TINY) & (step < 0)
        if (reached | at_start).any():
            # At the start, the rest of the step is dropped, as in esmini.
            remaining = np.where(reached, np.maximum(np.abs(step) - np.abs(distance - before), 0.0), 0.0)
            self._continue_beyond_end(world, track, remaining, reached | at_start)
        return np.asarray(reached | at_start)

    def _move_to_distance(self, world: World, track: Trajectory, distance: FloatArray, rows: BoolArray) -> None:
        """Move the entity to a distance along the trajectory, with the heading there."""
        e, scenarios = self._entity, np.arange(world.scenarios)
        oriented = track.has_heading_at(distance, scenarios)
        loses_heading = rows & ~oriented & (self._was_oriented > 0.0)
        if loses_heading.any():
            # From here on the line determines the heading: keep the current direction.
            heading = track.pose_at(distance, np.zeros(world.scenarios), scenarios)[2]
            against = _is_opposite_heading(heading, track.direction_at(distance, scenarios))
            self._sign[loses_heading] = np.where(against, -1.0, 1.0)[loses_heading]
        self._was_oriented[rows] = oriented[rows]
        world.turn[e][rows] = np.where(oriented | (self._sign > 0.0), 0.0, np.pi)[rows]
        world.distance[e][rows] = distance[rows]
        world.moved[e] |= rows
        update_pose_on_track(world, e, rows)

    def _continue_beyond_end(self, world: World, track: Trajectory, remaining: FloatArray, where: BoolArray) -> None:
        """Move the rest of the step beyond the trajectory's end, then follow the road at the same relative heading."""
        e, rows = self._entity, np.flatnonzero(where)
        heading = world.heading[e][rows] - world.turn[e][rows]
        world.x[e][rows] += remaining[rows] * np.cos(heading)
        world.y[e][rows] += remaining[rows] * np.sin(heading)
        attach_to_lane(world, e, where)
        for _, lane, at in world.iter_followed_tracks(e, where):
            # If roads have a small gap, the shift onto the lane does not count as motion.
            x, y, _ = lane.pose_at(world.distance[e][at], world.offset[e][at], at)
            dx, dy = x - world.x[e][at], y - world.y[e][at]
            has_gap = np.hypot(dx, dy) > _LANE_TOLERANCE
            for state, shift in ((world.x, dx), (world.y, dy), (world.from_x, dx), (world.from_y, dy)):
                state[e][at] += np.where(has_gap, shift, 0.0)
        world.stranded[e][where] = (world.track[e] == NO_TRACK)[where]


def _is_opposite_heading(heading: FloatArray, line_heading: FloatArray) -> BoolArray:
    """Check whether a heading points backwards along a line."""
    return np.asarray(np.cos(heading - line_heading) < -_TINY)
