"""Scores that searches receive, several metrics, and stop criteria."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from conftest import examples
from cornercase._common.errors import InputError
from cornercase.exploration._best_scores import BestScores, is_on_pareto_front
from cornercase.metrics import METRICS
from cornercase.optimizers import OPTIMIZERS, Evolutionary, Optuna
from cornercase.scenario import Constraint, Parameter, ParameterDeclaration, ParameterSpace
from cornercase.study import StudyFile
from cornercase.study._criterion import Criterion
from cornercase.study._objective import Objective
from helpers.command_line import SPACE, X, cornercase
from helpers.search_cases import CUBE, explored
from helpers.synthetic_study import explorer, opened

TTC, DRAC = METRICS.create("ttc"), METRICS.create("drac")
NAMED = ParameterSpace([*CUBE.parameters, Parameter("kind", 0, 2, choices=("car", "truck", "bicycle"))])


def bowl(points):
    """Minimum at 0.3 in each direction, for trucks."""
    truck = NAMED.parameters[3].level_indices(points[:, 3]) == 1
    return np.linalg.norm(points[:, :3] - 0.3, axis=1) + np.where(truck, 0.0, 1.0)


def between(points):
    """Two scores whose Pareto set is the line from 0.3 to 0.7."""
    return np.stack([np.linalg.norm(points[:, :3] - place, axis=1) for place in (0.3, 0.7)], axis=1)


def test_lower_is_always_more_critical():
    scores = np.array([[1.5, 4.0], [0.5, 8.0]])
    np.testing.assert_array_equal(Objective([TTC, DRAC]).compute_scores_to_minimize(scores), [1.5, 0.5])
    np.testing.assert_array_equal(Objective([DRAC, TTC]).compute_scores_to_minimize(scores[:, ::-1]), [-4.0, -8.0])
    both = Objective([TTC, DRAC], {"ttc": 2.0, "drac": 0.5})
    np.testing.assert_array_equal(both.compute_scores_to_minimize(scores), [1.0, -3.0])
    assert both.label == "2 ttc + 0.5 (-drac)"
    np.testing.assert_array_equal(
        Objective([TTC, DRAC], pareto=True).compute_scores_to_minimize(scores), [[1.5, -4.0], [0.5, -8.0]]
    )
    criterion = Criterion(3.0, lower_is_critical=False, unit="m/s²")
    assert Objective([DRAC], threshold=3.0).criterion == criterion
    assert criterion.is_critical(np.array([-4.0, -3.0, -2.0, np.nan])).tolist() == [True, True, False, False]
    assert (criterion.oriented, str(criterion)) == (-3.0, ">= 3 m/s²")
    # Unused scores may be undefined.
    np.testing.assert_array_equal(Objective([TTC, DRAC]).compute_scores_to_minimize(np.array([[1.5, np.nan]])), [1.5])


@pytest.mark.parametrize(
    ("weights", "pareto", "words"),
    [
        ({"tcc": 1.0}, False, "did you mean 'ttc'"),
        ({"ttc": -1.0}, False, "above 0"),
        ({"drac": math.inf}, False, "drac=inf: give a finite number above 0\\.$"),
        ({"ttc": 1.0}, True, "leave `weights` out"),
    ],
)
def test_what_cannot_be_searched_is_refused(weights, pareto, words):
    with pytest.raises(InputError, match=words):
        Objective([TTC, DRAC], weights, pareto)


def test_what_is_critical_needs_one_score():
    with pytest.raises(InputError, match="has no threshold"):
        Objective([TTC, DRAC], pareto=True).with_threshold(1.0)
    with pytest.raises(InputError, match="the highest weighted sum that counts"):
        Objective([TTC, DRAC], {"ttc": 1.0}).with_threshold(None)


@given(arrays(np.float64, st.tuples(st.integers(1, 25), st.integers(1, 3)), elements=st.integers(0, 4).map(float)))
@settings(max_examples=examples(100), deadline=None)
def test_the_front_is_what_nothing_dominates(values):
    expected = [not any((b <= a).all() and (b < a).any() for b in values) for a in values]
    np.testing.assert_array_equal(is_on_pareto_front(values), expected)


def test_news_is_what_nothing_before_was_better_than():
    best = BestScores(Objective([TTC, DRAC], pareto=True))
    assert best.update(np.array([[1.0, -1.0], [2.0, -2.0], [np.nan, np.nan]]))
    assert not best.update(np.array([[2.0, -1.0]]))
    assert best.update(np.array([[3.0, -3.0]]))
    assert best.label == "front of 3"
    one = BestScores(Objective([TTC]))
    assert [one.update(np.array([value])) for value in (10.0, 10.0, 4.0, 5.0, 4.0)] == [True, False, True, False, True]
    assert one.label == "best 4 s"
    # Of a metric that is critical where it is high, 0 is stored as -0.
    high = BestScores(Objective([DRAC]))
    high.update(np.array([-0.0]))
    assert high.label == "best 0 m/s²"


@pytest.mark.parametrize("search", [Evolutionary(), Optuna()], ids=str)
def test_searches_of_the_lowest_score_find_it_among_names_too(search):
    points = explored(search.start(NAMED, 2), 200, function=bowl)
    assert len(np.unique(points, axis=0)) == 200
    np.testing.assert_array_equal(NAMED.snap(points), points)
    assert bowl(points).min() < 0.12
    assert np.mean(bowl(points)[100:] < 0.5) > 0.3


@pytest.mark.parametrize("search", [Evolutionary(), Optuna(), Optuna(sampler="nsga2")], ids=str)
def test_told_the_same_rounds_they_go_on_in_the_same_way(search):
    first = search.start(CUBE, 5)
    rounds = []
    for size in (10, 10, 10, 10, 10, 7, 10):
        points = first.ask(size)
        scores = between(points)
        scores[0] = np.nan
        first.tell(points, scores)
        rounds.append((points, scores))
    again = search.start(CUBE, 5)
    for points, scores in rounds:
        again.tell(points, scores)
    np.testing.assert_array_equal(again.ask(10), first.ask(10))


def test_evolution_finds_the_front_of_two_scores():
    def near_the_front(points):
        along = np.clip((points - 0.3).mean(axis=1), 0.0, 0.4)[:, None]
        return np.linalg.norm(points - 0.3 - along, axis=1) < 0.1

    evolved = explored(Evolutionary(population=20).start(CUBE, 0), 300, function=between)
    spread = explored(OPTIMIZERS.create("sobol").start(CUBE, 0), 300)
    assert near_the_front(evolved).sum() > 3 * near_the_front(spread).sum()
    front = evolved[is_on_pareto_front(between(evolved))]
    assert np.ptp(front.mean(axis=1)) > 0.3


@pytest.mark.parametrize("search", [Evolutionary(), Optuna()], ids=str)
def test_a_small_space_is_run_whole(search):
    space = ParameterSpace.from_ranges(["a=0:5:1", "b=0:9:1"]).with_constraints(
        [
            ParameterDeclaration("a", "double", "0", ((Constraint("lessThan", "5"),),)),
            ParameterDeclaration("b", "double", "0"),
        ]
    )
    optimizer = search.start(space, 0)
    points = explored(optimizer, 50, function=lambda p: p[:, 0] + p[:, 1])
    assert len(np.unique(points, axis=0)) == 50
    assert len(optimizer.ask(5)) == 0


def test_options_of_a_search_stand_behind_a_colon():
    optimizer = OPTIMIZERS.create("evolutionary:population=12").start(CUBE, 0)
    assert optimizer.name == "evolutionary:population=12"
    for name, words in (
        ("evolutionary:population=1", "2 or more"),
        ("bayes:fill=0", "has no option 'fill'; did you mean 'filling'?"),
        ("optuna:sampler=tpa", "no sampler 'tpa'"),
        ("bayes:filling", "give options as in"),
        ("bayes:", "ends in a colon"),
        ("bayes:filling=0,filling=1", "the option 'filling' twice"),
    ):
        with pytest.raises(InputError, match=words):
            OPTIMIZERS.create(name).start(CUBE, 0)


def test_an_explorer_stops_when_enough_is_known(tmp_path):
    limit = {"critical": 1.0}
    with opened(tmp_path / "s.db") as study:
        result = explorer(study, optimizer="sobol", budget=400, stop_when=("missed<0.3",), **limit).run()
    assert 20 <= result.n_finished < 400
    assert "of the critical set is missed" in result.reason
    with opened(tmp_path / "t.db") as study:
        never = ("missed<0.3", "unvisited(0.0001)<0.001")
        assert explorer(study, optimizer="sobol", budget=60, stop_when=never, **limit).run().n_finished == 60
    with opened(tmp_path / "u.db") as study, pytest.raises(InputError, match="has no default threshold"):
        explorer(study, stop_when=never)


def test_the_command_line_searches_sums_and_fronts_and_says_what_matters(tmp_path):
    common = ["explore", X, "--space", SPACE, "--ego", "Ego", "--other", "Pedestrian"]
    common += ["--metric", "wttc", "--metric", "pet:signed=true", "--budget", "60"]
    front = cornercase(*common, "--pareto", "--optimizer", "evolutionary:population=20", "-o", tmp_path / "p.db")
    assert front.returncode == 0, front.stderr
    shown = json.loads(cornercase("show", tmp_path / "p.db", "--json").stdout)
    assert shown["searched"] == "Pareto front of wttc, pet:signed=true"
    with StudyFile.open(tmp_path / "p.db", readonly=True) as study:
        scores = np.stack([study.scores(name) for name in study.meta.metrics], axis=1)
    assert len(shown["front"]) == is_on_pareto_front(scores).sum()
    refused = cornercase(*common, "--pareto", "--optimizer", "bayes", "-o", tmp_path / "b.db")
    assert refused.returncode == 2
    assert "searches one score" in refused.stderr
    assert not (tmp_path / "b.db").exists()

    weighted = [*common, "--weight", "wttc=1", "--weight", "pet:signed=true=0.2", "--optimizer", "level-set"]
    done = cornercase(*weighted, "--critical", "0.5", "--stop-when", "missed<0.9", "-o", tmp_path / "w.db")
    assert done.returncode == 0, done.stderr
    assert "of the critical set is missed" in done.stdout
    shown = json.loads(cornercase("show", tmp_path / "w.db", "--json").stdout)
    assert shown["critical"]["is"] == "1 wttc + 0.2 pet:signed=true <= 0.5"
    assert 0 < shown["critical"]["share"]["low"] < shown["critical"]["share"]["high"] < 1
    assert set(shown["sensitivity"]["parameters"]) == set(shown["parameters"])
    assert "p1_speed" in shown["sensitivity"]["of_little_influence"]
    # Other weights define another search.
    other = cornercase(*common, "--critical", "0.5", "--optimizer", "level-set", "-o", tmp_path / "w.db")
    assert other.returncode == 2
    assert "other weights" in other.stderr
    for words, option in (("write it as", ["--stop-when", "lost<1"]), ("METRIC=NUMBER", ["--weight", "wttc"])):
        wrong = cornercase(*common, *option, "-o", tmp_path / "x.db")
        assert wrong.returncode == 2
        assert words in wrong.stderr
