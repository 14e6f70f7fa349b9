"""Importance sampling of rare events held against known probabilities, plain Monte Carlo and OpenTURNS.

python benchmarks/rare.py [--quick] [--half {choose,judge,limit-states}] [--only NAME]… [--runs N] [--repetitions N]
                          [--peer-repetitions N] [--json FILE]

Each function has a critical set whose probability is known by a formula or an integral: 1e-5 in the halves "choose" and
"judge", and 1e-3 for the one whose scores tell only whether it was met; 1e-6 to 2e-3 in "limit-states". Shown are, over
the truth, the mean, the standard deviation and the root mean square error of the estimates, how many of the 95 %
intervals hold it, and how often a run warns that its interval may be too narrow. The constants of the method were
chosen with the functions of the half "choose" alone.

Beside it are the error of plain Monte Carlo with as many runs, and, with OpenTURNS installed (extra `bench`), those of
its subset sampling and of its nonparametric adaptive importance sampling (NAIS). Both decide for themselves how many
runs they take. So an error at equal cost is given, too: the error times the root of their runs over ours.
"""

from __future__ import annotations

import argparse
import importlib
import json
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.integrate import dblquad, quad
from scipy.optimize import brentq
from scipy.special import gamma as gamma_function
from scipy.special import ndtr, ndtri
from scipy.stats import chi2, gamma, norm

from cornercase.evidence._probability import probability_from_counts, probability_from_weights
from cornercase.evidence._rare_events import ImportanceSampling
from cornercase.exploration._estimation import describe_doubts
from cornercase.scenario import ParameterSpace

Floats = npt.NDArray[np.float64]
Function = tuple[int, Callable[[Floats], Floats], float]

TRUTH: Final = 1e-5
# A search of OpenTURNS that takes more runs than this multiple of ours has failed.
MOST_RUNS: Final = 10


def normal(points: Floats) -> Floats:
    return np.asarray(ndtri(np.clip(points, 1e-16, 1.0 - 1.2e-16)))


def plane(dimension: int, truth: float = TRUTH) -> Function:
    """Beyond a plane."""
    reach = -norm.ppf(truth)
    return dimension, lambda u: reach - normal(u).sum(1) / np.sqrt(dimension), truth


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


def two_planes(dimension: int, truth: float, parallel: bool = False) -> Function:
    """Beyond one of two planes whose normals are 60° apart, or beyond both of them (a parallel system)."""
    first = np.full(dimension, 1.0 / np.sqrt(dimension))
    across = np.tile([1.0, -1.0], dimension)[:dimension]
    across = across - across @ first * first
    normals = np.array([first, 0.5 * first + np.sqrt(0.75) * across / np.linalg.norm(across)])

    def probability(reach: float) -> float:
        both = quad(
            lambda a: norm.pdf(a) * norm.sf((reach - 0.5 * a) / np.sqrt(0.75)), reach, np.inf, epsabs=0.0, limit=500
        )[0]
        return float(both if parallel else 2.0 * norm.sf(reach) - both)

    reach = brentq(lambda r: np.log(probability(r) / truth), 1.0, 7.0)
    worst = np.max if parallel else np.min
    return dimension, lambda u: np.asarray(worst(reach - normal(u) @ normals.T, axis=1)), probability(reach)


def saddle(truth: float) -> Function:
    """Beyond a saddle in three dimensions."""

    def probability(reach: float) -> float:
        def beyond(b: float, a: float) -> float:
            return float(norm.pdf(a) * norm.pdf(b) * norm.sf(reach - 0.2 * (a * a - b * b)))

        return float(4.0 * dblquad(beyond, 0.0, 9.0, 0.0, 9.0, epsabs=1e-12)[0])

    reach = brentq(lambda r: np.log(probability(r) / truth), 2.0, 8.0, xtol=1e-6)

    def score(u: Floats) -> Floats:
        z = normal(u)
        return np.asarray(reach - z[:, 2] - 0.2 * (z[:, 0] ** 2 - z[:, 1] ** 2))

    return 3, score, probability(reach)


def four_corners(dimension: int) -> Function:
    """Where two parameters are both far from their middle, on any side."""
    reach = norm.isf(0.5 * np.sqrt(TRUTH))
    return dimension, lambda u: reach - np.abs(normal(u)[:, :2]).min(axis=1), TRUTH


