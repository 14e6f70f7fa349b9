"""Speed of the DTW distance matrix beside aeon, dtaidistance and tslearn: same series, same definition.

python benchmarks/dtw.py [--quick | --paper | --disk] [--device cpu|cuda] [--threads N] [--json FILE]

The definition is the squared local cost, which all four know; the Euclidean one, which cornercase uses for
scenarios, is shown for itself. A cell is one entry of the table of one pair; the best of the rounds counts.

--paper measures the matrices of 300 and 3,375 scenarios of 400 instants, each in a process of its own. What
starts compilers and the GPU, a first call on three series, does not count.
--disk writes the matrix of 20,000 courses of 200 instants to a file, is killed in the middle, and goes on.
"""

# mypy: disable-error-code="import-not-found"

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from cornercase._common.platform import count_available_cpus
from cornercase.dtw import _matrix_file as disk
from cornercase.dtw import distance_matrix

Series = list[npt.NDArray[np.float64]]
Call = Callable[[Series], npt.NDArray[Any]]

# Pairs whose distance is computed again by the definition, for the column of differences.
CHECKED_PAIRS = 10


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
    definition = {squared: [defined(series[i], series[j], squared) for i, j in pairs] for squared in (False, True)}
    rows = []
    for name, matrix in matrices.items():
        exact = definition["euclidean" not in name]
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


def own_process(*arguments: str) -> dict[str, Any]:
    """Run this file with arguments of its own, and return what it says last."""
    run = subprocess.run([sys.executable, __file__, *arguments], stdout=subprocess.PIPE, text=True, check=True)
    return dict(json.loads(run.stdout.splitlines()[-1]))


def one_matrix(
    n: int, length: int, dims: int, dtype: str, threads: int, device: str, out: str | None
) -> dict[str, Any]:
    """Compute one matrix of random walks with the Euclidean cost; seconds, memory, and difference to the definition."""
    rng = np.random.default_rng(0)
    series = [np.cumsum(rng.normal(size=(length, dims)), axis=0) for _ in range(n)]
    options: dict[str, Any] = {"dtype": dtype, "n_jobs": threads, "device": device}
    distance_matrix(series[:3], **options)
    begin = time.perf_counter()
    found = distance_matrix(series, **options, out=out, resume=out is not None)
    seconds = time.perf_counter() - begin
    pairs = rng.choice(n, size=(CHECKED_PAIRS, 2), replace=False)
    exact = np.array([defined(series[i], series[j], squared=False) for i, j in pairs])
    difference = np.max(np.abs(found[pairs.min(axis=1), pairs.max(axis=1)] / exact - 1.0))
    return {
        "n": n,
        "length": length,
        "dims": dims,
        "dtype": dtype,
        "device": device,
        "seconds": seconds,
        "largest_relative_difference": float(difference),
        "gigabytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9,
    }


def paper(threads: int, device: str) -> list[dict[str, Any]]:
    rows = []
    print(f"{'scenarios':>9} {'instants':>8} {'k':>2} {'arithmetic':>10} {'s':>9} {'GB':>6} {'largest difference':>19}")
    for n in (300, 3375):
        for dims in (2, 1):
            for dtype in ("float64", "float32"):
                asked = ("--one", f"{n},400,{dims},{dtype}", "--threads", str(threads), "--device", device)
                rows.append(row := own_process(*asked))
                print(
                    f"{n:9} {400:8} {dims:2} {dtype:>10} {row['seconds']:9.2f} {row['gigabytes']:6.2f} "
                    f"{row['largest_relative_difference']:19.1e}",
                    flush=True,
                )
    return rows


def killed_and_resumed(threads: int, n: int) -> list[dict[str, Any]]:
    """Write a matrix to a file, kill the process at half of its squares, and let another go on."""
    bands = -(-n // disk.SIDE)
    squares = bands * (bands + 1) // 2
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "matrix.npy"
        progress = path.with_name(path.name + ".progress")
        arguments = ["--one", f"{n},200,1,float64", "--threads", str(threads), "--out", str(path)]
        begin = time.perf_counter()
        child = subprocess.Popen([sys.executable, __file__, *arguments])
        while not progress.exists() or progress.read_bytes().count(b"\n") <= squares // 2:
            time.sleep(0.1)
            if child.poll() is not None:
                raise SystemExit("The process ended before it was killed.")
        peak = memory_of(child.pid)
        child.send_signal(signal.SIGKILL)
        child.wait()
        done = progress.read_bytes().count(b"\n") - 1
        first = {"squares": done, "seconds": time.perf_counter() - begin, "gigabytes": peak}
        print(f"killed after {done} of {squares} squares, {first['seconds']:.0f} s, {peak:.2f} GB", flush=True)
        second = {"squares": squares - done, **own_process(*arguments)}
        print(f"went on with {squares - done}: {second['seconds']:.0f} s, {second['gigabytes']:.2f} GB")
        print(f"{path.stat().st_size / 1e9:.2f} GB in the file")
    return [first, second]


def memory_of(pid: int) -> float:
    """Most memory that a running process has had, in GB."""
    status = Path(f"/proc/{pid}/status").read_text(encoding="utf-8")
    return next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM")) * 1024 / 1e9


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="one size, under a minute")
    parser.add_argument("--threads", type=int, default=count_available_cpus())
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--paper", action="store_true", help="the paper's sizes")
    parser.add_argument("--disk", action="store_true", help="a matrix on disk, killed and resumed")
    parser.add_argument("--series", type=int, default=20_000, help="number of series for --disk")
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu", help="of --paper")
    parser.add_argument("--one", metavar="N,T,K,DTYPE", help=argparse.SUPPRESS)
    parser.add_argument("--out", help=argparse.SUPPRESS)
    options = parser.parse_args()
    os.environ["OMP_NUM_THREADS"] = str(options.threads)

    if options.one:
        n, length, dims, dtype = options.one.split(",")
        print(
            json.dumps(one_matrix(int(n), int(length), int(dims), dtype, options.threads, options.device, options.out))
        )
        return
    if options.paper or options.disk:
        rows = (
            paper(options.threads, options.device)
            if options.paper
            else killed_and_resumed(options.threads, options.series)
        )
        write(options, rows, [])
        return

    missing = {"aeon", "dtaidistance", "tslearn"} - set(peers(options.threads))
    if missing:
        print(f"Not installed, so not measured: {', '.join(sorted(missing))} (extra 'bench').", file=sys.stderr)
    sizes = [(100, 100), (100, 400)] if options.quick else [(n, t) for n in (200, 400, 1000) for t in (100, 200, 400)]
    rows = []
    print(f"{'n':>5} {'length':>6} {'k':>2}  {'':30} {'s':>9} {'Gcells/s':>9} {'largest difference':>19}")
    for n, length in sizes:
        for dims in (1, 2):
            for row in measure(n, length, dims, options.threads, {200: 3, 400: 2}.get(n, 1)):
                rows.append(row)
                print(
                    f"{n:5} {length:6} {dims:2}  {row['who']:30} {row['seconds']:9.3f} "
                    f"{row['cells_per_second'] / 1e9:9.3f} {row['largest_relative_difference']:19.1e}",
                    flush=True,
                )
    write(options, rows, list(peers(options.threads)))


def write(options: argparse.Namespace, rows: list[dict[str, Any]], others: list[str]) -> None:
    if options.json:
        about = {
            "machine": platform.processor() or platform.machine(),
            "threads": options.threads,
            "versions": {name: version(name) for name in ("numba", "numpy", *others)},
        }
        options.json.write_text(json.dumps({"about": about, "rows": rows}, indent=1))


if __name__ == "__main__":
    main()
