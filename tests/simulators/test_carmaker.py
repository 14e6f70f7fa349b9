"""The CarMaker adapter with a replacement for its command port, without CarMaker."""

from __future__ import annotations

import json
import re
import socket
import sys
import threading
import time
from contextlib import closing, suppress
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import psutil
import pytest

import cornercase as cc
from conftest import at_night, ran, same_recording
from cornercase._common.errors import InputError, NoticeWarning, SimulationError, SimulatorError
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import CarMaker
from cornercase.simulators._server_addresses import worker_address
from cornercase.simulators._server_process import ServerProcess
from cornercase.simulators.carmaker._cmapi_client import CmapiClient
from cornercase.simulators.carmaker._licences import Licence
from cornercase.simulators.carmaker._tcl_run import TclClient, TclTestRun
from cornercase.simulators.pool._simulator import WorkerSimulator
from cornercase.study import StudyFile
from helpers import foreign_recordings as foreign
from helpers.carla_or_stand_in import free_port
from helpers.carmaker_port import Port, write_testrun
from helpers.command_line import cornercase

# Entities without boxes; another test covers boxes.
pytestmark = pytest.mark.filterwarnings("ignore:.* ha(s|ve) no <BoundingBox>:UserWarning")

SAMPLE = Path(__file__).parents[3] / "shared" / "reference" / "simulators" / "carmaker" / "example.erg"
SCENARIO = """<?xml version="1.0"?>
<OpenSCENARIO>
  <FileHeader revMajor="1" revMinor="2" date="2026-11-21T00:00:00" author="a" description="parameters of a TestRun"/>
  <ParameterDeclarations>
    <ParameterDeclaration name="ego_speed" parameterType="double" value="50"/>
  </ParameterDeclarations>
  <Entities><ScenarioObject name="Ego"/><ScenarioObject name="T00"/></Entities>
  <Storyboard><Init><Actions/></Init><StopTrigger/></Storyboard>
</OpenSCENARIO>
"""


@pytest.fixture
def project(tmp_path):
    folder = tmp_path / "project"
    (folder / "SimOutput" / "pc").mkdir(parents=True)
    foreign.erg(folder / "SimOutput" / "pc" / "run.erg")
    write_testrun(folder)
    (tmp_path / "s.xosc").write_text(SCENARIO)
    return folder


@pytest.fixture
def quick(monkeypatch):
    """Short time-outs, since the awaited event never comes."""
    plain = TclTestRun.__init__

    def init(self, client, project, run_timeout, quantities, **options):
        assert run_timeout == 120.0
        plain(self, client, project, 0.5, quantities, start_timeout=0.6, **options)

    monkeypatch.setattr(TclTestRun, "__init__", init)


def run(project, port, values=None, **options):
    port.project = project
    options = {"hosts": "127.0.0.1", "port": port.number} | options
    simulator = CarMaker(testrun="Crossing", project=str(project), **options)
    try:
        (found,) = simulator.run([ConcreteScenario(project.parent / "s.xosc", values or {"ego_speed": 42.5})])
    finally:
        simulator.close()
    return found


@pytest.mark.parametrize("pieces", [1, 2, 3, 1000])
def test_a_run_from_end_to_end_however_the_answers_are_split(project, pieces):
    port = Port(pieces=pieces)
    found = run(project, port)
    assert found.names == ("Ego", "T00")
    np.testing.assert_allclose(found.speed[0], 42.5, atol=1e-4)
    commands = [command.partition(" ")[0] for command in port.asked]
    assert commands == [
        "SimStatus", "LoadTestRun", "OutQuantsAdd", "NamedValue", "SaveMode", "StartSim", "WaitForStatus", "SimStatus", "WaitForStatus",
        "SimStatus", "GetLastResultFName",
    ]  # fmt: skip
    assert port.asked[1] == 'LoadTestRun "Crossing"'
    assert port.asked[2] == (
        "OutQuantsAdd {Time Car.tx Car.ty Car.Yaw Car.v Sensor.Collision.Vhcl.Fr1.Count Traffic.T00.tx Traffic.T00.ty"
        " Traffic.T00.rz Traffic.T00.LongVel Traffic.T00.v_0.x Traffic.T00.v_0.y}"
    )
    assert port.asked[3] == "NamedValue set ego_speed 42.5"
    port.close()


def test_results_of_workers_that_share_a_project_are_not_mixed_up(project):
    """Both CarMakers name their results alike, as real ones do that begin in the same second."""
    ports = [Port(pieces=1000), Port(pieces=1000)]
    hosts = "+".join(f"127.0.0.1:{port.number}" for port in ports)
    for worker, port in enumerate(ports):
        assert run(project, port, worker=worker, hosts=hosts).names == ("Ego", "T00")
        port.close()
    assert {path.name for path in (project / "SimOutput" / "pc").glob("run1*.erg")} == {"run1.erg", "run1_worker1.erg"}
    assert not any(command.startswith("SetResultFName") for command in ports[0].asked)
    assert 'SetResultFName "%o/%r/%D/%f_%T_worker1%?_s"' in ports[1].asked


