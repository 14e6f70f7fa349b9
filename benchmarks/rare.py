"""Importance sampling of rare events held against known probabilities, and against OpenTURNS.

python benchmarks/rare.py [--quick] [--half {choose,judge}] [--runs N] [--repetitions N] [--json FILE]

Each function has a critical set whose probability is known by a formula or an integral of one dimension: 1e-5, and 1e-3
for the one whose scores tell only whether it was met. Shown are the mean and the standard deviation of the estimates
over the truth, how many of the 95 % intervals hold it, and how often a run warns that its interval may be too narrow.
Plain Monte Carlo would need 2.5 million runs for a relative standard error of 20 % of 1e-5. The constants of the method
were chosen with the functions of the half "choose" alone.

With OpenTURNS installed (extra `bench`), its subset sampling runs beside it, with as many runs or a few more.
"""

from __future__ import annotations

import argparse
import importlib
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.special import ndtri
from scipy.stats import chi2, gamma, norm

from cornercase.evidence._probability import probability_from_counts, probability_from_weights
from cornercase.evidence._rare_events import ImportanceSampling
from cornercase.exploration._estimation import describe_doubts
from cornercase.scenario import ParameterSpace

Floats = npt.NDArray[np.float64]
Function = tuple[int, Callable[[Floats], Floats], float]

TRUTH: Final = 1e-5


def normal(points: Floats) -> Floats:
    return np.asarray(ndtri(np.clip(points, 1e-16, 1.0 - 1.2e-16)))


def plane(dimension: int) -> Function:
    """Beyond a plane."""
    reach = -norm.ppf(TRUTH)
    return dimension, lambda u: reach - normal(u).sum(1) / np.sqrt(dimension), TRUTH


def branches() -> Function:
    """Four branches: two curved ones that face each other, and two planes."""

    def probability(reach: float) -> float:
        side = reach + 0.5
        inner = quad(lambda b: norm.pdf(b) * 2.0 * norm.sf(reach + 0.2 * b * b), 0.0, side, epsabs=1e-14)[0]
        return float(2.0 * (inner + norm.sf(side)))

    reach = brentq(lambda r: np.log(probability(r) / TRUTH), 2.0, 6.0)

    def score(u: Floats) -> Floats:
        z = normal(u)
        a, b = (z[:, 0] + z[:, 1]) / np.sqrt(2.0), (z[:, 0] - z[:, 1]) / np.sqrt(2.0)
        return np.asarray(np.minimum(reach + 0.2 * b * b - np.abs(a), reach + 0.5 - np.abs(b)))

    return 2, score, probability(reach)


def outside(dimension: int) -> Function:
    """Outside of a ball: far away in all directions."""
    radius = np.sqrt(chi2.isf(TRUTH, dimension))
    return dimension, lambda u: radius - np.linalg.norm(normal(u), axis=1), TRUTH


def planes(dimension: int, count: int) -> Function:
    """Far regions in many directions, each less likely than the one before."""
    steps = np.linspace(0.0, 0.3, count)

    def probability(reach: float) -> float:
        tails = norm.sf(reach + steps)
        return float(-np.expm1(sum(np.log1p(-tails[axis::dimension].sum()) for axis in range(dimension))))

    reach = brentq(lambda r: np.log(probability(r) / TRUTH), 3.0, 6.0)

    def score(u: Floats) -> Floats:
        z = normal(u)
        signs = [1.0 if k < dimension else -1.0 for k in range(count)]
        return np.asarray(np.min([reach + steps[k] - signs[k] * z[:, k % dimension] for k in range(count)], axis=0))

    return dimension, score, probability(reach)


def boxes(dimension: int, cap: float = np.inf) -> Function:
    """Two small boxes within the cube; beyond a distance all scores are the same where there is a cap."""
    side = (0.5 * TRUTH) ** (1.0 / dimension)

    def score(u: Floats) -> Floats:
        nearest = np.minimum(np.abs(u - 0.3).max(1), np.abs(u - 0.8).max(1))
        return np.asarray(np.minimum(nearest - 0.5 * side, cap))

    return dimension, score, TRUTH


