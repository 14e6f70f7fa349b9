"""What becomes of files that nobody here wrote: scenarios, and roads lane by lane.

    python benchmarks/wild.py FOLDER [--part NAME]… [--only TEXT] [--processes N] [--quick] [--json FILE]

FOLDER holds scenarios and roads of several sources, each in a tree of its own. ``index.json`` names the scenarios and
esmini's recordings of them (in ``expected/``, in steps of 0.05 s, with its own controllers switched off), and where
esmini was found wrong. ``lane_centres.csv.gz`` holds where CARLA's map and esmini's road manager have lane centres. The
parts are

- ``scenarios``: each scenario, run by the builtin simulator and compared with its recording within 0.25 m, 0.05 rad,
  0.25 m/s and 0.15 s. A file of CARLA's, which esmini reads in other axes, has no recording to agree with;
- ``lanes``: each lane centre, within 1 cm of CARLA's or of esmini's; those that are not, by the reason, as far as it
  follows from the road: lanes by borders, lanes of a road that leans, and the like. Where some centres of a file are on
  roads that it lacks, all of them come from another version of it, and are counted apart;
- ``driving``: each lane of each road: whether it can be driven, and whether steps of 0.05 s with 10 m/s from places all
  along it are right within 0.1 % over ground, but for those over a place where the lane jumps aside.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from cornercase import ConcreteScenario, InputError
from cornercase.recordings import Recording
from cornercase.roads._network import RoadNetwork
from cornercase.simulators import Builtin
from helpers.esmini_agreement import disagreement, last_instant, tracks_of_file
from helpers.lane_centres import OTHER_VERSION, compare_centres, read_centres
from helpers.lane_driving import drive_lanes

PARTS = ("scenarios", "lanes", "driving")
# Of the speed that a lane is driven with.
EXACT = 1e-3


@dataclass(frozen=True)
class Row:
    """What became of a scenario, or of a road file."""

    part: str
    name: str
    outcome: str
    why: str = ""
    points: int = 0
    """Lane centres or lanes that were looked at."""
    good: int = 0
    seconds: float = 0.0
    explained: dict[str, int] = field(default_factory=dict)
    """Lane centres that are elsewhere, by the reason."""


def judge_scenario(folder: Path, entry: dict[str, object]) -> Row:
    """Run a scenario and compare it with esmini's recording, if there is one."""
    name = f"{entry['source']}/{entry['path']}"
    path, recorded = folder / name, entry.get("expected")
    expected = tracks_of_file(folder / "expected" / str(recorded)) if recorded else {}
    begun = time.perf_counter()
    outcome, why = "", ""
    try:
        duration = min(last_instant(expected) + 1.0, 30.0) if expected else 30.0
        (result,) = Builtin(duration=duration).run([ConcreteScenario(path, {})])
        if not isinstance(result, Recording):
            outcome, why = "fails", str(result)
        elif not expected:
            outcome = "runs"
        else:
            why = disagreement(expected, result)
            outcome = "agrees" if not why else "differs"
    except InputError as error:
        outcome, why = "refused", str(error)
    except Exception as error:  # what breaks the engine is a row of the table, not its end
        outcome, why = "crashes", f"{type(error).__name__}: {error}"
    if outcome == "differs" and (known := _not_comparable(path, entry)):
        outcome, why = "not comparable", known
    elif not expected and outcome in ("refused", "fails"):
        outcome += " as esmini does"
    return Row("scenarios", name, outcome, why.replace(f"{folder}/", ""), seconds=time.perf_counter() - begun)


def _not_comparable(path: Path, entry: dict[str, object]) -> str:
    """Why esmini's recording of a scenario says nothing; empty where it does."""
    if entry.get("esmini_differs"):
        return str(entry["esmini_differs"])
    header = path.read_text(encoding="utf-8", errors="replace").partition("<Entities")[0]
    return "esmini does not turn the axes of a file of CARLA's" if 'description="CARLA:' in header else ""


def judge_centres(folder: Path, name: str, points: list[dict[str, str]]) -> Row:
    """Compare lane centres of a road file with those of CARLA and of esmini."""
    begun = time.perf_counter()
    try:
        centres = compare_centres(RoadNetwork.read(folder / name), points)
    except InputError as error:
        return Row("lanes", name, "refused", str(error).replace(f"{folder}/", ""), len(points))
    why = "; ".join([*centres.off[:3], *(f"{reason}: {count}" for reason, count in centres.explained.items())])
    outcome = "differs" if centres.off else "explained" if centres.explained else "agrees"
    seconds = time.perf_counter() - begun
    return Row("lanes", name, outcome, why, len(points), centres.good, seconds, centres.explained)


