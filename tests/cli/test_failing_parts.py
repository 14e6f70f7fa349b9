"""Drivers, simulators, metrics and searches of users that fail: each costs its scenario, or one sentence."""

from __future__ import annotations

import ctypes
import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cornercase as cc
from conftest import at_night
from cornercase._common.errors import InputError
from cornercase._common.plugin_errors import describe_error, group_failure_messages
from cornercase.cli.config_file import read_explore_options
from cornercase.drivers import Driver
from cornercase.drivers._resolve import resolve_driver
from cornercase.metrics import METRICS, Clearance, measure
from cornercase.optimizers import OPTIMIZERS, Sobol
from cornercase.recordings import Recording, read_recording
from cornercase.simulators import SIMULATORS, Builtin, Simulator
from cornercase.simulators._create import create_simulator
from cornercase.simulators.pool._simulator import WorkerSimulator
from cornercase.study import StudyFile
from cornercase.suite import Requirement, judge
from helpers import fake_simulators as fake_simulators
from helpers.command_line import SPACE, X, cornercase, process
from helpers.fake_simulators import Plan

pytestmark = pytest.mark.filterwarnings("ignore:without effect")

DRIVERS = '''
import ctypes, sys
import numpy as np
from cornercase.cli.config_file import read_explore_options
from cornercase.drivers import Driver


class Steady(Driver):
    def acceleration(self, situation):
        return np.clip(situation.target_speed - situation.speed, -3.0, 2.0)


class Near(Steady):
    """Fails where it is far along its path after 1 s: in three of the first six scenarios."""

    def acceleration(self, situation):
        if situation.time > 1.02 and (situation.active & (situation.distance > 70.0)).any():
            self.fail()
        return super().acceleration(situation)


class Leaving(Near):
    def fail(self):
        sys.exit(0)


class Crashing(Near):
    def fail(self):
        ctypes.string_at(0)


class Hopeless(Steady):
    def acceleration(self, situation):
        raise RuntimeError("no map")


class Holding(Steady):
    def __init__(self):
        self.handle = ctypes.pointer(ctypes.c_int(3))


class Unmade(Steady):
    def __init__(self):
        sys.exit(0)


class Interrupting(Steady):
    def __init__(self):
        raise KeyboardInterrupt
'''
SEARCH: tuple[object, ...] = (
    "explore", X, "--space", SPACE, "--ego", "Ego", "--other", "Pedestrian", "--metric", "wttc", "--optimizer", "sobol",
    "--budget", "6", "--batch", "6", "--duration", "2",
)  # fmt: skip
PYTHON: dict[str, Any] = {
    "space": SPACE, "ego": "Ego", "other": "Pedestrian", "optimizer": "sobol", "budget": 6, "batch": 6,
    "duration": 2.0,
}  # fmt: skip


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "faulty.py").write_text(DRIVERS)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def searched(folder, driver, *more, study="s.db"):
    return cornercase("-q", *SEARCH, "--driver", f"Ego=faulty:{driver}", *more, "-o", study, cwd=folder)


def rows(path):
    with StudyFile.open(path, readonly=True) as study:
        return [(row.id, row.state, row.error) for row in study.rows()]


def test_42_s5_a_driver_that_leaves_python_fails_its_scenarios_and_all_tell_of_it(folder):
    done = searched(folder, "Leaving")
    assert (done.returncode, done.stderr.count("Traceback")) == (0, 0)
    said = "the driver of Ego (faulty:Leaving) failed at t = 1.05 to 1.55 s: SystemExit: 0 (faulty.py line "
    assert "6 scenarios in s.db, 3 of which failed" in done.stdout
    assert said in done.stdout
    found = rows(folder / "s.db")
    assert [state for _, state, _ in found] == ["done", "failed", "failed", "done", "done", "failed"]
    assert (
        "failed at t = 1.55 s: SystemExit: 0 (faulty.py line 18 in acceleration: self.fail(); faulty.py line"
        in found[5][2]
    )
    assert str(folder) not in str(found)
    shown = cornercase("show", "s.db", cwd=folder).stdout
    assert said in shown
    told = json.loads(cornercase("show", "s.db", "--json", cwd=folder).stdout)["failures"]
    ((reason, failure),) = told.items()
    assert reason.startswith(said)
    assert (failure["scenarios"], failure["first"]) == (3, 2)
    assert failure["at"]["ego_start"] == 67.0
    # Wherever it runs it fails in the same way.
    assert searched(folder, "Leaving", "--workers", "2", study="two.db").returncode == 0
    assert rows(folder / "two.db") == found