def corner(dimension: int) -> Function:
    """A corner of the cube, cut off by a hyperbola."""
    reach = gamma.isf(TRUTH, dimension)
    return dimension, lambda u: reach + np.log(np.clip(u, 1e-16, 1.0)).sum(1), TRUTH


def bent(dimension: int, curvature: float) -> Function:
    """Beyond a surface that bends away from the middle, or towards it where the curvature is negative."""

    def probability(reach: float) -> float:
        return float(
            quad(lambda x: norm.pdf(x) * norm.sf(reach + curvature * x * x), -12, 12, epsabs=1e-15, limit=500)[0]
        )

    reach = brentq(lambda r: np.log(probability(r) / TRUTH), 1.0, 12.0)

    def score(u: Floats) -> Floats:
        z = normal(u)
        return np.asarray(reach + curvature * z[:, 0] ** 2 - z[:, 1:].sum(1) / np.sqrt(dimension - 1))

    return dimension, score, probability(reach)


def binary(dimension: int, truth: float) -> Function:
    """A corner of the cube, of which the score tells nothing but whether it was met."""
    side = truth ** (1.0 / dimension)
    return dimension, lambda u: np.where((u < side).all(axis=1), 0.0, 1.0), truth


HALVES: Final[dict[str, dict[str, Callable[[], Function]]]] = {
    "choose": {
        "plane, d = 2": lambda: plane(2),
        "plane, d = 6": lambda: plane(6),
        "four branches, d = 2": branches,
        "outside of a ball, d = 4": lambda: outside(4),
        "four far regions, d = 3": lambda: planes(3, 4),
        "two boxes, d = 3": lambda: boxes(3),
        "bent away, d = 3": lambda: bent(3, 0.5),
        "bent towards, d = 5": lambda: bent(5, -0.3),
        "outside of a ball, d = 8": lambda: outside(8),
        "corner, d = 8": lambda: corner(8),
        "bent away, d = 8": lambda: bent(8, 0.5),
        "plane, d = 10": lambda: plane(10),
    },
    "judge": {
        "plane, d = 4": lambda: plane(4),
        "outside of a ball, d = 2": lambda: outside(2),
        "outside of a ball, d = 6": lambda: outside(6),
        "eight far regions, d = 5": lambda: planes(5, 8),
        "two boxes on a plateau, d = 3": lambda: boxes(3, 0.3),
        "two boxes, d = 5": lambda: boxes(5),
        "corner, d = 3": lambda: corner(3),
        "bent away, d = 5": lambda: bent(5, 1.0),
        "bent towards, d = 3": lambda: bent(3, -0.3),
        "corner, d = 10": lambda: corner(10),
        "bent away, d = 12": lambda: bent(12, 0.5),
        "plane, d = 12": lambda: plane(12),
        "plane, d = 20": lambda: plane(20),
        "met or not, d = 4": lambda: binary(4, 1e-3),
    },
}


def estimated(function: Function, runs: int, seed: int) -> tuple[Any, bool]:
    """Probability by importance sampling, and whether it warns."""
    dimension, score, _ = function
    space = ParameterSpace.from_ranges([f"x{axis}=0:1" for axis in range(dimension)])
    sampling, spent, plain = ImportanceSampling(space, 1, round(0.4 * runs), seed), 0, probability_from_counts(0, 0)
    while sampling.next_stage != "estimate" and spent < runs:
        points = sampling.draw_round(runs - spent)
        scores = score(points)
        if sampling.next_stage == "law":
            plain = probability_from_counts(plain.met + int((scores <= 0.0).sum()), plain.scenarios + len(scores))
        sampling.record_round(points, scores, (scores <= 0.0)[:, None])
        spent += len(points)
    if sampling.is_plain:
        return plain, bool(describe_doubts("critical scenario", plain, plain, plain.scenarios, 0))
    points = sampling.draw_round(runs - spent)
    found = probability_from_weights(sampling.importance_weights(points), score(points) <= 0.0)
    return found, bool(describe_doubts("critical scenario", found, plain, plain.scenarios + len(points), 0))


