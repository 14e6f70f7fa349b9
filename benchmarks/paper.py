"""The paper's two experiments at its sizes, and its discussion statement by statement beside what was measured.

python benchmarks/paper.py [--quick] [--seed N] [--keep FOLDER] [--json FILE]
python benchmarks/paper.py --family [--seeds N] [--statement NUMBER] [--keep FOLDER] [--page FILE] [--json FILE]

Schütt, Otten and Sax (2023), section "Discussion": scenario 1 is the X-intersection with 400 concrete scenarios,
scenario 2 the T-intersection with 300, each with a cautious, a normal and an aggressive ego. Searched by Thompson
sampling without filling, as in the paper. A statement is confirmed by a limit that stands beside the figure.

After these, what the paper leaves open is asked of the same studies: whether a reduced set of a tenth covers them, and
whether the clusters stay when scenarios are added. What is predicted of the space is compared with 2,000 random
scenarios.

With --family the statements are tested for each reconstruction of `benchmarks/replication/family.py` and ten seeds, and
each gets a verdict. Studies and figures stay in the folder, so that it can go on after an interruption.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from sklearn.metrics import adjusted_rand_score

from cornercase import SimulationError
from cornercase.clustering import ASPECTS, analyze, cluster, read_distances
from cornercase.clustering._series import read_series
from cornercase.drivers._resolve import driver_by_name
from cornercase.dtw import distances_to
from cornercase.exploration._explore import explore_config
from cornercase.exploration._paper_examples import paper_experiment_config
from cornercase.metrics import METRICS
from cornercase.reduction import reduce
from cornercase.reduction._critical_clusters import find_critical_clusters
from cornercase.reduction._medoids import find_k_medoids
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import Builtin
from cornercase.study import StudyFile

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.replication.family import READINGS
from benchmarks.replication.observed import ASPECTS_OF, Observed
from benchmarks.replication.statements import EGOS, STATEMENTS
from benchmarks.replication.verdicts import (
    CONFIRMED,
    NONE,
    SOME,
    describe,
    run_family,
    table,
    verdict,
    write_table,
)

Floats = npt.NDArray[np.float64]


class Experiment:
    """One explored, clustered and reduced study, and what is asked of it."""

    def __init__(self, name: str, driver: str | None, budget: int | None, seed: int, folder: Path) -> None:
        self.path = path = folder / f"{name}-{driver or 'file'}.db"
        asked = paper_experiment_config(name, budget=budget, seed=seed, driver=driver)
        explore_config(replace(asked, optimizer="bayes:filling=0"), path, progress=True)
        with StudyFile.open(path, readonly=False) as study:
            self.found = analyze(study)
            self.ids = [row.id for row in study.finished_rows()]
            self.distances = {name: read_distances(study, name) for name in self.found}
            scenario = asked.logical.scenario_file
            self.reduced = reduce(study, folder / f"{path.stem}-reduced", scenario=scenario)
            self.critical = find_critical_clusters(study, self.found[self.reduced.by])
            self.unlike = self._unlike(study, scenario.path)

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
        # Of few scenarios none may be in a critical cluster.
        *([(f"the same in the critical clusters by {by}, than k-medoids",
            *than_k_medoids(distances[members], kept, find_k_medoids(distances, len(kept)), part))]
          if members.any() else []),
        ("another order gives the same clusters", f"adjusted Rand {_listed(again)} (0.9)", min(again.values()) >= 0.9),
        ("adding the last 10 % of the scenarios gives the same clusters", f"adjusted Rand {_listed(before)} (0.9)",
         min(before.values()) >= 0.9),
        ("a critical scenario of the space is as likely unlike all kept ones as predicted", "; ".join(
            f"{name} {x.unlike[name]:.0%}, predicted {one.low:.0%} to {one.high:.0%}"
            for name, one in predicted.items()), all(inside)),
    ]  # fmt: skip


def than_k_medoids(
    distances: Floats, kept: npt.NDArray[np.int64], medoids: npt.NDArray[np.int64], part: bool
) -> tuple[str, bool]:
    """Largest and mean distance of scenarios to those kept, over those to k-medoids."""
    mine, theirs = (distances[:, some].min(axis=1) for some in (kept, medoids))
    ratios = float(mine.max() / theirs.max()), float(mine.mean() / theirs.mean())
    text = f"largest {ratios[0]:.2f}, mean {ratios[1]:.2f} of theirs (1)" + ("" if part else ", but all is one cluster")
    return text, max(ratios) <= 1.0 + 1e-9 or not part


def _listed(values: dict[str, float]) -> str:
    return ", ".join(f"{name} {value:.2f}" for name, value in values.items())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="60 scenarios, and the normal ego alone")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="keep the studies; go on with those that are there")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--family", action="store_true", help="test the statements for each reconstruction")
    parser.add_argument("--seeds", type=int, default=10, metavar="N", help="seeds 0 to N-1 of each reconstruction")
    parser.add_argument(
        "--statement", choices=STATEMENTS, metavar="NUMBER", help="test one statement of the family only"
    )
    parser.add_argument(
        "--page", type=Path, metavar="FILE", help="write the family's tables to a page such as docs/paper.md"
    )
    options = parser.parse_args()
    budget = 60 if options.quick else None
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.keep or Path(temporary)
        if options.family:
            show_family(options, folder, budget)
        else:
            show_default(options, folder, budget)


def show_family(options: argparse.Namespace, folder: Path, budget: int | None) -> None:
    """Print the verdict of each statement, and for which reconstructions it holds."""
    numbers = list(STATEMENTS) if options.statement is None else [options.statement]
    results = run_family(folder, range(options.seeds), numbers, budget, progress=True)
    verdicts = {number: verdict(number, results) for number in numbers}
    print("\n".join(table(results)))
    counts = Counter(answer for answer, _ in verdicts.values())
    print(f"{len(numbers)} statements: " + ", ".join(f"{counts[one]} {one}" for one in (CONFIRMED, SOME, NONE)))
    if options.page:
        write_table(options.page, results)
    if options.json:
        rows = [{"number": key[0], "runs": key[1], "reading": key[2], "seeds": cells} for key, cells in results.items()]
        options.json.write_text(json.dumps({"verdicts": verdicts, "rows": rows}, indent=1))


def show_default(options: argparse.Namespace, folder: Path, budget: int | None) -> None:
    """Print the statements of the default reconstruction for one seed, and what the paper leaves open."""
    rows = []
    for name, driver in (("x-intersection", None), *(
        ("t-intersection", one) for one in (("normal",) if options.quick else EGOS)
    )):  # fmt: skip
        experiment = Experiment(name, driver, budget, options.seed, folder)
        print(f"\n{name}, ego {driver or 'as in the file'}, {len(experiment.ids)} scenarios")
        observed = Observed.read(experiment.path, options.seed, ASPECTS_OF[name])
        asked = [one for one in STATEMENTS.values() if (one.scenario, one.ego) == (name, driver or "")]
        told = [(one.says, one.measure(observed, READINGS[0])) for one in asked]
        for of_paper, (statement, measured, confirmed) in (
            *((True, (says, describe([{"figures": figures}]), holds)) for says, (figures, holds) in told),
            *((False, row) for row in beyond(experiment)),
        ):
            rows.append({"case": name, "ego": driver, "of the paper": of_paper, "statement": statement,
                         "measured": measured, "confirmed": bool(confirmed)})  # fmt: skip
            print(f"  {'confirmed' if confirmed else 'NOT'.ljust(9)}  {statement}: {measured}", flush=True)
    for kind, of_paper in (("of the paper's", True), ("further", False)):
        answers = [bool(row["confirmed"]) for row in rows if row["of the paper"] == of_paper]
        print(f"{sum(answers)} of {len(answers)} {kind} statements confirmed")
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
