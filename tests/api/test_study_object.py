"""The study with verbs: what a user does from a file to a report, and what is refused."""

from __future__ import annotations

import re
import shutil
import signal
from inspect import signature
from pathlib import Path
from typing import Any, cast

import numpy as np
import pandas as pd
import pytest

import cornercase as cc
from cornercase.drivers import SimpleDriver
from cornercase.metrics import METRICS
from cornercase.recordings import Recording
from cornercase.simulators import Builtin
from cornercase.study import StudyFile
from helpers.command_line import SPACE, X, cornercase

pytestmark = pytest.mark.filterwarnings("ignore::cornercase.NoticeWarning")

VERBS = ("explore", "cluster", "reduce", "report", "watch", "replay", "estimate")
READS = (
    "table",
    "most_critical",
    "pareto_front",
    "recording",
    "course",
    "critical_set",
    "sensitivity",
    "summary",
    "export",
)


@pytest.fixture(scope="module")
def problem() -> cc.Problem:
    scenario = cc.LogicalScenario.read(X, SPACE)
    return cc.Problem(scenario, ego="Ego", other="Pedestrian", metrics=["wttc", "distance"], threshold=0.2)


@pytest.fixture(scope="module")
def explored(problem, tmp_path_factory) -> cc.Study:
    study = cc.Study.create(tmp_path_factory.mktemp("explored") / "study.db", problem, seed=1)
    study.explore("sobol", budget=24)
    study.cluster(by=["interaction", "wttc"])
    return study


def test_tab_completion_shows_verbs_and_what_is_read(explored):
    shown = {name for name in dir(explored) if not name.startswith("_")}
    assert shown == {
        *VERBS,
        *READS,
        "create",
        "open",
        "open_or_create",
        "optimizer",
        "path",
        "problem",
        "seed",
        "simulator",
    }


@pytest.mark.parametrize("method", [getattr(cc.Study, name) for name in (*VERBS, *READS)] + [cc.Suite.run])
def test_a_verb_has_at_most_twelve_parameters(method):
    assert len(signature(method).parameters) - 1 <= 12


@pytest.mark.parametrize(
    ("verb", "function"),
    [
        (cc.Study.cluster, cc.analyze), (cc.Study.reduce, cc.reduce), (cc.Study.report, cc.write_report),
        (cc.Study.watch, cc.watch), (cc.Study.replay, cc.replay), (cc.Study.estimate, cc.estimate),
        (cc.Study.summary, cc.summarize), (cc.Suite.run, cc.run_suite),
    ],
)  # fmt: skip
def test_a_verb_has_the_defaults_of_the_function_that_it_calls(verb, function):
    defaults = [
        {name: item.default for name, item in signature(shown).parameters.items() if item.default is not item.empty}
        for shown in (verb, function)
    ]
    # None stands for the function's own default.
    same = {name for name in defaults[0].keys() & defaults[1].keys() if defaults[0][name] is not None}
    assert {name: defaults[0][name] for name in same} == {name: defaults[1][name] for name in same}
    assert "progress" in same or verb in (cc.Study.watch, cc.Study.summary)


def test_creating_checks_everything_and_writes_nothing(problem, tmp_path):
    path = tmp_path / "study.db"
    study = cc.Study.create(path, problem, seed=3)
    assert not path.exists()
    assert "no scenario was run yet" in repr(study)
    assert "no scenario was run yet" in study._repr_html_()
    with pytest.raises(cc.InputError, match="no scenario was run yet; run some with `explore`"):
        study.table()
    with pytest.raises(cc.InputError, match="There is no simulator 'bultin'"):
        cc.Study.create(path, problem, "bultin")
    with pytest.raises(cc.InputError, match="`seed`"):
        cc.Study.create(path, problem, seed=-1)
    with pytest.raises(cc.InputError, match="`problem`: give a Problem, not a str"):
        cc.Study.create(path, cast("Any", "x.xosc"))
    assert list(tmp_path.iterdir()) == []


def test_a_study_goes_on_by_the_same_call_and_keeps_its_settings(problem, explored, tmp_path):
    path = shutil.copy(explored.path, tmp_path / "study.db")
    with pytest.raises(cc.InputError, match="exists already; continue it with `Study"):
        cc.Study.create(path, problem)
    study = cc.Study.open_or_create(path, problem, seed=1)
    assert study.explore().done == 24
    # Optimizer, batch and seed are those of the file.
    assert cc.Study.open(path).explore(budget=30).done == 30
    whole = cc.Study.create(tmp_path / "whole.db", problem, seed=1)
    whole.explore("sobol", budget=30)
    pd.testing.assert_frame_equal(whole.table()[["ego_start", "wttc"]], study.table()[["ego_start", "wttc"]])


