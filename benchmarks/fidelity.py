"""Searches that begin from another study: how many expensive scenarios they need, where it helps and where it misleads.

python benchmarks/fidelity.py [--quick] [--steps N] [--seeds N] [--cheap N] [--most N] [--only NAME]…
                              [--first N] [--sumo N] [--truth FOLDER] [--json FILE]

The truth is the score of every scenario of a grid with N steps for each of three parameters, as in
benchmarks/exploration.py. ``level-set`` searches it from nothing, and from a study of the same parameters which
``level-set`` searched before with another seed: of another driver, or one that says something else altogether. What a
search found is what it ran, and elsewhere what its process takes for critical, as `cornercase.evidence.CriticalSet` has
it.

Counted are the scenarios, in rounds of 5, until the recall is 0.95, and until the precision is 0.9 as well: a set that
is told too large has a recall of 0.95 by luck. Printed are means over the seeds, and their ratio with its standard
error, paired by seed. After 40 scenarios it is judged too whether the truth lies within the 90 % intervals of the
critical share and of what is missed. How much likelier another study has to make scenarios to be used, and how many of
the first ones it chooses, was decided with seeds below 40.

A driver of cornercase drives the same on SUMO as on the builtin simulator, so the grid is run by the latter; ``--sumo
N`` runs N scenarios of each such grid on SUMO too, and prints how far the scores are apart at most.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from cornercase.evidence._critical_set_estimate import CriticalSet
from cornercase.evidence._multi_fidelity import SourceStudyModel, append_source_prediction
from cornercase.evidence.gp._gaussian_process import encode_points, fit_boundary_process
from cornercase.exploration._study_critical_set import is_score_independent
from cornercase.metrics import METRICS
from cornercase.optimizers import LevelSet
from cornercase.recordings import Recording
from cornercase.simulators import SIMULATORS
from cornercase.study._criterion import Criterion

# Beside this file; mypy knows it by its package.
from exploration import CASES, EXAMPLES, logical, stepped, truth  # type: ignore[attr-defined]

Floats = npt.NDArray[np.float64]
ROUND, JUDGED, RECALL, PRECISION, FIRST = 5, 40, 0.95, 0.9, 100
SLOWER = "normal:reaction_time=0.8"


@dataclass(frozen=True)
class Pair:
    """What is searched, and what it begins from; ``twisted`` makes of the grid of the latter's scores what it says."""

    case: str
    expensive: str
    cheap: str
    twisted: Callable[[Floats], Floats] = lambda grid: grid
    cheap_case: str | None = None


PAIRS = {
    "reacts in 0.8 s, not 0.5 s": Pair("x-intersection", SLOWER, "normal"),
    "safety time 1.5 s, not 2 s": Pair("x-intersection", "normal:safety_time=1.5", "normal"),
    "aggressive, not normal": Pair("x-intersection", "aggressive", "normal"),
    "reacts in 1.2 s, not 0.5 s": Pair("x-intersection", "normal:reaction_time=1.2", "normal"),
    "cautious, not normal": Pair("x-intersection", "cautious", "normal"),
    "scores mirrored": Pair("x-intersection", SLOWER, "normal", lambda grid: grid[::-1, ::-1, ::-1]),
    "another scenario's scores": Pair("x-intersection", SLOWER, "normal", cheap_case="t-intersection"),
}


