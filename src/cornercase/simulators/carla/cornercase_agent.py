"""Agent for ScenarioRunner that moves the ego on CARLA as a driver of cornercase decides.

The driver runs in cornercase's own process. ScenarioRunner loads this file by its name, in its own environment with an
older Python, so it must not import cornercase. In each tick the agent sends the state of all entities as a line of
JSON, and receives a velocity and a yaw rate.
"""

from __future__ import annotations

import json
import math
import socket
from typing import Any, Dict, List

import carla
from srunner.autoagents.autonomous_agent import AutonomousAgent
from srunner.scenariomanager.carla_data_provider import CarlaDataProvider


class CornercaseAgent(AutonomousAgent):  # type: ignore[misc]
    """Agent that asks cornercase in each tick how to move the ego.

    Its configuration is a JSON file with the port of cornercase, a token, and the names of the ego and of all entities.
    """

    def setup(self, path_to_conf_file: str) -> None:
        """Read the configuration file, and connect to cornercase."""
        with open(path_to_conf_file, encoding="utf-8") as file:
            config = json.load(file)
        self._ego: str = config["ego"]
        self._names: List[str] = config["names"]
        self._token: str = config["token"]
        self._is_placed = False
        self._actors: Dict[str, Any] = {}
        self._socket = socket.create_connection(("127.0.0.1", config["port"]))
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._answers = self._socket.makefile("r", encoding="utf-8")

    def run_step(self, input_data: Any, timestamp: float) -> Any:
        """Ask cornercase for the velocity and the yaw rate of the ego, and apply them for one tick."""
        self._find_actors()
        states = {name: _state_of(actor) for name, actor in self._actors.items() if actor.is_alive}
        question = json.dumps({"token": self._token, "time": timestamp, "states": states})
        self._socket.sendall(question.encode() + b"\n")
        line = self._answers.readline()
        if not line:
            raise RuntimeError("cornercase has ended the run")
        decided = json.loads(line)
        ego = self._actors[self._ego]
        if not self._is_placed:
            self._move_to_center(ego)
        vx, vy = decided["velocity"]
        # Convert the velocity of the box's centre into the velocity of the actor's origin.
        yaw = math.radians(ego.get_transform().rotation.yaw)
        sideways = decided["yaw_rate"] * ego.bounding_box.location.x
        vx, vy = vx - sideways * math.sin(yaw), vy - sideways * math.cos(yaw)
        ego.set_target_velocity(carla.Vector3D(vx, -vy, ego.get_velocity().z))
        ego.set_target_angular_velocity(carla.Vector3D(0.0, 0.0, -math.degrees(decided["yaw_rate"])))
        return carla.VehicleControl()

    def destroy(self) -> None:
        """Close the connection."""
        self._answers.close()
        self._socket.close()

    def _move_to_center(self, ego: Any) -> None:
        """Move the ego so that the centre of its box, instead of the actor's origin, is at its initial position."""
        self._is_placed = True
        transform = ego.get_transform()
        transform.location -= ego.bounding_box.location.x * transform.get_forward_vector()
        ego.set_transform(transform)

    def _find_actors(self) -> None:
        if len(self._actors) < len(self._names):
            for actor in CarlaDataProvider.get_world().get_actors():
                name = actor.attributes.get("role_name", "")
                if name in self._names:
                    self._actors[name] = actor


def _state_of(actor: Any) -> List[float]:
    """Return x and y of the box's centre, heading, speed, and length and width of the box of an actor.

    The values are in m, rad and m/s, in right-handed axes.
    """
    transform, velocity, box = actor.get_transform(), actor.get_velocity(), actor.bounding_box
    yaw = math.radians(transform.rotation.yaw)
    cos, sin = math.cos(yaw), math.sin(yaw)
    x = transform.location.x + box.location.x * cos - box.location.y * sin
    y = transform.location.y + box.location.x * sin + box.location.y * cos
    speed = velocity.x * cos + velocity.y * sin
    return [x, -y, -yaw, speed, 2.0 * box.extent.x, 2.0 * box.extent.y]
