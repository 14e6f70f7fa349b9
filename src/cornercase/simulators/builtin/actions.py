"""What events do to entities, under a mask of the scenarios in which they happen."""

from __future__ import annotations

from collections.abc import Callable
from itertools import count
from typing import Final, Protocol

import numpy as np
from lxml import etree

from cornercase.errors import InputError
from cornercase.simulators.builtin.positions import Position, entity_index, read_position
from cornercase.simulators.builtin.scope import Scope
from cornercase.simulators.builtin.tracks import LaneTrack, Polyline
from cornercase.simulators.builtin.world import LATERAL, LONGITUDINAL, World
from cornercase.typing import BoolArray, FloatArray

# Actions that change nothing a criticality metric sees.
WITHOUT_EFFECT: Final = (
    "EnvironmentAction", "AppearanceAction", "InfrastructureAction", "VisibilityAction", "UserDefinedAction",
)  # fmt: skip

# The largest slope of a transition from 0 to 1 over unit time.
_PEAK: Final = {"linear": 1.0, "cubic": 1.5, "sinusoidal": 0.5 * np.pi, "step": 1.0}

_identities = count()


class Action(Protocol):
    """Something that runs in some of the scenarios until it says that it is done."""

    def start(self, world: World, where: BoolArray) -> None:
        """Begin in the scenarios of the mask."""
        ...

    def step(self, world: World, dt: float, where: BoolArray) -> BoolArray:
        """Act for one time step; return where it has ended, shape (N,)."""
        ...


def read_action(element: etree._Element, scope: Scope, world: World, entity: int | None) -> Action | None:
    """Read a ``PrivateAction`` or ``GlobalAction`` for one entity.

    Returns
    -------
    Action or None
        None for one that has no effect here.

    Raises
    ------
    InputError
        The action is not supported, or is malformed.
    """
    inner = next(iter(element.iterchildren("*")), None)
    while inner is not None and inner.tag in ("LongitudinalAction", "LateralAction", "RoutingAction"):
        inner = next(iter(inner.iterchildren("*")), None)
    if inner is None:
        raise InputError(f"{scope.source}, line {element.sourceline}: <{element.tag}> holds no action.")
    if inner.tag in WITHOUT_EFFECT or element.tag in WITHOUT_EFFECT:
        return None
    if inner.tag not in _READERS:
        raise InputError(
            f"{scope.source}, line {inner.sourceline}: <{inner.tag}> is not supported by the builtin simulator;"
            f" it runs {', '.join(_READERS)}."
        )
    if entity is None:
        raise InputError(f"{scope.source}, line {inner.sourceline}: <{inner.tag}> needs an entity that acts.")
    return _READERS[inner.tag](inner, scope, world, entity)


class TeleportAction:
    """Puts an entity somewhere at once."""

    def __init__(self, element: etree._Element, scope: Scope, world: World, entity: int) -> None:
        self._entity = entity
        self._position = read_position(_child(element, "Position", scope), scope, world)

    def start(self, world: World, where: BoolArray) -> None:
        world.place(self._entity, self._position(world), where)

    def step(self, world: World, dt: float, where: BoolArray) -> BoolArray:
        return where.copy()


