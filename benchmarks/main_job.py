"""What one waits for who explores: scenarios simulated, whole explorations, the demonstration, a proposal.

    python benchmarks/main_job.py [--quick] [--only TEXT]… [--ncap FOLDER] [--seconds S] [--json FILE]

The rows, of which ``--only`` takes those that begin so:

- ``x/…``, ``t/…``: the X-intersection and the T-intersection of the examples, with their driver ``normal``; one at a
  time, in rounds of ten, 100 and 3,375 at once;
- ``cpnco/…``, ``cpnco-normal/…``, ``ccftap/…``: the same of Euro NCAP's CPNCO and CCFtap as their storyboards have it,
  and of CPNCO with the driver ``normal``; FOLDER holds ``CA-FC_2026``;
- ``growth/…``: 100 to 50,000 at once of the X-intersection and of CPNCO, with the most memory that is held (not with
  ``--quick``);
- ``explore/…``, ``demo``, ``simulate``: commands, with the start of their process, after they were run once;
- ``propose/…``: a proposal, and the critical set judged, as `benchmarks/proposals.py` measures them, in seconds of CPU.

Scenarios, esmini's library beside them and the columns are as in `benchmarks/engine.py`. Commands and proposals are
given in ``loops`` too, as many as its loop of NumPy's calls does in their seconds of CPU.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from cornercase.optimizers import Bayes, LevelSet

ROOT = Path(__file__).resolve().parents[1]
NCAP = ROOT.parent / "shared" / "reference" / "openscenario" / "ncap" / "OpenSCENARIO" / "NCAP"
sys.path.insert(0, str(ROOT))

from benchmarks.engine import (  # noqa: E402
    Case,
    Rate,
    apart,
    example,
    numpy_loop,
    of_esmini,
    rate,
    row_of,
    tell_header,
    tell_missing_esmini,
    told,
)
from benchmarks.proposals import SPACE, THRESHOLD, judged, proposals  # noqa: E402

Row = dict[str, Any]
WAYS = {"one": 1, "rounds": 10, "100": 100, "3375": 3375}
# Scenarios in a second, and seconds, on 2 cores.
GOALS = {
    "x/rounds": 300.0, "x/one": 60.0, "x/3375": 3000.0, "cpnco/3375": 15000.0, "ccftap/3375": 10000.0,
    "explore/bayes": 8.0, "explore/level-set": 5.0, "demo": 15.0, "simulate": 1.0,
    "propose/bayes 400": 0.01, "propose/bayes 2000": 0.01, "propose/level-set 2000": 0.02, "propose/judged 2000": 0.5,
}  # fmt: skip


def cases(ncap: Path) -> dict[str, Case]:
    cpnco, ccftap = ncap / "CA-FC_2026" / "CPNCO.xosc", ncap / "CA-FC_2026" / "CCFtap.xosc"
    varied = ("Ego_speed_kph=10:60", "ImpactLocation=10:90", "VRU_finalSpeed_kph=3:8")
    return {
        "x": example("x_intersection"),
        "t": example("t_intersection"),
        "cpnco": Case(cpnco, varied),
        "cpnco-normal": Case(cpnco, varied, driver="normal"),
        "ccftap": Case(ccftap, ("Target_final_speed_kph=30:60",)),
    }


def command(arguments: Sequence[str]) -> tuple[float, float]:
    """Seconds of a command of cornercase, and its seconds of CPU, from the start of its process on."""
    begun, before = time.perf_counter(), os.times()
    program = [sys.executable, "-c", "from cornercase.cli import main; main()", *arguments]
    if (ran := subprocess.run(program, capture_output=True, text=True)).returncode != 0:
        raise SystemExit(f"cornercase {' '.join(arguments)}: {ran.stderr}")
    seconds, after = time.perf_counter() - begun, os.times()
    return seconds, after.children_user + after.children_system - before.children_user - before.children_system


def arguments_of(name: str, budget: int, folder: str) -> list[str]:
    """What is run, and writes to a folder."""
    case = example("x_intersection")
    what, _, optimizer = name.partition("/")
    if what == "simulate":
        return ["simulate", str(case.path), "--set", "ego_start=40", "-o", f"{folder}/recording.csv"]
    if what == "demo":
        return ["demo", "x-intersection", "--budget", f"{budget}", "-o", f"{folder}/demo"]
    return [
        "explore", str(case.path), "--space", str(case.space), "--ego", "Ego", "--other", "Pedestrian",
        "--metric", "wttc", "--metric", "trajectory-distance", "--optimizer", optimizer, "--budget", f"{budget}",
        "-o", f"{folder}/study.db",
    ]  # fmt: skip


def of_proposals(what: str, quick: bool) -> float:
    """Seconds of CPU of a proposal, or of one judgement of the critical set."""
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1):
        # What is imported and compiled when it is first called is no part of a proposal.
        proposals(Bayes().start(SPACE, 0), 40, 1)
        proposals(LevelSet().start(SPACE, 0, threshold=THRESHOLD), 40, 1)
        kind, known = what.split()
        if kind == "judged":
            return judged(int(known), 1 if quick else 3)
        made = Bayes().start(SPACE, 0) if kind == "bayes" else LevelSet().start(SPACE, 0, threshold=THRESHOLD)
        return proposals(made, int(known), 5 if quick else 50)["seconds"]


def simulations(chosen: list[str], options: argparse.Namespace) -> Iterator[Row]:
    known = cases(options.ncap)
    peers: dict[str, Rate | None] = {}
    tell_missing_esmini()
    tell_header()
    for name in chosen:
        *growth, key, way = name.split("/")
        case = known[key]
        if not case.path.is_file():
            print(f"{name:24} left out: {case.path} is not there; --ncap names the folder of CA-FC_2026.")
            continue
        if key not in peers:
            peers[key] = of_esmini(case, options.seconds)
        # What grows is run once, and not again until the time is over.
        found = apart(rate, case, WAYS.get(way) or int(way), 0.0 if growth else options.seconds)
        yield row_of(name, GOALS.get(name), found, peers[key])


def waits(chosen: list[str], options: argparse.Namespace) -> Iterator[Row]:
    told("commands", "goal s", "s", "CPU s", "loops")
    loop = apart(numpy_loop)
    for name in chosen:
        spent = []
        # The first compiles where a machine has not yet, and is not counted.
        for budget in (20, *[60 if options.quick else 400] * (3 if name == "simulate" else 1)):
            with tempfile.TemporaryDirectory() as folder:
                spent.append(command(arguments_of(name, budget, folder)))
        seconds, cpu = sorted(spent[1:])[len(spent[1:]) // 2]
        goal = None if options.quick and name != "simulate" else GOALS[name]
        told(name, "" if goal is None else f"{goal:g}", f"{seconds:.2f}", f"{cpu:.2f}", f"{cpu / loop:.1f}")
        yield {"row": name, "goal": goal, "seconds": seconds, "cpu": cpu, "loop": loop}


def asked_of_optimizers(chosen: list[str], options: argparse.Namespace) -> Iterator[Row]:
    told("proposals", "goal s", "CPU s", "loops")
    loop = apart(numpy_loop)
    for name in chosen:
        cpu = apart(of_proposals, name.partition("/")[2], options.quick)
        told(name, f"{GOALS[name]:g}", f"{cpu:.4f}", f"{cpu / loop:.4f}")
        yield {"row": name, "goal": GOALS[name], "cpu": cpu, "loop": loop}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="less time, 60 in place of 400 explored, no growth")
    parser.add_argument("--only", action="append", metavar="TEXT", help="rows that begin so")
    parser.add_argument("--ncap", type=Path, default=NCAP, metavar="FOLDER", help="folder of CA-FC_2026")
    parser.add_argument("--seconds", type=float, metavar="S", help="of CPU for each row of scenarios, at least")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    options.seconds = options.seconds or (1.0 if options.quick else 5.0)
    simulated = [f"{key}/{way}" for key in cases(options.ncap) for way in WAYS]
    if not options.quick:
        simulated += [f"growth/{key}/{size}" for key in ("x", "cpnco") for size in (100, 1000, 10_000, 50_000)]
    parts = [
        (simulations, simulated),
        (waits, ["explore/bayes", "explore/level-set", "demo", "simulate"]),
        (asked_of_optimizers, [name for name in GOALS if name.startswith("propose/")]),
    ]
    asked = tuple(options.only or [""])
    if not any(name.startswith(asked) for _, names in parts for name in names):
        parser.error(f"no row begins with {' or '.join(asked)}.")
    table: list[Row] = []
    for part, names in parts:
        if chosen := [name for name in names if name.startswith(asked)]:
            table += part(chosen, options)
    if options.json:
        options.json.write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
