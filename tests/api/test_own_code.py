"""Metrics, optimizers and drivers of a user's own class, defined in a script or a notebook and given as objects."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cornercase as cc
from conftest import at_night
from cornercase.drivers import DRIVERS
from cornercase.metrics import METRICS
from cornercase.scenario._file import ScenarioFile
from cornercase.simulators import SIMULATORS, Builtin
from cornercase.simulators.pool._simulator import WorkerSimulator
from cornercase.study import StudyFile
from helpers.command_line import SPACE, X, cornercase

pytestmark = pytest.mark.filterwarnings("ignore::cornercase.NoticeWarning")

OWN_CLASSES = """
import numpy as np
import cornercase as cc

LIMIT = 3.0

class Lazy(cc.Driver):
    def __init__(self, speed=8.0):
        self.speed = speed

    def acceleration(self, situation):
        return np.clip(self.speed - situation.speed, -LIMIT, LIMIT)

class SpeedNearby(cc.Metric):
    name, unit, lower_is_critical, cap = "speed-nearby", "m/s", False, 0.0

    def __init__(self, radius=20.0):
        self.radius = radius

    def course(self, recording, ego, other):
        gap = np.hypot(*(recording.box_center(other) - recording.box_center(ego)).T)
        return np.where(gap <= self.radius, recording.speed[recording.entity_index(ego)], np.nan)

class Walk(cc.Optimizer):
    name = "walk"

    def __init__(self, step=0.3):
        self.step = step

    def prepare(self, space, seed):
        self._dimension, self._seed, self._count = space.dimension, seed, 0

    def ask(self, n):
        return (np.random.default_rng([self._seed, self._count]).random((n, self._dimension)) + self.step) % 1.0

    def tell(self, points, scores):
        self._count += len(points)