def test_another_problem_is_refused_when_the_study_is_opened(problem, explored):
    for other, seed, message in (
        (cc.Problem(problem.scenario, "Ego", "C", ["wttc", "distance"], 0.2), 1, "metrics against another entity"),
        (problem, 2, "another seed"),
        (cc.Problem(problem.scenario, "Ego", "Pedestrian", ["wttc", "distance"], 0.3), 1, "threshold"),
    ):
        with pytest.raises(cc.InputError, match=message):
            cc.Study.open_or_create(explored.path, other, seed=seed)


def test_opening_needs_the_path_alone(problem, explored):
    study = cc.Study.open(explored.path)
    assert study.seed == 1
    assert repr(study.problem) == repr(problem)
    assert study.problem.scenario.space == problem.scenario.space
    assert study.problem.metrics == ("wttc", "distance")


def test_the_index_of_the_table_names_recordings_and_courses(explored):
    table = explored.table()
    assert table.index.tolist() == list(range(1, 25))
    for scenario in table.index[:3]:
        recording = explored.recording(scenario)
        assert isinstance(recording, Recording)
        metric = METRICS.create("wttc")
        course = metric.course(recording, "Ego", "Pedestrian")
        # As the metric gives it, without its cap.
        np.testing.assert_array_equal(explored.course(scenario), course)
        assert metric.score(course) == table.loc[scenario, "wttc"]


def test_an_export_has_the_ids_in_its_first_column(explored, tmp_path):
    explored.export(tmp_path / "tables")
    read = pd.read_csv(tmp_path / "tables" / "scenarios.csv", index_col="id")
    assert read.index.tolist() == explored.table().index.tolist()
    assert read["cluster_by_wttc"].tolist() == explored.table()["cluster by wttc"].tolist()
    assert len(list((tmp_path / "tables" / "recordings").iterdir())) == 24


def test_an_export_is_imported_again(explored, tmp_path):
    explored.export(tmp_path / "tables")
    given: dict[str, Any] = {"ego": "Ego", "other": "Pedestrian", "metrics": ["wttc"], "critical": 0.2}
    cc.import_recordings(tmp_path / "tables", tmp_path / "imported.db", **given)
    imported = cc.Study.open(tmp_path / "imported.db")
    same = ["ego_start", "pedestrian_wait", "p1_speed", "wttc", "critical", "collision"]
    pd.testing.assert_frame_equal(imported.table()[same], explored.table()[same])
    with pytest.raises(
        cc.InputError, match=r"imported recordings instead of runs .* so it has no search problem; `summary` says what"
    ):
        _ = imported.problem
    for folder, table, says in (
        ("tables/recordings", None, f"name the folder above, {tmp_path / 'tables'}, which has one"),
        (
            "tables/recordings",
            tmp_path / "tables" / "scenarios.csv",
            f"name the folder {tmp_path / 'tables'}, which has",
        ),
    ):
        with pytest.raises(cc.InputError, match=says):
            cc.import_recordings(tmp_path / folder, tmp_path / "again.db", table=table, **given)


def test_the_table_says_which_scenarios_are_critical(explored, problem, tmp_path):
    table = explored.table()
    assert table["critical"].dtype == "boolean"
    assert (table["critical"] == (table["wttc"] <= 0.2)).all()
    assert explored.most_critical(1)["critical"].all()
    # The file's own table, and what is exported, has what the file holds.
    with StudyFile.open(explored.path) as file:
        assert "critical" not in file.table()
    without = cc.Problem(problem.scenario, ego="Ego", other="Pedestrian", metrics=["distance"])
    plain = cc.Study.create(tmp_path / "plain.db", without)
    plain.explore("sobol", budget=2)
    assert "critical" not in plain.table()
    condition = cc.Problem(problem.scenario, ego="Ego", other="Pedestrian", metrics=["wttc"], condition="collision")
    collided = cc.Study.create(tmp_path / "collided.db", condition, seed=1)
    collided.explore("sobol", budget=24)
    table = collided.table()
    assert (table["critical"] == (table["collision"] == "Pedestrian")).all()


def test_clusters_have_a_table_that_adds_up(explored):
    for by, analysis in explored.summary().analyses.items():
        table = analysis.table()
        counts = explored.table()[f"cluster by {by}"].value_counts()
        assert table["size"].to_dict() == counts.to_dict()
        for cluster, example in table["example"].dropna().items():
            assert explored.table().loc[example, f"cluster by {by}"] == cluster
        members = explored.table()[explored.table()[f"cluster by {by}"] == 0]
        assert table.loc[0, "median wttc"] == pytest.approx(members["wttc"].median())


