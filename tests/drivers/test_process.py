"""Driving functions in a process of their own, which speak a protocol."""

from __future__ import annotations

import ast
import gc
import pickle
import re
import shlex
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import psutil
import pytest

import cornercase as cc
from conftest import at_night, ran
from cornercase._common.errors import InputError, PluginError
from cornercase.drivers import DRIVERS, EquippedDriver, ProcessFunction, Trajectory
from cornercase.drivers import process as process_package
from cornercase.drivers._resolve import create_driver_named_in_file, driver_by_name, may_be_named_in_file
from cornercase.drivers.process._columns import COLUMNS, PATH_COLUMNS
from cornercase.drivers.process._messages import PROTOCOL_VERSION, ProtocolError, pack_column, read_answer
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import Builtin
from cornercase.simulators._create import create_simulator
from cornercase.study import StudyFile
from helpers.command_line import SPACE, X, cornercase
from helpers.isolation import ROOT
from helpers.waiting import until

CLIENTS = Path(process_package.__file__).parent
PYTHON = f'"{sys.executable}"'
DURATION = 6.0
FUNCTION = """
import os, sys, time
from cornercase_client import Control, Function, serve

class Aeb(Function):
    def __init__(self, time_to_brake=1.5, wrong=""):
        self.time_to_brake, self.wrong = time_to_brake, wrong

    def start(self, ego, rng):
        print("a line that is no message")

    def step(self, view, dt):
        walks = any(other.name == "Pedestrian" and other.speed > 0.0 for other in view.objects)
        if walks and view.time > 0.99:
            if self.wrong == "raise":
                raise RuntimeError("no gap")
            if self.wrong == "crash":
                print("about to\\x1b[2J crash", file=sys.stderr, flush=True)
                os._exit(3)
            if self.wrong == "hang":
                time.sleep(60)
            if self.wrong == "garbage":
                os.write(3, b"Hello world")
            if self.wrong == "infinite":
                return float("inf")
        leader = view.leader
        if leader is not None and leader.gap < self.time_to_brake * leader.closing:
            return Control(acceleration=-8.0)
        return 0.1 * view.path(10.0).heading + 0.01 * len(view.objects) - 0.001 * view.ego.turn

serve(Aeb, ahead=range(0, 31, 10))
"""


class Aeb(cc.SystemUnderTest):
    def __init__(self, time_to_brake: float = 1.5):
        self.time_to_brake = time_to_brake

    def step(self, view, dt):
        leader = view.leader
        if leader is not None and leader.gap < self.time_to_brake * leader.closing:
            return cc.Control(acceleration=-8.0)
        return 0.1 * view.path(10.0).heading + 0.01 * len(view.objects) - 0.001 * view.ego.turn


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "my_function.py").write_text(FUNCTION)
    for name in ("cornercase_client.py", "cornercase_client.hpp"):
        shutil.copy(CLIENTS / name, tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def concretes(*waits):
    return [ConcreteScenario(X, {"pedestrian_wait": wait}) for wait in waits]


def run(driver, *waits, duration=DURATION):
    return ran(Builtin(duration=duration, drivers={"Ego": driver}), concretes(*waits))


def spec(options="", program="my_function.py"):
    return f"exec:{PYTHON} {program}" + (f":{options}" if options else "")


def same(one, other, within=0.0):
    return all(
        np.allclose(getattr(one, name), getattr(other, name), rtol=0.0, atol=within, equal_nan=True)
        for name in ("x", "y", "heading", "speed", "acceleration")
    )


def test_a_process_drives_as_the_same_class_does_alone_and_in_a_batch(folder):
    waits = (0.0, 2.0, 5.0)
    process = driver_by_name(spec("time_to_brake=2"))
    expected, batch = run(Aeb(time_to_brake=2.0), *waits), run(process, *waits)
    assert all(same(one, other, within=1e-9) for one, other in zip(expected, batch, strict=True))
    assert min(one.acceleration[0].min() for one in batch) == pytest.approx(-8.0)
    for wait, recording in zip(waits, batch, strict=True):
        assert same(run(process, wait)[0], recording)


@pytest.fixture(scope="module")
def alone():
    """What the class does where nothing is at fault."""
    return run(Aeb(), 4.0, 5.0, duration=2.0)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ("raise", r"failed at t = 1 s: RuntimeError: no gap \(my_function\.py line 16 in step: raise RuntimeError"),
        ("crash", r"failed at t = 1 s: it ended with exit code 3; its last lines: .*about to\\x1b\[2J crash$"),
        ("hang", r"failed at t = 1 s: it did not answer within 0\.6 s"),
        ("infinite", r"failed at t = 1 s: ValueError: acceleration is inf"),
        ("garbage", r"failed at t = 1 s: its output begins with 'Hello world"),
    ],
)
def test_only_the_scenario_at_fault_fails_with_its_instant(folder, alone, wrong, words):
    driver = ProcessFunction(f"{PYTHON} my_function.py", timeout=0.6 if wrong == "hang" else 10.0, wrong=wrong)
    simulator = Builtin(duration=2.0, drivers={"Ego": driver})
    # The pedestrian walks in one of them.
    well, broken, last = simulator.run(concretes(4.0, 0.0, 5.0))
    assert isinstance(broken, PluginError)
    assert str(broken).startswith(f"the driver of Ego ({str(driver)[:5]}")
    assert re.search(words, str(broken)), str(broken)
    assert same(well, alone[0])
    assert same(last, alone[1])


