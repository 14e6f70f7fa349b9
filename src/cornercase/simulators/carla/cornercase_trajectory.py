"""Controller that moves an entity on CARLA along the timed trajectory of its scenario.

ScenarioRunner loads this file by its name, in its own environment with an older Python, so it must not import
cornercase.
"""

from __future__ import annotations

import math
from typing import Any, Dict, List, Optional, Tuple

import carla
from srunner.scenariomanager.actorcontrols.basic_control import BasicControl
from srunner.scenariomanager.timer import GameTime

# Time in s within which a velocity leads to the target position, if the time step is unknown.
_DEFAULT_STEP = 0.05
# Distance in m from the target position beyond which an entity is placed there.
_MAX_DEVIATION = 3.0


class CornercaseTrajectory(BasicControl):  # type: ignore[misc]
    """Moves a vehicle by its velocity, a walker by its steps, and any other entity by its position.

    It replaces ScenarioRunner's own controls, which would leave the trajectory. ``center_x`` in `args` is the distance
    in m by which the centre of the scenario's box is ahead of its reference point.
    """

    _actor: Any
    _waypoints: List[Any]
    _times: Optional[List[float]]

    def __init__(self, actor: Any, args: Optional[Dict[str, str]] = None) -> None:
        super().__init__(actor)
        is_movable = isinstance(actor, (carla.Vehicle, carla.Walker))
        actor_center_x = float(actor.bounding_box.location.x) if is_movable else 0.0
        self._origin_offset = float((args or {}).get("center_x", actor_center_x)) - actor_center_x
        # Times of the trajectory start at the first tick of the run.
        self._start_time: Optional[float] = None
        self._last_time: Optional[float] = None

    def reset(self) -> None:
        """Release the actor."""
        self._actor = None

    def run_step(self) -> None:
        """Move the entity in one tick."""
        now = GameTime.get_time()
        if self._start_time is None:
            self._start_time = now
        if self._actor is None or not self._actor.is_alive or not self._waypoints or not self._times:
            return
        step = now - self._last_time if self._last_time is not None and now > self._last_time else _DEFAULT_STEP
        self._last_time = now
        elapsed = now - self._start_time
        self._reached_goal = elapsed > self._times[-1]
        x, y, yaw = self._pose_at(elapsed + step)
        transform = self._actor.get_transform()
        dx, dy = x - transform.location.x, y - transform.location.y
        if isinstance(self._actor, carla.Walker):
            self._move_walker(dx, dy, step)
        elif (
            isinstance(self._actor, carla.Vehicle)
            and math.hypot(dx, dy) < _MAX_DEVIATION + self._speed_at(elapsed) * step
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
        direction = (
            carla.Vector3D(dx / distance, dy / distance, 0.0) if distance > 1e-4 else carla.Vector3D(1.0, 0.0, 0.0)
        )
        self._actor.apply_control(carla.WalkerControl(direction, distance / step if distance > 1e-4 else 0.0, False))

    def _leg_at(self, elapsed: float) -> Tuple[int, float]:
        """Return the index of the last vertex before a time, and the fraction of the leg to the next vertex."""
        assert self._times is not None
        last = len(self._times) - 1
        k = min(sum(1 for time in self._times if time <= elapsed), last) - 1
        k = max(k, 0)
        if last == 0:
            return 0, 0.0
        span = self._times[k + 1] - self._times[k]
        return k, min(max((elapsed - self._times[k]) / span, 0.0), 1.0) if span > 0.0 else 1.0

    def _pose_at(self, elapsed: float) -> Tuple[float, float, float]:
        """Return the pose of the entity's CARLA actor at a time: x and y in m, yaw in degrees."""
        k, fraction = self._leg_at(elapsed)
        start = self._waypoints[k]
        end = self._waypoints[min(k + 1, len(self._waypoints) - 1)]
        x = start.location.x + fraction * (end.location.x - start.location.x)
        y = start.location.y + fraction * (end.location.y - start.location.y)
        yaw = start.rotation.yaw + fraction * _wrap_degrees(end.rotation.yaw - start.rotation.yaw)
        return (
            x + self._origin_offset * math.cos(math.radians(yaw)),
            y + self._origin_offset * math.sin(math.radians(yaw)),
            yaw,
        )

    def _speed_at(self, elapsed: float) -> float:
        assert self._times is not None
        k, _ = self._leg_at(elapsed)
        next_index = min(k + 1, len(self._waypoints) - 1)
        span = self._times[next_index] - self._times[k]
        distance = self._waypoints[k].location.distance(self._waypoints[next_index].location)
        return float(distance / span) if span > 0.0 else 0.0


def _wrap_degrees(degrees: float) -> float:
    """Wrap an angle in degrees to the range of half a turn in either direction."""
    return (degrees + 180.0) % 360.0 - 180.0
