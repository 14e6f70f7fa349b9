"""Who drives and with what, by options of commands and by files."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from conftest import EXAMPLES
from cornercase._common.errors import InputError
from cornercase.cli.driver_options import combine_drivers
from cornercase.cli.sut_file import read_sut_file
from cornercase.drivers import SENSORS, Radar
from cornercase.drivers._resolve import driver_by_name
from cornercase.study import StudyFile
from helpers.command_line import SPACE, X, cornercase

MODULE = '''
import cornercase as cc


class Aeb(cc.SystemUnderTest):
    """Keeps its speed, and brakes after a while."""

    def __init__(self, reaction=0.5, word="calm"):
        self.reaction = reaction

    def describe(self):
        return ["brakes by itself"]

    def step(self, view, dt):
        return -3.0 if view.time >= self.reaction else 0.0
'''


class Blind(Radar):
    """Sees nothing beyond its range."""

    name = "blind"

    def __init__(self, range: float = 10.0) -> None:  # noqa: A002
        super().__init__(range=range)


@pytest.fixture(autouse=True)
def sensor(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(SENSORS._factories, "blind", (Blind, {}))


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    (tmp_path / "my_aeb.py").write_text(MODULE)
    yield tmp_path
    sys.modules.pop("my_aeb", None)


def combined(**texts: str) -> dict[str, str]:
    return combine_drivers(
        *(texts[name].split(" ") if name in texts else () for name in ("driver", "sut", "sensor", "vehicle"))
    )


def test_driver_sensors_and_vehicle_become_one_text():
    assert combined(sut="Ego=normal:horizon=4", sensor="Ego=blind:range=5 Ego=blind", vehicle="Ego=kinematic") == {
        "Ego": "normal:horizon=4 + blind:range=5 + blind + kinematic"
    }
    assert combined(driver="C=simple", sut="Ego=normal", sensor="C=blind") == {"C": "simple + blind", "Ego": "normal"}
    assert combined() == {}


@pytest.mark.parametrize(
    ("texts", "says"),
    [
        ({"sensor": "Ego=blind"}, "--sensor Ego=blind: nobody drives Ego; give its driver, too, as in --sut Ego=normal."),
        ({"vehicle": "Ego=kinematic"}, "--vehicle Ego=kinematic: nobody drives Ego"),
        ({"sut": "Ego=normal", "sensor": "Ego=blnd"}, "there is no sensor 'blnd'; did you mean 'blind'?"),
        ({"sut": "Ego=normal", "sensor": "Ego=kinematic"}, "'kinematic'; it is a vehicle; give it with --vehicle."),
        ({"sut": "Ego=normal", "vehicle": "Ego=blind"}, "there is no vehicle 'blind'; it is a sensor; give it with --sensor."),
        ({"sut": "Ego=normal", "vehicle": "Ego=kinematic Ego=kinematic:mu=1"}, "Ego has the vehicle 'kinematic' already"),
        ({"sut": "Ego=normal", "sensor": "Ego=blind Ego=blind"}, "--sensor Ego=blind: is given twice; give it once."),
        ({"sut": "Ego=normal", "sensor": "Ego"}, "--sensor Ego: write it as ENTITY=NAME"),
        ({"driver": "Ego=simple", "sut": "Ego=normal"}, "--sut Ego=normal: Ego is driven by 'simple' already"),
        ({"sut": "Ego=normal Ego=simple"}, "--sut Ego=simple: Ego is driven by 'normal' already"),
        ({"sut": "Ego=normal", "sensor": "Ego=blind+radar"}, "there is no sensor 'blind+radar'"),
    ],
)  # fmt: skip
def test_a_contradiction_is_one_sentence(texts, says):
    with pytest.raises(InputError) as error:
        combined(**texts)
    assert says in str(error.value)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("Ego=Brake.fmu", "There is no driver 'Brake.fmu'; an FMU is named as 'fmu:Brake.fmu'."),
        ("Ego=Brake.FMU:reaction=0.3", "an FMU is named as 'fmu:Brake.FMU:reaction=0.3'."),
        ("Ego=./hold", "There is no driver './hold'; a program is named as 'exec:./hold'."),
        ("Ego=./hold:time=2", "a program is named as 'exec:./hold:time=2'."),
        ("Ego=hold", "a program is named as 'exec:./hold'."),
        ("Ego=python hold.py", "a program is named as 'exec:python hold.py'."),
        ("Ego=tcp://localhost:5000", "a program is named as 'exec:tcp://localhost:5000'."),
        ("Ego=my_aeb.py:Aeb", "a class is named as 'my_aeb:Aeb'."),
        ("Ego=code/my_aeb.py:Aeb", "a class is named as 'my_aeb:Aeb' in the folder code."),
        ("Ego=my_aeb.py", "a class is named as 'my_aeb:Class', a program as 'exec:python my_aeb.py'."),
        ("Ego=my_aeb", "a class of my_aeb.py is named as 'my_aeb:Class'."),
        ("Ego=my_aeb:aeb", "has no class 'aeb'; did you mean 'Aeb'?"),
        ("Ego=sut.toml", "give a file that names the drivers without an entity, as in --sut sut.toml."),
        ("Brake.fmu", "write it as ENTITY=NAME, as in Ego=fmu:Brake.fmu;"),
        ("./hold", "write it as ENTITY=NAME, as in Ego=exec:./hold;"),
        ("fmu:Brake.fmu", "write it as ENTITY=NAME, as in Ego=fmu:Brake.fmu;"),
        ("Ego=nrmal", "did you mean 'normal'?"),
    ],
)
def test_a_file_or_program_without_its_prefix_is_named_as_it_has_to_be(folder, monkeypatch, text, says):
    monkeypatch.chdir(folder)
    monkeypatch.syspath_prepend(folder)
    (folder / "hold").write_text("#!/bin/sh\n")
    with pytest.raises(InputError) as error:
        driver_by_name(combine_drivers((), [text], (), ())["Ego"])
    assert says in str(error.value)


def test_several_parts_in_one_option_are_refused():
    with pytest.raises(InputError, match="give each sensor or vehicle with an option of its own"):
        combine_drivers((), ["Ego=normal"], ["Ego=blind + blind"], ())


def test_a_study_is_the_same_by_options_by_one_text_and_by_a_file(folder):
    (folder / "sut.toml").write_text(
        '[Ego]\nsut = "my_aeb:Aeb"\noptions = { reaction = 0.3, word = "brave" }\n'
        'sensors = ["blind", { name = "blind", options = { range = 5 } }]\nvehicle = { name = "kinematic" }\n'
    )
    driver = "my_aeb:Aeb:reaction=0.3,word=brave"
    ways = {
        "options": ("--sut", f"Ego={driver}", "--sensor", "Ego=blind", "--sensor", "Ego=blind:range=5", "--vehicle",
                    "Ego=kinematic"),
        "text": ("--driver", f"Ego={driver} + blind + blind:range=5 + kinematic"),
        "file": ("--sut", "sut.toml"),
    }  # fmt: skip
    settings = []
    for name, way in ways.items():
        command = ("-q", "explore", X, "--space", SPACE, "--ego", "Ego", "--other", "Pedestrian", "--metric", "wttc")
        ended = cornercase(*command, "--budget", 2, "--duration", 2, *way, "-o", f"{name}.db", cwd=folder)
        assert ended.returncode == 0, ended.stderr
        with StudyFile.open(folder / f"{name}.db") as study:
            settings.append(study.meta.settings)
            recording = study.recording(1)
    assert settings[0] == settings[1] == settings[2]
    ego = recording.acceleration[recording.entity_index("Ego")]
    assert recording.time[ego < -1.0].min() == pytest.approx(0.3, abs=0.11)
    shown = cornercase("show", "file.db", "--config", cwd=folder).stdout
    assert f"--driver 'Ego={driver} + blind + blind:range=5 + kinematic'" in shown.replace("\\\n", "")


@pytest.mark.parametrize(
    ("driver", "spec"),
    [
        ("normal + radar", "normal:gain=1 + radar"),
        ("normal:horizon=4 + radar:range=5", "normal:horizon=4,gain=1 + radar:range=5"),
        ("my_aeb:Aeb:map=C:/map.toml", "my_aeb:Aeb:map=C:/map.toml,gain=1"),
        ("fmu:C:\\a.fmu", "fmu:C:\\a.fmu:gain=1"),
        ("fmu:C:\\a.fmu:map=C:\\map.toml", "fmu:C:\\a.fmu:map=C:\\map.toml,gain=1"),
        ("exec:./aeb --mode=city", "exec:./aeb --mode=city:gain=1"),
        ("exec:tcp://localhost:80", "exec:tcp://localhost:80:gain=1"),
        ("exec:sh -c 'a + b':timeout=3 + radar", "exec:sh -c 'a + b':timeout=3,gain=1 + radar"),
    ],
)
def test_options_of_a_file_go_to_the_driver(tmp_path, driver, spec):
    (tmp_path / "sut.toml").write_text(f"[Ego]\ndriver = {json.dumps(driver)}\noptions = {{ gain = 1 }}\n")
    assert read_sut_file(tmp_path / "sut.toml") == {"Ego": spec}


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "sut.toml: has no entity; write a table for each, as in [Ego]"),
        ("driver = 'normal'", "sut.toml: [driver]: is no table; write [Ego] on a line"),
        ("[Ego]", "sut.toml: [Ego]: has no 'driver'; add one."),
        ("[Ego]\ndriver='normal'\nsut='normal'", "[Ego]: has both 'driver' and 'sut', which mean the same; keep one."),
        ("[Ego]\ndriver='normal'\nsensor=['blind']", "[Ego]: has 'sensor', which is not known; did you mean 'sensors'?"),
        ("[Ego]\ndriver='normal'\nsensors='blind'", "[Ego]: 'sensors' is no list; write sensors = ["),
        ("[Ego]\ndriver='normal'\nsensors=[3]", "[Ego], sensors 1: is no text"),
        ("[Ego]\ndriver='normal'\nsensors=[{options={}}]", "[Ego], sensors 1: has no 'name'; add one."),
        ("[Ego]\ndriver='normal'\nvehicle={name='kinematic', mass=3}", "[Ego], vehicle: has 'mass', which is not known"),
        ("[Ego]\ndriver='normal'\noptions=3", "[Ego], driver: 'options' is no table; write options = {"),
        ("[Ego]\ndriver='normal'\noptions={horizon=[1]}", "the value of the option 'horizon' must be a number, a text, true or false."),
        ("[Ego]\ndriver='normal'\noptions={horizon='1,2'}", "a comma or ' + ' cannot be in a value."),
        ("[Ego", "sut.toml"),
    ],
)  # fmt: skip
def test_a_wrong_file_is_refused_with_its_key(folder, text, says):
    (folder / "sut.toml").write_text(text)
    ended = cornercase("check", X, "--sut", "sut.toml", cwd=folder)
    assert ended.returncode == 2
    assert says in ended.stderr


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('sut = ["sut.toml"]', "'sut' names the file sut.toml, which could run code; give --sut sut.toml on the command line."),
        ('sut = ["Ego=my_aeb:Aeb"]', "give it on the command line, --sut Ego=my_aeb:Aeb"),
        ('sensor = ["Ego=blind:range=far"]', "'sensor' has the option 'range', which is no number"),
    ],
)  # fmt: skip
def test_a_study_file_names_no_code(folder, text, says):
    (folder / "study.toml").write_text(f"scenario = '{X}'\n{text}\n")
    ended = cornercase("explore", "--config", "study.toml", "--ego", "Ego", "-o", "s.db", cwd=folder)
    assert ended.returncode == 2
    assert says in ended.stderr


def test_a_study_file_may_have_sensors_and_vehicles(folder):
    (folder / "study.toml").write_text(
        'sut = ["Ego=normal"]\nsensor = ["Ego=blind:range=5"]\nvehicle = ["Ego=kinematic"]\n'
    )
    command = (
        "explore",
        X,
        "--space",
        SPACE,
        "--ego",
        "Ego",
        "--other",
        "Pedestrian",
        "--metric",
        "wttc",
        "--budget",
        2,
    )
    ended = cornercase("-q", *command, "--duration", 1, "--config", "study.toml", "-o", "s.db", cwd=folder)
    assert ended.returncode == 0, ended.stderr
    with StudyFile.open(folder / "s.db") as study:
        assert study.meta.settings["drivers"]["Ego"] == "normal + blind:range=5 + kinematic"


def test_check_says_what_drives_and_what_can_be_searched(folder):
    texts = ("--sut", "Ego=my_aeb:Aeb:word=brave", "--sensor", "Ego=blind:range=5", "--sensor", "Ego=blind")
    shown = cornercase("check", X, *texts, "--vehicle", "Ego=kinematic:mu=0.5", cwd=folder)
    assert shown.returncode == 0, shown.stderr
    lines = shown.stdout.splitlines()
    begin = lines.index("Ego: driven by my_aeb:Aeb:word=brave + blind:range=5 + blind + kinematic:mu=0.5")
    assert lines[begin + 1 : begin + 5] == [
        "  driver: reaction=0.5, word=brave",
        "  brakes by itself",
        "  blind1: range=5",
        "  blind2: range=10.0",
    ]
    assert lines[begin + 5].startswith("  vehicle: ")
    searched = lines[begin + 6].removeprefix("  can be searched, as in --range Ego.reaction=LOW:HIGH: ").split(", ")
    # What is given is fixed: 'range' of the first, 'mu' of the vehicle.
    assert searched[:2] == ["reaction", "blind2.range"]
    assert "mu" not in searched


def test_check_runs_the_function_for_a_step(folder):
    (folder / "broken.py").write_text(MODULE.replace("return -3.0", "return 1 / 0").replace("Aeb", "Broken"))
    shown = cornercase("check", X, "--sut", "Ego=broken:Broken:reaction=0", cwd=folder)
    sys.modules.pop("broken", None)
    assert shown.returncode == 1
    assert "ZeroDivisionError" in shown.stdout
    assert "cannot be run" in shown.stdout


def test_check_does_not_call_axles_without_effect_where_a_function_may_steer(folder):
    t = EXAMPLES / "t_intersection" / "t_intersection.xosc"
    for drives, is_without_effect in (("my_aeb:Aeb", False), ("normal + single-track", False), ("normal", True)):
        shown = cornercase("check", t, "--sut", f"Ego={drives}", cwd=folder)
        assert shown.returncode == 0, shown.stderr
        assert ("<Axles>" in shown.stdout) == is_without_effect, drives


def test_check_refuses_a_driver_of_nobody(folder):
    ended = cornercase("check", X, "--sut", "Eego=normal", cwd=folder)
    assert ended.returncode == 2
    assert "has no entity 'Eego'; did you mean 'Ego'?" in ended.stderr


def test_drivers_lists_what_can_be_given():
    rows = json.loads(cornercase("drivers", "--json").stdout)
    by_name = {row["name"]: row for row in rows}
    assert by_name["blind"] == {
        "kind": "sensor", "name": "blind", "what": "Sees nothing beyond its range.", "options": {"range": 10.0},
    }  # fmt: skip
    assert by_name["kinematic"]["kind"] == "vehicle"
    assert by_name["normal"]["options"]["horizon"] > 0.0
    assert "time_headway=0.8" in cornercase("drivers").stdout.replace("\n", "")
    assert "Time gap in s to the leader." in cornercase("drivers", "simple").stdout
    refused = cornercase("drivers", "simpel")
    assert refused.returncode == 2
    assert "did you mean 'simple'?" in refused.stderr