def answering(folder, code, name="other.py"):
    (folder / name).write_text(f"import sys\nimport cornercase_client as client\n{code}\n")
    return spec(program=name)


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (
            "client.PROTOCOL_VERSION = 7\nclient.serve(client.Function)",
            "this cornercase_client.py speaks version 7, cornercase ",
        ),
        (
            "client._answer_hello = lambda *_: {'type': 'hello', 'protocol': 7}\nclient.serve(client.Function)",
            "cannot be used: it has version 7 of the protocol, cornercase has version 1.",
        ),
        ("print('Hello there, how are you?')", "its output begins with 'Hello there"),
        ("sys.exit('no licence')", "it ended with exit code 1; its last lines: no licence."),
        ("import time; time.sleep(60)", "it did not answer within 0.6 s"),
        (
            "f = client.ScalarAdapter(client.Function); f.columns = ['sped']; client.serve_batches(f)",
            "cannot be used: it wants the column 'sped', which does not exist; did you mean 'speed'.",
        ),
        (
            "f = client.ScalarAdapter(client.Function); f.columns = ['path_x']; client.serve_batches(f)",
            "it wants the column 'path_x', but does not give 'ahead', the list of distances in m at which it",
        ),
        ("import os; os.close(0); os._exit(0)", "cannot be used: it ended with exit code 0 before it answered."),
        ("import os; os.close(0); os.write(1, b'hello'); os._exit(0)", "its output begins with 'hello', which is no"),
    ],
)
def test_a_program_that_cannot_be_used_ends_the_command_with_a_sentence(folder, code, words):
    text = answering(folder, code) + (":start_timeout=0.6" if "sleep" in code else "")
    with pytest.raises(InputError) as caught:
        run(text, 0.0)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
    assert str(folder) not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("exec", "needs a command, as in exec:./function"),
        ("exec:./no_function", "since there is no program './no_function'."),
        ("exec:no-such-program --fast", "since there is no program 'no-such-program'."),
        ("exec:my_function.py", "'my_function.py' is not on PATH; give it by its folder"),
        ("exec:tcp://localhost", "has no host and port; give both, as in exec:tcp://localhost:5000."),
        (spec("timeout=0"), "`timeout`"),
        (spec("start_timeout=soon"), "`start_timeout`"),
        ("exec:'unfinished", "cannot be split into words: No closing quotation"),
        (
            "exec:./f:reaction=1,6",
            "'exec:./f:reaction=1,6' has the option '6' without a name or value; give options as",
        ),
        ("exec:./f:reaction=1,reaction=2", "has the option 'reaction' twice; give it once."),
    ],
)
def test_bad_commands_are_refused_when_they_are_given(folder, text, words):
    with pytest.raises(InputError) as caught:
        driver_by_name(text)
    assert words in str(caught.value)


def test_what_stands_before_sensors_may_be_quoted_in_a_command(folder):
    (folder / "a + b.py").write_text(FUNCTION)
    driver = driver_by_name(f'exec:{PYTHON} "a + b.py":time_to_brake=2 + radar:range=80 + kinematic')
    assert isinstance(driver, EquippedDriver)
    assert [str(part) for part in driver.equipment] == ["radar:range=80", "kinematic"]
    assert str(driver.driver) == f'exec:{PYTHON} "a + b.py":time_to_brake=2'
    assert same(run(f'exec:{PYTHON} "a + b.py"', 0.0)[0], run(spec(), 0.0)[0])


