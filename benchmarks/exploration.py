"""Searches judged by what they missed: critical sets known on a dense grid, beside what each search finds of them.

python benchmarks/exploration.py [--quick] [--steps N] [--seeds N] [--only NAME]… [--half choose|judge]
                                 [--search NAME]… [--judge NAME] [--round-share SHARE] [--asynchronous N] [--sizes N…]
                                 [--ncap FOLDER] [--alks FOLDER] [--truth FOLDER] [--json FILE] [--plot FILE]

The truth is the score of every scenario of a grid, run once and kept in a folder: N steps for each of three parameters,
as many scenarios or fewer where there are two to six parameters. Each search then works on that grid, so that its
scores are looked up and nothing is interpolated. A region is a connected part of the critical set of at least 0.1 % of
the grid; it is hit by a critical scenario in it.

What a search found is what it ran, and elsewhere what a classifier of its runs takes for critical: by ``--judge best``
the one that tells these runs best from each other (benchmarks/judging.py), else the one of that name. Constants of the
searches were chosen with the scenarios of the half ``choose``; those of the half ``judge`` were not looked at then.

Also judged: what is said of the critical share and of the share of the critical set that is missed, and the criterion
``missed<0.05``, by whether the truth lies within the 90 % intervals and by what is missed when it is first fulfilled.

With ``--asynchronous N`` searches have no rounds: N workers run one scenario each, which takes 0.5 s, or 3 s in one of
ten scenarios, by a clock that is only counted; what has ended is told, and another scenario is asked for, at once.

FOLDER of --ncap is that of ASAM's Euro NCAP scenarios which holds CA-FC_2026 and AEB_VRU_2023, FOLDER of --alks the one
of its ALKS scenarios which holds their templates; what is not given is left out.
"""

from __future__ import annotations

import argparse
import heapq
import json
import os
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.ndimage import label
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

from cornercase import LogicalScenario
from cornercase.evidence._critical_set_estimate import CriticalSet
from cornercase.exploration._asynchronous import max_pending_scenarios
from cornercase.exploration._study_critical_set import is_score_independent, uses_features_for_critical_set
from cornercase.metrics import METRICS, compute_features, registered_features
from cornercase.optimizers import (
    Auto,
    Bayes,
    Committee,
    Evolutionary,
    Grid,
    LevelSet,
    Optuna,
    Sobol,
)
from cornercase.scenario import Parameter, ParameterSpace
from cornercase.simulators import Builtin
from cornercase.study._criterion import Criterion

# Beside this file; mypy knows it by its package.
from judging import CLASSIFIERS, CUTS, best_classifier  # type: ignore[import-not-found]

EXAMPLES = Path(__file__).parents[1] / "examples"
SIZES = (50, 100, 200, 300, 400)
SMALLEST_REGION = 1e-3
STOP = 0.05
REFERENCES = ("grid", "bayes, filling 0")
OTHERS = (*REFERENCES, "sobol", "bayes", "evolutionary", "optuna (TPE)")


@dataclass(frozen=True)
class Case:
    """A logical scenario, who drives its ego, and what is critical: a score of at most so much."""

    file: str
    other: str
    metric: str
    critical: float
    ranges: tuple[str, ...] = ()
    driver: str | None = None
    on_collision: str = "continue"
    time_step: float = 0.05
    of: str = "examples"


