"""User-defined drivers with options, and how a study describes them."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import cornercase as cc
from cornercase.drivers import DRIVERS, NORMAL, BehaviourDriver
from cornercase.drivers._resolve import resolve_driver
from cornercase.drivers._serialization import driver_command_option, format_driver
from cornercase.report import write_report
from cornercase.study import StudyFile
from helpers.command_line import SPACE, X, cornercase

MODULE = '''
import numpy as np

from cornercase.drivers import Driver


class Aeb(Driver):
    """Keeps its speed, and brakes after a while."""

    def __init__(self, *, reaction=0.5, eager: bool = False, word="calm", **others):
        self.reaction = reaction

    def acceleration(self, situation):
        return np.full_like(situation.speed, 0.0 if situation.time < self.reaction else -3.0)


class Braking(Aeb):
    """Brakes at a given rate, or as its base class does."""

    def __init__(self, hard: float = 1.0, **options):
        super().__init__(**options)
        self.hard = hard


class Set(Aeb):
    settings = {"driver": "set", "gain": 2.0}
'''
EXPLORE = (
    "explore", X, "--space", SPACE, "--ego", "Ego", "--other", "Pedestrian", "--metric", "wttc",
    "--optimizer", "sobol", "--budget", 3, "--duration", 3,
)  # fmt: skip
DRIVER = "my_aeb:Aeb:eager=true,reaction=0.3"
CHECKSUM = 8


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    (tmp_path / "my_aeb.py").write_text(MODULE)
    yield tmp_path
    sys.modules.pop("my_aeb", None)


def explored(folder: Path, driver: str, study: str = "s.db"):
    return cornercase("-q", *EXPLORE, "--driver", f"Ego={driver}", "-o", study, cwd=folder)


def test_42_5_options_of_an_own_driver_stand_behind_a_second_colon(folder):
    ended = explored(folder, DRIVER)
    assert ended.returncode == 0, ended.stderr
    with StudyFile.open(folder / "s.db") as study:
        (stored,) = study.meta.settings["drivers"].values()
        assert (stored["driver"], stored["options"]) == ("my_aeb:Aeb", {"reaction": 0.3, "eager": True})
        motion = study.recording(1)
    # It brakes from then on.
    ego = motion.acceleration[motion.entity_index("Ego")]
    assert motion.time[ego < -1.0].min() == pytest.approx(0.3, abs=0.11)


@pytest.mark.parametrize(
    ("driver", "says"),
    [
        ("my_aeb:Aeb:reacton=0.3", "The driver 'my_aeb:Aeb' has no option 'reacton'; did you mean 'reaction'?"),
        # Options that no constructor declares are refused.
        ("my_aeb:Aeb:others=0.3", "has no option 'others'; known are: eager, reaction, word."),
        ("my_aeb:Braking:reactoin=1", "has no option 'reactoin'; did you mean 'reaction'?"),
        ("my_aeb:Aeb:reaction=soon", "takes a number for 'reaction', not 'soon'"),
        ("my_aeb:Aeb:eager=2", "takes true or false for 'eager', not '2'"),
        (
            "my_aeb:Aeb:reaction",
            "has the option 'reaction' without a name or value; give options as in 'my_aeb:Aeb:name=value'",
        ),
        ("my_aeb:Aeb:reaction=1,reaction=2", "has the option 'reaction' twice"),
        ("my_aeb:Aeb:", "ends in a colon; give options as in 'my_aeb:Aeb:name=value'"),
    ],
)
def test_42_5_an_option_that_the_class_does_not_declare_is_refused(folder, driver, says):
    ended = explored(folder, driver)
    assert ended.returncode == 2
    assert says in ended.stderr
    assert not (folder / "s.db").exists()


def test_42_5_options_reach_the_class_that_an_own_driver_derives_from(folder, monkeypatch):
    monkeypatch.chdir(folder)
    made: Any = resolve_driver("my_aeb:Braking:hard=2,reaction=0.1")
    assert (made.hard, made.reaction) == (2.0, 0.1)


def test_42_5_a_study_names_its_driver_so_that_the_command_can_be_typed_again(folder):
    assert explored(folder, DRIVER).returncode == 0
    words = "my_aeb:Aeb, eager=true, reaction=0.3, sha256 "
    shown = cornercase("show", "s.db", "--all", cwd=folder).stdout
    assert f"  Ego: {words}" in shown
    plain = json.loads(cornercase("show", "s.db", "--json", cwd=folder).stdout)
    assert plain["drivers"]["Ego"].startswith(words)
    assert len(plain["drivers"]["Ego"]) == len(words) + CHECKSUM + 1
    assert f"--driver Ego={DRIVER}" in cornercase("show", "s.db", "--config", cwd=folder).stdout
    page = write_report(folder / "s.db", folder / "r.html").read_text()
    assert f"<td class=text>{words}" in page
    command = page.partition("cornercase explore ")[2].partition("<")[0]
    assert f"--driver Ego={DRIVER} " in command
    again = [X, *shlex.split(command)[1:-1], "again.db"]
    assert cornercase("-q", "explore", *again, cwd=folder).returncode == 0
    with StudyFile.open(folder / "s.db") as first, StudyFile.open(folder / "again.db") as second:
        assert first.meta.settings == second.meta.settings


def test_42_5_a_study_goes_on_only_with_the_same_file_of_its_driver(folder):
    assert explored(folder, DRIVER).returncode == 0
    before = (folder / "s.db").read_bytes()
    refused = explored(folder, "my_aeb:Aeb:reaction=0.4")
    assert refused.returncode == 2
    assert "driver of Ego: my_aeb:Aeb, eager=true, reaction=0.3, sha256 " in refused.stderr
    assert "in the study, my_aeb:Aeb, reaction=0.4, sha256 " in refused.stderr
    (folder / "my_aeb.py").write_text(MODULE + "# another version\n")
    refused = explored(folder, DRIVER)
    assert refused.returncode == 2
    assert (
        "s.db: the file of the driver of Ego has changed since the study was made (my_aeb:Aeb, eager=true, reaction=0.3"
        in refused.stderr
    )
    assert "name another study with -o, or restore the file." in refused.stderr
    assert (folder / "s.db").read_bytes() == before
    # Two versions can be compared and distinguished.
    assert explored(folder, DRIVER, "new.db").returncode == 0
    compared = cornercase("compare", "s.db", "new.db", cwd=folder)
    (line,) = [one for one in compared.stdout.splitlines() if one.strip().startswith("driver Ego: ")]
    old, new = line.split(" → ")
    assert old.strip().startswith("driver Ego: my_aeb:Aeb, eager=true, reaction=0.3, sha256 ")
    assert new.startswith("my_aeb:Aeb, eager=true, reaction=0.3, sha256 ")
    assert old[-CHECKSUM:] != new[-CHECKSUM:]
    (folder / "my_aeb.py").write_text(MODULE)
    assert explored(folder, DRIVER).returncode == 0


def test_42_5_commands_that_need_the_driver_again_say_how_to_give_it(folder):
    assert explored(folder, DRIVER).returncode == 0
    steps = (("analyze", "s.db", "--by", "wttc"), ("reduce", "s.db", "-o", "set", "--scenario", X))
    assert [cornercase("-q", *one, cwd=folder).returncode for one in steps] == [0, 0]
    for command, words in (
        (("test", "set", "-o", "t.db"), "code named in a file is not run"),
        (("estimate", "s.db", "--scenario", X, "-o", "e.db"), "code that a study names is not run"),
    ):
        refused = cornercase("-q", *command, cwd=folder)
        assert refused.returncode == 2
        # Opening a study of somebody else runs nothing.
        assert words in refused.stderr
        assert f"Ego={DRIVER}." in refused.stderr
    tested = cornercase("-q", "test", "set", "--driver", f"Ego={DRIVER}", "-o", "t.db", cwd=folder)
    assert tested.returncode == 0, tested.stderr
    assert "are identical to those" in tested.stdout
    asked = cornercase(
        "-q", "test", "set", "--driver", f"Ego={DRIVER}", "-o", "u.db",
        "--require", "no collision unless my_aeb:Aeb:reaction=0.1 collides", cwd=folder,
    )  # fmt: skip
    assert asked.returncode == 0, asked.stderr
    searched = cornercase(
        "-q", *EXPLORE, "--critical-if", "collision and not reference:my_aeb:Aeb:reaction=0.1", "-o", "c.db", cwd=folder
    )
    assert searched.returncode == 0, searched.stderr


def test_42_5_drivers_that_python_makes_are_named_too(folder, monkeypatch):
    monkeypatch.chdir(folder)
    made = resolve_driver("my_aeb:Set")
    assert made is resolve_driver(made)
    given: dict[str, Any] = {
        "ego": "Ego",
        "other": "Pedestrian",
        "metrics": ["wttc"],
        "space": SPACE,
        "budget": 1,
        "duration": 1.0,
    }
    stored = {}
    for name, driver in (
        ("name", "my_aeb:Aeb:reaction=0.3"),
        ("object", sys.modules["my_aeb"].Set()),
        ("preset", BehaviourDriver(NORMAL._replace(reaction_time=1.0))),
    ):
        cc.explore(X, folder / f"{name}.db", optimizer="sobol", drivers={"Ego": driver}, **given)
        with StudyFile.open(folder / f"{name}.db") as study:
            stored[name] = study.meta.settings["drivers"]["Ego"]
    assert driver_command_option(stored["name"]) == "my_aeb:Aeb:reaction=0.3"
    assert driver_command_option(stored["preset"]) == format_driver(stored["preset"]) == "normal:reaction_time=1.0"
    assert driver_command_option({"driver": "rss", "delay": 1.5}) == "rss:delay=1.5"
    # It is unknown how an object was created; its class, settings and file are known.
    assert driver_command_option(stored["object"]) is None
    assert format_driver(stored["object"]).startswith("my_aeb:Set, gain=2.0, sha256 ")
    page = write_report(folder / "object.db", folder / "r.html").read_text()
    assert "--driver Ego=DRIVER " in page
    assert "DRIVER stands for the driver of Ego, an object that Python code made (my_aeb:Set, gain=2.0" in page


def test_42_5_what_a_study_says_of_drivers_makes_none(monkeypatch):
    def made(**options: object) -> None:
        raise AssertionError("made because a study says so")

    monkeypatch.setattr(DRIVERS, "_factories", {**DRIVERS._factories, "foreign": (made, {})})
    for stored in (
        {"driver": "foreign", "file": "/etc/passwd"},
        {"driver": "foreign", "options": {"file": "/etc/passwd"}},
        {"driver": "own:Class", "options": {}, "sha256": 3},
        {"driver": ["rss"], "delay": {}},
        {"driver": "own:Class", "settings": [3]},
        {"driver": "rss", "delay": [1.0]},
        {"driver": "behaviour", "reaction_time": "__import__"},
        {},
        ["foreign"],
        3.5,
    ):
        driver_command_option(stored)
        assert isinstance(format_driver(stored), str)