def judged(function: Function, runs: int, repetitions: int, first_seed: int = 0) -> dict[str, float]:
    truth, begun = function[2], time.process_time()
    found = [estimated(function, runs, seed) for seed in range(first_seed, first_seed + repetitions)]
    ratios = np.array([one.value / truth for one, _ in found])
    return {
        "mean": float(ratios.mean()),
        "deviation": float(ratios.std()),
        "holds": float(np.mean([one.low <= truth <= one.high for one, _ in found])),
        "warns": float(np.mean([warns for _, warns in found])),
        "holds without warning": float(
            np.mean([one.low <= truth <= one.high for one, warns in found if not warns] or [np.nan])
        ),
        "seconds": (time.process_time() - begun) / repetitions,
    }


def by_openturns(function: Function, runs: int, repetitions: int) -> dict[str, float] | None:
    """OpenTURNS' subset sampling with about as many runs; None where it is not installed."""
    try:
        openturns: Any = importlib.import_module("openturns")
    except ImportError:
        return None
    dimension, score, truth = function
    ratios, spent = [], []
    for seed in range(repetitions):
        openturns.RandomGenerator.SetSeed(seed)
        law = openturns.JointDistribution([openturns.Uniform(0.0, 1.0)] * dimension)
        scores = openturns.PythonFunction(
            dimension, 1, func_sample=lambda sample: score(np.array(sample)).reshape(-1, 1).tolist()
        )
        event = openturns.ThresholdEvent(
            openturns.CompositeRandomVector(scores, openturns.RandomVector(law)), openturns.LessOrEqual(), 0.0
        )
        # Five levels of a tenth each.
        algorithm = openturns.SubsetSampling(event)
        algorithm.setBlockSize(100)
        algorithm.setMaximumOuterSampling(runs // 500)
        try:
            algorithm.run()
        except TypeError:
            # On a plateau it finds no variance.
            continue
        ratios.append(algorithm.getResult().getProbabilityEstimate() / truth)
        spent.append(scores.getEvaluationCallsNumber())
    if not ratios:
        return {"failed": float(repetitions)}
    return {"mean": float(np.mean(ratios)), "deviation": float(np.std(ratios)), "runs": float(np.mean(spent))}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--quick", action="store_true", help="two functions, three repetitions")
    parser.add_argument("--half", choices=sorted(HALVES), help="only these functions")
    parser.add_argument(
        "--only", action="append", choices=[name for half in HALVES.values() for name in half], help="may be repeated"
    )
    parser.add_argument("--runs", type=int, default=5000)
    parser.add_argument("--repetitions", type=int, default=100)
    parser.add_argument("--json", type=Path, help="write the figures as JSON")
    given = parser.parse_args()
    repetitions = 3 if given.quick else given.repetitions
    table = {}
    for half in [given.half] if given.half else sorted(HALVES):
        for name in [one for one in HALVES[half] if one in (given.only or HALVES[half])][: 1 if given.quick else None]:
            function = HALVES[half][name]()
            one = table[name] = {"half": half, **judged(function, given.runs, repetitions)}
            peer = by_openturns(function, given.runs, min(repetitions, 20))
            text = " | ".join(f"{key} {value:.3g}" if isinstance(value, float) else value for key, value in one.items())
            other = "not installed" if peer is None else ", ".join(f"{key} {value:.3g}" for key, value in peer.items())
            print(f"{name} | {text} | OpenTURNS' subset sampling: {other}", flush=True)
            one["OpenTURNS"] = peer
    if given.json:
        given.json.write_text(json.dumps(table, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
