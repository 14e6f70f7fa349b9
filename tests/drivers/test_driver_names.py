"""Drivers by name, and user-defined drivers."""

from __future__ import annotations

import sys
import textwrap

import numpy as np
import pytest

from conftest import EXAMPLES, ran, same_recording
from cornercase._common.errors import InputError
from cornercase.drivers import AGGRESSIVE, DRIVERS, NORMAL, BehaviourDriver, DrivenPath, ReferenceDriver
from cornercase.drivers._resolve import driver_by_name, is_compiled_driver_name, load_user_driver, resolve_driver
from cornercase.scenario import ConcreteScenario
from cornercase.scenario._concrete_file import write_concrete_file
from cornercase.scenario._file import ScenarioFile
from cornercase.simulators import Builtin
from helpers.closed_loop import Other, Run, straight


def test_presets_by_name_state_all_their_parameters():
    assert {"cautious", "normal", "aggressive"} <= set(DRIVERS.names())
    assert driver_by_name("aggressive").settings == {"driver": "behaviour", **AGGRESSIVE._asdict()}
    with pytest.raises(InputError, match="did you mean 'cautious'"):
        driver_by_name("cautous")


def test_unusable_parameters_are_named():
    with pytest.raises(InputError, match="horizon is -1"):
        BehaviourDriver(NORMAL._replace(horizon=-1))


@pytest.fixture
def own_module(tmp_path, monkeypatch):
    (tmp_path / "own_drivers.py").write_text(
        textwrap.dedent(
            """
            import numpy as np

            from cornercase.drivers import Driver

            class Steady:
                settings = {"driver": "steady"}

                def start(self, scenarios, others):
                    pass

                def acceleration(self, situation):
                    return np.clip(situation.target_speed - situation.speed, -1.0, 1.0)

            class Picky(Steady):
                def __init__(self, level):
                    self.level = level

            class Engine:
                pass

            class Derived(Driver):
                def acceleration(self, situation):
                    return np.clip(situation.target_speed - situation.speed, -1.0, 1.0)

            class Forgetful(Driver):
                pass

            class Nameless(Derived):
                settings = "none"

            constant = 3
            """
        )
    )
    (tmp_path / "broken_drivers.py").write_text("raise RuntimeError('no licence')\n")
    monkeypatch.chdir(tmp_path)
    yield
    for name in ("own_drivers", "broken_drivers"):
        sys.modules.pop(name, None)


@pytest.mark.usefixtures("own_module")
def test_a_users_own_driver_is_found_in_the_current_folder_and_drives():
    before = list(sys.path)
    driver = driver_by_name("own_drivers:Steady")
    assert sys.path == before
    assert driver.settings["driver"] == "steady"
    run = Run(driver, straight(), [Other("car", 150.0, 3.0)], speed=4.0, target=8.0, duration=20.0)
    assert run.speed[-1, 0] == pytest.approx(8.0, abs=0.01)


@pytest.mark.usefixtures("own_module")
def test_a_driver_that_derives_from_the_base_class_needs_only_its_decision():
    driver = driver_by_name("own_drivers:Derived")
    assert driver.settings["driver"] == "own_drivers:Derived"
    run = Run(driver, straight(), speed=4.0, target=8.0, duration=20.0)
    assert run.speed[-1, 0] == pytest.approx(8.0, abs=0.01)


@pytest.mark.usefixtures("own_module")
@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("own_drivers", "a class of own_drivers.py is named as 'own_drivers:Class'."),
        ("own_drivers:", "not of the form package.module:Class"),
        ("../own:Steady", "not of the form package.module:Class"),
        ("no_such_module_here:Steady", "no module 'no_such_module_here'"),
        ("broken_drivers:Steady", "its module fails: RuntimeError: no licence"),
        ("own_drivers:Absent", "has no class 'Absent'"),
        ("own_drivers:constant", "has no class 'constant'"),
        ("own_drivers:Picky", "needs the option 'level'; give it as in 'own_drivers:Picky:level=value'"),
        ("own_drivers:Engine", "is not a driver"),
        ("own_drivers:Forgetful", "cannot be created: TypeError"),
        ("own_drivers:Nameless", "is not a driver"),
    ],
)
def test_what_is_no_driver_is_refused_in_one_sentence(name, says):
    with pytest.raises(InputError) as caught:
        load_user_driver(name)
    message = str(caught.value)
    assert says in message
    assert "\n" not in message
    assert message.endswith(".")


@pytest.mark.parametrize(
    "distance",
    [np.array([0.0]), np.array([0.0, 1.0, 1.0]), np.array([1.0, 2.0, 3.0])],
)
def test_paths_that_are_none_are_refused(distance):
    with pytest.raises(ValueError, match="path"):
        DrivenPath(distance, *(np.zeros_like(distance) for _ in range(4)))


def ends(path, **drivers):
    (recording,) = ran(Builtin(drivers=drivers), [ConcreteScenario(path)])
    return recording


def test_options_in_a_name_are_the_parameters_of_the_driver():
    named = DRIVERS.create("normal:reaction_time=0.6,horizon=4")
    assert named.settings == BehaviourDriver(NORMAL._replace(reaction_time=0.6, horizon=4.0)).settings
    assert DRIVERS.create("simple:reaction_time=1").settings["reaction_time"] == 1.0
    assert DRIVERS.create("rss:delay=1").settings == ReferenceDriver("rss", delay=1.0).settings
    # Studies and files store the name, and a batch with it runs compiled.
    assert resolve_driver("normal:reaction_time=0.6") == "normal:reaction_time=0.6"
    assert is_compiled_driver_name("normal:reaction_time=0.6")


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("normal:reaction_tim=0.6", "no option 'reaction_tim'; did you mean 'reaction_time'"),
        ("normal:reaction_time=-1", "reaction_time is -1; it has to be a finite number of 0 or more"),
        ("normal:horizon=0", "horizon is 0; it has to be a finite number above zero"),
        ("normal:field_of_view=200", "field_of_view is 200; give an angle in rad"),
        ("normal:horizon=nan", "takes a number for 'horizon', not 'nan'"),
        ("normal:horizon=long", "takes a number for 'horizon', not 'long'"),
        ("simple:sight_range=-5", "sight_range is -5"),
        ("cc-human:name=rss", "no option 'name'"),
        ("nrmal:horizon=4", "no driver 'nrmal'; did you mean 'normal'"),
    ],
)
def test_what_no_driver_can_have_is_refused(name, words):
    with pytest.raises(InputError, match=words):
        resolve_driver(name)


def test_a_written_file_drives_as_its_driver_with_options(tmp_path):
    """A file that names the driver reproduces the recording of the run it was written from."""
    file = EXAMPLES / "t_intersection" / "t_intersection.xosc"
    slow = "normal:reaction_time=1.4"
    written = tmp_path / "written.xosc"
    write_concrete_file(ScenarioFile.read(file), {}, written, drivers={"Ego": slow})
    assert same_recording(ends(written), ends(file, Ego=slow))
    assert not same_recording(ends(written), ends(file))


def test_a_file_gives_a_driver_nothing_but_numbers(tmp_path):
    written = tmp_path / "written.xosc"
    write_concrete_file(
        ScenarioFile.read(EXAMPLES / "t_intersection" / "t_intersection.xosc"), {}, written,
        drivers={"Ego": "normal:horizon=long"},
    )  # fmt: skip
    with pytest.raises(
        InputError,
        match=r"written\.xosc, line \d+: <ScenarioObject>: asks for .* option 'horizon'; in a file, options are numbers",
    ):
        ends(written)