@pytest.mark.parametrize("command", ["python a + b.py", "python a.py --log 'x' + y"])
def test_a_command_that_would_be_taken_for_sensors_says_to_quote_it(folder, command):
    with pytest.raises(InputError, match=r"no sensor or vehicle '.*If ' \+ ' belongs to the command, put it in double"):
        driver_by_name(f"exec:{command}")
    with pytest.raises(InputError, match=r"contains ' \+ ', .*put it in double quotes"):
        ProcessFunction(command)


def test_a_file_never_names_a_program(folder):
    for name in ("exec:./f", "exec:./f:timeout=2", "exec:evil=1", "exec:5", "exec", "exec:tcp://host:5"):
        assert not may_be_named_in_file(name)
        with pytest.raises(InputError, match="a program named in a file is not run"):
            create_driver_named_in_file(name)
    cut_in = X.parents[1] / "r157" / "cut_in.xosc"
    scenario = folder / cut_in.name
    scenario.write_text(cut_in.read_text().replace('value="cc-human"', 'value="exec:touch pwned"'))
    shutil.copy(cut_in.parent / "motorway.xodr", folder)
    simulated = cornercase("simulate", scenario, "-o", folder / "r.csv")
    assert simulated.returncode == 2
    assert "but a program named in a file is not run; give the driver with --driver." in simulated.stderr
    (folder / "study.toml").write_text('driver = ["Ego=exec:touch pwned"]\n')
    explored = cornercase("explore", X, "--config", folder / "study.toml", "-o", folder / "s.db")
    assert explored.returncode == 2
    assert "a program named in a file is not run" in explored.stderr
    condition = cornercase(
        "explore", X, "--range", "pedestrian_wait=0:5", "--ego", "Ego", "--other", "Pedestrian", "--driver", "Ego=normal",
        "--metric", "ttc", "--critical-if", "collision and not reference:exec:./pwned", "--budget", 2, "-o", folder / "s.db",
    )  # fmt: skip
    assert condition.returncode == 2
    assert "a condition must not run one" in condition.stderr
    assert not (folder / "pwned").exists()


def test_a_study_stores_the_command_and_the_checksum_of_its_files(folder):
    text = spec("time_to_brake=2")
    explore = (
        "explore", X, "--space", SPACE, "--ego", "Ego", "--other", "Pedestrian", "--metric", "wttc", "--optimizer", "sobol",
        "--duration", 1, "--driver", f"Ego={text}", "-o", folder / "s.db",
    )  # fmt: skip
    done = cornercase(*explore, "--budget", 2)
    assert done.returncode == 0, done.stderr
    with StudyFile.open(folder / "s.db") as study:
        stored = study.meta.settings["drivers"]["Ego"]
    assert stored["driver"] == text
    assert len(stored["sha256"]) == 64
    shown = cornercase("show", folder / "s.db", "--config").stdout
    assert f"# A class of one's own has to be given again: --driver {shlex.quote(f'Ego={text}')}" in shown
    (folder / "my_function.py").write_text(FUNCTION + "# changed\n")
    again = cornercase(*explore, "--budget", 3)
    assert again.returncode == 2
    assert "sha256" in again.stderr


def test_two_workers_give_the_same_bytes_and_no_process_is_left(folder):
    alone = run(spec(), 0.0, 2.0, 5.0)
    simulator = create_simulator(
        "builtin", {"duration": DURATION, "drivers": {"Ego": driver_by_name(spec())}}, workers=2
    )
    with simulator:
        several = ran(simulator, concretes(0.0, 2.0, 5.0))
    assert all(same(one, other) for one, other in zip(alone, several, strict=True))
    gc.collect()
    until(lambda: not running("my_function.py"))


def running(word):
    return [
        process
        for process in psutil.process_iter(["cmdline", "status"])
        if process.info["status"] != psutil.STATUS_ZOMBIE
        and any(word in part for part in process.info["cmdline"] or ())
    ]


