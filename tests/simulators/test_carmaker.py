"""The CarMaker adapter against a stand-in of its command port: the protocol only, no CarMaker."""

from __future__ import annotations

import socket
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import foreign_recordings as foreign
from command_line import cornercase
from conftest import ran
from cornercase._common.errors import InputError, SimulationError, SimulatorError
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import CarMakerSimulator, WorkerSimulator
from cornercase.simulators.carmaker.cmapi import CarMakerApi
from cornercase.simulators.carmaker.port import CommandPort

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


class Port:
    """Answers as CarMaker's command port does; ``odd`` says how, by the word a command begins with."""

    def __init__(self, result="SimOutput/pc/run.erg", pieces=1, odd=None):
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.number = self._listener.getsockname()[1]
        self.asked: list[str] = []
        self._result, self._pieces, self._odd = result, pieces, odd or {}
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self):
        while True:
            try:
                line, _ = self._listener.accept()
            except OSError:
                return
            threading.Thread(target=self._talk, args=(line,), daemon=True).start()

    def _talk(self, line):
        # Who asked may have hung up.
        with suppress(OSError):
            self._answer_all(line)

    def _answer_all(self, line):
        heard = b""
        with line:
            while piece := line.recv(4096):
                heard += piece
                while b"\r" in heard:
                    command, _, heard = heard.partition(b"\r")
                    self.asked.append(command.decode())
                    word = command.decode().split()[0]
                    odd = self._odd.get(word)
                    odd = odd.pop(0) if isinstance(odd, list) and odd else odd or None
                    if odd == "close":
                        return
                    if odd == "silence":
                        time.sleep(2)
                    answer = odd.encode() if odd else self._answer(word)
                    half = odd == "Ocut"
                    for k in range(0, len(answer), self._pieces):
                        line.sendall(answer[k : k + self._pieces])
                        time.sleep(0.001)
                    if half:
                        return

    def _answer(self, word):
        known = {"WaitForStatus": "O0", "GetLastResultFName": f"O{self._result}", "SimStatus": "O-2", "NamedValue": "O"}
        if word in known:
            return known[word].encode() + b"\r\n\r\n"
        if word in ("LoadTestRun", "SaveMode", "StartSim", "StopSim"):
            return b"\r\n"
        return f'Einvalid command name "{word}"\r\n\r\n'.encode()

    def close(self):
        # Wakes who waits for a call.
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()


@pytest.fixture
def project(tmp_path):
    folder = tmp_path / "project"
    (folder / "SimOutput" / "pc").mkdir(parents=True)
    foreign.erg(folder / "SimOutput" / "pc" / "run.erg")
    (tmp_path / "s.xosc").write_text(SCENARIO)
    return folder


def run(project, port, values=None, **options):
    simulator = CarMakerSimulator(
        testrun="Crossing", project=str(project), hosts="127.0.0.1", port=port.number, **options
    )
    (found,) = simulator.run([ConcreteScenario(project.parent / "s.xosc", values or {"ego_speed": 42.5})])
    return found


@pytest.mark.parametrize("pieces", [1, 2, 3, 1000])
def test_a_run_from_end_to_end_however_the_answers_are_split(project, pieces):
    port = Port(pieces=pieces)
    found = run(project, port)
    assert found.names == ("Ego", "T00")
    np.testing.assert_allclose(found.speed[0], foreign.SPEED, atol=1e-4)
    commands = [command.partition(" ")[0] for command in port.asked]
    assert commands == [
        "LoadTestRun", "NamedValue", "SaveMode", "StartSim", "WaitForStatus", "SimStatus", "WaitForStatus", "SimStatus",
        "GetLastResultFName",
    ]  # fmt: skip
    assert port.asked[0] == 'LoadTestRun "Crossing"'
    assert port.asked[1] == "NamedValue set ego_speed 42.5"
    port.close()