def sheet(dimension: int, truth: float) -> Function:
    """A thin curved sheet: scores are the distance to it, less half of its thickness."""

    def probability(half: float) -> float:
        def inside(x: float) -> float:
            middle = 2.0 - 0.3 * x * x
            return float(norm.pdf(x) * (norm.cdf(middle + half) - norm.cdf(middle - half)))

        return float(quad(inside, -9.0, 9.0, epsabs=0.0, limit=500)[0])

    half = brentq(lambda h: np.log(probability(h) / truth), 1e-9, 1.0, xtol=1e-15)

    def score(u: Floats) -> Floats:
        z = normal(u)
        return np.asarray(np.abs(z[:, -1] - 2.0 + 0.3 * z[:, 0] ** 2) - half)

    return dimension, score, probability(half)


def funnel(dimension: int) -> Function:
    """A ball within the cube; scores fall towards it within a distance of 0.25, and are the same elsewhere."""
    radius = (TRUTH * gamma_function(0.5 * dimension + 1.0)) ** (1.0 / dimension) / np.sqrt(np.pi)
    middle = np.linspace(0.3, 0.7, dimension)
    return dimension, lambda u: np.minimum(np.linalg.norm(u - middle, axis=1), 0.25) - radius, TRUTH


def decoy(dimension: int, truth: float) -> Function:
    """A box around which scores are no better than elsewhere: they fall towards another place, where nothing is."""
    side = truth ** (1.0 / dimension)

    def score(u: Floats) -> Floats:
        away = np.linalg.norm(u - 0.2, axis=1) + 0.1
        return np.asarray(np.where(np.abs(u - 0.75).max(axis=1) < 0.5 * side, -0.1, away))

    return dimension, score, truth


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
        "decoy, d = 4": lambda: decoy(4, 1e-3),
        "decoy, d = 2": lambda: decoy(2, 1e-2),
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
    "limit-states": {
        "two planes, d = 6, 1e-4": lambda: two_planes(6, 1e-4),
        "two planes, d = 4, 1e-6": lambda: two_planes(4, 1e-6),
        "beyond both planes, d = 5, 1e-5": lambda: two_planes(5, 1e-5, parallel=True),
        "saddle, d = 3, 1e-4": lambda: saddle(1e-4),
        "four corners, d = 5, 1e-5": lambda: four_corners(5),
        "sum of gamma, d = 10, 1e-5": lambda: corner(10),
        "plane, d = 12, 1e-3": lambda: plane(12, 1e-3),
        "plane, d = 20, 1e-4": lambda: plane(20, 1e-4),
        "thin sheet, d = 3, 1e-3": lambda: sheet(3, 1e-3),
        "thin sheet, d = 2, 1e-4": lambda: sheet(2, 1e-4),
        "funnel in a plateau, d = 4, 1e-5": lambda: funnel(4),
        "decoy, d = 3, 2e-3": lambda: decoy(3, 2e-3),
        "met or not, d = 4, 1e-3": lambda: binary(4, 1e-3),
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
    if spent == runs:
        return plain, bool(describe_doubts("critical scenario", plain, plain, plain.scenarios, 0))
    points = sampling.draw_round(runs - spent)
    occurred = score(points) <= 0.0
    if sampling.is_plain_after_learning:
        found = probability_from_counts(int(occurred.sum()), len(points))
    else:
        found = probability_from_weights(sampling.importance_weights(points), occurred)
    return found, bool(describe_doubts("critical scenario", found, plain, plain.scenarios + len(points), 0))


def judged(function: Function, runs: int, repetitions: int, first_seed: int = 0) -> dict[str, float]:
    truth, begun = function[2], time.process_time()
    found = [estimated(function, runs, seed) for seed in range(first_seed, first_seed + repetitions)]
    ratios = np.array([one.value / truth for one, _ in found])
    return {
        "mean": float(ratios.mean()),
        "deviation": float(ratios.std()),
        "rmse": float(np.sqrt(np.mean(np.square(ratios - 1.0)))),
        "plain rmse": float(np.sqrt((1.0 - truth) / (truth * runs))),
        "holds": float(np.mean([one.low <= truth <= one.high for one, _ in found])),
        "warns": float(np.mean([warns for _, warns in found])),
        "holds without warning": float(
            np.mean([one.low <= truth <= one.high for one, warns in found if not warns] or [np.nan])
        ),
        "seconds": (time.process_time() - begun) / repetitions,
    }


def by_openturns(function: Function, runs: int, repetitions: int) -> dict[str, dict[str, float]]:
    """Subset sampling and NAIS of OpenTURNS in standard normal space; none where it is not installed."""
    try:
        openturns: Any = importlib.import_module("openturns")
    except ImportError:
        return {}
    dimension, score, truth = function
    # As many levels of a tenth as it should take; a truth that was solved for is not exactly a power of ten.
    size = round(runs / np.ceil(-np.log10(truth) - 1e-6))
    found: dict[str, dict[str, float]] = {}
    for name in ("SubsetSampling", "NAIS"):
        ratios, spent, holds = [], [], []
        for seed in range(repetitions):
            openturns.RandomGenerator.SetSeed(seed)
            law = openturns.JointDistribution([openturns.Normal(0.0, 1.0)] * dimension)
            calls = 0

            def evaluate(sample: Any) -> list[list[float]]:
                nonlocal calls
                calls += len(sample)
                if calls > MOST_RUNS * runs:
                    raise RuntimeError("It does not come to an end.")
                return list(score(ndtr(np.array(sample))).reshape(-1, 1).tolist())

            scores = openturns.PythonFunction(dimension, 1, func_sample=evaluate)
            event = openturns.ThresholdEvent(
                openturns.CompositeRandomVector(scores, openturns.RandomVector(law)), openturns.LessOrEqual(), 0.0
            )
            algorithm = getattr(openturns, name)(event)
            algorithm.setBlockSize(100)
            algorithm.setMaximumOuterSampling(size // 100)
            # On a plateau they find no variance, or no end.
            with suppress(TypeError, RuntimeError, ValueError):
                algorithm.run()
                result = algorithm.getResult()
                value, length = result.getProbabilityEstimate() / truth, result.getConfidenceLength(0.95) / truth
                ratios.append(value)
                holds.append(abs(value - 1.0) <= 0.5 * length)
                spent.append(calls)
        error = float(np.sqrt(np.mean(np.square(np.array(ratios) - 1.0)))) if ratios else np.nan
        mean_calls = float(np.mean(spent)) if spent else np.nan
        found[name] = {
            "mean": float(np.mean(ratios)) if ratios else np.nan,
            "rmse": error,
            "holds": float(np.mean(holds)) if holds else np.nan,
            "runs": mean_calls,
            "failed": float(repetitions - len(ratios)),
            "rmse at equal cost": error * float(np.sqrt(mean_calls / runs)),
        }
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--quick", action="store_true", help="two functions, three repetitions")
    parser.add_argument("--half", choices=sorted(HALVES), help="only these functions")
    parser.add_argument(
        "--only", action="append", choices=[name for half in HALVES.values() for name in half], help="may be repeated"
    )
    parser.add_argument("--runs", type=int, default=5000)
    parser.add_argument("--repetitions", type=int, default=100)
    parser.add_argument("--peer-repetitions", type=int, default=20, metavar="N", help="those of OpenTURNS")
    parser.add_argument("--json", type=Path, help="write the figures as JSON")
    given = parser.parse_args()
    repetitions = 3 if given.quick else given.repetitions
    table: dict[str, dict[str, Any]] = {}
    for half in [given.half] if given.half else sorted(HALVES):
        for name in [one for one in HALVES[half] if one in (given.only or HALVES[half])][: 1 if given.quick else None]:
            function = HALVES[half][name]()
            one = table[name] = {"half": half, **judged(function, given.runs, repetitions)}
            text = " | ".join(f"{key} {value:.3g}" if isinstance(value, float) else value for key, value in one.items())
            print(f"{name} | {text}", flush=True)
            one["peers"] = by_openturns(function, given.runs, min(repetitions, given.peer_repetitions))
            for peer, figures in one["peers"].items():
                print(f"    {peer} | " + " | ".join(f"{key} {value:.3g}" for key, value in figures.items()), flush=True)
    if given.json:
        given.json.write_text(json.dumps(table, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
