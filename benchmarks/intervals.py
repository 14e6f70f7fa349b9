"""How often the intervals of a critical set hold on simulated scenarios, how wide they are, and when searches stop.

python benchmarks/intervals.py [--half choose|judge] [--only NAME]… [--search NAME]… [--seeds N] [--sizes N …]
                               [--first SEED] [--process] [--stop] [--steps N] [--truth FOLDER] [--runs FOLDER]
                               [--json FILE] --ncap FOLDER --alks FOLDER

The scenarios, their truths and searches are those of benchmarks/exploration.py, and more of Euro NCAP and UN
Regulation 157. Thresholds of the latter are the score of their own truth below which a given share of the space lies.
What a search ran is kept in the folder of --runs, so that judging again runs no search. Constants may be chosen with
the scenarios of the half ``choose``; what the docs say is of the half ``judge``.

With ``--process`` the features of recordings are left out, and the Gaussian process of the scores judges alone. With
``--stop`` the criterion ``missed<0.05`` is tested after every 20 scenarios, with several probabilities: how often it
was fulfilled although more was missed, and how often within 1.5 times the number of scenarios from which on less than
4 % was missed.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from cornercase.evidence._critical_set_estimate import CriticalSet
from cornercase.evidence._multi_fidelity import SourceStudyModel
from cornercase.exploration._study_critical_set import is_score_independent
from cornercase.metrics import registered_features
from cornercase.study._criterion import Criterion

# Beside this file; mypy knows it by its package.
from exploration import (  # type: ignore[attr-defined]
    CASES,
    EXAMPLES,
    SEARCHES,
    Case,
    Folders,
    Judge,
    truth,
)
from exploration import CHOOSE as CHOOSE_FIRST  # type: ignore[attr-defined]
from exploration import JUDGE as JUDGE_FIRST  # type: ignore[attr-defined]

SIZES = (60, 100, 200, 400)
STOP, REACHED, LOOK = 0.05, 0.04, 20
CONFIDENCES = (0.95, 0.9, 0.8, 0.7, 0.6, 0.5)

# Critical is negative where it is the share of the space.
CHOOSE = {
    "cbla": Case(
        "CA-FC_2026/CBLA.xosc", "Target", "wttc", -0.05,
        ("Ego_speed_kph=30:80", "Target_final_speed_kph=10:25", "ImpactLocation=10:90"), "aggressive", of="ncap",
    ),
    "cbna": Case(
        "CA-FC_2026/CBNA.xosc", "VRU", "wttc", -0.08,
        ("Ego_speed_kph=10:60", "VRU_finalSpeed_kph=8:25", "ImpactLocation=10:90"), "normal", of="ncap",
    ),
    "deceleration": Case(
        "r157/deceleration.xosc", "Other", "ttc", -0.1, ("ego_kmh=60:130", "gap=8:60", "deceleration=1:9"), "normal",
    ),
    "ccr": Case(
        "AEB_C2C_2023/NCAP_AEB_C2C_CCR_2023.xosc", "GVT", "ttc", -0.06,
        ("Ego_speed_kph=20:80", "GVT_init_speed_kph=0:40", "Overlap=10:100"), "aggressive", of="ncap",
    ),
    "unavoidable cut-in": Case(
        "alks_scenario_4_4_2_cut_in_unavoidable_collision_template.xosc", "CutInVehicle", "ttc", -0.04,
        ("Ego_InitSpeed_Ve0_kph=30:60", "CutInVehicle_RelativeInitSpeed_Ve0_Vo0_kph=-40:-5",
         "CutInVehicle_HeadwayDistanceTrigger_dx0_m=3:40", "CutInVehicle_LaneChange_MaxLateralVelocity_Vy_mps=0.5:3"),
        "aggressive", of="alks",
    ),
    "cpnco, four": Case(
        "CA-FC_2026/CPNCO.xosc", "VRU", "wttc", -0.05,
        ("Ego_speed_kph=10:60", "VRU_finalSpeed_kph=3:10", "ImpactLocation=10:90", "VRU_initLatDist=3:8"),
        "aggressive", of="ncap",
    ),
}  # fmt: skip
JUDGE = {
    "cbfa": Case(
        "CA-FC_2026/CBFA.xosc", "VRU", "wttc", -0.06,
        ("Ego_speed_kph=10:60", "VRU_finalSpeed_kph=8:25", "VRU_lateralDist=0.5:3"), "normal", of="ncap",
    ),
    "cut-in at speed": Case(
        "r157/cut_in.xosc", "Other", "ttc", -0.08,
        ("ego_kmh=60:130", "other_kmh=30:90", "gap=5:60", "lateral_speed=0.5:3"), "normal",
    ),
    "cut-out at speed": Case(
        "r157/cut_out.xosc", "Standing", "ttc", -0.05,
        ("ego_kmh=60:130", "gap=10:60", "front_gap=10:80", "lateral_speed=0.5:3"), "cautious",
    ),
    "emergency brake": Case(
        "alks_scenario_4_3_2_follow_lead_vehicle_emergency_brake_template.xosc", "LeadVehicle", "ttc", -0.1,
        ("Ego_InitSpeed_Ve0_kph=20:60", "LeadVehicle_Init_HeadwayTime_s=0.6:3",
         "LeadVehicle_Deceleration_Rate_mps2=2:9.81"), "normal", of="alks",
    ),
    "cpra": Case(
        "AEB_VRU_2023/NCAP_AEB_VRU_CPRA_Cm_2023.xosc", "VRU", "clearance", -0.05,
        ("Ego_speed_kph=3:15", "VRU_finalSpeed_kph=3:8", "VRU_collisionDist=3:8"), "normal", of="ncap",
    ),
    "ccftap, normal": Case(
        "CA-FC_2026/CCFtap.xosc", "Target", "clearance", -0.06,
        ("Ego_speed_kph=10:25", "Target_final_speed_kph=30:60", "Trajectory_R2=9:15"), "normal", of="ncap",
    ),
}  # fmt: skip
HALVES = {"choose": CHOOSE_FIRST | CHOOSE, "judge": JUDGE_FIRST | JUDGE}
CASES.update(CHOOSE | JUDGE)


def settle_threshold(name: str, folders: Folders, steps: int, folder: Path) -> None:
    """Replace a share by the score below which that share of the scenarios lies."""
    case = CASES[name]
    if case.critical < 0.0:
        scores = truth(name, folders, steps, folder)[:, 0]
        CASES[name] = replace(case, critical=float(np.nanquantile(scores, -case.critical)))


def path_of_run(folder: Path, name: str, steps: int, kind: str, seed: int) -> Path:
    """File of the places of one search of one scenario, in the folder of --runs."""
    return folder / f"{name.replace(', ', '-').replace(' ', '-')}-{steps}" / f"{kind.replace(', ', '-')}-{seed}.npy"


def run_search(judge: Judge, kind: str, seed: int, size: int, path: Path) -> npt.NDArray[np.int64]:
    """Places of the scenarios in the order in which a search ran them, kept in a file."""
    if path.exists():
        kept: npt.NDArray[np.int64] = np.load(path)
        if len(kept) >= size:
            return kept[:size]
    optimizer: Any = SEARCHES[kind](judge.space, seed, judge.case.critical, size)
    points = np.zeros((0, judge.space.dimension))
    while len(points) < size:
        new = optimizer.ask(min(10, size - len(points)))
        if not len(new):
            break
        at = judge.places(new)
        more = (judge.features[at],) if "features" in optimizer.requires else ()
        optimizer.tell(new, judge.scores[at], *more)
        points = np.concatenate([points, new])
    path.parent.mkdir(parents=True, exist_ok=True)
    places: npt.NDArray[np.int64] = judge.places(points)
    np.save(path, places)
    return places


def judge_at(
    judge: Judge, kind: str, seed: int, places: npt.NDArray[np.int64], with_features: bool,
    source: SourceStudyModel | None = None,
) -> dict[str, Any]:  # fmt: skip
    """What is said of the critical set after these scenarios, and whether it is so; `source` is of a warm start."""
    points = judge.lattice[places]
    row: dict[str, Any] = {"size": len(places), "critical": float(judge.true[judge.admitted].mean())}
    try:
        known = CriticalSet(
            judge.space, points, judge.scores[places], Criterion(judge.case.critical), seed,
            initial_design=is_score_independent(kind.partition(",")[0], judge.space, seed, points),
            features=(registered_features(), judge.features[places]) if with_features else None, source_model=source,
        )  # fmt: skip
    except ValueError:
        return row
    told = known.predict(judge.lattice) & judge.admitted
    both = float((told & judge.true).sum())
    recall, precision = both / max(judge.true.sum(), 1), both / max(told.sum(), 1)
    row |= {"recall": recall, "precision": precision, "f1": 2 * recall * precision / max(recall + precision, 1e-12)}
    if not known.interval_unavailable:
        share = known.critical_fraction
        row["share"] = (share.low, share.value, share.high)
    if not known.missed_interval_unavailable:
        missed = known.missed_fraction
        row["missed"] = (missed.low, missed.value, missed.high)
        row["most missed"] = [known.missed_upper_bound(confidence) for confidence in CONFIDENCES]
    return row


def work(
    name: str, folders: Folders, steps: int, truths: Path, kind: str, seed: int, sizes: tuple[int, ...],
    runs: Path, with_features: bool, stop: bool,
) -> list[dict[str, Any]]:  # fmt: skip
    """Judge one search of one scenario at each size."""
    settle_threshold(name, folders, steps, truths)
    with threadpool_limits(1):
        judge = Judge(name, folders, steps, truths, ("process",))
        places = run_search(judge, kind, seed, max(sizes), path_of_run(runs, name, steps, kind, seed))
        looks = sorted({*sizes, *(range(40, max(sizes) + 1, LOOK) if stop else ())})
        rows = [judge_at(judge, kind, seed, places[:look], with_features) for look in looks if look <= len(places)]
    first = {"case": name, "search": kind, "seed": seed, "dimension": judge.space.dimension}
    return [first | {"judged": row["size"] in sizes} | row for row in rows]


def bounds_and_truth(rows: Iterable[dict[str, Any]], what: str) -> tuple[npt.NDArray[np.float64], ...]:
    """Lower and upper bounds of the intervals that were given, and the true values."""
    given = [(*row[what], row["critical"] if what == "share" else 1.0 - row["recall"]) for row in rows if what in row]
    low, _, high, true = np.array(given).reshape(-1, 4).T
    return low, high, true


def print_rates(rows: Iterable[dict[str, Any]]) -> None:
    """Print how often intervals hold, and how wide they are, by search, size, dimension and scenario."""
    rows = [row for row in rows if row["judged"]]
    columns = f"{'holds':>16} {'width':>7} {'below':>6}"
    print(f"\n{'':24}{'':6} {'share':>16} {'':14} {'missed':>16}\n{'':24}{'F1':>6} {columns} {columns}")
    for key in ("search", "size", "dimension", "case", None):
        for value in dict.fromkeys(row[key] for row in rows) if key else ("all",):
            mine = [row for row in rows if key is None or row[key] == value]
            texts = [f"{np.mean([row.get('f1', 0.0) for row in mine]):6.3f}"]
            for what in ("share", "missed"):
                low, high, so = bounds_and_truth(mine, what)
                if not len(so):
                    texts.append(f"{'none given':>16} {'':14}")
                    continue
                holds, widths = (low <= so) & (so <= high), (high - low) / (so if what == "share" else 1.0)
                texts.append(f"{holds.mean():8.1%} of {len(so):4} {np.median(widths):7.3f} {(so > high).mean():6.1%}")
            print(f"{value!s:24}", *texts)


def print_stops(rows: Iterable[dict[str, Any]]) -> None:
    """Print how often ``missed(P)<0.05`` stops searches, when, and how often more was missed, for some P."""
    searches: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
    for row in rows:
        searches.setdefault((row["case"], row["search"], row["seed"]), []).append(row)
    print(
        f"\nmissed(P)<{STOP:g}: searches stopped within 1.5 times the scenarios from which on less than {REACHED:g} was"
        " missed, of those run so long;\nsearches stopped at all, and those that missed more then"
    )
    for kind in dict.fromkeys(row["search"] for row in rows):
        for k, confidence in enumerate(CONFIDENCES):
            timely, due, stopped, wrong = count_stops([one for key, one in searches.items() if key[1] == kind], k)
            print(f"{kind:24} P {confidence:<5g} {timely:4} of {due:4} {stopped:8} of which {wrong:4}")


def count_stops(searches: list[list[dict[str, Any]]], k: int) -> tuple[int, int, int, int]:
    """Searches stopped in time with the k-th of `CONFIDENCES`, those to stop, those stopped, and too early."""
    due, fired, stopped, wrong = 0, 0, 0, 0
    for looks in searches:
        stop = next((row["size"] for row in looks if "most missed" in row and row["most missed"][k] < STOP), None)
        # From here on less is missed at each look.
        late = [row["size"] for row in looks if 1.0 - row.get("recall", 0.0) >= REACHED]
        reached = min((row["size"] for row in looks if row["size"] > max(late, default=0)), default=None)
        if reached is not None and 1.5 * reached <= looks[-1]["size"]:
            due, fired = due + 1, fired + (stop is not None and stop <= 1.5 * reached)
        if stop is not None:
            missed = 1.0 - next(row["recall"] for row in looks if row["size"] == stop)
            stopped, wrong = stopped + 1, wrong + (missed >= STOP)
    return fired, due, stopped, wrong


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--half", choices=HALVES, default="judge")
    parser.add_argument("--only", action="append", help="only this scenario; may be repeated")
    parser.add_argument(
        "--search", action="append", choices=SEARCHES, help="may be repeated; default sobol, level-set, bayes"
    )
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES)
    parser.add_argument("--steps", type=int, default=14, help="for each of three parameters")
    parser.add_argument("--process", action="store_true", help="judge without features")
    parser.add_argument("--stop", action="store_true", help="test the criterion missed<0.05 as well")
    parser.add_argument("--ncap", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--alks", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--truth", type=Path, default=Path("truth"), metavar="FOLDER")
    parser.add_argument("--runs", type=Path, default=Path("runs"), metavar="FOLDER")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    folders: Folders = {"examples": EXAMPLES, "ncap": options.ncap, "alks": options.alks}
    names = options.only or list(HALVES[options.half])
    for name in names:
        settle_threshold(name, folders, options.steps, options.truth)
        case, scores = CASES[name], truth(name, folders, options.steps, options.truth)[:, 0]
        print(f"{name:28} {len(scores)} scenarios, {np.mean(scores <= case.critical):6.2%} critical, {case.metric} <="
              f" {case.critical:.3g}, {np.isnan(scores).sum()} failed", flush=True)  # fmt: skip
    searches = options.search or ("sobol", "level-set", "bayes")
    seeds = range(options.first, options.first + options.seeds)
    jobs = [(name, kind, seed) for name in names for kind in searches for seed in seeds]
    with ProcessPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        parts = pool.map(
            work,
            [job[0] for job in jobs], repeat(folders), repeat(options.steps), repeat(options.truth),
            [job[1] for job in jobs], [job[2] for job in jobs], repeat(tuple(options.sizes)), repeat(options.runs),
            repeat(not options.process), repeat(options.stop),
        )  # fmt: skip
        rows = [row for part in parts for row in part]
    print_rates(rows)
    if options.stop:
        print_stops(rows)
    if options.json:
        options.json.write_text(json.dumps(rows))


if __name__ == "__main__":
    main()
