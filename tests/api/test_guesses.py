"""What users guess, mistype and forget: each is done, or told in a sentence that says what to do."""

from __future__ import annotations

import io
import re
import shutil
import sqlite3
import subprocess
import sys
import warnings
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cornercase as cc
from cornercase.clustering import read_analyses, read_analysis, read_distances
from cornercase.reduction import read_reduction
from cornercase.simulators import Builtin
from helpers.command_line import SPACE, X, cornercase

# What no type checker would let through.
loose: Any = cc

pytestmark = pytest.mark.filterwarnings("ignore::cornercase.NoticeWarning")


def problem_of(scenario: Path, **more: Any) -> cc.Problem:
    given: dict[str, Any] = {"ego": "Ego", "other": "Pedestrian", "metrics": ["wttc"], "threshold": 0.2}
    return cc.Problem(cc.LogicalScenario.read(scenario, SPACE), **given | more)


@pytest.fixture(scope="module")
def problem() -> cc.Problem:
    return problem_of(X)


@pytest.fixture(scope="module")
def driven(problem, tmp_path_factory) -> cc.Study:
    simulator = Builtin(drivers={"Ego": cc.drivers.CAUTIOUS}, time_step=0.1)
    study = cc.Study.create(tmp_path_factory.mktemp("driven") / "study.db", problem, simulator, seed=1)
    study.explore("sobol", budget=12)
    return study


@pytest.fixture(scope="module")
def many(problem, tmp_path_factory) -> cc.Study:
    """A study in which several scenarios have the most critical score."""
    study = cc.Study.create(tmp_path_factory.mktemp("many") / "study.db", problem, Builtin(time_step=0.1), seed=1)
    study.explore(cc.optimizers.LevelSet(), budget=60)
    return study


def test_a_smaller_budget_says_that_it_is_a_total(problem, driven, tmp_path):
    shutil.copy(driven.path, tmp_path / "s.db")
    result = cc.Study.open(tmp_path / "s.db").explore(budget=5)
    assert result.done == 12
    assert result.reason == (
        "the budget of 5 scenarios counts these too, so no new one was run; a budget of 17 runs 5 more"
    )


