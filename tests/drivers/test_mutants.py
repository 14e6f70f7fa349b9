"""Mutants of drivers."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise

import pytest

from conftest import EXAMPLES
from cornercase._common.errors import InputError
from cornercase.drivers import AGGRESSIVE, DRIVERS, NORMAL, BehaviourDriver, EquippedDriver, Radar, generate_mutants
from cornercase.drivers._mutants import mutable_driver_name
from cornercase.drivers._preset_name import nearest_preset_name
from cornercase.drivers._resolve import load_user_driver
from cornercase.drivers._serialization import serialize_driver
from helpers.command_line import cornercase

# Parameters that make a driver worse when increased; all others do so when reduced.
MORE = {"reaction_time", "comfortable_deceleration", "target_share", "lateral_acceleration", "acceleration"}


def settings(driver):
    return {name: value for name, value in DRIVERS.create(driver).settings.items() if isinstance(value, float)}


def changed(driver, mutant):
    """Parameters that differ, by whether they became larger."""
    before, after = settings(driver), settings(mutant)
    return {name: after[name] > before[name] for name in before if after[name] != before[name]}


def test_a_mutant_is_its_driver_but_for_one_parameter_that_is_worse():
    for driver in ("normal", "cautious:horizon=4", "simple"):
        mutants = generate_mutants(driver, 60, 3)
        assert len({one.driver for one in mutants}) == 60
        for one in mutants:
            ((name, larger),) = changed(driver, one.driver).items()
            assert larger == (name in MORE), one


def test_the_kinds_take_turns_and_severities_spread():
    mutants = generate_mutants("normal", 60)
    assert set(Counter(one.mutation for one in mutants).values()) == {4}
    later = sorted(
        settings(one.driver)["reaction_time"]
        for one in generate_mutants("normal", 300)
        if one.mutation == "reacts later"
    )
    assert 0.6 <= later[0] < 0.65
    assert 1.6 < later[-1] <= 2.0
    assert max(b - a for a, b in pairwise(later)) < 0.3


def test_seeds_and_numbers():
    assert generate_mutants("normal", 30, 7)[:20] == generate_mutants("normal", 20, 7)
    assert generate_mutants("normal", 30, 7) != generate_mutants("normal", 30, 8)
    assert len(generate_mutants("simple", 1000)) == 1000


def test_drivers_that_are_made_have_names():
    slow = BehaviourDriver(NORMAL._replace(reaction_time=0.75))
    assert nearest_preset_name(slow) == "normal:reaction_time=0.75"
    assert nearest_preset_name(BehaviourDriver(AGGRESSIVE)) == "aggressive"
    # As stored in a study.
    assert DRIVERS.create(nearest_preset_name(slow.settings)).settings == slow.settings


def test_mutants_keep_the_sensors_and_the_vehicle_model():
    name = "normal + radar:range=100 + kinematic"
    assert mutable_driver_name(name) == name
    assert all(mutant.driver.endswith(" + radar:range=100 + kinematic") for mutant in generate_mutants(name, 3))
    equipped = EquippedDriver(BehaviourDriver(NORMAL._replace(reaction_time=0.75)), [Radar(range=100)])
    # As an object, and as stored in a study.
    for driver in (equipped, serialize_driver(equipped)):
        assert mutable_driver_name(driver) == "normal:reaction_time=0.75 + radar:range=100"
    with pytest.raises(InputError, match="a file may only name registered sensors"):
        mutable_driver_name({"driver": "normal", "equipment": ["my_sensors:Radar"]})


def test_drivers_without_mutants_are_refused():
    for driver in ("cc-human",):
        with pytest.raises(InputError, match=f"driver {driver} has no mutants"):
            generate_mutants(driver, 3)
    with pytest.raises(InputError, match="no mutants"):
        nearest_preset_name({"driver": "somebody"})

    class Otherwise(BehaviourDriver):
        def acceleration(self, situation):
            return -1.0 * situation.speed

    with pytest.raises(InputError, match="no mutants"):
        nearest_preset_name(Otherwise())
    with pytest.raises(InputError, match="no mutants"):
        nearest_preset_name({**Otherwise().settings, "source": "64e76f09288e841b"})
    with pytest.raises(InputError, match="count"):
        generate_mutants("normal", 0)


OWN_CLASS = """
import cornercase as cc
from cornercase.drivers import Driver, Mutation


class Aeb(cc.SystemUnderTest):
    mutations = (
        Mutation("brakes later", "time_to_brake", 0.8, 0.2),
        Mutation("reacts later", "reaction", 0.1, 1.0, is_offset=True),
    )

    def __init__(self, time_to_brake: float = 2.5, reaction: float = 0.0):
        self.time_to_brake, self.reaction = time_to_brake, reaction

    def step(self, view, dt):
        for other in view.objects:
            if other.x > 0.0 and abs(other.y) < 4.0 and other.x < self.time_to_brake * view.ego.speed:
                return -8.0 if view.time > self.reaction else 0.0
        return 0.5 * (view.target_speed - view.ego.speed)