def test_a_driver_is_pickled_without_its_program_and_ends_it_when_it_is_closed(folder):
    driver = ProcessFunction(f"{PYTHON} my_function.py", time_to_brake=2.0)
    expected = run(driver, 5.0)
    assert same(run(pickle.loads(pickle.dumps(driver)), 5.0)[0], expected[0])
    assert driver == ProcessFunction(f"{PYTHON} my_function.py", time_to_brake=2.0)
    assert str(driver.with_options(time_to_brake=3.0)) == spec("time_to_brake=3.0")
    driver.close()
    gc.collect()
    until(lambda: not running("my_function.py"))
    # It starts again.
    assert same(run(driver, 5.0)[0], expected[0])
    driver.close()


def test_a_killed_simulation_leaves_no_program_behind(folder):
    (folder / "deaf.py").write_text(
        "import subprocess, sys, time\n"
        "subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(600)', 'grandchild-of-deaf'])\n"
        "open('begun', 'w').close()\ntime.sleep(600)\n"
    )
    script = f"import cornercase as cc; cc.simulate({str(X)!r}, drivers={{'Ego': {spec(program='deaf.py')!r}}})"
    with subprocess.Popen([sys.executable, "-c", script], stderr=subprocess.DEVNULL) as process:
        until(lambda: (folder / "begun").exists())
        process.kill()
    until(lambda: not running("deaf.py") and not running("grandchild-of-deaf"))


def test_a_program_that_listens_drives_too(folder):
    with socket.socket() as probe:
        probe.bind(("localhost", 0))
        port = probe.getsockname()[1]
    (folder / "my_function.py").write_text(FUNCTION.replace("serve(Aeb,", f"serve(Aeb, port={port},"))
    with subprocess.Popen([sys.executable, "my_function.py"], stderr=subprocess.PIPE) as server:
        try:
            until(lambda: socket_answers(port))
            assert same(run(f"exec:tcp://localhost:{port}:time_to_brake=2", 5.0)[0], run(Aeb(2.0), 5.0)[0])
        finally:
            server.kill()
    with pytest.raises(InputError, match="cannot be started: Connection refused"):
        run(f"exec:tcp://localhost:{port}", 5.0)


def socket_answers(port):
    try:
        socket.create_connection(("localhost", port)).close()
    except OSError:
        return False
    return True


def test_what_a_program_writes_to_stderr_is_kept(folder):
    run(spec("log=function.log"), 0.0, duration=0.5)
    assert "a line that is no message" in (folder / "function.log").read_text()


def test_an_answer_is_read_or_refused():
    controls, failures = read_answer(
        {
            "steering": pack_column([0.1, np.nan]),
            "throttle": pack_column([1.0, np.nan]),
            "lane_change": pack_column([0.0, -1.0]),
            "trajectories": [[1, pack_column([0.0, 1.0]), pack_column([0.0, 5.0]), pack_column([0.0, 0.0])]],
            "failures": [[0, "lost"]],
        },
        2,
    )
    assert (controls.steering[0], controls.throttle[0], controls.lane_change.tolist()) == (0.1, 1.0, [0, -1])
    assert np.isnan([controls.steering[1], *controls.acceleration, *controls.brake]).all()
    assert isinstance(controls.trajectories[1], Trajectory)
    assert controls.trajectories[1].x.tolist() == [0.0, 5.0]
    assert failures == {0: "lost"}
    for answer, words in (
        ({"acceleration": pack_column([1.0])}, "has 1 values of acceleration for 2 scenarios"),
        ({"acceleration": [1.0, 2.0]}, "its acceleration is not binary data"),
        ({"brake": pack_column([0.0, 1.5])}, "its brake is 1.5; it has to be from 0 to 1"),
        ({"lane_change": pack_column([0.0, 2.0])}, "its lane_change is not 1"),
        ({"accelaration": pack_column([0.0, 1.0])}, "unknown key 'accelaration'; did you mean 'acceleration'"),
        ({"failures": [[2, "x"]]}, "has the row 2, but the step has 2 rows"),
        ({"failures": {"a": 1}}, "its failures are not a list of lists of 2 items"),
        ({"trajectories": [[0, pack_column([0.0]), pack_column([0.0]), pack_column([0.0])]]}, "at least two points"),
    ):
        with pytest.raises(ProtocolError, match=words):
            read_answer(answer, 2)


