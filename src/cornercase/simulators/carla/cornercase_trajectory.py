"""Controller for ScenarioRunner that moves an entity on CARLA along the timed trajectory of its scenario.

ScenarioRunner loads this file by its name, in its own environment with an older Python, so it must not import
cornercase.
"""

from __future__ import annotations

import json
import math
from typing import Any, Dict, List, Optional, Tuple

import carla
from srunner.scenariomanager.actorcontrols.basic_control import BasicControl
from srunner.scenariomanager.carla_data_provider import CarlaDataProvider
from srunner.scenariomanager.timer import GameTime

# Assumed time step in s, in which a velocity leads to the target position, if the time step is unknown.
_DEFAULT_STEP = 0.05
# Distance in m from the target position beyond which an entity is placed there.
_MAX_DEVIATION = 3.0


class CornercaseTrajectory(BasicControl):  # type: ignore[misc]
    """Controller that moves an entity along a trajectory in ScenarioRunner.

    A vehicle is moved by its velocity, a walker by its steps, and any other entity by its position. This controller
    replaces ScenarioRunner's own controls, because these would leave the trajectory. It does not use the storyboard.

    In `args`, ``parts`` is a JSON list of the parts of the trajectory: at each jump of the entity to another place, a
    new part begins. Each part is a list of vertices: time in s, x and y in m, and heading in rad, in right-handed axes.
    ``starts`` is a JSON list with the time in s from which each part applies. ``end`` is the time in s at which the
    entity vanishes; without ``end``, the entity stays. ``center_x`` is the distance in m from the entity's reference
    point in the scenario forward to the centre of its box.
    """

    _actor: Any

    def __init__(self, actor: Any, args: Dict[str, str]) -> None:
        super().__init__(actor)
        is_movable = isinstance(actor, (carla.Vehicle, carla.Walker))
        actor_center_x = float(actor.bounding_box.location.x) if is_movable else 0.0
        self._origin_offset = float(args.get("center_x", actor_center_x)) - actor_center_x
        self._parts: List[List[List[float]]] = json.loads(args["parts"])
        self._starts: List[float] = json.loads(args["starts"])
        self._end = float(args.get("end", "inf"))
        # Times of the trajectory start at the first tick of the run.
        self._start_time: Optional[float] = None
        self._last_time: Optional[float] = None

    def reset(self) -> None:
        """Release the actor."""
        self._actor = None

    def run_step(self) -> None:
        """Move the entity by one time step."""
        now = GameTime.get_time()
        if self._start_time is None:
            self._start_time = now
        if self._actor is None or not self._actor.is_alive:
            return
        step = now - self._last_time if self._last_time is not None and now > self._last_time else _DEFAULT_STEP
        self._last_time = now
        elapsed = now - self._start_time
        self._reached_goal = elapsed > self._parts[-1][-1][0]
        if elapsed > self._end:
            CarlaDataProvider.remove_actor_by_id(self._actor.id)
            return
        part = self._parts[max(k for k, start in enumerate(self._starts) if k == 0 or elapsed > start)]
        x, y, yaw = self._pose_at(part, elapsed + step)
        transform = self._actor.get_transform()
        dx, dy = x - transform.location.x, y - transform.location.y
        if isinstance(self._actor, carla.Walker):
            self._move_walker(dx, dy, step)
        elif (
            isinstance(self._actor, carla.Vehicle)
            and math.hypot(dx, dy) < _MAX_DEVIATION + _speed_at(part, elapsed) * step
        ):
            vertical_speed = self._actor.get_velocity().z
            self._actor.set_target_velocity(carla.Vector3D(dx / step, dy / step, vertical_speed))
            self._actor.set_target_angular_velocity(
                carla.Vector3D(0.0, 0.0, _wrap_degrees(yaw - transform.rotation.yaw) / step)
            )
        else:
            location = carla.Location(x, y, transform.location.z)
            self._actor.set_transform(
                carla.Transform(location, carla.Rotation(transform.rotation.pitch, yaw, transform.rotation.roll))
            )

    def _move_walker(self, dx: float, dy: float, step: float) -> None:
        distance = math.hypot(dx, dy)
        if distance > _MAX_DEVIATION:
            transform = self._actor.get_transform()
            transform.location.x, transform.location.y = transform.location.x + dx, transform.location.y + dy
            self._actor.set_transform(transform)
            distance = 0.0
        direction = (
            carla.Vector3D(dx / distance, dy / distance, 0.0) if distance > 1e-4 else carla.Vector3D(1.0, 0.0, 0.0)
        )
        self._actor.apply_control(carla.WalkerControl(direction, distance / step if distance > 1e-4 else 0.0, False))

    def _pose_at(self, part: List[List[float]], elapsed: float) -> Tuple[float, float, float]:
        """Return x and y in m and yaw in degrees of the actor at a time in s, in CARLA's left-handed axes."""
        start, end, fraction = _find_segment_at(part, elapsed)
        x, y, heading = (start[k] + fraction * (end[k] - start[k]) for k in (1, 2, 3))
        x, y = x + self._origin_offset * math.cos(heading), y + self._origin_offset * math.sin(heading)
        return x, -y, -math.degrees(heading)


def _find_segment_at(part: List[List[float]], elapsed: float) -> Tuple[List[float], List[float], float]:
    """Return the vertices before and after a time in s, and the fraction of the interval that has elapsed.

    `part` is a list of vertices: time in s, x and y in m, and heading in rad.
    """
    k = min(max(sum(1 for vertex in part if vertex[0] <= elapsed) - 1, 0), len(part) - 2)
    start, end = part[k], part[k + 1]
    span = end[0] - start[0]
    return start, end, min(max((elapsed - start[0]) / span, 0.0), 1.0) if span > 0.0 else 1.0


def _speed_at(part: List[List[float]], elapsed: float) -> float:
    start, end, _ = _find_segment_at(part, elapsed)
    span = end[0] - start[0]
    return math.hypot(end[1] - start[1], end[2] - start[2]) / span if span > 0.0 else 0.0


def _wrap_degrees(degrees: float) -> float:
    """Wrap an angle in degrees to the range from -180 to 180."""
    return (degrees + 180.0) % 360.0 - 180.0
