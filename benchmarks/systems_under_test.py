"""How many scenarios per second a function of your own drives: class, arrays, FMU and program beside a preset.

    python benchmarks/systems_under_test.py [--quick] [--json FILE]

Runs concrete scenarios of the X-intersection alone, in tens and 400 at once. All functions are the same emergency
brake. The table has the best of three runs (of ten if alone): scenarios per second of CPU time of all processes, and
per second of wall time, beside the preset ``normal``, whose decisions are compiled. FMUs and the C++ program are
compiled, and left out without a compiler. ``--quick`` leaves out the runs of 400.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
import psutil

import cornercase as cc
from cornercase.drivers import DRIVERS, Driver
from cornercase.simulators import Builtin

ROOT: Final = Path(__file__).resolve().parents[1]
EXAMPLE: Final = ROOT / "examples" / "x_intersection"
PROGRAMS: Final = ROOT / "examples" / "process"
sys.path.insert(0, str(ROOT / "tests"))


class Aeb(cc.SystemUnderTest):
    """Brakes if the leader is closer than the ego comes in the time to brake."""

    def __init__(self, time_to_brake: float = 1.5) -> None:
        self.time_to_brake = time_to_brake

    def step(self, view: cc.drivers.View, dt: float) -> float:
        """Decide one step."""
        leader = view.leader
        return -8.0 if leader is not None and leader.gap < self.time_to_brake * leader.closing else 0.0


class Arrays(cc.Driver):
    """Keeps its speed, for all scenarios at once."""

    def acceleration(self, situation: cc.drivers.Situation) -> Any:
        """Decide one step of all scenarios."""
        return np.zeros(len(situation.speed))


def functions(folder: Path) -> Iterator[tuple[str, str | Driver | cc.SystemUnderTest]]:
    """Names of functions, and what `drivers` takes for them."""
    yield "normal", "normal"
    yield "array class", Arrays()
    yield "class", Aeb()
    if shutil.which("cc") or shutil.which("gcc"):
        from helpers.fmus import make_fmu

        for version in (2, 3):
            yield f"FMU, FMI {version}", DRIVERS.create(f"fmu:{make_fmu(folder / f'aeb{version}.fmu', version)}")
    subprocess.run([sys.executable, "-m", "cornercase.drivers.process", str(folder)], check=True, capture_output=True)
    for name in ("aeb.py", "aeb_numpy.py"):
        shutil.copy(PROGRAMS / name, folder)
        yield f"program {name}", DRIVERS.create(f"exec:{sys.executable} {folder / name}")
    if compiler := shutil.which("g++"):
        program = folder / "aeb"
        source = str(PROGRAMS / "aeb.cpp")
        subprocess.run([compiler, "-O2", "-std=c++17", f"-I{folder}", source, "-o", str(program)], check=True)
        yield "program aeb.cpp", DRIVERS.create(f"exec:{program}")


def concretes(count: int) -> list[cc.ConcreteScenario]:
    """Concrete scenarios that fill the example's space at random."""
    logical = cc.LogicalScenario.read(EXAMPLE / "x_intersection.xosc", EXAMPLE / "x_intersection.space.xosc")
    points = np.random.default_rng(1).random((count, logical.space.dimension))
    return [
        cc.ConcreteScenario(logical.scenario_file.path, row, logical.scenario_file)
        for row in logical.space.values(points)
    ]


def cpu_seconds() -> float:
    """CPU seconds of this process, of its children, and of those that have ended."""
    own = psutil.Process()
    children = [child.cpu_times() for child in own.children(recursive=True)]
    times = own.cpu_times()
    waited = times.children_user + times.children_system
    return times.user + times.system + waited + sum(child.user + child.system for child in children)


def measure(driver: Any, scenarios: list[cc.ConcreteScenario], runs: int) -> tuple[float, float]:
    """Scenarios per second of CPU time and of wall time: the best of some runs."""
    best_cpu = best_wall = float("inf")
    with Builtin(drivers={"Ego": driver}) as simulator:
        for outcome in simulator.run(scenarios[:2]):
            if isinstance(outcome, cc.SimulationError):
                raise outcome
        for _ in range(runs):
            cpu, wall = cpu_seconds(), time.perf_counter()
            for outcome in simulator.run(scenarios):
                if isinstance(outcome, cc.SimulationError):
                    raise outcome
            best_cpu, best_wall = min(best_cpu, cpu_seconds() - cpu), min(best_wall, time.perf_counter() - wall)
    return len(scenarios) / best_cpu, len(scenarios) / best_wall


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="only alone and in tens")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    warnings.simplefilter("ignore", cc.NoticeWarning)
    sizes = {1: 10, 10: 3} if options.quick else {1: 10, 10: 3, 400: 3}
    scenarios, rows = concretes(max(sizes)), []
    print(f"{'scenarios per second':<22}" + "".join(f"{f'{size} at once: CPU':>18}{'wall':>8}" for size in sizes))
    with tempfile.TemporaryDirectory() as folder:
        for name, driver in functions(Path(folder)):
            row: dict[str, Any] = {"function": name}
            for size, runs in sizes.items():
                row[f"{size} cpu"], row[f"{size} wall"] = measure(driver, scenarios[:size], runs)
            rows.append(row)
            figures = "".join(f"{row[f'{size} cpu']:>18.1f}{row[f'{size} wall']:>8.1f}" for size in sizes)
            print(f"{name:<22}{figures}", flush=True)
    if options.json is not None:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
