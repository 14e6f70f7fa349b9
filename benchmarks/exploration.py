"""Searches judged by what they missed: critical sets known on a dense grid, beside what each search finds of them.

python benchmarks/exploration.py [--quick] [--steps N] [--seeds N] [--only NAME] [--search NAME]… [--round-share SHARE]
                                 [--ncap FOLDER] [--truth FOLDER] [--json FILE] [--plot FILE]

The truth is the score of every scenario of a grid of N steps per parameter, run once and kept in a folder. Each search
then works on that grid, so that its scores are looked up and nothing is interpolated. What it found is what one and
the same Gaussian process of its scenarios takes for critical. A region is a connected part of the critical set of at
least 0.1 % of the grid; it is hit by a critical scenario in it.

Also judged: what is said of the critical share and of the share of the critical set that is missed, and the criterion
``missed<0.05``, by whether the truth lies within the 90 % intervals and by what is missed when it is first fulfilled.

FOLDER is that of ASAM's Euro NCAP scenarios which holds CA-FC_2026 and AEB_VRU_2023; without it only the examples run.
"""

from __future__ import annotations

import argparse
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
from cornercase.evidence import CriticalSet
from cornercase.metrics import METRICS
from cornercase.optimizers import (
    BayesOptimizer,
    EvolutionaryOptimizer,
    GridOptimizer,
    LevelSetOptimizer,
    OptunaOptimizer,
    SobolOptimizer,
)
from cornercase.scenario import Parameter, ParameterSpace
from cornercase.simulators import BuiltinSimulator

EXAMPLES = Path(__file__).parents[1] / "examples"
SIZES = (50, 100, 200, 300, 400)
SMALLEST_REGION = 1e-3
STOP = 0.05
REFERENCES = ("grid", "bayes, filling 0")


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


# Files of the examples, and of Euro NCAP's protocols as ASAM publishes them.
CASES = {
    "x-intersection": Case("x_intersection/x_intersection.xosc", "Pedestrian", "wttc", 0.5),
    "t-intersection": Case("t_intersection/t_intersection.xosc", "C", "ttc", 0.5, on_collision="stop"),
    "cpnco": Case(
        "CA-FC_2026/CPNCO.xosc", "VRU", "ttc", 0.5,
        ("Ego_speed_kph=10:60", "VRU_finalSpeed_kph=3:10", "ImpactLocation=10:90"), "normal", time_step=0.02,
    ),
    "ccftap": Case(
        "CA-FC_2026/CCFtap.xosc", "Target", "clearance", 0.6,
        ("Ego_speed_kph=10:25", "Target_final_speed_kph=30:60", "Trajectory_R2=9:15"), "aggressive", time_step=0.02,
    ),
    "cpta": Case(
        "AEB_VRU_2023/NCAP_AEB_VRU_CPTA_2023.xosc", "VRU", "wttc", 0.4,
        ("Ego_speed_kph=10:25", "VRU_finalSpeed_kph=3:8", "VRU_centerlineOffset=7:12"), "aggressive", time_step=0.02,
    ),
}  # fmt: skip

SEARCHES: dict[str, Callable[[ParameterSpace, int, float, int], Any]] = {
    "grid": lambda space, seed, critical, budget: GridOptimizer(space, seed, budget),
    "sobol": lambda space, seed, critical, budget: SobolOptimizer(space, seed),
    "bayes, filling 0": lambda space, seed, critical, budget: BayesOptimizer(space, seed, filling=0.0),
    "bayes": lambda space, seed, critical, budget: BayesOptimizer(space, seed),
    "evolutionary": lambda space, seed, critical, budget: EvolutionaryOptimizer(space, seed),
    "optuna (TPE)": lambda space, seed, critical, budget: OptunaOptimizer(space, seed),
    "level-set": lambda space, seed, critical, budget: LevelSetOptimizer(space, seed, critical),
}


def logical(name: str, ncap: Path | None) -> LogicalScenario:
    case = CASES[name]
    if not case.ranges:
        path = EXAMPLES / case.file
        return LogicalScenario.read(path, path.with_suffix(".space.xosc"))
    return LogicalScenario.read((ncap or Path()) / case.file, None, case.ranges)


def stepped(space: ParameterSpace, steps: int) -> ParameterSpace:
    """The same ranges, of which only the middles of `steps` equal parts are run."""
    parameters = []
    for one in space.parameters:
        width = (one.high - one.low) / steps
        parameters.append(Parameter(one.name, one.low + width / 2, one.high - width / 2, width, unit=one.unit))
    return ParameterSpace(parameters)


