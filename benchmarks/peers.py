"""Searches and peers on the scenarios of exploration.py: F1 of the critical set by three judges, regions met, and CPU.

python benchmarks/peers.py [--half choose|judge] [--only NAME]… [--search NAME]… [--sizes N…] [--steps N] [--seeds N]
                           [--ncap FOLDER] [--alks FOLDER] [--truth FOLDER] [--json FILE]

The truth, the halves and the folders are those of exploration.py. A search found what it ran, and what a classifier of
its runs takes for critical:

- ``own``: what `cornercase show` would say, the committee with features for searches that use them, otherwise the
  process of the scores;
- ``features``: the committee with features, on the runs of every search;
- ``parameters``: of the process and a random forest of the parameters, the one with the least log loss in five folds.

Peers: ``forest-al``, a few lines: extremely randomised trees on the parameters, asked where p (1 - p) times the
distance to what was run is largest; ``optuna (TPE)`` by Optuna; ``evolutionary`` by pymoo; ``nsga2-d``, which is
NSGA-II-D of OpenSBT written with pymoo; ``botorch``, a Gaussian process of BoTorch with its own settings, asked where
it is least sure on which side of the threshold a scenario is (straddle); ``verifai-ce`` (cross entropy) and
``verifai-mab`` (multi-armed bandit) by VerifAI with its own settings. BoTorch and VerifAI have to be installed (``pip
install botorch verifai``, in an environment of its own). Rounds are of ten. Results are written to --json as they come,
and what is there already is not run again.
"""

from __future__ import annotations

import argparse
import json
import random
import time
from abc import abstractmethod
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from pymoo.algorithms.moo.nsga2 import NSGA2
from pymoo.core.evaluator import Evaluator
from pymoo.core.population import Population
from pymoo.core.problem import Problem
from pymoo.core.termination import NoTermination
from pymoo.operators.crossover.sbx import SBX
from pymoo.operators.mutation.pm import PM
from pymoo.operators.sampling.lhs import LHS
from pymoo.problems.static import StaticProblem
from scipy.spatial import cKDTree
from sklearn.ensemble import ExtraTreesClassifier
from threadpoolctl import threadpool_limits

from cornercase.evidence._committee import PREDICTED_CRITICAL, CommitteeModel
from cornercase.metrics import registered_features
from cornercase.optimizers import Optimizer, Sobol
from cornercase.study._criterion import Criterion
from exploration import CASES, CHOOSE, EXAMPLES, JUDGE, SEARCHES, Judge  # type: ignore[attr-defined]
from judging import best_classifier  # type: ignore[import-not-found]

Floats = npt.NDArray[np.float64]
KINDS = ("sobol", "bayes", "level-set", "committee", "auto", "forest-al")
VERIFAI = {"verifai-ce": "crossEntropySamplerFor", "verifai-mab": "multiArmedBanditSamplerFor"}
JUDGES = ("found", "process", "parameters")
ROUND, INITIAL, TREES, CANDIDATES, FILLING, WIDTH = 10, 24, 100, 4096, 0.2, 0.1
# Of NSGA-II-D; its archive takes what is further than NOVEL from all in it.
POPULATION, REPLACED, NOVEL = 20, 6, 0.1
# A failed scenario is not critical.
FAILED = 1e3