def test_reduce_says_which_scenarios_were_run_since_they_were_clustered(explored, tmp_path):
    study = cc.Study.open(shutil.copy(explored.path, tmp_path / "study.db"), scenario=X)
    study.explore(budget=34)
    since = "10 of the 34 scenarios were run after the clusters were found and are not represented; cluster again, with"
    with pytest.warns(cc.NoticeWarning, match=since):
        study.reduce(tmp_path / "reduced", size=5)
    with pytest.warns(
        cc.NoticeWarning, match="34 scenarios were asked for, but 24 are selected: no more are clustered"
    ):
        study.reduce(tmp_path / "reduced", size=34, within=1e-6)
    said = cornercase("reduce", study.path, "-o", tmp_path / "reduced", "--size", "5").stderr
    assert "10 of the 34 scenarios were run after the clusters were found" in said
    assert "cluster again, with --keep-clusters" in said
    study.cluster(by=["interaction", "wttc"], keep_clusters=True)
    assert "after the clusters were found" not in cornercase("reduce", study.path, "-o", tmp_path / "reduced").stderr


def test_the_critical_set_counts_the_critical_scenarios(explored):
    scores = explored.table()["wttc"]
    assert explored.critical_set().n_critical == (scores <= 0.2).sum()
    loose = explored.critical_set(threshold=1.0)
    assert loose.n_critical == (scores <= 1.0).sum()
    assert loose.critical_set is not None
    assert 0.0 < loose.critical_set.critical_fraction.value <= 1.0


def test_sensitivities_are_listed_by_influence(explored):
    table = explored.sensitivity().table()
    assert set(table.index) == set(explored.problem.scenario.space.names)
    assert table["total"].is_monotonic_decreasing
    assert (table["total low"] <= table["total"]).all()
    assert (table["total"] <= table["total high"]).all()


def test_what_cannot_be_estimated_is_said(problem, tmp_path):
    study = cc.Study.create(tmp_path / "few.db", problem)
    study.explore("sobol", budget=2)
    with pytest.raises(cc.InputError, match="sensitivities need 10 scenarios or more"):
        study.sensitivity()
    front = cc.Problem(problem.scenario, "Ego", "Pedestrian", ["wttc", "distance"], pareto=True)
    study = cc.Study.create(tmp_path / "front.db", front)
    study.explore("sobol", budget=2)
    for threshold in (None, 0.2):
        with pytest.raises(
            cc.InputError, match="a Pareto front was searched, which has no critical set; use `pareto_f"
        ):
            study.critical_set(threshold=threshold)


def test_the_front_of_a_study_is_a_table(problem, tmp_path):
    both = cc.Problem(problem.scenario, "Ego", "Pedestrian", ["wttc", "distance"], pareto=True)
    study = cc.Study.create(tmp_path / "front.db", both)
    study.explore(cc.optimizers.Evolutionary(population=6), budget=18)
    table = study.table()
    scores = table[["wttc", "distance"]].to_numpy()
    dominated = [any((other <= own).all() and (other < own).any() for other in scores) for own in scores]
    front = study.pareto_front()
    assert sorted(front.index) == table.index[~np.array(dominated)].tolist()
    assert front["wttc"].is_monotonic_increasing
    pd.testing.assert_frame_equal(front, table.loc[front.index])


def test_a_study_without_a_front_says_what_to_use(explored):
    with pytest.raises(cc.InputError, match="no Pareto front was searched; use `most_critical`"):
        explored.pareto_front()


def test_a_weighted_sum_is_a_column_and_ranks_the_scenarios(problem, tmp_path):
    weighted = cc.Problem(
        problem.scenario, "Ego", "Pedestrian", ["wttc", "pet"], threshold=1.0, weights={"wttc": 1.0, "pet": 5.0}
    )
    study = cc.Study.create(tmp_path / "weighted.db", weighted)
    study.explore("sobol", budget=12)
    table = study.table()
    np.testing.assert_allclose(table["objective"], table["wttc"] + 5.0 * table["pet"])
    ranked = study.most_critical()
    assert ranked["objective"].is_monotonic_increasing
    assert not ranked["wttc"].is_monotonic_increasing
    assert study.most_critical(metric="wttc")["wttc"].is_monotonic_increasing


