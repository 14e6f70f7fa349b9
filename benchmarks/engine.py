"""How many concrete scenarios the builtin simulator runs in a second, all at once and one after the other.

    python benchmarks/engine.py [SCENARIO.xosc SPACE.xosc | SCENARIO.xosc NAME=LOW:HIGH …] [--quick] [--json FILE]

Without a scenario it takes the X-intersection of the examples. Load is included; memory is the largest resident set of
a process of its own for each figure.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any, cast

EXAMPLE = Path(__file__).parents[1] / "examples" / "x_intersection"

PROGRAM = """
import json, resource, sys, time
from cornercase import LogicalScenario
from cornercase.simulators import BuiltinSimulator
from cornercase.optimizers import RandomOptimizer
scenario, count, alone, *varied = sys.argv[1:]
files = [one for one in varied if "=" not in one]
logical = LogicalScenario.read(scenario, files[0] if files else None, [one for one in varied if "=" in one], True)
points = RandomOptimizer(logical.space, 0).ask(int(count))
concretes = [logical.concrete(values) for values in logical.space.values(points)]
simulator = BuiltinSimulator(duration=40.0)
list(simulator.run(concretes[:1]))
begun = time.perf_counter()
parts = [[one] for one in concretes] if alone == "alone" else [concretes]
failed = sum(isinstance(one, Exception) for part in parts for one in simulator.run(part))
seconds = time.perf_counter() - begun
memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
print(json.dumps({"scenarios": len(concretes), "failed": failed, "seconds": seconds, "memory": memory}))
"""


def measure(arguments: list[str], count: int, alone: bool) -> dict[str, float]:
    command = [sys.executable, "-c", PROGRAM, arguments[0], str(count), "alone" if alone else "batch", *arguments[1:]]
    lines = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()
    return cast(dict[str, float], json.loads(lines[-1]))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario", nargs="*")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    arguments = options.scenario or [str(EXAMPLE / f"x_intersection{end}") for end in (".xosc", ".space.xosc")]
    sizes = [256, 1024] if options.quick else [1024, 3375, 16384, 50000]
    table: list[dict[str, Any]] = [
        {"way": "one after the other", **measure(arguments, 16 if options.quick else 64, True)}
    ]
    table += [{"way": "all at once", **measure(arguments, size, False)} for size in sizes]
    slowest = table[0]["scenarios"] / table[0]["seconds"]
    print(f"{'':22}{'scenarios':>10}{'failed':>8}{'s':>9}{'1/s':>9}{'ratio':>8}{'MB':>8}")
    for row in table:
        rate = row["scenarios"] / row["seconds"]
        print(
            f"{row['way']:22}{row['scenarios']:>10}{row['failed']:>8}{row['seconds']:>9.2f}{rate:>9.0f}"
            f"{rate / slowest:>8.1f}{row['memory']:>8.0f}"
        )
    if options.json:
        options.json.write_text(json.dumps(table, indent=2) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