def test_the_client_is_python_3_7_and_needs_msgpack_only():
    tree = ast.parse((CLIENTS / "cornercase_client.py").read_text(), feature_version=(3, 7))
    modules = {
        name.name if isinstance(node, ast.Import) else node.module
        for node in ast.walk(tree)
        if isinstance(node, ast.Import | ast.ImportFrom)
        for name in node.names
    }
    assert {name for name in modules if name not in sys.stdlib_module_names} == {"msgpack"}


def test_the_clients_are_copied_by_a_command(tmp_path):
    command = [sys.executable, "-m", "cornercase.drivers.process", tmp_path / "here"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == [
        str(tmp_path / "here" / name) for name in ("cornercase_client.py", "cornercase_client.hpp")
    ]
    assert {file.name for file in (tmp_path / "here").iterdir()} == {"cornercase_client.py", "cornercase_client.hpp"}
    helped = subprocess.run([*command[:-1], "--help"], capture_output=True, text=True, check=True, cwd=tmp_path)
    assert "folder to copy them to" in helped.stdout
    assert [file.name for file in tmp_path.iterdir()] == ["here"]


def test_a_registered_name_is_a_driver_of_users(folder):
    assert "exec" in DRIVERS
    assert COLUMNS["leader_gap"].unit == "m"


CPP = """
#include <cmath>
#include <cstdio>
#include <stdexcept>
#include "cornercase_client.hpp"

struct Aeb {
    cornercase::Batch batch;

    void start(const cornercase::Batch &started) {
        batch = started;
        std::printf("a line that is no message\\n");
    }

    void step(const cornercase::Step &step, cornercase::Controls &controls) {
        const auto &gap = step.column("leader_gap"), &closing = step.column("leader_closing");
        for (std::size_t row = 0; row < step.size(); ++row) {
            std::size_t present = 0;
            for (std::size_t k = 0; k < step.others.size(); ++k)
                present += !std::isnan(step.of_other("other_x", row, k));
            const double limit = batch.option("time_to_brake", 1.5, step.scenarios[row]);
            const bool brakes = gap[row] < limit * closing[row];
            controls.acceleration[row] = brakes ? -8.0
                : 0.1 * step.column("path_heading")[row] + 0.01 * present - 0.001 * step.column("turn")[row];
            if (batch.option("lost", 0.0) > 0.0 && step.time > 0.99) controls.failures[row] = "lost";
            if (batch.option("thrown", 0.0) > 0.0) throw std::runtime_error("no gap");
        }
    }
};

int main() { return cornercase::serve(Aeb{}, {"leader_gap", "leader_closing", "other_x", "turn", "path_heading"}, {10.0},
                                     {"time_to_brake", "lost", "thrown"}); }
"""


@pytest.mark.skipif(shutil.which("g++") is None, reason="g++ is not installed")
def test_a_function_in_cpp_drives_as_the_same_class_does(folder):
    (folder / "aeb.cpp").write_text(CPP)
    warnings = ["-Wall", "-Wextra", "-Werror", "-std=c++17", "-O1"]
    subprocess.run(["g++", *warnings, "aeb.cpp", "-o", "aeb"], check=True)
    for one, other in zip(run(Aeb(2.0), 0.0, 2.0, 5.0), run("exec:./aeb:time_to_brake=2", 0.0, 2.0, 5.0), strict=True):
        assert same(one, other, within=1e-9)
    for option, words in (
        ("lost", r"t = 1 s: lost$"),
        ("thrown", r"t = 0 s: it ended with .* its last lines: .*no gap$"),
    ):
        (failed,) = Builtin(duration=2.0, drivers={"Ego": f"exec:./aeb:{option}=1"}).run(concretes(0.0))
        assert re.search(words, str(failed)), str(failed)
    with pytest.raises(InputError, match=r"has no option 'time_to_brak'; did you mean 'time_to_brake'"):
        run("exec:./aeb:time_to_brak=2", 0.0)
    (failed,) = Builtin(duration=2.0, drivers={"Ego": "exec:./aeb:time_to_brake=abc"}).run(concretes(0.0))
    assert str(failed).endswith("the option time_to_brake is 'abc', which is not a number")


EXAMPLES = X.parents[1] / "process"
RCLPY = '''
"""Stand-in for rclpy with an emergency brake as the node that listens."""

answers, listeners = [], []

def init(): pass
def create_node(name): return Node()
def spin_once(node, timeout_sec=None):
    if answers:
        listeners[0](answers.pop(0))

class Node:
    def create_publisher(self, kind, topic, depth):
        assert (kind.__name__, topic) == ("Float64MultiArray", "situation")
        return Publisher()
    def create_subscription(self, kind, topic, listener, depth):
        assert (kind.__name__, topic) == ("Float64", "acceleration")
        listeners.append(listener)

class Publisher:
    subscriptions = 0
    last_time = None
    def get_subscription_count(self):
        self.subscriptions += 1
        return self.subscriptions - 1
    def publish(self, message):
        from std_msgs.msg import Float64
        time, speed, gap, closing = message.data
        assert time == 0.0 or self.last_time < time < self.last_time + 0.06
        self.last_time = time
        answers.append(Float64(-8.0 if gap < 2.0 * closing else 0.0))
'''
STD_MSGS = """
class Float64:
    def __init__(self, data): self.data = data
class Float64MultiArray:
    def __init__(self, data): self.data = data
"""


class PlainAeb(cc.SystemUnderTest):
    def step(self, view, dt):
        leader = view.leader
        return -8.0 if leader is not None and leader.gap < 2.0 * leader.closing else 0.0


@pytest.mark.parametrize("command", at_night(["aeb.py", "aeb_numpy.py", "ros2_bridge.py", "./aeb"], {"./aeb"}))
def test_examples_of_the_page_drive_as_the_class_does(folder, monkeypatch, command):
    if command == "./aeb" and shutil.which("g++") is None:
        pytest.skip("g++ is not installed")
    for file in EXAMPLES.iterdir():
        shutil.copy(file, folder)
    for name, text in (("rclpy.py", RCLPY), ("std_msgs/__init__.py", ""), ("std_msgs/msg.py", STD_MSGS)):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text)
    if command == "./aeb":
        subprocess.run(["g++", "-std=c++17", "-Wall", "-Werror", "aeb.cpp", "-o", "aeb"], check=True)
    text = "exec:./aeb" if command == "./aeb" else spec(program=command)
    text += "" if command == "ros2_bridge.py" else ":time_to_brake=2"
    expected = run(PlainAeb(), 0.0, 3.0, duration=7.0)
    assert expected[1].acceleration[0].min() == pytest.approx(-8.0)
    assert all(same(one, other) for one, other in zip(expected, run(text, 0.0, 3.0, duration=7.0), strict=True))


