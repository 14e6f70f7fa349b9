"""A scenario's files are read and prepared once, and never mixed with later versions of them."""

from __future__ import annotations

import pickle
from collections import Counter
from pathlib import Path
from shutil import copytree

import numpy as np
import pytest
from lxml import etree
from typer.testing import CliRunner

from conftest import EXAMPLES, same_recording
from cornercase._common.errors import InputError
from cornercase._common.io import files
from cornercase.cli import app
from cornercase.roads._network import RoadNetwork
from cornercase.scenario import ConcreteScenario, LogicalScenario
from cornercase.simulators import Builtin
from cornercase.simulators.pool._simulator import WorkerSimulator


@pytest.fixture
def folder(tmp_path) -> Path:
    return Path(copytree(EXAMPLES / "x_intersection", tmp_path / "x"))


@pytest.fixture
def reads(monkeypatch) -> Counter[str]:
    """Count how often each file is read, parsed, and turned into a road network."""
    counted: Counter[str] = Counter()
    read, parse, begin = files.read_file, etree.fromstring, RoadNetwork.__init__

    def read_file(path):
        counted[f"read {Path(path).name}"] += 1
        return read(path)

    def fromstring(data, *arguments, **options):
        counted[f"parse {hash(data)}"] += 1
        return parse(data, *arguments, **options)

    def make(network, *arguments):
        counted["network"] += 1
        begin(network, *arguments)

    monkeypatch.setattr("cornercase.scenario._xml.read_file", read_file)
    monkeypatch.setattr(etree, "fromstring", fromstring)
    monkeypatch.setattr(RoadNetwork, "__init__", make)
    return counted


def read(folder: Path) -> LogicalScenario:
    return LogicalScenario.read(folder / "x_intersection.xosc", folder / "x_intersection.space.xosc")


def a_round(logical: LogicalScenario, number: int) -> list[ConcreteScenario]:
    places = np.array([[(3 * number + k) / 12, 0.5, 0.5] for k in range(3)])
    return [logical.concrete_scenario(values) for values in logical.space.values(places)]


def elsewhere(concretes):
    """The same concrete scenarios as another process receives them."""
    return pickle.loads(pickle.dumps(concretes))


def test_an_exploration_reads_each_file_once(folder, reads, tmp_path):
    command = [
        "explore", folder / "x_intersection.xosc", "--space", folder / "x_intersection.space.xosc", "--ego", "Ego",
        "--other", "Pedestrian", "--metric", "distance", "--optimizer", "sobol", "--budget", 6, "--batch", 2,
        "--duration", 2, "-o", tmp_path / "study.db",
    ]  # fmt: skip
    result = CliRunner().invoke(app, [str(one) for one in command])
    assert result.exit_code == 0, result.output
    assert {"read x_intersection.xosc", "read x_intersection.xodr", "read x_intersection.space.xosc"} <= set(reads)
    assert set(reads.values()) == {1}


def test_a_worker_reads_each_file_once(folder, reads):
    logical, simulator = read(folder), Builtin(duration=2.0)
    reads.clear()
    for number in range(3):
        list(simulator.run(elsewhere(a_round(logical, number))))
    assert set(reads.values()) == {1}


def test_processes_keep_what_they_have_prepared(folder):
    logical = read(folder)
    with WorkerSimulator("builtin", {"duration": 2.0}, 1) as simulator:
        list(simulator.run(a_round(logical, 0)))
        (folder / "x_intersection.xodr").unlink()
        results = list(simulator.run(a_round(logical, 1)))
    assert not any(isinstance(result, Exception) for result in results)


def test_a_file_that_changes_between_rounds_is_not_mixed_in(folder):
    logical, simulator = read(folder), Builtin(duration=2.0)
    before = list(simulator.run(a_round(logical, 0)))
    change(folder)
    for one, again in zip(before, simulator.run(a_round(logical, 0)), strict=True):
        assert same_recording(one, again)
    assert read(folder).fingerprint != logical.fingerprint
    # Reading it again gives its present content.
    (other,) = simulator.run(a_round(read(folder), 0)[:1])
    assert not same_recording(other, before[0])


def test_a_process_refuses_a_file_that_has_changed(folder):
    concretes = a_round(read(folder), 0)
    change(folder)
    with pytest.raises(InputError, match="has changed since it was read"):
        list(Builtin(duration=2.0).run(elsewhere(concretes)))


def test_a_scenario_named_by_its_path_is_read_as_it_is_now(folder):
    simulator, concrete = Builtin(duration=2.0), ConcreteScenario(folder / "x_intersection.xosc")
    (before,) = simulator.run([concrete])
    change(folder)
    (after,) = simulator.run([concrete])
    assert not same_recording(before, after)


def change(folder: Path) -> None:
    """Make the vehicles longer."""
    path = folder / "x_intersection.xosc"
    root = etree.parse(str(path)).getroot()
    for box in root.iterfind(".//ScenarioObject/Vehicle/BoundingBox/Dimensions"):
        box.set("length", str(float(box.attrib["length"]) + 0.5))
    path.write_bytes(etree.tostring(root))