class Bare(Aeb):
    mutations = ()


class Wrong(Aeb):
    mutations = (Mutation("sees less", "sight", 0.8, 0.2),)


class Frames(Aeb):
    mutations = (Mutation("slower", "frames", 1.05, 3.0),)

    def __init__(self, frames: int = 3):
        super().__init__()


class Braking(Driver):
    mutations = (Mutation("brakes less", "deceleration", 0.8, 0.2),)

    def __init__(self, deceleration: float = 5.0):
        self.deceleration = deceleration

    def acceleration(self, situation):
        return 0.0 * situation.speed - self.deceleration
"""


@pytest.fixture
def own_module(tmp_path, monkeypatch):
    (tmp_path / "mutated_aeb.py").write_text(OWN_CLASS)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_class_of_the_user_has_the_mutants_that_it_declares(own_module):
    mutants = generate_mutants("mutated_aeb:Aeb", 6)
    assert {mutant.mutation for mutant in mutants} == {"brakes later", "reacts later"}
    values = [float(mutant.driver.rpartition("=")[2]) for mutant in mutants if mutant.mutation == "brakes later"]
    assert all(0.2 * 2.5 <= value <= 0.8 * 2.5 for value in values)
    given = generate_mutants("mutated_aeb:Aeb:reaction=0.5", 6)
    assert all("reaction=0.5" in mutant.driver for mutant in given if mutant.mutation == "brakes later")
    assert all(mutant.driver.count("reaction=") == 1 for mutant in given)
    with pytest.raises(InputError, match="declares none"):
        generate_mutants("mutated_aeb:Bare", 2)
    with pytest.raises(InputError, match="'sight', but its constructor has no option"):
        generate_mutants("mutated_aeb:Wrong", 2)


def test_a_whole_number_stays_one_in_a_mutant(own_module):
    mutants = generate_mutants("mutated_aeb:Frames", 10)
    values = [load_user_driver(mutant.driver).numeric_parameters()["frames"] for mutant in mutants]
    # Of 3.15 to 9, without 3.
    assert sorted(values) == [4.0, 5.0, 6.0, 7.0, 8.0, 9.0]
    with pytest.raises(InputError, match="no mutation changes a parameter"):
        generate_mutants("mutated_aeb:Frames:frames=0", 2)


def test_a_class_under_a_registered_name_has_the_mutants_that_it_declares(own_module, monkeypatch):
    monkeypatch.setattr(DRIVERS, "_factories", dict(DRIVERS._factories))
    DRIVERS.register("braking", "mutated_aeb:Braking")
    monkeypatch.syspath_prepend(own_module)
    assert mutable_driver_name("braking + radar") == "braking + radar"
    (mutant,) = generate_mutants("braking:deceleration=4", 1)
    assert mutant.mutation == "brakes less"
    assert 0.8 <= DRIVERS.create(mutant.driver).numeric_parameters()["deceleration"] <= 3.2


def test_reduce_and_test_make_mutants_of_a_class_of_the_user(own_module):
    x = EXAMPLES / "x_intersection"
    explored = cornercase(
        "explore", x / "x_intersection.xosc", "--space", x / "x_intersection.space.xosc", "--ego", "Ego", "--other",
        "Pedestrian", "--metric", "wttc", "--driver", "Ego=mutated_aeb:Aeb", "--optimizer", "sobol", "--budget", 8,
        "--duration", 8, "-o", "study.db",
    )  # fmt: skip
    assert explored.returncode == 0, explored.stderr
    assert cornercase("analyze", "study.db", "--by", "wttc").returncode == 0
    refused = cornercase("reduce", "study.db", "--size", 2, "--kill-mutants", 2, "-o", "reduced")
    assert refused.returncode == 2
    assert "but mutants need its code; give the driver with --driver" in refused.stderr
    other = cornercase(
        "reduce", "study.db", "--size", 2, "--kill-mutants", 2, "--driver", "Ego=mutated_aeb:Bare", "-o", "reduced"
    )
    assert other.returncode == 2
    assert "the study was explored with mutated_aeb:Aeb" in other.stderr
    reduced = cornercase(
        "reduce", "study.db", "--size", 2, "--kill-mutants", 2, "--driver", "Ego=mutated_aeb:Aeb", "-o", "reduced"
    )
    assert reduced.returncode == 0, reduced.stderr
    tested = cornercase("test", "reduced", "--mutants", 2, "--driver", "Ego=mutated_aeb:Aeb", "-o", "run.db")
    assert tested.returncode in (0, 1), tested.stderr
    assert "of 2 mutants" in tested.stdout