class Grid:
    """Scores of all scenarios of a grid, by who drives."""

    def __init__(self, steps: int, folder: Path) -> None:
        self._steps, self._folder = steps, folder
        self._folders = {"examples": EXAMPLES, "ncap": None, "alks": None}

    def space(self, case: str) -> Any:
        """Space of the grid."""
        return stepped(logical(case, self._folders).space, self._steps)

    def scores(self, case: str, driver: str) -> Floats:
        """Score of each scenario of the grid."""
        name = f"{case}, {driver.replace(':', ' ').replace('=', ' ')}"
        CASES[name] = replace(CASES[case], driver=driver)
        return np.asarray(truth(name, self._folders, self._steps, self._folder)[:, 0])

    def apart(self, case: str, driver: str, count: int) -> float:
        """How far scores of some scenarios on SUMO are from those of the grid at most."""
        about, scenario, space = CASES[case], logical(case, self._folders), self.space(case)
        metric = METRICS.create(about.metric)
        lattice = space.lattice()
        some = np.random.default_rng(0).choice(len(lattice), count, replace=False)
        with SIMULATORS.create(
            "sumo", time_step=about.time_step, on_collision=about.on_collision, drivers={"Ego": driver}
        ) as simulator:
            runs = simulator.run([scenario.concrete_scenario(one) for one in space.values(lattice[some])])
            scores = [
                metric.score(metric.course(run, "Ego", about.other)) for run in runs if isinstance(run, Recording)
            ]
        return float(np.abs(np.array(scores) - self.scores(case, driver)[some]).max())


class Search:
    """One search on a grid."""

    def __init__(self, space: Any, scores: Floats, threshold: float) -> None:
        self.space, self.scores, self.threshold = space, scores, threshold
        self.true = scores <= threshold
        self.lattice = space.lattice()
        self._steps = [int(one.size or 0) for one in space.parameters]

    def places(self, points: Floats) -> npt.NDArray[np.int64]:
        """Where points stand in the grid."""
        numbers = [one.numbers(points[:, j]) for j, one in enumerate(self.space.parameters)]
        return np.asarray(np.ravel_multi_index(tuple(numbers), tuple(self._steps)), dtype=np.int64)

    def known(self, seed: int, count: int) -> tuple[Floats, Floats]:
        """Points and scores of a study of this grid."""
        optimizer, points = (
            LevelSet().start(self.space, seed, threshold=self.threshold),
            np.zeros((0, len(self._steps))),
        )
        while len(points) < count:
            new = optimizer.ask(min(20, count - len(points)))
            optimizer.tell(new, self.scores[self.places(new)])
            points = np.concatenate([points, new])
        return points, self.scores[self.places(points)]

    def run(self, seed: int, most: int, begun: tuple[Floats, Floats] | None) -> dict[str, Any]:
        """Search, from what another study knows or from nothing, and judge each round."""
        optimizer, elsewhere = LevelSet().start(self.space, seed, threshold=self.threshold), None
        if begun is not None:
            optimizer.warm_start(*begun)
            elsewhere = SourceStudyModel(encode_points(self.space, begun[0]), begun[1], Criterion(self.threshold))
        everywhere = append_source_prediction(elsewhere, encode_points(self.space, self.lattice))
        points, rows, within = np.zeros((0, len(self._steps))), [], {}
        while len(points) < most:
            new = optimizer.ask(ROUND)
            optimizer.tell(new, self.scores[self.places(new)])
            points = np.concatenate([points, new])
            at = self.places(points)
            if len(points) >= 2 * ROUND and np.ptp(self.scores[at]) > 0.0:
                process = fit_boundary_process(
                    everywhere[at], self.scores[at], Criterion(self.threshold), has_prediction=elsewhere is not None
                )
                told = process.predict(everywhere)[0] <= 0.0
                told[at] = self.true[at]
                both = (told & self.true).sum()
                rows.append((len(points), both / self.true.sum(), both / max(told.sum(), 1)))
            if len(points) == JUDGED:
                within = self._within(points, seed, elsewhere)
        return {"rows": rows, **within}

    def _within(self, points: Floats, seed: int, elsewhere: SourceStudyModel | None) -> dict[str, float]:
        """Whether the truth lies within the intervals; NaN where none is given."""
        known = CriticalSet(
            self.space, points, self.scores[self.places(points)], Criterion(self.threshold), seed,
            initial_design=is_score_independent("level-set", self.space, seed, points), source_model=elsewhere,
        )  # fmt: skip
        missed = 1.0 - (known.predict(self.lattice) & self.true).sum() / self.true.sum()
        share = known.critical_fraction.low <= self.true.mean() <= known.critical_fraction.high
        return {
            "share": np.nan if known.interval_unavailable else float(share),
            "missed": np.nan
            if known.missed_interval_unavailable
            else float(known.missed_fraction.low <= missed <= known.missed_fraction.high),
        }


