from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import qmc

from conftest import at_night, examples
from cornercase._common.errors import InputError
from cornercase.optimizers import (
    OPTIMIZERS,
    Auto,
    Bayes,
    Committee,
    Grid,
    LevelSet,
    Optimizer,
    Random,
    Sobol,
)
from cornercase.optimizers._dedupe import Deduplicator
from cornercase.optimizers._random_features import RandomFeatureProcess
from cornercase.scenario import Constraint, Parameter, ParameterDeclaration, ParameterSpace
from cornercase.scenario._distributions import Distribution
from helpers.search_cases import CUBE, explored, ridge


def test_sobol_is_scipys_scrambled_sequence_of_the_seed():
    expected = qmc.Sobol(3, scramble=True, seed=np.random.default_rng(4)).random(1024)
    np.testing.assert_array_equal(explored(Sobol().start(CUBE, 4), 1000), expected[:1000])


@pytest.mark.parametrize(
    "make",
    [
        lambda: Sobol().start(CUBE, 1),
        lambda: Random().start(CUBE, 1),
        lambda: Grid().start(CUBE, 1, budget=400),
    ],
)
def test_the_sequence_does_not_depend_on_the_size_of_the_rounds(make):
    np.testing.assert_array_equal(explored(make(), 330, batch=7), explored(make(), 330, batch=100))


def test_asking_again_without_telling_gives_the_same():
    optimizer = Sobol().start(CUBE, 1)
    np.testing.assert_array_equal(optimizer.ask(30)[:10], optimizer.ask(10))


@pytest.mark.parametrize("make", [Sobol, Random])
def test_rare_values_of_a_finite_space_are_run_in_the_end(make):
    rare = Distribution("set", 0.0, 2.0, (1.0, 1e-9, 1e3))
    space = ParameterSpace(
        [Parameter("s", 0.0, 2.0, choices=("x", "y", "z"), distribution=rare), Parameter("t", 0.0, 9.0, 1.0)]
    )
    optimizer = make().start(space, 0)
    seen: set[tuple[Any, Any]] = set()
    while len(points := optimizer.ask(4)):
        optimizer.tell(points, np.zeros(len(points)))
        seen.update((v["s"], v["t"]) for v in space.values(points))
    assert seen == {(s, float(t)) for s in "xyz" for t in range(10)}


def test_a_large_finite_space_is_proposed_completely_at_once():
    space = ParameterSpace.from_ranges(["a=1:131073:1"])
    assert len(Random().start(space, 0).ask(131073)) == 131073


def test_a_grid_has_every_combination_once():
    points = Grid().start(CUBE, 0, budget=30).ask(100)
    middles = (1 / 6, 1 / 2, 5 / 6)
    assert {tuple(p) for p in points.round(9)} == {
        (round(a, 9), round(b, 9), round(c, 9)) for a in middles for b in middles for c in middles
    }
    assert len(points) == 27


def test_a_grid_gives_the_steps_that_one_parameter_lacks_to_the_others():
    space = ParameterSpace.from_ranges(["a=0:1:1", "b=0:1"])
    points = Grid().start(space, 0, budget=100).ask(1000)
    assert [len(np.unique(points[:, j])) for j in range(2)] == [2, 50]


@pytest.mark.parametrize("n", [4, 16])
def test_the_first_part_of_a_grid_covers_the_space(n):
    square = ParameterSpace.from_ranges(["a=0:1", "b=0:1"])
    points = Grid().start(square, 0, budget=64).ask(n)
    quadrants = np.unique(np.floor(points * 2).astype(int), axis=0, return_counts=True)[1]
    assert len(quadrants) == 4
    assert quadrants.max() <= 2 * quadrants.min()


def test_bayes_covers_the_critical_region_and_the_rest():
    points = explored(Bayes().start(CUBE, 0), 120)
    critical = ridge(points) == 0.0
    # A tenth of the cube is critical.
    assert critical.mean() > 0.3
    along = {(int(a * 6), int(c * 6)) for a, _, c in points[critical]}
    sobol = Sobol().start(CUBE, 0).ask(120)
    assert len(along) > len({(int(a * 6), int(c * 6)) for a, _, c in sobol[ridge(sobol) == 0.0]})
    assert len({tuple(cell) for cell in (points * 3).astype(int)}) >= 25


@pytest.mark.parametrize("n", [1, 3, 17])
@pytest.mark.parametrize("filling", [0.0, 0.3, 1.0])
def test_bayes_gives_as_many_points_as_asked_and_none_twice(n, filling):
    optimizer = Bayes(candidates=100, filling=filling).start(CUBE, 0)
    start = explored(optimizer, 24)
    points = optimizer.ask(n)
    assert points.shape == (n, 3)
    assert len(np.unique(np.concatenate([start, points]), axis=0)) == 24 + n


