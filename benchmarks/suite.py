"""How many mutants of a driver a suite exposes, by how its scenarios were chosen.

    python benchmarks/suite.py [--quick] [--seeds N] [--budget N] [--folder FOLDER] [--ncap FOLDER] [--json FILE]

Each logical scenario is explored by `level-set` with so many scenarios, once per seed, and analysed. All scenarios are
run with 40 mutants of the ego's driver that choose, and 40 that judge, which are another draw. Of the mutants that
judge, those count that at least one scenario exposes. Sets of 5, 10 and 20 scenarios are chosen by

- ``expose``: `reduce --kill-mutants`, by the mutants that choose;
- ``reduce``: `reduce`, as it is without mutants;
- ``medoids``: k-medoids of the distances by the first metric;
- ``archetypes``: prototypes and archetypes of the clusters, as the paper: as few for each cluster as give the size, or
  more; all where there are fewer;
- ``random``: the mean of 100 random choices.

``other draws`` is the share of the mutants that judge which a set exposes. ``other kinds`` is the same where no mutant
of their kind chose: for each kind of mutation the set is chosen by the mutants of all other kinds, and the shares are
averaged over the kinds. That a mutant counts half with each scenario more that exposes it was chosen on the other
logical scenarios and seeds that `CHOOSE` names.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import cornercase as cc
from cornercase.clustering import read_analysis, read_distances
from cornercase.drivers import generate_mutants
from cornercase.reduction._critical_clusters import find_critical_clusters
from cornercase.reduction._evaluate import load_study_data
from cornercase.reduction._medoids import find_k_medoids
from cornercase.reduction._mutant_selection import select_killing
from cornercase.reduction.selection._select import SelectionInput, SelectionRequest, select_reduced_set
from cornercase.study import StudyFile
from cornercase.suite import Requirement
from cornercase.suite._mutation_analysis import run_mutants

ROOT = Path(__file__).resolve().parents[1]
NCAP = ROOT.parent / "shared" / "reference" / "openscenario" / "ncap" / "OpenSCENARIO" / "NCAP" / "CA-FC_2026"
SIZES = (5, 10, 20)
WAYS = ("expose", "reduce", "medoids", "archetypes", "random")
CHOOSING, JUDGING = 40, 40
DRAWS = 100
# Names in benchmarks/exploration.py, explored with the seeds 101 and 102.
CHOOSE = ("t-intersection, cautious", "t-intersection, five", "x-intersection, six")

Matrix = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Case:
    """A logical scenario, and who drives its ego."""

    path: Path
    other: str
    metric: str
    critical: float
    driver: str = "normal"
    ranges: tuple[str, ...] = ()
    time_step: float = 0.05

    @property
    def logical(self) -> cc.LogicalScenario:
        """What is explored."""
        space = None if self.ranges else self.path.with_suffix(".space.xosc")
        return cc.LogicalScenario.read(self.path, space, self.ranges)


def cases(ncap: Path) -> dict[str, Case]:
    examples = ROOT / "examples"
    walking = ("Ego_speed_kph=10:60", "VRU_finalSpeed_kph=3:10", "ImpactLocation=10:90")
    return {
        "x-intersection": Case(examples / "x_intersection" / "x_intersection.xosc", "Pedestrian", "wttc", 0.5),
        "t-intersection": Case(examples / "t_intersection" / "t_intersection.xosc", "C", "ttc", 0.5),
        "cpna": Case(
            ncap / "CPNA.xosc", "VRU", "ttc", 0.75, "cautious", (*walking, "VRU_initLatDist=3:8"), time_step=0.02
        ),
        "cpnco": Case(ncap / "CPNCO.xosc", "VRU", "ttc", 0.5, "normal", walking, time_step=0.02),
    }


def explored(case: Case, path: Path, seed: int, budget: int) -> Path:
    """Study of a logical scenario, explored and analysed where it is not there yet."""
    if not path.exists():
        cc.explore(
            case.logical, path, ego="Ego", other=case.other, metrics=[case.metric], critical=case.critical,
            optimizer="level-set", budget=budget, seed=seed, time_step=case.time_step, drivers={"Ego": case.driver},
        )  # fmt: skip
    with StudyFile.open(path, readonly=False) as study:
        if case.metric not in study.analyzed_aspects():
            cc.analyze(study)
    return path


def outcomes(case: Case, study: StudyFile, path: Path, seed: int) -> tuple[Matrix, list[str]]:
    """Which scenarios expose which mutants, and what was done to these: those that choose, then those that judge."""
    drawn = generate_mutants(case.driver, CHOOSING, seed)
    drawn += tuple(one for one in generate_mutants(case.driver, 2 * JUDGING, seed + 1000) if one not in drawn)[:JUDGING]
    kinds = [one.mutation for one in drawn]
    if not path.exists():
        scenario = case.logical
        concretes = [scenario.concrete_scenario(dict(row.values)) for row in study.finished_rows()]
        known = [[Requirement.parse("no collision")]] * len(concretes)
        options = {"time_step": case.time_step, "drivers": {}}
        _, exposed = run_mutants(concretes, ("Ego", (case.other,)), (case.driver, drawn), known, options)
        np.save(path, exposed)
    return np.load(path), kinds


def share(exposed: Matrix, chosen: Sequence[int] | npt.NDArray[np.int64]) -> float:
    """Of the mutants that any scenario exposes, those that chosen ones expose; NaN where there are none."""
    possible = exposed.any(axis=0)
    return float(exposed[chosen][:, possible].any(axis=0).mean()) if possible.any() else np.nan


def over_kinds(exposed: Matrix, kinds: Sequence[str], chosen: dict[str, Sequence[int]]) -> float:
    """Mean share over the kinds of mutation, each with its own choice."""
    names = np.array(kinds)
    found = [share(exposed[:, names == kind], chosen[kind]) for kind in dict.fromkeys(kinds)]
    return float(np.nanmean(found)) if np.isfinite(found).any() else np.nan


def archetypes(material: SelectionInput, size: int) -> list[int]:
    """Prototypes and archetypes, as few for each cluster as give so many scenarios; all where there are fewer."""
    found: list[int] = []
    for each in range(1, 16):
        found = [one.index for one in select_reduced_set(material, SelectionRequest(None, None, each, "hull"))[0]]
        if len(found) >= size:
            break
    return found


def exposing(material: SelectionInput, choosing: Matrix, size: int) -> list[int]:
    """As `reduce --kill-mutants`."""
    with_mutants = replace(material, kills=choosing)
    return [one.index for one in select_reduced_set(with_mutants, SelectionRequest(size, None, None, "auto"))[0]]


def judged(path: Path, case: Case, seed: int) -> Iterator[dict[str, Any]]:
    """What each way of choosing exposes, for each size."""
    with StudyFile.open(path, readonly=True) as study:
        whole, kinds = outcomes(case, study, path.with_suffix(".npy"), seed)
        analysis, ran = read_analysis(study, case.metric), load_study_data(study)
        first = read_distances(study, case.metric)
        others = [one for name, one in ran.distances.items() if name != case.metric and len(one) == len(first)]
        material = SelectionInput(
            ran.parameter_points(analysis), [first, *others], analysis.labels, analysis.clustering.embedding,
            find_critical_clusters(study, analysis),
            np.isin(analysis.ids, np.array(list(ran.rows))[study.critical_mask()]),
        )  # fmt: skip
        place = {one: i for i, one in enumerate(ran.rows)}
    exposed = whole[[place[i] for i in analysis.ids.tolist()]]
    choosing, judging = exposed[:, :CHOOSING], exposed[:, CHOOSING:]
    chose, judges = np.array(kinds[:CHOOSING]), kinds[CHOOSING:]
    rng = np.random.default_rng(seed)
    for size in SIZES:
        sets = {
            "reduce": [
                one.index for one in select_reduced_set(material, SelectionRequest(size, None, None, "auto"))[0]
            ],
            "medoids": find_k_medoids(first, size).tolist(),
            "archetypes": archetypes(material, size),
        }
        found = {
            way: (share(judging, one), over_kinds(judging, judges, dict.fromkeys(judges, one)), len(one))
            for way, one in sets.items()
        }
        drawn = [rng.choice(len(exposed), size, replace=False) for _ in range(DRAWS)]
        by_kind = [over_kinds(judging, judges, dict.fromkeys(judges, one.tolist())) for one in drawn]
        found["random"] = (
            float(np.mean([share(judging, one) for one in drawn])), float(np.mean(by_kind)), size,
        )  # fmt: skip
        mine = exposing(material, choosing, size)
        # Where mutants expose less than the size, the rest is that of `reduce`, for each kind alike.
        blind = {kind: _blind(material, choosing[:, chose != kind], size, sets["reduce"]) for kind in set(judges)}
        found["expose"] = share(judging, mine), over_kinds(judging, judges, blind), len(mine)
        for way in WAYS:
            yield {
                "size": size, "way": way, "draws": found[way][0], "kinds": found[way][1], "kept": found[way][2],
                "mutants": JUDGING, "possible": int(judging.any(axis=0).sum()), "seed": seed,
            }  # fmt: skip


def _blind(material: SelectionInput, choosing: Matrix, size: int, others: Sequence[int]) -> Sequence[int]:
    extents = [float(one.max()) for one in material.distances]

    def apart(rows: Sequence[int]) -> npt.NDArray[np.float64]:
        scaled = [
            one[list(rows)] / max(extent, 1e-300) for one, extent in zip(material.distances, extents, strict=True)
        ]
        return np.asarray(np.max(scaled, axis=0))

    found = select_killing(choosing, apart, size)
    return [*found, *(one for one in others if one not in found)][:size]


def tell(name: str, rows: Sequence[dict[str, Any]]) -> None:
    """Print a table: means over the seeds, and how often the first way is ahead of each other one."""
    possible = float(np.mean([one["possible"] for one in rows]))
    print(f"{name}: {possible:.1f} of {JUDGING} mutants can be exposed")
    print(f"{'':14}{'size':>5}{'kept':>6}{'other draws':>13}{'not behind':>12}{'other kinds':>13}{'not behind':>12}")
    for size in SIZES:
        mine = {one["seed"]: one for one in rows if one["size"] == size and one["way"] == "expose"}
        for way in WAYS:
            its = [one for one in rows if one["size"] == size and one["way"] == way]
            line = f"{way:14}{size:5}{np.mean([one['kept'] for one in its]):6.1f}"
            for what in ("draws", "kinds"):
                values = [one[what] for one in its]
                ahead = sum(mine[one["seed"]][what] >= one[what] - 1e-12 for one in its)
                line += f"{np.nanmean(values):13.1%}" + ("" if way == "expose" else f"{ahead} of {len(its)}").rjust(12)
            print(line, flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="two seeds, 60 scenarios")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--budget", type=int, default=200)
    parser.add_argument("--only", action="append", metavar="NAME", help="one of the logical scenarios")
    parser.add_argument("--folder", type=Path, help="where studies are kept, to go on with; default: none are")
    parser.add_argument("--ncap", type=Path, default=NCAP, metavar="FOLDER", help="folder of CA-FC_2026")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    seeds, budget = (2, 60) if options.quick else (options.seeds, options.budget)
    rows = []
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        for name, case in cases(options.ncap).items():
            if options.only and name not in options.only:
                continue
            if not case.path.is_file():
                print(f"{name}: left out, as {case.path} is not there; --ncap names the folder of CA-FC_2026")
                continue
            found = []
            for seed in range(1, seeds + 1):
                path = explored(case, folder / f"{name}-{seed}-{budget}.db", seed, budget)
                found += list(judged(path, case, seed))
            tell(name, found)
            rows += [{"scenario": name, **one} for one in found]
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
