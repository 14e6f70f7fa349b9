"""Actions that move an entity across its lane."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from lxml import etree

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.scenario._scope import Scope
from cornercase.simulators.builtin.actions._action import Action, CompiledAction
from cornercase.simulators.builtin.actions._longitudinal import read_dynamic_limit, read_target, require_child
from cornercase.simulators.builtin.kernels._action_table import DYNAMICS_SHAPES, LANE_CHANGE_ACTION, LANE_OFFSET_ACTION
from cornercase.simulators.builtin.paths._positions import read_entity_index, shift_lane
from cornercase.simulators.builtin.paths._transition_dynamics import (
    TransitionDynamics,
    check_dynamics_shape,
    duration_at_peak_acceleration,
)
from cornercase.simulators.builtin.world._entity_distances import offset_of_entity
from cornercase.simulators.builtin.world._lane_following import attach_to_lane, switch_to_lane_track
from cornercase.simulators.builtin.world._road_position import is_heading_along_road, road_pose
from cornercase.simulators.builtin.world._track_motion import update_pose_on_track
from cornercase.simulators.builtin.world._world import LATERAL, World

# m/s²; esmini's default for lane offsets.
_DEFAULT_ACCELERATION: Final = 0.5

# m; tolerance of a lateral distance.
_DISTANCE_TOLERANCE: Final = 0.01


class LaneChangeAction(CompiledAction):
    """Action that moves an entity to another lane; the lateral motion reduces the entity's speed along the lane."""

    domains = (LATERAL,)
    memory_attributes = ("_from", "_to", "_done", "_extent")

    def __init__(self, element: etree._Element, scope: Scope, world: World, entity: int) -> None:
        self._entity = entity
        self._location = f"{Path(scope.file_name).name}, line {element.sourceline}"
        self._transition = TransitionDynamics(require_child(element, "LaneChangeActionDynamics", scope), scope)
        target, self._reference = read_target(element, "LaneChangeTarget", "TargetLane", scope, world)
        self._value = scope.read_integer(target, "value")
        self._target_offset = scope.read_numbers(element, "targetLaneOffset", 0.0)
        n = scope.n_scenarios
        self._from, self._to, self._done, self._extent = (np.zeros(n) for _ in range(4))

    def kernel_options(self) -> tuple[int, ...]:
        return LANE_CHANGE_ACTION, self._entity, *self._transition.kernel_options

    def start(self, world: World, where: BoolArray) -> None:
        e = self._entity
        if world.network is None:
            world.fail(where, f"{world.names[e]} cannot change lanes, as there are no roads")
            return
        lane = self._target_lanes(world)
        exists = switch_to_lane_track(world, e, lane, where)
        if not exists[where].all():
            # Ends in its own lane, as in esmini (which jumps sideways first).
            self._keep_own_lane(world, where & ~exists)
        pose = road_pose(world, e)
        forward = np.where(is_heading_along_road(world, pose), 1.0, -1.0)
        self._from[where] = world.offset[e][where]
        self._to[where] = (forward * self._target_offset)[where]
        self._extent[where] = self._transition.lateral_extent(self._from, self._to)[where]
        self._done[where] = 0.0
        # With a route it counts as being on the new lane from the start.
        world.changes_lanes[e][where] = (world.route[e] == 0)[where]
        # It starts parallel to its lane, whatever its previous heading.
        world.turn[e][where] = 0.0
        update_pose_on_track(world, e, where)

    def release(self, world: World, where: BoolArray) -> None:
        """Make the entity follow its present lane; an entity with a route follows the target lane instead."""
        world.changes_lanes[self._entity][where] = False
        attach_to_lane(world, self._entity, where & (world.route[self._entity] == 0))

    def _keep_own_lane(self, world: World, where: BoolArray) -> None:
        """Make the entity's present lane the target lane, in the scenarios of a mask."""
        e, own_lane = self._entity, road_pose(world, self._entity).road_coordinates()[1]
        why = f"{world.names[e]} is to change to a lane that does not exist, and stays in its own lane"
        world.add_notice(self._location, "<LaneChangeAction>", why, where)
        stays = switch_to_lane_track(world, e, own_lane, where)
        world.fail(where & ~stays, f"{world.names[e]} cannot change lanes, as it is in none ({self._location})")

    def _target_lanes(self, world: World) -> IntArray:
        if self._reference is None:
            return np.full(world.scenarios, self._value)
        pose = road_pose(world, self._reference)
        forward = np.where(is_heading_along_road(world, pose), 1, -1)
        return shift_lane(pose.road_coordinates()[1], self._value * forward)


