"""Searches of 6 to 12 parameters: F1 of the critical set, whether intervals hold, and CPU per proposal.

python benchmarks/dimensions.py [--dimensions N…] [--search NAME]… [--sizes N…] [--seeds N] [--judged N] [--json FILE]
                                [--quick]

The parameters are those of the scenario, and then those of the driver `normal` in the ego, one after the other. The
truth is the score of scenarios drawn from the space, whatever the searches run. What a study would show is judged: the
committee with features for searches that use them, otherwise the process of the scores. `share` and `missed` are 1 if
the interval holds the truth, and NaN if there is none. Rounds are of ten. Results are written to --json as they come,
and what is there already is not run again.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from cornercase.evidence._critical_set_estimate import CriticalSet
from cornercase.exploration._study_critical_set import is_score_independent, uses_features_for_critical_set
from cornercase.metrics import METRICS, compute_features, registered_features
from cornercase.scenario import LogicalScenario
from cornercase.simulators import Builtin
from cornercase.study._criterion import Criterion
from exploration import EXAMPLES, SEARCHES, Case  # type: ignore[attr-defined]
from peers import searched  # type: ignore[import-not-found]

Floats = npt.NDArray[np.float64]
KINDS: Final = ("sobol", "level-set", "auto", "forest-al", "optuna (TPE)")
FIGURES: Final = ("F1", "recall", "precision", "share", "missed", "ms")
ROUND: Final = 10
# Of the driver in the ego.
DRIVER_RANGES: Final = (
    "Ego.reaction_time=0.1:1.5",
    "Ego.max_deceleration=4:9",
    "Ego.lateral_margin=0:0.6",
    "Ego.horizon=1.5:5",
    "Ego.safety_time=0.2:2",
    "Ego.sight_range=15:100",
    "Ego.acceleration=1:3",
)


CASES: Final = {
    "x-intersection": Case(
        "x_intersection/x_intersection.xosc", "Pedestrian", "wttc", 0.25,
        ("ego_start=20:80", "pedestrian_wait=0:8", "p1_speed=5:12", "ego_speed=7:13", "pedestrian_speed=1:3",
         "truck_speed=5:10"), "normal", "continue",
    ),
    "t-intersection": Case(
        "t_intersection/t_intersection.xosc", "C", "ttc", 0.25,
        ("ego_sync_s=2:17", "c_start_time=0:5", "c_routing_distance=0:80", "ego_speed=6:14", "c_speed=6:14"), "normal",
        "stop",
    ),
}  # fmt: skip


class Judge:
    """Runs scenarios of one case with some parameters, and knows which of many others are critical."""

    def __init__(self, name: str, dimension: int, n_judged: int) -> None:
        self.case = CASES[name]
        ranges = (*self.case.ranges, *DRIVER_RANGES)[:dimension]
        self.scenario = LogicalScenario.read(EXAMPLES / self.case.file, None, ranges)
        self.space = self.scenario.space
        self.points = self.space.snap(np.random.default_rng(dimension).random((n_judged, dimension)))
        self.critical = self.run(self.points)[0] <= self.case.critical

    def run(self, points: Floats) -> tuple[Floats, Floats]:
        """Scores (n,) and features (n, f) of scenarios."""
        case, metric = self.case, METRICS.create(self.case.metric)
        simulator = Builtin(drivers={"Ego": case.driver}, on_collision=case.on_collision)
        scores, features = [], []
        for first in range(0, len(points), 500):
            values = self.space.values(points[first : first + 500])
            runs = []
            for run in simulator.run([self.scenario.concrete_scenario(one) for one in values]):
                if isinstance(run, Exception):
                    raise run
                runs.append(run)
            scores += [metric.score(metric.course(run, "Ego", case.other)) for run in runs]
            features.append(compute_features(runs, "Ego", case.other))
        return np.array(scores), np.concatenate(features)

    def figures(self, kind: str, seed: int, points: Floats, scores: Floats, features: Floats) -> dict[str, float]:
        """What a study of these scenarios would show, against the truth."""
        known = CriticalSet(
            self.space, points, scores, Criterion(self.case.critical), seed,
            initial_design=is_score_independent(kind.partition(" ")[0], self.space, seed, points),
            features=(registered_features(), features) if uses_features_for_critical_set(kind, len(points)) else None,
        )  # fmt: skip
        told, true = known.predict(self.points), self.critical
        recall, precision = (float((told & true).sum() / max(count.sum(), 1)) for count in (true, told))
        share, missed = known.critical_fraction, known.missed_fraction
        return {
            "F1": 2.0 * recall * precision / max(recall + precision, 1e-9),
            "recall": recall,
            "precision": precision,
            "share": np.nan if known.interval_unavailable else float(share.low <= true.mean() <= share.high),
            "missed": np.nan if known.missed_interval_unavailable else float(missed.low <= 1.0 - recall <= missed.high),
        }


def search(judge: Judge, kind: str, seed: int, sizes: list[int]) -> Iterator[dict[str, float]]:
    """Run one search, and judge it at each size."""
    optimizer = searched(judge, kind, seed, sizes[-1])
    points, scores = np.zeros((0, judge.space.dimension)), np.zeros(0)
    features, spent = np.zeros((0, len(registered_features()))), 0.0
    for size in sizes:
        while len(points) < size:
            begin = time.process_time()
            asked = optimizer.ask(min(ROUND, size - len(points)))
            spent += time.process_time() - begin
            new_scores, new_features = judge.run(asked)
            begin = time.process_time()
            optimizer.tell(asked, new_scores, *((new_features,) if "features" in optimizer.requires else ()))
            spent += time.process_time() - begin
            points, scores = np.concatenate([points, asked]), np.concatenate([scores, new_scores])
            features = np.concatenate([features, new_features])
        yield {"size": size, "ms": 1e3 * spent / size, **judge.figures(kind, seed, points, scores, features)}


def table(rows: list[dict[str, Any]], dimensions: list[int], sizes: list[int]) -> None:
    """Print means over scenarios and seeds, by number of parameters."""
    for figure in FIGURES:
        for size in sizes:
            print(
                f"\n{figure}, {size} scenarios\n| search | " + " | ".join(f"{d} parameters" for d in dimensions) + " |"
            )
            for kind in dict.fromkeys(row["search"] for row in rows):
                chosen = [
                    [row[figure] for row in rows if (row["search"], row["size"], row["d"]) == (kind, size, d)]
                    for d in dimensions
                ]
                digits = 1 if figure == "ms" else 2
                print(f"| {kind} | " + " | ".join(f"{np.nanmean(x):.{digits}f}" if x else "–" for x in chosen) + " |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--dimensions", type=int, nargs="+", default=[6, 8, 10, 12], choices=range(2, 13))
    parser.add_argument("--search", action="append", choices=(*SEARCHES, "forest-al"), help="may be repeated")
    parser.add_argument("--sizes", type=int, nargs="+", default=[100, 200, 400, 1000])
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--judged", type=int, default=8192, help="scenarios of which the truth is known")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--quick", action="store_true", help="6 parameters, 60 scenarios, sobol and auto")
    options = parser.parse_args()
    kinds = options.search or list(KINDS)
    if options.quick:
        options.dimensions, options.sizes, options.judged, kinds = [6], [60], 500, ["sobol", "auto"]
    known = options.json is not None and options.json.exists()
    lines = options.json.read_text(encoding="utf-8").splitlines() if known else []
    rows: list[dict[str, Any]] = [json.loads(line) for line in lines]
    done = {(row["case"], row["d"], row["search"], row["seed"]) for row in rows}
    with threadpool_limits(1):
        for name in CASES:
            for dimension in options.dimensions:
                judge = Judge(name, dimension, options.judged)
                print(f"{name}, {dimension} parameters: {judge.critical.mean():.1%} critical", flush=True)
                for seed in range(options.seeds):
                    for kind in [one for one in kinds if (name, dimension, one, seed) not in done]:
                        common = {"case": name, "d": dimension, "search": kind, "seed": seed}
                        new = [common | row for row in search(judge, kind, seed, options.sizes)]
                        rows += new
                        if options.json:
                            with options.json.open("a", encoding="utf-8") as file:
                                file.writelines(json.dumps(row) + "\n" for row in new)
    table(rows, options.dimensions, options.sizes)


if __name__ == "__main__":
    main()
