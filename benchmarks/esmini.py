"""How far the builtin simulator agrees with esmini: within 0.25 m, 0.05 rad, 0.25 m/s and 0.15 s.

    python benchmarks/esmini.py [FOLDER] [--part NAME]… [--only TEXT] [--storyboards N] [--seed N] [--processes N]
        [--keep DIR] [--quick] [--json FILE]

FOLDER holds recordings of esmini: ``index.json`` names scenarios, parameter values and what esmini made of them, and
``random/`` holds storyboards with their recordings in ``random/expected/``. The parts are

- ``shared`` and ``random``: these recordings, in steps of 0.05 s;
- ``public``: each scenario file below FOLDER with five random sets of its parameters, drawn from the variation files
  that name it, or within 20 % of what it declares and within its constraints. A file of which nothing can be varied
  counts once;
- ``steps``: each of these files as it is, in steps of 0.01 s and of 0.1 s;
- ``storyboards``: N storyboards of a generator, on roads of its own.

The last three run esmini's library, which ``CORNERCASE_ESMINI`` names, with its own controllers switched off; without
it they are left out. What esmini itself cannot run is told, and does not count.
"""

from __future__ import annotations

import argparse
import json
import random
import re
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
from lxml import etree

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from cornercase import ConcreteScenario, InputError, LogicalScenario
from cornercase.recordings import Recording
from cornercase.scenario import Value
from cornercase.simulators import Builtin, Esmini
from cornercase.simulators.pool._simulator import WorkerSimulator
from helpers.esmini_agreement import Tracks, disagreement, last_instant, tracks_of, tracks_of_file
from helpers.random_storyboards import storyboard, write_roads

PARTS = ("shared", "random", "public", "steps", "storyboards")
SETS = 5
# s: how long esmini may take for a scenario.
PATIENCE = 120.0
# Elements and attributes that name a lane, a road or a catalog entry: a parameter there is no quantity.
NAMES = ("laneId", "roadId", "id", "dLane", "roadMark", "trackId", "entryName", "name", "entityRef", "signalId")
LANES = ("AbsoluteTargetLane", "RelativeTargetLane", "RelativeLaneRange")


@dataclass(frozen=True)
class Case:
    """Some concrete scenarios of one file, and what is known of esmini's recordings of them."""

    part: str
    rows: tuple[str, ...]
    path: Path
    values: tuple[dict[str, Value], ...]
    duration: float
    time_step: float = 0.05
    expected: Path | None = None


@dataclass(frozen=True)
class Row:
    """One comparison."""

    part: str
    row: str
    outcome: str
    """``matches``, ``differs``, or ``esmini fails``, which does not count."""
    why: str
    seconds: float
    parameters: dict[str, Value] = field(default_factory=dict)


def shared_cases(folder: Path) -> Iterator[Case]:
    for row in json.loads((folder / "index.json").read_text(encoding="utf-8")):
        name, expected = row["expected"].removesuffix(".csv"), folder / "expected" / row["expected"]
        yield Case("shared", (name,), folder / row["scenario"], (row["parameters"],), 40.0, expected=expected)


def random_cases(folder: Path) -> Iterator[Case]:
    for path in sorted((folder / "random").glob("*.xosc")):
        expected = path.parent / "expected" / f"{path.stem}.csv"
        yield Case("random", (path.stem,), path, ({},), 20.0, expected=expected)


@cache
def scenario_files(folder: Path) -> dict[Path, list[Path]]:
    """Scenario files below a folder, each with the variation files that name it."""
    found: dict[Path, list[Path]] = {}
    variations = []
    for path in sorted(folder.rglob("*.xosc")):
        if folder / "random" in path.parents:
            continue
        root = etree.parse(path).getroot()
        if root.find("Storyboard") is not None:
            found[path.resolve()] = []
        elif (file := root.find("ParameterValueDistribution/ScenarioFile")) is not None:
            variations.append((path, (path.parent / file.get("filepath", "")).resolve()))
    for path, scenario in variations:
        if scenario in found:
            found[scenario].append(path)
    return found


