"""Starts ScenarioRunner so that cornercase knows in which frame a scenario begins; a program that cornercase starts.

It runs in ScenarioRunner's own Python, 3.7 or later, so it must not import cornercase. Its arguments are the frame rate
in Hz and those of ScenarioRunner. When all entities are there, and before the storyboard begins, it writes the number
of the present frame into a file, and waits for a line on standard input: by then all entities are recorded. When the
storyboard has ended, it writes the number of the last frame.
"""

from __future__ import annotations

import os
import sys
from typing import Any

import scenario_runner
from srunner.scenariomanager.carla_data_provider import CarlaDataProvider
from srunner.scenariomanager.scenario_manager import ScenarioManager

FIRST_FRAME_FILE, LAST_FRAME_FILE = "first_frame", "last_frame"


def main() -> int:
    """Run ScenarioRunner, and return its exit status."""
    frame_rate = float(sys.argv.pop(1))
    run_scenario = ScenarioManager.run_scenario

    def run_when_recorded(manager: Any) -> Any:
        world = CarlaDataProvider.get_world()
        _write_frame(world, FIRST_FRAME_FILE)
        if not sys.stdin.readline():
            raise RuntimeError("cornercase has ended the run")
        result = run_scenario(manager)
        _write_frame(world, LAST_FRAME_FILE)
        return result

    ScenarioManager.run_scenario = run_when_recorded
    # Before 0.9.16 there is no option for it.
    scenario_runner.ScenarioRunner.frame_rate = frame_rate
    return int(scenario_runner.main() or 0)


def _write_frame(world: Any, name: str) -> None:
    with open(name + ".part", "w", encoding="utf-8") as file:
        file.write(str(world.get_snapshot().frame))
    os.rename(name + ".part", name)


if __name__ == "__main__":
    sys.exit(main())
