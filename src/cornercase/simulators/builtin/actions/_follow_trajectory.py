"""The action that makes an entity follow a trajectory."""

from __future__ import annotations

from typing import Final

import numpy as np
from lxml import etree

from cornercase._common.typing import BoolArray, FloatArray
from cornercase.scenario._scope import Scope
from cornercase.simulators.builtin.actions._action import CompiledAction
from cornercase.simulators.builtin.kernels._action_table import TRAJECTORY_ACTION
from cornercase.simulators.builtin.paths._positions import read_position
from cornercase.simulators.builtin.paths._trajectory_shapes import TimeConversion, has_times, read_trajectory
from cornercase.simulators.builtin.tracks._track import NO_TRACK, Trajectory
from cornercase.simulators.builtin.world._lane_following import attach_to_lane, follow_track
from cornercase.simulators.builtin.world._world import LATERAL, LONGITUDINAL, World

# Tolerance of distances and times in m and s.
_TINY: Final = 1e-6
# A larger lateral gap to a sampled lane, in m, exists in the road file too.
_LANE_TOLERANCE: Final = 0.01


class FollowTrajectoryAction(CompiledAction):
    """Action that moves an entity along a trajectory, at the entity's own speed or at given times."""

    domains: tuple[str, ...] = (LATERAL,)
    memory_attributes = ("_sign", "_was_oriented", "_ahead", "_number")

    def __init__(self, element: etree._Element, scope: Scope, world: World, entity: int) -> None:
        self._entity = entity
        holder = element.find("TrajectoryRef")
        self._shape = read_trajectory(element if holder is None else holder, scope, world, read_position)
        mode = element.find("TrajectoryFollowingMode")
        reference = element.find("TimeReference")
        timing_element = None if reference is None else reference.find("*")
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
        # Number among the tracks of the entity.
        self._number = np.zeros(scope.n_scenarios)

    def kernel_options(self) -> tuple[int, ...]:
        return TRAJECTORY_ACTION, self._entity, self._clock is not None

    def start(self, world: World, where: BoolArray) -> None:
        e, scenarios = self._entity, np.arange(world.scenarios)
        track = self._shape(world, self._smooth, self._clock, e)
        # All scenarios share one track, as each step loops over an entity's tracks.
        if self._track is None:
            self._track = track
        else:
            self._track.copy_scenarios_from(track, where)
            track = self._track
        world.present[e] |= where
        follow_track(world, e, track, self._skip, where)
        self._number[where] = world.track[e][where]
        world.offset[e][where] = world.turn[e][where] = 0.0
        world.stranded[e][where] = False
        points = track.evaluate(self._skip, np.zeros(world.scenarios), scenarios)
        x, y, heading, line, oriented, clock, speed, _ = points
        backwards = world.speed[e] < 0.0
        if track.times is not None:
            decreases = (np.diff(track.times) < -_TINY).any(axis=1)
            world.fail(where & decreases, f"the times of a trajectory of {world.names[e]} must not decrease")
        if self._clock is not None:
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

    def release(self, world: World, where: BoolArray) -> None:
        attach_to_lane(world, self._entity, where, may_move=False)

    def leave_track(self, world: World, where: BoolArray) -> None:
        """Make the entity follow the road beyond the trajectory; its heading relative to the road stays the same."""
        e = self._entity
        attach_to_lane(world, e, where, may_move=False)
        for _, lane, at in world.iter_followed_tracks(e, where):
            # If roads have a small gap, the shift onto the lane does not count as motion.
            x, y, _ = lane.pose_at(world.distance[e][at], world.offset[e][at], at)
            dx, dy = x - world.x[e][at], y - world.y[e][at]
            has_gap = np.hypot(dx, dy) > _LANE_TOLERANCE
            for state, shift in ((world.x, dx), (world.y, dy), (world.from_x, dx), (world.from_y, dy)):
                state[e][at] += np.where(has_gap, shift, 0.0)
        world.stranded[e][where] = (world.track[e] == NO_TRACK)[where]


def _is_opposite_heading(heading: FloatArray, line_heading: FloatArray) -> BoolArray:
    return np.asarray(np.cos(heading - line_heading) < -_TINY)