def test_values_are_one_tcl_word(project):
    port = Port()
    run(project, port, {"ego_speed": -1.5e-7, "weather": "heavy rain; exit"})
    assert port.asked[1:3] == ["NamedValue set ego_speed -1.5e-07", "NamedValue set weather {heavy rain; exit}"]
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
        ({"StartSim": "close"}, "CarMaker closed the line in its answer to 'StartSim'", True),
        ({"GetLastResultFName": "Ocut"}, "CarMaker closed the line in its answer to 'GetLastResultFName'", True),
        ({"SimStatus": ["O-6\r\n\r\n"]}, "CarMaker ended the TestRun with a fatal error", True),
        ({"SimStatus": "Owell\r\n\r\n"}, "tells the status 'well', which is no number", False),
        ({"SimStatus": "O1\r\n\r\n"}, "did not end the TestRun within", False),
        ({"GetLastResultFName": "O\r\n\r\n"}, "stored no result file", False),
        ({"GetLastResultFName": "OSimOutput/none.erg\r\n\r\n"}, "cannot be read", False),
    ],
)
def test_what_goes_wrong_costs_the_scenario_alone(project, odd, words, lost):
    port = Port(odd=odd)
    found = run(project, port)
    assert isinstance(found, SimulationError)
    assert words in str(found)
    assert isinstance(found, SimulatorError) == lost
    port.close()


def test_a_lost_licence_stops_all_and_says_so(project):
    port = Port(odd={"SimStatus": "O-7\r\n\r\n"})
    with pytest.raises(InputError, match="lost its licence"):
        run(project, port)
    port.close()


def test_a_silent_port_is_given_up():
    port = Port(odd={"SimStatus": "silence"})
    with CommandPort("127.0.0.1", port.number) as line, pytest.raises(SimulatorError, match=r"within 0\.2 s"):
        line.ask("SimStatus", 0.2)
    port.close()


def test_nobody_listens(project):
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = SimpleNamespace(number=free.getsockname()[1])
    with pytest.raises(InputError, match=r"No CarMaker listens on 127\.0\.0\.1:\d+ .*start it with -cmdport"):
        run(project, port)


def test_a_broken_line_is_tried_again_on_a_new_one(project):
    port = Port(odd={"StartSim": ["close"]})
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
    file = project / "SimOutput" / "pc" / "run.erg"
    whole = file.read_bytes()
    port = Port()
    for tenth in range(10):
        file.write_bytes(whole[: len(whole) * tenth // 10 + 3])
        found = run(project, port)
        assert isinstance(found, SimulationError), tenth
        assert str(file) in str(found)
    port.close()


def test_explores(project):
    port = Port()
    study = project.parent / "s.db"
    done = cornercase(
        "explore", project.parent / "s.xosc", "--range", "ego_speed=30:60", "--ego", "Ego", "--other", "T00", "--metric",
        "distance", "--optimizer", "sobol", "--budget", "4", "-o", study,
        "--simulator", f"carmaker:testrun=Crossing,project={project},hosts=127.0.0.1,port={port.number}",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert sum(one.startswith("StartSim") for one in port.asked) == 4
    port.close()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"testrun": ""}, "needs a TestRun"),
        ({"project": "/no/such/folder"}, "no such folder"),
        ({"testrun": "a[exit]"}, "Tcl would take"),
        ({"port": 0}, "localhost:0 cannot be"),
        ({"drivers": {"Ego": "normal"}}, "no drivers of cornercase"),
        ({"on_collision": "stop"}, "only where the TestRun says so"),
        ({"speedup": 0.0}, "both above 0"),
    ],
)
def test_refuses_in_one_sentence(tmp_path, options, words):
    with pytest.raises(InputError, match=words):
        CarMakerSimulator(**({"testrun": "a", "project": str(tmp_path)} | options))
    assert Path(tmp_path).is_dir()


