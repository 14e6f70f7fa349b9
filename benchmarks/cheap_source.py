"""What a cheap simulator saves: searches that start from its scores, beside the same search without them.

python benchmarks/cheap_source.py [--half choose|judge] [--only NAME]… [--sizes N…] [--steps N] [--source N] [--seeds N]
                                  --ncap FOLDER --alks FOLDER [--truth FOLDER] [--json FILE]

The scenarios, their truths and the halves are those of intervals.py. `auto` searches each of them without a warm start,
and with one from N scenarios of a Sobol' sequence that a cheap simulator has run:

- ``0.2 s``: the builtin simulator with a time step of 0.2 s, four to ten times that of the truth;
- ``driver``: another driver in the ego, from whose scores little follows.

F1 is that of what `cornercase show` takes for critical; it is 0 where nothing can be predicted. A source whose scores
are all equal is left out.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from cornercase.evidence._multi_fidelity import SourceStudyModel
from cornercase.evidence.gp._gaussian_process import encode_points
from cornercase.metrics import registered_features
from cornercase.optimizers import Auto, Sobol
from cornercase.study._criterion import Criterion

# Beside this file; mypy knows it by its package.
from exploration import CASES, EXAMPLES, Folders, Judge, truth  # type: ignore[attr-defined]
from intervals import HALVES, judge_at, settle_threshold  # type: ignore[import-not-found]

SOURCES = ("none", "0.2 s", "driver")
OTHER_DRIVER = {"normal": "cautious", "aggressive": "normal", "cautious": "normal", None: "cautious"}
ROUND = 10


def cheap_scores(name: str, source: str, folders: Folders, steps: int, folder: Path) -> npt.NDArray[np.float64]:
    """Score of each scenario of the grid by the cheap simulator."""
    case = CASES[name]
    cheap = replace(case, time_step=0.2) if source == "0.2 s" else replace(case, driver=OTHER_DRIVER[case.driver])
    scores: npt.NDArray[np.float64] = truth(name, folders, steps, folder / source.replace(" ", ""), cheap)[:, 0]
    return scores


def search(
    judge: Judge,
    seed: int,
    sizes: list[int],
    warm_start: tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]] | None,
) -> Iterator[dict[str, float]]:
    """Search, and judge at each size."""
    model = None
    optimizer = Auto().start(judge.space, seed, threshold=judge.case.critical, features=registered_features())
    if warm_start is not None:
        optimizer.warm_start(*warm_start)
        model = SourceStudyModel(
            encode_points(judge.space, warm_start[0]), warm_start[1], Criterion(judge.case.critical)
        )
    points = np.zeros((0, judge.space.dimension))
    for size in sizes:
        while len(points) < size:
            new = optimizer.ask(min(ROUND, size - len(points)))
            at = judge.places(new)
            optimizer.tell(new, judge.scores[at], judge.features[at])
            points = np.concatenate([points, new])
        yield {"size": size, "f1": judge_at(judge, "auto", seed, judge.places(points), True, model).get("f1", 0.0)}


def work(
    name: str, source: str, seed: int, folders: Folders, steps: int, folder: Path, sizes: list[int], count: int
) -> list[dict[str, Any]]:
    """Search one scenario from one source."""
    settle_threshold(name, folders, steps, folder)
    with threadpool_limits(1):
        judge, warm_start = Judge(name, folders, steps, folder, ()), None
        if source != "none":
            scores = cheap_scores(name, source, folders, steps, folder)
            points = Sobol().start(judge.space, 1000 + seed).ask(count)
            scores = scores[judge.places(points)]
            finite = np.isfinite(scores)
            if np.ptp(scores[finite]) == 0.0:
                return []
            warm_start = points[finite], scores[finite]
        return [{"case": name, "source": source, "seed": seed, **row} for row in search(judge, seed, sizes, warm_start)]


def print_table(rows: list[dict[str, Any]], sizes: list[int]) -> None:
    """Print F1 by scenario, and means."""
    cases = list(dict.fromkeys(row["case"] for row in rows))
    columns = [(source, size) for source in SOURCES for size in sizes]
    print("\n| scenario | " + " | ".join(f"{source}, {size}" for source, size in columns) + " |")
    for name in (*cases, "mean"):
        mine = [row for row in rows if name in ("mean", row["case"])]
        cells = [[row["f1"] for row in mine if (row["source"], row["size"]) == column] for column in columns]
        texts = [f"{np.mean(cell):.3f}" if cell else "–" for cell in cells]
        print(f"| {name} | " + " | ".join(texts) + " |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--half", choices=HALVES, default="judge")
    parser.add_argument("--only", action="append", help="only this scenario; may be repeated")
    parser.add_argument("--sizes", type=int, nargs="+", default=[50, 100, 200])
    parser.add_argument("--steps", type=int, default=14, help="for each of three parameters")
    parser.add_argument("--source", type=int, default=500, help="scenarios of the cheap simulator")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--ncap", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--alks", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--truth", type=Path, default=Path("truth"), metavar="FOLDER")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    folders: Folders = {"examples": EXAMPLES, "ncap": options.ncap, "alks": options.alks}
    names = options.only or list(HALVES[options.half])
    for name in names:
        settle_threshold(name, folders, options.steps, options.truth)
        for source in SOURCES[1:]:
            cheap_scores(name, source, folders, options.steps, options.truth)
    jobs = [(name, source, seed) for name in names for source in SOURCES for seed in range(options.seeds)]
    with ProcessPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        parts = pool.map(
            work, *zip(*jobs, strict=True), repeat(folders), repeat(options.steps), repeat(options.truth),
            repeat(options.sizes), repeat(options.source),
        )  # fmt: skip
        rows = [row for part in parts for row in part]
    print_table(rows, options.sizes)
    if options.json:
        options.json.write_text(json.dumps(rows))


if __name__ == "__main__":
    main()
