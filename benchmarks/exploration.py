"""Searches judged by what they missed: critical sets known on a dense grid, beside what each search finds of them.

python benchmarks/exploration.py [--quick] [--steps N] [--seeds N] [--only NAME] [--truth FOLDER] [--json FILE]

The truth is the score of every scenario of a grid of N steps per parameter, run once and kept in a folder. Each search
then works on that grid, so that its scores are looked up and nothing is interpolated. What it found is what a Gaussian
process of its scenarios takes for critical, the same process for all. A region is a connected part of the critical set
of at least 0.1 % of the grid; it is hit by a critical scenario in it.
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

from cornercase import BuiltinSimulator, LogicalScenario
from cornercase.metrics import METRICS
from cornercase.optimizers import BayesOptimizer, GridOptimizer, LevelSetOptimizer, SequenceOptimizer
from cornercase.scenario.space import Parameter, ParameterSpace

EXAMPLES = Path(__file__).parents[1] / "examples"
SIZES = (50, 100, 200, 300, 400)
SMALLEST_REGION = 1e-3


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
    "sobol": lambda space, seed, critical, budget: SequenceOptimizer(space, seed, "sobol"),
    "bayes, filling 0": lambda space, seed, critical, budget: BayesOptimizer(space, seed, filling=0.0),
    "bayes": lambda space, seed, critical, budget: BayesOptimizer(space, seed),
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
    return np.load(path)


def search(
    make: Callable[[ParameterSpace, int, float, int], Any],
    space: ParameterSpace,
    whole: npt.NDArray[np.float64],
    critical: float,
    seed: int,
    sizes: tuple[int, ...],
) -> list[dict[str, float]]:
    """Run one search, and judge it at each size."""
    steps = [int(one.size or 0) for one in space.parameters]
    lattice = space.lattice()
    true = whole <= critical
    regions, _ = label(true.reshape(steps), structure=np.ones([3] * len(steps)))
    regions = regions.ravel()
    counts = np.bincount(regions)
    large = [k for k in range(1, len(counts)) if counts[k] >= SMALLEST_REGION * len(whole)]

    def place(points: npt.NDArray[np.float64]) -> npt.NDArray[np.int64]:
        numbers = [one.numbers(points[:, j]) for j, one in enumerate(space.parameters)]
        return np.ravel_multi_index(tuple(numbers), tuple(steps))

    rows = []
    points, spent, proposals = np.zeros((0, len(steps))), 0.0, 0
    optimizer = make(space, seed, critical, sizes[-1])
    for size in sizes:
        if isinstance(optimizer, GridOptimizer):
            optimizer, points = make(space, seed, critical, size), points[:0]
        while len(points) < size:
            begin = time.perf_counter()
            new = optimizer.ask(min(10, size - len(points)))
            if not len(new):
                break
            optimizer.tell(new, whole[place(new)])
            spent, proposals = spent + time.perf_counter() - begin, proposals + len(new)
            points = np.concatenate([points, new])
        ran = whole[place(points)]
        judge = LevelSetOptimizer(space, 0, critical)
        judge.tell(points, ran)
        told = judge.critical(lattice) > 0.5 if np.ptp(ran[np.isfinite(ran)]) > 0 else np.zeros(len(whole), dtype=bool)
        hit = set(regions[place(points)]) & set(large)
        rows.append(
            {
                "size": size,
                "recall": float((told & true).sum() / max(true.sum(), 1)),
                "precision": float((told & true).sum() / max(told.sum(), 1)),
                "regions": len(hit) / max(len(large), 1),
                "best": float(np.nanmin(ran)),
                "seconds": spent / max(proposals, 1),
            }
        )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="12 steps, 2 seeds, up to 100 scenarios")
    parser.add_argument("--steps", type=int, default=40)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--only", choices=CASES)
    parser.add_argument("--truth", type=Path, default=Path("truth"), metavar="FOLDER")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    steps, seeds, sizes = (12, 2, SIZES[:2]) if options.quick else (options.steps, options.seeds, SIZES)
    table = []
    for name in [options.only] if options.only else CASES:
        whole = truth(name, steps, options.truth)
        space = stepped(logical(name).space, steps)
        critical = CASES[name][4]
        print(
            f"\n{name}: {len(whole)} scenarios, {np.mean(whole <= critical):.1%} critical "
            f"({CASES[name][2]} <= {critical:g})"
        )
        print(
            f"{'search':18} {'size':>5} {'recall':>20} {'precision':>20} {'regions':>8} {'best':>7} {'s/proposal':>11}"
        )
        for kind, make in SEARCHES.items():
            runs = [search(make, space, whole, critical, seed, sizes) for seed in range(1 if kind == "grid" else seeds)]
            for k, size in enumerate(sizes):
                column = {key: [run[k][key] for run in runs] for key in runs[0][k]}
                table.append({"case": name, "search": kind, **column})
                spread = {key: np.percentile(column[key], (25, 50, 75)) for key in ("recall", "precision")}
                texts = [f"{m:.3f} ({a:.3f}-{b:.3f})" for a, m, b in spread.values()]
                others = [float(np.median(column[key])) for key in ("regions", "best", "seconds")]
                print(f"{kind:18} {size:5} {texts[0]:>20} {texts[1]:>20} {others[0]:8.2f} "
                      f"{others[1]:7.3f} {others[2]:11.4f}", flush=True)  # fmt: skip
    if options.json:
        options.json.write_text(json.dumps(table, indent=1))


if __name__ == "__main__":
    main()
