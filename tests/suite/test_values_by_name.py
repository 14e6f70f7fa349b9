"""Suites of simulators of one's own: they run the values that they were made of, whichever way they take them."""

from __future__ import annotations

from typing import Any

import pytest

import cornercase as cc
from conftest import EXAMPLES, moving, same_recording, scenario_file
from cornercase._common.errors import InputError
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario
from cornercase.scenario._constraints import read_declarations
from cornercase.scenario._file import ScenarioFile
from cornercase.simulators import SIMULATORS, Builtin
from cornercase.simulators._create import create_simulator
from cornercase.simulators._results import run_scenarios
from cornercase.study import StudyFile
from documentation.test_documentation import ROOT, blocks_of
from helpers.fake_simulators import Plan

pytestmark = pytest.mark.filterwarnings("ignore::cornercase._common.errors.NoticeWarning")

X = EXAMPLES / "x_intersection" / "x_intersection.xosc"
SPACE = EXAMPLES / "x_intersection" / "x_intersection.space.xosc"
WHO: dict[str, Any] = {"ego": "Ego", "other": "Pedestrian", "metrics": ["clearance"]}


@pytest.fixture(scope="module")
def own():
    """Values that the file declares."""
    return {one.name: float(one.value) for one in read_declarations(ScenarioFile.read(X).root, str(X))}


@pytest.fixture(scope="module")
def noting():
    """The simulator of docs/howto/own-simulator.md, as "noting", and the list of the values that it is given."""
    names: dict[str, Any] = {}
    block = next(one for one in blocks_of(ROOT / "docs" / "howto" / "own-simulator.md") if one.language == "python")
    exec(compile(block.text.partition("SIMULATORS.register")[0], block.place, "exec"), names)
    given: list[dict[str, Any]] = []
    base: Any = names["Braking"]

    class Noting(base):  # type: ignore[misc]
        name = "noting"
        # Else the first scenario would be run once more.
        deterministic = False

        def run(self, concretes):
            given.extend(dict(one.values) for one in concretes)
            return super().run(concretes)

    SIMULATORS.register("noting", Noting)
    return given


@pytest.fixture
def braking(noting):
    noting.clear()
    return noting


def suite_of(folder, ranges=(), **more):
    """A study, and its reduced set."""
    space = None if ranges else SPACE
    cc.explore(X, folder / "s.db", space=space, ranges=ranges, optimizer="sobol", budget=12, **WHO, **more)
    cc.analyze(folder / "s.db")
    return cc.reduce(folder / "s.db", folder / "set", size=4, scenario=X)


def test_42_1_a_suite_runs_the_values_that_it_was_made_of(braking, tmp_path):
    kept = suite_of(tmp_path, simulator="noting")
    explored, braking[:] = braking[:], []
    ran = cc.run_suite(tmp_path / "set", tmp_path / "run.db")
    assert braking == [explored[one.id - 1] for one in kept.scenarios]
    assert len({one["ego_start"] for one in braking}) > 1
    assert [one.difference.same for one in ran.scenarios if one.difference is not None] == [True] * len(kept.scenarios)
    # The same files without a manifest.
    braking.clear()
    (tmp_path / "set" / "manifest.json").unlink()
    cc.run_suite(tmp_path / "set", tmp_path / "f.db", ego="Ego", other="Pedestrian", simulator="noting")
    assert braking == [explored[one.id - 1] for one in sorted(kept.scenarios, key=lambda one: one.file)]


@pytest.mark.parametrize("varied", ["p1_speed=1:2", "pedestrian_wait=0:2"])
def test_42_1_a_parameter_that_is_not_varied_has_its_value_of_the_file(braking, own, tmp_path, varied):
    suite_of(tmp_path, [varied], simulator="noting")
    cc.run_suite(tmp_path / "set", tmp_path / "run.db")
    assert {one["ego_start"] for one in braking} == {own["ego_start"]}
    name = varied.partition("=")[0]
    assert len({one[name] for one in braking}) > 1


def test_42_1_one_file_alone_and_many_are_given_their_values(braking, tmp_path):
    kept = suite_of(tmp_path, simulator="noting")
    explored, braking[:] = braking[:], []
    file = tmp_path / "set" / kept.scenarios[0].file
    alone = cc.simulate(file, simulator="noting")
    cc.simulate_many([file], tmp_path / "recordings", simulator="noting")
    cc.simulate(file, {"ego_start": 44.0}, simulator="noting")
    first = explored[kept.scenarios[0].id - 1]
    assert braking == [first, first, first | {"ego_start": 44.0}]
    with StudyFile.open(tmp_path / "s.db", readonly=True) as study:
        assert same_recording(alone, study.recording(kept.scenarios[0].id))


@pytest.mark.parametrize("options", [{"workers": 2}, {"timeout": 60.0}])
def test_42_1_values_by_name_reach_a_simulator_in_another_process(own, tmp_path, options):
    with create_simulator("named-values", {"plan": Plan(tmp_path)}, **options) as simulator:
        (found,) = run_scenarios(simulator, [ConcreteScenario(X, {"p1_speed": 1.5}, ScenarioFile.read(X))])
    assert isinstance(found, Recording)
    assert dict(zip(found.names, found.x[:, 0].tolist(), strict=True)) == own | {"p1_speed": 1.5}


def test_42_1_values_by_name_are_of_the_types_that_the_file_declares(tmp_path):
    kinds = {
        "a": ("double", "2.50"), "b": ("integer", "${$a * 2}"), "c": ("boolean", "1"), "d": ("string", "07"),
        "e": ("double", "$a"), "f": ("double", "none"),
    }  # fmt: skip
    declared = "".join(
        f'<ParameterDeclaration name="{name}" parameterType="{kind}" value="{value}"/>'
        for name, (kind, value) in kinds.items()
    )
    path = scenario_file(tmp_path, init=moving(), parameters=declared)
    scenario = ScenarioFile.read(path)
    given = ConcreteScenario(path, {"a": "3.0", "other": "x"}, scenario)
    assert given.with_all_values().values == {
        "a": 3.0, "b": 6, "c": "true", "d": "07", "e": 3.0, "f": "none", "other": "x",
    }  # fmt: skip
    assert isinstance(given.with_all_values().values["b"], int)
    assert ConcreteScenario(path, {}, scenario).with_all_values().values["e"] == 2.5
    assert given.with_all_values().with_all_values() == given.with_all_values()
    # What was not read stays as it is.
    assert ConcreteScenario(path, {"a": 1.0}).with_all_values().values == {"a": 1.0}
    with pytest.raises(InputError, match=r"scenario\.xosc, line \d+: value of <ParameterDeclaration> is 'x', which"):
        ConcreteScenario(path, {"a": "x"}, scenario).with_all_values()


def test_42_1_a_simulator_that_reads_the_file_is_given_only_what_differs_from_it(monkeypatch):
    given: list[Any] = []
    run = Builtin.run

    def noted(self, concretes):
        given.extend(concretes)
        return run(self, concretes)

    monkeypatch.setattr(Builtin, "run", noted)
    cc.simulate(X, {"p1_speed": 1.5}, duration=0.2)
    assert [one.values for one in given] == [{"p1_speed": 1.5}]
    names = ("builtin", "esmini", "sumo", "carla", "carmaker")
    assert [SIMULATORS.get_class(name).parameter_passing for name in names] == ["file", "file", "file", "file", "name"]