"""
# No guard: the processes must not run this again.
SCRIPT = f"""
print("begins")
{OWN_CLASSES}
scenario = cc.LogicalScenario.read({str(X)!r}, space={str(SPACE)!r})
problem = cc.Problem(scenario, ego="Ego", other="Pedestrian", metrics=[SpeedNearby(), "wttc"], threshold=5.0)
study = cc.Study.open_or_create("study.db", problem, cc.simulators.Builtin(drivers={{"Ego": Lazy(9.0)}}), seed=1)
study.explore(Walk(step=0.2), budget=BUDGET, batch=2, runs=cc.Runs(workers=WORKERS, timeout=600.0))
print(study.table()[["speed-nearby", "wttc"]].to_numpy().tolist())
"""


@pytest.fixture(scope="module")
def own() -> dict[str, Any]:
    names: dict[str, Any] = {"__name__": "own_code"}
    exec(OWN_CLASSES, names)
    return names


@pytest.fixture
def problem(own) -> cc.Problem:
    scenario = cc.LogicalScenario.read(X, SPACE)
    return cc.Problem(scenario, ego="Ego", other="Pedestrian", metrics=[own["SpeedNearby"](), "wttc"], threshold=5.0)


@pytest.fixture
def explored(own, problem, tmp_path) -> cc.Study:
    study = cc.Study.create(tmp_path / "study.db", problem, Builtin(drivers={"Ego": own["Lazy"](9.0)}), seed=1)
    study.explore(own["Walk"](step=0.2), budget=4, batch=2)
    return study


def script(budget: int, workers: int) -> str:
    return SCRIPT.replace("BUDGET", str(budget)).replace("WORKERS", str(workers))


def run_script(text: str, folder: Path, *, is_file: bool) -> str:
    (folder / "script.py").write_text(text)
    command = [sys.executable, "script.py"] if is_file else [sys.executable, "-"]
    given = None if is_file else text
    ended = subprocess.run(command, input=given, capture_output=True, text=True, cwd=folder, timeout=600)
    assert ended.returncode == 0, ended.stderr
    return ended.stdout


@pytest.mark.parametrize("is_file", at_night([True, False], [False]))
def test_a_script_without_a_guard_runs_own_code_in_workers_and_continues(is_file, explored, tmp_path):
    scores = explored.table()[["speed-nearby", "wttc"]].to_numpy().tolist()
    folder = tmp_path / "script"
    folder.mkdir()
    assert run_script(script(2, 1), folder, is_file=is_file) == f"begins\n{scores[:2]}\n"
    # Edited and run again, as a user does.
    assert run_script(script(4, 2), folder, is_file=is_file) == f"begins\n{scores}\n"


def test_names_that_a_script_registers_are_known_in_workers(own, monkeypatch):
    for registry in (DRIVERS, SIMULATORS):
        monkeypatch.setattr(registry, "_factories", dict(registry._factories))
    DRIVERS.register("lazy", own["Lazy"])
    SIMULATORS.register("own-builtin", type("OwnBuiltin", (Builtin,), {"__module__": "own_code"}))
    alone = cc.simulate(X, {"ego_start": 40.0}, drivers={"Ego": own["Lazy"](9.0)}, duration=2.0)
    options = {"drivers": {"Ego": "lazy:speed=9"}, "duration": 2.0}
    concrete = cc.ConcreteScenario(X, {"ego_start": 40.0}, ScenarioFile.read(X))
    with WorkerSimulator("own-builtin", options) as simulator:
        (in_worker,) = simulator.run([concrete])
    assert isinstance(in_worker, cc.Recording)
    assert np.array_equal(alone.x, in_worker.x)


class Steady(cc.SystemUnderTest):
    def __init__(self, speed=5.0):
        self.speed = speed

    def step(self, view, dt):
        return self.speed - view.ego.speed


def test_a_system_under_test_that_is_registered_drives_by_its_name(monkeypatch):
    monkeypatch.setattr(DRIVERS, "_factories", dict(DRIVERS._factories))
    DRIVERS.register("steady", f"{__name__}:Steady")
    itself, named, sensing = (
        cc.simulate(X, {"ego_start": 40.0}, drivers={"Ego": driver}, duration=2.0)
        for driver in (Steady(8.0), "steady:speed=8", "steady:speed=8 + radar")
    )
    assert np.array_equal(itself.x, named.x)
    assert np.array_equal(itself.speed, sensing.speed)


def test_the_object_itself_measures(own, explored):
    metric = own["SpeedNearby"]()
    for scenario, score in explored.table()["speed-nearby"].items():
        recording = explored.recording(scenario)
        course = metric.course(recording, "Ego", "Pedestrian")
        assert score == pytest.approx(np.nanmax(np.append(course, 0.0)))
        measured = cc.measure(recording, "Ego", "Pedestrian", [metric, "wttc"])
        assert measured.scores["speed-nearby"] == pytest.approx(score)
        assert measured.units == {"speed-nearby": "m/s", "wttc": "s"}


def test_a_study_is_read_without_its_metric(explored, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    explored.cluster(by=["speed-nearby"], eps=1.0, min_samples=2)
    assert "speed-nearby" not in METRICS
    shown = cornercase("show", "study.db", "--all")
    assert (shown.returncode, shown.stderr) == (0, "")
    assert "speed-nearby\n    unit: m/s\n    critical is: high" in shown.stdout
    assert cornercase("report", "study.db", "-o", "report.html").returncode == 0
    study = cc.Study.open("study.db", scenario=X)
    assert repr(study.problem) == "<Problem 'x_intersection': Ego and Pedestrian, critical if speed-nearby >= 5 m/s>"
    assert study.summary().metrics["speed-nearby"].unit == "m/s"
    assert study.critical_set().lower_is_critical is False
    compared = cornercase("compare", "study.db", "study.db", "-o", "compare.html")
    assert compared.returncode == 0, compared.stderr
    assert "speed-nearby 0.1 m/s" in compared.stdout


def test_a_study_is_continued_with_the_same_objects_alone(own, problem, explored):
    driven = Builtin(drivers={"Ego": own["Lazy"](9.0)})
    other = cc.Problem(problem.scenario, "Ego", "Pedestrian", [own["SpeedNearby"](radius=5.0), "wttc"], 5.0)
    with pytest.raises(cc.InputError, match="belongs to other metrics"):
        cc.Study.open_or_create(explored.path, other, driven, seed=1)

    in_km_h = type("SpeedNearby", (own["SpeedNearby"],), {"unit": "km/h"})
    other = cc.Problem(problem.scenario, "Ego", "Pedestrian", [in_km_h(), "wttc"], 5.0)
    with pytest.raises(
        cc.InputError, match=r"driver of Ego: own_code:Lazy, speed=9.0 in the study, own_code:Lazy, speed=7.0"
    ):
        cc.Study.open_or_create(explored.path, problem, Builtin(drivers={"Ego": own["Lazy"](7.0)}), seed=1).explore(
            own["Walk"](step=0.2), budget=6
        )
    with pytest.raises(cc.InputError, match=r"belongs to another definition of a metric \(class, unit"):
        cc.Study.open_or_create(explored.path, other, driven, seed=1)
    again = cc.Study.open_or_create(explored.path, problem, driven, seed=1)
    with pytest.raises(cc.InputError, match=r"with the optimizer 'walk:step=0.2', which .* as in explore\(MyOptimizer"):
        again.explore(budget=6)
    with pytest.raises(cc.InputError, match="belongs to another optimizer"):
        again.explore(own["Walk"](step=0.4), budget=6)
    with pytest.raises(cc.InputError, match="belongs to another optimizer"):
        again.explore("sobol", budget=6)
    again.explore(own["Walk"](step=0.2), budget=6)
    assert len(again.table()) == 6


def test_a_study_runs_nothing_without_the_class_of_its_metric(own, explored):
    study = cc.Study.open(explored.path, Builtin(drivers={"Ego": own["Lazy"](9.0)}), scenario=X)
    expected = r"The metric 'speed-nearby' is of the class SpeedNearby; .* metrics=\[SpeedNearby\(\)\]\), simulator, seed=…\)\."
    with pytest.raises(cc.InputError, match=expected):
        study.explore(own["Walk"](step=0.2), budget=6)
    assert len(study.table()) == 4


def test_a_reduced_set_is_run_again_with_its_metric(own, explored, tmp_path):
    explored.cluster(by=["speed-nearby"], eps=1.0, min_samples=2)
    explored.reduce(tmp_path / "reduced", size=2, by="speed-nearby")
    suite = cc.Suite.open(tmp_path / "reduced")
    with pytest.raises(
        cc.InputError, match=r"`metrics`: .*manifest.json names the metric 'speed-nearby', which cornercase does not"
    ):
        suite.run(tmp_path / "run.db", drivers={"Ego": own["Lazy"](9.0)})
    result = suite.run(tmp_path / "run.db", metrics=own["SpeedNearby"](), drivers={"Ego": own["Lazy"](9.0)})
    scores = explored.table()["speed-nearby"]
    assert [item.scores["speed-nearby"] for item in result.scenarios] == [
        pytest.approx(scores[item.origin]) for item in result.scenarios
    ]


def metric_class(**attributes: object) -> type[cc.Metric]:
    attributes = {"name": "mine", "unit": "m", "lower_is_critical": True, "cap": 1.0} | attributes
    given = {name: value for name, value in attributes.items() if value is not None}
    return type("Mine", (cc.Metric,), {"course": lambda self, recording, ego, other: recording.time, **given})


@pytest.mark.parametrize(
    ("metric", "expected"),
    [
        (
            metric_class(name="wttc")(),
            "The metric Mine has the name 'wttc' of another metric; change the `name` of the class.",
        ),
        (metric_class(name=None)(), "The metric class Mine lacks `name`; set it to a text, such as 'speed-nearby'."),
        (
            metric_class(lower_is_critical=None)(),
            "The metric class Mine lacks `lower_is_critical`; set it to True or F",
        ),
        (metric_class(unit="<b>")(), "The metric class Mine has '<b>' as `unit`; set it to at most 20 letters, digits"),
        (metric_class(cap=np.inf)(), "The metric class Mine has inf as `cap`; set it to a finite number."),
        (metric_class(), r"`metrics`: Mine is a class; give an object of it, as in Mine\(\)."),
        (max, r"`metrics` <built-in function max>: derive a class from `cornercase.Metric` and give an object of it"),
        (
            [metric_class()(), metric_class()()],
            "`metrics`: two different metrics have the name 'mine'; rename one of t",
        ),
    ],
)
def test_a_metric_that_cannot_be_used_is_refused_at_once(metric, expected, problem):
    with pytest.raises(cc.InputError, match=expected):
        cc.Problem(problem.scenario, "Ego", "Pedestrian", metric)


def test_a_function_is_not_registered_as_a_metric():
    with pytest.raises(
        cc.InputError, match=r"'fun' is .*<lambda>, which is not a subclass of cornercase.metrics.Metri"
    ):
        METRICS.register("fun", lambda: None)  # type: ignore[arg-type, return-value]
    assert "fun" not in METRICS


def proposing(points: object, name: str = "mine") -> cc.Optimizer:
    methods = {"prepare": lambda *_: None, "ask": lambda self, n: points, "tell": lambda *_: None, "name": name}
    optimizer: cc.Optimizer = type("Mine", (cc.Optimizer,), methods)()
    return optimizer


@pytest.mark.parametrize(
    ("optimizer", "expected"),
    [
        (
            proposing(np.zeros(6)),
            r"The optimizer 'mine' proposed an array of shape \(6,\) in ask\(2\); return an array of",
        ),
        (proposing("none"), r"The optimizer 'mine' proposed 'none' in ask\(2\); return an array of shape \(m, 3\)"),
        (proposing(np.zeros((5, 3))), r"proposed an array of shape \(5, 3\) in ask\(2\); .* with m up to 2\."),
        (
            proposing(np.full((2, 3), 1.2)),
            "The optimizer 'mine' proposed 1.2 for ego_start in ask; return values from 0",
        ),
        (proposing(np.full((2, 3), np.nan)), "The optimizer 'mine' proposed nan for ego_start in ask"),
        (
            proposing(np.zeros((1, 3)), "sobol"),
            "The optimizer Mine has the name 'sobol' of another optimizer; change the",
        ),
    ],
)
def test_an_optimizer_that_proposes_what_cannot_be_run_is_refused(optimizer, expected, problem, tmp_path):
    study = cc.Study.create(tmp_path / "study.db", problem)
    with pytest.raises(cc.InputError, match=expected):
        study.explore(optimizer, budget=4, batch=2)


def test_proposals_that_were_run_already_are_noticed(problem, tmp_path):
    study = cc.Study.create(tmp_path / "study.db", problem)
    with pytest.warns(cc.NoticeWarning, match="'mine' proposed 3 scenarios that were run already"):
        study.explore(proposing(np.full((2, 3), 0.5)), budget=4, batch=2)


class Uniform(cc.Optimizer):
    """Draws from a generator that each `ask` advances."""

    name = "uniform"

    def prepare(self, space, seed):
        self._rng, self._dimension = np.random.default_rng(seed), space.dimension

    def ask(self, n):
        return self._rng.random((n, self._dimension))

    def tell(self, points, scores):
        pass


class Stateful(Uniform):
    name, is_stateful_ask = "stateful", True


@pytest.mark.parametrize("audit", [0.0, 0.25])
def test_a_search_that_depends_on_calls_of_ask_goes_on_as_if_it_had_not_stopped(audit, problem, tmp_path):
    for name, budgets in {"whole": [17], "parts": [5, 8, 17]}.items():
        study = cc.Study.create(tmp_path / f"{name}.db", problem, seed=1)
        for budget in budgets:
            study.explore(Stateful(), budget=budget, batch=4, audit=audit)
    whole, parts = (cc.Study.open(tmp_path / f"{name}.db").table()["ego_start"] for name in ("whole", "parts"))
    np.testing.assert_array_equal(whole, parts)


def test_a_search_that_began_again_is_told_why(problem, tmp_path):
    study = cc.Study.create(tmp_path / "study.db", problem)
    study.explore(Uniform(), budget=4, batch=2)
    with pytest.warns(
        cc.NoticeWarning, match=r"4 scenarios that were run already; .* set is_stateful_ask = True in its"
    ):
        study.explore(Uniform(), budget=8, batch=2)


def test_an_object_is_no_sampler_of_optuna():
    with pytest.raises(
        cc.InputError, match=r"`sampler` <object object .*>: give the name of a sampler of Optuna, one of tpe, nsga2"
    ):
        cc.optimizers.Optuna(object())  # type: ignore[arg-type]


def test_the_traceback_of_an_error_is_that_of_the_call(problem, explored):
    """Causes and frames inside of cornercase are left out; those of the user's own code stay."""
    calls = {
        "text": partial(cc.Problem, problem.scenario, "Ego", "Pedestrian", "wttc", threshold="low"),  # type: ignore[arg-type]
        "unknown": partial(explored.explore, "sobolo", budget=9),
        "no study": partial(cc.Study.open, X),
        "no suite": partial(cc.Suite.open(X.parent).run, metrics=["wtc"]),
        "no metric": partial(cc.measure, explored.recording(1), "Ego", "Pedestrian", "wtc"),
    }
    for call in calls.values():
        with pytest.raises(cc.InputError) as refused:
            call()
        assert refused.value.__cause__ is None
        assert refused.value.__suppress_context__
        assert len(refused.traceback) <= 5

    def fail(*_: object) -> None:
        raise RuntimeError("no idea")

    optimizer = proposing(None)
    type(optimizer).ask = fail  # type: ignore[assignment]
    study = cc.Study.create(explored.path.with_name("failed.db"), problem)
    with pytest.raises(cc.InputError, match="The optimizer 'mine' failed in ask: RuntimeError: no idea") as failed:
        study.explore(optimizer, budget=4)
    assert isinstance(failed.value.__cause__, RuntimeError)