def test_messages_name_the_verbs_and_their_arguments(problem, tmp_path):
    study = cc.Study.create(tmp_path / "study.db", problem)
    study.explore(cc.optimizers.Sobol(), budget=2)
    with pytest.raises(cc.InputError, match="run `cluster` first"):
        study.reduce(tmp_path / "reduced")
    with pytest.raises(
        cc.InputError, match=r"another optimizer \(sobol in the study, grid given\); create another study"
    ):
        study.explore(cc.optimizers.Grid())
    with pytest.raises(cc.InputError, match="`scenario` '1': give a whole number"):
        study.replay(cast("Any", "1"), tmp_path / "run.html")
    with pytest.raises(cc.InputError, match="no such study; make one with `Study"):
        cc.Study.open(tmp_path / "missing.db")
    with pytest.raises(cc.InputError, match="no such study; make one with `Study"):
        cc.compare(tmp_path / "missing.db", study)
    with pytest.raises(
        cc.InputError, match=r"^`by` ttc: .*study\.db was explored without this metric; the study has wttc, dist"
    ):
        study.cluster("ttc")


def test_functions_take_a_study(explored, tmp_path):
    assert cc.summarize(explored).n_run == 24
    page = explored.report(tmp_path / "verb.html")
    cc.write_report(explored, tmp_path / "function.html")
    assert Path(page).read_bytes() == (tmp_path / "function.html").read_bytes()
    comparison = cc.compare(explored, explored.path)
    assert comparison.studies == (explored.path, explored.path)
    assert not comparison


def test_own_drivers_are_given_again_and_code_that_a_study_names_is_not_run(problem, tmp_path):
    path = tmp_path / "own.db"
    cc.explore(
        problem.scenario, path, ego="Ego", other="Pedestrian", metrics=["wttc"], budget=2, drivers={"Ego": Own()}
    )
    study = cc.Study.open(path)
    assert len(study.table()) == 2
    with pytest.raises(cc.InputError, match=r"is not run, so give it again in the `simulator` of Study\.open\.$"):
        study.explore(budget=3)


@pytest.mark.parametrize(
    ("argument", "says"),
    [
        ({"optimizer": cc.optimizers.Sobol}, "`optimizer`: Sobol is a class; give an object of it, as in Sobol()."),
        ({"optimizer": 3}, "`optimizer` 3: give an object or its name."),
        ({"runs": cc.Runs}, "`runs`: Runs is a class; give an object of it, as in Runs()."),
        ({"runs": 4}, "`runs` 4: give them as in Runs(workers=4)."),
    ],
)
def test_what_is_no_object_is_named(argument, says, problem, tmp_path):
    with pytest.raises(cc.InputError) as refused:
        cc.Study.create(tmp_path / "study.db", problem).explore(**argument)
    assert str(refused.value) == says


def test_what_is_no_simulator_and_no_driver_is_named(problem, tmp_path):
    with pytest.raises(cc.InputError, match="`simulator`: Builtin is a class; give an object of it"):
        cc.Study.create(tmp_path / "study.db", problem, Builtin)  # type: ignore[arg-type]
    for driver, says in (
        (3, "`drivers` Ego=3: give the name of a driver, or a driver object"),
        (Own, "`drivers` Ego: Own is a class; give an object of it, as in drivers="),
    ):
        with pytest.raises(cc.InputError, match=says):
            Builtin(drivers={"Ego": driver})  # type: ignore[dict-item]


def test_an_interrupted_search_goes_on_by_the_same_call(problem, explored, tmp_path, monkeypatch):
    study, calls = cc.Study.create(tmp_path / "study.db", problem, seed=1), []
    run = Builtin.run

    def interrupted(self, scenarios, *rest, **more):
        calls.append(len(scenarios))
        if len(calls) == 2:
            signal.raise_signal(signal.SIGINT)
        return run(self, scenarios, *rest, **more)

    monkeypatch.setattr(Builtin, "run", interrupted)
    with pytest.raises(KeyboardInterrupt, match=re.escape("Interrupted after 10 scenarios. The same call again")):
        study.explore("sobol", budget=24)
    assert (study.table()["state"] == "done").sum() == 10
    assert study.explore("sobol", budget=24).done == 24
    pd.testing.assert_series_equal(study.table()["wttc"], explored.table()["wttc"])


def test_a_study_can_be_used_as_a_context(explored):
    with cc.Study.open(explored.path) as study:
        assert len(study.table()) == 24
    # It holds no file open, so a writer gets it.
    StudyFile.open(explored.path, readonly=False).close()


class Own(SimpleDriver):
    """A driver that is no part of cornercase."""


def test_a_printed_summary_says_what_the_command_says(explored, tmp_path):
    summary = explored.summary()
    shown = cornercase("show", explored.path).stdout
    assert "Does it collide?" in str(summary)
    assert str(summary).split() == shown.split()
    assert "Does it collide?" in summary._repr_html_()
    assert str(explored.summary(threshold=0.5)).split() != shown.split()
    copy = cc.Study.open(shutil.copy(explored.path, tmp_path / "copy.db")).summary()
    (tmp_path / "copy.db").unlink()
    assert str(copy) == repr(copy)
