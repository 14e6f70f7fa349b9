"""Whether automatic settings find known kinds of scenario, and none where there are none.

    python benchmarks/kinds.py [--quick] [--first SEED] [--draws N] [--many N] [--methods A,B] [--json FILE]

Sets are drawn afresh by ``tests/helpers/synthetic_clusters.py`` with even seeds; constants of the method were chosen
with odd ones, and the
sets marked with * were not made then. Each is compared in aspects in which its kinds differ. Figures are the adjusted
Rand index with the true kinds, median and worst of all draws; for sets without structure, the share of draws that come
out as one kind. Peers get the same distances: HDBSCAN of scikit-learn with its default settings, k-medoids, which is
told how many kinds there are, and k-means of tslearn (``pip install tslearn``), told the same, which gets the series.
Real studies are in ``benchmarks/outcomes.py``. ``--quick`` takes one draw and one aspect of each.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from sklearn.cluster import HDBSCAN
from sklearn.metrics import adjusted_rand_score

from cornercase.clustering import ASPECTS, cluster
from cornercase.dtw import distance_matrix
from cornercase.reduction._medoids import find_k_medoids

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from helpers.synthetic_clusters import ASPECTS_OF, SETS, UNSEEN, WITHOUT, Floats, Ints, Maker

METHODS = ("dbscan", "hdbscan", "scikit-learn", "k-medoids", "tslearn")
MANY = 3000

Row = dict[str, Any]


def labels_by(method: str, series: list[Floats], distances: Floats, kinds: int) -> Ints:
    """Cluster by one method."""
    if method == "scikit-learn":
        return np.asarray(HDBSCAN(metric="precomputed", copy=True).fit_predict(distances))
    if method == "k-medoids":
        return np.asarray(distances[:, find_k_medoids(distances, kinds)].argmin(axis=1))
    if method == "tslearn":
        from tslearn.clustering import TimeSeriesKMeans
        from tslearn.utils import to_time_series_dataset

        model = TimeSeriesKMeans(kinds, metric="dtw", random_state=0)
        return np.asarray(model.fit_predict(to_time_series_dataset(series)))
    return cluster(distances, method="dbscan" if method == "dbscan" else "hdbscan").labels


def judged(maker: Maker, count: int, seed: int, aspect: str, methods: tuple[str, ...]) -> Iterator[tuple[str, Row]]:
    """Figures of one draw, by method."""
    recordings, truth = maker(count, np.random.default_rng(seed))
    chosen = ASPECTS.create(aspect)
    series = [chosen.series(one, "Ego", "Other") for one in recordings]
    distances = distance_matrix(series)
    for method in methods:
        begun = time.process_time()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            labels = labels_by(method, series, distances, int(truth.max()) + 1)
        whole = len(np.unique(labels)) == 1
        yield (
            method,
            {
                "rand": float(adjusted_rand_score(truth, labels)),
                "one": float(whole),
                "clusters": int(labels.max()) + 1,
                "seconds": time.process_time() - begun,
            },
        )


def rows_of(
    makers: Mapping[str, Maker],
    counts: Sequence[int],
    seeds: Callable[[int], range],
    methods: tuple[str, ...],
    quick: bool,
) -> Iterator[Row]:
    """A row for each set, size and aspect."""
    for name, maker in makers.items():
        for count in counts:
            # Of many, one aspect: its distances take longer than all else.
            for aspect in ASPECTS_OF[name][: 1 if quick or count == MANY else None]:
                draws: dict[str, list[Row]] = {}
                for seed in seeds(count):
                    for method, row in judged(maker, count, seed, aspect, methods):
                        draws.setdefault(method, []).append(row)
                yield {"set": name + "*" * (name in UNSEEN), "count": count, "aspect": aspect, "draws": draws}


def told(row: Row, figure: str) -> str:
    """Median and worst of all draws of each method, or their mean for shares."""
    words = []
    for draws in row["draws"].values():
        values = [one[figure] for one in draws]
        words.append(f"{np.mean(values):.2f}" if figure == "one" else f"{np.median(values):.2f} {min(values):5.2f}")
    return "".join(f"{one:>14}" for one in words)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--first", type=int, default=2)
    parser.add_argument("--draws", type=int, default=10)
    parser.add_argument("--many", type=int, default=2, metavar="N", help="draws of 3,000; 0 leaves them out")
    parser.add_argument("--methods", type=lambda text: tuple(text.split(",")), default=METHODS)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    draws, many = (1, 0) if options.quick else (options.draws, options.many)
    methods = tuple(one for one in options.methods if one != "tslearn" or importlib.util.find_spec("tslearn"))
    if len(methods) < len(options.methods):
        print("tslearn: not installed")
    rows: list[Row] = []

    def seeds(count: int) -> range:
        return range(options.first, options.first + 2 * (many if count == MANY else draws), 2)

    sizes = [60, 300, MANY] if many else [60, 300]
    for title, makers, used, figure in (
        ("kinds: adjusted Rand index", SETS, methods, "rand"),
        (
            "no kinds: share of draws of one kind",
            WITHOUT,
            tuple(one for one in methods if one not in ("k-medoids", "tslearn")),
            "one",
        ),
    ):
        print(f"\n{title}\n{'set':20}{'n':>5}  {'aspect':16}" + "".join(f"{one:>14}" for one in used))
        for row in rows_of(makers, sizes, seeds, used, options.quick):
            rows.append(row)
            print(f"{row['set']:20}{row['count']:5}  {row['aspect']:16}{told(row, figure)}", flush=True)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
