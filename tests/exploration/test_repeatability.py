"""Check if runs are deterministic: the first scenario of a study is run twice."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

import cornercase as cc
from cornercase._common.errors import NoticeWarning, SimulationError
from cornercase.drivers import Driver
from cornercase.recordings import Recording
from cornercase.report import write_report
from cornercase.scenario import LogicalScenario
from cornercase.simulators import SIMULATORS, Simulator
from cornercase.study import StudyFile
from cornercase.study._checksums import delete_rows
from helpers.command_line import cornercase


class Dice(Driver):
    """Draws random numbers."""

    def acceleration(self, situation):
        return np.random.default_rng().uniform(-1.5, 1.5, situation.speed.shape)


class Seeded(Driver):
    """Draws the same random numbers in each scenario."""

    def acceleration(self, situation):
        drawn = np.random.default_rng(round(situation.time / situation.time_step)).normal(0.0, 1.0)
        return np.full_like(situation.speed, drawn)


class Remembering(Driver):
    """Keeps a counter between batches."""

    batches = 0

    def start(self, scenarios, others):
        self.batches += 1

    def acceleration(self, situation):
        return np.full_like(situation.speed, -1.0 - 0.1 * self.batches)


class Sociable(Driver):
    """Depends on the other scenarios of its batch."""

    def acceleration(self, situation):
        return np.full_like(situation.speed, -situation.speed.mean() / 100.0 - len(situation.speed) / 10.0)


class Drifting(Simulator):
    """Claims to be deterministic, and is, up to 1.5e-5 m."""

    name = "drifting"
    in_process = True
    deterministic = True
    drift = 1.5e-5

    def __init__(self):
        self.settings: dict[str, object] = {}
        self.runs = 0

    def run(self, concretes):
        for concrete in concretes:
            self.runs += 1
            way = float(concrete.values["ego_start"]) + np.arange(5.0) + self.drift * self.runs
            still, ones = np.zeros(5), np.ones(2)
            yield Recording(
                time=np.arange(5.0), names=("Ego", "Pedestrian"), object_types=("car", "pedestrian"),
                x=np.stack([way, still]), y=np.stack([still, still]), heading=np.stack([still, still]),
                speed=np.stack([still, still]), acceleration=np.stack([still, still]),
                length=ones, width=ones, center_x=0.0 * ones,
            )  # fmt: skip


class Steady(Drifting):
    """Is deterministic as declared."""

    name, drift = "steady-simulator", 0.0


class Modest(Drifting):
    """Does not claim to be deterministic."""

    name, deterministic = "modest", False


@pytest.fixture(autouse=True)
def registered(monkeypatch) -> None:
    monkeypatch.setattr(SIMULATORS, "_factories", dict(SIMULATORS._factories))
    for one in (Drifting, Steady, Modest):
        SIMULATORS.register(one.name, one)


@pytest.fixture
def explore(x_intersection: LogicalScenario, tmp_path: Path):
    def explored(name: str, **options: Any) -> Path:
        given: dict[str, Any] = {"budget": 12, "batch": 5, "duration": 3.0, "optimizer": "sobol"} | options
        if "simulator" in given:
            del given["duration"]
        path = tmp_path / name
        cc.explore(x_intersection, path, ego="Ego", other="Pedestrian", metrics=["distance"], **given)
        return path

    return explored


def tried(path: Path) -> dict[str, Any]:
    with StudyFile.open(path) as study:
        return dict(study.meta.repeatability)


@pytest.mark.parametrize("asynchronous", [False, True])
def test_42_6_a_study_knows_that_its_driver_draws_random_numbers(explore, asynchronous):
    with pytest.warns(
        NoticeWarning, match=r"runs differ: scenario 1 was run twice, and in .* apart; .* with `repeats`"
    ):
        path = explore("dice.db", drivers={"Ego": Dice()}, asynchronous=asynchronous, budget=6)
    found = tried(path)
    assert (found["scenario"], found["same"]) == (1, False)
    assert 0.01 < found["apart"] < 100.0
    words = f"scenario 1 was run twice, and in its recordings entities are up to {found['apart']:.3g} m apart"
    assert f"Runs differ: {words}" in cornercase("show", path).stdout
    assert json.loads(cornercase("show", path, "--json").stdout)["runs_differ"] == words
    assert words in write_report(path, path.with_suffix(".html")).read_text()


@pytest.mark.parametrize("driver", [Remembering, Sociable])
def test_42_6_what_depends_on_other_runs_does_not_repeat_itself(explore, driver):
    with pytest.warns(NoticeWarning, match="runs differ"):
        path = explore("s.db", drivers={"Ego": driver()})
    assert not tried(path)["same"]


@pytest.mark.filterwarnings("error:runs differ")
def test_42_6_seeded_random_numbers_repeat_themselves(explore):
    path = explore("seeded.db", drivers={"Ego": Seeded()})
    assert tried(path) == {"scenario": 1, "same": True, "apart": None}
    assert "differ" not in cornercase("show", path).stdout
    with StudyFile.open(path) as study:
        assert len(study.rows()) == 12


@pytest.mark.filterwarnings("ignore:runs differ")
def test_42_6_compare_is_certain_only_of_runs_that_were_seen_to_repeat_themselves(explore, tmp_path):
    dice = [explore(f"dice{k}.db", drivers={"Ego": Dice()}) for k in range(2)]
    found = cc.compare(*dice)
    assert not found.is_deterministic
    assert found.count_pairs("otherwise") == 12
    assert "repeat themselves" not in found.reason
    assert sum(one.startswith(f"runs of dice{k}.db differ: scenario 1") for k, one in enumerate(found.differences)) == 2
    seeded = [explore(f"seeded{k}.db", drivers={"Ego": Seeded()}) for k in range(2)]
    assert cc.compare(*seeded).is_deterministic
    assert not cc.compare(seeded[0], dice[0]).is_deterministic


@pytest.mark.filterwarnings("ignore:runs differ")
def test_42_6_a_simulator_is_not_believed_that_it_repeats_itself(explore):
    found = {one.name: tried(explore(f"{one.name}.db", simulator=one.name)) for one in (Drifting, Steady, Modest)}
    assert found["drifting"] == {"scenario": 1, "same": False, "apart": pytest.approx(7.5e-5, rel=1e-6)}
    assert found["steady-simulator"]["same"]
    # Without the claim there is no check.
    assert found["modest"] == {}
    assert cc.compare(
        explore("a.db", simulator="steady-simulator"), explore("b.db", simulator="steady-simulator")
    ).is_deterministic
    assert not cc.compare(explore("c.db", simulator="drifting"), explore("d.db", simulator="drifting")).is_deterministic


@pytest.mark.filterwarnings("ignore:runs differ")
def test_42_6_a_second_run_that_fails_is_told(explore, monkeypatch):
    class Once(Steady):
        """Runs a scenario once."""

        name, wrong = "once", RuntimeError("known already")
        ran: ClassVar[set[float]] = set()

        def run(self, concretes):
            for concrete, found in zip(concretes, super().run(concretes), strict=True):
                value = float(concrete.values["ego_start"])
                if value in self.ran:
                    if isinstance(self.wrong, SimulationError):
                        yield self.wrong
                        continue
                    raise self.wrong
                self.ran.add(value)
                yield found

    SIMULATORS.register("once", Once)
    # An own failure counts as a difference; after an external one the check is repeated.
    assert tried(explore("a.db", simulator="once")) == {"scenario": 1, "same": False, "apart": None}
    Once.ran.clear()
    monkeypatch.setattr(Once, "wrong", SimulationError("no licence"))
    with pytest.warns(NoticeWarning, match=r"scenario 1 could not be run a second time \(no licence\)"):
        path = explore("b.db", simulator="once")
    assert tried(path) == {}


def test_42_6_it_is_tried_once_and_also_when_a_search_goes_on(explore, monkeypatch):
    runs = []
    monkeypatch.setattr(Steady, "close", lambda simulator: runs.append(simulator.runs))
    path = explore("s.db", simulator="steady-simulator", budget=4)
    explore("s.db", simulator="steady-simulator", budget=6)
    assert runs == [5, 2]
    # A search that was killed before resumes; nothing else in the study differs.
    other = explore("t.db", simulator="steady-simulator", budget=6)
    contents = [stored(one) for one in (path, other)]
    assert contents[0] == contents[1]
    with StudyFile.open(other, readonly=False) as study, study._database.transaction() as connection:
        delete_rows(connection, "meta", "key = ?", "repeatability")
    assert tried(other) == {}
    explore("t.db", simulator="steady-simulator", budget=6)
    assert runs[-1] == 1
    assert stored(other) == contents[0]


def stored(path: Path) -> dict[str, object]:
    with StudyFile.open(path) as study:
        return {"meta": study.meta.to_json(), "rows": [study.recording(row.id).x.tobytes() for row in study.rows()]}


@pytest.mark.slow
def test_42_6_any_number_of_workers_gives_the_same_study(explore):
    alone, both = (explore(f"{k}.db", drivers={"Ego": "normal"}, workers=k) for k in (1, 2))
    assert stored(alone) == stored(both)


@pytest.mark.filterwarnings("ignore:runs differ")
def test_42_6_runs_of_suites_are_tried_too(explore, tmp_path, x_intersection):
    path = explore("s.db", drivers={"Ego": "normal"})
    cc.analyze(path)
    cc.reduce(path, tmp_path / "set", scenario=x_intersection.scenario_file)
    cc.run_suite(tmp_path / "set", tmp_path / "a.db", drivers={"Ego": Seeded()})
    cc.run_suite(tmp_path / "set", tmp_path / "b.db", drivers={"Ego": Dice()})
    assert tried(tmp_path / "a.db")["same"]
    assert not tried(tmp_path / "b.db")["same"]
    assert not cc.compare(tmp_path / "a.db", tmp_path / "b.db").is_deterministic
