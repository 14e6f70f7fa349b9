"""The action that makes an entity arrive at a target when another entity, the master, arrives at a second target."""

from __future__ import annotations

import numpy as np
from lxml import etree

from cornercase._common.typing import BoolArray
from cornercase.scenario._scope import Scope
from cornercase.simulators.builtin.actions._action import CompiledAction
from cornercase.simulators.builtin.actions._longitudinal import require_child
from cornercase.simulators.builtin.kernels._action_table import SYNCHRONIZE_ACTION
from cornercase.simulators.builtin.kernels._synchronize import (
    ABSOLUTE_FINAL_SPEED,
    FINAL_SPEED_DIFFERENCE,
    FINAL_SPEED_FACTOR,
    NO_FINAL_SPEED,
    NOT_STARTED,
)
from cornercase.simulators.builtin.paths._positions import read_entity_index, read_position
from cornercase.simulators.builtin.tracks._track import Pose
from cornercase.simulators.builtin.world._entity_distances import locate_target_on_track
from cornercase.simulators.builtin.world._road_position import locate_on_road
from cornercase.simulators.builtin.world._world import LONGITUDINAL, World


class SynchronizeAction(CompiledAction):
    """Action that makes an entity reach a target when another entity, the master, reaches a second target.

    Without a final speed, the acceleration is constant. With a final speed, two phases of constant acceleration end at
    the target with that speed; the entity stops in between rather than driving backwards. With a steady state, the
    entity has the final speed already at a given distance or time before the target.
    """

    domains = (LONGITUDINAL,)
    # The kernels use the same order.
    memory_attributes = (
        "_mode", "_convex", "_last", "_last_master",
        "_x", "_y", "_road", "_s", "_track", "_place", "_tolerance",
        "_x_master", "_y_master", "_road_master", "_s_master", "_track_master", "_place_master", "_tolerance_master",
        "_steady_distance", "_steady_time", "_final", "_is_located",
    )  # fmt: skip

    def __init__(self, element: etree._Element, scope: Scope, world: World, entity: int) -> None:
        self._entity = entity
        self._master = read_entity_index(element, scope, world, "masterEntityRef")
        self._read_target_master = read_position(require_child(element, "TargetPositionMaster", scope), scope, world)
        self._read_target = read_position(require_child(element, "TargetPosition", scope), scope, world)
        self._tolerance = scope.read_numbers(element, "targetTolerance", 0.0)
        self._tolerance_master = scope.read_numbers(element, "targetToleranceMaster", 0.0)
        n = scope.n_scenarios
        self._final, self._final_speed_kind = np.zeros(n), NO_FINAL_SPEED
        self._steady_distance, self._steady_time = np.zeros(n), np.zeros(n)
        final = element.find("FinalSpeed")
        inner = None if final is None else final.find("*")
        if inner is not None:
            self._read_final(inner, scope)
        self._is_located = np.zeros(n)
        self._mode, self._convex = np.full(n, float(NOT_STARTED)), np.zeros(n)
        self._last, self._last_master = np.full(n, np.inf), np.full(n, np.inf)
        self._x, self._y, self._road, self._s = (np.full(n, np.nan) for _ in range(4))
        self._x_master, self._y_master, self._road_master, self._s_master = (np.full(n, np.nan) for _ in range(4))
        self._track, self._place, self._track_master, self._place_master = (np.full(n, np.nan) for _ in range(4))

    def kernel_options(self) -> tuple[int, ...]:
        return SYNCHRONIZE_ACTION, self._entity, self._master, self._final_speed_kind

    def _read_final(self, element: etree._Element, scope: Scope) -> None:
        if element.tag == "AbsoluteSpeed":
            self._final, self._final_speed_kind = scope.read_numbers(element, "value"), ABSOLUTE_FINAL_SPEED
        elif element.tag == "RelativeSpeedToMaster":
            self._final = scope.read_numbers(element, "value")
            factor = scope.read_text(element, "speedTargetValueType", "delta") == "factor"
            self._final_speed_kind = FINAL_SPEED_FACTOR if factor else FINAL_SPEED_DIFFERENCE
        else:
            raise scope.error_at(
                element, "<FinalSpeed> holds neither an <AbsoluteSpeed> nor a <RelativeSpeedToMaster>."
            )
        distance, time = element.find("TargetDistanceSteadyState"), element.find("TargetTimeSteadyState")
        if distance is not None:
            self._steady_distance = scope.read_numbers(distance, "distance")
        if time is not None:
            name = "time_gap" if time.get("time_gap") is not None else "time"
            self._steady_time = scope.read_numbers(time, name)

    def start(self, world: World, where: BoolArray) -> None:
        target, master = self._read_target(world), self._read_target_master(world)
        self._x[where], self._y[where] = target.x[where], target.y[where]
        self._x_master[where], self._y_master[where] = master.x[where], master.y[where]
        if world.network is not None:
            self._road[where], _, self._s[where], _ = world.network.locate(target.x[where], target.y[where])
            self._road_master[where], _, self._s_master[where], _ = world.network.locate(
                master.x[where], master.y[where]
            )
        self._place[where] = self._place_master[where] = np.nan
        self._mode[where] = NOT_STARTED
        self._last[where] = self._last_master[where] = np.inf

    def look_up_positions_now(self, world: World, where: BoolArray) -> None:
        self.look_up_positions(world, where)
        self._is_located[where] = 1.0

    def look_up_positions(self, world: World, where: BoolArray) -> None:
        target = Pose(self._x, self._y, np.zeros(world.scenarios), road=self._road, s=self._s)
        master = Pose(self._x_master, self._y_master, target.heading, road=self._road_master, s=self._s_master)
        locate_target_on_track(world, self._entity, target, self._track, self._place, where)
        locate_target_on_track(world, self._master, master, self._track_master, self._place_master, where)
        for entity in (self._entity, self._master):
            locate_on_road(world, entity, where)
