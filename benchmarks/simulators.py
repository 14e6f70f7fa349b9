"""The same exploration on several simulators: what each finds of the other's critical scenarios, and how fast.

python benchmarks/simulators.py [--quick] [--simulators builtin,sumo] [--workers N] [--json FILE]

Each simulator runs the paper's two experiments with its own normal driver, searched by level sets for TTC <= 0.5 s and
WTTC <= 0.5 s. What each found, by its Gaussian process, is asked on 4,096 concrete scenarios that are the same for all:
the recall of A by B is the share of what is critical on A that B says is critical. Speed is that of the simulation
alone, per worker.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import qmc

from cornercase.evidence._critical_set_estimate import CriticalSet
from cornercase.exploration._explore import explore_config
from cornercase.exploration._paper_examples import paper_experiment_config
from cornercase.study import StudyFile
from cornercase.study._criterion import Criterion
from cornercase.study._objective import Objective


def explored(name: str, simulator: str, budget: int, workers: int, folder: Path) -> dict[str, Any]:
    metric = {"x-intersection": "wttc", "t-intersection": "ttc"}[name]
    path = folder / f"{name}-{simulator.partition(':')[0]}.db"
    asked = paper_experiment_config(name, budget=budget, simulator=simulator, workers=workers)
    explore_config(replace(asked, metrics=(metric,), optimizer="level-set", critical=0.5), path, progress=True)
    with StudyFile.open(path, readonly=True) as study:
        scores = Objective.from_study_meta(study.meta).minimized_scores(study)
        points = np.array([row.point for row in study.finished_rows()])
        space = study.space
        places = space.snap(qmc.Sobol(space.dimension, seed=7).random(4096))
        found = CriticalSet(space, points, scores, Criterion(0.5)).predict(places)
        ends = [study.recording(row.id).time[-1] for row in study.finished_rows()]
        seconds = study.elapsed_by_stage()["simulate"]
        return {
            "found": found,
            "critical": int((scores <= 0.5).sum()),
            "per_second": len(points) / seconds / workers,
            "times_real_time": float(np.sum(ends)) / seconds / workers,
        }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="40 scenarios each in place of 200")
    parser.add_argument("--simulators", default="builtin,sumo")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    names = options.simulators.split(",")
    table = []
    with tempfile.TemporaryDirectory() as folder:
        for case in ("x-intersection", "t-intersection"):
            budget = 40 if options.quick else 200
            # The builtin simulator steps batches, which one worker does best.
            found = {
                name: explored(case, name, budget, 1 if name == "builtin" else options.workers, Path(folder))
                for name in names
            }
            for name, one in found.items():
                recalls = {
                    other: float((one["found"] & two["found"]).sum() / max(two["found"].sum(), 1))
                    for other, two in found.items()
                    if other != name
                }
                row = {
                    "case": case, "simulator": name, "critical run": one["critical"],
                    "critical share": float(np.mean(one["found"])), "per second": one["per_second"],
                    "times real time": one["times_real_time"], "recall of": recalls,
                }  # fmt: skip
                table.append(row)
                told = ", ".join(f"{share:.2f} of {other}'s" for other, share in recalls.items())
                print(
                    f"{case:16} {name:10} {row['critical run']:4} of {budget} critical, {row['critical share']:6.1%} of"
                    f" the space; recall {told}; {row['per second']:.1f} scenarios/s a worker,"
                    f" {row['times real time']:.0f} times real time",
                    flush=True,
                )
    if options.json:
        options.json.write_text(json.dumps(table, indent=1))


if __name__ == "__main__":
    main()