def test_workers_that_cannot_name_their_results_need_a_project_each(project):
    port = Port(odd={"SetResultFName": 'Einvalid command name "SetResultFName"\r\n\r\n'})
    hosts = f"127.0.0.1:{port.number}+127.0.0.1:{port.number}"
    with pytest.raises(
        InputError, match=r"several workers use this project, and .* give each worker its own project, as project=A"
    ):
        run(project, port, worker=1, hosts=hosts)
    assert "StartSim" not in port.asked
    port.project = project.parent / "other"
    (port.project / "SimOutput" / "pc").mkdir(parents=True)
    with (
        closing(CarMaker(testrun="Crossing", project=f"{project}+{port.project}", worker=1, hosts=hosts)) as simulator,
        pytest.warns(NoticeWarning),
    ):
        (found,) = ran(simulator, [ConcreteScenario(project.parent / "s.xosc", {"ego_speed": 3.0})])
    assert found.names == ("Ego", "T00")
    port.close()


SPEEDS = (10.0, 20.0, 30.0)


@pytest.mark.parametrize("waits", at_night(["waits", "at once", "error"], {"waits", "error"}))
@pytest.mark.parametrize("course", [(-1, -5, 0, 0, -3), (-10, -11, -1, -4, 3), (), (-3,), (5,)])
def test_three_speeds_give_three_recordings_however_the_waits_end(project, waits, course):
    # Without any state it is idle again before the first poll.
    port = Port(waits=waits, course=course)
    found = [run(project, port, {"ego_speed": speed}) for speed in SPEEDS]
    assert [one.speed[0, 0] for one in found] == pytest.approx(SPEEDS)
    port.close()


@pytest.mark.parametrize("waits", at_night(["waits", "at once", "error"], {"waits", "error"}))
@pytest.mark.parametrize(
    ("behaviour", "words"),
    [
        ({"course": None}, r"did not start the TestRun within 0\.6 s: it is idle"),
        (
            {"course": (-1, *[-5] * 10_000)},
            r"did not start the TestRun within 0\.6 s: it is adapting its driver \(-5\)",
        ),
        ({"course": (0, *[-8] * 10_000)}, "has paused the TestRun"),
        ({"course": [-8] * 10_000}, r"it is paused \(-8\)"),
        ({"course": [1] * 10_000}, "did not end the TestRun within"),
        ({"course": (1, *[-3] * 10_000)}, "did not end the TestRun within"),
        ({"course": (1, *[-6] * 10_000)}, "ended the TestRun with a fatal error"),
        ({"course": (-1, *[-6] * 10_000)}, "ended the TestRun with a fatal error"),
        ({"write": lambda path, values: None}, "did not begin|cannot be read|stored no result file"),
        ({"odd": {"GetLastResultFName": "OSimOutput/pc/run.erg\r\n\r\n"}}, "but it is older than this run"),
    ],
)
def test_an_old_result_is_never_taken_for_a_new_one(project, quick, waits, behaviour, words):
    port = Port(waits=waits, **behaviour)
    for speed in SPEEDS[:2]:
        found = run(project, port, {"ego_speed": speed})
        assert isinstance(found, SimulationError), found
        assert re.search(words, str(found)), str(found)
    port.close()


def test_the_time_limit_of_a_run_is_waited_for_once(project):
    port = Port(waits="in full", course=[1] * 10_000)
    with (
        closing(TclClient("127.0.0.1", port.number)) as line,
        pytest.raises(SimulationError, match=r"did not end the TestRun within 0\.2 s"),
    ):
        TclTestRun(line, project, 0.2, start_timeout=1.0).run_testrun("Crossing", {})
    after = port.asked[port.asked.index("WaitForStatus idle 200") + 1 :]
    assert after[:2] == ["SimStatus", "StopSim"]
    port.close()


def test_what_is_still_running_is_stopped_first(project):
    port = Port(state=(7, 7, 7, 7))
    assert run(project, port).speed[0, 0] == pytest.approx(42.5)
    assert [one.partition(" ")[0] for one in port.asked[:4]] == ["SimStatus", "StopSim", "WaitForStatus", "SimStatus"]
    port.close()


def test_a_carmaker_that_does_not_stop_is_left(project, quick):
    port = Port(odd={"SimStatus": "O7\r\n\r\n"})
    found = run(project, port)
    assert isinstance(found, SimulatorError)
    assert "is not idle but running (7), even 0.6 s after StopSim" in str(found)
    assert not any(one.startswith(("LoadTestRun", "StartSim")) for one in port.asked)
    port.close()


def test_boxes_and_kinds_come_from_the_scenario(project, recwarn):
    path = project.parent / "s.xosc"
    body = """<{0} {1}><BoundingBox><Center x="1" y="0" z="1"/><Dimensions length="{2}" width="{3}" height="1"/>
</BoundingBox></{0}>"""
    truck = body.format("Vehicle", 'name="t" vehicleCategory="truck"', "$long", 2.5)
    walker = body.format("Pedestrian", 'name="p" mass="80" pedestrianCategory="pedestrian"', 0.5, 0.6)
    text = SCENARIO.replace('<ScenarioObject name="Ego"/>', f'<ScenarioObject name="Ego">{truck}</ScenarioObject>')
    text = text.replace('<ScenarioObject name="T00"/>', f'<ScenarioObject name="T00">{walker}</ScenarioObject>')
    declared = '<ParameterDeclaration name="long" parameterType="double" value="10"/></ParameterDeclarations>'
    path.write_text(text.replace("</ParameterDeclarations>", declared))
    port = Port()
    found = run(project, port, {"ego_speed": 8.0, "long": 12.0})
    assert found.object_types == ("truck", "pedestrian")
    assert found.length.tolist() == [12.0, 0.5]
    assert found.width.tolist() == [2.5, 0.6]
    # The position in the file is the middle of the rear end.
    np.testing.assert_allclose([found.x[0, 0], found.y[0, 0]], foreign.way(0.0, 6.0), atol=1e-6)
    assert not [one for one in recwarn if issubclass(one.category, NoticeWarning)]
    port.close()


