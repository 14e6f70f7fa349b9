"""Speed of the DTW distance matrix beside aeon, dtaidistance and tslearn: same series, same definition.

python benchmarks/dtw.py [--quick] [--threads N] [--json FILE]

The definition is the squared local cost, which all four know; the Euclidean one, which cornercase uses for
scenarios, is shown for itself. A cell is one entry of the table of one pair; the best of the rounds counts.
"""

# mypy: disable-error-code="import-not-found"

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from cornercase.dtw import distance_matrix
from cornercase.dtw.cpu import available_cpus

Series = list[npt.NDArray[np.float64]]
Call = Callable[[Series], npt.NDArray[Any]]

# Pairs whose distance is computed again by the definition, for the column of differences.
CHECKED_PAIRS = 3


def ours(dtype: str, local_cost: str, threads: int) -> Call:
    return lambda series: distance_matrix(
        series,
        dtype=dtype,
        local_cost=local_cost,  # type: ignore[arg-type]
        n_jobs=threads,
    )


def peers(threads: int) -> dict[str, Call]:
    """Return those that are installed, each giving the root of the summed squared distances."""
    found: dict[str, Call] = {}
    try:
        from aeon.distances import dtw_pairwise_distance

        def aeon(series: Series) -> npt.NDArray[Any]:
            # Series of one length are one array, the form that aeon is fastest with; axes are (n, k, T).
            stacked = np.ascontiguousarray(np.stack(series).transpose(0, 2, 1))
            return np.asarray(np.sqrt(dtw_pairwise_distance(stacked, n_jobs=threads)))

        found["aeon"] = aeon
    except ImportError:
        pass
    try:
        from dtaidistance import dtw, dtw_ndim

        def dtaidistance(series: Series) -> npt.NDArray[Any]:
            many = threads > 1
            if series[0].shape[1] == 1:
                flat = [one[:, 0].copy() for one in series]
                return np.asarray(dtw.distance_matrix(flat, use_c=True, parallel=many, use_mp=False))
            return np.asarray(dtw_ndim.distance_matrix(series, use_c=True, parallel=many, use_mp=False))

        found["dtaidistance"] = dtaidistance
    except ImportError:
        pass
    try:
        from tslearn.metrics import cdist_dtw

        found["tslearn"] = lambda series: np.asarray(cdist_dtw(series, n_jobs=threads))
    except ImportError:
        pass
    return found


def defined(x: npt.NDArray[np.float64], y: npt.NDArray[np.float64], squared: bool) -> float:
    """Distance of one pair by the definition, in double precision."""
    costs = ((x[:, None] - y) ** 2).sum(axis=2)
    table = np.full((len(x) + 1, len(y) + 1), np.inf)
    table[0, 0] = 0.0
    for i, row in enumerate(costs if squared else np.sqrt(costs)):
        for j, cost in enumerate(row):
            table[i + 1, j + 1] = cost + min(table[i, j], table[i, j + 1], table[i + 1, j])
    return float(np.sqrt(table[-1, -1]) if squared else table[-1, -1])


def measure(n: int, length: int, dims: int, threads: int, rounds: int) -> list[dict[str, Any]]:
    """Run everybody on one set of random walks."""
    rng = np.random.default_rng(0)
    series = [np.cumsum(rng.normal(size=(length, dims)), axis=0) for _ in range(n)]
    calls: dict[str, Call] = {
        "cornercase float32": ours("float32", "squared", threads),
        "cornercase float64": ours("float64", "squared", threads),
        "cornercase float64 euclidean": ours("float64", "euclidean", threads),
        **peers(threads),
    }
    times: dict[str, float] = dict.fromkeys(calls, np.inf)
    matrices: dict[str, npt.NDArray[Any]] = {}
    for call in calls.values():
        call(series[:4])
    for _ in range(rounds):
        for name, call in calls.items():
            begin = time.perf_counter()
            matrices[name] = call(series)
            times[name] = min(times[name], time.perf_counter() - begin)
    pairs = rng.choice(n, size=(CHECKED_PAIRS, 2), replace=False)
    rows = []
    for name, matrix in matrices.items():
        exact = [defined(series[i], series[j], "euclidean" not in name) for i, j in pairs]
        got = [matrix[min(pair), max(pair)] for pair in pairs]
        rows.append(
            {
                "n": n,
                "length": length,
                "dims": dims,
                "who": name,
                "seconds": times[name],
                "cells_per_second": n * (n - 1) / 2 * length**2 / times[name],
                "largest_relative_difference": float(np.max(np.abs(np.array(got) / exact - 1.0))),
            }
        )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="one size, under a minute")
    parser.add_argument("--threads", type=int, default=available_cpus())
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    os.environ["OMP_NUM_THREADS"] = str(options.threads)

    missing = {"aeon", "dtaidistance", "tslearn"} - set(peers(options.threads))
    if missing:
        print(f"Not installed, so not measured: {', '.join(sorted(missing))} (extra 'bench').", file=sys.stderr)
    sizes = [(100, 100), (100, 400)] if options.quick else [(n, t) for n in (200, 400, 1000) for t in (100, 200, 400)]
    rows: list[dict[str, Any]] = []
    print(f"{'n':>5} {'length':>6} {'k':>2}  {'':30} {'s':>9} {'Gcells/s':>9} {'largest difference':>19}")
    for n, length in sizes:
        for dims in (1, 2):
            for row in measure(n, length, dims, options.threads, 2 if n < 1000 else 1):
                rows.append(row)
                print(
                    f"{n:5} {length:6} {dims:2}  {row['who']:30} {row['seconds']:9.3f} "
                    f"{row['cells_per_second'] / 1e9:9.3f} {row['largest_relative_difference']:19.1e}"
                )
    if options.json:
        about = {
            "machine": platform.processor() or platform.machine(),
            "threads": options.threads,
            "versions": {name: version(name) for name in ("numba", "numpy", *peers(options.threads))},
        }
        options.json.write_text(json.dumps({"about": about, "rows": rows}, indent=1))


if __name__ == "__main__":
    main()
