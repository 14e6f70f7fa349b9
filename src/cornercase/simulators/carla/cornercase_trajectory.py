"""Moves an entity on CARLA along the trajectory of its scenario, in time.

ScenarioRunner loads this file by its name, in its own environment and an older Python; it uses nothing of cornercase.
"""

from __future__ import annotations

import math
from typing import Any, Dict, List, Optional, Tuple

import carla
from srunner.scenariomanager.actorcontrols.basic_control import BasicControl
from srunner.scenariomanager.timer import GameTime

# s that a velocity takes to lead to where the entity is to be.
_AHEAD = 0.05
# m that an entity may be away from where it is to be before it is put there.
_FAR = 3.0


class CornercaseTrajectory(BasicControl):  # type: ignore[misc]
    """Takes a vehicle by its velocity, a walker by its steps, and anything else by its place.

    ScenarioRunner's own controls go to the nearest lane, or as fast as they can.

    Parameters
    ----------
    actor : carla.Actor
    args : dict
        ``center_x`` is how far the centre of the scenario's box lies ahead of its reference point, in m.
    """

    _actor: Any
    _waypoints: List[Any]
    _times: Optional[List[float]]

    def __init__(self, actor: Any, args: Optional[Dict[str, str]] = None) -> None:
        super().__init__(actor)
        moves = isinstance(actor, (carla.Vehicle, carla.Walker))
        here = float(actor.bounding_box.location.x) if moves else 0.0
        self._shift = float((args or {}).get("center_x", here)) - here
        # The times of a trajectory count from the first tick of the run.
        self._since: Optional[float] = None
        self._before: Optional[float] = None

    def reset(self) -> None:
        """Give back what it holds: nothing."""
        self._actor = None

    def run_step(self) -> None:
        """Move the entity in one tick."""
        now = GameTime.get_time()
        if self._since is None:
            self._since = now
        if self._actor is None or not self._actor.is_alive or not self._waypoints or not self._times:
            return
        step = now - self._before if self._before is not None and now > self._before else _AHEAD
        self._before = now
        elapsed = now - self._since
        self._reached_goal = elapsed > self._times[-1]
        x, y, yaw = self._place(elapsed + step)
        here = self._actor.get_transform()
        dx, dy = x - here.location.x, y - here.location.y
        if isinstance(self._actor, carla.Walker):
            self._walk(dx, dy, step)
        elif isinstance(self._actor, carla.Vehicle) and math.hypot(dx, dy) < _FAR + self._speed(elapsed) * step:
            falling = self._actor.get_velocity().z
            self._actor.set_target_velocity(carla.Vector3D(dx / step, dy / step, falling))
            self._actor.set_target_angular_velocity(carla.Vector3D(0.0, 0.0, _turn(yaw - here.rotation.yaw) / step))
        else:
            place = carla.Location(x, y, here.location.z)
            self._actor.set_transform(
                carla.Transform(place, carla.Rotation(here.rotation.pitch, yaw, here.rotation.roll))
            )

    def _walk(self, dx: float, dy: float, step: float) -> None:
        way = math.hypot(dx, dy)
        if way > _FAR:
            here = self._actor.get_transform()
            here.location.x, here.location.y = here.location.x + dx, here.location.y + dy
            self._actor.set_transform(here)
        direction = carla.Vector3D(dx / way, dy / way, 0.0) if way > 1e-4 else carla.Vector3D(1.0, 0.0, 0.0)
        self._actor.apply_control(carla.WalkerControl(direction, way / step if way > 1e-4 else 0.0, False))

    def _leg(self, elapsed: float) -> Tuple[int, float]:
        """Vertex before an instant, and how much of the way to the next one is done."""
        assert self._times is not None
        last = len(self._times) - 1
        k = min(sum(1 for time in self._times if time <= elapsed), last) - 1
        k = max(k, 0)
        if last == 0:
            return 0, 0.0
        span = self._times[k + 1] - self._times[k]
        return k, min(max((elapsed - self._times[k]) / span, 0.0), 1.0) if span > 0.0 else 1.0

    def _place(self, elapsed: float) -> Tuple[float, float, float]:
        """Where CARLA's origin of the entity is to be at an instant: x and y in m, yaw in degrees."""
        k, part = self._leg(elapsed)
        one = self._waypoints[k]
        other = self._waypoints[min(k + 1, len(self._waypoints) - 1)]
        x = one.location.x + part * (other.location.x - one.location.x)
        y = one.location.y + part * (other.location.y - one.location.y)
        yaw = one.rotation.yaw + part * _turn(other.rotation.yaw - one.rotation.yaw)
        return (
            x + self._shift * math.cos(math.radians(yaw)),
            y + self._shift * math.sin(math.radians(yaw)),
            yaw,
        )

    def _speed(self, elapsed: float) -> float:
        assert self._times is not None
        k, _ = self._leg(elapsed)
        other = min(k + 1, len(self._waypoints) - 1)
        span = self._times[other] - self._times[k]
        way = self._waypoints[k].location.distance(self._waypoints[other].location)
        return float(way / span) if span > 0.0 else 0.0


def _turn(degrees: float) -> float:
    """The same turn, by at most half a circle."""
    return (degrees + 180.0) % 360.0 - 180.0