# Files of the examples, and of Euro NCAP's protocols and of UN Regulation 157 (ALKS) as ASAM publishes them.
CHOOSE = {
    "x-intersection": Case("x_intersection/x_intersection.xosc", "Pedestrian", "wttc", 0.5),
    "t-intersection": Case("t_intersection/t_intersection.xosc", "C", "ttc", 0.5, on_collision="stop"),
    "cpnco": Case(
        "CA-FC_2026/CPNCO.xosc", "VRU", "ttc", 0.5,
        ("Ego_speed_kph=10:60", "VRU_finalSpeed_kph=3:10", "ImpactLocation=10:90"), "normal", time_step=0.02, of="ncap",
    ),
    "ccftap": Case(
        "CA-FC_2026/CCFtap.xosc", "Target", "clearance", 0.6,
        ("Ego_speed_kph=10:25", "Target_final_speed_kph=30:60", "Trajectory_R2=9:15"), "aggressive", time_step=0.02,
        of="ncap",
    ),
    "cpta": Case(
        "AEB_VRU_2023/NCAP_AEB_VRU_CPTA_2023.xosc", "VRU", "wttc", 0.4,
        ("Ego_speed_kph=10:25", "VRU_finalSpeed_kph=3:8", "VRU_centerlineOffset=7:12"), "aggressive", time_step=0.02,
        of="ncap",
    ),
    "t-intersection, aggressive": Case(
        "t_intersection/t_intersection.xosc", "C", "ttc", 0.5, driver="aggressive", on_collision="stop",
    ),
}  # fmt: skip
JUDGE = {
    "t-intersection, cautious": Case(
        "t_intersection/t_intersection.xosc", "C", "ttc", 1.5, driver="cautious", on_collision="stop",
    ),
    "t-intersection, five": Case(
        "t_intersection/t_intersection.xosc", "C", "ttc", 1.0,
        ("ego_sync_s=2:17", "c_start_time=0:5", "c_routing_distance=0:80", "ego_speed=6:14", "c_speed=6:14"), "normal",
    ),
    "x-intersection, six": Case(
        "x_intersection/x_intersection.xosc", "Pedestrian", "wttc", 0.5,
        ("ego_start=30:80", "pedestrian_wait=0:6", "p1_speed=4:10", "ego_speed=7:13", "pedestrian_speed=1:3",
         "truck_speed=5:10"), "normal",
    ),
    "cbnao": Case(
        "CA-FC_2026/CBNAO.xosc", "VRU", "wttc", 0.25,
        ("Ego_speed_kph=10:60", "VRU_finalSpeed_kph=5:20", "ImpactLocation=10:90"), "aggressive", time_step=0.02,
        of="ncap",
    ),
    "cpna": Case(
        "CA-FC_2026/CPNA.xosc", "VRU", "ttc", 0.75,
        ("Ego_speed_kph=10:60", "VRU_finalSpeed_kph=3:10", "ImpactLocation=10:90", "VRU_initLatDist=3:8"), "cautious",
        time_step=0.02, of="ncap",
    ),
    "cccscp": Case(
        "CA-FC_2026/CCCscp.xosc", "Target", "ttc", 1.5, ("Ego_speed_kph=20:60", "Target_final_speed_kph=20:60"),
        "normal", time_step=0.02, of="ncap",
    ),
    "ccrs": Case(
        "CA-FC_2026/CCRs.xosc", "Target", "ttc", 2.0, ("Ego_speed_kph=10:60", "Target_init_speed_kph=0:50"),
        "aggressive", time_step=0.02, of="ncap",
    ),
    "cut-in": Case(
        "alks_scenario_4_4_1_cut_in_no_collision_template.xosc", "CutInVehicle", "wttc", 0.9,
        ("Ego_InitSpeed_Ve0_kph=20:60", "CutInVehicle_RelativeInitSpeed_Ve0_Vo0_kph=-20:-5",
         "CutInVehicle_HeadwayDistanceTrigger_dx0_m=5:60", "CutInVehicle_LaneChange_MaxLateralVelocity_Vy_mps=0.5:3"),
        "normal", of="alks",
    ),
    "cut-out": Case(
        "alks_scenario_4_5_1_cut_out_fully_blocking_template.xosc", "TargetBlocking", "wttc", 0.95,
        ("Ego_InitSpeed_Ve0_kph=20:60", "FrontOfLead_Distance_dx0_f_m=10:100",
         "CutOutVehicle_LaneChange_MaxLateralVelocity_Vy_mps=0.5:3"), "cautious", of="alks",
    ),
}  # fmt: skip
CASES = CHOOSE | JUDGE

SEARCHES: dict[str, Callable[[ParameterSpace, int, float, int], Any]] = {
    "grid": lambda space, seed, critical, budget: Grid().start(space, seed, budget=budget),
    "sobol": lambda space, seed, critical, budget: Sobol().start(space, seed),
    "bayes, filling 0": lambda space, seed, critical, budget: Bayes(filling=0.0).start(space, seed),
    "bayes": lambda space, seed, critical, budget: Bayes().start(space, seed),
    "evolutionary": lambda space, seed, critical, budget: Evolutionary().start(space, seed),
    "optuna (TPE)": lambda space, seed, critical, budget: Optuna().start(space, seed),
    "level-set": lambda space, seed, critical, budget: LevelSet().start(space, seed, threshold=critical),
    "committee": lambda space, seed, critical, budget: Committee().start(
        space, seed, threshold=critical, features=registered_features()
    ),
    "auto": lambda space, seed, critical, budget: Auto().start(
        space, seed, threshold=critical, features=registered_features()
    ),
}


Folders = dict[str, Path | None]