def test_who_has_no_box_is_said(project):
    port = Port()
    with pytest.warns(NoticeWarning, match=r"s\.xosc: Ego, T00 have no <BoundingBox>"):
        found = run(project, port)
    assert found.length.tolist() == [4.5, 4.5]
    port.close()


def test_values_are_one_tcl_word(project):
    port = Port()
    run(project, port, {"ego_speed": -1.5e-7, "weather": "heavy rain; exit"})
    assert port.asked[3:5] == ["NamedValue set ego_speed -1.5e-07", "NamedValue set weather {heavy rain; exit}"]
    found = run(project, port, {"weather": "} exit {"})
    assert "Tcl" in str(found)
    port.close()


@pytest.mark.parametrize(
    ("odd", "words", "lost"),
    [
        (
            {"LoadTestRun": "Eno such TestRun\r\n\r\n"},
            "CarMaker refuses 'LoadTestRun \"Crossing\"': no such TestRun",
            False,
        ),
        ({"StartSim": "close"}, "CarMaker closed the connection while answering 'StartSim'", True),
        ({"GetLastResultFName": "Ocut"}, "CarMaker closed the connection while answering 'GetLastResultFName'", True),
        ({"SimStatus": "O-6\r\n\r\n"}, "is not idle but stopped by a fatal error (-6)", True),
        ({"SimStatus": "Owell\r\n\r\n"}, "reports the status 'well', which is not a number", False),
        ({"GetLastResultFName": "O\r\n\r\n"}, "stored no result file", False),
        ({"GetLastResultFName": "OSimOutput/none.erg\r\n\r\n"}, "cannot be read", False),
    ],
)
def test_what_goes_wrong_costs_the_scenario_alone(project, quick, odd, words, lost):
    port = Port(odd=odd)
    found = run(project, port)
    assert isinstance(found, SimulationError)
    assert words in str(found)
    assert isinstance(found, SimulatorError) == lost
    port.close()


@pytest.mark.parametrize("course", [[-7] * 10_000, [-1, *[-7] * 10_000], [3, *[-7] * 10_000]])
def test_a_lost_licence_stops_all_and_says_so(project, course):
    port = Port(course=course)
    with pytest.raises(InputError, match="waits for a licence"):
        run(project, port)
    port.close()


def test_a_silent_port_is_given_up():
    port = Port(odd={"SimStatus": "silence"})
    with closing(TclClient("127.0.0.1", port.number)) as line, pytest.raises(SimulatorError, match=r"within 0\.2 s"):
        line.send("SimStatus", 0.2)
    port.close()


def test_nobody_listens(project):
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = SimpleNamespace(number=free.getsockname()[1])
    with pytest.raises(InputError, match=r"No CarMaker listens on 127\.0\.0\.1:\d+ .*start it with -cmdport"):
        run(project, port)


def test_a_broken_line_is_tried_again_on_a_new_one(project):
    port = Port(odd={"StartSim": ["close"]})
    port.project = project
    options = {"testrun": "Crossing", "project": str(project), "hosts": "127.0.0.1", "port": port.number}
    simulator = WorkerSimulator("carmaker", options)
    found = ran(simulator, [ConcreteScenario(project.parent / "s.xosc", {"ego_speed": float(k)}) for k in range(3)])
    simulator.close()
    assert [one.names for one in found] == [("Ego", "T00")] * 3
    assert [one for one in port.asked if one.startswith("NamedValue")] == [
        f"NamedValue set ego_speed {k}" for k in (0, 0, 1, 2)
    ]
    port.close()