class Filled(Optimizer):
    """Begins with points of a Sobol' sequence; later a fifth of the points continue it."""

    requires = frozenset({"threshold"})

    def prepare(self, space: Any, seed: int, *further: Any, **required: Any) -> None:
        """Prepare the search of a space."""
        self._space, self._seed, self._threshold = space, seed, required["threshold"]
        self._sequence = Sobol().start(space, seed)
        self._points, self._scores = np.zeros((0, space.dimension)), np.zeros(0)

    def tell(self, points: Floats, scores: Floats) -> None:
        """Observe the scores of one round."""
        self._points, self._scores = np.concatenate([self._points, points]), np.concatenate([self._scores, scores])
        self._sequence.tell(points, scores)

    def ask(self, n: int) -> Floats:
        """Propose n points."""
        known = len(self._points)
        filling = n if known < INITIAL else int(FILLING * (known + n)) - int(FILLING * known)
        first = self._sequence.ask(min(filling, n))
        if len(first) == n:
            return first
        finite = np.isfinite(self._scores)
        return np.concatenate([self.choose(n - len(first), first, self._points[finite], self._scores[finite]), first])

    @abstractmethod
    def choose(self, n: int, first: Floats, points: Floats, scores: Floats) -> Floats:
        """Choose n points besides the first ones of a round, from those that have a score."""