@pytest.fixture
def far(tmp_path, monkeypatch) -> Path:
    """A study whose scenario lies so far away that its path would show folders."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    shutil.copytree(X.parent, tmp_path / "secret-name")
    path: Path = tmp_path / "a" / "b" / "c" / "d" / "study.db"
    path.parent.mkdir(parents=True)
    study = cc.Study.create(path, problem_of(tmp_path / "secret-name" / X.name), Builtin(drivers={"Ego": "normal"}))
    study.explore("sobol", budget=4)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    return path


def test_a_study_finds_its_scenario_from_anywhere_and_does_not_say_where_it_is(far, tmp_path):
    study = cc.Study.open(far)
    assert study.problem.scenario.path == tmp_path / "secret-name" / X.name
    # Reading the problem changes nothing in how it goes on.
    assert study.explore(budget=6).done == 6
    study.cluster("interaction")
    study.reduce(tmp_path / "reduced", size=3, by="interaction")
    study.report(tmp_path / "report.html")
    done = cornercase("show", far, "--config")
    for written in (far, *(tmp_path / "reduced").iterdir(), tmp_path / "report.html"):
        assert b"secret-name" not in written.read_bytes(), written
    assert "secret-name" not in done.stdout


@pytest.mark.skipif(sys.platform == "win32", reason="links need rights there")
def test_links_that_lead_nowhere_do_not_keep_a_study_from_its_scenario(far):
    Path("link").symlink_to("x" * 300)
    assert cc.Study.open(far).problem.scenario.path.name == X.name


def test_a_scenario_that_has_moved_or_changed_is_named(far, tmp_path):
    file = tmp_path / "secret-name" / X.name
    file.write_text(file.read_text().replace("<FileHeader ", "<!-- new --><FileHeader ", 1))
    study = cc.Study.open(far)
    with pytest.raises(cc.InputError, match=f"{file}: the file, its road or its catalogs have changed since"):
        _ = study.problem
    file.unlink()
    with pytest.raises(cc.InputError, match=r"two folders below them; name it as in Study\.open\(…, scenario=…\)"):
        _ = study.problem
    assert cc.Study.open(far, scenario=X).problem.scenario.path == X


def test_a_fingerprint_that_somebody_made_up_leads_nowhere(far, tmp_path):
    (tmp_path / "cache" / "cornercase" / "x.txt").write_text(str(X))
    with closing(sqlite3.connect(far)) as connection, connection:
        connection.execute("UPDATE meta SET value = '\"../x\"' WHERE key = 'fingerprint'")
    with pytest.raises(cc.InputError):
        _ = cc.Study.open(far).problem


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda p: Builtin(drivers={"Ego": "cautios"}), "There is no driver 'cautios'; did you mean 'cautious'?"),
        (lambda p: loose.simulators.Builtin(drivers="cautious"), "`drivers` 'cautious': give the driver of each entity, as in drivers="),
        (lambda p: Builtin(drivers={"Ego": "normal:horizn=4"}), "The driver 'normal' has no option 'horizn'"),
        (lambda p: p("builtin:driver=cautious"), "The simulator 'builtin' has no option 'driver'; its options (drivers, duration"),
        (lambda p: p(Builtin(drivers={"Ego": "my_package:Driver"})), "there is no module 'my_package'"),
        (lambda p: p(Builtin(drivers={"Egon": "normal"})), "has no entity 'Egon' to be the driven entity"),
        (lambda p: loose.optimizers.LevelSet(filling=2), "`filling` 2: give a number from 0 to 1."),
        (lambda p: loose.optimizers.LevelSet(filling=-1), "`filling` -1: give a number from 0 to 1."),
        (lambda p: loose.optimizers.Bayes(filling="x"), "`filling` 'x': give a number from 0 to 1."),
        (lambda p: loose.optimizers.Committee(candidates=0), "`candidates` 0: give a whole number of 1 or more."),
        (lambda p: loose.optimizers.Evolutionary(population=1), "`population` 1: give a whole number of 2 or more."),
        (lambda p: loose.optimizers.Optuna(Builtin()), "`sampler` Builtin(): give the name of a sampler of Optuna, one of tpe, nsga2, cmaes"),
        (lambda p: loose.compare("a.db", 3), "`new` 3: give the path of a file or folder."),
        (lambda p: problem_of(X, threshold=float("nan")), "`threshold` nan: give a finite number."),
        (lambda p: loose.LogicalScenario.read(X, ranges={"ego_start": 20}), "give two bounds, as in {'ego_start': (20, 80)}"),
        (lambda p: loose.LogicalScenario.read(X, ranges={"ego_start": (30, 30)}), "in Python, vary('ego_start', 30, 30) fixes it"),
        (lambda p: Builtin(drivers={"Ego": loose.drivers.SimpleDriver}), "SimpleDriver is a class; give an object of it, as in drivers={'Ego': SimpleDriver()}"),
        (lambda p: loose.stop.missed(5), "`bound`: 5 has to be a number above 0 and up to 1."),
        (lambda p: loose.simulate(problem_of(X).scenario), "is a LogicalScenario; give its file and the values, as in simulate(scenario.path, {"),
        (lambda p: loose.simulate(cc.ConcreteScenario(X, {"ego_start": 40.0})), "as in simulate(scenario.path, scenario.values)."),
        (lambda p: problem_of(X).scenario.concrete_scenario({"ego_strat": 3.0}), "no parameter 'ego_strat'; did you mean 'ego_start'?"),
        (lambda p: problem_of(X).scenario.concrete_scenario({"ego_start": "x"}), "the parameter ego_start is 'x', which is not a number."),
        (lambda p: loose.study.StudyFile("study.db"), "to open the study at a path, use StudyFile.open(path)."),
    ],
)  # fmt: skip
def test_a_wrong_setting_is_refused_where_it_is_given(make, says, problem, tmp_path):
    with pytest.raises(cc.InputError) as refused:
        make(lambda simulator: cc.Study.create(tmp_path / "study.db", problem, simulator))
    assert says in str(refused.value)


def test_a_suite_takes_drivers_by_entity_only(tmp_path):
    shutil.copytree(X.parent, tmp_path / "set")
    with pytest.raises(cc.InputError, match="give the driver of each entity"):
        cc.Suite.open(tmp_path / "set", ego="Ego", other="C").run(drivers="cautious")  # type: ignore[arg-type]


def test_other_settings_are_told_with_both_values_when_a_study_is_opened(problem, driven):
    for simulator, says in (
        (Builtin(drivers={"Ego": "aggressive"}, time_step=0.1), "driver of Ego: cautious in the study, aggressive given"),
        (Builtin(drivers={"Ego": "cautious"}), "time_step: 0.1 in the study, 0.05 given"),
    ):  # fmt: skip
        with pytest.raises(cc.InputError) as refused:
            cc.Study.open_or_create(driven.path, problem, simulator, seed=1)
        assert says in str(refused.value)
    same = Builtin(drivers={"Ego": "cautious"}, time_step=0.1)
    assert len(cc.Study.open_or_create(driven.path, problem, same, seed=1)) == 12
    with pytest.raises(cc.InputError) as refused:
        driven.explore(cc.optimizers.Bayes())
    assert str(refused.value) == (
        f"{driven.path}: belongs to another optimizer (sobol in the study, bayes given); create another study, or give"
        " the same options."
    )


def test_the_parameters_of_a_driver_are_a_driver(driven):
    assert driven.table()["collision"].notna().sum() < 12
    with pytest.raises(cc.InputError, match="max_deceleration"):
        Builtin(drivers={"Ego": cc.drivers.NORMAL._replace(max_deceleration=-1.0)})


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda s: s.explore(stop_when="missed<0.1"), r"Study\.explore\(\) got an .* 'stop_when'; did you mean 'stop'\?"),
        (lambda s: s.critical_set(critical=0.1), "'critical'; did you mean 'threshold'"),
        (lambda s: s.reduce("r", sizes=3), "'sizes'; did you mean 'size'"),
        (lambda s: loose.compare(s, s, critical=0.1), "'critical'; did you mean 'threshold'"),
        (lambda s: problem_of(X, critical_if="collision"), r"Problem\(\) got .* did you mean 'condition'"),
        (lambda s: loose.explore(X, "s.db", ego="Ego", other="C", metrics="wttc", threshold=1), "'critical'"),
        (lambda s: loose.explore(X, "s.db", ego="Ego", other="C", metrics="wttc", condition="collision"), "'critical_if'"),
        (lambda s: loose.estimate(s, "e.db", threshold=1), r"estimate\(\) got .* 'threshold'; did you mean 'critical'"),
        (lambda s: loose.analyze(s, threshold=1), r"analyze\(\) got .* 'threshold'; did you mean 'critical'"),
        (lambda s: loose.import_recordings("r", "s.db", threshold=1), r"import_recordings\(\) got .* did you mean 'critical'"),
        (lambda s: s.explore(callbacks=[print]), "call `explore` in a loop with a growing `budget`"),
        (lambda s: s.cluster(n_clusters=3), "a smaller `eps` splits them"),
    ],
)  # fmt: skip
def test_an_unknown_argument_says_which_one_is_meant(call, says, driven):
    with pytest.raises(TypeError, match=says):
        call(driven)


def test_a_search_that_ends_without_its_stop_rule_says_so(problem, many, tmp_path):
    shutil.copy(many.path, tmp_path / "s.db")
    goal = cc.stop.missed(0.0001)
    result = cc.Study.open(tmp_path / "s.db").explore(stop=goal)
    assert result.reason.startswith(
        "the budget of 60 scenarios is used up, and missed<0.0001 is not reached: at most "
    )  # fmt: skip
    few = cc.Study.create(tmp_path / "few.db", problem).explore("sobol", budget=2, stop=goal)
    assert few.reason.endswith("is used up, and too little is known to judge missed<0.0001")


def test_estimates_are_read_in_a_line_and_as_a_table(many):
    estimates = many.critical_set()
    scores = many.table()["wttc"]
    assert repr(estimates).startswith(
        f"<CriticalEstimates: {(scores <= 0.2).sum()} of 60 scenarios are critical (score "
    )
    assert "missed share of the critical set: " in repr(estimates)
    assert max(map(len, repr(estimates).split())) < 20
    assert estimates.critical_set is not None
    table = estimates.table()
    assert table.loc["missed share of the critical set", "fraction"] == estimates.critical_set.missed_fraction.value
    sensitivity = many.sensitivity()
    largest = sensitivity.table()["total"].idxmax()
    assert repr(sensitivity).startswith(f"<Sensitivity: total {largest} ")


def test_the_table_says_who_collides_and_the_most_critical_scenario_is_a_hard_collision(many):
    table = many.table()
    for scenario in table.index:
        hits = [one for one in many.recording(scenario).collisions if "Ego" in one.entities]
        assert (table.loc[scenario, "collision"] is not None) == bool(hits)
        assert (table.loc[scenario, "impact speed"] > 0.0) == bool(hits)
    worst = many.most_critical()
    assert len(worst) == 10
    assert worst["wttc"].is_monotonic_increasing
    tied = table[table["wttc"] == table["wttc"].min()]
    assert len(tied) > 2
    assert worst.index[0] == tied["impact speed"].idxmax()
    assert many.summary().metrics["wttc"].most_critical_id == worst.index[0]
    assert many._repr_html_().count("<td>") > 0
    with pytest.raises(cc.InputError, match="no course of the metric 'ttc'"):
        many.most_critical(metric="ttc")


class Terminal(io.StringIO):
    """An error output that a person sees."""

    def isatty(self) -> bool:
        return True


def test_a_search_shows_its_progress_where_somebody_sees_it(problem, tmp_path, monkeypatch):
    for name, output, shown in (("file", io.StringIO(), False), ("terminal", Terminal(), True)):
        monkeypatch.setattr(sys, "stderr", output)
        cc.Study.create(tmp_path / f"{name}.db", problem).explore("sobol", budget=2)
        assert ("exploring" in output.getvalue()) == shown


@pytest.mark.parametrize(
    "verb",
    [
        lambda s: s.cluster(), lambda s: s.reduce("r"), lambda s: s.report("r.html"), lambda s: s.replay(1, "r.html"),
        lambda s: s.critical_set(), lambda s: s.sensitivity(), lambda s: s.summary(), lambda s: s.estimate("e.db"),
        lambda s: s.watch(), lambda s: s.most_critical(), lambda s: s.table(),
    ],
)  # fmt: skip
def test_all_verbs_say_the_same_of_a_study_without_scenarios(verb, problem, tmp_path):
    study = cc.Study.create(tmp_path / "study.db", problem)
    with pytest.raises(cc.InputError, match=r"study\.db: no scenario was run yet; run some with `explore`\."):
        verb(study)
    assert len(study) == 0
    assert study.optimizer is None


def test_a_study_tells_notices_once(problem, tmp_path):
    study = cc.Study.create(tmp_path / "study.db", problem)
    counts = []
    for budget in (2, 4):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            study.explore("sobol", budget=budget)
        counts.append(sum("parts of the files are ignored" in str(one.message) for one in caught))
    assert counts == [1, 0]


def test_ranges_are_numbers_by_name():
    texts = cc.LogicalScenario.read(X, ranges=["ego_start=20:80", "p1_speed=5:10:1"])
    numbers = cc.LogicalScenario.read(X, ranges={"ego_start": (20, 80), "p1_speed": (5, 10, 1)})
    assert numbers.space == texts.space
    assert cc.ParameterSpace.from_ranges({"a": (0, 1)}) == cc.ParameterSpace.from_ranges(["a=0:1"])


def test_what_tab_completion_and_print_show(problem, driven):
    assert len(driven) == 12
    assert driven.optimizer == "sobol"
    assert repr(driven.simulator) == "Builtin(drivers={'Ego': CAUTIOUS}, time_step=0.1)"
    opened = cc.Study.open(driven.path)
    assert opened.simulator == Builtin(drivers={"Ego": "cautious"}, time_step=0.1)
    assert "in builtin, Ego driven by cautious; 12 scenarios run" in repr(opened)
    assert {"cautious", "normal"} <= set(cc.drivers.DRIVERS)
    assert "wttc" in repr(cc.metrics.METRICS)
    assert len(cc.optimizers.OPTIMIZERS) == len(cc.optimizers.OPTIMIZERS.names())


def test_a_comparison_says_which_drivers_ran(problem, driven, tmp_path):
    other = cc.Study.create(
        tmp_path / "o.db", problem, Builtin(drivers={"Ego": "aggressive"}, time_step=0.1), seed=1
    )  # fmt: skip
    other.explore("sobol", budget=12)
    assert "drivers Ego: cautious → aggressive" in repr(cc.compare(driven, other))


def test_what_looks_like_a_call_evaluates(driven, many, tmp_path):
    analyses = many.cluster("interaction")
    shown = [
        many.summary(),
        analyses["interaction"],
        analyses["interaction"].clustering,
        many.reduce(tmp_path / "r", size=3, by="interaction"),
    ]
    for one in shown:
        assert repr(one).startswith(f"<{type(one).__name__}"), one
        assert repr(one).endswith(">")
    from cornercase.stop import missed

    assert missed(0.05) == cc.stop.missed(0.05)


def test_words_of_other_libraries_point_to_those_of_this_one(problem, many):
    study: Any = many
    logical: Any = problem.scenario
    calls: dict[str, Any] = {
        "did you mean 'budget'?": lambda: study.explore(n_trials=5),
        "did you mean 'optimizer'?": lambda: study.explore(sampler="tpe"),
        "give `runs=Runs(workers=…)`.": lambda: study.explore(n_jobs=2),
        "give `stop=stop.seconds(…)`.": lambda: study.explore(timeout=60),
        "each metric says whether low or high scores are critical.": lambda: loose.Problem(direction="minimize"),
        "give `simulator=Builtin(drivers={…})`.": lambda: loose.Study.create("s.db", problem, drivers={}),
        "did you mean 'drivers'?": lambda: loose.simulators.Builtin(driver={}),
        "did you mean 'filling'?": lambda: loose.optimizers.LevelSet(fill=0.1),
        "did you mean 'workers'?": lambda: loose.Runs(n_jobs=2),
        "did you mean 'require'?": lambda: loose.Suite.run(required=[]),
        "did you mean 'ego'?": lambda: loose.Suite.open("r", egos="Ego"),
        "it takes none.": lambda: study.sensitivity(metric="wttc"),
        "did you mean 'step'?": lambda: logical.vary("ego_start", 1.0, 2.0, steps=1.0),
        "did you mean 'space'?": lambda: loose.LogicalScenario.read("x.xosc", spaces="y"),
    }
    for hint, call in calls.items():
        with pytest.raises(TypeError) as refused:
            call()
        assert str(refused.value).endswith(hint)
    for name in ("optimize", "best_params", "best_trials", "trials"):
        with pytest.raises(AttributeError, match=f"^'Study' object has no attribute '{name}'; "):
            getattr(study, name)
    with pytest.raises(AttributeError, match=r"has no attribute 'create_study'; use `Study\.create`"):
        _ = loose.create_study
    with pytest.raises(AttributeError, match=r"has no attribute 'nothing'$"):
        _ = study.nothing


def test_rooms_are_there_without_importing_them(driven):
    program = "import cornercase as cc; print(cc.reduction.read_reduction.__name__, len([n for n in dir(cc)]))"
    found = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    assert found.split() == ["read_reduction", str(len(dir(cc)))]
    with pytest.raises(AttributeError, match=r"use `cornercase\.compare"):
        driven.compare(driven)


def test_what_is_stored_is_read_from_a_study_or_its_path(many, tmp_path):
    study = cc.Study.open(shutil.copy(many.path, tmp_path / "s.db"), scenario=X)
    clusters = study.cluster("interaction")
    kept = study.reduce(tmp_path / "reduced", size=3)
    given: Any
    for given in (study, study.path, str(study.path)):
        reduced = read_reduction(given)
        assert reduced is not None
        assert reduced.ids == kept.ids
        assert list(read_analyses(given)) == ["interaction"]
        assert read_analysis(given, "interaction").sizes == clusters["interaction"].sizes
        assert read_distances(given, "interaction").shape == (60, 60)


@pytest.mark.parametrize("workers", ["many", 0])
def test_a_number_of_workers_that_is_none_is_refused(workers, many):
    with pytest.raises(cc.InputError, match=rf"`workers` '?{workers}'?: give a whole number of 1 or more"):
        many.cluster("wttc", workers=workers)


def test_a_front_is_refused_by_a_search_of_one_score_as_by_any_other(tmp_path):
    problem = problem_of(X, metrics=["wttc", "trajectory-distance"], pareto=True, threshold=None)
    for optimizer in (cc.optimizers.LevelSet(), cc.optimizers.Bayes()):
        with pytest.raises(cc.InputError, match=f"`pareto`: {optimizer} searches one score; use evolutionary"):
            cc.Study.create(tmp_path / "s.db", problem).explore(optimizer, budget=4)


def test_a_study_without_a_threshold_says_which_one_it_lacks(tmp_path):
    study = cc.Study.create(tmp_path / "s.db", problem_of(X, metrics=["distance"], threshold=None))
    study.explore("sobol", budget=4)
    with pytest.raises(
        cc.InputError, match="since the metric distance has no threshold of its own; give `threshold`, in m"
    ):
        study.critical_set()
    assert study.critical_set(threshold=1.0).n_run == 4


class Constant(cc.Metric):
    name, unit, lower_is_critical, cap = "constant", "m", True, 100.0

    def course(self, recording, ego, other):
        return np.ones_like(recording.time)


class Scalar(Constant):
    name = "scalar"

    def course(self, recording, ego, other):
        return 5.0


def test_scores_that_are_all_the_same_are_said_to_be(tmp_path):
    study = cc.Study.create(tmp_path / "s.db", problem_of(X, metrics=[Constant()], threshold=2.0))
    study.explore("sobol", budget=20)
    assert "too few scenarios with different scores" in repr(study.critical_set())


def test_failures_from_the_first_scenario_on_say_how_to_look_at_them(tmp_path):
    study = cc.Study.create(tmp_path / "s.db", problem_of(X, metrics=[Scalar()], threshold=2.0))
    with pytest.raises(
        cc.InputError, match=r"`runs=Runs\(max_failures=…\)` is the limit, and with 0 the search goes on"
    ):
        study.explore("sobol", budget=8)
    assert not study.path.exists()
    study.explore("sobol", budget=8, runs=cc.Runs(max_failures=0))
    assert study.table()["error"].str.contains("gave 5.0 as its course").sum() == 8


def test_a_bad_scenario_fails_alone():
    scenario = problem_of(X).scenario
    concretes = [cc.ConcreteScenario(X, values, scenario.file) for values in ({"ego_start": 40.0}, {"ego_strat": 1.0})]
    good, bad = Builtin(duration=1.0).run(concretes)
    assert isinstance(good, cc.Recording)
    assert "declares no parameter 'ego_strat'; did you mean 'ego_start'?" in str(bad)


def test_what_has_no_items_says_what_to_use(many):
    with pytest.raises(
        TypeError, match=r"create\('wttc'\) makes the metric, and get_class\('wttc'\) returns its class"
    ):
        loose.metrics.METRICS["wttc"]
    measured: Any = cc.measure(many.recording(1), "Ego", "Pedestrian", ["wttc"])
    with pytest.raises(TypeError, match=r"use scores\['wttc'\], courses\['wttc'\] or units\['wttc'\]"):
        measured["wttc"]


def test_errors_of_expressions_and_of_own_code_can_be_told_apart():
    with pytest.raises(cc.metrics.ExpressionError) as refused:
        cc.metrics.Expression.parse("ttc < 1 m")
    assert "^" in refused.value.excerpt
    assert issubclass(loose.exploration.UserCodeError, cc.InputError)


@pytest.mark.parametrize(
    ("word", "instead"),
    [("analyze", "`cluster`"), ("run", "`explore`"), ("results", "`table()`"), ("importances", "`sensitivity()`")],
)
def test_words_of_other_libraries_lead_to_the_verbs_of_a_study(driven, word, instead):
    with pytest.raises(AttributeError, match=re.escape(f"has no attribute '{word}'; use {instead}")):
        getattr(driven, word)


@pytest.mark.parametrize(("argument", "instead"), [("sampler", "`explore`"), ("load_if_exists", "open_or_create")])
def test_what_is_no_part_of_a_new_study_is_said_to_belong_elsewhere(problem, tmp_path, argument, instead):
    with pytest.raises(TypeError, match=instead):
        loose.Study.create(tmp_path / "s.db", problem, **{argument: True})
