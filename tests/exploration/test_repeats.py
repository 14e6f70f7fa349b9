"""Scenarios that are run several times each."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cornercase._common.errors import InputError, SimulationError
from cornercase.exploration._explore import explore_config
from cornercase.exploration._explorer import ScenarioExplorer
from cornercase.exploration._paper_examples import paper_experiment_config
from cornercase.optimizers import OPTIMIZERS
from cornercase.report import summarize, write_report
from cornercase.study import StudyFile
from helpers.fake_simulators import NoisySimulator
from helpers.synthetic_study import about


def test_of_repeated_runs_the_median_is_stored_and_the_spread_of_all(tmp_path):
    one, simulator = paper_experiment_config("t-intersection", budget=6, seed=1), NoisySimulator()
    meta = about(one.logical.space, "distance", repeats=3, other="C", seed=1)
    optimizer = OPTIMIZERS.create("sobol").start(one.logical.space, 1)
    with StudyFile.create(tmp_path / "s.db", meta) as study:
        ScenarioExplorer(replace(one, metrics=("distance",), budget=6, repeats=3), simulator, optimizer, study).run()
        runs = [[k for k in simulator.given[i : i + 3] if k is not None] for i in range(0, 18, 3)]
        expected = [sorted(run)[(len(run) - 1) // 2] for run in runs]
        assert min(map(len, runs)) == 2
        np.testing.assert_allclose(study.scores("distance"), expected)
        spread = study.score_range("distance")
        assert spread is not None
        np.testing.assert_allclose(spread, [[min(run), max(run)] for run in runs])
        for row, score in zip(study.finished_rows(), expected, strict=True):
            assert study.recording(row.id).x[1, 0] == pytest.approx(score)
            assert study.course(row.id, "distance")[0] == pytest.approx(score)
        said = summarize(study).metrics["distance"]
        assert said.repeat_spread is not None
        assert said.repeat_spread[1] == pytest.approx(max(max(run) - min(run) for run in runs))
        write_report(study, tmp_path / "r.html")
        assert "Each was run 3 times" in (tmp_path / "r.html").read_text()
        study.export(tmp_path / "csv")
        head = (tmp_path / "csv" / "scenarios.csv").read_text().splitlines()[0]
        assert "lowest_distance,highest_distance" in head


def test_a_scenario_fails_only_when_all_its_runs_do(tmp_path):
    class Failing(NoisySimulator):
        def run(self, concretes):
            for number, run in enumerate(super().run(concretes)):
                yield SimulationError(f"run {number}") if number < 3 else run

    one = paper_experiment_config("t-intersection", budget=2, seed=1)
    meta = about(one.logical.space, "distance", repeats=3, other="C", seed=1)
    optimizer = OPTIMIZERS.create("sobol").start(one.logical.space, 1)
    with StudyFile.create(tmp_path / "s.db", meta) as study:
        ScenarioExplorer(replace(one, metrics=("distance",), budget=2, repeats=3), Failing(), optimizer, study).run()
        assert [row.state for row in study.rows()] == ["failed", "done"]
        assert study.failed_rows()[0].error == "run 0"


def test_a_study_of_repeats_is_not_gone_on_with_otherwise(tmp_path):
    one = replace(paper_experiment_config("t-intersection", budget=2, seed=1), optimizer="sobol", repeats=2)
    explore_config(one, tmp_path / "s.db")
    with pytest.raises(InputError, match="another number of repeats"):
        explore_config(replace(one, repeats=3), tmp_path / "s.db")
    with StudyFile.open(tmp_path / "s.db", readonly=False) as study:
        # The builtin simulator gives the same each time.
        spread = study.score_range("ttc")
        assert spread is not None
        np.testing.assert_array_equal(*spread.T)