def judge_roads(folder: Path, path: Path) -> Row:
    """Drive every lane of a road file."""
    name, begun = str(path.relative_to(folder)), time.perf_counter()
    try:
        lanes = list(drive_lanes(RoadNetwork.read(path)))
    except InputError as error:
        return Row("driving", name, "refused", str(error).replace(f"{folder}/", ""))
    except Exception as error:
        return Row("driving", name, "crashes", f"{type(error).__name__}: {error}")
    wrong = [lane for lane in lanes if lane.crash or lane.error > EXACT]
    crashed = any(lane.crash for lane in wrong)
    outcome = "crashes" if crashed else "wrong speed" if wrong else "drives"
    why = "; ".join(map(str, sorted(wrong, key=lambda lane: -lane.error)[:3]))
    return Row("driving", name, outcome, why, len(lanes), len(lanes) - len(wrong), time.perf_counter() - begun)


def cases(options: argparse.Namespace) -> Iterator[partial[Row]]:
    """What there is to look at, of the parts that were asked for."""
    folder: Path = options.folder
    found: list[tuple[str, str, partial[Row]]] = []
    for entry in json.loads((folder / "index.json").read_text(encoding="utf-8")):
        if entry["kind"] == "scenario":
            found.append(("scenarios", str(entry["path"]), partial(judge_scenario, folder, entry)))
    centres = read_centres(folder / "lane_centres.csv.gz")
    found += [("lanes", name, partial(judge_centres, folder, name, points)) for name, points in centres.items()]
    found += [("driving", str(path), partial(judge_roads, folder, path)) for path in sorted(folder.rglob("*.xodr"))]
    for part in options.part:
        chosen = [case for of, name, case in found if of == part and options.only in name]
        yield from chosen[:: 9 if options.quick else 1]


def summary(table: Iterable[Row]) -> dict[str, float]:
    """Figures of all parts."""
    rows = list(table)
    outcomes = Counter((row.part, row.outcome) for row in rows)
    figures: dict[str, float] = {}
    counted = {key: outcomes["scenarios", key] for key in ("agrees", "differs", "not comparable", "refused", "fails")}
    crashes = outcomes["scenarios", "crashes"]
    if esmini_runs := sum(counted.values()) + crashes:
        accepted = counted["agrees"] + counted["differs"] + counted["not comparable"]
        compared = counted["agrees"] + counted["differs"]
        figures |= {
            "scenarios that esmini runs": esmini_runs, "accepted": accepted, "compared": compared,
            "agreeing": counted["agrees"], "crashes of scenarios": crashes,
        }  # fmt: skip
    for part, what in (("lanes", "lane centres"), ("driving", "lanes driven")):
        mine = [row for row in rows if row.part == part]
        if mine:
            figures |= {
                f"road files of {what}": len(mine), f"refused of {what}": outcomes[part, "refused"],
                f"crashes of {what}": outcomes[part, "crashes"],
                what: sum(row.points - row.explained.get(OTHER_VERSION, 0) for row in mine),
                f"good {what}": sum(row.good for row in mine),
            }  # fmt: skip
        reasons: Counter[str] = Counter()
        for row in mine:
            reasons.update(row.explained)
        figures |= {f"{what} {reason}": count for reason, count in reasons.items()}
    return figures


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--part", action="append", choices=PARTS, help="by default all")
    parser.add_argument("--only", default="", help="files that have this in their name")
    parser.add_argument("--processes", type=int, default=1, metavar="N")
    parser.add_argument("--quick", action="store_true", help="every ninth file")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    options.part = options.part or list(PARTS)
    table: list[Row] = []
    if options.folder is None or not (options.folder / "index.json").is_file():
        print("No folder of others' scenarios and roads was given.")
        return 0
    with ProcessPoolExecutor(options.processes) as pool:
        for future in [pool.submit(case) for case in cases(options)]:
            row = future.result()
            print(f"{row.outcome:15} {row.seconds:6.2f} s  {row.part:9}  {row.name}  {row.why}", flush=True)
            table.append(row)
    figures = summary(table)
    for name, figure in figures.items():
        print(f"{figure:<8g} {name}")
    if options.json:
        rows = [asdict(row) for row in table]
        options.json.write_text(json.dumps({"figures": figures, "rows": rows}, indent=2) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