def logical(name: str, folders: Folders) -> LogicalScenario:
    return logical_of(CASES[name], folders)


def logical_of(case: Case, folders: Folders) -> LogicalScenario:
    path = (folders[case.of] or Path()) / case.file
    return LogicalScenario.read(path, None if case.ranges else path.with_suffix(".space.xosc"), case.ranges)


def stepped(space: ParameterSpace, steps: int) -> ParameterSpace:
    """The same ranges, of which only the middles of equal parts are run: `steps` of each of three parameters."""
    parameters = []
    steps = int(steps ** (3.0 / space.dimension) + 1e-9)
    for one in space.parameters:
        width = (one.high - one.low) / steps
        parameters.append(Parameter(one.name, one.low + width / 2, one.high - width / 2, width, unit=one.unit))
    return ParameterSpace(parameters, space.declarations)


def outcomes(case: Case, folders: Folders, values: list[dict[str, Any]]) -> npt.NDArray[np.float64]:
    """Score and features of each scenario."""
    scenario = logical_of(case, folders)
    metric = METRICS.create(case.metric)
    drivers = {} if case.driver is None else {"Ego": case.driver}
    simulator = Builtin(time_step=case.time_step, on_collision=case.on_collision, drivers=drivers)
    found, runs = np.full(len(values), np.nan), []
    for k, run in enumerate(simulator.run([scenario.concrete_scenario(one) for one in values])):
        runs.append(None if isinstance(run, Exception) else run)
        if not isinstance(run, Exception):
            found[k] = metric.score(metric.course(run, "Ego", case.other))
    return np.column_stack([found, compute_features(runs, "Ego", case.other)])


def truth(name: str, folders: Folders, steps: int, folder: Path, case: Case | None = None) -> npt.NDArray[np.float64]:
    """Score and features of each scenario of the grid, in the order of its lattice; `case` is by default that named."""
    path = folder / f"{name.replace(', ', '-')}-{steps}-features.npy"
    if not path.exists():
        case = CASES[name] if case is None else case
        space = stepped(logical_of(case, folders).space, steps)
        values = space.values(space.full_factorial())
        begin = time.perf_counter()
        parts = [values[k : k + 500] for k in range(0, len(values), 500)]
        with ProcessPoolExecutor(len(os.sched_getaffinity(0))) as pool:
            whole = np.concatenate(list(pool.map(outcomes, repeat(case), repeat(folders), parts)))
        folder.mkdir(parents=True, exist_ok=True)
        np.save(path, whole)
        print(f"{name}: {len(whole)} scenarios in {time.perf_counter() - begin:.0f} s, kept in {path}", flush=True)
    known: npt.NDArray[np.float64] = np.load(path)
    return known


