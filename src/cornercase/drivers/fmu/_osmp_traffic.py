"""Conversion of the traffic to ASAM OSI messages for an FMU, and of the FMU's OSI messages to its motion."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from cornercase._common.geometry.boxes import wrap_angle
from cornercase._common.typing import FloatArray
from cornercase.drivers._base import Situation
from cornercase.drivers._controls import Trajectory
from cornercase.drivers._driving_function import Start
from cornercase.drivers.fmu._osmp_map import OsmpMap
from cornercase.recordings._osi_messages import OsiEntity, OsiState, fill_ground_truth, set_timestamp, set_version
from cornercase.recordings._osi_roads import fill_roads

HOST: Final = 0
"""OSI id of the driven vehicle; the ids of other entities follow, and the ids of false objects of sensors come last."""


class UnusableMotionError(Exception):
    """An OSI message of an FMU does not say, in a usable form, where the vehicle drives."""


class OsmpTraffic:
    """OSI messages of a batch: writes the traffic that an FMU is given, and reads the motion that the FMU decides.

    The traffic is the situation as known by sensors. Accelerations of others and all yaw rates are computed from the
    changes since the previous step.
    """

    def __init__(self, osmp: OsmpMap, start: Start) -> None:
        self._osmp, self._start = osmp, start
        # Speed and heading of all objects in the step before, the host first.
        n_objects = 1 + len(start.others)
        self._speed, self._heading = np.full((2, start.scenarios, n_objects), np.nan)
        # Target speed in the last speed action, and number of speed actions so far.
        self._given_speed, self._n_actions = np.full(start.scenarios, np.nan), [0] * start.scenarios
        self._views = [variable.name for variable in osmp.inputs if variable.message == "SensorView"]
        self._roads = self._describe_roads()
        self.static = [
            self._roads if variable.message == "GroundTruth" else self._configure_view(variable.name)
            for variable in osmp.static
        ]
        """OSI messages that are passed once, before the first step; the same in all scenarios."""

    def encode_messages(self, situation: Situation) -> list[list[bytes]]:
        """Return the OSI messages that the FMU is given, by scenario; empty bytes in scenarios that are not active."""
        if not self._osmp.inputs:
            return [[]] * len(situation.active)
        entities, states = self._entities(situation), self._states(situation)
        return [
            self._write_row(situation, row, entities, [OsiState(*state) for state in states[row].tolist()])
            if is_active
            else [b""] * len(self._osmp.inputs)
            for row, is_active in enumerate(situation.active.tolist())
        ]

    def decode_motion(self, message: bytes, situation: Situation, row: int) -> Trajectory | float:
        """Decode the FMU's OSI message in scenario `row`: a trajectory, or an acceleration along the heading in m/s².

        Empty bytes mean no message: the acceleration is 0. Raises `UnusableMotionError`.
        """
        assert self._osmp.motion is not None
        kind = self._osmp.motion.message
        if not message:
            return 0.0
        from google.protobuf.message import DecodeError

        try:
            if kind == "TrafficUpdate":
                return self._read_traffic_update(message, situation, row)
            return self._read_motion_request(message, situation, row)
        except DecodeError as error:
            raise UnusableMotionError(f"its message is not an OSI {kind}") from error
        except ValueError as error:
            raise UnusableMotionError(f"its {kind} cannot be driven: {error}") from error

    def _entities(self, situation: Situation) -> list[OsiEntity]:
        body, names = self._start.body, situation.others_name
        boxes = zip(
            situation.others_length.tolist(),
            situation.others_width.tolist(),
            situation.others_center_x.tolist(),
            strict=True,
        )
        host = OsiEntity(body.name, body.object_type, body.length, body.width, body.center_x)
        others = zip(names, situation.others_object_type, boxes, strict=True)
        return [host, *(OsiEntity(name, object_type, *box) for name, object_type, box in others)]

    def _states(self, situation: Situation) -> FloatArray:
        """Return x, y, heading, speed, acceleration and yaw rate of the ego and A others, shape (N, 1 + A, 6)."""
        x, y, heading, speed = (
            np.column_stack((getattr(situation, name), getattr(situation, f"others_{name}")))
            for name in ("x", "y", "heading", "speed")
        )
        dt, active = situation.time_step, situation.active
        acceleration = np.nan_to_num((speed - self._speed) / dt)
        acceleration[:, HOST] = situation.acceleration
        yaw_rate = np.nan_to_num(wrap_angle(heading - self._heading) / dt)
        self._speed[active], self._heading[active] = speed[active], heading[active]
        return np.stack((x, y, heading, speed, acceleration, yaw_rate), axis=2)

    def _write_row(
        self, situation: Situation, row: int, entities: list[OsiEntity], states: list[OsiState]
    ) -> list[bytes]:
        from osi3.osi_groundtruth_pb2 import GroundTruth
        from osi3.osi_sensorview_pb2 import SensorView

        time, truth = situation.time, GroundTruth()
        fill_ground_truth(truth, time, entities, states, HOST)
        if not self._osmp.has_roads_once:
            # Parsing the serialized roads is faster than copying their parts.
            truth.MergeFromString(self._roads)
            set_timestamp(truth.timestamp, time)
        command: bytes | None = None
        messages = []
        for variable in self._osmp.inputs:
            if variable.message == "TrafficCommand":
                command = self._command(time, row, float(situation.target_speed[row])) if command is None else command
                messages.append(command)
                continue
            message = truth
            if variable.message == "SensorView":
                message = SensorView()
                set_version(message)
                set_timestamp(message.timestamp, time)
                message.sensor_id.value = self._views.index(variable.name)
                message.host_vehicle_id.value = HOST
                _set_mounting_position(message)
                message.global_ground_truth.CopyFrom(truth)
            messages.append(message.SerializeToString(deterministic=True))
        return messages

    def _command(self, time: float, row: int, target_speed: float) -> bytes:
        """Return an OSI TrafficCommand, with a speed action only if the scenario's target speed has changed."""
        from osi3.osi_trafficcommand_pb2 import TrafficCommand

        command = TrafficCommand()
        set_version(command)
        set_timestamp(command.timestamp, time)
        command.traffic_participant_id.value = HOST
        if math.isfinite(target_speed) and target_speed != self._given_speed[row]:
            self._given_speed[row] = target_speed
            self._n_actions[row] += 1
            action = command.action.add().speed_action
            action.action_header.action_id.value = self._n_actions[row]
            action.absolute_target_speed = target_speed
        content: bytes = command.SerializeToString(deterministic=True)
        return content

    def _configure_view(self, name: str) -> bytes:
        """Return the OSI SensorViewConfiguration for the variable `name`; requests of the FMU are ignored."""
        from osi3.osi_sensorviewconfiguration_pb2 import SensorViewConfiguration

        config, view = SensorViewConfiguration(), name.replace("Config", "", 1)
        set_version(config)
        config.sensor_id.value = self._views.index(view) if view in self._views else 0
        _set_mounting_position(config)
        config.field_of_view_horizontal, config.field_of_view_vertical = 2.0 * math.pi, math.pi
        set_timestamp(config.update_cycle_time, self._start.time_step)
        set_timestamp(config.simulation_start_time, 0.0)
        config.omit_static_information = self._osmp.has_roads_once
        content: bytes = config.SerializeToString(deterministic=True)
        return content

    def _describe_roads(self) -> bytes:
        """Return an OSI GroundTruth with the roads only, which do not change."""
        from osi3.osi_groundtruth_pb2 import GroundTruth

        truth, network = GroundTruth(), self._start.network
        set_version(truth)
        set_timestamp(truth.timestamp, 0.0)
        if network is not None:
            truth.map_reference = network.path.name
            fill_roads(truth, network)
        content: bytes = truth.SerializeToString(deterministic=True)
        return content

    def _read_traffic_update(self, message: bytes, situation: Situation, row: int) -> Trajectory | float:
        from osi3.osi_trafficupdate_pb2 import TrafficUpdate

        updates = TrafficUpdate.FromString(message).update
        update = next((update for update in updates if update.id.value == HOST), None)
        if update is None:
            ids = ", ".join(str(update.id.value) for update in updates) or "none"
            raise UnusableMotionError(
                f"its TrafficUpdate has the ids {ids}, but not the id {HOST} of the driven vehicle"
            )
        return self._plan_motion_to(
            update.base, situation.time + situation.time_step, situation, row, self._start.body.center_x
        )

    def _read_motion_request(self, message: bytes, situation: Situation, row: int) -> Trajectory | float:
        from osi3.osi_motionrequest_pb2 import MotionRequest

        request = MotionRequest.FromString(message)
        if request.motion_request_type == MotionRequest.MOTION_REQUEST_TYPE_TRAJECTORY:
            points = request.desired_trajectory.trajectory_point
            times = [_read_time(point.timestamp) for point in points]
            if len(points) == 1:
                return self._plan_motion_to(points[0], times[0], situation, row, 0.0)
            headings = [point.orientation.yaw for point in points]
            return Trajectory(
                np.array(times),
                np.array([point.position.x for point in points]),
                np.array([point.position.y for point in points]),
                np.array(headings) if all(point.HasField("orientation") for point in points) else None,
            )
        state = request.desired_state
        time = _read_time(state.timestamp) if state.HasField("timestamp") else situation.time + situation.time_step
        return self._plan_motion_to(state, time, situation, row, 0.0)

    def _plan_motion_to(
        self, goal: Any, time: float, situation: Situation, row: int, center_x: float
    ) -> Trajectory | float:
        """Return a trajectory to the OSI state `goal` at `time` s, or the acceleration of a `goal` without position.

        The position of `goal` is `center_x` m ahead of the vehicle's reference point. Coordinates and headings that
        `goal` leaves out stay as they are. The acceleration is along the heading, in m/s².
        """
        heading = float(situation.heading[row])
        if not goal.HasField("position"):
            if not goal.HasField("acceleration"):
                raise ValueError("the state has neither a position nor an acceleration")
            along: float = goal.acceleration.x * math.cos(heading) + goal.acceleration.y * math.sin(heading)
            return along
        yaw = goal.orientation.yaw if goal.orientation.HasField("yaw") else heading
        here = float(situation.x[row]), float(situation.y[row])
        ahead = center_x * math.cos(heading), center_x * math.sin(heading)
        # An unset number would be read as 0.
        centre = (
            getattr(goal.position, axis) if goal.position.HasField(axis) else start + shift
            for axis, start, shift in zip("xy", here, ahead, strict=True)
        )
        x, y = (to - center_x * part for to, part in zip(centre, (math.cos(yaw), math.sin(yaw)), strict=True))
        speed = None
        is_moving = "velocity" in goal.DESCRIPTOR.fields_by_name and goal.HasField("velocity")
        if is_moving:
            forward = goal.velocity.x * math.cos(yaw) + goal.velocity.y * math.sin(yaw)
            speed = np.array([situation.speed[row], max(forward, 0.0)])
        return Trajectory(
            np.array([situation.time, time]),
            np.array([here[0], x]),
            np.array([here[1], y]),
            np.array([heading, yaw]),
            speed,
        )


def _set_mounting_position(message: Any) -> None:
    """Set a sensor's mounting position to the middle of the rear axle, the origin of mounting positions."""
    position, orientation = message.mounting_position.position, message.mounting_position.orientation
    position.x = position.y = position.z = orientation.roll = orientation.pitch = orientation.yaw = 0.0


def _read_time(timestamp: Any) -> float:
    return float(timestamp.seconds) + 1e-9 * float(timestamp.nanos)
