"""Motion of a vehicle according to the decisions of its driver, in many scenarios at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from cornercase._common.geometry.boxes import wrap_angle
from cornercase._common.masks import any_true
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.drivers._base import Situation
from cornercase.drivers._controls import Controls
from cornercase.drivers._driving_function import Start
from cornercase.drivers._lane_change import LaneChange
from cornercase.drivers._lanes import find_neighbouring_path
from cornercase.drivers._path_tracking import locate_on_path, steer_along_path
from cornercase.drivers._trajectory_following import FollowedTrajectory
from cornercase.drivers.vehicles._kernels.steered import MOVED
from cornercase.drivers.vehicles._vehicle_model import VEHICLES, PlanarMotion, VehicleModel

_DEFAULT_VEHICLE: Final = "kinematic"


@dataclass(frozen=True, eq=False)
class DrivenMotion:
    """Motion of a vehicle at the end of a time step, in N scenarios.

    In scenarios where `is_steered` (N,) is True, the vehicle has the pose in `state`. In all others, the vehicle stays
    exactly on its path, and only the speed in `state` counts. `is_tracked` (N,) is True where the driver did not steer,
    and a controller steered the vehicle along its path instead.
    """

    state: PlanarMotion
    is_steered: BoolArray
    is_tracked: BoolArray


@dataclass(eq=False)
class _ManeuverState:
    """State of a vehicle's maneuvers in N scenarios.

    `is_free` (N,): True if the vehicle no longer follows its path exactly, so a controller must steer along the path.
    `last_request` (N,): lane change that the driver requested in the previous time step, in lanes to the left; 0 for
    none. `left_x`, `left_y` (N,): position in m at the end of the previous time step. `followed` and `changes`:
    trajectories and lane changes in progress, by index of the scenario.
    """

    is_free: BoolArray
    last_request: FloatArray
    left_x: FloatArray
    left_y: FloatArray
    followed: dict[int, FollowedTrajectory] = field(default_factory=dict)
    changes: dict[int, LaneChange] = field(default_factory=dict)


class VehicleMover:
    """Motion of a driver's vehicle, step by step, with or without a vehicle model.

    Without a vehicle model, the vehicle follows a driver's trajectories exactly. Without a vehicle model that steers,
    the vehicle also follows its path and lane changes exactly, until the driver first steers or gives a trajectory. In
    all other cases, a controller steers the vehicle while the driver does not. If the driver requests a change to a
    lane that does not exist, `note_missing_lane` is called with the time and the side.
    """

    def __init__(self, vehicle: VehicleModel | None, note_missing_lane: Callable[[float, str], None]) -> None:
        self._vehicle, self._note_missing_lane = vehicle, note_missing_lane

    def start(self, start: Start) -> None:
        """Reset all state before the first step of the scenarios."""
        self._start = start
        self._steered = self._vehicle if self._vehicle is not None and self._vehicle.steers else None
        n = start.scenarios
        self._memory = _ManeuverState(np.full(n, self._steered is not None), np.zeros(n), np.zeros(n), np.zeros(n))
        if self._vehicle is not None:
            self._vehicle.start(start)
        late = 0.0 if self._vehicle is None else self._vehicle.steering_response
        self._response = np.broadcast_to(late, start.scenarios)
        axles = None if self._vehicle is None else self._vehicle.wheelbase
        self._wheelbase = np.broadcast_to(start.body.wheelbase if axles is None else axles, start.scenarios)

    def step(
        self, situation: Situation, begin: PlanarMotion, controls: Controls, acceleration: FloatArray, active: BoolArray
    ) -> DrivenMotion:
        """Return the motion at the end of a time step in the active scenarios.

        `begin` is the motion at the start of the step. `acceleration` (N,) in m/s² is NaN in scenarios in which the
        vehicle follows a trajectory.
        """
        memory, dt, time = self._memory, situation.time_step, situation.time
        self._update_maneuvers(time, begin, controls, active)
        steering = np.where(active, controls.steering, np.nan)
        memory.is_free |= np.isfinite(steering)
        is_exact = np.zeros(len(active), dtype=np.bool_)
        x, y, heading, speed = (values.copy() for values in (begin.x, begin.y, begin.heading, begin.speed))
        for n, trajectory in memory.followed.items():
            if not active[n]:
                continue
            memory.is_free[n] = True
            here = (time, float(begin.x[n]), float(begin.y[n]), float(begin.heading[n]), float(begin.speed[n]), dt)
            if self._vehicle is None:
                is_exact[n] = True
                x[n], y[n], heading[n], speed[n] = trajectory.move(*here)
            else:
                acceleration[n], steering[n] = trajectory.track(
                    *here, float(self._wheelbase[n]), float(self._response[n])
                )
        acceleration = self._limit(acceleration)
        goes = active & ~is_exact
        requested = np.minimum(np.maximum(begin.speed + acceleration * dt, 0.0), self._start.body.max_speed)
        speed[goes] = requested[goes]
        if self._vehicle is not None and not self._vehicle.steers:
            speed[goes] = self._drive(self._vehicle, begin, acceleration, steering, dt, goes).speed[goes]
        for n in [*memory.changes]:
            if active[n]:
                exact = self._continue_change(n, begin, float(speed[n]), steering, dt)
                if exact is not None:
                    is_exact[n] = True
                    x[n], y[n], direction = exact
                    heading[n] += wrap_angle(direction - heading[n])
        is_steered = active & (memory.is_free | is_exact)
        is_driven = is_steered & ~is_exact
        is_tracked = is_driven & np.isnan(steering)
        if is_driven.any():
            self._set_path_tracking_steering(situation, begin, steering, is_tracked)
            if self._steered is None:
                self._steered = VEHICLES.create(_DEFAULT_VEHICLE)
                self._steered.start(self._start)
            if self._steered is not self._vehicle:
                acceleration = (speed - begin.speed) / dt
            limit = self._start.body.max_steering
            after = self._drive(self._steered, begin, acceleration, steering.clip(-limit, limit), dt, is_driven)
            for values, driven in ((x, after.x), (y, after.y), (heading, after.heading), (speed, after.speed)):
                values[is_driven] = driven[is_driven]
        memory.left_x[active], memory.left_y[active] = x[active], y[active]
        return DrivenMotion(PlanarMotion(x, y, heading, speed, (speed - begin.speed) / dt), is_steered, is_tracked)

    def follows_trajectory(self, controls: Controls) -> BoolArray:
        """Return a mask (N,): True if the driver gives a trajectory now, or the vehicle already follows one."""
        result = np.zeros(len(controls.acceleration), dtype=np.bool_)
        result[[*controls.trajectories, *self._memory.followed]] = True
        return result

    def _update_maneuvers(self, time: float, begin: PlanarMotion, controls: Controls, active: BoolArray) -> None:
        """Begin and end trajectories and lane changes as the driver requests."""
        memory = self._memory
        if not (controls.trajectories or memory.followed or memory.changes or any_true(controls.lane_change != 0)):
            memory.last_request[active] = 0.0
            return
        for n, given in controls.trajectories.items():
            if active[n] and not (n in memory.followed and memory.followed[n].given is given):
                may_reverse = self._start.body.object_type != "pedestrian"
                memory.followed[n] = FollowedTrajectory(
                    given, time, float(begin.x[n]), float(begin.y[n]), may_reverse=may_reverse
                )
        requests = np.where(active, controls.lane_change, 0)
        is_new = active & (requests != 0) & (requests != memory.last_request)
        memory.last_request[active] = requests[active]
        moved = np.hypot(begin.x - memory.left_x, begin.y - memory.left_y)
        for n in [*memory.changes]:
            if active[n] and moved[n] > MOVED:
                del memory.changes[n]
        decides = np.isfinite(controls.acceleration) | np.isfinite(controls.throttle) | np.isfinite(controls.brake)
        for n in [*memory.followed]:
            if active[n] and decides[n] and n not in controls.trajectories:
                del memory.followed[n]
        for n in np.flatnonzero(is_new).tolist():
            if n not in memory.changes and n not in memory.followed:
                self._begin_change(n, time, begin, int(requests[n]))
        for n in [*memory.changes]:
            if active[n] and (np.isfinite(controls.steering[n]) or n in memory.followed):
                del memory.changes[n]

    def _begin_change(self, n: int, time: float, begin: PlanarMotion, lanes_to_left: int) -> None:
        network, x, y = self._start.network, float(begin.x[n]), float(begin.y[n])
        path = None
        if network is not None:
            path = find_neighbouring_path(network, x, y, float(begin.heading[n]), lanes_to_left)
        if path is None:
            self._note_missing_lane(time, "left" if lanes_to_left > 0 else "right")
            return
        self._memory.changes[n] = LaneChange.begin(path, x, y)

    def _continue_change(
        self, n: int, begin: PlanarMotion, speed: float, steering: FloatArray, dt: float
    ) -> tuple[float, float, float] | None:
        """Continue the lane change of scenario `n` by a time step.

        Returns the new pose of a vehicle that follows its path exactly. For any other vehicle, sets the scenario's
        angle in `steering` and returns None.
        """
        change, x, y = self._memory.changes[n], float(begin.x[n]), float(begin.y[n])
        if not self._memory.is_free[n]:
            pose = change.move(x, y, speed, dt)
            if change.progress >= 1.0:
                del self._memory.changes[n]
            return pose
        response = float(self._response[n])
        at = change.advance_and_locate(x, y, float(begin.heading[n]), float(begin.speed[n]), dt, response)
        steering[n] = float(steer_along_path(at, begin.speed[n : n + 1], float(self._wheelbase[n]), response)[0])
        if change.has_arrived(float(at.offset[0])):
            del self._memory.changes[n]
        return None

    def _set_path_tracking_steering(
        self, situation: Situation, begin: PlanarMotion, steering: FloatArray, rows: BoolArray
    ) -> None:
        """Set the steering angles that follow the path, in the scenarios of the mask `rows`."""
        if rows.any():
            ahead = begin.speed * (0.5 * situation.time_step + self._response)
            poses = locate_on_path(situation.path, situation.distance, begin.x, begin.y, begin.heading, ahead)
            steering[rows] = steer_along_path(poses, begin.speed, self._wheelbase, self._response)[rows]

    def _limit(self, acceleration: FloatArray) -> FloatArray:
        body = self._start.body
        decided = np.where(np.isnan(acceleration), 0.0, acceleration)
        return np.clip(decided, -body.max_deceleration, body.max_acceleration)

    def _drive(
        self,
        vehicle: VehicleModel,
        begin: PlanarMotion,
        acceleration: FloatArray,
        steering: FloatArray,
        dt: float,
        rows: BoolArray,
    ) -> PlanarMotion:
        steering = np.where(rows, np.nan_to_num(steering), 0.0)
        return vehicle.step(begin, acceleration, steering, self._start.friction, dt, rows)
