"""The builtin simulator held against esmini: its recordings of others' scenarios and of random storyboards.

What is known to differ stands in ``data/esmini_differences.json``, each with its reason. A recording that starts to
match has to leave that list, so that it is held from then on.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from random import Random
from typing import Any

import pytest

import cornercase as cc
from conftest import at_night, ran
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import Builtin
from cornercase.simulators.pool._simulator import WorkerSimulator
from helpers.esmini_agreement import disagreement, last_instant, tracks_of, tracks_of_file
from helpers.random_storyboards import storyboard, write_roads

DRAWN = [f"s0-{k:04}" for k in range(100)]
"""Storyboards as ``benchmarks/esmini.py`` draws and names them with seed 0."""

BY_DAY, AT_NIGHT = (), pytest.mark.slow
REFERENCE = Path(__file__).parents[3] / "shared" / "reference" / "openscenario"
DIFFERENCES = json.loads((Path(__file__).parents[1] / "data" / "esmini_differences.json").read_text(encoding="utf-8"))


def recorded():
    """Scenario file, parameters, and esmini's recording of it, with the name of each."""
    found: list[Any] = []
    index = REFERENCE / "index.json"
    for row in json.loads(index.read_text(encoding="utf-8")) if index.is_file() else []:
        expected = REFERENCE / "expected" / row["expected"]
        found.append((REFERENCE / row["scenario"], row["parameters"], expected))
    for path in sorted((REFERENCE / "random").glob("*.xosc")):
        found.append((path, {}, path.parent / "expected" / f"{path.stem}.csv"))
    return [
        pytest.param(*one, id=one[-1].stem, marks=BY_DAY if k % 8 == 0 else AT_NIGHT) for k, one in enumerate(found)
    ]


def held(name, off):
    """Demand that a recording matches, or differs where that is known."""
    if name not in DIFFERENCES:
        assert off == ""
    else:
        assert off != "", f"{name} now matches: take it out of tests/data/esmini_differences.json"


@pytest.mark.parametrize(("scenario", "values", "expected"), recorded())
def test_gives_the_recording_of_esmini(scenario, values, expected):
    tracks = tracks_of_file(expected)
    simulator = Builtin(duration=min(last_instant(tracks) + 1.0, 40.0))
    try:
        (recording,) = ran(simulator, [ConcreteScenario(scenario, values)])
        off = disagreement(tracks, recording)
    except (cc.InputError, cc.SimulationError) as error:
        off = str(error)
    held(expected.stem, off)


@pytest.mark.skipif(not (REFERENCE / "index.json").is_file(), reason="the recordings are not beside the checkout")
def test_what_differs_is_among_the_recordings():
    assert set(DIFFERENCES) <= {one.id for one in recorded()} | set(DRAWN)


@pytest.fixture(scope="module")
def roads(tmp_path_factory):
    folder = tmp_path_factory.mktemp("roads")
    write_roads(folder)
    return folder


@pytest.mark.parametrize("seed", range(5))
def test_random_storyboards_are_valid_and_run(roads, seed):
    path = roads / f"{seed}.xosc"
    path.write_text(storyboard(Random(seed)))
    found = cc.check(path)
    assert not found.schema_errors
    assert not found.run_errors
    assert storyboard(Random(seed)) == path.read_text()


@pytest.fixture(scope="module")
def esmini():
    simulator = WorkerSimulator("esmini", {"duration": 20.0, "controllers": False, "undriven": True}, timeout=120.0)
    yield simulator
    simulator.close()


@pytest.mark.skipif("CORNERCASE_ESMINI" not in os.environ, reason="CORNERCASE_ESMINI does not name esmini's library")
@pytest.mark.parametrize("name", at_night(DRAWN, DRAWN[5:]))
def test_random_storyboards_run_as_in_esmini(roads, esmini, name):
    path = roads / f"{name}.xosc"
    seed, number = name[1:].split("-")
    path.write_text(storyboard(Random(f"{seed}-{int(number)}")), encoding="utf-8")
    (expected,) = ran(esmini, [ConcreteScenario(path, {})])
    tracks = tracks_of(expected)
    (recording,) = ran(Builtin(duration=min(last_instant(tracks) + 1.0, 20.0)), [ConcreteScenario(path, {})])
    held(name, disagreement(tracks, recording))