class Judge:
    """The truth about one case, and what a search tells of it."""

    def __init__(self, name: str, folders: Folders, steps: int, folder: Path, kinds: tuple[str, ...]) -> None:
        self.case, self.kinds = CASES[name], kinds
        self.scores, self.features = np.split(truth(name, folders, steps, folder), [1], axis=1)
        self.scores = self.scores.ravel()
        self.space = stepped(logical(name, folders).space, steps)
        self.steps = [int(one.size or 0) for one in self.space.parameters]
        self.lattice = self.space.full_factorial()
        # What breaks a constraint is no scenario, and no search asks for it.
        self.admitted = self.space.is_admissible(self.lattice)
        self.true = self.scores <= self.case.critical
        regions, _ = label(self.true.reshape(self.steps), structure=np.ones([3] * len(self.steps)))
        self.regions = regions.ravel()
        counts = np.bincount(self.regions)
        self.large = {k for k in range(1, len(counts)) if counts[k] >= SMALLEST_REGION * len(self.true)}

    def places(self, points: npt.NDArray[np.float64]) -> npt.NDArray[np.int64]:
        """Where points stand in the lattice."""
        numbers = [one.level_indices(points[:, j]) for j, one in enumerate(self.space.parameters)]
        return np.ravel_multi_index(tuple(numbers), tuple(self.steps))

    def agreement(self, told: npt.NDArray[np.bool_]) -> dict[str, float]:
        """Recall and precision of what is told to be critical."""
        told = told & self.admitted
        both = float((told & self.true).sum())
        return {"recall": both / max(self.true.sum(), 1), "precision": both / max(told.sum(), 1)}

    def row(self, kind: str, points: npt.NDArray[np.float64], seed: int) -> dict[str, float]:
        """All figures about scenarios that were run."""
        places = self.places(points)
        hit = set(self.regions[places]) & self.large
        row = {"regions": len(hit) / max(len(self.large), 1), "best": float(np.nanmin(self.scores[places]))}
        row |= self.found(places, seed)
        features = (
            (registered_features(), self.features[places])
            if uses_features_for_critical_set(kind, len(points))
            else None
        )
        try:
            known = CriticalSet(
                self.space, points, self.scores[places], Criterion(self.case.critical), seed,
                initial_design=is_score_independent(kind.partition(",")[0], self.space, seed, points),
                features=features,
            )  # fmt: skip
        except ValueError:
            return row | {"share": np.nan, "missed": np.nan}
        within = known.critical_fraction.low <= self.true[self.admitted].mean() <= known.critical_fraction.high
        # What is said to be missed is what the set itself does not find, whoever judges the search.
        open_ = 1.0 - self.agreement(known.predict(self.lattice))["recall"]
        missed = known.missed_fraction.low <= open_ <= known.missed_fraction.high
        # Where no interval is given, none can be wrong.
        row["share"] = np.nan if known.interval_unavailable else float(within)
        row["missed"] = np.nan if known.missed_interval_unavailable else float(missed)
        return row | {"most missed": known.missed_upper_bound()}

    def found(self, places: npt.NDArray[np.int64], seed: int) -> dict[str, float]:
        """Recall and precision of what was run at places, and elsewhere of what the best classifier of it tells."""
        runs = self.lattice[places], self.scores[places], self.features[places]
        kind, probability = best_classifier(self.kinds, *runs, self.case.critical, seed)
        told = np.zeros(len(self.true), dtype=bool)
        if probability is not None:
            told = probability(self.lattice) >= CUTS.get(kind, 0.5)
        told[places] = self.true[places]
        return self.agreement(told) | {"judge": float((*CLASSIFIERS, "none").index(kind))}


class Workers:
    """Workers that run what a search without rounds asks for, by a clock that is only counted."""

    def __init__(self, optimizer: Any, dimension: int, count: int, budget: int, seed: int) -> None:
        self._optimizer, self._dimension, self._left = optimizer, dimension, budget
        self._free, self._most, self._now = [0.0] * count, max_pending_scenarios(count), 0.0
        self._running: list[tuple[float, int]] = []
        self._points: dict[int, npt.NDArray[np.float64]] = {}
        self._asked, self._random = 0, np.random.default_rng([seed, count])

    def next(self) -> npt.NDArray[np.float64] | None:
        """Point of the scenario that ends next, after others were asked for."""
        if (wanted := min(self._most - len(self._points), self._left)) > 0:
            pending = np.array(list(self._points.values())).reshape(-1, self._dimension)
            for point in self._optimizer.ask_async(wanted, pending):
                # What was asked for first begins first, on the worker that is free first.
                end = max(heapq.heappop(self._free), self._now) + (3.0 if self._random.random() < 0.1 else 0.5)
                heapq.heappush(self._free, end)
                heapq.heappush(self._running, (end, self._asked))
                self._points[self._asked] = point
                self._asked, self._left = self._asked + 1, self._left - 1
        if not self._running:
            return None
        self._now, number = heapq.heappop(self._running)
        return self._points.pop(number)


def search(
    judge: Judge, kind: str, seed: int, sizes: tuple[int, ...], share: float, workers: int | None
) -> dict[str, Any]:
    """Run one search and judge it at each size; and find when the criterion would have stopped it.

    A round is of ten scenarios, or of that share of those before it where that is more; with workers there are none.
    """
    rows, stop = [], None
    critical = judge.case.critical
    points, spent, proposals = np.zeros((0, len(judge.steps))), 0.0, 0
    optimizer: Any = SEARCHES[kind](judge.space, seed, critical, sizes[-1])
    running = None if workers is None else Workers(optimizer, len(judge.steps), workers, sizes[-1], seed)
    for size in sizes:
        if isinstance(optimizer, Grid):
            optimizer, points = SEARCHES[kind](judge.space, seed, critical, size), points[:0]
            running = None if workers is None else Workers(optimizer, len(judge.steps), workers, size, seed)
        while len(points) < size:
            begin = time.process_time()
            if running is None:
                new = optimizer.ask(min(max(10, int(share * len(points))), size - len(points)))
            else:
                ended = running.next()
                new = points[:0] if ended is None else ended[None]
            if not len(new):
                break
            at = judge.places(new)
            # Some take the features too.
            more = (judge.features[at],) if "features" in optimizer.requires else ()
            optimizer.tell(new, judge.scores[at], *more)
            spent, proposals = spent + time.process_time() - begin, proposals + len(new)
            points = np.concatenate([points, new])
            if kind == "level-set" and stop is None and len(points) >= 40 and len(points) % 20 == 0:
                row = judge.row(kind, points, seed)
                if row.get("most missed", 1.0) < STOP:
                    stop = {"scenarios": len(points), "missed": 1.0 - row["recall"]}
        rows.append({"size": size, "seconds": spent / max(proposals, 1), **judge.row(kind, points, seed)})
    return {"search": kind, "seed": seed, "rows": rows, "stop": stop, "places": judge.places(points).tolist()}