def test_the_page_lists_all_columns():
    page = (ROOT / "docs" / "process.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)` \| (M(?:, [AK])?) \| (.*?) \| (.*?) \|$", page, re.MULTILINE)
    expected = [(c.name, c.shape, c.unit, c.meaning) for c in COLUMNS.values()]
    expected += [(name, "M, K", unit, meaning) for name, (unit, meaning) in PATH_COLUMNS.items()]
    assert rows == expected
    assert f"Version {PROTOCOL_VERSION}." in page


TWO_OPTIONS = """
from cornercase_client import Function, serve

class Brake(Function):
    def __init__(self, brake=1.0, after=0.0, mode="soft"):
        self.brake, self.after, self.mode = brake, after, mode

    def step(self, view, dt):
        return -self.brake if view.time >= self.after and self.mode == "nan" else 0.0

serve(Brake)
"""


def test_each_number_in_a_command_can_vary_and_other_options_stay_texts(folder):
    (folder / "two.py").write_text(TWO_OPTIONS)
    driver = driver_by_name(f"exec:{PYTHON} two.py:brake=1,after=0.5,mode=nan,timeout=5")
    simulator = Builtin(duration=2.0, drivers={"Ego": driver})
    values = ({"Ego.brake": 2.0, "Ego.after": 1.0}, {"Ego.brake": 3.0, "Ego.after": 0.0})
    for recording, given in zip(ran(simulator, [ConcreteScenario(X, own) for own in values]), values, strict=True):
        braking = recording.acceleration[0] < -0.5
        assert recording.time[braking.argmax()] == pytest.approx(given["Ego.after"] + 0.05)
        assert recording.acceleration[0][braking].min() == pytest.approx(-given["Ego.brake"])
    simulator.close()
    checked = cornercase("check", X, "--sut", f"Ego=exec:{PYTHON} two.py:brake=1,after=0.5,mode=nan,timeout=5")
    assert "timeout=5" in checked.stdout
    assert "brake=1, after=0.5, mode=nan" in checked.stdout
    assert "can be searched, as in --range Ego.brake=LOW:HIGH: brake, after" in checked.stdout


