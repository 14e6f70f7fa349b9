"""Preventability from a second run with a reference driver."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from cornercase.drivers.references.r157._preventability import ReferenceOutcome, assess_preventability
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import Builtin
from helpers.two_cars import met

ROOT = Path(__file__).parents[2]
T = np.arange(60) * 0.1
BRAKES = (20.0 * T, 0.0, 0.0, 20.0)


def judged(driver, run, original=None):
    return assess_preventability(driver, run, run if original is None else original, "Ego", "Other")


def ahead(gap, speed, aside=0.0, collides=None, heading=0.0):
    return met(BRAKES, (gap + 4.0 + speed * T, aside, heading, speed), collides)


@pytest.mark.slow
def test_it_agrees_with_the_outcomes_of_the_commission_where_an_encounter_ends_at_the_intrusion():
    rows = pd.read_csv(ROOT / "tests" / "data" / "r157" / "cut_in.csv")
    rows = rows[(rows.model == "CC_human_driver") & (rows.lateral_m_s > 0.4)]
    assert 10 < (rows.crash > 0).sum() < len(rows) - 10
    columns = {"ego_kmh": rows.ego_kmh, "other_kmh": rows.other_kmh}
    columns |= {"gap": rows.gap_m, "lateral_speed": rows.lateral_m_s}
    values = [dict(zip(columns, map(float, one), strict=True)) for one in zip(*columns.values(), strict=True)]
    concretes = [ConcreteScenario(ROOT / "examples" / "r157" / "cut_in.xosc", one) for one in values]
    runs = Builtin(time_step=0.1, duration=15.0, drivers={"Ego": "cc-human"}).run(concretes)
    found = [judged("cc-human", run).collides for run in runs]
    assert None not in found
    assert sum(a is not bool(b) for a, b in zip(found, rows.crash > 0, strict=True)) <= 2


@pytest.mark.parametrize("driver", ["cc-human", "fsm", "rss", "reg157", "cautious", "cautious:reaction_time=1"])
def test_who_does_not_touch_anybody_prevents_it_and_who_does_does_not(driver):
    hit, missed = ahead(20.0, 10.0, collides=2.0), ahead(200.0, 20.0)
    assert judged(driver, missed, hit) == ReferenceOutcome(False)
    assert judged(driver, hit) == ReferenceOutcome(True, 2.0)
    assert "prevents it" in judged(driver, missed, hit).describe(driver)
    assert judged(driver, hit).describe(driver) == f"{driver} does not prevent it either, and collides at 2 s"


def test_a_reference_of_the_regulation_says_nothing_of_what_it_is_no_model_of():
    missed, along = ahead(200.0, 20.0), ahead(20.0, 10.0, collides=2.0)
    crossing = met(BRAKES, (40.0, 15.0 * (2.0 - T), -np.pi / 2, 15.0), 2.0)
    oncoming = met(BRAKES, (80.0 - 20.0 * T, 0.0, np.pi, 20.0), 2.0)
    behind = met(BRAKES, (-14.0 + 25.0 * T, 0.0, 0.0, 25.0), 2.0)
    pedestrian = replace(along, object_types=("car", "pedestrian"))
    for original in (crossing, oncoming, behind, pedestrian):
        assert judged("cc-human", missed, original) == ReferenceOutcome(None)
        assert judged("fsm:delay=1", original, original) == ReferenceOutcome(None)
        assert judged("cautious", missed, original) == ReferenceOutcome(False)
    # The entity that the reference collides with has to be covered too.
    assert judged("rss", crossing, along) == ReferenceOutcome(None)
    assert "does not cover" in judged("rss", crossing, along).describe("rss")
    # The direction of a standing entity is ignored.
    standing = met(BRAKES, (44.0, 0.0, np.pi / 2, 0.0), 2.0)
    assert judged("cc-human", standing) == ReferenceOutcome(True, 2.0)


@pytest.mark.parametrize(("gap", "collides"), [(15.0, True), (30.0, False)])
def test_for_the_careful_human_a_cut_in_with_time_to_spare_is_no_danger(gap, collides):
    # From 3.5 m aside to the middle within 1 s, 10 m/s slower: the boxes overlap across the path from 0.5 s on, with a
    # gap that has closed by 5 m, so 1 s or 2.5 s before the contact.
    aside = np.clip(3.5 * (1.0 - T), 0.0, 3.5)
    assert aside[4] > 2.0 > aside[5]
    run = ahead(gap, 10.0, aside=aside, collides=gap / 10.0)
    outcome = judged("cc-human", run)
    assert outcome.collides is collides
    assert f"collides at {gap / 10.0:g} s" in outcome.describe("cc-human")
    assert ("counts as prevented" in outcome.describe("cc-human")) is not collides
    # Other references have no such end of an encounter.
    assert judged("fsm", run).collides
    # Nor does it exist for an entity that was ahead all the time.
    assert judged("cc-human", ahead(gap, 10.0, collides=gap / 10.0)).collides


def test_a_collision_in_the_first_instant_is_no_cut_in():
    run = ahead(-1.0, 10.0, collides=0.0)
    first = {name: getattr(run, name)[:, :1] for name in ("x", "y", "heading", "speed", "acceleration")}
    run = replace(run, time=run.time[:1], **first)
    assert judged("cc-human", run) == ReferenceOutcome(True, 0.0)
