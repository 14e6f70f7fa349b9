"""How time and memory of each command grow with the number of scenarios.

    python benchmarks/scale.py [--quick] [--sizes N,…] [--level-set N,…] [--only COMMAND,…]
                               [--memory SIZE] [--folder FOLDER] [--tasks N] [--json FILE]

Each command runs in a process of its own: seconds of CPU (of the process and those that it started), of the clock, and
the most memory of any of them, in 10^9 bytes. The scenarios are those of the X-intersection, with the metrics ``wttc``
and ``trajectory-distance``, searched by ``sobol`` in rounds of 500; ``explore, level-set`` is a search by ``level-set``
for what is critical by the metric's own threshold, of the sizes of ``--level-set``. What is in FOLDER already is not
explored again, and has no time then. Commands run one after the other on as many cores as there are.

``analyze + reduce + report`` is the sum of the three, and at least 3,000 scenarios have goals for it. The exponent of a
command is the slope of a straight line through the logarithms of time or memory from 1,000 scenarios on; below that the
start of Python counts for most. The steepest one is that between two neighbouring sizes. kB are those of the explored
study per scenario.

``--tasks`` measures what a cluster adds to a scenario instead: a local cluster of Dask with one worker and a simulator
that returns at once.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
EXAMPLE = ROOT / "examples" / "x_intersection" / "x_intersection"
SIZES = (400, 1_000, 3_000, 10_000, 20_000, 50_000)
LEVEL_SET = (400, 1_000, 3_000)
FITTED_FROM = 1_000
PROGRAM = "import sys; from cornercase.cli import main; sys.exit(main())"
COLUMNS = ("CPU s", "clock s", "GB")
SUMMED = ("analyze", "reduce", "report")
TOTAL = " + ".join(SUMMED)
GOALS = {3_000: 15.0, 20_000: 100.0}
"""Most seconds of CPU of the three commands by number of scenarios."""


def measured(arguments: list[str]) -> dict[str, float]:
    """Run a command of cornercase in a process of its own."""
    begun = time.monotonic()
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    assert process.stderr is not None
    said = process.stderr.read()
    _, status, used = os.wait4(process.pid, 0)
    if status != 0:
        raise SystemExit(
            f"cornercase {' '.join(arguments)}: {said.strip().splitlines()[-1] if said.strip() else status}"
        )
    return {"CPU s": used.ru_utime + used.ru_stime, "clock s": time.monotonic() - begun, "GB": most_memory(used)}


def most_memory(used: resource.struct_rusage) -> float:
    return used.ru_maxrss * (1 if sys.platform == "darwin" else 1024) / 1e9


def explored(path: Path, count: int, search: str) -> dict[str, float] | None:
    """Explore so many scenarios, if that was not done before."""
    if path.exists():
        return None
    rounds = ["--batch", "500"] if search == "sobol" else []
    used = measured(
        ["explore", f"{EXAMPLE}.xosc", "--space", f"{EXAMPLE}.space.xosc", "--ego", "Ego", "--other", "Pedestrian",
         "--metric", "wttc", "--metric", "trajectory-distance", "--optimizer", search, "--seed", "1",
         "--budget", str(count), *rounds, "-o", str(path)]
    )  # fmt: skip
    return used | {"kB": path.stat().st_size / count / 1e3}


def commands(folder: Path, count: int, memory: str) -> dict[str, Callable[[], dict[str, float] | None]]:
    """What is measured of one size, by name."""
    source, study = folder / f"sobol{count}.db", folder / f"analysed{count}.db"
    scenario = ["--scenario", f"{EXAMPLE}.xosc"]
    bounded = ["--memory", memory]

    def analyzed() -> dict[str, float]:
        explored(source, count, "sobol")
        shutil.copyfile(source, study)
        return measured(["analyze", str(study), *bounded])

    return {
        "explore, sobol": lambda: explored(source, count, "sobol"),
        "analyze": analyzed,
        "reduce": lambda: measured(["reduce", str(study), *scenario, *bounded, "-o", str(folder / f"reduced{count}")]),
        "show": lambda: measured(["show", str(study)]),
        "report": lambda: measured(["report", str(study), *scenario, *bounded, "-o", str(folder / f"{count}.html")]),
    }


def exponent(sizes: list[int], values: list[float]) -> float | None:
    """Slope of a straight line through the logarithms."""
    known = [(size, value) for size, value in zip(sizes, values, strict=True) if size >= FITTED_FROM]
    if len(known) < 2:
        return None
    logarithms = np.log(np.array(known))
    return float(np.polyfit(logarithms[:, 0], logarithms[:, 1], 1)[0])


def fits(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The exponents of each command."""
    found = []
    for command in dict.fromkeys(row["command"] for row in rows):
        mine = [row for row in rows if row["command"] == command]
        sizes = [row["scenarios"] for row in mine]
        found.append(
            {"command": command}
            | {one: exponent(sizes, [row[one] for row in mine]) for one in COLUMNS}
            | {"steepest": steepest(sizes, [row["CPU s"] for row in mine])}
        )
    return found


def steepest(sizes: list[int], values: list[float]) -> float | None:
    """Largest exponent between two neighbouring sizes."""
    pairs = list(zip(sizes, values, strict=True))
    slopes = [exponent([a[0], b[0]], [a[1], b[1]]) for a, b in itertools.pairwise(pairs)]
    return max((slope for slope in slopes if slope is not None), default=None)