def parameter_sets(path: Path, variations: list[Path], seed: int) -> list[dict[str, Value]]:
    """Draw sets of parameters, all different; a single empty one where nothing can be varied."""
    rng = np.random.default_rng([seed, *path.name.encode()])
    drawn: list[dict[str, Value]] = []
    for _ in range(SETS):
        try:
            if variations:
                logical = LogicalScenario.read(path, variations[rng.integers(len(variations))])
            elif ranges := _ranges_around(path):
                logical = LogicalScenario.read(path, ranges=ranges)
            else:
                return [{}]
        except InputError:
            return [{}]
        points = rng.random((64, logical.space.dimension))
        (admitted,) = np.nonzero(logical.space.is_admissible(points))
        if admitted.size:
            (values,) = logical.space.values(points[admitted[:1]])
            rounded = {k: round(v, 4) if isinstance(v, float) else v for k, v in values.items()}
            if rounded not in drawn:
                drawn.append(rounded)
    return drawn or [{}]


def _ranges_around(path: Path) -> list[str]:
    """Ranges of 20 % around the numbers that a file declares, but for those that stand where names do."""
    root = etree.parse(path).getroot()
    named = {
        name
        for element in root.iter("*")
        for key, text in element.attrib.items()
        for name in re.findall(r"\$\{?\s*(\w+)", str(text))
        if (key in NAMES and element.tag != "ParameterDeclaration") or element.tag in LANES
    }
    ranges = []
    for declared in root.iterfind("ParameterDeclarations/ParameterDeclaration"):
        name, kind = declared.get("name", ""), declared.get("parameterType", "")
        try:
            value = float(declared.get("value", ""))
        except ValueError:
            continue
        low, high = sorted((0.8 * value, 1.2 * value))
        if name in named or kind not in ("double", "integer", "int", "unsignedInt", "unsignedShort"):
            continue
        if kind == "double" and low < high:
            ranges.append(f"{name}={low!r}:{high!r}")
        elif kind != "double" and round(low) < round(high):
            ranges.append(f"{name}={round(low)}:{round(high)}:1")
    return ranges


def public_cases(folder: Path, seed: int) -> Iterator[Case]:
    for path, variations in scenario_files(folder).items():
        values = parameter_sets(path, variations, seed)
        name = str(path.relative_to(folder.resolve()).with_suffix(""))
        yield Case("public", tuple(f"{name} #{k}" for k in range(len(values))), path, tuple(values), 40.0)


def step_cases(folder: Path) -> Iterator[Case]:
    for path in scenario_files(folder):
        name = str(path.relative_to(folder.resolve()).with_suffix(""))
        for step in (0.01, 0.1):
            yield Case("steps", (f"{name} @{step:g}",), path, ({},), 40.0, step)


def storyboard_cases(folder: Path, number: int, seed: int) -> Iterator[Case]:
    write_roads(folder)
    for k in range(number):
        path = folder / f"s{seed}-{k:04}.xosc"
        path.write_text(storyboard(random.Random(f"{seed}-{k}")), encoding="utf-8")
        yield Case("storyboards", (path.stem,), path, ({},), 20.0)


_esmini: WorkerSimulator | None = None


def run_esmini(case: Case, number: int) -> Tracks | str:
    """Tracks of one concrete scenario, or why esmini has none."""
    global _esmini
    settings = {"time_step": case.time_step, "duration": case.duration, "controllers": False, "undriven": True}
    if _esmini is None or _esmini.settings != Esmini(**settings).settings:  # type: ignore[arg-type]
        if _esmini is not None:
            _esmini.close()
        _esmini = WorkerSimulator("esmini", settings, timeout=PATIENCE, retries=0)
    try:
        (result,) = _esmini.run([ConcreteScenario(case.path, case.values[number])])
    except InputError as error:
        # After five failures in a row it gives up.
        _esmini.close()
        _esmini = None
        return str(error)
    return tracks_of(result) if isinstance(result, Recording) else str(result)