def test_42_4_a_driver_that_always_fails_ends_the_search_in_a_sentence(folder):
    done = searched(folder, "Hopeless")
    assert done.returncode == 2
    assert done.stderr.startswith(
        "cornercase: The first 6 scenarios all failed, so no more are run; in the last scenario the driver of Ego"
        " (faulty:Hopeless) failed at t = 0 s: RuntimeError: no map (faulty.py line"
    )
    assert done.stderr.count("\n") == 1
    # Nothing keeps out the corrected driver.
    assert not (folder / "s.db").exists() or rows(folder / "s.db") == []


class Hopeless(Driver):
    def acceleration(self, situation):
        raise RuntimeError("no map")


def test_42_8_whoever_wants_to_knows_of_all_failures(tmp_path):
    given = {**PYTHON, "metrics": ["wttc"], "drivers": {"Ego": Hopeless()}}
    assert cc.explore(X, tmp_path / "s.db", max_failures=0, **given).failed == 6
    assert cc.explore(X, tmp_path / "s.db", max_failures=7, retry_failed=True, **given).failed == 6
    with pytest.raises(InputError, match="The first 6 scenarios all failed"):
        cc.explore(X, tmp_path / "s.db", max_failures=6, retry_failed=True, **given)
    assert len(rows(tmp_path / "s.db")) == 6
    # As soon as it is known, where each scenario is proposed by itself.
    with pytest.raises(InputError, match="The first 2 scenarios all failed"):
        cc.explore(X, tmp_path / "b.db", max_failures=2, asynchronous=True, **given)
    (tmp_path / "study.toml").write_text("max-failures = 7\n")
    assert read_explore_options(tmp_path / "study.toml") == {"max_failures": 7}


def test_42_8_a_driver_that_crashes_costs_its_scenario_alone(folder):
    options = {"duration": 2.0, "drivers": {"Ego": resolve_driver("faulty:Crashing")}}
    with create_simulator("builtin", options, retries=0) as simulator:
        well, lost = simulator.run([cc.ConcreteScenario(X, {"ego_start": start}) for start in (30.0, 70.0)])
    assert isinstance(well, Recording)
    assert str(lost) == (
        "the process of the simulator and of the driver of Ego (faulty:Crashing) was ended by SIGSEGV, tried once"
    )


def test_42_8_a_driver_that_holds_what_cannot_be_sent_is_made_in_its_worker(folder):
    assert searched(folder, "Holding", "--workers", "2").returncode == 0


class Holding(Driver):
    def __init__(self):
        self.handle = ctypes.pointer(ctypes.c_int(3))

    def acceleration(self, situation):
        return np.zeros(len(situation.speed))


def test_42_8_a_driver_object_that_cannot_be_sent_is_named_with_what_it_holds(tmp_path):
    with pytest.raises(InputError) as refused:
        cc.explore(X, tmp_path / "s.db", metrics=["wttc"], drivers={"Ego": Holding()}, workers=2, **PYTHON)
    assert "`drivers` Ego: the driver test_failing_parts:Holding cannot be sent to another process" in str(
        refused.value
    )
    assert "its attribute 'handle' cannot be pickled (ValueError: ctypes objects" in str(refused.value)
    assert "Create it in start(), give the class by name" in str(refused.value)
    assert not (tmp_path / "s.db").exists()
    # In this process it need not be sent.
    assert cc.explore(X, tmp_path / "s.db", metrics=["wttc"], drivers={"Ego": Holding()}, **PYTHON).done == 6


