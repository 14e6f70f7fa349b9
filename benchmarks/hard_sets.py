"""Searches judged by critical sets that are hard to find, of functions that are known everywhere.

python benchmarks/hard_sets.py [--half choose|judge] [--seeds N] [--only NAME]… [--search NAME]… [--sizes N]…
                               [--process] [--json FILE]

Each kind of set is there twice. Of the half `choose` are the functions that settings of searches may be chosen with;
figures that are told are of the half `judge`, whose shapes, places, profiles and seeds are others. Each seed draws a
function of its own.

What a search found is what one and the same classifier takes for critical: of a Gaussian process and extremely
randomised trees the one that tells the scenarios apart better that were left out (with `--process` always the process).
Recall and precision are those on 2^17 points of a Sobol' sequence, of which all critical ones and 2^14 others are
asked. A region is met by a critical scenario in it.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.stats import ortho_group, qmc
from sklearn.ensemble import ExtraTreesClassifier
from sklearn.metrics import f1_score
from sklearn.model_selection import StratifiedKFold, cross_val_predict
from threadpoolctl import threadpool_limits

from cornercase.evidence.gp._gaussian_process import encode_points, fit_boundary_process
from cornercase.optimizers import OPTIMIZERS
from cornercase.scenario import Parameter, ParameterSpace
from cornercase.study._criterion import Criterion

Floats = npt.NDArray[np.float64]
Function = Callable[[Floats], Floats]

SEARCHES = ("sobol", "bayes", "level-set")
SIZES = (200, 400)
HALVES = ("choose", "judge")
_EVERYWHERE, _ASKED, _MOST_INSIDE = 17, 14, 3000


@dataclass(frozen=True)
class HardSet:
    """A function of the unit cube that is critical up to 0; each of its regions is critical by itself up to 0."""

    space: ParameterSpace
    regions: tuple[Function, ...]
    # What is told of the least of the regions.
    profile: Function
    noise: float = 0.0
    fails: Callable[[Floats], npt.NDArray[np.bool_]] | None = None

    def margin(self, points: Floats) -> Floats:
        """Least distance from a region, below 0 in one; infinite where scenarios fail."""
        least = np.min([one(points) for one in self.regions], axis=0)
        return least if self.fails is None else np.where(self.fails(points), np.inf, least)

    def scores(self, points: Floats, rng: np.random.Generator) -> Floats:
        """What a search is told, NaN where scenarios fail."""
        margin = self.margin(points)
        told = self.profile(margin) + self.noise * rng.normal(size=len(points))
        return np.where(np.isinf(margin), np.nan, told)


def cube(dims: int) -> ParameterSpace:
    return ParameterSpace([Parameter(f"p{k}", 0.0, 1.0) for k in range(dims)])


def of_share(distance: Function, space: ParameterSpace, share: float) -> Function:
    """The same less what makes it at most 0 in this share of the space."""
    at = space.snap(qmc.Sobol(space.dimension, seed=7).random(2**16))
    level = float(np.quantile(distance(at), share))
    return lambda points: np.asarray(distance(points) - level)


def ball(centre: Floats) -> Function:
    return lambda points: np.linalg.norm(points - centre, axis=1)


def ellipsoid(centre: Floats, rng: np.random.Generator, ratio: float = 1.6) -> Function:
    turned = ortho_group.rvs(len(centre), random_state=rng) if len(centre) > 1 else np.eye(1)
    axes = turned / np.exp(rng.uniform(-np.log(ratio), np.log(ratio), len(centre)))[:, None]
    return lambda points: np.linalg.norm((points - centre) @ axes.T, axis=1)


def shape(half: str, centre: Floats, rng: np.random.Generator) -> Function:
    return ball(centre) if half == "choose" else ellipsoid(centre, rng)


def saturating(half: str, width: float, top: float = 3.0) -> Function:
    """A score that rises from the boundary and is flat some widths away from it."""
    if half == "choose":
        return lambda margin: top * np.tanh(np.where(np.isinf(margin), 0.0, margin) / width)
    return lambda margin: top * np.where(np.isinf(margin), 0.0, margin) / (width + np.abs(margin))


def apart(rng: np.random.Generator, dims: int, least: float) -> tuple[Floats, Floats]:
    """Two places that are so far from each other, and from the border."""
    while True:
        a, b = rng.uniform(0.15, 0.85, (2, dims))
        if np.linalg.norm(a - b) >= least:
            return a, b


def islands(half: str, rng: np.random.Generator) -> HardSet:
    """Two of 0.5 % each, far apart; how far away they are felt differs."""
    space = cube(3)
    regions = [of_share(shape(half, centre, rng), space, 0.005) for centre in apart(rng, 3, 0.6)]
    return HardSet(space, tuple(regions), saturating(half, float(np.exp(rng.uniform(*np.log((0.06, 0.25)))))))


def hidden(half: str, rng: np.random.Generator) -> HardSet:
    """One of 1 % that is not felt from afar, beside one of 8 %."""
    space = cube(3)
    a, b = apart(rng, 3, 0.55)
    large = of_share(shape(half, a, rng), space, 0.08)
    small = of_share(shape(half, b, rng), space, 0.01)
    steep = 5.0 if half == "choose" else 4.0

    def felt(points: Floats) -> Floats:
        distance = small(points)
        return np.where(distance > 0.0, steep, 1.0) * distance

    return HardSet(space, (large, felt), saturating(half, 0.4))


def shell(half: str, rng: np.random.Generator) -> HardSet:
    """The wall of a ball, 3 % of the space."""
    space = cube(3)
    whole = shape(half, rng.uniform(0.4, 0.6, 3), rng)
    radius = rng.uniform(0.25, 0.4)
    return HardSet(space, (of_share(lambda points: np.abs(whole(points) - radius), space, 0.03),),
                   saturating(half, 0.3))  # fmt: skip


def needle(half: str, rng: np.random.Generator) -> HardSet:
    """One of 1 % where 95 % of the space has one and the same score."""
    space = cube(3)
    region = of_share(shape(half, rng.uniform(0.2, 0.8, 3), rng), space, 0.01)
    at = qmc.Sobol(3, seed=8).random(2**14)
    cap = float(np.quantile(region(at), 0.05))
    flat = saturating(half, 0.2)
    return HardSet(space, (region,), lambda margin: flat(np.minimum(margin, cap)) / flat(np.array([cap])) * 3.0)


def noisy(half: str, rng: np.random.Generator) -> HardSet:
    """Two of 5 % each, with noise."""
    space = cube(3)
    regions = [of_share(shape(half, centre, rng), space, 0.05) for centre in apart(rng, 3, 0.5)]
    return HardSet(space, tuple(regions), saturating(half, 0.4), noise=0.5 if half == "choose" else 0.4)


def idle(half: str, rng: np.random.Generator) -> HardSet:
    """Ten parameters, of which three matter; 10 % of the space."""
    space, active = cube(10), rng.choice(10, 3, replace=False)
    inner = shape(half, rng.uniform(0.3, 0.7, 3), rng)
    return HardSet(space, (of_share(lambda points: inner(points[:, active]), space, 0.1),), saturating(half, 0.5))


def full(half: str, rng: np.random.Generator) -> HardSet:
    """Ten parameters that all matter; 10 % of the space."""
    space = cube(10)
    weights, centre = np.exp(rng.normal(0.0, 0.4, 10)), rng.uniform(0.2, 0.8, 10)
    signs = rng.choice((-1.0, 1.0), 10)

    def ellipse(points: Floats) -> Floats:
        return np.asarray(np.linalg.norm((points - centre) * weights, axis=1))

    def wave(points: Floats) -> Floats:
        slope = (points - centre) @ (weights * signs) / 3.0
        return np.asarray(slope + 0.5 * np.sin(3.0 * points[:, 0]) * points[:, 1])

    region = of_share(ellipse if half == "choose" else wave, space, 0.1)
    return HardSet(space, (region,), saturating(half, 0.6))


def kinds(half: str, rng: np.random.Generator) -> HardSet:
    """Three numbers and four choices, of which two have regions of their own; 1.5 % of the space each."""
    names = ("a", "b", "c", "d")
    space = ParameterSpace([*cube(3).parameters, Parameter("kind", 0, 3, None, names)])
    which, centres = rng.choice(4, 2, replace=False), rng.uniform(0.25, 0.75, (2, 3))

    def region(k: int) -> Function:
        inner = shape(half, centres[k], rng)

        def distance(points: Floats) -> Floats:
            mine = space.parameters[3].level_indices(points[:, 3]) == which[k]
            return np.where(mine, inner(points[:, :3]), inner(points[:, :3]) + 1.0)

        return of_share(distance, space, 0.015)

    return HardSet(space, (region(0), region(1)), saturating(half, 0.3))


def rare(half: str, rng: np.random.Generator) -> HardSet:
    """One of 0.5 %, four parameters."""
    space = cube(4)
    region = of_share(shape(half, rng.uniform(0.2, 0.8, 4), rng), space, 0.005)
    return HardSet(space, (region,), saturating(half, 0.3))


def failing(half: str, rng: np.random.Generator) -> HardSet:
    """One of 5 %, and scenarios that fail in a fifth of the space beside it."""
    space = cube(3)
    centre = rng.uniform(0.3, 0.7, 3)
    region = of_share(shape(half, centre, rng), space, 0.05)
    if half == "choose":
        j = rng.integers(3)
        side = of_share(lambda points: points[:, j], space, 0.2)
    else:
        corner = rng.integers(0, 2, 3)
        side = of_share(lambda points: np.linalg.norm(points - corner, axis=1), space, 0.2)
    return HardSet(space, (region,), saturating(half, 0.4), fails=lambda points: side(points) <= 0.0)


SETS: dict[str, Callable[[str, np.random.Generator], HardSet]] = {
    "islands": islands, "hidden": hidden, "shell": shell, "needle": needle, "noise": noisy, "idle": idle,
    "full": full, "kinds": kinds, "rare": rare, "failing": failing,
}  # fmt: skip


class Judge:
    """The truth about one set."""

    def __init__(self, known: HardSet) -> None:
        self.known = known
        at = known.space.snap(qmc.Sobol(known.space.dimension, seed=11).random_base2(_EVERYWHERE))
        inside = known.margin(at) <= 0.0
        self.share = float(inside.mean())
        self.inside = at[inside][:_MOST_INSIDE]
        # What fails is neither critical nor not.
        part, outside = at[: 2**_ASKED], np.isfinite(known.margin(at[: 2**_ASKED])) & ~inside[: 2**_ASKED]
        self.outside, self.outer = part[outside], float(outside.mean())

    def agreement(self, told: Callable[[Floats], npt.NDArray[np.bool_]]) -> dict[str, float]:
        """Recall and precision of what is told to be critical."""
        recall = float(told(self.inside).mean())
        wrong = self.outer * float(told(self.outside).mean())
        right = self.share * recall
        return {"recall": recall, "precision": right / max(right + wrong, 1e-12) if right else 0.0}

    def row(self, points: Floats, scores: Floats, process_only: bool) -> dict[str, float]:
        """All figures about scenarios that were run."""
        failed = np.isnan(scores)
        met = [bool((one(points[~failed]) <= 0.0).any()) for one in self.known.regions]
        row = {"met": float(np.mean(met)), "failed": float(failed.mean()), "hits": float((scores <= 0.0).sum())}
        critical = scores[~failed] <= 0.0
        if critical.sum() < 2 or critical.all():
            return row | {"recall": 0.0, "precision": 0.0}
        told = classifier(self.known.space, points[~failed], scores[~failed], process_only)
        return row | self.agreement(told)


def classifier(
    space: ParameterSpace, points: Floats, scores: Floats, process_only: bool
) -> Callable[[Floats], npt.NDArray[np.bool_]]:
    """Which scenarios are critical, by the better of a process and of trees for scenarios that were left out."""
    at, critical = encode_points(space, points), scores <= 0.0
    process = fit_boundary_process(at, scores, Criterion(0.0))

    def by_process(places: Floats) -> npt.NDArray[np.bool_]:
        return np.asarray(process.predict(encode_points(space, places))[0] <= 0.0)

    if process_only or critical.sum() < 5:
        return by_process
    trees = ExtraTreesClassifier(200, min_samples_leaf=1, random_state=0)
    folds = StratifiedKFold(5, shuffle=True, random_state=0)
    of_trees = cross_val_predict(trees, at, critical, cv=folds)
    if f1_score(critical, process.leave_one_out()[0] <= 0.0) >= f1_score(critical, of_trees):
        return by_process
    trees.fit(at, critical)
    return lambda places: np.asarray(trees.predict(encode_points(space, places)), dtype=np.bool_)


def search(half: str, name: str, kind: str, seed: int, sizes: tuple[int, ...], process_only: bool) -> dict[str, Any]:
    """Run one search and judge it at each size."""
    number = [HALVES.index(half), list(SETS).index(name), seed]
    known = SETS[name](half, np.random.default_rng(number))
    judge, rng = Judge(known), np.random.default_rng([*number, 1])
    optimizer = OPTIMIZERS.create(kind).start(known.space, seed, threshold=0.0, budget=sizes[-1])
    points, scores, spent, rows = np.zeros((0, known.space.dimension)), np.zeros(0), 0.0, []
    for size in sizes:
        while len(points) < size:
            begin = time.process_time()
            new = optimizer.ask(min(10, size - len(points)))
            told = known.scores(new, rng)
            optimizer.tell(new, told)
            spent += time.process_time() - begin
            points, scores = np.concatenate([points, new]), np.concatenate([scores, told])
        rows.append({"size": size, "seconds": spent / len(points), **judge.row(points, scores, process_only)})
    return {"set": name, "search": kind, "seed": seed, "rows": rows}


def table(runs: list[dict[str, Any]], sizes: tuple[int, ...]) -> None:
    """Print medians and the least."""
    for k, size in enumerate(sizes):
        for kind in dict.fromkeys(run["search"] for run in runs):
            mine = [run["rows"][k] for run in runs if run["search"] == kind]
            column = {key: np.array([row[key] for row in mine]) for key in mine[0]}
            middle = {key: float(np.median(values)) for key, values in column.items()}
            met = f"all met {int((column['met'] == 1.0).sum()):2} of {len(mine):2}"
            print(f"{runs[0]['set']:9} {kind:12} {size:4}  {met}"
                  f"  recall {middle['recall']:.3f} (least {column['recall'].min():.3f})"
                  f"  precision {middle['precision']:.3f} (least {column['precision'].min():.3f})"
                  f"  hits {middle['hits']:3.0f}  failed {column['failed'].max():.2f}"
                  f"  s {middle['seconds']:.4f}", flush=True)  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--half", choices=HALVES, default="judge")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--only", action="append", choices=SETS, help="only this one; may be repeated")
    parser.add_argument("--search", action="append", help="as of --optimizer; may be repeated")
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES)
    parser.add_argument("--process", action="store_true", help="judge by the process alone")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    runs = []
    with threadpool_limits(1):
        for name in options.only or SETS:
            mine = [
                search(options.half, name, kind, seed, tuple(options.sizes), options.process)
                for kind in options.search or SEARCHES
                for seed in range(options.seeds)
            ]
            table(mine, tuple(options.sizes))
            runs += mine
    if options.json:
        options.json.write_text(json.dumps(runs, indent=1))


if __name__ == "__main__":
    main()
