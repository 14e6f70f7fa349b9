"""Example of a user's agent for ScenarioRunner; `cornercase check-simulator carla` checks whether it drives.

ScenarioRunner loads this file by its name, in its own environment with an older Python, so it must not import
cornercase.
"""

from __future__ import annotations

from typing import Any, Dict, List

import carla
from srunner.autoagents.autonomous_agent import AutonomousAgent

_TARGET_SPEED = 8.0  # m/s
# Throttle and brake, from 0 to 1, for 1 m/s of difference from the target speed.
_GAIN = 0.3


class CornercaseExampleAgent(AutonomousAgent):  # type: ignore[misc]
    """Agent that drives straight ahead at 8 m/s by its speedometer, whatever is ahead.

    The agent also has an IMU, which only shows whether ScenarioRunner passes on the data of such a sensor.
    """

    def setup(self, path_to_conf_file: str) -> None:
        """Do nothing, since the agent needs no configuration."""

    def sensors(self) -> List[Dict[str, Any]]:
        """Return the specifications of the IMU and the speedometer."""
        position = {"x": 0.7, "y": 0.0, "z": 1.6, "roll": 0.0, "pitch": 0.0, "yaw": 0.0}
        return [
            {"type": "sensor.other.imu", "id": "IMU", **position},
            {"type": "sensor.speedometer", "id": "SPEED", "reading_frequency": 20},
        ]

    def run_step(self, input_data: Any, timestamp: float) -> Any:
        """Return throttle and brake; raise `RuntimeError` if the IMU has sent nothing."""
        if len(input_data["IMU"][1]) == 0:
            raise RuntimeError("the IMU has sent nothing")
        difference = _GAIN * (_TARGET_SPEED - input_data["SPEED"][1]["speed"])
        return carla.VehicleControl(throttle=min(max(difference, 0.0), 1.0), brake=min(max(-difference, 0.0), 1.0))