def scores(name: str, ncap: Path | None, values: list[dict[str, Any]]) -> npt.NDArray[np.float64]:
    case, scenario = CASES[name], logical(name, ncap)
    metric = METRICS.create(case.metric)
    drivers = {} if case.driver is None else {"Ego": case.driver}
    simulator = BuiltinSimulator(time_step=case.time_step, on_collision=case.on_collision, drivers=drivers)
    found = np.full(len(values), np.nan)
    for k, recording in enumerate(simulator.run([scenario.concrete(one) for one in values])):
        if not isinstance(recording, Exception):
            found[k] = metric.score(metric.course(recording, "Ego", case.other))
    return found


def truth(name: str, ncap: Path | None, steps: int, folder: Path) -> npt.NDArray[np.float64]:
    """Scores of the whole grid, in the order of its lattice."""
    path = folder / f"{name}-{steps}.npy"
    if not path.exists():
        space = stepped(logical(name, ncap).space, steps)
        values = space.values(space.lattice())
        begin = time.perf_counter()
        parts = [values[k : k + 1000] for k in range(0, len(values), 1000)]
        with ProcessPoolExecutor(len(os.sched_getaffinity(0))) as pool:
            whole = np.concatenate(list(pool.map(scores, repeat(name), repeat(ncap), parts)))
        folder.mkdir(parents=True, exist_ok=True)
        np.save(path, whole)
        print(f"{name}: {len(whole)} scenarios in {time.perf_counter() - begin:.0f} s, kept in {path}", flush=True)
    known: npt.NDArray[np.float64] = np.load(path)
    return known


class Judge:
    """The truth about one case, and what a search tells of it."""

    def __init__(self, name: str, ncap: Path | None, steps: int, folder: Path) -> None:
        self.case, self.scores = CASES[name], truth(name, ncap, steps, folder)
        self.space = stepped(logical(name, ncap).space, steps)
        self.steps = [int(one.size or 0) for one in self.space.parameters]
        self.lattice = self.space.lattice()
        self.true = self.scores <= self.case.critical
        regions, _ = label(self.true.reshape(self.steps), structure=np.ones([3] * len(self.steps)))
        self.regions = regions.ravel()
        counts = np.bincount(self.regions)
        self.large = {k for k in range(1, len(counts)) if counts[k] >= SMALLEST_REGION * len(self.true)}

    def places(self, points: npt.NDArray[np.float64]) -> npt.NDArray[np.int64]:
        """Where points stand in the lattice."""
        numbers = [one.numbers(points[:, j]) for j, one in enumerate(self.space.parameters)]
        return np.ravel_multi_index(tuple(numbers), tuple(self.steps))

    def agreement(self, told: npt.NDArray[np.bool_]) -> dict[str, float]:
        """Recall and precision of what is told to be critical."""
        both = float((told & self.true).sum())
        return {"recall": both / max(self.true.sum(), 1), "precision": both / max(told.sum(), 1)}

    def row(self, points: npt.NDArray[np.float64], seed: int) -> dict[str, float]:
        """All figures about scenarios that were run."""
        places = self.places(points)
        hit = set(self.regions[places]) & self.large
        row = {"regions": len(hit) / max(len(self.large), 1), "best": float(np.nanmin(self.scores[places]))}
        try:
            known = CriticalSet(self.space, points, self.scores[places], self.case.critical, seed)
        except ValueError:
            return row | self.agreement(np.zeros(len(self.true), dtype=bool)) | {"share": 1.0, "missed": 1.0}
        row |= self.agreement(known.found(self.lattice))
        within = known.share.low <= self.true.mean() <= known.share.high
        missed = known.missed.low <= 1.0 - row["recall"] <= known.missed.high
        return row | {"share": float(within), "missed": float(missed), "most missed": known.missed.high}


def search(judge: Judge, kind: str, seed: int, sizes: tuple[int, ...], share: float) -> dict[str, Any]:
    """Run one search and judge it at each size; and find when the criterion would have stopped it.

    A round is of ten scenarios, or of that share of those before it where that is more.
    """
    rows, stop = [], None
    critical = judge.case.critical
    points, spent, proposals = np.zeros((0, len(judge.steps))), 0.0, 0
    optimizer = SEARCHES[kind](judge.space, seed, critical, sizes[-1])
    for size in sizes:
        if isinstance(optimizer, GridOptimizer):
            optimizer, points = SEARCHES[kind](judge.space, seed, critical, size), points[:0]
        while len(points) < size:
            begin = time.process_time()
            new = optimizer.ask(min(max(10, int(share * len(points))), size - len(points)))
            if not len(new):
                break
            optimizer.tell(new, judge.scores[judge.places(new)])
            spent, proposals = spent + time.process_time() - begin, proposals + len(new)
            points = np.concatenate([points, new])
            if kind == "level-set" and stop is None and len(points) >= 40 and len(points) % 20 == 0:
                row = judge.row(points, seed)
                if row.get("most missed", 1.0) < STOP:
                    stop = {"scenarios": len(points), "missed": 1.0 - row["recall"]}
        rows.append({"size": size, "seconds": spent / max(proposals, 1), **judge.row(points, seed)})
    return {"search": kind, "seed": seed, "rows": rows, "stop": stop, "places": judge.places(points).tolist()}