def grid_needed(judge: Judge, recall: float, precision: float) -> int | None:
    """Scenarios of the smallest grid that finds as much, told by the nearest of its scenarios; None if none does."""
    for steps in range(4, max(judge.steps) + 1):
        points = Grid().start(judge.space, 0, budget=steps ** len(judge.steps)).ask(steps ** len(judge.steps))
        nearest = cKDTree(points).query(judge.lattice)[1]
        found = judge.agreement(judge.true[judge.places(points)][nearest])
        if found["recall"] >= recall and found["precision"] >= precision:
            return len(points)
    return None


_judge: Judge


def begin_worker(*arguments: Any) -> None:
    global _judge
    _judge = Judge(*arguments)


def work(kind: str, seed: int, sizes: tuple[int, ...], share: float, workers: int | None) -> dict[str, Any]:
    with threadpool_limits(1):
        return search(_judge, kind, seed, sizes, share, workers)


def table(name: str, runs: list[dict[str, Any]], sizes: tuple[int, ...]) -> list[dict[str, Any]]:
    """Print and return medians and quartiles."""
    rows = []
    print(f"{'search':18} {'size':>5} {'recall':>20} {'precision':>20} {'regions':>8} {'best':>7} {'CPU s each':>11}")
    for kind in [one for one in SEARCHES if any(run["search"] == one for run in runs)]:
        mine = [run["rows"] for run in runs if run["search"] == kind]
        for k, size in enumerate(sizes):
            column = {key: [row[k][key] for row in mine] for key in mine[0][k]}
            rows.append({"case": name, "search": kind, **column})
            spread = {key: np.percentile(column[key], (25, 50, 75)) for key in ("recall", "precision")}
            texts = [f"{m:.3f} ({a:.3f}-{b:.3f})" for a, m, b in spread.values()]
            others = [float(np.median(column[key])) for key in ("regions", "best", "seconds")]
            print(f"{kind:18} {size:5} {texts[0]:>20} {texts[1]:>20} {others[0]:8.2f} "
                  f"{others[1]:7.3f} {others[2]:11.4f}", flush=True)  # fmt: skip
    return rows


