"""How often what is said of a critical set is so: functions whose critical sets are known, one judgement after another.

python benchmarks/calibration.py [--half test] [--cases 45] [--first 0] [--search NAME]… [--sizes N …] [--audit 0]
python benchmarks/calibration.py --hidden 20

A case is a function of a family, a number of dimensions, a critical share between 0.5 and 40 %, and a space that is
continuous or has steps and choices. Each search runs on each case. The families of the two halves differ: constants may
be chosen with one of them, and what the docs say is of the other. Each search is judged once, after one of the
sizes. What it says of a region that was overlooked is compared with whether one was.

With --hidden: of how many seeds `level-set` stops by `missed<0.05` while more is missed, of a ball of 8 % of a cube
beside one of 1 % that nothing points to. It is looked at after each round, as an exploration does.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from scipy.stats import qmc

from cornercase.evidence._critical_set_estimate import MIN_REGION_FRACTION, CriticalSet
from cornercase.evidence.gp._gaussian_process import encode_points
from cornercase.exploration._stop_criteria import StopCriteria
from cornercase.exploration._study_critical_set import audit_sampler, is_score_independent
from cornercase.optimizers import OPTIMIZERS
from cornercase.scenario import Parameter, ParameterSpace
from cornercase.stop._stop_rules import StopCriterion
from cornercase.study._criterion import Criterion

Floats = npt.NDArray[np.float64]
Function = Callable[[Floats], Floats]

SEARCHES: Final = ("sobol", "random", "bayes", "bayes:filling=0", "level-set", "evolutionary")
SIZES: Final = (80, 160)
SHARES: Final = (0.005, 0.01, 0.03, 0.1, 0.2, 0.4)
BELIEFS: Final = (0.0, 0.05, 0.2, 0.5, 0.8, 1.01)
ROUND: Final = 10


def waves(rng: np.random.Generator, dims: int) -> Function:
    """Draw of a smooth process, of which some dimensions matter more than others."""
    widths = np.exp(rng.normal(np.log(0.35 * np.sqrt(dims)), 0.5, dims))
    frequencies = rng.standard_t(5.0, (400, dims)) / widths
    phases, weights = rng.uniform(0.0, 2 * np.pi, 400), rng.normal(size=400) / 20.0
    return lambda points: np.cos(points @ frequencies.T + phases) @ weights


def bumps(rng: np.random.Generator, dims: int) -> Function:
    """Sum of bumps, high and low."""
    centres, sizes = rng.random((4 + 2 * dims, dims)), rng.normal(size=4 + 2 * dims)
    width = 0.25 * np.sqrt(dims)

    def of(points: Floats) -> Floats:
        apart = ((points[:, None] - centres) ** 2).sum(axis=2) / width**2
        return np.asarray(-np.exp(-apart) @ sizes)

    return of


def shell(rng: np.random.Generator, dims: int) -> Function:
    """Low on a thin shell around a place."""
    centre, radius = rng.uniform(0.2, 0.8, dims), rng.uniform(0.25, 0.5) * np.sqrt(dims)
    stretch = rng.uniform(0.5, 1.5, dims)
    return lambda points: np.abs(np.linalg.norm((points - centre) * stretch, axis=1) - radius)


def islands(rng: np.random.Generator, dims: int) -> Function:
    """Two to four balls in a plateau that says nothing of them."""
    count = int(rng.integers(2, 5))
    centres, sizes = rng.random((count, dims)), rng.uniform(0.5, 1.5, count)

    def of(points: Floats) -> Floats:
        apart = np.linalg.norm(points[:, None] - centres, axis=2) / sizes
        return np.asarray(np.minimum(apart.min(axis=1), 0.35 * np.sqrt(dims)))

    return of


def steps(rng: np.random.Generator, dims: int) -> Function:
    """Smooth, but with a jump along two slanted planes."""
    smooth, planes = waves(rng, dims), rng.normal(size=(2, dims))
    at, high = (planes * rng.uniform(0.3, 0.7, (2, dims))).sum(axis=1), rng.normal(0.0, 1.5, 2)
    return lambda points: np.asarray(smooth(points) + (points @ planes.T > at) @ high)


def capped(rng: np.random.Generator, dims: int) -> Function:
    """A valley in few dimensions, at its cap nearly everywhere, with noise as of time steps."""
    some = rng.permutation(dims)[: max(1, dims // 2)]
    slope, centre = rng.normal(size=len(some)), rng.uniform(0.2, 0.8, len(some))
    curved = rng.uniform(0.5, 2.0, len(some))

    def of(points: Floats) -> Floats:
        at = points[:, some] - centre
        valley = np.abs(at @ slope) + (curved * at**2).sum(axis=1)
        grain = 0.02 * np.sin(1e4 * (points @ np.arange(1.0, dims + 1.0)))
        return np.asarray(np.minimum(valley + grain, 0.6 * np.sqrt(len(some))))

    return of


FAMILIES: Final[dict[str, dict[str, Callable[[np.random.Generator, int], Function]]]] = {
    "train": {"waves": waves, "bumps": bumps, "shell": shell},
    "test": {"islands": islands, "steps": steps, "capped": capped},
}


@dataclass(frozen=True)
class Case:
    """A function, and what of it is critical."""

    family: str
    dims: int
    aimed: float
    finite: bool
    seed: int
    space: ParameterSpace
    function: Function
    threshold: float
    everywhere: Floats

    @cached_property
    def critical(self) -> npt.NDArray[np.bool_]:
        """Which of the places are critical."""
        return self.function(self.everywhere) <= self.threshold

    @cached_property
    def regions(self) -> tuple[Any, npt.NDArray[np.int64], npt.NDArray[np.int64]]:
        """Places of the critical set, the connected part that each belongs to, and which parts are large.

        Neighbours are connected if both are critical, as `CriticalSet.overlooked` has it.
        """
        points, weights = np.unique(self.everywhere, axis=0, return_counts=True)
        places, critical = encode_points(self.space, points), self.function(points) <= self.threshold
        a, b = np.arange(len(places) - 1), np.arange(1, len(places))
        if self.dims > 1:
            near = np.asarray(cKDTree(places).query(places, k=2 * places.shape[1] + 1)[1])[:, 1:]
            a, b = np.repeat(np.arange(len(places)), near.shape[1]), near.ravel()
        a, b = a[critical[a] & critical[b]], b[critical[a] & critical[b]]
        graph = coo_array((np.ones(len(a)), (a, b)), shape=(len(places), len(places)))
        part = connected_components(graph, directed=False)[1][critical]
        sizes = np.bincount(part, weights=weights[critical]) / len(self.everywhere)
        return cKDTree(places[critical]), np.asarray(part, dtype=np.int64), np.flatnonzero(sizes >= MIN_REGION_FRACTION)

    def overlooked(self, hits: Floats) -> bool:
        """Whether a region of 1 % of the space or more holds none of the critical scenarios that were run."""
        tree, part, large = self.regions
        if not len(hits):
            return bool(len(large))
        return bool(np.setdiff1d(large, part[tree.query(encode_points(self.space, hits))[1]]).size)


def space_of(dims: int, finite: bool) -> ParameterSpace:
    """A cube; with steps, and with one choice among three where there are dimensions to spare."""
    if not finite:
        return ParameterSpace.from_ranges([f"p{k}=0:1" for k in range(dims)])
    count = {1: 2000, 2: 50, 3: 20}.get(dims, 6)
    ranges = [Parameter(f"p{k}", 0.0, count - 1.0, 1.0) for k in range(dims)]
    if dims > 2:
        ranges[0] = Parameter("p0", 0, 2, None, ("x", "y", "z"))
    return ParameterSpace(ranges)


def cases(half: str, count: int, dims: Sequence[int], first: int = 0) -> Iterator[Case]:
    """Cases of one half, whose shares, dimensions and families take turns."""
    families = list(FAMILIES[half].items())
    for number in range(first, first + count):
        rng = np.random.default_rng([number, 0 if half == "train" else 1])
        name, family = families[number % len(families)]
        d, finite = int(dims[(number // len(families)) % len(dims)]), bool(rng.random() < 0.3)
        share = float(rng.choice(SHARES))
        space = space_of(d, finite)
        everywhere = space.snap(qmc.Sobol(d, seed=rng).random(2**15))
        for _ in range(20):
            function = family(rng, d)
            values = function(everywhere)
            threshold = float(np.quantile(values, share))
            true = (values <= threshold).mean()
            # A plateau or a jump may lie at this share.
            if 0.5 * share <= true <= 2.0 * share:
                yield Case(name, d, share, finite, number, space, function, threshold, everywhere)
                break


def explored(case: Case, search: str, budget: int) -> tuple[Floats, Floats]:
    """Points and scores of a search."""
    optimizer = OPTIMIZERS.create(search).start(case.space, case.seed, threshold=case.threshold, budget=budget)
    points, scores = np.zeros((0, case.dims)), np.zeros(0)
    while len(points) < budget and len(new := optimizer.ask(min(ROUND, budget - len(points)))):
        values = case.function(new)
        optimizer.tell(new, values)
        points, scores = np.concatenate([points, new]), np.concatenate([scores, values])
    return points, scores


def judged(case: Case, search: str, points: Floats, scores: Floats, audit: float) -> dict[str, Any] | None:
    """What is said after a search, and what is so; None where all scores are the same."""
    audits = audit_sampler(case.space, case.seed).ask(round(audit * len(points) / (1.0 - audit)))
    try:
        known = CriticalSet(
            case.space,
            points,
            scores,
            Criterion(case.threshold),
            case.seed,
            initial_design=is_score_independent(search, case.space, case.seed, points),
            audits=(audits, case.function(audits)),
        )
    except ValueError:
        return None
    true = case.critical
    region = case.everywhere[true]
    missed = float((~known.predict(region)).mean())
    hits = int((scores <= case.threshold).sum())
    plain: dict[str, Any] = {
        "family": case.family, "dims": case.dims, "aimed": case.aimed, "finite": case.finite, "search": search,
        "run": len(points), "hits": hits, "overlooked": known.p_overlooked_region(),
        "true overlooked": case.overlooked(points[scores <= case.threshold]), "true share": float(true.mean()),
        "true missed": missed,
    }  # fmt: skip
    # The truth is known of 32,768 places.
    slack = 2.0 * np.sqrt(true.mean() / len(true))
    for name, said, doubt, so, near in (
        ("share", known.critical_fraction, known.interval_unavailable, float(true.mean()), slack),
        ("missed", known.missed_fraction, known.missed_interval_unavailable, missed, 2.0 / max(int(true.sum()), 1)),
        ("audited share", known.audited_critical_fraction, None if len(audits) else "none", float(true.mean()), slack),
        ("audited missed", known.audited_missed_fraction, None if len(audits) else "none", missed, 0.0),
    ):
        plain[name] = None if doubt else (said.low, said.high)
        plain[f"{name} holds"] = None if doubt else bool(said.low - near <= so <= said.high + near)
    return plain


def table(rows: Sequence[dict[str, Any]], by: str, first: str) -> str:
    """How often each interval is given, and holds, by one property of the cases."""
    groups: defaultdict[Any, list[dict[str, Any]]] = defaultdict(list)
    for row in rows:
        groups[row[by]].append(row)
    lines = [f"| {first} | judged | share holds | missed: given | missed holds |", "| --- | --- | --- | --- | --- |"]
    for name in sorted(groups, key=str if by in ("search", "family") else None):
        share = [row["share holds"] for row in groups[name] if row["share holds"] is not None]
        missed = [row["missed holds"] for row in groups[name] if row["missed holds"] is not None]
        parts = [f"{np.mean(each):.0%} of {len(each)}" if each else "-" for each in (share, missed)]
        given = f"{len(missed) / len(groups[name]):.0%}"
        lines.append(f"| {name} | {len(groups[name])} | {parts[0]} | {given} | {parts[1]} |")
    return "\n".join(lines)


def overlooked_table(rows: Sequence[dict[str, Any]]) -> str:
    """How often a region was overlooked, by what is said of that."""
    lines = ["| overlooked, as said | judged | said, mean | true |", "| --- | --- | --- | --- |"]
    for low, high in itertools.pairwise(BELIEFS):
        mine = [row for row in rows if low <= row["overlooked"] < high]
        if mine:
            said, true = (np.mean([row[what] for row in mine]) for what in ("overlooked", "true overlooked"))
            lines.append(f"| {low:g} to {min(high, 1.0):g} | {len(mine)} | {said:.2f} | {true:.2f} |")
    return "\n".join(lines)


def beside(points: Floats) -> Floats:
    """At most 0 in a ball of 8 % and in one of 1 % of a cube; a plateau that points to the first alone."""
    large = np.linalg.norm(points - (0.35, 0.4, 0.45), axis=1) - (0.08 * 3.0 / (4.0 * np.pi)) ** (1.0 / 3.0)
    small = np.linalg.norm(points - (0.82, 0.8, 0.78), axis=1) - (0.01 * 3.0 / (4.0 * np.pi)) ** (1.0 / 3.0)
    return np.asarray(np.where(small <= 0.0, small, large))


def hidden(seeds: int, budget: int) -> None:
    """Stop by `missed<0.05`, looked at after each round."""
    space = ParameterSpace.from_ranges(["a=0:1", "b=0:1", "c=0:1"])
    everywhere = qmc.Sobol(3, seed=0).random(2**15)
    region = everywhere[beside(everywhere) <= 0.0]
    stopped = wrong = 0
    for seed in range(seeds):
        optimizer = OPTIMIZERS.create("level-set").start(space, seed, threshold=0.0, budget=budget)
        stopping = StopCriteria([StopCriterion.parse("missed<0.05")], space, Criterion(0.0), seed, "level-set")
        points, scores = np.zeros((0, 3)), np.zeros(0)
        while len(points) < budget and stopping.describe_if_all_reached() is None:
            new = optimizer.ask(ROUND)
            values = beside(new)
            optimizer.tell(new, values)
            stopping.add_results(new, values)
            points, scores = np.concatenate([points, new]), np.concatenate([scores, values])
        missed = float((~CriticalSet(space, points, scores, Criterion(0.0), seed).predict(region)).mean())
        if len(points) < budget:
            stopped += 1
            wrong += missed > 0.05
        met = bool(np.linalg.norm(points - (0.82, 0.8, 0.78), axis=1).min() < 0.1337)
        print(f"seed {seed}: {len(points)} scenarios, {missed:.1%} missed, the small one {'met' if met else 'not met'}")
        sys.stdout.flush()
    print(f"{stopped} of {seeds} stopped before {budget}; {wrong} of them with more than 5 % missed")


def main() -> None:
    """Judge, and print tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--half", choices=sorted(FAMILIES), default="test")
    parser.add_argument("--cases", type=int, default=45)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--dims", type=int, nargs="+", default=[1, 2, 3, 6, 10])
    parser.add_argument("--search", action="append", help="as of --optimizer; may be repeated")
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES, help="numbers of scenarios, which take turns")
    parser.add_argument("--audit", type=float, default=0.0)
    parser.add_argument("--hidden", type=int, default=0)
    parser.add_argument("--budget", type=int, default=300)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    if given.hidden:
        hidden(given.hidden, given.budget)
        return
    rows = []
    for case in cases(given.half, given.cases, given.dims, given.first):
        budget = given.sizes[(case.seed // 3) % len(given.sizes)]
        for search in given.search or SEARCHES:
            row = judged(case, search, *explored(case, search, budget), given.audit)
            rows += [] if row is None else [row]
        if given.json:
            given.json.write_text(json.dumps(rows))
    for by, first in (("search", "search"), ("dims", "dimensions"), ("aimed", "critical share"), ("family", "family")):
        print(table(rows, by, first), end="\n\n")
    print(overlooked_table(rows))
    for what in ("share", "missed"):
        held = [row[f"audited {what} holds"] for row in rows if row[f"audited {what} holds"] is not None]
        if held:
            print(f"By the audits alone, the interval of the {what} holds in {np.mean(held):.0%} of {len(held)}")


if __name__ == "__main__":
    main()