class Adjustable(cc.Metric):
    """A metric that changes what it is given, unless it cannot."""

    name, unit, lower_is_critical, cap = "adjustable", "m/s", False, 0.0

    def __init__(self, weights: object = 1.0) -> None:
        self.weights = weights

    def course(self, recording, ego, other):
        speed = recording.speed[recording.entity_index(ego)]
        speed[:] = 0.0
        return speed


def test_a_metric_cannot_change_a_recording(problem, tmp_path):
    changed = cc.Study.create(
        tmp_path / "s.db", cc.Problem(problem.scenario, ego="Ego", other="Pedestrian", metrics=[Adjustable(), "wttc"])
    )
    changed.explore("sobol", budget=4)
    with StudyFile.open(changed.path) as file:
        errors = [row.error or "" for row in file.failed_rows()]
    assert len(errors) == 4
    assert all("assignment destination is read-only" in error for error in errors)


def test_an_option_that_a_study_cannot_compare_is_refused(problem):
    with pytest.raises(cc.InputError, match="Adjustable: its option `weights` is of type list, which a study cannot"):
        cc.Problem(problem.scenario, ego="Ego", other="Pedestrian", metrics=[Adjustable([1, 2])])


class Curve(cc.Driver):
    """Follows a list of accelerations, which a study cannot compare."""

    def __init__(self, gains: Any = (1.0,)) -> None:
        self.gains = gains

    def acceleration(self, situation):
        return np.where(situation.speed < 5.0, self.gains[0], 0.0)


