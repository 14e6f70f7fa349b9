"""What the paper leaves open, asked of the default reconstructions: do reduced sets cover, do clusters stay.

What is predicted of the space is compared with 2,000 random scenarios.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
from benchmarks.replication.family import DEFAULTS, RUNS
from benchmarks.replication.verdicts import Cell, replace_between, told
from sklearn.metrics import adjusted_rand_score

from cornercase import SimulationError
from cornercase.clustering import ASPECTS, analyze, cluster, read_distances
from cornercase.clustering._series import read_series
from cornercase.drivers._resolve import driver_by_name
from cornercase.dtw import distances_to
from cornercase.exploration._explore import explore_config
from cornercase.metrics import METRICS
from cornercase.reduction import reduce
from cornercase.reduction._critical_clusters import find_critical_clusters
from cornercase.reduction._medoids import find_k_medoids
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import Builtin
from cornercase.study import StudyFile

Floats = npt.NDArray[np.float64]
Answers = dict[tuple[str, str], list[Cell]]
"""By scenario and question: figures and answer for each seed."""

COVERS: Final = "a tenth leaves a smaller largest gap and mean of others than random choices"
MEDOIDS: Final = "the same in the critical clusters, than k-medoids"
ORDER: Final = "another order gives the same clusters"
MORE: Final = "adding the last 10 % of the scenarios gives the same clusters"
PREDICTED: Final = "a critical scenario of the space is as likely unlike all kept ones as predicted"
QUESTIONS: Final = {
    COVERS: ("of 100 random choices", "at least 95"),
    MEDOIDS: ("distance over that of k-medoids", "at most 1"),
    ORDER: ("adjusted Rand", "at least 0.9"),
    MORE: ("adjusted Rand", "at least 0.9"),
    PREDICTED: ("per cent above the interval (below: negative)", "within 1"),
}
"""Each with what its figures are, and their limit."""
BEGIN, END = "<!-- open questions: begin -->", "<!-- open questions: end -->"


class Experiment:
    """One explored, clustered and reduced study, and what is asked of it."""

    def __init__(self, path: Path, scenario: Path) -> None:
        with StudyFile.open(path, readonly=False) as study:
            self.found = analyze(study)
            self.distances = {name: read_distances(study, name) for name in self.found}
            self.reduced = reduce(study, path.with_suffix(""), scenario=scenario)
            self.critical = find_critical_clusters(study, self.found[self.reduced.by])
            self.unlike = self._unlike(study, scenario)

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

    def answers(self) -> Iterator[tuple[str, dict[str, float], bool]]:
        """Each question that can be asked of the study: figures and answer."""
        reduced, by = self.reduced, self.reduced.by
        # What chose the set does not grade it.
        judged = {name: one.held_out for name, one in reduced.coverage.items() if one.held_out is not None}
        better = {name: 100.0 * min(one.better_largest, one.better_mean) for name, one in judged.items()}
        yield COVERS, better, min(better.values()) >= 95.0
        found = self.found[by]
        members = np.isin(found.clustering.labels, self.critical)
        # Where all is one cluster, its members are all scenarios; of few, none may be in a critical cluster.
        if members.any() and (found.clustering.labels[~members] >= 0).any():
            kept, distances = found.rows_of(reduced.ids), self.distances[by]
            yield MEDOIDS, *than_k_medoids(distances[members], kept, find_k_medoids(distances, len(kept)))
        rng = np.random.default_rng(0)
        order = rng.permutation(len(found.ids))
        fewer = np.arange(round(len(found.ids) / 1.1))
        for question, rows in ((ORDER, order), (MORE, fewer)):
            same = {
                name: adjusted_rand_score(cluster(self.distances[name][np.ix_(rows, rows)]).labels, one.labels[rows])
                for name, one in self.found.items()
            }
            yield question, same, min(same.values()) >= 0.9
        predicted = {name: one.unlike for name, one in reduced.critical.items() if one.unlike}
        above = {
            name: 100.0 * (max(self.unlike[name] - one.high, 0.0) + min(self.unlike[name] - one.low, 0.0))
            for name, one in predicted.items()
        }
        yield PREDICTED, above, all(abs(value) <= 1.0 for value in above.values())


def than_k_medoids(
    distances: Floats, kept: npt.NDArray[np.int64], medoids: npt.NDArray[np.int64]
) -> tuple[dict[str, float], bool]:
    """Largest and mean distance of scenarios to those kept, over those to k-medoids."""
    mine, theirs = (distances[:, some].min(axis=1) for some in (kept, medoids))
    ratios = float(mine.max() / theirs.max()), float(mine.mean() / theirs.mean())
    return dict(zip(("largest", "mean"), ratios, strict=True)), max(ratios) <= 1.0 + 1e-9


def ask_open_questions(folder: Path, seeds: Sequence[int], budget: int | None, progress: bool) -> Answers:
    """Ask them of the family's studies in a folder; what is missing is explored, and what is asked already is read."""
    answers: Answers = {}
    copies = folder / "open"
    copies.mkdir(parents=True, exist_ok=True)
    state = hashlib.sha256(Path(__file__).read_bytes()).hexdigest()
    for seed in seeds:
        for runs in RUNS:
            if DEFAULTS[runs.scenario][0] != runs.name:
                continue
            for ego in runs.egos:
                config = runs.config(ego, seed, budget, folder)
                path = folder / f"{runs.name}-{ego or 'file'}-{seed}.db"
                known = copies / f"{path.stem}.json"
                stored = json.loads(known.read_text()) if known.exists() else {}
                if stored.get("state") != state:
                    explore_config(config, path, progress=False)
                    # The family's study stays as it is.
                    copy = copies / path.name
                    shutil.copyfile(path, copy)
                    asked = Experiment(copy, config.logical.path).answers()
                    cells = {name: {"figures": figures, "holds": bool(holds)} for name, figures, holds in asked}
                    stored = {"state": state, "cells": cells}
                    known.write_text(json.dumps(stored))
                    copy.unlink()
                    shutil.rmtree(copy.with_suffix(""))
                for name, cell in stored["cells"].items():
                    answers.setdefault((f"{runs.scenario[0].upper()}{ego and ', '}{ego}", name), []).append(cell)
                if progress:
                    held = sum(cell["holds"] for cell in stored["cells"].values())
                    print(f"{path.stem}: {held} of {len(stored['cells'])} hold", flush=True)
    return answers


def table(answers: Answers) -> Iterator[str]:
    """Markdown rows: scenario, statement, and what was measured."""
    yield "| | statement | limit | measured: median (range), seeds |"
    yield "| --- | --- | --- | --- |"
    for (scenario, question), cells in sorted(answers.items(), key=lambda item: list(QUESTIONS).index(item[0][1])):
        of, limit = QUESTIONS[question]
        yield f"| {scenario} | {question} | {of}: {limit} | {told(cells)} |"


def write_table(page: Path, answers: Answers) -> None:
    """Put the table between the marks of a page."""
    replace_between(page, BEGIN, END, table(answers))
