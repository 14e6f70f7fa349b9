"""What each constant of the searches and estimates is worth, on scenarios that did not choose it.

python benchmarks/constants.py [--quick] [--part {found,search,estimate}]… [--seeds N] [--repetitions N]
                               [--truth FOLDER] [--runs FOLDER] [--json FILE] --ncap FOLDER --alks FOLDER

Each constant gets other values in turn, usually half and twice its own, and everything else stays. Three parts:

- ``found``: the critical set that is predicted from scenarios of ``sobol`` and ``level-set``, on the scenarios of the
  half ``judge`` of benchmarks/intervals.py, after 100 and 200 scenarios: its mean F1 score, how many 90 % intervals of
  the critical share and of the missed fraction hold the truth, and their median widths;
- ``search``: the mean F1 score that ``auto`` or ``level-set`` reaches there, after 100 and 200 scenarios;
- ``estimate``: importance sampling on the functions of the half ``judge`` of benchmarks/rare.py: the root mean square
  error as a multiple of the error with the constant's own value (geometric mean of the functions, and the largest), and
  how many 95 % intervals hold the truth.

Constants were chosen with the halves ``choose``. Differences of the size of one seed to the next say nothing: the
first row of each part is repeated with other seeds for comparison.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from cornercase.evidence._critical_set_estimate import _COMMITTEE_PRIOR
from cornercase.evidence._probit_calibration import CalibrationPrior

# Beside this file; mypy knows them by their package.
from exploration import EXAMPLES, Folders, Judge  # type: ignore[attr-defined]
from intervals import HALVES, bounds_and_truth, judge_at, path_of_run, run_search, settle_threshold  # type: ignore[import-not-found]
from rare import HALVES as FUNCTIONS  # type: ignore[import-not-found]
from rare import judged

SIZES = (100, 200)
RUNS = 5000


@dataclass(frozen=True)
class Change:
    """Another value of a constant, in one part of the benchmark; without a constant: nothing changes."""

    part: str
    search: str = ""
    module: str = ""
    constant: str = ""
    value: Any = None
    first_seed: int = 0

    @property
    def text(self) -> str:
        """What changes, as in a table."""
        search = f"{self.search}: " if self.search else ""
        if not self.constant:
            return f"{search}as it is" + (f", seeds from {self.first_seed}" if self.first_seed else "")
        value = "none" if self.value == frozenset() else f"{self.value}"
        return f"{search}`{self.module.rpartition('.')[2]}.{self.constant}` = {value}"

    @contextmanager
    def applied(self) -> Iterator[None]:
        """Within the block, the constant has the other value."""
        if not self.constant:
            yield
            return
        module = importlib.import_module(f"cornercase.{self.module}")
        own = getattr(module, self.constant)
        setattr(module, self.constant, self.value)
        try:
            yield
        finally:
            setattr(module, self.constant, own)


FOUND: list[tuple[str, str, tuple[Any, ...]]] = [
    ("evidence._critical_set_estimate", "PREDICTED_CRITICAL", (0.4, 0.5)),
    ("evidence._critical_set_estimate", "_PREDICTION_WEIGHT", (0.25, 1.0)),
    ("evidence._critical_set_estimate", "_CHOSEN_WEIGHT", (0.125, 0.5)),
    (
        "evidence._critical_set_estimate",
        "_COMMITTEE_PRIOR",
        (CalibrationPrior(), *(replace(_COMMITTEE_PRIOR, p_surprises=p) for p in (0.0, 0.5))),
    ),
    ("evidence._critical_set_estimate", "_UNEXPLAINED", (0.05, 0.2)),
    ("evidence._critical_set_estimate", "_P_HIDDEN", (0.0, 0.25, 0.9)),
    ("evidence._critical_set_estimate", "_MIN_DEVIATION", (0.01, 0.04)),
    ("evidence._probit_calibration", "_FULL_WEIGHT_COUNT", (80, 10**9)),
    ("evidence._committee", "_UNUSED_FEATURES", (frozenset(),)),
    ("evidence._committee", "_PRIOR_COUNT", (1.0, 4.0)),
    ("evidence._committee", "_FOLDS", (3, 10)),
    ("evidence._feature_models", "_MAX_NOISE", (0.25, 1.0)),
    ("evidence._feature_models", "_MIN_BRANCH_SCENARIOS", (4, 16)),
    ("evidence.gp._gaussian_process", "_FULL_SCALE_COUNT", (50, 200)),
    ("evidence.gp._gaussian_process", "_SMOOTH_SCALE", (1.0, 4.0)),
    ("evidence.gp._gaussian_process", "_UNSQUASHED_FRACTION", (0.0, 0.2)),
    ("evidence.gp._gaussian_process", "_LOW_MAX_NOISE", (0.01, 0.04)),
    ("evidence.gp._matern_kernel", "_PRIOR_MEDIAN", (0.25, 1.0)),
    ("evidence.gp._matern_kernel", "_PRIOR_SPREAD", (0.35, 1.4)),
]
SEARCH: list[tuple[str, str, str, tuple[Any, ...]]] = [
    ("auto", "optimizers._auto", "_LOCAL_MINIMA_FRACTION", (0.0, 0.3)),
    ("auto", "optimizers._auto", "_MAX_FAILURE_PROBABILITY", (0.125, 0.5)),
    ("auto", "optimizers._auto", "_CONDITIONING_STEP", (1, 10)),
    ("auto", "optimizers._committee_search", "_BRANCH_WEIGHT", (0.0, 0.25, 1.0)),
    ("auto", "optimizers._committee_search", "_MIN_SIDE", (0.05, 0.2, 1.0)),
    ("auto", "optimizers._committee_search", "_MAX_DEVIATION", (0.03, 0.12)),
    ("auto", "optimizers._local_minima", "_MAX_RELATIVE_HEIGHT", (1.5, 6.0)),
    ("level-set", "optimizers._level_set", "_LOCAL_MINIMA_FRACTION", (0.0, 0.3)),
    ("level-set", "optimizers._level_set", "_MIN_PROBABILITY", (0.025, 0.1)),
    ("level-set", "optimizers._level_set", "_UNCERTAIN_FRACTIONS", ((0.015, 0.04), (0.06, 0.16))),
    ("level-set", "optimizers._level_set", "_FILLING_FACTORS", ((1.0, 1.0), (5.0, 1.0))),
    ("level-set", "optimizers._local_minima", "_MAX_RELATIVE_HEIGHT", (1.5, 6.0)),
]
ESTIMATE: list[tuple[str, str, tuple[Any, ...]]] = [
    ("evidence._rare_events", "_FIRST_ROUND_FRACTION", (0.1, 0.4)),
    ("evidence._rare_events", "_ROUNDS", (6, 24)),
    ("evidence._rare_events", "_PER_COEFFICIENT", (5, 20)),
    ("evidence._rare_events", "_EVENTS_FACTOR", (5, 20)),
    ("evidence._rare_events", "_WIDE_DEVIATIONS", ((1.0, 1.5), (2.0, 4.0))),
    ("evidence._rare_events", "_WIDE_FRACTION", (0.125, 0.5)),
    ("evidence._rare_events", "_FINAL_WIDE_FRACTION", (0.0, 0.3)),
    ("evidence._rare_events", "_FINAL_PLAIN_FRACTION", (0.0, 0.1)),
    ("evidence._rare_events", "_FINAL_EARLIER_FRACTION", (0.0, 0.4)),
    ("evidence._rare_events", "_MANY_DIMENSIONS", (4, 16, 100)),
    ("evidence._rare_events", "_LINEAR_FRACTION", (0.125, 0.5)),
    ("evidence._rare_events", "_FINAL_LINEAR_FRACTION", (0.0, 0.2)),
    ("evidence._rare_events", "_DISTANCE_SCENARIOS", (5, 20)),
    ("evidence._mixture", "_PRIOR_POINTS_PER_DIMENSION", (0.5, 1.0, 4.0)),
    ("evidence._mixture", "_MIN_POOLED_FRACTION", (0.0, 0.2)),
    ("evidence._mixture", "_MIN_DEGREES_OF_FREEDOM", (1.5, 6.0, 100.0)),
]


def list_changes(parts: list[str], seeds: int) -> list[Change]:
    """All changes of the parts, each part after its rows without a change."""
    changes = []
    if "found" in parts:
        changes += [Change("found", first_seed=seed) for seed in (0, seeds)]
        changes += [Change("found", "", module, name, value) for module, name, values in FOUND for value in values]
    if "search" in parts:
        for search in ("auto", "level-set"):
            changes += [Change("search", search, first_seed=seed) for seed in (0, seeds)]
            changes += [Change("search", *row[:3], value) for row in SEARCH if row[0] == search for value in row[3]]
    if "estimate" in parts:
        changes += [Change("estimate", first_seed=seed) for seed in (0, 1000)]
        changes += [
            Change("estimate", "", module, name, value) for module, name, values in ESTIMATE for value in values
        ]
    return changes


def judge_sets(
    change: Change, case: str, folders: Folders, truth: Path, runs: Path, seeds: int
) -> list[dict[str, Any]]:
    """Judge critical sets of one logical scenario; a search whose constant changes runs anew."""
    settle_threshold(case, folders, 14, truth)
    judge = Judge(case, folders, 14, truth, ("process",))
    rows = []
    for search in (change.search,) if change.search else ("sobol", "level-set"):
        for seed in range(change.first_seed, change.first_seed + seeds):
            path = path_of_run(runs, case, 14, search, seed)
            with TemporaryDirectory() as temporary:
                if change.search:
                    path = Path(temporary) / "run.npy"
                with change.applied():
                    indices = run_search(judge, search, seed, SIZES[-1], path)
            for size in SIZES:
                # What a search finds is judged with the constants as they are.
                with change.applied() if not change.search else nullcontext():
                    rows.append(judge_at(judge, search, seed, indices[:size], with_features=True))
    return rows


def judge_estimates(change: Change, function: str, repetitions: int) -> dict[str, Any]:
    """Errors and intervals of one function's estimates."""
    # A fraction of 0 leaves a distribution out.
    with change.applied(), np.errstate(divide="ignore"):
        row = judged(FUNCTIONS["judge"][function](), RUNS, repetitions, change.first_seed)
    return {"error": float(np.hypot(row["mean"] - 1.0, row["deviation"])), "holds": row["holds"]}


