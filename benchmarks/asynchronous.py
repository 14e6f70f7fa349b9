"""Searches in rounds and without, on a simulator of which some scenarios take much longer than others.

python benchmarks/asynchronous.py [--quick] [--search NAME]… [--workers N] [--budget N] [--json FILE]

The simulator sleeps 0.5 s, in one of ten scenarios 3 s: where a round waits for its slowest scenario, workers stand
idle. Each search runs with rounds of as many scenarios as there are workers, and with ``asynchronous``. Beside them
stand the bounds: the sum of all that was slept, for one worker that never waits, and that divided by the number of
workers. ``--one`` runs one worker too.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from cornercase import LogicalScenario
from cornercase.exploration._asynchronous import AsynchronousExplorer
from cornercase.exploration._config import ExplorationConfig
from cornercase.exploration._explorer import ScenarioExplorer
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import SIMULATORS, Simulator
from cornercase.simulators._create import create_simulator
from cornercase.study import StudyFile

EXAMPLE = Path(__file__).parents[1] / "examples" / "x_intersection" / "x_intersection"
SHORT, LONG, SHARE = 0.5, 3.0, 0.1
SEARCHES = ("bayes", "level-set", "committee")


def seconds_of(values: Sequence[float]) -> float:
    """How long a scenario takes: by its values, so that it is the same however it is run."""
    seed = np.frombuffer(np.asarray(values, dtype=np.float64).tobytes(), dtype=np.uint32)
    return LONG if np.random.default_rng(seed).random() < SHARE else SHORT


class Sleeping(Simulator):
    """Lets a car drive straight on and a pedestrian cross, and sleeps."""

    name = "sleeping"

    def __init__(self, **options: Any) -> None:
        self.settings: dict[str, object] = {}

    def run(self, concretes: Sequence[ConcreteScenario]) -> Iterator[Recording]:
        """Run scenarios, as in `Simulator.run`."""
        time_ = np.arange(0.0, 10.0, 0.1)
        for concrete in concretes:
            start, wait, speed = (float(concrete.values[name]) for name in ("ego_start", "pedestrian_wait", "p1_speed"))
            time.sleep(seconds_of([start, wait, speed]))
            walked = np.maximum(time_ - wait, 0.0) * 1.5
            ones = np.ones_like(time_)
            yield Recording(
                time=time_,
                names=("Ego", "Pedestrian"),
                object_types=("car", "pedestrian"),
                x=np.stack([speed * time_ - start, 0.0 * ones]),
                y=np.stack([0.0 * ones, walked - 5.0]),
                heading=np.stack([0.0 * ones, np.pi / 2 * ones]),
                speed=np.stack([speed * ones, 1.5 * ones]),
                acceleration=np.zeros((2, len(time_))),
                length=np.array([4.5, 0.5]),
                width=np.array([1.8, 0.5]),
                center_x=np.array([1.4, 0.0]),
            )


SIMULATORS.register("sleeping", Sleeping)


def timed(search: str, asynchronous: bool, workers: int, budget: int, folder: Path) -> dict[str, Any]:
    """Run one exploration in processes that are there already, and tell how long it took."""
    logical = LogicalScenario.read(EXAMPLE.with_suffix(".xosc"), EXAMPLE.with_suffix(".space.xosc"))
    configuration = ExplorationConfig(
        logical, ego="Ego", other="Pedestrian", metrics=("wttc",), optimizer=search, simulator="sleeping",
        budget=budget, batch=workers, workers=workers, asynchronous=asynchronous, seed=1,
    )  # fmt: skip
    objective = configuration.make_objective()
    optimizer = configuration.start_optimizer(objective)
    meta = configuration.make_study_meta(objective, {})
    kind = AsynchronousExplorer if asynchronous else ScenarioExplorer
    names = [one.name for one in logical.space.parameters]
    with (
        StudyFile.create(folder / f"{search}-{asynchronous}-{workers}.db", meta) as study,
        create_simulator("sleeping", workers=workers) as simulator,
    ):
        middle = logical.concrete_scenario(logical.space.values(logical.space.center_point())[0])
        list(simulator.run([middle] * workers))
        begun, used = time.monotonic(), time.process_time()
        kind(configuration, simulator, optimizer, study, objective).run()
        took, used = time.monotonic() - begun, time.process_time() - used
        slept = sum(seconds_of([float(row.values[name]) for name in names]) for row in study.finished_rows())
        spent = {stage: round(seconds, 2) for stage, seconds in study.elapsed_by_stage().items()}
        same = [scenario for scenario, _ in study.result_order()]
    return {
        "search": search, "asynchronous": asynchronous, "workers": workers, "scenarios": budget, "seconds": took,
        "slept": slept, "busy": slept / workers / took, "cpu": used, "elapsed": spent,
        "overtaken": sum(a > b for a, b in pairwise(same)),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="level-set alone, 60 scenarios")
    parser.add_argument("--search", action="append", help="only this one; may be repeated")
    parser.add_argument("--workers", type=int, default=8)
    parser.add_argument("--budget", type=int, default=400)
    parser.add_argument("--one", action="store_true", help="with one worker, too")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    searches = options.search or (["level-set"] if options.quick else SEARCHES)
    budget = 60 if options.quick else options.budget
    rows = []
    print(
        f"{'search':12} {'how':>12} {'workers':>8} {'s':>8} {'scenarios/s':>12} {'workers busy':>13} {'asking, s':>10}"
    )
    with TemporaryDirectory() as folder:
        kinds = [(False, options.workers), (True, options.workers), *([(True, 1)] if options.one else [])]
        for search in searches:
            for asynchronous, workers in kinds:
                row = timed(search, asynchronous, workers, budget, Path(folder))
                rows.append(row)
                how = "asynchronous" if asynchronous else "rounds"
                print(f"{search:12} {how:>12} {workers:8} {row['seconds']:8.1f} {budget / row['seconds']:12.2f} "
                      f"{row['busy']:13.1%} {row['elapsed'].get('optimize', 0.0):10.1f}", flush=True)  # fmt: skip
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
