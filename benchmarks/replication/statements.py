"""The paper's statements about its results, each with how it is measured and from where on it counts as true.

Criticality and convexity are measured over the space, not over the scenarios that were run: the search runs most of
them where they are critical, so what lies elsewhere would hardly count.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
import numpy.typing as npt
from benchmarks.replication.family import Reading
from benchmarks.replication.observed import Bools, Floats, Labels, Observed
from scipy.spatial import Delaunay
from scipy.stats import spearmanr
from sklearn.metrics import silhouette_score

from cornercase.evidence._criticality_bands import explained_variance
from cornercase.reduction._hulls import find_hull_archetypes

EGOS: Final = ("cautious", "normal", "aggressive")
SPACES: Final = ("ego-trajectory", "distance", "traffic-quality")
Figures = dict[str, float]
Measure = Callable[[Observed, Reading], tuple[Figures, bool]]
X: Final = "x-intersection"
T: Final = "t-intersection"


@dataclass(frozen=True)
class Statement:
    """A statement of the paper: its number, the scenario and the ego that it is about, and how it is measured."""

    number: str
    scenario: str
    ego: str
    says: str
    limit: str
    measure: Measure


def negligible(x: Observed, reading: Reading) -> tuple[Figures, bool]:
    return {"total sensitivity": x.total["p1_speed"]}, x.total["p1_speed"] < 0.05


def same_pattern(x: Observed, reading: Reading) -> tuple[Figures, bool]:
    same = float(spearmanr(x.scores["wttc"], x.scores["trajectory-distance"]).statistic)
    return {"rank correlation of WTTC and trajectory distance": same}, same >= 0.7


def diagonal(x: Observed) -> tuple[float, Bools]:
    """Correlation of both parameters among the most critical fifth, and who lies below the line through them."""
    start, wait = x.values["ego_start"], x.values["pedestrian_wait"]
    worst = np.argsort(x.scores["trajectory-distance"], kind="stable")[: len(start) // 5]
    slope, offset = np.polyfit(start[worst], wait[worst], 1)
    return float(np.corrcoef(start[worst], wait[worst])[0, 1]), wait < slope * start + offset


def on_a_diagonal(x: Observed, reading: Reading) -> tuple[Figures, bool]:
    correlation, _ = diagonal(x)
    return {"correlation of ego_start and pedestrian_wait": correlation}, correlation <= -0.7


def on_one_side(x: Observed, reading: Reading, *, below: bool) -> tuple[Figures, bool]:
    _, is_below = diagonal(x)
    side = is_below if below else ~is_below
    kinds = {True: x.ended("Pedestrian first"), False: x.ended("Ego first")}
    share = float((side & kinds[below]).sum() / max((side & (kinds[True] | kinds[False])).sum(), 1))
    return {"share of those without collision": share}, share >= 0.9


def border(x: Observed, labels: Labels) -> float:
    """Median trajectory distance at the borders of clusters over that elsewhere, both over the space."""
    cells = 60
    ticks = (np.arange(cells) + 0.5) / cells
    places = np.stack(np.meshgrid(ticks, ticks, indexing="ij"), axis=-1).reshape(-1, 2)
    run = x.nearest_run(places, ("ego_start", "pedestrian_wait"))
    cluster, score = labels[run].reshape(cells, cells), x.scores["trajectory-distance"][run].reshape(cells, cells)
    edge = np.zeros((cells, cells), dtype=bool)
    for axis in (0, 1):
        differs = np.diff(cluster, axis=axis) != 0
        for side in (slice(1, None), slice(None, -1)):
            edge[(side, slice(None)) if axis == 0 else (slice(None), side)] |= differs
    return float(np.median(score[edge]) / np.median(score[~edge])) if edge.any() and not edge.all() else np.inf


def borders_are_critical(x: Observed, reading: Reading) -> tuple[Figures, bool]:
    ratio = border(x, x.clustering(reading.trajectory, reading).labels)
    return {"trajectory distance at the border, over that elsewhere": ratio}, ratio <= 0.5


def by_trajectory(x: Observed, reading: Reading) -> tuple[Figures, bool]:
    count = x.clustering(reading.trajectory, reading).n_clusters
    return {"clusters": count}, count in (2, 3)


def by_criticality(x: Observed, reading: Reading, *, aspect: str, count: int) -> tuple[Figures, bool]:
    found = x.clustering(aspect, reading)
    share = explained_variance(x.scores["wttc"], found.labels)
    return {
        "clusters": found.n_clusters,
        "explained variance of WTTC": share,
    }, found.n_clusters == count and share >= 0.5


def kept(x: Observed, reading: Reading) -> tuple[Figures, bool]:
    labels = x.clustering(reading.trajectory, reading).labels
    members = [np.flatnonzero(labels == k) for k in range(int(labels.max(initial=-1)) + 1)]
    count = sum(len(find_hull_archetypes(x.points[rows], 15)) + 1 if len(rows) > 1 else 1 for rows in members)
    return {"kept": count}, 28 <= count <= 36


def all_influence(t: Observed, reading: Reading) -> tuple[Figures, bool]:
    return dict(t.total), min(t.total.values()) >= 0.05


def three_outcomes(t: Observed, reading: Reading) -> tuple[Figures, bool]:
    counts = [int(t.ended("C first").sum()), int(t.crash.sum()), int(t.ended("Ego first").sum())]
    return dict(zip(("C first", "collision", "ego first"), map(float, counts), strict=True)), min(counts) > 0


def where_they_end(t: Observed, reading: Reading) -> tuple[Figures, bool]:
    ends = {"C": t.ended("C first"), "ego": t.ended("Ego first")}
    medians = {
        f"{parameter}, {who} first": float(np.median(t.values[parameter][rows])) if rows.any() else np.nan
        for parameter in ("c_start_time", "c_routing_distance")
        for who, rows in ends.items()
    }
    low, high, near, far = medians.values()
    return medians, low < high and near < far


def in_order(t: Observed, reading: Reading) -> tuple[Figures, bool]:
    return order_of_causes(t, t.caused(reading.cause))


def order_of_causes(t: Observed, cause: npt.NDArray[np.str_]) -> tuple[Figures, bool]:
    """How often, of an accident of the ego and one of C, that of the ego is nearer to where C is first.

    Nearer means the distance to the nearest scenario with C first, seen from the nearest one with the ego first. The
    share of all pairs is the area under the curve.
    """
    rows = {"ego": cause == "ego", "C": cause == "other"}
    figures = {f"caused by {who}": float(those.sum()) for who, those in rows.items()}
    first, last = (t.points[t.ended(end)] for end in ("C first", "Ego first"))
    if not (rows["ego"].any() and rows["C"].any() and len(first) and len(last)):
        return figures, False

    near, far = (np.linalg.norm(t.points[:, None] - ends, axis=-1).min(axis=1) for ends in (first, last))
    order = _share_in_order(near / np.maximum(near + far, 1e-12), rows["ego"], rows["C"])
    by_time = _share_in_order(t.values["c_start_time"], rows["ego"], rows["C"])
    return {**figures, "pairs in this order": order, "in the order of c_start_time": by_time}, order >= 0.75


def _share_in_order(place: Floats, earlier: Bools, later: Bools) -> float:
    """Share of the pairs of one of the earlier and one of the later that are in this order."""
    one, other = place[earlier][:, None], place[later]
    return float((one < other).mean() + 0.5 * (one == other).mean())


def own_cluster(t: Observed, reading: Reading, *, aspect: str) -> tuple[Figures, bool]:
    labels = t.clustering(reading.trajectory if aspect == "ego-trajectory" else aspect, reading).labels
    clusters = [labels == k for k in range(int(labels.max(initial=-1)) + 1)]
    fit = max((float((one & t.crash).sum() / (one | t.crash).sum()) for one in clusters), default=0.0)
    fit = fit if t.crash.any() else 0.0
    return {"Jaccard index": fit}, fit >= 0.8


def most_distinct(t: Observed, reading: Reading) -> tuple[Figures, bool]:
    if not 1 < t.crash.sum() < len(t.crash) - 1:
        return {}, False
    apart = {by: float(silhouette_score(t.clustering(by, reading).embedding, t.crash)) for by in SPACES}
    return {f"silhouette, {by}": value for by, value in apart.items()}, max(apart, key=apart.__getitem__) == SPACES[-1]


def not_convex(t: Observed, reading: Reading) -> tuple[Figures, bool]:
    if t.crash.sum() < 5:
        return {}, False
    places = np.random.default_rng(0).random((4000, len(t.names)))
    inside = Delaunay(t.points[t.crash]).find_simplex(places) >= 0
    free = ~t.crash[t.nearest_run(places, t.names)]
    share = float((inside & free).sum() / max(inside.sum(), 1))
    return {"share of its hull without accident": share}, share >= 0.1


def three_hours(t: Observed, reading: Reading) -> tuple[Figures, bool]:
    if reading.interpreted:
        hours = interpreted_hours(t.series["distance"], t.stride["distance"])
    else:
        hours = t.seconds_compiled("distance", len(t.points)) / 3600.0
    return {"hours on one core": hours}, 1.0 <= hours <= 9.0


def interpreted_hours(series: list[Floats], stride: int) -> float:
    """Hours for all pairs of scenarios, projected from four pairs: the textbook's table, filled cell by cell."""
    n, cells = len(series), 0
    start = time.process_time()
    for k in range(4):
        one, other = (series[row % n].ravel() for row in (k * n // 4, k * n // 4 + n // 2))
        table = np.full((len(one) + 1, len(other) + 1), np.inf)
        table[0, 0] = 0.0
        for i in range(1, len(one) + 1):
            for j in range(1, len(other) + 1):
                cost = abs(one[i - 1] - other[j - 1])
                table[i, j] = cost + min(table[i - 1, j], table[i, j - 1], table[i - 1, j - 1])
        cells += len(one) * len(other)
    a_cell = (time.process_time() - start) / cells
    lengths = stride * np.array([len(one) for one in series], dtype=np.float64)
    pairs = float((lengths.sum() ** 2 - (lengths**2).sum()) / 2.0)
    return a_cell * pairs / 3600.0


def growth(t: Observed, reading: Reading) -> tuple[Figures, bool]:
    """How much longer 3,375 scenarios take than 300: by the pairs if each takes its time, else as measured."""
    if reading.interpreted:
        times = 3375 * 3374 / (300 * 299)
    else:
        t.seconds_compiled("distance", 10)
        small, large = (t.seconds_compiled("distance", count) for count in (len(t.points) // 4, len(t.points)))
        times = (3375.0 / 300.0) ** float(np.log(large / small) / np.log(4.0))
    return {"times as long": times}, 60.0 <= times <= 240.0


def _statements() -> Iterator[Statement]:
    of_x: list[tuple[str, str, Measure]] = [
        ("p1_speed has negligible influence", "at most 0.05", negligible),
        ("all metrics show the same pattern", "at least 0.7", same_pattern),
        ("the critical scenarios lie on a diagonal", "at most -0.7", on_a_diagonal),
        ("below it the ego passes after the pedestrian", "at least 0.9", partial(on_one_side, below=True)),
        ("above it the pedestrian crosses after the ego", "at least 0.9", partial(on_one_side, below=False)),
        ("borders of clusters by trajectory lie where criticality is highest", "at most 0.5", borders_are_critical),
        ("2 clusters by trajectory", "2 or 3", by_trajectory),
        ("2 clusters by trajectory distance, high and low criticality", "2, at least 0.5",
         partial(by_criticality, aspect="trajectory-distance", count=2)),
        ("3 clusters by WTTC: high, medium, low, along the gradient", "3, at least 0.5",
         partial(by_criticality, aspect="wttc", count=3)),
        ("15 archetypes a cluster and 2 prototypes: 32 of 400", "28 to 36", kept),
    ]  # fmt: skip
    for k, row in enumerate(of_x, 1):
        yield Statement(f"1.{k}", X, "", *row)
    of_t: list[tuple[str, str, Measure]] = [
        ("all three parameters have an influence", "at least 0.05", all_influence),
        ("three outcomes: C first, collision, ego first", "at least 1", three_outcomes),
        ("C first at low time and distance, the ego at high ones", "in this order", where_they_end),
        ("accidents caused by the ego near where C is first, then by C", "at least 0.75", in_order),
        *((f"accidents are a cluster of their own by {aspect}", "at least 0.8", partial(own_cluster, aspect=aspect))
          for aspect in SPACES),
        ("the border is most distinct in the kernel space of traffic quality", "its is highest", most_distinct),
        ("the critical cluster is not convex", "at least 0.1", not_convex),
        ("the distance matrix of about 300 takes 3 hours", "1 to 9", three_hours),
    ]  # fmt: skip
    for ego in EGOS:
        for k, row in enumerate(of_t, 1):
            yield Statement(f"2.{k}{ego[0]}", T, ego, *row)
    yield Statement(
        "2.11n", T, "normal", "15 days for 3,375 scenarios, if 300 take 3 hours: 120 times", "60 to 240", growth
    )


STATEMENTS: Final[Mapping[str, Statement]] = {one.number: one for one in _statements()}
"""All 41, by number."""
