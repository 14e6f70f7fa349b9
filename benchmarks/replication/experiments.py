"""Why statements hold for no reconstruction: one cause changed at a time, in the same studies.

`EXPERIMENTS` by name: each gives rows of a table, of a scenario's figures for each seed.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
from benchmarks.replication.causes import ROADS, write_roads
from benchmarks.replication.family import READINGS, RUNS
from benchmarks.replication.observed import Floats, Observed
from benchmarks.replication.statements import SPACES, by_criticality, order_of_causes
from benchmarks.replication.verdicts import Cell, road_file, told
from scipy.ndimage import distance_transform_cdt, label
from sklearn.metrics import adjusted_mutual_info_score, silhouette_score

from cornercase.clustering._density import cluster_by_density
from cornercase.clustering._kernel_pca import KernelPca
from cornercase.exploration._explore import explore_config

Rows = Iterator[tuple[str, dict[str, float], bool]]
SPEED: Final = next(one for one in READINGS if one.name == "speed, by hand")
EPS: Final = np.round(np.arange(0.02, 0.605, 0.01), 2)
MIN_SAMPLES: Final = np.arange(3, 25)
GAMMAS: Final = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)


def settings_of_each_seed(x: Observed, _: Path) -> Rows:
    """1.8 and 1.9 with eps and min. points chosen for each seed.

    They are the centre of the largest region of eps and min. points with the paper's number of clusters: the place
    farthest from the region's border.
    """
    for number, aspect, count in (("1.8", "trajectory-distance", 2), ("1.9", "wttc", 3)):
        embedding = x.clustering(aspect, SPEED).embedding
        has_count = np.array(
            [[cluster_by_density(embedding, e, n, "dbscan").max() + 1 == count for n in MIN_SAMPLES] for e in EPS]
        )
        if not has_count.any():
            yield number, {"share of the settings": 0.0}, False
            continue
        eps, neighbours = centre_of_the_largest_region(has_count)
        chosen = {aspect: (float(EPS[eps]), int(MIN_SAMPLES[neighbours]))}
        x.clusterings.clear()
        figures, holds = by_criticality(x, replace(SPEED, settings=chosen), aspect=aspect, count=count)
        x.clusterings.clear()
        share = float(has_count.mean())
        settings = {"eps": chosen[aspect][0], "min. points": float(chosen[aspect][1]), "share of the settings": share}
        yield number, {**figures, **settings}, holds


def centre_of_the_largest_region(cells: npt.NDArray[np.bool_]) -> tuple[int, int]:
    """Return the cell farthest from the border of the largest connected region; the first of several."""
    regions, _ = label(cells)
    largest = regions == np.bincount(regions[cells]).argmax()
    inside = distance_transform_cdt(np.pad(largest, 1), metric="chessboard")[1:-1, 1:-1]
    row, column = np.unravel_index(int(inside.argmax()), inside.shape)
    return int(row), int(column)


def gammas(t: Observed, _: Path) -> Rows:
    """2.8 for several gammas; the paper's is 100."""
    for gamma in GAMMAS:
        apart = {by: float(silhouette_score(_kernel_space(t, by, gamma), t.crash)) for by in SPACES}
        yield f"γ = {gamma:g}", apart, max(apart, key=apart.__getitem__) == SPACES[-1]


def _kernel_space(t: Observed, aspect: str, gamma: float) -> Floats:
    """Return scenarios in the kernel space by a gamma for distances divided by the largest one."""
    distances = t.distances(aspect)
    scaled = distances / np.median(distances[distances > 0.0])
    return KernelPca(gamma / float(scaled.max()) ** 2, 3).fit(scaled).embedding


def rules_of_fault(t: Observed, _: Path) -> Rows:
    """2.4 by other rules of fault, and with other priorities in the road file."""
    yield "contact", *order_of_causes(t, t.caused("contact"))
    yield "motion alone", *order_of_causes(t, t.caused("motion"))
    with tempfile.TemporaryDirectory() as folder:
        for rule in ROADS:
            roads = write_roads(t.road_file, Path(folder), rule)
            name = "the side road yields" if rule == "fault" else rule
            yield name, *order_of_causes(t, t.caused(rule, roads))


def who_goes_first(t: Observed, _: Path) -> Rows:
    """How much clusters by interaction, with automatic settings, say about who goes first, and about how it ends."""
    labels = t.clustering("interaction", READINGS[0]).labels
    first = float(adjusted_mutual_info_score(t.ended("Ego first"), labels))
    ending = float(adjusted_mutual_info_score(t.ends, labels))
    clusters = float(labels.max(initial=-1) + 1)
    yield "interaction", {"AMI with whether the ego passes first": first, "with how it ends": ending,
                          "clusters": clusters}, max(first, ending) > 0.995  # fmt: skip


Experiment = tuple[Callable[[Observed, Path], Rows], tuple[str, ...], tuple[str, ...], tuple[str, ...]]
EXPERIMENTS: Final[Mapping[str, Experiment]] = {
    "settings-of-each-seed": (settings_of_each_seed, ("corner",), ("",), ("trajectory-distance", "wttc")),
    "rules-of-fault": (rules_of_fault, ("carla",), ("cautious", "normal", "aggressive"), ()),
    "gamma": (gammas, ("carla",), ("aggressive",), ("ego-trajectory", "distance", "traffic-quality")),
    "who-goes-first": (who_goes_first, ("example-x", "example-t"), ("", "normal", "aggressive"), ("interaction",)),
}
"""What is measured, of which runs, egos and aspects."""


def run_experiment(name: str, folder: Path, seeds: Sequence[int], budget: int | None) -> Iterator[str]:
    """Markdown rows: the change, and what was measured with it."""
    measure, names, egos, aspects = EXPERIMENTS[name]
    cells: dict[str, list[Cell]] = {}
    for runs in RUNS:
        for ego in runs.egos if runs.name in names else ():
            for seed in seeds if ego in egos else ():
                config = runs.config(ego, seed, budget, folder)
                path = folder / f"{runs.name}-{ego or 'file'}-{seed}.db"
                explore_config(config, path, progress=False)
                observed = Observed.read(path, seed, aspects, road_file(config))
                for row, figures, holds in measure(observed, path):
                    key = f"*{runs.name}*{ego and ', '}{ego}, {row}"
                    cells.setdefault(key, []).append({"figures": figures, "holds": bool(holds)})
    yield "| | median (range), seeds |"
    yield "| --- | --- |"
    for key, of_seeds in cells.items():
        yield f"| {key} | {told(of_seeds)} |"
