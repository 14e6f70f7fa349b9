"""Starts ScenarioRunner so that cornercase knows in which frame a scenario begins; a program that cornercase starts.

It runs in ScenarioRunner's own Python, 3.7 or later, so it must not import cornercase. Its arguments are the frame rate
in Hz and those of ScenarioRunner. When all entities are there, and before the storyboard begins, it writes the number
of the present frame into a file, and waits for a line on standard input: by then all entities are recorded.
"""

from __future__ import annotations

import os
import sys
from typing import Any

import scenario_runner
from srunner.scenariomanager.carla_data_provider import CarlaDataProvider
from srunner.scenariomanager.scenario_manager import ScenarioManager

FRAME_FILE = "first_frame"


def main() -> int:
    """Run ScenarioRunner, and return its exit status."""
    frame_rate = float(sys.argv.pop(1))
    run_scenario = ScenarioManager.run_scenario

    def run_when_recorded(manager: Any) -> Any:
        with open(FRAME_FILE + ".part", "w", encoding="utf-8") as file:
            file.write(str(CarlaDataProvider.get_world().get_snapshot().frame))
        os.rename(FRAME_FILE + ".part", FRAME_FILE)
        if not sys.stdin.readline():
            raise RuntimeError("cornercase has ended the run")
        return run_scenario(manager)

    ScenarioManager.run_scenario = run_when_recorded
    # Before 0.9.16 there is no option for it.
    scenario_runner.ScenarioRunner.frame_rate = frame_rate
    return int(scenario_runner.main() or 0)


if __name__ == "__main__":
    sys.exit(main())