def test_42_8_a_script_is_not_begun_anew_by_a_driver_of_its_own(folder):
    lines = (
        "from pathlib import Path",
        "from cornercase.drivers._resolve import resolve_driver",
        "from cornercase.scenario import ConcreteScenario",
        "from cornercase.simulators._create import create_simulator",
        "options = {'duration': 1.0, 'drivers': {'Ego': resolve_driver('faulty:Steady')}}",
        "with create_simulator('builtin', options) as simulator:",
        f"    (found,) = simulator.run([ConcreteScenario(Path({str(X)!r}))])",
        "    print(type(simulator).__name__, type(found).__name__)",
    )
    (folder / "script.py").write_text("\n".join(lines))
    command = [sys.executable, folder / "script.py"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder, timeout=300)
    assert done.stdout == "WorkerSimulator Recording\n", done.stderr


@pytest.mark.parametrize(("driver", "raised"), [("Unmade", "SystemExit: 0"), ("Interrupting", "KeyboardInterrupt")])
def test_42_s5_a_driver_that_cannot_be_made_is_named(folder, driver, raised):
    done = searched(folder, driver)
    assert done.returncode == 2
    assert done.stderr.startswith(f"cornercase: The driver 'faulty:{driver}' cannot be created: {raised}")


def test_a_file_that_an_installed_module_hides_is_named(folder):
    for hidden in ("code", "time"):
        (folder / f"{hidden}.py").write_text(DRIVERS)
        done = cornercase("-q", *SEARCH, "--driver", f"Ego={hidden}:Steady", "-o", "s.db", cwd=folder)
        assert done.returncode == 2
        where = sys.modules[hidden].__file__ if hidden == "code" else "part of Python itself"
        assert f"the module '{hidden}' is {where}, which hides ./{hidden}.py, so rename yours." in done.stderr
    (folder / "steadies.py").write_text(DRIVERS)
    done = cornercase("-q", *SEARCH, "--driver", "Ego=steadies:Steadi", "-o", "s.db", cwd=folder)
    assert "'steadies' has no class 'Steadi'; did you mean 'Steady'?" in done.stderr


@pytest.mark.parametrize("workers", at_night([1, 2], {1}))
def test_json_is_all_that_a_command_prints_to_stdout(folder, workers):
    (folder / "loud.py").write_text(
        "import cornercase as cc\nprint('loaded')\n\n\nclass Loud(cc.SystemUnderTest):\n"
        "    def step(self, view, dt):\n        print('step')\n        return 0.0\n"
    )
    shutil.copytree(X.parent, folder / "suite")
    (folder / "suite" / SPACE.name).unlink()
    done = process(
        "-q", "test", "suite", "--driver", "Ego=loud:Loud", "--duration", 1, "--workers", workers, "--ego", "Ego", "--other",
        "Pedestrian", "-o", "s.db", "--json", cwd=folder,
    )  # fmt: skip
    assert done.stdout.startswith("{"), done.stderr[-500:]
    json.loads(done.stdout)
    assert "loaded\n" in done.stderr
    assert "step\n" in done.stderr