def test_a_truncated_result_costs_the_scenario_alone(project):
    whole = (project / "SimOutput" / "pc" / "run.erg").read_bytes()
    about = (project / "SimOutput" / "pc" / "run.erg.info").read_bytes()
    parts = iter(range(10))

    def write(path, values):
        path.write_bytes(whole[: len(whole) * next(parts) // 10 + 3])
        path.with_name(path.name + ".info").write_bytes(about)

    port = Port(write=write)
    for tenth in range(10):
        found = run(project, port)
        assert isinstance(found, SimulationError), tenth
        assert f"run{tenth + 1}.erg" in str(found)
    port.close()


def test_explores(project):
    port = Port()
    port.project = project
    study = project.parent / "s.db"
    done = cornercase(
        "explore", project.parent / "s.xosc", "--range", "ego_speed=30:60", "--ego", "Ego", "--other", "T00", "--metric",
        "distance", "--optimizer", "sobol", "--budget", "4", "-o", study,
        "--simulator", f"carmaker:testrun=Crossing,project={project},hosts=127.0.0.1,port={port.number}",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert sum(one.startswith("StartSim") for one in port.asked) == 4
    port.close()


SHEET = SCENARIO.replace(
    "</ParameterDeclarations>",
    """  <ParameterDeclaration name="gap" parameterType="double" value="${$ego_speed / 3.6}"/>
    <ParameterDeclaration name="lanes" parameterType="integer" value="2"/>
    <ParameterDeclaration name="weather" parameterType="string" value="heavy rain"/>
    <ParameterDeclaration name="lights" parameterType="boolean" value="true"/>
  </ParameterDeclarations>""",
)


def sent(asked):
    """Named values of each run."""
    runs: list[list[str]] = []
    for command in asked:
        if command.startswith("LoadTestRun"):
            runs.append([])
        elif command.startswith("NamedValue"):
            runs[-1].append(command)
    return runs


@pytest.mark.filterwarnings("ignore::cornercase._common.errors.NoticeWarning")
def test_42_1_a_suite_sends_the_named_values_that_it_was_made_of(project, monkeypatch):
    folder = project.parent
    (folder / "s.xosc").write_text(SHEET)
    port = Port(pieces=1000, course=(), write=lambda path, values: foreign.erg(path, speed=float(values["ego_speed"])))
    port.project = project
    monkeypatch.chdir(folder)
    simulator = (
        "--simulator",
        f"carmaker:testrun=Crossing,project={project},hosts=127.0.0.1,port={port.number},via=port",
    )
    about = ("--ego", "Ego", "--other", "T00", "--metric", "distance", "--optimizer", "sobol", "--budget", "4")
    ranges = ("--range", "ego_speed=30:60", "--range", "lanes=1:4")

    def said(*words):
        done = cornercase(*words, *(simulator if words[0] in ("explore", "test") else ()))
        assert done.returncode == 0, done.stderr
        asked, port.asked = sent(port.asked), []
        return asked

    explored = said("explore", "s.xosc", *ranges, *about, "-o", "s.db")
    assert len(explored) == 4
    assert {len(one) for one in explored} == {5}
    assert "NamedValue set weather {heavy rain}" in explored[0]
    said("analyze", "s.db", "--by", "ego-speed")
    said("reduce", "s.db", "--by", "ego-speed", "-o", "set", "--size", "3")
    manifest = json.loads((folder / "set" / "manifest.json").read_text())
    made_of = [explored[one["id"] - 1] for one in manifest["scenarios"]]
    assert len({tuple(one) for one in made_of}) == 3
    assert said("test", "set", "-o", "run.db") == made_of
    with (
        StudyFile.open(folder / "run.db", readonly=True) as again,
        StudyFile.open(folder / "s.db", readonly=True) as before,
    ):
        for row, one in zip(again.rows(), manifest["scenarios"], strict=True):
            assert same_recording(again.recording(row.id), before.recording(one["id"]))
    port.close()


@pytest.mark.filterwarnings("ignore::cornercase._common.errors.NoticeWarning")
def test_42_1_a_suite_gives_ipgs_module_the_named_values_too(cmapi, project):
    folder = project.parent
    (folder / "s.xosc").write_text(SHEET)
    simulator = f"carmaker:testrun=Crossing,project={project},via=cmapi"
    cc.explore(
        folder / "s.xosc", folder / "s.db", ranges=["ego_speed=30:60"], ego="Ego", other="T00", metrics=["distance"],
        optimizer="sobol", budget=4, simulator=simulator,
    )  # fmt: skip
    cc.analyze(folder / "s.db", "ego-speed")
    kept = cc.reduce(folder / "s.db", folder / "set", by="ego-speed", size=2)
    ran = cc.run_suite(folder / "set", folder / "run.db", simulator=simulator)
    assert all(one.difference is not None and one.difference.same for one in ran.scenarios)
    said = [json.loads(one) for one in (project / "said.txt").read_text().splitlines() if one.startswith("{")]
    assert said[4:] == [said[one.id - 1] for one in kept.scenarios]
    assert said[0] == {
        "ego_speed": said[0]["ego_speed"], "gap": pytest.approx(said[0]["ego_speed"] / 3.6, abs=1e-6), "lanes": 2,
        "weather": "heavy rain", "lights": "true",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"testrun": ""}, "needs a TestRun"),
        ({"project": "/no/such/folder"}, "no such folder"),
        ({"testrun": "a[exit]"}, "a special character of Tcl"),
        ({"port": 0}, "localhost:0 is not a valid address"),
        ({"drivers": {"Ego": "normal"}}, "`drivers` Ego: no driver of cornercase drives in CarMaker"),
        ({"on_collision": "halt"}, "`on_collision` halt"),
        ({"licences": -1}, "give a number of CarMakers from 1 on"),
        ({"start": "CM.exe", "via": "port"}, "write {port} where the port belongs"),
        ({"start": "CM.exe -cmdport {port}", "hosts": "far", "via": "port"}, "on this machine, not on far"),
        ({"speedup": 0.0}, "both must be above 0"),
    ],
)
def test_refuses_in_one_sentence(tmp_path, options, words):
    with pytest.raises(InputError, match=words):
        CarMaker(**({"testrun": "a", "project": str(tmp_path)} | options))
    # Only the refused option is wrong: the rest can be used.
    assert str(CarMaker(testrun="a", project=str(tmp_path))) == f"carmaker:testrun=a,project={tmp_path}"


@pytest.mark.skipif(not SAMPLE.is_file(), reason="the real sample is not beside the checkout")
def test_a_real_result_without_positions_says_what_to_store(project):
    def write(path, values):
        for ending in ("", ".info"):
            path.with_name(path.name + ending).write_bytes(SAMPLE.with_name(SAMPLE.name + ending).read_bytes())

    port = Port(write=write)
    found = run(project, port)
    assert isinstance(found, SimulationError)
    assert "has no Car.tx, Car.ty, Car.Yaw, Car.v; add it to the quantities that CarMaker stores." in str(found)
    port.close()


def test_entities_that_carmaker_does_not_have_are_refused(project):
    path = project.parent / "s.xosc"
    path.write_text(SCENARIO.replace('"T00"', '"Pedestrian"'))
    with pytest.raises(InputError, match=r"'Pedestrian' is not an entity of CarMaker; .* Ego, T00, T01"):
        run(project, Port())


