"""Mutants of the ego's driver in studies and suites."""

from __future__ import annotations

import json
import re
import shutil

import numpy as np
import pytest

import cornercase as cc
from conftest import EXAMPLES
from cornercase._common.errors import InputError
from cornercase.drivers import generate_mutants
from cornercase.reduction import read_reduction
from cornercase.reduction._reduced_set_folder import MANIFEST
from cornercase.study import StudyFile
from cornercase.suite import analyze_mutants
from helpers.command_line import cornercase

T = EXAMPLES / "t_intersection" / "t_intersection.xosc"


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """T-intersection with 16 space-filling scenarios, run with `normal`."""
    path = tmp_path_factory.mktemp("mutants") / "study.db"
    logical = cc.LogicalScenario.read(T, T.with_suffix(".space.xosc"))
    cc.explore(logical, path, ego="Ego", other="C", metrics=["ttc"], optimizer="sobol", budget=16, seed=2)
    cc.analyze(path, ["ttc"])
    return path


@pytest.fixture(scope="module")
def exposure(study):
    return analyze_mutants(study, 15, scenario=T)


def test_a_mutant_is_exposed_where_it_collides_and_its_driver_does_not(study, exposure):
    """Each alone, by `cornercase.simulate`."""
    assert exposure.driver == "normal"
    assert exposure.mutants == generate_mutants("normal", 15)
    assert not set(exposure.mutants) & set(exposure.held_out.mutants)
    assert 0 < exposure.kills.sum() < exposure.kills.size
    with StudyFile.open(study, readonly=True) as opened:
        values = {row.id: row.values for row in opened.finished_rows()}
        collided = [bool(opened.recording(i).collisions) for i in exposure.scenarios]
    assert exposure.failed.tolist() == collided
    assert not exposure.kills[exposure.failed].any()
    rng = np.random.default_rng(0)
    exposed, not_exposed = np.argwhere(exposure.kills), np.argwhere(~exposure.kills & ~exposure.failed[:, None])
    for pairs, hits in ((exposed, True), (not_exposed, False)):
        for i, j in rng.choice(pairs, 3, replace=False):
            run = cc.simulate(T, values[exposure.scenarios[i]], drivers={"Ego": exposure.mutants[j].driver})
            assert bool(run.collisions) == hits


def test_a_requirement_says_what_a_mutant_has_to_fail(study, exposure):
    strict = analyze_mutants(study, 2, require=["no collision", "ego.speed < 9"], scenario=T)
    assert strict.requirements == ("no collision", "ego.speed < 9")
    assert strict.failed.sum() > exposure.failed.sum()


def test_mutants_choose_the_reduced_set_and_others_judge_it(study, exposure, tmp_path):
    folder = tmp_path / "reduced"
    plain = cc.reduce(study, tmp_path / "plain", size=3, scenario=T)
    reduced = cc.reduce(study, folder, size=3, kill_matrix=exposure, scenario=T)
    choice, judges = reduced.exposing, exposure.held_out
    assert choice is not None
    assert choice.held_out is not None
    assert choice.chosen_by == exposure.mutation_score(reduced.ids)
    assert choice.held_out == judges.mutation_score(reduced.ids)
    assert choice.without == judges.mutation_score(plain.ids)
    assert choice.chosen_by.killed >= exposure.mutation_score(plain.ids).killed
    first = reduced.scenarios[0]
    count = int(exposure.kills_of([first.id]).sum())
    assert (first.role, first.why[:30]) == ("exposing", f"exposes {count} of 15 mutants of normal"[:30])
    manifest = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    assert manifest["exposing"]["held_out"]["exposed"] == choice.held_out.killed
    assert manifest["scenarios"][0]["why"] == first.why
    with StudyFile.open(study, readonly=True) as opened:
        assert read_reduction(opened) == reduced
    # The suite exposes what its scenarios exposed in the study.
    result = cc.run_suite(folder, tmp_path / "run.db", mutants=15)
    assert result.kill_matrix is not None
    assert result.kill_matrix.kills.tolist() == exposure.kills_of(reduced.ids).tolist()
    assert result.to_json()["mutants"]["exposed"] == choice.chosen_by.killed
    # Where nothing is exposed, the set is that without mutants.
    rows = exposure.scenarios
    nothing = type(exposure)("normal", (), rows, exposure.failed, exposure.mutants, np.zeros_like(exposure.kills))
    assert cc.reduce(study, tmp_path / "same", size=3, kill_matrix=nothing, scenario=T).ids == plain.ids