def needed(run: dict[str, Any], precision: float, most: int) -> float:
    """Scenarios until it is found; twice as many as there are where it is not."""
    return next((n for n, recall, right in run["rows"] if recall >= RECALL and right >= precision), 2 * most)


def ratio(before: list[float], now: list[float]) -> tuple[float, float]:
    """Ratio of the means of paired counts, and its standard error to first order."""
    of = float(np.mean(now) / np.mean(before))
    rest = np.array(now) - of * np.array(before)
    return of, float(np.std(rest, ddof=1) / np.mean(before) / np.sqrt(len(rest))) if len(rest) > 1 else np.nan


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="10 steps, 2 seeds")
    parser.add_argument("--steps", type=int, default=20)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=FIRST, help="first seed")
    parser.add_argument("--cheap", type=int, default=200, help="scenarios of the study to begin from")
    parser.add_argument("--most", type=int, default=80, help="scenarios of each search")
    parser.add_argument("--only", action="append", choices=PAIRS, help="only this one; may be repeated")
    parser.add_argument("--sumo", type=int, default=0, metavar="N", help="scenarios to run on SUMO too")
    parser.add_argument("--truth", type=Path, default=Path("truth"), metavar="FOLDER")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    seeds, most = range(options.first, options.first + (2 if options.quick else options.seeds)), options.most
    options.truth.mkdir(parents=True, exist_ok=True)
    grid = Grid(10 if options.quick else options.steps, options.truth)
    cold: dict[str, list[dict[str, Any]]] = {}
    rows = []
    print(f"{'begins from':28} {'recall 0.95':>27} {'and precision 0.9':>27} {'share':>7} {'missed':>7}")
    for name in options.only or PAIRS:
        pair = PAIRS[name]
        threshold = CASES[pair.case].critical
        space = grid.space(pair.case)
        there = grid.scores(pair.cheap_case or pair.case, pair.cheap)
        side = [round(len(there) ** (1.0 / space.dimension))] * space.dimension
        cheap = Search(space, np.ascontiguousarray(pair.twisted(there.reshape(side))).ravel(), threshold)
        search = Search(space, grid.scores(pair.case, pair.expensive), threshold)
        with threadpool_limits(1):
            if pair.expensive not in cold:
                cold[pair.expensive] = [search.run(seed, most, None) for seed in seeds]
            warm = [search.run(seed, most, cheap.known(1000 + seed, options.cheap)) for seed in seeds]
        counts = {
            (kind, right): [needed(run, right, most) for run in runs]
            for kind, runs in (("nothing", cold[pair.expensive]), ("another", warm))
            for right in (0.0, PRECISION)
        }
        texts = []
        for right in (0.0, PRECISION):
            before, now = counts["nothing", right], counts["another", right]
            of, error = ratio(before, now)
            texts.append(f"{np.mean(before):.1f} -> {np.mean(now):.1f} {of:.2f} ± {error:.2f}")
        within = [np.array([run[what] for run in warm]) for what in ("share", "missed")]
        held = [f"{np.nansum(one):.0f}/{np.isfinite(one).sum()}" for one in within]
        print(f"{name:28} {texts[0]:>27} {texts[1]:>27} {held[0]:>7} {held[1]:>7}", flush=True)
        rows.append({"pair": name, "counts": {f"{kind}, {right}": one for (kind, right), one in counts.items()},
                     "cold": cold[pair.expensive], "warm": warm})  # fmt: skip
        if options.sumo:
            apart = grid.apart(pair.case, pair.expensive, options.sumo)
            print(f"  scores of {options.sumo} scenarios are up to {apart:g} apart on SUMO", flush=True)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