class Transition:
    """A change from one value to another over time, with the shapes of ``TransitionDynamics``."""

    def __init__(self, element: etree._Element, scope: Scope) -> None:
        self.shape = scope.text(element, "dynamicsShape")
        self.dimension = scope.text(element, "dynamicsDimension", "time")
        self.value = scope.number(element, "value", 0.0)
        if self.shape not in _PEAK:
            raise InputError(
                f"{scope.source}, line {element.sourceline}: dynamicsShape '{self.shape}' is not"
                f" one of {', '.join(_PEAK)}."
            )
        if self.dimension not in ("time", "rate", "distance"):
            raise InputError(
                f"{scope.source}, line {element.sourceline}: dynamicsDimension '{self.dimension}' is not time, rate"
                " or distance."
            )

    def duration(self, start: FloatArray, end: FloatArray, steepest: FloatArray) -> FloatArray:
        """Time that the change takes, shape (N,), no slope being above `steepest`."""
        if self.shape == "step":
            return np.zeros_like(start)
        change, peak = np.abs(end - start), _PEAK[self.shape]
        with np.errstate(divide="ignore", invalid="ignore"):
            if self.dimension == "time":
                wanted = self.value
            elif self.dimension == "rate":
                wanted = np.where(change > 0, peak * change / np.abs(self.value), 0.0)
            else:
                wanted = np.where(np.abs(start + end) > 0, 2.0 * self.value / np.abs(start + end), 0.0)
            return np.maximum(wanted, np.where(np.isfinite(steepest), peak * change / steepest, 0.0))

    def at(self, part: FloatArray) -> FloatArray:
        """Share of the change that is done after a share of the time, shape (N,)."""
        part = np.clip(part, 0.0, 1.0)
        if self.shape == "cubic":
            return part * part * (3.0 - 2.0 * part)
        if self.shape == "sinusoidal":
            return np.asarray(0.5 - 0.5 * np.cos(np.pi * part))
        return part


class SpeedAction:
    """Brings an entity to a speed; for one with a driver, it says what speed the driver shall want."""

    def __init__(self, element: etree._Element, scope: Scope, world: World, entity: int) -> None:
        self._entity, self._id = entity, next(_identities)
        self._transition = Transition(_child(element, "SpeedActionDynamics", scope), scope)
        target = _child(element, "SpeedActionTarget", scope)
        absolute, relative = target.find("AbsoluteTargetSpeed"), target.find("RelativeTargetSpeed")
        self._reference: int | None = None
        if absolute is not None:
            self._value = scope.number(absolute, "value")
        elif relative is not None:
            self._reference = entity_index(relative, scope, world)
            self._value = scope.number(relative, "value")
            self._factor = scope.text(relative, "speedTargetValueType", "delta") == "factor"
            if scope.flag(relative, "continuous", False):
                raise InputError(
                    f"{scope.source}, line {relative.sourceline}: a continuous <RelativeTargetSpeed> is not supported"
                    " by the builtin simulator."
                )
        else:
            raise InputError(f"{scope.source}, line {element.sourceline}: <SpeedActionTarget> holds no target.")
        n = scope.scenarios
        self._from, self._to, self._elapsed, self._duration = (np.zeros(n) for _ in range(4))

    def start(self, world: World, where: BoolArray) -> None:
        e, entity = self._entity, world.entities[self._entity]
        world.claim(LONGITUDINAL, e, self._id, where)
        target = self._value
        if self._reference is not None:
            speed = world.speed[self._reference]
            target = speed * self._value if self._factor else speed + self._value
        target = np.clip(target, -entity.max_speed, entity.max_speed)
        start = world.speed[e]
        limit = np.where(np.abs(target) > np.abs(start), entity.max_acceleration, entity.max_deceleration)
        duration = self._transition.duration(start, target, limit)
        for state, value in ((self._from, start), (self._to, target), (self._duration, duration)):
            state[where] = value[where]
        self._elapsed[where] = 0.0

    def step(self, world: World, dt: float, where: BoolArray) -> BoolArray:
        e = self._entity
        acting = where & world.controls(LONGITUDINAL, e, self._id)
        self._elapsed[acting] += dt
        finished = self._elapsed >= self._duration - 1e-9
        part = self._elapsed / np.where(self._duration > 0, self._duration, 1.0)
        speed = np.where(finished, self._to, self._from + self._transition.at(part) * (self._to - self._from))
        if world.driven[e]:
            world.target_speed[e][acting] = speed[acting]
        if not world.driven[e] or world.time == 0.0:
            world.speed[e][acting] = speed[acting]
        return where & (finished | ~acting)


