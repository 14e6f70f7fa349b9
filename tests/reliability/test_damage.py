"""Studies that are damaged at random: nothing is used in silence, and what is lost is brought back."""

from __future__ import annotations

import os

import pytest
from damage import KINDS, Harness

from conftest import at_night

SEED = int(os.environ.get("CORNERCASE_TORTURE_SEED", "0"))
COMMANDS = ("show", "export", "report", "reduce", "explore", "analyze")


@pytest.fixture(scope="module", params=at_night(KINDS, list(KINDS)[1:]))
def harness(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Harness:
    return Harness(tmp_path_factory.mktemp("damage"), request.param)


@pytest.mark.parametrize("seed", range(SEED, SEED + 6))
def test_a_damaged_study_is_told_and_brought_back(harness, seed):
    before = len(harness.tried.faults)
    harness.one(seed, (COMMANDS[seed % len(COMMANDS)],))
    assert harness.tried.faults[before:] == []


@pytest.mark.torture
def test_a_thousand_damaged_studies(harness):
    # Each command on each would take an hour; three of them on each, in turn.
    count = int(os.environ.get("CORNERCASE_TORTURE_DAMAGED", "1000")) // len(KINDS)
    harness.tried.studies = harness.tried.meaningless = harness.tried.repaired = harness.tried.refused = 0
    for seed in range(SEED, SEED + count):
        harness.one(seed, tuple(COMMANDS[(seed + k) % len(COMMANDS)] for k in (0, 2, 4)))
    tried = harness.tried
    print(
        f"{tried.studies} damaged studies of {harness.kind}: {tried.meaningless} where the damage means nothing, {tried.repaired} brought back,"
        f" {tried.refused} of which it is lost what they are about; {len(tried.faults)} faults"
    )
    assert tried.faults == []
    assert tried.studies == tried.meaningless + tried.repaired + tried.refused