def work(
    change: Change, case: str, folders: Folders, truth: Path, runs: Path, seeds: int, repetitions: int
) -> list[dict[str, Any]]:
    """Judge one change on one logical scenario or function."""
    with threadpool_limits(1):
        if change.part == "estimate":
            return [judge_estimates(change, case, repetitions)]
        return judge_sets(change, case, folders, truth, runs, seeds)


def describe_sets(rows: list[dict[str, Any]], is_search: bool) -> list[str]:
    """Format the figures of critical sets."""
    texts = [f"{np.mean([row.get('f1', 0.0) for row in rows if row['size'] == size]):.3f}" for size in SIZES]
    for what in () if is_search else ("share", "missed"):
        low, high, true = bounds_and_truth(rows, what)
        width = np.median((high - low) / (true if what == "share" else 1.0))
        texts += [f"{np.mean((low <= true) & (true <= high)):.0%} of {len(true)}", f"{width:.3f}"]
    return texts


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--quick", action="store_true", help="two scenarios or functions, two repetitions")
    parser.add_argument("--part", action="append", choices=("found", "search", "estimate"), help="may be repeated")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--repetitions", type=int, default=40, help="of each estimate")
    parser.add_argument("--ncap", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--alks", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--truth", type=Path, default=Path("truth"), metavar="FOLDER")
    parser.add_argument("--runs", type=Path, default=Path("runs"), metavar="FOLDER")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    folders: Folders = {"examples": EXAMPLES, "ncap": options.ncap, "alks": options.alks}
    limit = 2 if options.quick else None
    cases, functions = list(HALVES["judge"])[:limit], list(FUNCTIONS["judge"])[:limit]
    repetitions = 2 if options.quick else options.repetitions
    results, own_errors = [], np.ones(len(functions))
    with ProcessPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        for change in list_changes(options.part or ["found", "search", "estimate"], options.seeds):
            names = functions if change.part == "estimate" else cases
            futures = [
                pool.submit(work, change, name, folders, options.truth, options.runs, options.seeds, repetitions)
                for name in names
            ]
            rows = [row for future in futures for row in future.result()]
            if change.part == "estimate":
                errors = np.array([row["error"] for row in rows])
                if not change.constant and not change.first_seed:
                    own_errors = errors
                ratios = errors / own_errors
                texts = [f"{np.exp(np.log(ratios).mean()):.2f}", f"{ratios.max():.2f} ({names[int(ratios.argmax())]})"]
                texts += [f"{np.mean([row['holds'] for row in rows]):.1%}"]
            else:
                texts = describe_sets(rows, is_search=change.part == "search")
            print("|", " | ".join([change.text, *texts]), "|", flush=True)
            results.append({"change": change.text, "part": change.part, "rows": rows})
    if options.json:
        options.json.write_text(json.dumps(results) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