class Touchy(Clearance):
    """Fails where the ego begins far away, as the names of its errors say."""

    name, wrong = "touchy", "raise"

    def course(self, recording, ego, other):
        course = super().course(recording, ego, other)
        if recording.y[recording.entity_index(ego), 0] > -60.0:
            if self.wrong == "raise":
                sys.exit(0)
            if self.wrong == "shape":
                return course[1:]
        return course

    def score(self, course):
        return float("nan") if self.wrong == "score" and course[0] < 66.0 else super().score(course)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ("raise", "the metric touchy failed: SystemExit: 0 (test_failing_parts.py line "),
        ("shape", "the metric touchy gave array("),
        ("score", "the metric touchy gave nan as its score, which is not a number"),
    ],
)
def test_42_s5_a_metric_that_fails_fails_its_scenario(tmp_path, monkeypatch, wrong, said):
    monkeypatch.setitem(METRICS._factories, "touchy", (Touchy, {}))
    monkeypatch.setattr(Touchy, "wrong", wrong)
    explored = {"metrics": ["touchy"], **PYTHON}
    result = cc.explore(X, tmp_path / "s.db", **explored)
    assert result.done + result.failed == 6
    assert 0 < result.failed < 6
    assert all(error.startswith(said) for _, state, error in rows(tmp_path / "s.db") if state == "failed")
    monkeypatch.setattr(Touchy, "wrong", "")
    assert cc.explore(X, tmp_path / "s.db", retry_failed=True, **explored).done == 6
    with StudyFile.open(tmp_path / "s.db", readonly=True) as study:
        recording = study.recording(2)
    monkeypatch.setattr(Touchy, "wrong", "raise")
    with pytest.raises(InputError, match=r"^The metric touchy failed: SystemExit: 0 \("):
        measure(recording, "Ego", "Pedestrian", ["touchy"])


def test_42_s5_a_metric_that_fails_in_a_requirement_alone_leaves_it_open(tmp_path, monkeypatch):
    monkeypatch.setitem(METRICS._factories, "touchy", (Touchy, {}))
    cc.simulate_many(X, tmp_path / "runs", values={"ego_start": 70.0}, duration=2.0)
    recording = read_recording(tmp_path / "runs" / "x_intersection.csv")
    verdict = judge(Requirement.parse("touchy > 0"), recording, "Ego", "Pedestrian")
    assert verdict.state == "inconclusive"
    assert verdict.reason.startswith("the metric touchy failed: SystemExit: 0 (test_failing_parts.py line ")


@pytest.mark.parametrize("asked", ["ask", "tell"])
def test_42_s5_a_search_that_fails_is_named_and_the_study_kept(tmp_path, monkeypatch, asked):
    class Tired(Sobol):
        name, rounds = "tired", 0

        def ask(self, n, exclude=None):
            self.rounds += 1
            if self.rounds == 2 and asked == "ask":
                sys.exit(0)
            return super().ask(n)

        def tell(self, points, scores):
            if asked == "tell":
                raise KeyError("scores")
            super().tell(points, scores)

    monkeypatch.setitem(OPTIMIZERS._factories, "tired", (Tired, {}))
    explored = {**PYTHON, "metrics": ["wttc"], "optimizer": "tired", "batch": 3}
    with pytest.raises(
        InputError, match=rf"^The optimizer 'tired' failed in {asked}: (SystemExit: 0|KeyError: 'scores') \("
    ):
        cc.explore(X, tmp_path / "s.db", **explored)
    assert [state for _, state, _ in rows(tmp_path / "s.db")] == ["done"] * 3


class Unruly(Simulator):
    """A simulator that fails where it says."""

    name, wrong, in_process = "unruly", "", True

    def __init__(self, **options):
        self.fail("__init__")
        self.settings = {}

    def fail(self, where):
        if self.wrong == where:
            sys.exit(0)

    def check_supported(self, scenario):
        self.fail("require_means")

    def close(self):
        self.fail("close")

    @classmethod
    def notices(cls, scenario, values=None):
        if cls.wrong == "notices":
            raise KeyError("notices")
        return ()

    @classmethod
    def availability(cls):
        if cls.wrong == "availability":
            sys.exit(0)
        return super().availability()

    def run(self, concretes):
        yield from Builtin(duration=1.0).run(concretes)


@pytest.fixture
def unruly(monkeypatch):
    monkeypatch.setitem(SIMULATORS._factories, "unruly", (Unruly, {}))
    return lambda where: monkeypatch.setattr(Unruly, "wrong", where)


