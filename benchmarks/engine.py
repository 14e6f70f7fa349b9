"""How many concrete scenarios the builtin simulator runs in a second: one at a time, in rounds of ten, all at once.

    python benchmarks/engine.py [SCENARIO.xosc [SPACE.xosc] [NAME=LOW:HIGH …]] [--driver NAME] [--quick] [--seconds S]
        [--json FILE]

Without a scenario it takes the X-intersection of the examples. NAME drives the entity ``Ego``; without one it is who
the file names, and more rows compare the built-in ``normal`` with a plain driver of NumPy's such as users write
(``own``), which Python asks in each time step. Each row is measured in a process of its own, which has run these
scenarios before with all kernels compiled, for S seconds of CPU at least; large batches are run once. ``first`` is what
a new simulator needs there for one scenario: reading and preparing the file. Recordings are not kept. Memory is the
most that the process held.

Beside it stands esmini's library, where ``CORNERCASE_ESMINI`` names it: the same concrete scenarios, one after the
other, each loaded anew, stepped as often, nothing read of what happens, its own controllers switched off. It has no
drivers of cornercase, so that it runs their scenarios by the storyboard alone, which is less to do. It is given in
scenarios per second of CPU, as who has two cores can start two of it, and ``times`` is of these too.

Figures of different machines, and of a busy one, compare by a loop of 200,000 calls of NumPy on 16 numbers each, which
is timed around each row in its process: ``per loop`` are the scenarios that a core simulates while it does that once,
both in seconds of CPU.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass, replace
from itertools import cycle
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numpy as np

from cornercase import ConcreteScenario, LogicalScenario
from cornercase._common.numba.interpret import compile_at_once
from cornercase._common.typing import FloatArray
from cornercase.drivers import Driver, Situation
from cornercase.optimizers import Random
from cornercase.simulators import Builtin, Esmini
from cornercase.simulators.esmini._library import (
    PARAMETER_CALLBACK,
    encode_esmini_path,
    find_library_path,
    load_library,
    set_parameter,
)

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
P = ParamSpec("P")
T = TypeVar("T")
TIME_STEP, DURATION = 0.05, 60.0
# What is run for some time at least, lest figures be chance; more than that at once is run once.
REPEATED = 3375


class OwnDriver(Driver):
    """Keeps the target speed and ignores all others, as the first driver of the documentation."""

    def acceleration(self, situation: Situation) -> FloatArray:
        """Approach the target speed."""
        wanted = np.where(np.isfinite(situation.target_speed), situation.target_speed, 10.0)
        return np.clip(wanted - situation.speed, -3.0, 2.0)


@dataclass(frozen=True)
class Case:
    """A logical scenario, and who drives in it; ``own`` is a driver of NumPy's."""

    path: Path
    ranges: tuple[str, ...] = ()
    space: Path | None = None
    driver: str | None = None

    def concretes(self, count: int) -> list[ConcreteScenario]:
        """Draw so many concrete scenarios."""
        logical = LogicalScenario.read(self.path, self.space, self.ranges, continuous=True)
        points = Random().start(logical.space, 0).ask(count)
        return [logical.concrete_scenario(values) for values in logical.space.values(points)]

    def simulator(self) -> Builtin:
        """Make a simulator that has prepared nothing yet."""
        drivers = {} if self.driver is None else {"Ego": OwnDriver() if self.driver == "own" else self.driver}
        return Builtin(time_step=TIME_STEP, duration=DURATION, drivers=drivers)


@dataclass(frozen=True)
class Rate:
    """How fast scenarios were simulated."""

    scenarios: int
    failed: int
    seconds: float
    cpu: float
    first: float
    """s of wall time until a new simulator gave its first recording."""
    loop: float
    """s of CPU of the loop of NumPy's calls, the mean of before and after."""
    memory: float
    """MB, the most that the process held."""


def example(name: str) -> Case:
    return Case(EXAMPLES / name / f"{name}.xosc", space=EXAMPLES / name / f"{name}.space.xosc")


def numpy_loop() -> float:
    """Seconds of CPU of 200,000 calls of NumPy on arrays that are so small that the calls are what costs."""
    numbers, result = np.linspace(0.0, 1.0, 16), np.zeros(16)
    begun = time.process_time()
    for _ in range(100_000):
        np.add(numbers, 1.0, out=result)
        np.sin(numbers, out=result)
    return time.process_time() - begun


def most_memory() -> float:
    """MB that this process held at most; what the system tells of a process otherwise can be its parent's."""
    status = Path("/proc/self/status")
    if status.is_file():
        lines = status.read_text(encoding="ascii", errors="replace").splitlines()
        return float(next(line for line in lines if line.startswith("VmHWM")).split()[1]) / 1024
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (2**20 if sys.platform == "darwin" else 2**10)