@pytest.fixture
def cmapi(monkeypatch, project):
    """A replacement for IPG's module with configurable failures."""
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "fake_cmapi"))

    def wrong(what):
        monkeypatch.setenv("FAKE_CMAPI", what)
        sys.modules.pop("cmapi", None)

    wrong("")
    yield wrong
    sys.modules.pop("cmapi", None)


def test_ipgs_module_is_taken_where_it_is_there_and_starts_carmaker_once(cmapi, project):
    simulator = CarMaker(testrun="Crossing", project=str(project))
    concretes = [ConcreteScenario(project.parent / "s.xosc", {"ego_speed": speed}) for speed in (42.5, 50.0)]
    for found, speed in zip(ran(simulator, concretes), (42.5, 50.0), strict=True):
        assert found.names == ("Ego", "T00")
        np.testing.assert_allclose(found.speed[0], speed, atol=1e-4)
    said = (project / "said.txt").read_text().splitlines()
    # A finished run is closed before the next one is configured.
    assert said == ["connected", '{"ego_speed": 42.5}', "stopped", '{"ego_speed": 50.0}']
    process = simulator._api._master.process  # type: ignore[union-attr]
    assert process.poll() is None
    simulator.close()
    assert process.wait(120) is not None
    with pytest.raises(
        InputError, match=r"each worker needs its own CarMaker project, and the number of projects given is 1; give"
    ):
        CarMaker(testrun="Crossing", project=str(project), worker=1)
    CarMaker(testrun="Crossing", project=f"{project}+{project.parent}", worker=1)
    # The port can still be chosen.
    port = Port()
    assert run(project, port, via="port").names == ("Ego", "T00")
    port.close()


@pytest.mark.parametrize(
    ("wrong", "kind", "words"),
    [
        (
            "raise",
            SimulatorError,
            "cmapi, the Python package of CarMaker, failed with RuntimeError: the application is gone",
        ),
        ("hang", SimulationError, "CarMaker did not end the TestRun within 2 s"),
        (
            "hang on",
            SimulatorError,
            "CarMaker did not end the TestRun within 2 s, and did not stop it within another 0.3 s",
        ),
        ("no file", SimulationError, "CarMaker wrote 0 result files in SimOutput instead of one"),
    ],
)
def test_what_goes_wrong_by_ipgs_module_is_one_sentence(cmapi, project, wrong, kind, words):
    cmapi(wrong)
    control = CmapiClient(project, "Crossing", 2.0, end_timeout=0.3 if wrong == "hang on" else 5.0)
    with pytest.raises(kind) as caught:
        control.run_testrun("Crossing", {"ego_speed": 42.5})
    assert words in str(caught.value)
    assert ("stopped" in (project / "said.txt").read_text()) == wrong.startswith("hang")
    control.close()


def test_a_module_that_does_not_answer_is_said(cmapi, project):
    cmapi("deaf")
    control = CmapiClient(project, "Crossing", 2.0, end_timeout=0.3)
    with pytest.raises(SimulatorError, match=r"CarMaker, does not answer$"):
        control.run_testrun("Crossing", {"ego_speed": 7.0})
    control.close()


def test_a_run_of_somebody_else_is_stopped_before_ours_is_configured(cmapi, project):
    cmapi("busy")
    control = CmapiClient(project, "Crossing", 60.0)
    assert control.run_testrun("Crossing", {"ego_speed": 7.0}).is_file()
    assert (project / "said.txt").read_text().splitlines()[:2] == ["connected", "stopped"]
    control.close()


def test_a_carmaker_that_does_not_come_to_rest_is_left(cmapi, project):
    cmapi("restless")
    control = CmapiClient(project, "Crossing", 60.0, end_timeout=0.3)
    with pytest.raises(SimulatorError, match="did not become idle within"):
        control.run_testrun("Crossing", {"ego_speed": 7.0})
    control.close()


@pytest.mark.parametrize(
    ("wrong", "words"),
    [("start", r"does not start with IPG's cmapi \(no licence\).*carmaker:via=port"), ("slow start", "no answer")],
)
def test_a_carmaker_that_does_not_start_by_ipgs_module_is_said_and_ended(cmapi, project, wrong, words):
    cmapi(wrong)
    begun = _begun_processes()
    with pytest.raises(InputError, match=words):
        CmapiClient(project, "Crossing", 0.5 if wrong == "slow start" else 60.0)
    left = [psutil.Process(one) for one in _begun_processes() - begun]
    assert not psutil.wait_procs(left, timeout=120)[1]


def test_a_testrun_that_is_not_there_is_said(cmapi, project):
    with pytest.raises(InputError, match="no TestRun Nowhere"):
        CmapiClient(project, "Nowhere", 60.0)


def test_a_carmaker_that_does_not_end_is_ended_by_force(cmapi, project):
    cmapi("stays")
    control = CmapiClient(project, "Crossing", 60.0, end_timeout=0.3)
    process = control._master.process
    control.close()
    assert process.wait(120) is not None


def _begun_processes():
    alive = set()
    for one in psutil.Process().children():
        # The process may have ended meanwhile.
        with suppress(psutil.NoSuchProcess):
            if one.status() not in (psutil.STATUS_ZOMBIE, psutil.STATUS_DEAD):
                alive.add(one.pid)
    return alive


def test_a_way_that_is_not_there_is_refused(project):
    with pytest.raises(InputError, match=r"cmapi cannot be imported.*carmaker:via=port"):
        CarMaker(testrun="Crossing", project=str(project), via="cmapi")
    with pytest.raises(InputError, match="did you mean 'port'"):
        CarMaker(testrun="Crossing", project=str(project), via="prot")  # type: ignore[arg-type]


