"""A study that is opened again: what the file keeps, what it only names, and how the user gives that again."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cornercase as cc
from cornercase.recordings import Recording
from cornercase.report._repeat_command import format_toml_study_file
from cornercase.simulators import Builtin
from cornercase.study import StudyFile
from helpers.command_line import SPACE, X

# What no type checker would let through.
loose: Any = cc.drivers

pytestmark = pytest.mark.filterwarnings("ignore::cornercase.NoticeWarning")


class OwnDriver(cc.SystemUnderTest):
    """Drives on as it is."""

    def step(self, view: Any, dt: float) -> cc.Control:
        return cc.Control(acceleration=0.0)


class OwnMetric(cc.Metric):
    """Distance, under another name."""

    name = "own-distance"
    unit = "m"
    lower_is_critical = True
    cap = 100.0

    def course(self, recording: Recording, ego: str, other: str) -> Any:
        return cc.metrics.METRICS.create("distance").course(recording, ego, other)


@pytest.fixture(scope="module")
def problem() -> cc.Problem:
    return cc.Problem(cc.LogicalScenario.read(X, SPACE), "Ego", "Pedestrian", ["wttc"], 0.2)


@pytest.fixture(scope="module")
def own(problem, tmp_path_factory) -> Path:
    """A study with a driver of the user's own."""
    path: Path = tmp_path_factory.mktemp("own") / "own.db"
    cc.Study.create(path, problem, Builtin(drivers={"Ego": OwnDriver()})).explore("sobol", budget=4)
    return path


@pytest.fixture
def named(own, tmp_path) -> Callable[[str], cc.Study]:
    """Makes a study without scenarios that names a simulator."""

    def make(simulator: str) -> cc.Study:
        with StudyFile.open(own) as file:
            meta = replace(file.meta, simulator=simulator, settings={})
        StudyFile.create(tmp_path / "named.db", meta).close()
        return cc.Study.open(tmp_path / "named.db")

    return make


def test_the_simulator_of_an_opened_study_makes_the_same_runs_in_another_one(problem, tmp_path):
    driven = Builtin(drivers={"Ego": "cautious", "C": "normal:horizon=4"}, time_step=0.1, duration=20.0)
    first = cc.Study.create(tmp_path / "first.db", problem, driven, seed=1)
    assert "in Builtin(drivers={'Ego': 'cautious', " in repr(first)
    first.explore("sobol", budget=4)
    simulator = cc.Study.open(tmp_path / "first.db").simulator
    assert simulator == driven
    second = cc.Study.create(tmp_path / "second.db", problem, simulator, seed=1)
    second.explore("sobol", budget=4)
    assert second.table().equals(first.table())


def test_what_a_study_only_names_is_asked_for(own, problem, tmp_path):
    study = cc.Study.open(own)
    for call in (lambda: study.simulator, lambda: study.explore(budget=6), lambda: study.estimate(tmp_path / "e.db")):
        with pytest.raises(
            cc.InputError, match=r"OwnDriver.*not run, so give it again in the `simulator` of Study\.open"
        ):
            call()
    again = cc.Study.open(own, Builtin(drivers={"Ego": OwnDriver()}))
    assert again.explore(budget=6).done == 6
    cc.explore(
        problem.scenario, tmp_path / "named.db", ego="Ego", other="Pedestrian", metrics="wttc", budget=2,
        optimizer="sobol", drivers={"Ego": f"{__name__}:OwnDriver"},
    )  # fmt: skip
    with pytest.raises(cc.InputError, match=r"Study\.open, as in Builtin\(drivers=\{'Ego': '.*:OwnDriver'\}\)\.$"):
        _ = cc.Study.open(tmp_path / "named.db").simulator


@pytest.mark.parametrize(
    ("simulator", "says"),
    [
        ("mine", "with the simulator 'mine', which is not installed here, or which was defined in Python code"),
        ("my_module:Mine", "with the simulator 'my_module:Mine', which is not installed here"),
        ("esmini:library=evil.so", "with 'esmini:library=evil.so', whose options are not taken from a study"),
        ("imported", "contains imported recordings"),
    ],
)
def test_a_simulator_that_only_code_can_make_is_asked_for(simulator, says, named):
    with pytest.raises(cc.InputError) as refused:
        _ = named(simulator).simulator
    assert says in str(refused.value)
    assert ("give it again as in Study.open(…, simulator=…)" in str(refused.value)) == (simulator != "imported")


def test_numbers_among_the_options_of_a_simulator_are_kept(named):
    assert named("esmini:seed=3").simulator == cc.simulators.Esmini(seed=3)


def test_an_own_metric_is_given_again_in_a_problem(problem, tmp_path):
    path = tmp_path / "metric.db"
    own_problem = cc.Problem(problem.scenario, "Ego", "Pedestrian", [OwnMetric()], 1.0)
    cc.Study.create(path, own_problem).explore("sobol", budget=2)
    with pytest.raises(
        cc.InputError, match=r"as in Study\.open_or_create\(path, Problem\(…, metrics=\[OwnMetric\(\)\]\)"
    ):
        cc.Study.open(path).explore(budget=4)
    assert cc.Study.open_or_create(path, own_problem).explore(budget=4).done == 4


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (cc.optimizers.Optuna("tpe"), "optuna:sampler=tpe"),
        ("level-set:filling=0.2", cc.optimizers.LevelSet()),
        ("level-set", "level-set:filling=0.2"),
    ],
)
def test_an_optimizer_is_the_same_however_it_is_written(first, second, problem, tmp_path):
    study = cc.Study.create(tmp_path / "study.db", problem)
    study.explore(first, budget=2)
    stored = study.optimizer
    assert study.explore(second, budget=3).done == 3
    assert study.optimizer == stored
    with pytest.raises(cc.InputError, match="another optimizer"):
        study.explore("level-set:filling=0.3", budget=4)