def plot(rows: list[dict[str, Any]], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    cases = list(dict.fromkeys(row["case"] for row in rows))
    figure, axes = plt.subplots(2, len(cases), figsize=(3.4 * len(cases), 6.2), squeeze=False, sharex=True)
    markers = dict(zip(SEARCHES, "sxd^vPo*D", strict=True))
    # Okabe and Ito's colours, which the colour-blind tell apart.
    tones = ("#666666", "#0072B2", "#000000", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9", "#F0E442")
    colours = dict(zip(SEARCHES, tones, strict=True))
    for j, case in enumerate(cases):
        for i, quantity in enumerate(("recall", "precision")):
            for kind in [one for one in SEARCHES if any(row["search"] == one for row in rows)]:
                mine = [row for row in rows if row["case"] == case and row["search"] == kind]
                sizes = [row["size"][0] for row in mine]
                low, middle, high = np.array([np.percentile(row[quantity], (25, 50, 75)) for row in mine]).T
                reference = kind in REFERENCES
                axes[i, j].plot(
                    sizes, middle, marker=markers[kind], label=kind, linewidth=1.2 if kind in OTHERS else 2.2,
                    linestyle="--" if reference else "-", color=colours[kind],
                )  # fmt: skip
                axes[i, j].fill_between(sizes, low, high, color=colours[kind], alpha=0.12)
            axes[i, j].axhline((0.95, 0.9)[i], color="0.7", linewidth=0.8)
            axes[i, j].set_ylim(0, 1.02)
            axes[i, j].set_ylabel(f"{quantity} (1)" if j == 0 else "")
        axes[0, j].set_title(case)
        axes[1, j].set_xlabel("scenarios (1)")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncol=len(SEARCHES), frameon=False)
    figure.tight_layout(rect=(0, 0.05, 1, 1))
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="12 steps, 2 seeds, up to 100 scenarios")
    parser.add_argument("--steps", type=int, default=40)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--only", action="append", choices=CASES, help="only this one; may be repeated")
    parser.add_argument("--half", choices=("choose", "judge"), help="only scenarios of this half")
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES, help="scenarios after which searches are judged")
    parser.add_argument("--judge", choices=("best", *CLASSIFIERS), default="best")
    parser.add_argument("--search", action="append", choices=SEARCHES, help="only this one; may be repeated")
    parser.add_argument("--round-share", type=float, default=0.0, metavar="SHARE", help="of the scenarios run before")
    parser.add_argument("--asynchronous", type=int, metavar="N", help="no rounds; so many workers run scenarios")
    parser.add_argument("--ncap", type=Path, metavar="FOLDER", help="folder with CA-FC_2026 and AEB_VRU_2023")
    parser.add_argument("--alks", type=Path, metavar="FOLDER", help="folder with the templates of the ALKS scenarios")
    parser.add_argument("--truth", type=Path, default=Path("truth"), metavar="FOLDER")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="FILE")
    options = parser.parse_args()
    steps, seeds, sizes = (12, 2, SIZES[:2]) if options.quick else (options.steps, options.seeds, tuple(options.sizes))
    rows, every, needed = [], {}, {}
    folders: Folders = {"examples": EXAMPLES, "ncap": options.ncap, "alks": options.alks}
    kinds = CLASSIFIERS if options.judge == "best" else (options.judge,)
    half = {"choose": CHOOSE, "judge": JUDGE}.get(options.half, CASES)
    for name in options.only or half:
        if folders[CASES[name].of] is None:
            print(f"\n{name}: left out, without --{CASES[name].of}")
            continue
        judge = Judge(name, folders, steps, options.truth, kinds)
        print(f"\n{name}: {judge.admitted.sum()} scenarios, {judge.true[judge.admitted].mean():.1%} critical "
              f"({judge.case.metric} <= {judge.case.critical:g}), {len(judge.large)} regions")  # fmt: skip
        jobs = [(kind, seed) for kind in options.search or SEARCHES for seed in range(1 if kind == "grid" else seeds)]
        begin = (name, folders, steps, options.truth, kinds)
        with ProcessPoolExecutor(len(os.sched_getaffinity(0)), initializer=begin_worker, initargs=begin) as pool:
            how = repeat(sizes), repeat(options.round_share), repeat(options.asynchronous)
            runs = list(pool.map(work, *zip(*jobs, strict=True), *how))
        every[name] = runs
        rows += table(name, runs, sizes)
        at = sizes.index(200) if 200 in sizes else -1
        found = [run["rows"][at] for run in runs if run["search"] == "level-set"]
        if found:
            goal = [float(np.median([row[key] for row in found])) for key in ("recall", "precision")]
            needed[name] = grid_needed(judge, *goal)
            print(f"a grid needs {needed[name] or 'more than all'} scenarios for what level-set finds with {sizes[at]}")
    flat = [(run, row) for runs in every.values() for run in runs for row in run["rows"]]
    print("\nTruth within the 90 % interval, share of the runs for which one is given")
    print(f"{'search':18} {'critical share':>15} {'missed share':>13}")
    for kind in (*(options.search or SEARCHES), "all"):
        mine = [row for run, row in flat if kind in ("all", run["search"])]
        held = [np.array([row[what] for row in mine]) for what in ("share", "missed")]
        held = [one[np.isfinite(one)] for one in held]
        print(f"{kind:18}", *(f"{one.mean():.3f} of {len(one):<4}" if len(one) else "none given  " for one in held))
    stops = [run["stop"] for runs in every.values() for run in runs if run["stop"]]
    total = sum(run["search"] == "level-set" for runs in every.values() for run in runs)
    print(f"\nmissed<{STOP:g} stops {len(stops)} of {total} runs of level-set, after "
          f"{np.median([one['scenarios'] for one in stops]) if stops else float('nan'):g} scenarios (median), the most "
          f"missed then is {max((one['missed'] for one in stops), default=float('nan')):.3f}")  # fmt: skip
    if options.plot:
        plot(rows, options.plot)
    if options.json:
        options.json.write_text(json.dumps({"rows": rows, "runs": every, "grid needed": needed}, indent=1))


if __name__ == "__main__":
    main()
