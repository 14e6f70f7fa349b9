"""What is searched, and how scenarios are run: objects that check what they are given."""

from __future__ import annotations

import pytest

import cornercase as cc
from helpers.command_line import SPACE, X


@pytest.fixture(scope="module")
def scenario() -> cc.LogicalScenario:
    return cc.LogicalScenario.read(X, SPACE)


@pytest.mark.parametrize(
    ("arguments", "criterion"),
    [
        ({"metrics": ["wttc"]}, "critical if wttc <= 1 s"),
        ({"metrics": "wttc", "threshold": 0.2}, "critical if wttc <= 0.2 s"),
        ({"metrics": cc.metrics.Ttc(accelerating=True)}, "critical if ttc:accelerating=true <= 1.5 s"),
        ({"metrics": ["wttc"], "condition": "collision"}, "critical if collision"),
        (
            {"metrics": ["wttc"], "condition": cc.metrics.Expression.parse("ttc<1 s", "condition")},
            "critical if ttc < 1 s",
        ),
        ({"metrics": ["wttc", "distance"], "pareto": True}, "searched by Pareto front of wttc, distance"),
        (
            {"metrics": ["wttc", "distance"], "weights": {"wttc": 1, "distance": 2}, "threshold": 3},
            "critical if 1 wttc + 2 distance <= 3",
        ),
    ],
)
def test_it_says_what_is_critical(scenario, arguments, criterion):
    problem = cc.Problem(scenario, ego="Ego", other="Pedestrian", **arguments)
    assert repr(problem) == f"<Problem 'x_intersection': Ego and Pedestrian, {criterion}>"
    assert problem._repr_html_().count("<tr>") == 1 + len(scenario.space.parameters)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"ego": "Egon"}, "did you mean 'Ego'"),
        ({"other": "Pedestrain"}, "did you mean 'Pedestrian'"),
        ({"metrics": ["wtc"]}, "did you mean 'wttc'"),
        ({"metrics": []}, "metric"),
        ({"threshold": "low"}, "`threshold` 'low'"),
        (
            {"threshold": "200 ms"},
            "^`threshold` '200 ms': give only a number, in s like wttc; units are allowed only in a condition, as in "
            r'`condition` "wttc < 200 ms"\.$',
        ),
        ({"condition": "collision", "threshold": 1.0}, "`condition` defines .* leave `threshold` out"),
        ({"metrics": ["wttc", "distance"], "pareto": True, "threshold": 1.0}, "a Pareto front has no threshold"),
        (
            {"weights": {"distance": 1.0}},
            r"^`weights` distance: is not one of the `metrics` \(wttc\); add distance to `metrics`",
        ),
        ({"weights": {"wtc": 1.0}}, "^`weights` wtc: is not one of the metrics; did you mean 'wttc'"),
        ({"condition": cc.metrics.Expression.parse("ttc<1")}, 'was parsed as a formula, .* the language "condition"'),
        ({"condition": "collision with Ego"}, "^`condition` collision with Ego: names the ego itself"),
        (
            {"condition": "no collision with Pedestrain"},
            "no entity 'Pedestrain' to be the one that collides in `condition`; did you mean 'Pedestrian'",
        ),
        (
            {"metrics": ["wttc", "stl:always(no collision with Pedestrain)"]},
            "no entity 'Pedestrain' to be the one that collides in the metric stl:always.*; did you mean 'Pedestrian'",
        ),
        ({"condition": "gap < 1"}, "add a metric of your own with METRICS.register first; known are: "),
        ({"scenario": "x.xosc"}, "give a scenario that `LogicalScenario.read` has read"),
        ({"metrics": cc.metrics.Ttc}, "`metrics`: Ttc is a class; give an object of it, as in Ttc"),
        (
            {"metrics": 3},
            "`metrics` 3: derive a class from `cornercase.Metric` and give an object of it, or give the name",
        ),
    ],
)
def test_it_refuses_what_cannot_be_searched(scenario, arguments, message):
    given = {"scenario": scenario, "ego": "Ego", "other": "Pedestrian", "metrics": ["wttc"]} | arguments
    with pytest.raises(cc.InputError, match=message):
        cc.Problem(**given)


@pytest.mark.parametrize(
    ("metric", "threshold", "words"),
    [
        ("wttc", 200.0, "wttc are from 0 to 10 s, so each scenario is critical"),
        ("wttc", -0.2, "wttc are from 0 to 10 s, so no scenario is critical"),
        ("drac", 25.0, "drac are from 0 to 20 m/s², so no scenario is critical"),
        ("drac", -1.0, "drac are from 0 to 20 m/s², so each scenario is critical"),
        ("thw", 10.0, "thw are at most 10 s, so each scenario is critical"),
    ],
)
def test_a_threshold_that_no_score_or_each_one_passes_is_noticed(scenario, metric, threshold, words):
    with pytest.warns(cc.NoticeWarning, match=f"^`threshold` {threshold:g}: scores by {words}$"):
        cc.Problem(scenario, "Ego", "Pedestrian", [metric], threshold=threshold)


def test_a_threshold_that_some_scores_pass_needs_no_notice(scenario):
    for metric, threshold in (("wttc", 0.0), ("pet:signed=true", -0.2), ("wttc:severity=true", -0.2), ("drac", 20.0)):
        cc.Problem(scenario, "Ego", "Pedestrian", [metric], threshold=threshold)


def test_all_others_get_their_names(scenario):
    assert cc.Problem(scenario, "Ego", "*", ["wttc"]).other == ("Truck", "C", "Pedestrian")


@pytest.mark.parametrize(
    "runs", [cc.Runs(), cc.Runs(workers=4, timeout=1.5), cc.Runs(repeats=3, max_repeats=9, cluster="local")]
)
def test_runs_say_what_differs_from_the_default(runs):
    assert eval(repr(runs), {"Runs": cc.Runs}) == runs


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"workers": 0}, "`workers` 0"),
        ({"workers": 2.5}, "`workers` 2.5"),
        ({"timeout": 0.0}, "`timeout` 0"),
        ({"retries": -1}, "`retries` -1"),
        ({"cluster": 7}, "`cluster` 7"),
        ({"repeats": 0}, "`repeats` 0"),
    ],
)
def test_runs_are_checked_at_once(arguments, message):
    with pytest.raises(cc.InputError, match=message):
        cc.Runs(**arguments)