class Configured(cc.SystemUnderTest):
    def __init__(self, config: Any = None) -> None:
        self.config = config or {}

    def step(self, view, dt):
        return self.config.get("a", 0.0)


class SaysItsCurve(Curve):
    def __init__(self, gains: Any = (1.0,)) -> None:
        super().__init__(gains)
        self.settings = {"gains": list(gains)}


REFUSED_DRIVERS = [
    (Curve([3.0]), r"Curve: its option `gains` is of type list, which a study cannot store and compare; .*`settings`"),
    (Configured({"a": 1.0}), "Configured: its option `config` is of type dict, which a study cannot store and compare"),
]


@pytest.mark.parametrize(("driver", "expected"), REFUSED_DRIVERS)
def test_a_driver_with_an_option_that_a_study_cannot_compare_is_refused(driver, expected, problem, tmp_path):
    simulator = Builtin(drivers={"Ego": driver})
    with pytest.raises(cc.InputError, match=expected):
        cc.Study.create(tmp_path / "study.db", problem, simulator)
    cc.Study.create(tmp_path / "study.db", problem, Builtin(drivers={"Ego": type(driver)()})).explore("sobol", budget=4)
    with pytest.raises(cc.InputError, match=expected):
        cc.Study.open(tmp_path / "study.db", simulator)
    with pytest.raises(cc.InputError, match=expected):
        cc.run_suite(X.parent, tmp_path / "run.db", ego="Ego", other="*", drivers={"Ego": driver})
    assert isinstance(cc.simulate(X, drivers={"Ego": driver}, duration=1.0), cc.Recording)