class AssignRouteAction:
    """Tells an entity which way to go at junctions."""

    def __init__(self, element: etree._Element, scope: Scope, world: World, entity: int) -> None:
        self._entity = entity
        route = _child(element, "Route", scope)
        self._waypoints: list[Position] = [
            read_position(_child(waypoint, "Position", scope), scope, world) for waypoint in route.iterfind("Waypoint")
        ]
        self._where = f"{scope.source}, line {element.sourceline}"

    def start(self, world: World, where: BoolArray) -> None:
        assert world.network is not None
        here = world.lane_of(self._entity)
        poses = [waypoint(world) for waypoint in self._waypoints]
        on_lane = where & (world.track[self._entity] >= 0)
        routes = np.stack(
            [here.road, here.lane, *(part for pose in poses for part in (pose.road, pose.lane))],  # type: ignore[list-item]
            axis=1,
        )
        # Scenarios that share their roads and lanes share the track; waypoints only choose exits.
        for roads in np.unique(routes[on_lane], axis=0):
            rows = on_lane & (routes == roads).all(axis=1)
            first = int(np.flatnonzero(rows)[0])
            via = tuple(
                (int(roads[2 + 2 * i]), int(roads[3 + 2 * i]), float(pose.s[first]))  # type: ignore[index]
                for i, pose in enumerate(poses)
            )
            track = LaneTrack.of_lane(world.network, int(roads[0]), int(roads[1]), via)
            if track is None:
                world.fail(rows, f"{world.names[self._entity]} cannot take its route from here")
                continue
            assert here.s is not None
            world.follow(self._entity, track, track.distance_of(here.s), rows)

    def step(self, world: World, dt: float, where: BoolArray) -> BoolArray:
        return where.copy()


class FollowTrajectoryAction:
    """Moves an entity along a polyline, at its own speed or at given times."""

    def __init__(self, element: etree._Element, scope: Scope, world: World, entity: int) -> None:
        self._entity, self._id = entity, next(_identities)
        trajectory = element.find("TrajectoryRef/Trajectory")
        trajectory = element.find("Trajectory") if trajectory is None else trajectory
        polyline = None if trajectory is None else trajectory.find("Shape/Polyline")
        if trajectory is None or polyline is None:
            raise InputError(
                f"{scope.source}, line {element.sourceline}: the builtin simulator follows trajectories with a"
                " <Polyline> that stand in the action itself."
            )
        vertices = list(polyline.iterfind("Vertex"))
        if len(vertices) < 2:
            raise InputError(f"{scope.source}, line {polyline.sourceline}: a <Polyline> needs at least two vertices.")
        self._vertices = [read_position(_child(v, "Position", scope), scope, world) for v in vertices]
        self._oriented = [
            v.find("Position//Orientation") is not None or next(v.iterfind("Position/*")).get("h") is not None
            for v in vertices
        ]
        self._times = np.stack([scope.number(v, "time", 0.0) for v in vertices], axis=1)
        timing = element.find("TimeReference/Timing")
        self._timed = timing is not None
        self._absolute = False
        if timing is not None:
            self._absolute = scope.text(timing, "domainAbsoluteRelative") == "absolute"
            self._times = self._times * scope.number(timing, "scale", 1.0)[:, None]
            self._times = self._times + scope.number(timing, "offset", 0.0)[:, None]
        self._skip = scope.number(element, "initialDistanceOffset", 0.0)
        self._since = np.zeros(scope.scenarios)
        self._track: Polyline | None = None

    def start(self, world: World, where: BoolArray) -> None:
        if self._track is None:
            poses = [vertex(world) for vertex in self._vertices]
            headings = [
                pose.heading if oriented else np.full_like(pose.heading, np.nan)
                for pose, oriented in zip(poses, self._oriented, strict=True)
            ]
            self._track = Polyline(
                np.stack([pose.x for pose in poses], axis=1),
                np.stack([pose.y for pose in poses], axis=1),
                np.stack(headings, axis=1),
                self._times if self._timed else None,
            )
        world.claim(LATERAL, self._entity, self._id, where)
        if self._timed:
            world.claim(LONGITUDINAL, self._entity, self._id, where)
        world.present[self._entity] |= where
        world.follow(self._entity, self._track, self._skip, where)
        world.offset[self._entity][where] = 0.0
        self._since[where] = 0.0 if self._absolute else world.time

    def step(self, world: World, dt: float, where: BoolArray) -> BoolArray:
        assert self._track is not None
        e = self._entity
        acting = where & world.controls(LATERAL, e, self._id)
        if self._timed:
            acting &= world.controls(LONGITUDINAL, e, self._id)
            along = self._track.distance_at(world.time + dt - self._since)
            if dt > 0:
                world.speed[e][acting] = ((along - world.distance[e]) / dt)[acting]
            world.distance[e][acting] = along[acting]
            world.timed[e] |= acting
        arrived = world.distance[e] >= self._track.lengths - 1e-9
        return np.asarray(where & (arrived | ~acting))