def test_the_reason_why_a_program_has_no_object_stays(folder):
    (folder / "two.py").write_text(TWO_OPTIONS.replace("serve(Brake)", "serve(lambda **options: Brake(**options))"))
    with pytest.raises(InputError, match="unexpected keyword argument 'brak'"):
        cc.simulate(X, duration=1.0, drivers={"Ego": f"exec:{PYTHON} two.py:brak=2"})


def test_an_option_that_the_program_does_not_have_is_refused(folder):
    (folder / "two.py").write_text(TWO_OPTIONS)
    for option, meant in (("brak=2", "brake"), ("timeuot=2", "timeout")):
        with pytest.raises(InputError, match=f"has no option '{option[:-2]}'; did you mean '{meant}'"):
            cc.simulate(X, duration=1.0, drivers={"Ego": f"exec:{PYTHON} two.py:{option}"})
    explore = (
        "explore", X, "--range", "Ego.brak=1:2", "--ego", "Ego", "--other", "Pedestrian", "--metric", "wttc", "--budget", 2,
        "--duration", 1, "-o", folder / "s.db", "--driver",
    )  # fmt: skip
    done = cornercase(*explore, f"Ego=exec:{PYTHON} two.py:brak=1")
    assert done.returncode == 2
    assert "has no option 'brak'; did you mean 'brake'?" in done.stderr
    done = cornercase(*explore, f"Ego=exec:{PYTHON} two.py")
    assert done.returncode == 2
    assert "only options that it is given can be searched, so add it as in" in done.stderr


def test_a_program_that_lists_no_options_gets_all_but_misspelt_ones_of_cornercase(folder):
    code = "client.serve(lambda **options: client.Function())"
    for option, meant in (
        ("timeuot", "timeout"),
        ("Log", "log"),
        ("start_timout", "start_timeout"),
        ("mutatons", "mutations"),
    ):
        with pytest.raises(InputError, match=f"has the option '{option}'; .* did you mean '{meant}'"):
            run(f"{answering(folder, code)}:{option}=3", 0.0)
    code = "class F(client.Function):\n    def step(self, view, dt): return 0.0\nclient.serve(lambda **options: F())"
    run(f"{answering(folder, code)}:start_time=3,lag=1,limit=2", 0.0, duration=1.0)


def test_a_path_sent_at_one_distance_is_the_same_at_all(folder):
    code = (
        "class F(client.Function):\n"
        "    def step(self, view, dt):\n"
        "        assert view.path(0.0) == view.path(10.0) == view.path(99.0)\n"
        "        return 0.0\n"
        "client.serve(lambda: F(), ahead=[10.0])"
    )
    run(answering(folder, code), 0.0, duration=1.0)


def test_the_columns_of_the_path_may_be_named(folder):
    code = (
        "class F(client.BatchFunction):\n"
        "    columns = ['speed', 'path_heading']\n"
        "    def step(self, step):\n"
        "        assert set(step.columns) == {'speed', 'path_x', 'path_y', 'path_heading', 'path_curvature'}\n"
        "        return {'acceleration': [0.0] * len(step.scenarios)}\n"
        "client.serve_batches(F(), ahead=[5.0, 10.0])"
    )
    run(answering(folder, code), 0.0, duration=1.0)


def test_a_program_that_decides_nothing_is_named(folder):
    code = (
        "class F(client.BatchFunction):\n"
        "    def step(self, step): return {'steering': [0.1] * len(step.scenarios)}\n"
        "client.serve_batches(F())"
    )
    (failed,) = Builtin(duration=1.0, drivers={"Ego": answering(folder, code)}).run(concretes(0.0))
    assert re.fullmatch(
        r"the driver of Ego \(exec:.*other\.py\) decided nothing at t = 0 s: it gave no acceleration, no throttle or"
        r" brake, and no trajectory",
        str(failed),
    )


def test_a_log_in_no_folder_is_refused(folder):
    with pytest.raises(InputError, match="there is no folder"):
        ProcessFunction(f"{PYTHON} my_function.py", log="nowhere/at/all.log")