class LaneOffsetAction(CompiledAction):
    """Action that moves an entity sideways within its lane, without reducing the speed along the lane."""

    domains = (LATERAL,)
    memory_attributes = ("_from", "_to", "_elapsed", "_duration")

    def __init__(self, element: etree._Element, scope: Scope, world: World, entity: int) -> None:
        self._entity = entity
        dynamics = require_child(element, "LaneOffsetActionDynamics", scope)
        self._shape = scope.read_text(dynamics, "dynamicsShape")
        check_dynamics_shape(self._shape, dynamics, scope)
        self._max_acceleration = scope.read_numbers(dynamics, "maxLateralAcc", _DEFAULT_ACCELERATION)
        scope.mark_invalid(dynamics, "maxLateralAcc", "is below 0", self._max_acceleration < 0.0)
        target, self._reference = read_target(element, "LaneOffsetTarget", "TargetLaneOffset", scope, world)
        self._value = scope.read_numbers(target, "value")
        n = scope.n_scenarios
        self._from, self._to, self._elapsed, self._duration = (np.zeros(n) for _ in range(4))

    def kernel_options(self) -> tuple[int, ...]:
        return LANE_OFFSET_ACTION, self._entity, DYNAMICS_SHAPES.index(self._shape)

    def start(self, world: World, where: BoolArray) -> None:
        e = self._entity
        self._from[where] = world.offset[e][where]
        if world.network is None:
            target = self._value
        elif self._reference is None:
            pose = road_pose(world, e)
            target = np.where(is_heading_along_road(world, pose), self._value, -self._value)
        else:
            # Left is relative to the reference entity.
            pose = road_pose(world, e)
            along = is_heading_along_road(world, replace(pose, heading=world.heading[e] - world.turn[e]))
            same_direction = is_heading_along_road(world, road_pose(world, self._reference)) == along
            side = np.where(same_direction, self._value, -self._value)
            target = offset_of_entity(world, e, self._reference) + side
        self._to[where] = target[where]
        self._duration[where] = duration_at_peak_acceleration(
            self._shape, self._to - self._from, self._max_acceleration
        )[where]
        self._elapsed[where] = 0.0


class LateralDistanceAction(Action):
    """Action that keeps a lateral distance to another entity."""

    domains = (LATERAL,)

    def __init__(self, element: etree._Element, scope: Scope, world: World, entity: int) -> None:
        self._entity = entity
        self._other = read_entity_index(element, scope, world)
        self._continuous = scope.read_boolean(element, "continuous", False)
        side = -1.0 if scope.read_text(element, "displacement", "any") == "rightToReferencedEntity" else 1.0
        distance = np.abs(scope.read_numbers(element, "distance", 0.0))
        if scope.read_boolean(element, "freespace", False):
            distance = distance + 0.5 * (world.entities[entity].width + world.entities[self._other].width)
        self._target_distance = side * distance
        limits = element.find("DynamicConstraints")
        n = scope.n_scenarios
        self._max_acceleration, self._max_speed, self._max_jerk = (
            read_dynamic_limit(limits, name, np.inf, scope)
            for name in ("maxAcceleration", "maxSpeed", "maxAccelerationRate")
        )
        self._speed, self._acceleration = np.zeros(n), np.zeros(n)
        self._is_first_frame = np.zeros(n, dtype=np.bool_)

    def start(self, world: World, where: BoolArray) -> None:
        self._is_first_frame[where] = True
        self._speed[where] = self._acceleration[where] = 0.0

    def step(self, world: World, dt: float, where: BoolArray) -> BoolArray:
        e = self._entity
        # No motion in the first frame.
        moves = where & ~self._is_first_frame & (dt > 0)
        self._is_first_frame[where] = False
        error = self._target_distance - (world.offset[e] - offset_of_entity(world, e, self._other))
        reached = moves & (np.abs(error) < _DISTANCE_TOLERANCE)
        lateral_speed = self._lateral_speed(world, error, dt, moves)
        rigid = np.isinf(self._max_acceleration) & np.isinf(self._max_speed)
        shift = np.where(rigid, error, lateral_speed * dt)
        longitudinal = np.sqrt(np.maximum((world.speed[e] * dt) ** 2 - np.where(rigid, 0.0, shift) ** 2, 0.0))
        world.offset[e][moves] += shift[moves]
        world.sideways[e][moves] = np.where(rigid, 0.0, np.abs(shift))[moves]
        world.pace[e][moves] = world.speed[e][moves]
        world.turn[e][moves] = np.arctan2(shift, np.maximum(longitudinal, 1e-9))[moves]
        return np.asarray(where & reached & (not self._continuous))

    def _lateral_speed(self, world: World, error: FloatArray, dt: float, moves: BoolArray) -> FloatArray:
        """Return the lateral speed in m/s for the coming time step, one value per scenario."""
        fastest = np.maximum(np.minimum(self._max_speed, np.abs(world.speed[self._entity])) - 1e-6, 0.0)
        springy = np.isfinite(self._max_acceleration)
        stiffness = 0.4 * np.where(springy, self._max_acceleration, 0.0)
        # As in esmini, the other's speed across its own heading, which is almost 0 in a lane change.
        heading = world.heading[self._other]
        other_lateral_speed = world.step_velocity[1][self._other] * np.cos(heading) - world.step_velocity[0][
            self._other
        ] * np.sin(heading)
        acceleration = stiffness * error - 2.0 * np.sqrt(stiffness) * (self._speed - other_lateral_speed)
        step = np.where(np.isfinite(self._max_jerk), self._max_jerk * dt, np.inf)
        acceleration = self._acceleration + np.clip(acceleration - self._acceleration, -step, step)
        acceleration = np.clip(acceleration, -self._max_acceleration, self._max_acceleration)
        sprung = np.clip(self._speed + acceleration * dt, -fastest, fastest)
        constant_speed = np.sign(error) * fastest
        if dt > 0:
            constant_speed = np.where(np.abs(constant_speed) * dt > np.abs(error), error / dt, constant_speed)
        self._acceleration[moves & springy] = acceleration[moves & springy]
        self._speed[moves] = np.where(springy, sprung, constant_speed)[moves]
        return self._speed