def judge(case: Case) -> list[Row]:
    """Compare all concrete scenarios of a case, which run at once: alone they give the same bytes."""
    sets = list(zip(case.rows, case.values, strict=True))
    tracks = [
        run_esmini(case, number) if case.expected is None else tracks_of_file(case.expected)
        for number in range(len(sets))
    ]
    known = [number for number, one in enumerate(tracks) if not isinstance(one, str)]
    begun = time.perf_counter()
    found = run_builtin(case, known, [one for one in tracks if not isinstance(one, str)])
    seconds = (time.perf_counter() - begun) / max(len(known), 1)
    rows = []
    for number, (name, values) in enumerate(sets):
        expected = tracks[number]
        if isinstance(expected, str):
            rows.append(Row(case.part, name, "esmini fails", expected, 0.0, values))
            continue
        result = found[known.index(number)]
        why = disagreement(expected, result) if isinstance(result, Recording) else result
        why = re.sub(r"^\S*/", "", why)
        rows.append(Row(case.part, name, "differs" if why else "matches", why, seconds, values))
    return rows


def run_builtin(case: Case, known: list[int], expected: list[Tracks]) -> list[Recording | str]:
    """Recordings of some concrete scenarios, or why there is none."""
    if not known:
        return []
    # A step longer than the expected recordings, so that one that goes on is seen to.
    duration = min(case.duration, max(map(last_instant, expected)) + 1.0)
    try:
        simulator = Builtin(time_step=case.time_step, duration=duration)
        results = simulator.run([ConcreteScenario(case.path, case.values[number]) for number in known])
    except InputError as error:
        return [str(error)] * len(known)
    except Exception as error:  # what breaks the engine is a row of the table, not its end
        return [f"{type(error).__name__}: {error}"] * len(known)
    return [one if isinstance(one, Recording) else str(one) for one in results]


def all_cases(options: argparse.Namespace, storage: Path) -> Iterator[Case]:
    """Cases of the parts that were asked for and can be run."""
    folder: Path | None = options.folder
    try:
        Esmini()
    except InputError as error:
        runs_esmini = False
        print(f"Only recordings are compared: {error}")
    else:
        runs_esmini = True
    if folder is None:
        print("No folder of esmini's recordings and scenarios was given.")
    if folder is not None and "shared" in options.part:
        yield from shared_cases(folder)
    if folder is not None and "random" in options.part:
        yield from random_cases(folder)
    if folder is not None and runs_esmini and "public" in options.part:
        yield from public_cases(folder, options.seed)
    if folder is not None and runs_esmini and "steps" in options.part:
        yield from step_cases(folder)
    if runs_esmini and "storyboards" in options.part:
        yield from storyboard_cases(storage, options.storyboards, options.seed)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--part", action="append", choices=PARTS, help="by default all")
    parser.add_argument("--only", default="", help="rows that have this in their name")
    parser.add_argument("--storyboards", type=int, default=2000, metavar="N")
    parser.add_argument("--seed", type=int, default=0, help="of parameter sets and storyboards")
    parser.add_argument("--processes", type=int, default=1, metavar="N")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="where the storyboards are written")
    parser.add_argument("--quick", action="store_true", help="every ninth file, and 20 storyboards")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    options.part = options.part or list(PARTS)
    options.storyboards = min(options.storyboards, 20) if options.quick else options.storyboards
    table: list[Row] = []
    with tempfile.TemporaryDirectory() as storage, ProcessPoolExecutor(options.processes) as pool:
        keep = options.keep or Path(storage)
        keep.mkdir(parents=True, exist_ok=True)
        cases = list(all_cases(options, keep))
        cases = [case for case in cases if any(options.only in row for row in case.rows)]
        if options.quick:
            cases = [case for k, case in enumerate(cases) if k % 9 == 0 or case.part == "storyboards"]
        for rows in pool.map(judge, cases):
            for one in rows:
                mark = {"matches": "ok ", "differs": "OFF", "esmini fails": "-- "}[one.outcome]
                print(f"{mark} {one.seconds:6.2f} s  {one.part:11}  {one.row}  {one.why}", flush=True)
            table += rows
    for part in PARTS:
        outcomes = [one.outcome for one in table if one.part == part]
        if counted := len(outcomes) - outcomes.count("esmini fails"):
            matching, failing = outcomes.count("matches"), outcomes.count("esmini fails")
            left_out = f"; {failing} that esmini does not run" if failing else ""
            print(f"{part:11}  {matching} of {counted} match ({matching / counted:.1%}){left_out}")
    if options.json:
        options.json.write_text(json.dumps([asdict(one) for one in table], indent=2) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