def test_the_command_line_tells_what_is_exposed(study, tmp_path):
    reduced = cornercase(
        "reduce", study, "--size", 3, "--kill-mutants", 5, "--seed", 4, "--scenario", T, "-o", tmp_path / "r"
    )
    assert reduced.returncode == 0, reduced.stderr
    assert "of 5 other mutants of normal" in reduced.stdout
    told = cornercase("test", tmp_path / "r", "--mutants", 5, "--seed", 4, "-o", tmp_path / "run.db")
    assert "of 5 mutants of normal are exposed" in told.stdout
    assert "mutation" in told.stdout
    as_json = cornercase("test", tmp_path / "r", "--mutants", 5, "--json", "-o", tmp_path / "run.db")
    assert len(json.loads(as_json.stdout)["mutants"]["by_mutant"]) == 5


def test_where_there_can_be_no_mutants_one_sentence_says_so(study, tmp_path):
    cc.reduce(study, tmp_path / "reduced", size=3, scenario=T)
    with pytest.raises(InputError, match="builtin simulator, not 'sumo'"):
        cc.run_suite(tmp_path / "reduced", tmp_path / "run.db", simulator="sumo", mutants=5)
    with pytest.raises(InputError, match="driver cc-human has no mutants"):
        cc.run_suite(tmp_path / "reduced", tmp_path / "run.db", drivers={"Ego": "cc-human"}, mutants=5)
    with pytest.raises(InputError, match="mutants cannot be judged with a reference driver"):
        cc.run_suite(tmp_path / "reduced", tmp_path / "run.db", require=["no collision unless rss collides"], mutants=5)
    assert not (tmp_path / "run.db").exists()
    with pytest.raises(InputError, match="`kill_matrix`, `cover`: give only one of them"):
        cc.reduce(study, tmp_path / "none", cover=0.2, kill_matrix=analyze_mutants(study, 1, scenario=T), scenario=T)
    refused = cornercase("reduce", study, "--require", "ttc > 1", "-o", tmp_path / "none")
    assert (refused.returncode, refused.stdout) == (2, "")
    assert "give --kill-mutants too" in refused.stderr


def test_an_ego_without_a_driver_has_no_mutants(tmp_path):
    path = tmp_path / "study.db"
    cut_in = cc.LogicalScenario.read(EXAMPLES / "r157" / "cut_in.xosc", ranges=["gap=10:40"])
    cc.explore(cut_in, path, ego="Other", other="Ego", metrics=["ttc"], optimizer="sobol", budget=2)
    with pytest.raises(InputError, match="Mutants need a driver of Other; name one with `drivers`"):
        analyze_mutants(path, 3, scenario=EXAMPLES / "r157" / "cut_in.xosc")


def test_collisions_are_told_where_no_requirement_forbids_them(tmp_path):
    for file in (T, T.with_suffix(".xodr")):
        shutil.copy(file, tmp_path)
    run = ("test", tmp_path / T.name, "--ego", "Ego", "--other", "C", "--driver", "Ego=simple", "--mutants", 2)
    told = cornercase(*run, "-o", tmp_path / "run.db")
    assert told.returncode == 0, told.stderr
    text = " ".join(told.stdout.split())
    assert re.search(r"passed it ran for ([\d.]+) s, with a collision at \1 s", text)
    assert "No requirement was given, so all that ran have passed; --require 'no collision' forbids" in text
    assert "Without a requirement, mutants are judged by 'no collision'." in text
    assert "simple itself violates 'no collision' or fails in all scenarios, which therefore expose no mutant." in text
    judged = cornercase(*run, "--require", "no collision", "-o", tmp_path / "run.db")
    assert judged.returncode == 1
    assert "Without a requirement" not in judged.stdout