_BARE = '<ScenarioObject name="Ego"/>'


def declare(project, *parameters, entities=""):
    """A scenario file with more parameters."""
    declared = "".join(f'<ParameterDeclaration name="{one}" parameterType="double" value="1"/>' for one in parameters)
    text = SCENARIO.replace("</ParameterDeclarations>", f"{declared}</ParameterDeclarations>")
    (project.parent / "s.xosc").write_text(text.replace('<ScenarioObject name="Ego"/>', entities or _BARE))


def test_a_value_that_the_testrun_does_not_use_is_refused_before_anything_runs(project):
    declare(project, "gpa")
    port = Port()
    done = cornercase(
        "explore", project.parent / "s.xosc", "--range", "gpa=1:4", "--ego", "Ego", "--other", "T00", "--metric",
        "distance", "--budget", "4", "-o", project.parent / "s.db",
        "--simulator", f"carmaker:testrun=Crossing,project={project},hosts=127.0.0.1,port={port.number}",
    )  # fmt: skip
    assert done.returncode == 2
    assert "Crossing (of CarMaker 8.0.2): this TestRun does not use the named value gpa" in done.stderr
    assert "write $gpa=0 where the TestRun shall use the value" in done.stderr
    assert not port.asked
    assert not (project.parent / "s.db").exists()
    port.close()
    declare(project)
    with pytest.raises(InputError, match="named value weight of the search"):
        run(project, port, {"ego_speed": 3.0, "weight": 1.0})


def test_a_value_in_the_vehicle_data_set_or_in_a_box_is_used(project):
    ego = """<ScenarioObject name="Ego"><Vehicle name="e" vehicleCategory="car"><BoundingBox><Center x="1" y="0" z="1"/>
<Dimensions length="$long" width="2" height="1"/></BoundingBox></Vehicle></ScenarioObject>"""
    declare(project, "mass", "long", entities=ego)
    port = Port()
    assert run(project, port, {"ego_speed": 3.0, "mass": 1800.0, "long": 5.0}).length[0] == 5.0
    assert "NamedValue set mass 1800" in port.asked
    port.close()


_WALK = """<Storyboard><Init><Actions><Private entityRef="Ego"><PrivateAction><LongitudinalAction><SpeedAction>
<SpeedActionTarget><AbsoluteTargetSpeed value="$gap_to_leader"/></SpeedActionTarget></SpeedAction></LongitudinalAction>
</PrivateAction></Private></Actions></Init><StopTrigger/></Storyboard>"""


def test_a_value_that_only_the_storyboard_uses_is_refused_as_carmaker_reads_no_storyboard(project):
    ego = """<ScenarioObject name="Ego"><Vehicle name="e" vehicleCategory="car"><BoundingBox><Center x="1" y="0" z="1"/>
<Dimensions length="5" width="2" height="1"/></BoundingBox><Performance maxSpeed="$top" maxAcceleration="9"
maxDeceleration="9"/></Vehicle></ScenarioObject>"""
    declare(project, "gap_to_leader", "top", entities=ego)
    path = project.parent / "s.xosc"
    path.write_text(re.sub("<Storyboard>.*</Storyboard>", _WALK, path.read_text()))
    port = Port()
    with pytest.raises(InputError, match="does not use the named value gap_to_leader, top of"):
        run(project, port)
    port.close()


def test_what_a_description_mentions_is_not_used(project):
    declare(project, "gpa")
    path = project / "Data" / "TestRun" / "Crossing"
    path.write_text(path.read_text().replace("without anything", "once with $gpa=3"))
    port = Port()
    with pytest.raises(InputError, match="does not use the named value gpa"):
        run(project, port)
    port.close()


@pytest.mark.parametrize("encoding", ["latin-1", "utf-8", "utf-8-sig"])
def test_files_with_umlauts_are_followed_in_each_encoding(project, encoding):
    declare(project, "mass")
    testrun, vehicle = project / "Data" / "TestRun" / "Crossing", project / "Data" / "Vehicle" / "Examples" / "MyCar"
    testrun.write_text(testrun.read_text().replace("Examples/MyCar", "Prüfling 2/MyCar"), encoding)
    (project / "Data" / "Vehicle" / "Prüfling 2").mkdir()
    vehicle.rename(project / "Data" / "Vehicle" / "Prüfling 2" / "MyCar")
    port = Port()
    assert run(project, port).names == ("Ego", "T00")
    port.close()


@pytest.mark.parametrize("name", ["a[exit]", 'a"; exit; "', "$a", "a;b"])
def test_the_name_of_a_scenario_file_is_no_tcl(project, name):
    path = project.parent / f"{name}.xosc"
    path.write_text(SCENARIO)
    port = Port()
    simulator = CarMaker(testrun="{scenario}", project=str(project), hosts="127.0.0.1", port=port.number)
    with pytest.raises(InputError, match="contains a special character of Tcl"):
        ran(simulator, [ConcreteScenario(path, {"ego_speed": 1.0})])
    assert not port.asked
    port.close()


def test_a_trailer_is_said_not_to_be_in_the_recording(project):
    write_testrun(project, "Trailer = Examples/Caravan")
    port = Port()
    with pytest.warns(NoticeWarning, match="Crossing: has the trailer Examples/Caravan, which is in no recording"):
        assert run(project, port).names == ("Ego", "T00")
    port.close()


