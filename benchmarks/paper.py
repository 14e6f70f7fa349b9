"""The paper's two experiments at its sizes, and its discussion statement by statement beside what was measured.

python benchmarks/paper.py [--quick] [--seed N] [--keep FOLDER] [--json FILE]

Schütt, Otten and Sax (2023), section "Discussion": scenario 1 is the X-intersection with 400 concrete scenarios,
scenario 2 the T-intersection with 300, each with a cautious, a normal and an aggressive ego. Searched by Thompson
sampling without filling, as in the paper. A statement is confirmed by a limit that stands beside the figure.

After these, what the paper leaves open is asked of the same studies: whether a reduced set of a tenth covers them, and
whether the clusters stay when scenarios are added. What is predicted of the space is compared with 2,000 random
scenarios.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import Delaunay
from scipy.stats import spearmanr
from sklearn.metrics import adjusted_rand_score, silhouette_score

from cornercase import SimulationError
from cornercase.clustering import ASPECTS, analyze, cluster, read_distances
from cornercase.clustering._series import read_series
from cornercase.drivers._resolve import driver_by_name
from cornercase.dtw import distances_to
from cornercase.evidence._sensitivity import estimate_sensitivity
from cornercase.exploration._explore import explore_config
from cornercase.exploration._paper_examples import paper_experiment_config
from cornercase.metrics import METRICS
from cornercase.metrics._ending import describe_outcome
from cornercase.reduction import reduce
from cornercase.reduction._critical_clusters import find_critical_clusters
from cornercase.reduction._medoids import find_k_medoids
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import Builtin
from cornercase.study import StudyFile
from cornercase.study._objective import Objective

Floats = npt.NDArray[np.float64]
DRIVERS = ("cautious", "normal", "aggressive")
# Width of the kernel and neighbourhood as a person may set them, as in the paper; the same for all.
BY_HAND = (1.0, 0.2)


class Experiment:
    """One explored, clustered and reduced study, and what is asked of it."""

    def __init__(self, name: str, driver: str | None, budget: int | None, seed: int, folder: Path) -> None:
        path = folder / f"{name}-{driver or 'file'}.db"
        asked = paper_experiment_config(name, budget=budget, seed=seed, driver=driver)
        explore_config(replace(asked, optimizer="bayes:filling=0"), path, progress=True)
        with StudyFile.open(path, readonly=False) as study:
            self.found = analyze(study)
            self.distances = {name: read_distances(study, name) for name in self.found}
            self.by_hand = {
                name: cluster(one, gamma=BY_HAND[0], eps=BY_HAND[1]).labels for name, one in self.distances.items()
            }
            scenario = asked.logical.scenario_file
            by_hull = reduce(
                study, folder / f"{path.stem}-paper", archetypes=15, archetypes_by="hull", scenario=scenario
            )
            self.kept = len(by_hull)
            self.reduced = reduce(study, folder / f"{path.stem}-reduced", scenario=scenario)
            self.critical = find_critical_clusters(study, self.found[self.reduced.by])
            self.unlike = self._unlike(study, scenario.path)
            rows, meta = study.finished_rows(), study.meta
            self.points = np.array([row.point for row in rows])
            self.names = study.space.names
            self.values = {n: np.array([float(row.values[n]) for row in rows]) for n in self.names}
            self.scores = {m: study.scores(m) for m in meta.metrics}
            scores = Objective.from_study_meta(meta).minimized(np.stack(list(self.scores.values()), axis=1))
            self.influence = estimate_sensitivity(study.space, self.points, scores, seed)
            recordings = [study.recording(row.id) for row in rows]
            self.ends = [describe_outcome(one, meta.ego, meta.others[0]) for one in recordings]
            self.faults = [one.fault.who if one.fault else "" for one in (
                study.digest(row.id).outcomes[0] for row in rows)]  # fmt: skip
            self.crash = np.array([any(meta.ego in hit.entities for hit in one.collisions) for one in recordings])
            self.seconds = study.elapsed_by_stage()["compare"] / len(self.found)

    def _unlike(self, study: StudyFile, scenario: Path) -> dict[str, float]:
        """Share of the critical ones among 2,000 random scenarios that are unlike every kept one."""
        meta, space = study.meta, study.space
        points = space.snap(np.random.default_rng(5).random((2000, space.dimension)))
        settings = meta.settings
        simulator = Builtin(
            **{key: settings[key] for key in ("time_step", "duration", "on_collision")},
            drivers={entity: driver_by_name(name) for entity, name in settings.get("drivers", {}).items()},
        )
        concretes = [ConcreteScenario(scenario, values) for values in space.values(points)]
        runs = []
        for run in simulator.run(concretes):
            if isinstance(run, SimulationError):
                raise run
            runs.append(run)
        metric, criterion = study.objective.metrics[0], study.criterion
        assert criterion is not None
        scores = np.array([metric.score(metric.course(one, meta.ego, meta.others[0])) for one in runs])
        critical = criterion.is_critical(np.asarray(metric.to_minimize(scores)))
        runs = [run for run, is_critical in zip(runs, critical, strict=True) if is_critical]
        rows = [row.id for row in study.finished_rows()]
        kept = [rows.index(scenario) for scenario in self.reduced.ids]
        shares = {}
        for by, found in self.reduced.critical.items():
            if by in meta.metrics:
                measured = METRICS.create(by)
                new = [measured.clip_course(measured.course(one, meta.ego, meta.others[0])) for one in runs]
            else:
                aspect = ASPECTS.create(by)
                new = [aspect.series(one, meta.ego, meta.others[0]) for one in runs]
            series = read_series(study, by)
            away = distances_to(new, [series[k] for k in kept]).min(axis=1)
            shares[by] = float((away > found.within).mean())
        return shares

    def ended(self, text: str) -> npt.NDArray[np.bool_]:
        """Scenarios that ended so."""
        return np.array([end == text for end in self.ends])

    def labels(self, by: str) -> npt.NDArray[np.int64]:
        """Cluster of each scenario."""
        return self.found[by].clustering.labels

    def explained(self, labels: npt.NDArray[np.int64], metric: str) -> float:
        """Share of the variance of a score that clusters explain."""
        scores = self.scores[metric]
        between = sum((labels == c).sum() * (scores[labels == c].mean() - scores.mean()) ** 2 for c in set(labels))
        return float(between / max(((scores - scores.mean()) ** 2).sum(), 1e-12))

    def accidents(self, labels: npt.NDArray[np.int64]) -> float:
        """How far the cluster that fits best is all accidents and nothing else (Jaccard index)."""
        if not self.crash.any():
            return 0.0
        return max(
            float(((labels == c) & self.crash).sum() / ((labels == c) | self.crash).sum()) for c in set(labels) - {-1}
        )


def diagonal(x: Experiment) -> tuple[float, npt.NDArray[np.bool_]]:
    """Correlation of both parameters among the most critical fifth, and who lies below the line through them."""
    start, wait = x.values["ego_start"], x.values["pedestrian_wait"]
    worst = np.argsort(x.scores["trajectory-distance"], kind="stable")[: len(start) // 5]
    slope, offset = np.polyfit(start[worst], wait[worst], 1)
    return float(np.corrcoef(start[worst], wait[worst])[0, 1]), wait < slope * start + offset


def border(x: Experiment, labels: npt.NDArray[np.int64]) -> float:
    """Median trajectory distance of scenarios next to one of another cluster, over that of all others."""
    used = x.points[:, [x.names.index(n) for n in ("ego_start", "pedestrian_wait")]]
    apart = np.linalg.norm(used[:, None] - used, axis=-1)
    np.fill_diagonal(apart, np.inf)
    near = np.argsort(apart, axis=1)[:, :3]
    edge = (labels[near] != labels[:, None]).any(axis=1)
    scores = x.scores["trajectory-distance"]
    return float(np.median(scores[edge]) / np.median(scores[~edge])) if edge.any() else np.inf


def steepness(t: Experiment) -> dict[str, float]:
    """How far accidents and the rest are apart in each kernel space (silhouette)."""
    if not 1 < t.crash.sum() < len(t.crash) - 1:
        return {}
    return {by: float(silhouette_score(one.clustering.embedding, t.crash)) for by, one in t.found.items()}


def outside(t: Experiment) -> float:
    """Share of what lies in the convex hull of all accidents in the parameter space and is none."""
    if t.crash.sum() < 5:
        return 0.0
    inside = Delaunay(t.points[t.crash]).find_simplex(t.points) >= 0
    return float((inside & ~t.crash).sum() / inside.sum())


def scenario_1(x: Experiment) -> list[tuple[str, str, bool]]:
    total = dict(zip(x.influence.names, x.influence.total, strict=True))
    correlation, below = diagonal(x)
    same = float(spearmanr(x.scores["wttc"], x.scores["trajectory-distance"]).statistic)
    after, before = x.ended("Pedestrian first"), x.ended("Ego first")
    sides = [float((side & kind).sum() / max((side & (after | before)).sum(), 1)) for side, kind in
             ((below, after), (~below, before))]  # fmt: skip
    divided = [
        row
        for way, labels in (
            ("", {by: x.labels(by) for by in x.found}),
            (", gamma {:g} and eps {:g}".format(*BY_HAND), x.by_hand),
        )
        for row in divided_as_the_paper_does(x, way, labels)
    ]
    return [
        ("p1_speed has negligible influence", f"total sensitivity {total['p1_speed']:.4f} (limit 0.05), others"
         f" {total['ego_start']:.2f} and {total['pedestrian_wait']:.2f}", total["p1_speed"] < 0.05),
        ("all metrics show the same pattern", f"rank correlation of WTTC and trajectory distance {same:.2f} (0.7)",
         same >= 0.7),
        ("the critical scenarios lie on a diagonal", f"correlation of ego_start and pedestrian_wait {correlation:.2f}"
         " (-0.7)", correlation <= -0.7),
        ("below it the ego passes after the pedestrian", f"{sides[0]:.0%} of those without collision (90 %)",
         sides[0] >= 0.9),
        ("above it the pedestrian crosses after the ego", f"{sides[1]:.0%} of those without collision (90 %)",
         sides[1] >= 0.9),
        *divided,
        ("15 archetypes a cluster and 2 prototypes: 32 of 400", f"{x.kept} of {len(x.points)}", 28 <= x.kept <= 36),
    ]  # fmt: skip


def divided_as_the_paper_does(
    x: Experiment, way: str, labels: dict[str, npt.NDArray[np.int64]]
) -> list[tuple[str, str, bool]]:
    numbers = {by: int(one.max()) + 1 for by, one in labels.items()}
    explained = {by: x.explained(labels[by], "wttc") for by in ("trajectory-distance", "wttc")}
    near = border(x, labels["ego-trajectory"])
    return [
        (f"borders of clusters by trajectory lie where criticality is highest{way}",
         f"median trajectory distance at the border {near:.2f} of that elsewhere (0.5)", near <= 0.5),
        (f"2 clusters by trajectory{way}", f"{numbers['ego-trajectory']}", numbers["ego-trajectory"] in (2, 3)),
        (f"2 clusters by trajectory distance, high and low criticality{way}", f"{numbers['trajectory-distance']},"
         f" explaining {explained['trajectory-distance']:.0%} of the variance of WTTC (50 %)",
         numbers["trajectory-distance"] == 2 and explained["trajectory-distance"] >= 0.5),
        (f"3 clusters by WTTC: high, medium, low, along the gradient{way}", f"{numbers['wttc']}, explaining"
         f" {explained['wttc']:.0%} of the variance of WTTC (50 %)", numbers["wttc"] == 3 and explained["wttc"] >= 0.5),
    ]  # fmt: skip


def faults_in_order(t: Experiment) -> tuple[str, bool]:
    """Accidents caused by the ego, and by C, and how often the ego's are nearer to where C is first.

    That is the share of pairs of an accident of the ego and one of C, of which the one of the ego is nearer to the
    nearest scenario with C first, seen from the nearest one with the ego first (area under the curve).
    """
    who = np.array(t.faults)
    counts = {name: int((who == name).sum()) for name in ("ego", "other", "both", "undecided")}
    text = ", ".join(f"{count} {'C' if name == 'other' else name}" for name, count in counts.items())
    first, last = (t.points[t.ended(end)] for end in ("C first", "Ego first"))
    if not (counts["ego"] and counts["other"] and len(first) and len(last)):
        return f"at fault: {text}", False

    def place(rows: npt.NDArray[np.bool_]) -> Floats:
        near, far = (np.linalg.norm(t.points[rows][:, None] - ends, axis=-1).min(axis=1) for ends in (first, last))
        return np.asarray(near / np.maximum(near + far, 1e-12))

    earlier, later = place(who == "ego"), place(who == "other")
    order = float((earlier[:, None] < later).mean() + 0.5 * (earlier[:, None] == later).mean())
    return f"at fault: {text}; {order:.0%} of the pairs in this order (75 %)", order >= 0.75


def scenario_2(t: Experiment) -> list[tuple[str, str, bool]]:
    total = dict(zip(t.influence.names, t.influence.total, strict=True))
    first = {end: t.ended(end) for end in ("C first", "Ego first")}
    counts = [int(rows.sum()) for rows in (first["C first"], t.crash, first["Ego first"])]
    medians = [
        float(np.median(t.values[name][rows])) if rows.any() else np.nan
        for name in ("c_start_time", "c_routing_distance")
        for rows in first.values()
    ]
    fits = {by: t.accidents(t.labels(by)) for by in ("ego-trajectory", "distance", "traffic-quality")}
    steep = steepness(t)
    three = {
        by: round(value, 2) for by, value in steep.items() if by in ("ego-trajectory", "distance", "traffic-quality")
    }
    return [
        ("all three parameters have an influence", ", ".join(f"{n} {v:.2f}" for n, v in total.items()) + " (0.05)",
         min(total.values()) >= 0.05),
        ("three outcomes: C first, collision, ego first", ", ".join(map(str, counts)), min(counts) > 0),
        ("C first at low time and distance, the ego at high ones", f"medians {medians[0]:.1f} and {medians[1]:.1f} s,"
         f" {medians[2]:.0f} and {medians[3]:.0f} m", medians[0] < medians[1] and medians[2] < medians[3]),
        ("accidents caused by the ego near where C is first, then by C", *faults_in_order(t)),
        *(
            (f"accidents are a cluster of their own by {by}", f"Jaccard index {fit:.2f} (0.8)", fit >= 0.8)
            for by, fit in fits.items()
        ),
        ("the border is most distinct in the kernel space of traffic quality", f"silhouettes {three}",
         bool(three) and max(three, key=three.__getitem__) == "traffic-quality"),
        ("the critical cluster is not convex", f"{outside(t):.0%} of what lies in its hull is no accident (10 %)",
         outside(t) >= 0.1),
        ("the distance matrix of about 300 takes 3 hours", f"{t.seconds:.2f} s", t.seconds > 3600),
    ]  # fmt: skip


def beyond(x: Experiment) -> list[tuple[str, str, bool]]:
    """What the paper leaves open, asked of the same study."""
    reduced, by = x.reduced, x.reduced.by
    # What chose the set does not grade it.
    judged = {name: one.held_out for name, one in reduced.coverage.items() if one.held_out is not None}
    better = {name: (one.better_largest, one.better_mean) for name, one in judged.items()}
    text = ", ".join(f"{name} {largest:.0%} and {mean:.0%}" for name, (largest, mean) in better.items())
    found = x.found[by]
    kept, distances = found.rows_of(reduced.ids), x.distances[by]
    members = np.isin(found.clustering.labels, x.critical)
    mine, theirs = (distances[members][:, some].min(axis=1) for some in (kept, find_k_medoids(distances, len(kept))))
    ratios = float(mine.max() / theirs.max()), float(mine.mean() / theirs.mean())
    part = bool((found.clustering.labels[~members] >= 0).any())
    kinds = {name: (x.distances[name], one.labels) for name, one in x.found.items()}
    rng = np.random.default_rng(0)
    order = rng.permutation(len(found.ids))
    again = {n: adjusted_rand_score(cluster(d[np.ix_(order, order)]).labels, c[order]) for n, (d, c) in kinds.items()}
    fewer = np.arange(round(len(found.ids) / 1.1))
    before = {n: adjusted_rand_score(cluster(d[np.ix_(fewer, fewer)]).labels, c[fewer]) for n, (d, c) in kinds.items()}
    predicted = {name: one.unlike for name, one in reduced.critical.items() if one.unlike}
    inside = [one.low - 0.01 <= x.unlike[name] <= one.high + 0.01 for name, one in predicted.items()]
    return [
        (f"{len(reduced)} kept leave a smaller largest gap and mean of others than random choices",
         f"of 100: {text} (95 %)",
         min(map(min, better.values())) >= 0.95),
        (f"the same in the critical clusters by {by}, than k-medoids",
         f"largest {ratios[0]:.2f}, mean {ratios[1]:.2f} of theirs (1)"
         + ("" if part else ", but all is one cluster"), max(ratios) <= 1.0 + 1e-9 or not part),
        ("another order gives the same clusters", f"adjusted Rand {_listed(again)} (0.9)", min(again.values()) >= 0.9),
        ("adding the last 10 % of the scenarios gives the same clusters", f"adjusted Rand {_listed(before)} (0.9)",
         min(before.values()) >= 0.9),
        ("a critical scenario of the space is as likely unlike all kept ones as predicted", "; ".join(
            f"{name} {x.unlike[name]:.0%}, predicted {one.low:.0%} to {one.high:.0%}"
            for name, one in predicted.items()), all(inside)),
    ]  # fmt: skip


def _listed(values: dict[str, float]) -> str:
    return ", ".join(f"{name} {value:.2f}" for name, value in values.items())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="60 scenarios, and the normal ego alone")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="keep the studies; go on with those that are there")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    budget = 60 if options.quick else None
    runs: list[tuple[str, str | None, Callable[[Any], list[tuple[str, str, bool]]]]] = [
        ("x-intersection", None, scenario_1),
        *(("t-intersection", one, scenario_2) for one in (("normal",) if options.quick else DRIVERS)),
    ]
    table = []
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.keep or Path(temporary)
        for name, driver, ask in runs:
            experiment = Experiment(name, driver, budget, options.seed, folder)
            print(f"\n{name}, ego {driver or 'as in the file'}, {len(experiment.points)} scenarios")
            for of_paper, (statement, measured, confirmed) in (
                *((True, row) for row in ask(experiment)), *((False, row) for row in beyond(experiment))
            ):  # fmt: skip
                table.append({"case": name, "ego": driver, "of the paper": of_paper, "statement": statement,
                              "measured": measured, "confirmed": bool(confirmed)})  # fmt: skip
                print(f"  {'confirmed' if confirmed else 'NOT'.ljust(9)}  {statement}: {measured}", flush=True)
    for kind, of_paper in (("of the paper's", True), ("further", False)):
        asked = [bool(row["confirmed"]) for row in table if row["of the paper"] == of_paper]
        print(f"{sum(asked)} of {len(asked)} {kind} statements confirmed")
    if options.json:
        options.json.write_text(json.dumps(table, indent=1))


if __name__ == "__main__":
    main()
