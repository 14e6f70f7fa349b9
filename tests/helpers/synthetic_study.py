"""A simulator whose recordings follow from the parameters alone, and a program with it that can be killed at will.

The other entity stands at 10 |a - b| m from the ego; a scenario with a > 0.9 fails.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from cornercase._common.errors import SimulationError
from cornercase.exploration._asynchronous import AsynchronousExplorer
from cornercase.exploration._config import ExplorationConfig
from cornercase.exploration._explorer import ScenarioExplorer
from cornercase.metrics import METRICS
from cornercase.optimizers import OPTIMIZERS
from cornercase.recordings import Recording
from cornercase.scenario import LogicalScenario, ParameterSpace
from cornercase.simulators import Simulator
from cornercase.study import StudyFile, StudyMeta
from cornercase.study._criterion import Criterion

SPACE = ParameterSpace.from_ranges(["a=0:1:0.01", "b=0:1"])
LOGICAL = LogicalScenario(Path("synthetic.xosc"), SPACE, "0")


class Synthetic(Simulator):
    name = "synthetic"

    def __init__(self, survives=None, interrupts=None):
        self.settings: dict[str, Any] = {}
        self.left, self.interrupts, self.ran = survives, interrupts, 0

    def run(self, concretes):
        for concrete in concretes:
            if self.left == 0:
                psutil.Process().kill()
            if self.ran == self.interrupts:
                signal.raise_signal(signal.SIGINT)
            if self.left is not None:
                self.left -= 1
            self.ran += 1
            a, b = concrete.values["a"], concrete.values["b"]
            if a > 0.9:
                yield SimulationError(f"a is {a}")
                continue
            still = np.zeros((2, 5))
            x = np.stack([np.zeros(5), np.full(5, 10 * abs(a - b))])
            yield Recording(
                time=np.arange(5.0),
                names=("Ego", "B"),
                object_types=("car", "car"),
                x=x,
                y=still,
                heading=still,
                speed=still,
                acceleration=still,
                # So small that they never touch: in a contact the distance would count as 0.
                length=np.full(2, 1e-6),
                width=np.full(2, 1e-6),
                center_x=np.zeros(2),
            )


def about(space, *metrics, **more):
    """What a study of a synthetic scenario is about."""
    given = {"ego": "Ego", "other": "B", "optimizer": "none", "simulator": "synthetic", "fingerprint": "0"} | more
    return StudyMeta(scenario="synthetic.xosc", space=space, metrics=metrics, **given)


def explorer(study, simulator=None, optimizer="bayes", metrics=("distance",), budget=47, logical=LOGICAL, **options):
    metrics = [METRICS.create(name) if isinstance(name, str) else name for name in metrics]
    options |= {"optimizer": "bayes", "metrics": (), "budget": budget, "seed": 7}
    configuration = ExplorationConfig(logical, ego="Ego", other="B", **options)
    threshold = Criterion(1.0, metrics[0].lower_is_critical).oriented
    optimizer = OPTIMIZERS.create(optimizer).start(logical.space, 7, threshold=threshold, budget=budget)
    kind = AsynchronousExplorer if configuration.asynchronous else ScenarioExplorer
    return kind(configuration, simulator or Synthetic(), optimizer, study, configuration.make_objective(metrics))


def opened(path, space=SPACE, **more):
    return (
        StudyFile.open(path, readonly=False)
        if os.path.exists(path)
        else StudyFile.create(path, about(space, "distance", "wttc", **more))
    )


def go_on(path, optimizer, survives=None, **without):
    """Explore to the end, or until the simulator has killed its process."""
    with opened(path, **without) as study:
        return explorer(study, Synthetic(survives), optimizer, ("distance", "wttc"), **without).run()


def go_on_until_killed(path, optimizer, survives, *asynchronous):
    """Explore in a process of its own, which its simulator kills."""
    program = [sys.executable, __file__, path, str(survives), optimizer, *asynchronous]
    assert subprocess.run(program, check=False).returncode != 0


if __name__ == "__main__":
    go_on(sys.argv[1], sys.argv[3], int(sys.argv[2]), **({"asynchronous": True} if sys.argv[4:] else {}))