def test_licences_that_cannot_be_counted_are_one_sentence(project, monkeypatch):
    (project.parent / "cache").touch()
    monkeypatch.setattr("cornercase.simulators.carmaker._licences.user_cache_folder", lambda: project.parent / "cache")
    port = Port()
    with pytest.raises(InputError, match=r"licences=1: .*cache.* cannot be written"):
        run(project, port, licences=1)
    port.close()


def test_a_testrun_elsewhere_is_not_checked_and_that_is_said(project):
    (project / "Data" / "TestRun" / "Crossing").unlink()
    port = Port()
    with pytest.warns(
        NoticeWarning, match="Crossing: does not exist, so cornercase cannot check whether .* uses ego_speed"
    ):
        assert run(project, port).names == ("Ego", "T00")
    port.close()


TRAFFIC = ("Traffic.0.Name = T00", "Traffic.0.ObjectClass = Truck", "Traffic.0.Basics.Dimension = 9.5 2.4 3")


def test_boxes_come_from_the_vehicle_data_set_and_the_testrun(project, recwarn):
    write_testrun(project, *TRAFFIC, vehicle="Vehicle.OuterSkin = -0.1 0.85 0.2 4.05 -0.85 1.6")
    port = Port()
    found = run(project, port)
    np.testing.assert_allclose(found.length, [4.15, 9.5])
    np.testing.assert_allclose(found.width, [1.7, 2.4])
    assert found.object_types == ("car", "truck")
    # From 0.1 m behind the position in the file to 4.05 m before it.
    np.testing.assert_allclose([found.x[0, 0], found.y[0, 0]], foreign.way(0.0, 1.975), atol=1e-6)
    assert not [one for one in recwarn if issubclass(one.category, NoticeWarning)]
    port.close()


def test_a_box_of_the_scenario_file_that_is_not_the_vehicles_is_said(project):
    write_testrun(project, vehicle="Vehicle.OuterSkin = 0 0.9 0.2 4.5 -0.9 1.6")
    ego = """<ScenarioObject name="Ego"><Vehicle name="e" vehicleCategory="car"><BoundingBox><Center x="1" y="0" z="1"/>
<Dimensions length="5" width="2" height="1"/></BoundingBox></Vehicle></ScenarioObject>"""
    declare(project, entities=ego)
    port = Port()
    with pytest.warns(NoticeWarning, match=r"box of Ego is 5 m x 2 m, and in the files of the TestRun 4\.5 m x 1\.8 m"):
        assert run(project, port).length[0] == 5.0
    port.close()


def approaching(path, values, **more):
    """T00 stands 20 m ahead of an ego at 8 m/s, whose front is 4.5 m ahead of its position."""
    other_x, other_y = foreign.way(0.0 * foreign.TIME, 0.0)
    ahead = 20.0
    columns = {
        "Traffic.T00.tx": ("Double", other_x + ahead * np.cos(foreign.HEADING)),
        "Traffic.T00.ty": ("Double", other_y + ahead * np.sin(foreign.HEADING)),
        "Traffic.T00.rz": ("Double", 0 * foreign.TIME + foreign.HEADING),
        "Traffic.T00.LongVel": ("Double", 0 * foreign.TIME),
    }
    foreign.erg(path, more=columns | more)


def test_collisions_come_from_boxes_and_may_end_the_recording(project):
    port = Port(write=approaching)
    found = run(project, port)
    (collision,) = found.collisions
    assert collision.entities == ("Ego", "T00")
    # 15.5 m at 8 m/s.
    assert collision.time == pytest.approx(2.0)
    assert found.time[-1] == pytest.approx(4.0)
    stopped = run(project, port, on_collision="stop")
    assert stopped.time[-1] == pytest.approx(2.0)
    assert stopped.collisions == found.collisions
    port.close()


def test_a_collision_sensor_counts(project):
    # Its sensor sees the contact 0.1 s before the boxes touch, and later hits nobody that is known.
    count = (foreign.TIME > 1.85).astype(int) + (foreign.TIME > 3.85)
    port = Port(
        write=lambda path, values: approaching(path, values, **{"Sensor.Collision.Vhcl.Fr1.Count": ("Int", count)})
    )
    assert [round(one.time, 6) for one in run(project, port).collisions] == [1.9]
    port.close()
    far = {"Sensor.Collision.Vhcl.Fr1.Count": ("Int", count)}
    port = Port(write=lambda path, values: foreign.erg(path, more=far))
    assert run(project, port).collisions == ()
    port.close()


def test_a_version_that_takes_no_output_quantities_runs_on(project):
    port = Port(odd={"OutQuantsAdd": 'Einvalid command name "OutQuantsAdd"\r\n\r\n'})
    assert run(project, port).names == ("Ego", "T00")
    port.close()


def test_ipgs_module_is_told_what_to_store(cmapi, project):
    with closing(CarMaker(testrun="Crossing", project=str(project))) as simulator:
        ran(simulator, [ConcreteScenario(project.parent / "s.xosc", {"ego_speed": 9.0})])
    stored = (project / "quantities.txt").read_text().split()
    assert {"Time", "Car.tx", "Traffic.T00.ty", "Sensor.Collision.Vhcl.Fr1.Count"} <= {*stored}


def test_failsafe_is_left_before_the_next_run(project):
    port = Port(state=[-6] * 10_000)
    assert run(project, port).speed[0, 0] == pytest.approx(42.5)
    assert [one.partition(" ")[0] for one in port.asked[:2]] == ["SimStatus", "StopSim"]
    port.close()