def total(rows: list[dict[str, Any]], count: int) -> dict[str, Any] | None:
    """What the three commands that follow an exploration took together."""
    mine = [row for row in rows if row["scenarios"] == count and row["command"] in SUMMED]
    if len(mine) < len(SUMMED):
        return None
    sums = {one: sum(row[one] for row in mine) for one in ("CPU s", "clock s")}
    return {
        "scenarios": count,
        "command": TOTAL,
        **sums,
        "GB": max(row["GB"] for row in mine),
        "goal": GOALS.get(count),
    }


def told(row: dict[str, Any], digits: int) -> str:
    cells = "".join(f"{'–' if row[one] is None else format(row[one], f'.{digits}f'):>12}" for one in COLUMNS)
    more = "".join(
        f"  {name} {row[key]:.{digits}f}"
        for name, key in (("goal", "goal"), ("steepest", "steepest"), ("kB", "kB"))
        if row.get(key) is not None
    )
    return f"{row.get('scenarios', 'exponent'):>9}  {row['command']:25}{cells}{more}"


def scaled(
    folder: Path, sizes: list[int], searched: list[int], only: list[str] | None, memory: str
) -> list[dict[str, Any]]:
    rows = []
    for count in sorted({*sizes, *searched}):
        chosen = commands(folder, count, memory) if count in sizes else {}
        if count in searched:
            path = folder / f"level-set{count}.db"
            chosen["explore, level-set"] = partial(explored, path, count, "level-set")
        for command, run in chosen.items():
            if only is not None and command.partition(",")[0] not in only:
                continue
            found = run()
            if found is not None:
                rows.append({"scenarios": count, "command": command} | found)
                print(told(rows[-1], 2), flush=True)
        if (sums := total(rows, count)) is not None:
            rows.append(sums)
            print(told(sums, 2), flush=True)
    return rows


def cluster_overhead(tasks: int) -> dict[str, float]:
    """What Dask adds to a scenario: seconds of the clock and of CPU, and bytes that are sent, for each."""
    # The workers have to find the simulator.
    here = str(Path(__file__).resolve().parent)
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [here, os.environ.get("PYTHONPATH")]))
    import psutil
    from distributed.protocol.core import dumps
    from distributed.protocol.serialize import to_serialize

    import cornercase as cc
    from at_once import Answer, AtOnceSimulator  # type: ignore[import-not-found]
    from cornercase.simulators._create import create_simulator
    from cornercase.simulators.dask._simulator import ClusterSimulator

    logical = cc.LogicalScenario.read(f"{EXAMPLE}.xosc", f"{EXAMPLE}.space.xosc")
    points = np.random.default_rng(0).random((tasks, logical.space.dimension))
    concretes = [logical.concrete_scenario(one) for one in logical.space.values(points)]
    begun = time.process_time()
    with create_simulator("builtin", {}) as builtin:
        recordings = list(builtin.run(concretes[:200]))
    alone = (time.process_time() - begun) / 200
    recording = recordings[0]
    answer = Answer(recording)
    sent = sum(memoryview(one).nbytes for one in dumps({"data": {"key": to_serialize([recording])}}))
    with ClusterSimulator(AtOnceSimulator.name, {"answer": answer}, "local", 1) as simulator:
        list(simulator.run(concretes[:20]))
        others = psutil.Process().children(recursive=True)
        before = cpu_of([psutil.Process(), *others])
        begun = time.monotonic()
        count = sum(1 for _ in simulator.run(concretes))
        clock = time.monotonic() - begun
        used = [after - earlier for after, earlier in zip(cpu_of([psutil.Process(), *others]), before, strict=True)]
    return {
        "tasks": count,
        "clock ms": 1e3 * clock / count,
        "CPU ms, client and scheduler": 1e3 * used[0] / count,
        "CPU ms, worker": 1e3 * sum(used[1:]) / count,
        "bytes of a recording": sent,
        "CPU ms of the builtin simulator": 1e3 * alone,
    }


def cpu_of(processes: list[Any]) -> list[float]:
    return [sum(one.cpu_times()[:2]) for one in processes]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="100 and 200 scenarios")
    parser.add_argument("--sizes", metavar="N,…", help="scenarios of the studies")
    parser.add_argument("--level-set", metavar="N,…", help="scenarios of the searches by level-set")
    parser.add_argument("--only", metavar="COMMAND,…", help="which commands, as explore,report; default: all")
    parser.add_argument("--memory", metavar="SIZE", default="4 GB", help="what a command may take")
    parser.add_argument("--folder", type=Path, help="where studies and reports are kept")
    parser.add_argument("--tasks", type=int, metavar="N", help="measure what a cluster adds to each of so many tasks")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()

    def counts(given: str | None, otherwise: tuple[int, ...]) -> list[int]:
        if given is None:
            return [100, 200] if options.quick else list(otherwise)
        return [int(one) for one in given.split(",") if one]

    if options.tasks is not None:
        found: Any = cluster_overhead(options.tasks)
        for name, value in found.items():
            print(f"{name:34}{value:>12.2f}" if math.isfinite(value) else name)
    else:
        print(f"{'scenarios':>9}  {'command':25}" + "".join(f"{one:>12}" for one in COLUMNS))
        with tempfile.TemporaryDirectory() as temporary:
            folder = options.folder or Path(temporary)
            folder.mkdir(parents=True, exist_ok=True)
            sizes, searched = counts(options.sizes, SIZES), counts(options.level_set, LEVEL_SET)
            rows = scaled(folder, sizes, searched, options.only and options.only.split(","), options.memory)
        for row in fits(rows):
            print(told(row, 2))
        found = {"rows": rows, "exponents": fits(rows)}
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
