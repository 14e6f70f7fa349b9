"""What a proposal takes, in seconds of CPU, beside what others take for the same.

python benchmarks/proposals.py [--quick] [--json FILE]

Rounds of ten are asked for and told, from N scenarios on until there is a quarter more; so whatever is learned now and
then is in the figures. Beside the mean of a proposal stands the dearest round, a tenth of which is what its proposals
took. Also judged: the critical set of N scenarios.

The peers do what is done once per round, at the same size: PHYSBO as it comes, which learns its hyperparameters anew,
for `bayes`; and for `level-set` and the critical set scikit-learn's Gaussian process of a given kernel, whose mean and
deviation are asked for at as many places, without anything being learned.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from cornercase.evidence._critical_set_estimate import CriticalSet
from cornercase.optimizers import Bayes, LevelSet, Optimizer, Sobol
from cornercase.scenario import ParameterSpace
from cornercase.study._criterion import Criterion

Floats = npt.NDArray[np.float64]

SPACE = ParameterSpace.from_ranges(["a=0:1", "b=0:1", "c=0:1"])
THRESHOLD, ROUND = 1.0, 10


def places(count: int, seed: int = 0) -> Floats:
    return Sobol().start(SPACE, seed).ask(count)


def scores(points: Floats) -> Floats:
    """Critical in a pillar and in a ball apart from it, 13.6 % of the cube."""
    pillar = np.hypot(points[:, 0] - 0.25, points[:, 1] - 0.3) - 0.18
    ball = np.linalg.norm(points - (0.8, 0.75, 0.5), axis=1) - 0.2
    return np.asarray(THRESHOLD + 5.0 * np.minimum(pillar, ball))


def cpu_seconds(call: Callable[[], Any]) -> float:
    begin = time.process_time()
    call()
    return time.process_time() - begin


def proposals(optimizer: Optimizer, told: int, most_rounds: int) -> dict[str, float]:
    """Mean CPU time of a proposal after so many scenarios, and that of the dearest round."""
    points = places(told)
    for first in range(0, told, ROUND):
        optimizer.tell(points[first : first + ROUND], scores(points[first : first + ROUND]))
    spent = []
    for _ in range(min(told // (4 * ROUND), most_rounds)):
        begin = time.process_time()
        new = optimizer.ask(ROUND)
        spent.append(time.process_time() - begin)
        optimizer.tell(new, scores(new))
    return {"seconds": float(np.mean(spent)) / ROUND, "dearest round": max(spent)}


def of_physbo(told: int) -> float:
    """CPU time of a round: PHYSBO as it comes, told so many scenarios, with 2000 candidates and 500 features."""
    import physbo

    points, candidates = places(told), places(2000, 1)

    def ask() -> None:
        with contextlib.redirect_stdout(io.StringIO()):
            policy = physbo.search.discrete.Policy(test_X=candidates)
            policy.bayes_search(
                training=physbo.Variable(X=points, t=-scores(points)), max_num_probes=0, interval=0,
                num_rand_basis=500, is_disp=False,
            )  # fmt: skip
            for share in np.array_split(np.arange(len(candidates)), ROUND):
                policy.get_score("TS", actions=share)

    return cpu_seconds(ask)


def of_scikit_learn(told: int, asked: int) -> float:
    """CPU time of scikit-learn for the process of so many scenarios at so many places."""
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import Matern

    points, at = places(told), places(asked, 1)
    process = GaussianProcessRegressor(Matern((0.5, 0.5, 0.7), nu=2.5), alpha=1e-3, optimizer=None)
    return cpu_seconds(lambda: process.fit(points, scores(points)).predict(at, return_std=True))


def judged(told: int, repeats: int) -> float:
    points = places(told)

    def judge() -> None:
        known = CriticalSet(SPACE, points, scores(points), Criterion(THRESHOLD))
        _ = known.critical_fraction, known.missed_fraction

    return float(np.median([cpu_seconds(judge) for _ in range(repeats)]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="up to 400 scenarios")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []
    makers: dict[str, Callable[[], Optimizer]] = {
        "bayes": lambda: Bayes().start(SPACE, 0),
        "level-set": lambda: LevelSet().start(SPACE, 0, threshold=THRESHOLD),
        "level-set, 100,000 candidates": lambda: LevelSet(candidates=100_000).start(SPACE, 0, threshold=THRESHOLD),
    }
    print(f"{'what':32} {'told':>6} {'CPU s':>8} {'dearest round':>14} {'peer':>8}   peer is")
    with threadpool_limits(1):
        proposals(makers["bayes"](), 40, 1)
        for told in (100, 400) if options.quick else (100, 400, 2000):
            for name, make in makers.items():
                found = proposals(make(), told, 5 if options.quick else 100)
                peer = of_physbo(told) if name == "bayes" else of_scikit_learn(told, 20_000)
                called = "PHYSBO" if name == "bayes" else "scikit-learn, 20,000 places"
                rows.append({"what": name, "told": told, **found, "peer": peer / ROUND, "peer is": called})
            peer = of_scikit_learn(told, 2**14)
            rows.append({"what": "critical set", "told": told, "seconds": judged(told, 3), "peer": peer,
                         "peer is": "scikit-learn, 16,384 places"})  # fmt: skip
            for row in rows[-len(makers) - 1 :]:
                dearest = f"{row['dearest round']:.3f}" if "dearest round" in row else ""
                print(f"{row['what']:32} {row['told']:6} {row['seconds']:8.4f} {dearest:>14} {row['peer']:8.4f}"
                      f"   {row['peer is']}", flush=True)  # fmt: skip
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