def test_a_carmaker_that_ipgs_module_has_lost_is_started_again(cmapi, project):
    cmapi("raise once")
    options = {"testrun": "Crossing", "project": str(project)}
    simulator = WorkerSimulator("carmaker", options)
    concretes = [ConcreteScenario(project.parent / "s.xosc", {"ego_speed": speed}) for speed in (20.0, 30.0)]
    found = ran(simulator, concretes)
    simulator.close()
    assert [one.speed[0, 0] for one in found] == pytest.approx([20.0, 30.0])
    said = (project / "said.txt").read_text().splitlines()
    assert said.count("connected") == 2
    assert [json.loads(one)["ego_speed"] for one in said if one.startswith("{")] == [20.0, 30.0]


def test_a_carmaker_that_fails_again_costs_its_scenario_after_one_retry(cmapi, project):
    cmapi("raise")
    simulator = WorkerSimulator("carmaker", {"testrun": "Crossing", "project": str(project)})
    (found,) = simulator.run([ConcreteScenario(project.parent / "s.xosc", {"ego_speed": 20.0})])
    simulator.close()
    assert str(found) == (
        "cmapi, the Python package of CarMaker, failed with RuntimeError: the application is gone, tried 2 times"
    )
    assert (project / "said.txt").read_text().splitlines().count("connected") == 2


def test_only_as_many_run_at_a_time_as_there_are_licences(tmp_path):
    running, most = 0, 0
    lock = threading.Lock()

    def work():
        nonlocal running, most
        licence = Licence(2, tmp_path)
        for _ in range(5):
            licence.acquire()
            with lock:
                running += 1
                most = max(most, running)
            time.sleep(0.01)
            with lock:
                running -= 1
            licence.release()

    threads = [threading.Thread(target=work) for _ in range(5)]
    for one in threads:
        one.start()
    for one in threads:
        one.join(60)
    assert (running, most) == (0, 2)


def test_a_licence_that_another_worker_waits_for_is_given_back(cmapi, project, monkeypatch):
    monkeypatch.setattr("cornercase.simulators.carmaker._licences.user_cache_folder", lambda: project.parent / "cache")
    concrete = ConcreteScenario(project.parent / "s.xosc", {"ego_speed": 20.0})
    other = Licence(1)
    with closing(CarMaker(testrun="Crossing", project=str(project), licences=1)) as simulator:
        ran(simulator, [concrete])
        # Its CarMaker waits for the next scenario, and keeps the licence.
        waiting = threading.Thread(target=other.acquire, daemon=True)
        waiting.start()
        waiting.join(0.5)
        assert waiting.is_alive()
        ran(simulator, [concrete])
        waiting.join(60)
        assert not waiting.is_alive()
    other.release()
    assert (project / "said.txt").read_text().splitlines()[-1] == "disconnected"


def test_cornercase_starts_carmaker_and_starts_it_again_after_a_crash(project):
    program = Path(__file__).parents[1] / "helpers" / "carmaker_port.py"
    options = {
        "testrun": "Crossing", "project": str(project), "via": "port", "port": free_port(),
        "start": f"{sys.executable} {program} {{port}} {project} crash-once",
    }  # fmt: skip
    simulator = WorkerSimulator("carmaker", options)
    concretes = [ConcreteScenario(project.parent / "s.xosc", {"ego_speed": speed}) for speed in (20.0, 30.0)]
    found = ran(simulator, concretes)
    simulator.close()
    assert [one.speed[0, 0] for one in found] == pytest.approx([20.0, 30.0])
    assert (project / "started.txt").read_text().split() == ["started"] * 2
    with pytest.raises(OSError, match="refused"):
        socket.create_connection(("127.0.0.1", options["port"]), 1.0)


def test_a_carmaker_that_does_not_start_is_said_with_its_last_words(project):
    command = f"{sys.executable} -c \"print('no licence'); import sys; sys.exit(3)\" {{port}}"
    simulator = CarMaker(testrun="Crossing", project=str(project), via="port", port=free_port(), start=command)
    with pytest.raises(InputError, match="ended with exit code 3; its last words: no licence"):
        ran(simulator, [ConcreteScenario(project.parent / "s.xosc", {"ego_speed": 9.0})])


@pytest.mark.skipif(sys.platform == "win32", reason="the program is a shell script")
def test_a_server_whose_program_is_lost_costs_its_scenario_and_not_the_search(tmp_path):
    program = tmp_path / "server"
    program.write_text("#!/bin/sh\nexec sleep 60\n")
    program.chmod(0o755)
    server = ServerProcess(
        "CARLA", f"{program} {{port}}", "localhost", 2000, lambda: server.is_running, start_timeout=60.0
    )
    assert server.start_if_needed()
    server.stop()
    program.unlink()
    with pytest.raises(SimulatorError, match="CARLA cannot be started by"):
        server.start_if_needed()
    server.stop()


@pytest.mark.parametrize(
    ("hosts", "found"),
    [("::1", ("::1", 9)), ("[::1]", ("::1", 9)), ("[::1]:3000", ("::1", 3000))],
)
def test_a_host_may_be_an_ipv6_address(hosts, found):
    assert worker_address(hosts, 9, 0) == found


@pytest.mark.parametrize("hosts", ["a:1:2", "[::1]:b", ":::1"])
def test_what_only_looks_like_an_ipv6_address_is_refused(hosts):
    with pytest.raises(InputError, match="is not a host; write it as host or host:port"):
        worker_address(hosts, 9, 0)