def grid_needed(judge: Judge, recall: float, precision: float) -> int | None:
    """Scenarios of the smallest grid that finds as much, told by the nearest of its scenarios; None if none does."""
    for steps in range(4, max(judge.steps) + 1):
        points = GridOptimizer(judge.space, 0, steps ** len(judge.steps)).ask(steps ** len(judge.steps))
        nearest = cKDTree(points).query(judge.lattice)[1]
        found = judge.agreement(judge.true[judge.places(points)][nearest])
        if found["recall"] >= recall and found["precision"] >= precision:
            return len(points)
    return None


_judge: Judge


def begin_worker(*arguments: Any) -> None:
    global _judge
    _judge = Judge(*arguments)


def work(kind: str, seed: int, sizes: tuple[int, ...], share: float) -> dict[str, Any]:
    with threadpool_limits(1):
        return search(_judge, kind, seed, sizes, share)


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
    markers = dict(zip(SEARCHES, "sxd^vPo", strict=True))
    # Okabe and Ito's colours, which the colour-blind tell apart.
    tones = ("#666666", "#0072B2", "#000000", "#E69F00", "#009E73", "#CC79A7", "#D55E00")
    colours = dict(zip(SEARCHES, tones, strict=True))
    for j, case in enumerate(cases):
        for i, quantity in enumerate(("recall", "precision")):
            for kind in [one for one in SEARCHES if any(row["search"] == one for row in rows)]:
                mine = [row for row in rows if row["case"] == case and row["search"] == kind]
                sizes = [row["size"][0] for row in mine]
                low, middle, high = np.array([np.percentile(row[quantity], (25, 50, 75)) for row in mine]).T
                reference = kind in REFERENCES
                axes[i, j].plot(
                    sizes, middle, marker=markers[kind], label=kind, linewidth=2.2 if kind == "level-set" else 1.2,
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
    parser.add_argument("--only", choices=CASES)
    parser.add_argument("--search", action="append", choices=SEARCHES, help="only this one; may be repeated")
    parser.add_argument("--round-share", type=float, default=0.0, metavar="SHARE", help="of the scenarios run before")
    parser.add_argument("--ncap", type=Path, metavar="FOLDER", help="folder with CA-FC_2026 and AEB_VRU_2023")
    parser.add_argument("--truth", type=Path, default=Path("truth"), metavar="FOLDER")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="FILE")
    options = parser.parse_args()
    steps, seeds, sizes = (12, 2, SIZES[:2]) if options.quick else (options.steps, options.seeds, SIZES)
    rows, every, needed = [], {}, {}
    for name in [options.only] if options.only else CASES:
        if CASES[name].ranges and options.ncap is None:
            print(f"\n{name}: left out, without --ncap")
            continue
        judge = Judge(name, options.ncap, steps, options.truth)
        print(f"\n{name}: {len(judge.true)} scenarios, {judge.true.mean():.1%} critical "
              f"({judge.case.metric} <= {judge.case.critical:g}), {len(judge.large)} regions")  # fmt: skip
        jobs = [(kind, seed) for kind in options.search or SEARCHES for seed in range(1 if kind == "grid" else seeds)]
        begin = (name, options.ncap, steps, options.truth)
        with ProcessPoolExecutor(len(os.sched_getaffinity(0)), initializer=begin_worker, initargs=begin) as pool:
            runs = list(pool.map(work, *zip(*jobs, strict=True), repeat(sizes), repeat(options.round_share)))
        every[name] = runs
        rows += table(name, runs, sizes)
        at = sizes.index(200) if 200 in sizes else -1
        found = [run["rows"][at] for run in runs if run["search"] == "level-set"]
        if found:
            goal = [float(np.median([row[key] for row in found])) for key in ("recall", "precision")]
            needed[name] = grid_needed(judge, *goal)
            print(f"a grid needs {needed[name] or 'more than all'} scenarios for what level-set finds with {sizes[at]}")
    flat = [(run, row) for runs in every.values() for run in runs for row in run["rows"]]
    print("\nTruth within the 90 % interval, share of the runs")
    print(f"{'search':18} {'critical share':>15} {'missed share':>13}")
    for kind in (*(options.search or SEARCHES), "all"):
        mine = [row for run, row in flat if kind in ("all", run["search"])]
        print(f"{kind:18} {np.mean([r['share'] for r in mine]):15.3f} {np.mean([r['missed'] for r in mine]):13.3f}")
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