def rate(case: Case, size: int, patience: float) -> Rate:
    """Simulate so many at once, again and again for so many seconds of CPU, once at least."""
    concretes = case.concretes(max(size, 100))
    chunks = [concretes[begin : begin + size] for begin in range(0, len(concretes) - size + 1, size)]
    with compile_at_once():
        simulator = case.simulator()
        for chunk in chunks:
            for _ in simulator.run(chunk):
                pass
    loop = numpy_loop()
    begun = time.perf_counter()
    simulator = case.simulator()
    list(simulator.run(concretes[:1]))
    first = time.perf_counter() - begun
    scenarios = failed = 0
    begun, cpu = time.perf_counter(), time.process_time()
    for chunk in cycle(chunks):
        failed += sum(isinstance(one, Exception) for one in simulator.run(chunk))
        scenarios += len(chunk)
        if time.process_time() - cpu > patience:
            break
    seconds, cpu = time.perf_counter() - begun, time.process_time() - cpu
    return Rate(scenarios, failed, seconds, cpu, first, (loop + numpy_loop()) / 2, most_memory())


def esmini_rate(case: Case, patience: float) -> Rate:
    """Run the same scenarios, for so many seconds of CPU, by esmini's library, one after the other."""
    lib = load_library(find_library_path(None))
    concretes = case.concretes(100)
    scenario = concretes[0].load_file()
    declared = scenario.root.iterfind("ParameterDeclarations/ParameterDeclaration")
    kinds = {one.get("name", ""): one.get("parameterType", "") for one in declared}
    steps = round(DURATION / TIME_STEP)
    loop, first, scenarios, failed = numpy_loop(), 0.0, 0, 0
    begun, cpu = time.perf_counter(), time.process_time()
    for concrete in cycle(concretes):

        def declare(_: object, values: ConcreteScenario = concrete) -> None:
            for name, value in values.values.items():
                set_parameter(lib, name, value, kinds.get(name, ""))

        callback = PARAMETER_CALLBACK(declare)
        lib.SE_RegisterParameterDeclarationCallback(callback, None)
        if lib.SE_Init(encode_esmini_path(concrete.path), 1, 0, 0, 0) != 0:
            failed += 1
        else:
            for _ in range(steps):
                lib.SE_StepDT(TIME_STEP)
                if lib.SE_GetQuitFlag() != 0:
                    break
        lib.SE_Close()
        scenarios += 1
        first = first or time.perf_counter() - begun
        if time.process_time() - cpu > patience:
            break
    seconds, cpu = time.perf_counter() - begun, time.process_time() - cpu
    return Rate(scenarios, failed, seconds, cpu, first, (loop + numpy_loop()) / 2, most_memory())


def apart(function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
    """Call in a process of its own, which begins anew."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(function, *args, **kwargs).result()


def of_esmini(case: Case, patience: float) -> Rate | None:
    if Esmini.availability().problem:
        return None
    try:
        found = apart(esmini_rate, case, patience)
    except BrokenProcessPool:
        print(f"esmini died of {case.path.name}.")
        return None
    return None if found.failed else found


def told(name: str, *words: str) -> None:
    print(f"{name:24}" + "".join(f"{word:>10}" for word in words), flush=True)


def tell_header() -> None:
    told("scenarios", "goal 1/s", "1/s", "1/CPU s", "per loop", "first s", "MB", "failed", "esmini", "times")


def row_of(name: str, goal: float | None, one: Rate, peer: Rate | None) -> dict[str, Any]:
    """Tell a row, and give what is kept of it."""
    speed, by_cpu = one.scenarios / one.seconds, one.scenarios / one.cpu
    slower = peer and peer.scenarios / peer.cpu
    told(
        name, f"{goal:,.0f}" if goal else "", f"{speed:,.1f}", f"{by_cpu:,.1f}", f"{by_cpu * one.loop:.2f}",
        f"{one.first:.3f}", f"{one.memory:.0f}", f"{one.failed}",
        *([f"{slower:.1f}", f"{by_cpu / slower:.1f}"] if slower else []),
    )  # fmt: skip
    return {"row": name, "goal": goal, "per second": speed, **asdict(one), "esmini": asdict(peer) if peer else None}


def name_of(size: int) -> str:
    return f"{size:,} at once" if size > 1 else "one at a time"


def tell_missing_esmini() -> None:
    if missing := Esmini.availability().problem:
        print(f"Without esmini: {missing}")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario", nargs="*")
    parser.add_argument("--driver", metavar="NAME", help="of the entity Ego, or 'own'")
    parser.add_argument("--quick", action="store_true", help="up to 1,000 at once, for 1 s of CPU each")
    parser.add_argument("--seconds", type=float, default=5.0, metavar="S")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    case, seconds = example("x_intersection"), 1.0 if options.quick else options.seconds
    if options.scenario:
        files = [Path(one) for one in options.scenario[:2] if "=" not in one]
        ranges = tuple(options.scenario[len(files) :])
        case = Case(files[0], ranges, files[1] if len(files) == 2 else None)
    case = replace(case, driver=options.driver)
    tell_missing_esmini()
    peer = of_esmini(case, seconds)
    tell_header()
    table = []
    for size in (1, 10, 100, 1000) if options.quick else (1, 10, 100, 1000, 3375, 10_000, 50_000):
        found = apart(rate, case, size, seconds if size <= REPEATED else 0.0)
        table.append(row_of(name_of(size), None, found, peer))
    for size in () if options.driver else (1, 10, 1000):
        for driver in ("normal", "own"):
            found = apart(rate, replace(case, driver=driver), size, seconds)
            table.append(row_of(f"{driver}, {name_of(size)}", None, found, None))
    if options.json:
        options.json.write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