def test_bayes_never_proposes_a_failed_scenario_again():
    optimizer = Bayes().start(ParameterSpace.from_ranges(["a=0:9:1", "b=0:9:1"]), 0)

    def fails(points):
        return np.where(points[:, 0] > 0.5, np.nan, ridge(points))

    points = explored(optimizer, 90, function=fails)
    assert len(np.unique(points, axis=0)) == 90


@pytest.mark.parametrize(
    "scores", [lambda p: np.full(len(p), 3.0), lambda p: 1e-12 * ridge(p), lambda p: 1e12 * ridge(p)]
)
def test_bayes_stands_any_scale_of_scores(scores):
    points = explored(Bayes().start(CUBE, 0), 50, function=scores)
    assert np.isfinite(points).all()
    assert len(np.unique(points, axis=0)) == 50


def test_bayes_leaves_the_global_generator_and_the_terminal_alone(capfd):
    optimizer = Bayes().start(CUBE, 0)
    explored(optimizer, 20)
    np.random.seed(5)  # noqa: NPY002
    expected = np.random.rand(3)  # noqa: NPY002
    np.random.seed(5)  # noqa: NPY002
    first = optimizer.ask(10)
    np.testing.assert_array_equal(np.random.rand(3), expected)  # noqa: NPY002
    np.random.seed(6)  # noqa: NPY002
    np.testing.assert_array_equal(optimizer.ask(10), first)
    assert capfd.readouterr() == ("", "")


LEARNING = [name for name in OPTIMIZERS.names() if name not in ("grid", "random", "sobol")]


@pytest.mark.parametrize("name", at_night(LEARNING, set(LEARNING) - {"bayes", "evolutionary"}))
def test_every_search_keeps_to_constraints_names_and_steps_and_asks_for_nothing_twice(name):
    parameters = [
        Parameter("a", 0, 1),
        Parameter("kind", 0, 2, choices=("car", "truck", "bicycle")),
        Parameter("b", 0, 9, 1.0),
    ]
    # Less than 1.2 in the unit cube.
    limit = Constraint("lessThan", "${1.15 - $b / 10}")
    declared = [
        ParameterDeclaration("b", "double", "0"),
        ParameterDeclaration("kind", "string", ""),
        ParameterDeclaration("a", "double", "0", ((limit,),)),
    ]
    space = ParameterSpace(parameters).with_constraints(declared)

    def scores(points):
        kind = parameters[1].level_indices(points[:, 1])
        return np.where(points[:, 0] > 0.95, np.nan, np.abs(points[:, 0] - points[:, 2]) + 0.2 * kind)

    first, again = (OPTIMIZERS.create(name).start(space, 3, threshold=0.3, budget=100) for _ in range(2))
    everything = []
    for size in (10, 10, 10, 10, 10, 13, 1, 10):
        points = first.ask(size)
        assert points.shape == (size, 3)
        first.tell(points, scores(points))
        again.tell(points, scores(points))
        everything.append(points)
    met = np.concatenate(everything)
    assert space.is_admissible(met).all()
    np.testing.assert_array_equal(space.snap(met), met)
    assert len(np.unique(met, axis=0)) == len(met)
    np.testing.assert_array_equal(first.ask(5), again.ask(5))


class Threshold(Optimizer):
    """An optimizer of another package, which declares what it requires."""

    name, requires = "threshold", frozenset({"threshold", "budget"})

    def __init__(self, gain=1.0):
        self.gain = gain

    def prepare(self, space, seed, threshold, budget):
        self.given = (threshold, budget, self.gain)

    def ask(self, n):
        return np.zeros((0, 3))

    def tell(self, points, scores):
        pass


def test_an_optimizer_of_another_package_gets_what_it_declares(monkeypatch):
    monkeypatch.setitem(OPTIMIZERS._factories, "mine", (Threshold, {}))
    assert OPTIMIZERS.get_class("mine:gain=2").requires == {"threshold", "budget"}
    made: Any = OPTIMIZERS.create("mine:gain=2").start(CUBE, 0, threshold=0.5, budget=30)
    assert made.given == (0.5, 30, 2)
    with pytest.raises(InputError, match="needs a threshold"):
        OPTIMIZERS.create("mine").start(CUBE, 0, budget=30)
    monkeypatch.setitem(OPTIMIZERS._factories, "function", (lambda space, seed: None, {}))
    with pytest.raises(InputError, match="not a subclass"):
        OPTIMIZERS.create("function").start(CUBE, 0, budget=30)


def test_what_an_optimizer_does_not_declare_it_does_not_get():
    assert Optimizer.requires == frozenset()
    assert not Optimizer.multi_objective
    assert {
        name: OPTIMIZERS.get_class(name).requires for name in OPTIMIZERS.names() if OPTIMIZERS.get_class(name).requires
    } == {
        "auto": {"threshold", "features"},
        "committee": {"threshold", "features"},
        "grid": {"budget"},
        "level-set": {"threshold"},
    }