def test_a_suite_names_drivers_as_python_takes_them(own, tmp_path):
    study = cc.Study.open(own)
    study.cluster("interaction")
    study.reduce(tmp_path / "reduced", size=2, by="interaction")
    with pytest.raises(cc.InputError, match=r"give the driver, as in \{'Ego': 'normal'\}\.$"):
        cc.Suite.open(tmp_path / "reduced").run()
    assert cc.Suite.open(tmp_path / "reduced").run(tmp_path / "run.db", drivers={"Ego": OwnDriver()}).scenarios


def test_options_that_all_simulators_have_may_follow_the_colon(problem, tmp_path):
    study = cc.Study.create(tmp_path / "study.db", problem, "builtin:time_step=0.1")
    study.explore("sobol", budget=2)
    assert np.diff(study.recording(1).time)[0] == pytest.approx(0.1)
    assert cc.Study.open(study.path).simulator == Builtin(time_step=0.1)
    with pytest.raises(cc.InputError, match="'builtin' does not take drivers after the colon; give `drivers`"):
        cc.Study.create(tmp_path / "other.db", problem, "builtin:drivers=normal")
    with pytest.raises(cc.InputError, match="`time_step` 7"):
        cc.Study.create(tmp_path / "other.db", problem, "builtin:time_step=7")


@pytest.mark.filterwarnings("always::cornercase.NoticeWarning")
def test_notices_name_the_line_of_the_user_and_come_once(problem, tmp_path):
    study = cc.Study.create(tmp_path / "study.db", problem, Builtin(duration=2.0))
    texts = []
    for budget in (4, 8, 12):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            study.explore("sobol", budget=budget)
        assert {notice.filename for notice in caught} <= {__file__}
        texts += [str(notice.message) for notice in caught]
    assert texts
    assert len(texts) == len(set(texts))
    study.cluster("interaction")
    with pytest.warns(cc.NoticeWarning, match="were asked for") as of_reduce:
        study.reduce(tmp_path / "reduced", size=40, by="interaction")
    assert {notice.filename for notice in of_reduce} == {__file__}
    with pytest.warns(cc.NoticeWarning) as of_run:
        cc.Suite.open(tmp_path / "reduced").run()
    assert {notice.filename for notice in of_run} == {__file__}


@pytest.mark.parametrize(
    ("driver", "name"),
    [
        (cc.drivers.BehaviourDriver(cc.drivers.CAUTIOUS), "cautious"),
        (cc.drivers.DRIVERS.create("normal:horizon=4"), "normal:horizon=4.0"),
        (cc.drivers.ReferenceDriver("cc-human"), "cc-human:delay=0.75"),
        (
            cc.drivers.EquippedDriver(cc.drivers.SimpleDriver(), [cc.drivers.Radar()], cc.drivers.SingleTrack()),
            "simple + radar + single-track",
        ),
    ],
)
def test_a_driver_that_a_name_makes_goes_on_without_the_object(problem, tmp_path, driver, name):
    made = Builtin(drivers={"Ego": driver})
    assert made.settings["drivers"] == {"Ego": name}
    cc.Study.create(tmp_path / "s.db", problem, made).explore("sobol", budget=2)
    assert cc.Study.open(tmp_path / "s.db").explore(budget=3).n_finished == 3
    again = cc.Study.open(tmp_path / "s.db", Builtin(drivers={"Ego": name}))
    assert again.explore(budget=4).n_finished == 4


def test_a_driver_of_ones_own_class_has_no_name():
    class Mine(cc.drivers.BehaviourDriver):
        pass

    drivers: Any = Builtin(drivers={"Ego": Mine(cc.drivers.CAUTIOUS)}).settings["drivers"]
    assert drivers["Ego"]["driver"].endswith("Mine")


def test_other_options_of_runs_leave_the_repeats_of_a_study(problem, tmp_path):
    study = cc.Study.create(tmp_path / "s.db", problem)
    study.explore("sobol", budget=2, runs=cc.Runs(repeats=2, max_repeats=6))
    assert study.explore(budget=3, runs=cc.Runs(timeout=30.0)).n_finished == 3
    assert study.explore(budget=4, runs=cc.Runs(workers=1)).n_finished == 4


def test_a_study_whose_file_is_gone_still_shows_itself(problem, tmp_path):
    cc.Study.create(tmp_path / "s.db", problem).explore("sobol", budget=2)
    study = cc.Study.open(tmp_path / "s.db")
    (tmp_path / "s.db").rename(tmp_path / "moved.db")
    assert "there is no such study" in repr(study)
    assert "there is no such study" in study._repr_html_()


def test_a_number_of_the_file_is_not_taken_for_an_option_of_a_driver():
    with pytest.raises(cc.InputError, match="is a number of the file, but not a parameter; make it a parameter with"):
        cc.LogicalScenario.read(X, SPACE).vary("Pedestrian.initial.y", 3, 9)


def test_a_study_file_says_that_rules_which_ended_the_search_are_not_in_it(problem, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    study = cc.Study.create("s.db", problem, seed=1)
    study.explore("sobol", budget=40, batch=4, stop=cc.stop.no_improvement(1))
    assert "such as --stop-when ended it, which a study does not hold" in format_toml_study_file("s.db")
    study.explore(budget=len(study.table()))
    assert "--stop-when" not in format_toml_study_file("s.db")


def test_an_equipped_driver_is_made_of_a_driver_and_not_of_its_name():
    with pytest.raises(cc.InputError, match=r"give a driver, as in EquippedDriver\(DRIVERS.create\('cautious'\)\)"):
        loose.EquippedDriver("cautious")