@pytest.mark.skipif(not SAMPLE.is_file(), reason="the real sample is not beside the checkout")
def test_a_real_result_without_positions_says_what_to_store(project):
    for ending in ("", ".info"):
        target = project / "SimOutput" / "pc" / f"run.erg{ending}"
        target.write_bytes(SAMPLE.with_name(SAMPLE.name + ending).read_bytes())
    port = Port()
    found = run(project, port)
    assert isinstance(found, SimulationError)
    assert "has no Car.tx, Car.ty, Car.Yaw, Car.v; add it to the quantities that CarMaker stores." in str(found)
    port.close()


def test_entities_that_carmaker_does_not_have_are_refused(project):
    path = project.parent / "s.xosc"
    path.write_text(SCENARIO.replace('"T00"', '"Pedestrian"'))
    with pytest.raises(InputError, match=r"'Pedestrian' is no entity of CarMaker; .* Ego, T00, T01"):
        run(project, Port())


@pytest.fixture
def cmapi(monkeypatch, project):
    """IPG's module, as a stand-in that misbehaves as it is told."""
    (project / "Data" / "TestRun").mkdir(parents=True)
    (project / "Data" / "TestRun" / "Crossing").touch()
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "fake_cmapi"))

    def wrong(what):
        monkeypatch.setenv("FAKE_CMAPI", what)
        sys.modules.pop("cmapi", None)

    wrong("")
    yield wrong
    sys.modules.pop("cmapi", None)


def test_ipgs_module_is_taken_where_it_is_there_and_starts_carmaker_once(cmapi, project):
    simulator = CarMakerSimulator(testrun="Crossing", project=str(project))
    concretes = [ConcreteScenario(project.parent / "s.xosc", {"ego_speed": speed}) for speed in (42.5, 50.0)]
    for found in ran(simulator, concretes):
        assert found.names == ("Ego", "T00")
        np.testing.assert_allclose(found.speed[0], foreign.SPEED, atol=1e-4)
    said = (project / "said.txt").read_text().splitlines()
    assert said == ["connected", '{"ego_speed": 42.5}', '{"ego_speed": 50.0}']
    with pytest.raises(InputError, match=r"each needs a CarMaker project of its own, and there are 1; give more as"):
        CarMakerSimulator(testrun="Crossing", project=str(project), worker=1)
    CarMakerSimulator(testrun="Crossing", project=f"{project}+{project.parent}", worker=1)
    # The port can still be chosen.
    port = Port()
    assert run(project, port, via="port").names == ("Ego", "T00")
    port.close()


@pytest.mark.parametrize(
    ("wrong", "kind", "words"),
    [
        ("raise", SimulatorError, "CarMaker, by cmapi: RuntimeError: the application is gone"),
        ("hang", SimulationError, "CarMaker did not end the TestRun within 0.5 s"),
        ("no file", SimulationError, "CarMaker wrote 0 result files in SimOutput, where one was awaited"),
    ],
)
def test_what_goes_wrong_by_ipgs_module_is_one_sentence(cmapi, project, wrong, kind, words):
    cmapi(wrong)
    control = CarMakerApi(project, "Crossing", 0.5)
    with pytest.raises(kind) as caught:
        control.run({"ego_speed": 42.5})
    assert words in str(caught.value)
    assert ("stopped" in (project / "said.txt").read_text()) == (wrong == "hang")
    control.close()


def test_a_carmaker_that_does_not_start_by_ipgs_module_is_said(cmapi, project):
    cmapi("start")
    with pytest.raises(InputError, match=r"does not start by IPG's cmapi \(no licence\).*carmaker:via=port"):
        CarMakerApi(project, "Crossing", 0.5)
    cmapi("")
    with pytest.raises(InputError, match="no TestRun Nowhere"):
        CarMakerApi(project, "Nowhere", 0.5)


def test_a_way_that_is_not_there_is_refused(project):
    with pytest.raises(InputError, match=r"cmapi cannot be imported.*carmaker:via=port"):
        CarMakerSimulator(testrun="Crossing", project=str(project), via="cmapi")
    with pytest.raises(InputError, match="did you mean 'port'"):
        CarMakerSimulator(testrun="Crossing", project=str(project), via="prot")  # type: ignore[arg-type]