@pytest.mark.parametrize("where", ["__init__", "require_means", "notices"])
def test_42_s5_a_simulator_that_fails_before_it_runs_is_named(tmp_path, unruly, where):
    unruly(where)
    done = cornercase("-q", *SEARCH, "--simulator", "unruly", "-o", tmp_path / "s.db")
    assert done.returncode == 2
    assert done.stderr.startswith("cornercase: The simulator 'unruly' failed ")
    assert "(test_failing_parts.py line " in done.stderr
    assert not (tmp_path / "s.db").exists()


def test_42_s5_a_simulator_that_fails_in_close_keeps_what_it_ran(tmp_path, unruly):
    unruly("close")
    done = cornercase(*SEARCH, "--simulator", "unruly", "-o", tmp_path / "s.db")
    assert (done.returncode, len(rows(tmp_path / "s.db"))) == (0, 6)
    assert "The simulator 'unruly' failed in close: SystemExit: 0 (test_failing_parts.py line " in done.stderr
    unruly("availability")
    assert "SystemExit: 0" in cornercase("simulators", "--json").stdout


def test_42_8_an_option_says_how_many_failures_in_a_row_end_a_search(tmp_path):
    def ran(most, folder):
        folder.mkdir()
        plan = Plan(folder, {k: ["crash"] for k in range(7)})
        with create_simulator("failing", {"plan": plan}, retries=0, max_failures=most) as simulator:
            assert isinstance(simulator, WorkerSimulator)
            return len(list(simulator.run(fake_concretes(7))))

    assert ran(0, tmp_path / "never") == 7
    with pytest.raises(InputError, match=r"no result in 2 scenarios in a row \(`max_failures`\)"):
        ran(2, tmp_path / "two")


def fake_concretes(count):
    return [cc.ConcreteScenario(Path("none.xosc"), {"k": float(k)}) for k in range(count)]


@pytest.mark.parametrize("workers", ["1", "2"])
def test_42_9_a_notice_comes_from_workers_once(folder, workers):
    module = f"hard_{workers}"
    (folder / f"{module}.py").write_text(
        "import numpy as np\nfrom cornercase.drivers import Driver\n\nclass Hard(Driver):\n"
        "    def acceleration(self, situation):\n        return np.full(len(situation.speed), -30.0)\n"
    )
    done = cornercase(*SEARCH, "--driver", f"Ego={module}:Hard", "--workers", workers, "-o", "s.db", cwd=folder)
    assert done.returncode == 0
    said = (
        f"The driver of Ego ({module}:Hard) exceeds the deceleration of 9 m/s² in <Performance>, and is limited to it;"
    )
    assert done.stderr.count(said) == 1


def test_42_4_the_same_failure_at_different_instants_is_one_reason():
    at = "the driver of Ego (a:B) failed at t = {} s: ValueError: no (a.py line 3 in run: no())"
    found = group_failure_messages([at.format(0.5), "too slow", at.format(1.25), at.format(1)])
    assert found == {at.format("0.5 to 1.25"): [0, 2, 3], "too slow": [1]}


def test_42_4_an_error_is_described_in_a_line_whatever_it_is():
    class SilentError(Exception):
        def __str__(self):
            raise RuntimeError

    def raised(error):
        try:
            raise error
        except BaseException as caught:
            return describe_error(caught)

    assert raised(SilentError()).startswith("SilentError (test_failing_parts.py line ")
    assert raised(KeyError(f"{Path.cwd() / 'a'}\nb")).startswith("KeyError: 'a\\nb' (")
    assert len(raised(ValueError("x" * 9999))) < 400
    assert describe_error(SystemExit(1)) == "SystemExit: 1"


def test_42_s5_no_command_ends_well_by_an_exception_that_nobody_expected(monkeypatch):
    monkeypatch.setattr(METRICS, "names", lambda: sys.exit(0))
    done = cornercase("metrics")
    assert done.returncode == 2
    assert done.stderr.startswith("cornercase: user code ended the command with SystemExit: 0 (")
    assert "; test_failing_parts.py line" in done.stderr