def test_the_same_concrete_scenario_is_proposed_once():
    space = ParameterSpace.from_ranges(["a=0:9:1", "b=0:1"])
    unseen = Deduplicator(space)
    unseen.remember(np.array([[0.31, 0.5]]))
    points = np.array([[0.35, 0.5], [0.35, 0.6], [0.39, 0.6], [0.75, 0.1], [0.95, 0.1]])
    np.testing.assert_array_equal(unseen.filter(points, exclude=np.array([[0.99, 0.1]])), points[[1, 3]])
    assert len(unseen) == 1


MODELS: dict[str, Any] = {
    "bayes": lambda space=CUBE, **more: Bayes(**more).start(space, 5),
    "level-set": lambda space=CUBE, **more: LevelSet(**more).start(space, 5, threshold=0.1),
    "committee": lambda space=CUBE, **more: Committee(**more).start(space, 5, threshold=0.1, features=()),
    "auto": lambda space=CUBE, **more: Auto(**more).start(space, 5, threshold=0.1, features=()),
}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow if name in ("auto", "committee") else ()) for name in MODELS]
)
def test_what_is_asked_for_hangs_on_what_was_told_not_on_what_was_asked_or_on_the_rounds(name):
    """A killed study is resumed as if it had not been interrupted."""
    whole = explored(MODELS[name](), 90, batch=7)
    for told in (38, 64, 83):
        again = MODELS[name]()
        again.tell(whole[:told], ridge(whole[:told]))
        asked = MODELS[name]()
        for first in range(0, told, 5):
            asked.tell(whole[first : min(first + 5, told)], ridge(whole[first : min(first + 5, told)]))
            asked.ask(3)
        np.testing.assert_array_equal(again.ask(7), asked.ask(7))
    again = MODELS[name]()
    again.tell(whole[:77], ridge(whole[:77]))
    np.testing.assert_array_equal(again.ask(7), whole[77:84])


@pytest.mark.parametrize("most", at_night([121, 1000], {1000}))
@pytest.mark.parametrize("name", at_night(MODELS, list(MODELS)[1:]))
def test_a_model_is_learned_anew_with_ten_more_scores_or_a_share(name, most, monkeypatch):
    learned: list[int] = []
    optimizer = MODELS[name]()
    original = optimizer._fit_model

    def learn(points, scores, seed):
        learned.append(len(points))
        original(points, scores, seed)

    monkeypatch.setattr(optimizer, "_fit_model", learn)
    points = explored(optimizer, 20, batch=20)
    for told in (24, 27, 30, 100, 109, 110, 120, 121, *([1000] if most == 1000 else [])):
        more = Sobol().start(CUBE, told).ask(told - len(points))
        optimizer.tell(more, ridge(more))
        points = np.concatenate([points, more])
        optimizer.ask(1)
    # A tenth more: 100, 110, 121 and so on; a quarter more: 77, 96, 120 and so on; half more: 67, 100, 150 and so on.
    # Asked for when so many were told.
    last = {"committee": [96, 120, 883], "auto": [100, 757]}.get(name, [100, 110, 121, 958])
    assert learned == [20, 30, *(last if most == 1000 else last[:-1])]


@pytest.mark.parametrize("name", at_night(MODELS, list(MODELS)[1:]))
def test_scores_that_begin_all_the_same_are_learned_from_once_they_differ(name):
    counted = [0]

    def late(points):
        counted[0] += len(points)
        return np.full(len(points), 1.0) if counted[0] <= 40 else 1.0 - points[:, 0]

    points = explored(MODELS[name](), 80, function=late)
    assert len(np.unique(points, axis=0)) == 80


def test_candidates_that_run_out_are_followed_by_others():
    optimizer = LevelSet(candidates=20).start(CUBE, 0, threshold=0.1)
    points = explored(optimizer, 90, batch=15)
    assert len(np.unique(points, axis=0)) == 90


@settings(max_examples=examples(20), deadline=None)
@given(st.integers(0, 30), st.integers(0, 30), st.floats(0.05, 1.0), st.integers(0, 1000))
def test_random_features_take_values_in_step_by_step_or_at_once(first, second, noise, seed):
    rng = np.random.default_rng(seed)
    points, values = rng.random((first + second, 2)), rng.normal(size=first + second)
    empty = RandomFeatureProcess(rng.normal(size=(40, 2)), rng.random(40), 0.2, 0.3, noise)
    steps = empty.with_more_values(points[:first], values[:first]).with_more_values(points[first:], values[first:])
    once = empty.with_more_values(points, values)
    drawn = [one.draw_weights(2000, np.random.default_rng(1)) for one in (steps, once)]
    np.testing.assert_allclose(drawn[0], drawn[1], atol=1e-7)
    # The mean of the samples is that of ridge regression.
    rows = once.random_features(points)
    mean = np.linalg.solve(rows.T @ rows + noise**2 * np.eye(40), rows.T @ (values - 0.3))
    np.testing.assert_allclose(drawn[0].mean(axis=0), mean, atol=0.12)
