"""Mutants of drivers."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise

import pytest

from cornercase._common.errors import InputError
from cornercase.drivers import AGGRESSIVE, DRIVERS, NORMAL, BehaviourDriver, generate_mutants
from cornercase.drivers._mutants import nearest_preset_name

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


def test_drivers_without_mutants_are_refused():
    for driver in ("cc-human", "mymodule:MyDriver"):
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
