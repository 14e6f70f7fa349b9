"""What vehicle models cost: CPU seconds of the X-intersection with and without, side by side.

    python benchmarks/vehicles.py [--quick] [--scenarios N] [--rounds N] [--json FILE]

Each round runs the same N concrete scenarios with the driver ``normal`` alone and with each vehicle model, one after
another, in one process. The table has the median CPU seconds of the rounds, simulated seconds (scenarios end at other
times with other vehicles), and the median ratio of CPU seconds, and of CPU seconds per simulated second, to ``normal``
in the same round. The speed of a machine changes from second to second, so there are many rounds. ``--quick`` takes 200
scenarios and 3 rounds.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from pathlib import Path
from typing import Any, Final

import numpy as np

import cornercase as cc
from cornercase.simulators import Builtin

EXAMPLE: Final = Path(__file__).resolve().parents[1] / "examples" / "x_intersection"
DRIVERS: Final = (
    "normal",
    "normal + actuators",
    "normal + actuators:delay=0.1,mu=0.5",
    "normal + actuators:delay=0.1,lag=0.2,max_jerk=30",
    "normal + kinematic",
    "normal + single-track",
)


def concretes(count: int) -> list[cc.ConcreteScenario]:
    """Concrete scenarios that fill the example's space at random."""
    logical = cc.LogicalScenario.read(EXAMPLE / "x_intersection.xosc", EXAMPLE / "x_intersection.space.xosc")
    points = np.random.default_rng(1).random((count, logical.space.dimension))
    return [
        cc.ConcreteScenario(logical.scenario_file.path, row, logical.scenario_file)
        for row in logical.space.values(points)
    ]


def measure(driver: str, scenarios: list[cc.ConcreteScenario]) -> tuple[float, float]:
    """CPU seconds of a run, and the seconds that were simulated."""
    begin, simulated = time.process_time(), 0.0
    for run in Builtin(drivers={"Ego": driver}).run(scenarios):
        if isinstance(run, cc.SimulationError):
            raise run
        simulated += float(run.time[-1])
    return time.process_time() - begin, simulated


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="200 scenarios and 3 rounds")
    parser.add_argument("--scenarios", type=int, default=1000)
    parser.add_argument("--rounds", type=int, default=25)
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    count, rounds = (200, 3) if options.quick else (options.scenarios, options.rounds)
    scenarios = concretes(count)
    for driver in DRIVERS:
        # Compile before the clock runs.
        measure(driver, scenarios)
    runs = [{driver: measure(driver, scenarios) for driver in DRIVERS} for _ in range(rounds)]
    rows: list[dict[str, Any]] = []
    for driver in DRIVERS:
        pairs = [(one[driver], one["normal"]) for one in runs]
        rows.append(
            {
                "driver": driver,
                "cpu_s": statistics.median(own[0] for own, _ in pairs),
                "simulated_s": pairs[0][0][1],
                "ratio": statistics.median(own[0] / bare[0] for own, bare in pairs),
                "ratio_per_simulated_s": statistics.median(
                    own[0] / own[1] / (bare[0] / bare[1]) for own, bare in pairs
                ),
            }
        )
    print(f"{count} scenarios of the X-intersection, median of {rounds} rounds")
    print(f"{'driver':<50}{'CPU s':>8}{'simulated s':>13}{'ratio':>8}{'per simulated s':>17}")
    for row in rows:
        cost = f"{row['cpu_s']:8.2f}{row['simulated_s']:13.0f}{row['ratio']:8.2f}{row['ratio_per_simulated_s']:17.2f}"
        print(f"{row['driver']:<50}{cost}")
    if options.json:
        options.json.write_text(json.dumps({"scenarios": count, "rounds": rounds, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