def test_a_number_of_numpy_as_an_option_is_refused_with_the_way_out(problem, tmp_path):
    simulator = Builtin(drivers={"Ego": Configured(np.int64(2))})
    with pytest.raises(
        cc.InputError, match=r"of type int64, .*; give numbers and texts of Python, as `config\.item\(\)`"
    ):
        cc.Study.create(tmp_path / "study.db", problem, simulator)


@dataclass
class Remembers(cc.SystemUnderTest):
    """Its list is a field that each scenario fills anew."""

    seen: list[float] = field(default_factory=list)

    def step(self, view, dt):
        self.seen.append(view.time)
        return -0.01 * len(self.seen)


def test_a_field_with_a_list_of_its_own_is_no_option(problem, tmp_path):
    study = cc.Study.create(tmp_path / "study.db", problem, Builtin(drivers={"Ego": Remembers()}, duration=1.0))
    assert study.explore("sobol", budget=4).done == 4
    with pytest.raises(cc.InputError, match="Remembers: its option `seen` is of type list"):
        cc.Study.create(tmp_path / "other.db", problem, Builtin(drivers={"Ego": Remembers([1.0])}))


def test_a_driver_that_says_its_list_in_its_settings_is_compared(problem, tmp_path):
    study = cc.Study.create(tmp_path / "study.db", problem, Builtin(drivers={"Ego": SaysItsCurve([3.0])}))
    study.explore("sobol", budget=4)
    opened = cc.Study.open_or_create(study.path, problem, Builtin(drivers={"Ego": SaysItsCurve([3.0])}))
    assert len(opened) == 4
    with pytest.raises(cc.InputError, match=r"gains=\[3.0\], sha256 .* in the study, .*gains=\[2.0\]"):
        cc.Study.open_or_create(study.path, problem, Builtin(drivers={"Ego": SaysItsCurve([2.0])}))