class SynchronizeAction:
    """Steers an entity's speed so that it is at its place when the master is at its own."""

    def __init__(self, element: etree._Element, scope: Scope, world: World, entity: int) -> None:
        self._entity, self._id = entity, next(_identities)
        self._master = entity_index(element, scope, world, "masterEntityRef")
        self._target_master = read_position(_child(element, "TargetPositionMaster", scope), scope, world)
        self._target = read_position(_child(element, "TargetPosition", scope), scope, world)
        self._tolerance = scope.number(element, "targetTolerance", 0.0)
        self._tolerance_master = scope.number(element, "targetToleranceMaster", 0.0)
        final = element.find("FinalSpeed/AbsoluteSpeed")
        if element.find("FinalSpeed") is not None and (final is None or len(final)):
            raise InputError(
                f"{scope.source}, line {element.sourceline}: the builtin simulator reads a <FinalSpeed> with an"
                " <AbsoluteSpeed> and without a steady state."
            )
        self._final = None if final is None else scope.number(final, "value")

    def start(self, world: World, where: BoolArray) -> None:
        world.claim(LONGITUDINAL, self._entity, self._id, where)

    def step(self, world: World, dt: float, where: BoolArray) -> BoolArray:
        e, m = self._entity, self._master
        acting = where & world.controls(LONGITUDINAL, e, self._id)
        way = world.remaining(e, self._target(world))
        way_master = world.remaining(m, self._target_master(world))
        there = (way <= np.maximum(self._tolerance, 1e-6)) | (way_master <= np.maximum(self._tolerance_master, 1e-6))
        with np.errstate(divide="ignore", invalid="ignore"):
            time = way_master / np.maximum(world.speed[m], 1e-6)
            mean = way / time
            # With a final speed the speed changes linearly over the rest of the way, so that its mean is
            # the one that arrives in time.
            wanted = mean if self._final is None else np.maximum(2.0 * mean - self._final, 0.0)
        if self._final is not None:
            wanted = np.where(there, self._final, wanted)
        entity = world.entities[e]
        wanted = np.clip(wanted, 0.0, entity.max_speed)
        speed = world.speed[e]
        slowest, fastest = speed - entity.max_deceleration * dt, speed + entity.max_acceleration * dt
        acting &= ~there | (self._final is not None)
        if world.driven[e]:
            world.target_speed[e][acting] = wanted[acting]
        else:
            world.speed[e][acting] = np.clip(wanted, slowest, fastest)[acting]
        return where & (there | ~world.controls(LONGITUDINAL, e, self._id))


def _child(element: etree._Element, tag: str, scope: Scope) -> etree._Element:
    child = element.find(tag)
    if child is None:
        raise InputError(f"{scope.source}, line {element.sourceline}: <{element.tag}> has no <{tag}>.")
    return child


_READERS: Final[dict[str, Callable[[etree._Element, Scope, World, int], Action]]] = {
    "TeleportAction": TeleportAction,
    "SpeedAction": SpeedAction,
    "AssignRouteAction": AssignRouteAction,
    "FollowTrajectoryAction": FollowTrajectoryAction,
    "SynchronizeAction": SynchronizeAction,
}