class ActiveForest(Filled):
    """Samples where trees on the parameters are uncertain, away from what was run."""

    name = "forest-al"

    def choose(self, n: int, first: Floats, points: Floats, scores: Floats) -> Floats:
        """Choose n points by trees."""
        known = len(self._points)
        critical = scores <= max(self._threshold, scores.min())
        everywhere = Sobol().start(self._space, self._seed + known + 1).ask(CANDIDATES // 2)
        rng = np.random.default_rng([self._seed, known])
        centres = points[critical][rng.integers(critical.sum(), size=CANDIDATES // 2)]
        near = centres + WIDTH * rng.random((len(centres), 1)) * rng.normal(size=centres.shape)
        candidates = np.unique(self._space.snap(np.clip(np.concatenate([everywhere, near]), 0.0, 1.0)), axis=0)
        candidates = candidates[self._space.is_admissible(candidates)]
        trees = ExtraTreesClassifier(TREES, random_state=0).fit(points, critical)
        p = trees.predict_proba(candidates)[:, trees.classes_].sum(axis=1)
        # Where all trees agree, the most distant one first.
        gain = p * (1.0 - p) + 1e-9
        distance = np.asarray(cKDTree(np.concatenate([self._points, first])).query(candidates)[0])
        chosen: list[int] = []
        for _ in range(n):
            chosen.append(int(np.argmax(gain * distance)))
            distance = np.minimum(distance, np.linalg.norm(candidates - candidates[chosen[-1]], axis=1))
        picked: Floats = candidates[chosen]
        return picked


class Straddle(Filled):
    """BoTorch's SingleTaskGP as it comes, asked where 1.96 s - |m - threshold| is largest, among all of the grid.

    The points of a round are chosen one after the other, each as if the ones before had scored what is predicted.
    """

    name = "botorch"

    def choose(self, n: int, first: Floats, points: Floats, scores: Floats) -> Floats:
        """Choose n points by a Gaussian process."""
        import torch  # type: ignore[import-not-found]
        from botorch.fit import fit_gpytorch_mll  # type: ignore[import-not-found]
        from botorch.models import SingleTaskGP  # type: ignore[import-not-found]
        from gpytorch.mlls import ExactMarginalLogLikelihood  # type: ignore[import-not-found]

        lattice = self._space.full_factorial()
        new = cKDTree(np.concatenate([self._points, first])).query(lattice)[0] > 1e-9
        candidates = lattice[new & self._space.is_admissible(lattice)]
        torch.set_num_threads(1)
        model = SingleTaskGP(torch.from_numpy(points), torch.from_numpy(scores[:, None]))
        fit_gpytorch_mll(ExactMarginalLogLikelihood(model.likelihood, model))
        chosen: list[int] = []
        with torch.no_grad():
            # A model takes no further points before it has predicted some.
            predicted = model.posterior(torch.from_numpy(np.concatenate([first, candidates[:1]])))
            if len(first):
                model = model.condition_on_observations(torch.from_numpy(first), predicted.mean[:-1])
            while len(chosen) < min(n, len(candidates)):
                # In parts, as it computes the covariance of all that is asked at once.
                parts = [model.posterior(one) for one in torch.from_numpy(candidates).split(256)]
                mean = torch.cat([one.mean for one in parts])
                deviation = torch.cat([one.variance for one in parts]).sqrt()
                gain = (1.96 * deviation - (mean - self._threshold).abs()).squeeze(-1)
                gain[chosen] = -np.inf
                best = int(gain.argmax())
                chosen.append(best)
                model = model.condition_on_observations(torch.from_numpy(candidates[[best]]), mean[[best]])
        picked: Floats = candidates[chosen]
        return picked


class DiverseNsga2(Optimizer):
    """NSGA-II-D of OpenSBT, on the NSGA-II of pymoo; the package of OpenSBT, 0.1.4, does not hold it.

    Its second objective is the distance to the nearest point of an archive, the larger the better, when a scenario has
    run; 0 if the archive is empty. Then the archive takes, one after the other, the scenarios that are further than a
    limit from all in it, whether they are critical or not. In each generation up to 30 % of the population, the worst
    by rank, give way to random scenarios. Settings are the defaults of OpenSBT, but for the limit: it is 5 in the units
    of its examples, and 0.1 of the ranges here. A scenario that it proposes again is not run again.

    Source: L. Sorokin, D. Safin, S. Nejati, "Can search-based testing with Pareto optimization effectively cover
    failure-revealing test inputs?", Empirical Software Engineering 30, 26 (2025).
    """

    name = "nsga2-d"

    def prepare(self, space: Any, seed: int, *further: Any, **required: Any) -> None:
        """Prepare the search of a space."""
        self._space, self._rng = space, np.random.default_rng(seed)
        crossover, mutation = SBX(prob=0.7, eta=20), PM(prob=1.0 / space.dimension, eta=15)
        self._algorithm = NSGA2(POPULATION, sampling=LHS(), crossover=crossover, mutation=mutation, seed=seed)
        problem = Problem(n_var=space.dimension, n_obj=2, xl=0.0, xu=1.0)
        self._algorithm.setup(problem, termination=NoTermination())
        self._archive = np.zeros((0, space.dimension))
        self._scores: dict[tuple[float, ...], float] = {}
        self._waiting: list[tuple[float, ...]] = []

    def tell(self, points: Floats, scores: Floats) -> None:
        """Observe the scores of one round."""
        self._scores |= zip(map(tuple, points.tolist()), np.nan_to_num(scores, nan=FAILED).tolist(), strict=True)
        if not self._waiting:
            self._survive()

    def ask(self, n: int) -> Floats:
        """Propose n points, or what is left of a generation."""
        while not self._waiting:
            self._breed()
            if not self._waiting:
                self._survive()
        asked, self._waiting = self._waiting[:n], self._waiting[n:]
        return np.array(asked)

    def _breed(self) -> None:
        """Make children, and random scenarios but in the first generation."""
        is_first = not self._algorithm.is_initialized
        self._children = self._algorithm.ask()
        count = 0 if is_first else self._rng.integers(1, REPLACED + 1)
        self._random = Population.new(X=self._rng.random((count, self._space.dimension)))
        points = self._space.snap(Population.merge(self._children, self._random).get("X"))
        self._run = list(map(tuple, points.tolist()))
        for one, is_admissible in zip(self._run, self._space.is_admissible(points), strict=True):
            if not is_admissible:
                self._scores[one] = FAILED
        self._waiting = [one for one in dict.fromkeys(self._run) if one not in self._scores]

    def _survive(self) -> None:
        """End a generation, all scenarios of which have a score."""
        born = Population.merge(self._children, self._random)
        distance = [self._distance(point) for point in born.get("X")]
        objectives = np.column_stack([[self._scores[one] for one in self._run], np.negative(distance)])
        Evaluator().eval(StaticProblem(self._algorithm.problem, F=objectives), born)
        if len(self._random):
            # It is in the order of the ranks.
            self._algorithm.pop = Population.merge(self._algorithm.pop[: -len(self._random)], self._random)
        for point in Population.merge(self._algorithm.pop, self._children).get("X"):
            if not len(self._archive) or self._distance(point) > NOVEL:
                self._archive = np.concatenate([self._archive, [point]])
        self._algorithm.tell(infills=self._children)

    def _distance(self, point: Floats) -> float:
        return float(np.linalg.norm(self._archive - point, axis=1).min()) if len(self._archive) else 0.0


class VerifaiSearch(Optimizer):
    """A sampler of VerifAI in the unit cube; a scenario that it proposes again is run again."""

    requires = frozenset({"threshold"})

    def __init__(self, name: str) -> None:
        self.name = name

    def prepare(self, space: Any, seed: int, *further: Any, **required: Any) -> None:
        """Prepare the search of a space."""
        from verifai.features import Box, Feature, FeatureSpace  # type: ignore[import-not-found]
        from verifai.samplers import FeatureSampler  # type: ignore[import-not-found]

        # Its samplers draw from the generators of NumPy and Python.
        np.random.seed(seed)  # noqa: NPY002
        random.seed(seed)
        self._space, self._threshold = space, required["threshold"]
        cube = FeatureSpace({"point": Feature(Box(*[(0.0, 1.0)] * space.dimension))})
        self._sampler = getattr(FeatureSampler, VERIFAI[self.name])(cube)
        self._asked: list[Any] = []

    def tell(self, points: Floats, scores: Floats) -> None:
        """Observe the scores of one round."""
        for (sample, info), score in zip(self._asked, scores, strict=True):
            # Beyond the threshold is below 0, as VerifAI wants it.
            self._sampler.update(sample, info, float(np.nan_to_num(score - self._threshold, nan=FAILED)))

    def ask(self, n: int) -> Floats:
        """Propose n points."""
        points: list[Floats] = []
        self._asked = []
        while len(points) < n:
            sample, info = self._sampler.getSample()
            point = self._space.snap(np.array([sample.point]))
            if self._space.is_admissible(point)[0]:
                points.append(point)
                self._asked.append((sample, info))
        return np.concatenate(points)


PEERS: dict[str, Callable[[], Optimizer]] = {
    "forest-al": ActiveForest,
    "nsga2-d": DiverseNsga2,
    "botorch": Straddle,
    **{name: partial(VerifaiSearch, name) for name in VERIFAI},
}


def searched(judge: Judge, kind: str, seed: int, budget: int) -> Any:
    critical = judge.case.critical
    if kind in PEERS:
        return PEERS[kind]().start(judge.space, seed, threshold=critical)
    return SEARCHES[kind](judge.space, seed, critical, budget)


def f1(judge: Judge, told: npt.NDArray[np.bool_], places: npt.NDArray[np.int64]) -> float:
    told[places] = judge.true[places]
    both = judge.agreement(told)
    return float(2.0 * both["recall"] * both["precision"] / max(both["recall"] + both["precision"], 1e-9))


def judged(judge: Judge, kind: str, seed: int, points: Floats) -> dict[str, float]:
    """F1 by each judge, and the share of the regions that were met."""
    places = judge.places(points)
    met = len(set(judge.regions[places]) & judge.large) / max(len(judge.large), 1)
    hits = float(judge.true[np.unique(places)].sum())
    row: dict[str, float] = {"hits": hits, "regions": met} | dict.fromkeys(JUDGES, 0.0)
    at = places[np.isfinite(judge.scores[places])]
    if not 0 < judge.true[at].sum() < len(at):
        return row
    runs = judge.lattice[at], judge.scores[at], judge.features[at]
    committee = CommitteeModel(Criterion(judge.case.critical), registered_features(), seed).fit(*runs)
    row["found"] = f1(judge, committee.predict(judge.lattice)[0] >= PREDICTED_CRITICAL, places)
    row["process"] = f1(judge, committee.process.predict(judge.lattice)[0] < 0.0, places)
    _, probability = best_classifier(("process", "forest"), *runs, judge.case.critical, seed)
    if probability is not None:
        row["parameters"] = f1(judge, probability(judge.lattice) >= 0.5, places)
    return row


def search(judge: Judge, kind: str, seed: int, sizes: list[int]) -> Iterable[dict[str, float]]:
    optimizer = searched(judge, kind, seed, sizes[-1])
    points, spent = np.zeros((0, len(judge.steps))), 0.0
    for size in sizes:
        while len(points) < size:
            begin = time.process_time()
            new = optimizer.ask(min(ROUND, size - len(points)))
            at = judge.places(new)
            more = (judge.features[at],) if "features" in optimizer.requires else ()
            optimizer.tell(new, judge.scores[at], *more)
            spent += time.process_time() - begin
            if not len(new):
                break
            points = np.concatenate([points, new])
        yield {"size": size, "ms": 1e3 * spent / max(len(points), 1), **judged(judge, kind, seed, points)}


def table(rows: list[dict[str, Any]], kinds: list[str], sizes: list[int]) -> None:
    """Print means over seeds, per scenario and over all."""
    cases = list(dict.fromkeys(row["case"] for row in rows))
    for size in sizes:
        for what in (*JUDGES, "regions", "hits", "ms"):
            print(f"\n{what}, {size} runs\n| search | " + " | ".join((*cases, "mean", "least")) + " |")
            for kind in kinds:
                mine = [
                    [r[what] for r in rows if (r["case"], r["search"], r["size"]) == (case, kind, size)]
                    for case in cases
                ]
                means = [float(np.mean(one)) if one else float("nan") for one in mine]
                least = min((value for one in mine for value in one), default=float("nan"))
                digits = 1 if what in ("hits", "ms") else 3
                print(f"| {kind} | " + " | ".join(f"{v:.{digits}f}" for v in (*means, np.nanmean(means), least)) + " |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--half", choices=("choose", "judge"), default="judge")
    parser.add_argument("--only", action="append", choices=CASES, help="only this scenario; may be repeated")
    parser.add_argument("--search", action="append", choices=(*SEARCHES, *PEERS), help="may be repeated")
    parser.add_argument("--sizes", type=int, nargs="+", default=[100, 200])
    parser.add_argument("--steps", type=int, default=16)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--ncap", type=Path, metavar="FOLDER")
    parser.add_argument("--alks", type=Path, metavar="FOLDER")
    parser.add_argument("--truth", type=Path, default=Path("truth"), metavar="FOLDER")
    parser.add_argument("--json", type=Path, default=Path("peers.jsonl"), metavar="FILE")
    options = parser.parse_args()
    folders = {"examples": EXAMPLES, "ncap": options.ncap, "alks": options.alks}
    kinds = options.search or list(KINDS)
    names = options.only or [
        name for name in (CHOOSE if options.half == "choose" else JUDGE) if folders[CASES[name].of]
    ]
    lines = options.json.read_text(encoding="utf-8").splitlines() if options.json.exists() else []
    rows: list[dict[str, Any]] = [json.loads(line) for line in lines]
    known = {(row["case"], row["search"], row["seed"]) for row in rows}
    with threadpool_limits(1):
        for name in names:
            judge = Judge(name, folders, options.steps, options.truth, ())
            print(f"{name}: {judge.true[judge.admitted].mean():.1%} critical, {len(judge.large)} regions", flush=True)
            for seed in range(options.seeds):
                for kind in [one for one in kinds if (name, one, seed) not in known]:
                    new = [{"case": name, "search": kind, "seed": seed, **row}
                           for row in search(judge, kind, seed, options.sizes)]  # fmt: skip
                    rows += new
                    with options.json.open("a", encoding="utf-8") as file:
                        file.writelines(json.dumps(row) + "\n" for row in new)
    table([row for row in rows if row["case"] in names], kinds, options.sizes)


if __name__ == "__main__":
    main()
