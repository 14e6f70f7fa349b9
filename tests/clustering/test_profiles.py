"""Profiles of clusters: names, rules, and agreement of clusterings."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from sklearn.metrics import adjusted_rand_score

from conftest import at_night
from cornercase.clustering._agreement import compare_labels
from cornercase.clustering.naming._rules import find_rules
from cornercase.exploration._explore import explore_config
from cornercase.exploration._paper_examples import paper_experiment_config
from cornercase.metrics.ending._find_outcome import describe_outcome
from cornercase.recordings import Collision
from cornercase.scenario import Parameter, ParameterSpace
from helpers.command_line import cornercase
from helpers.oracle import actor, recorded

SPACE = ParameterSpace(
    [
        Parameter("start", 0.0, 10.0, unit="m"),
        Parameter("kind", 0, 2, choices=("car", "truck", "bicycle")),
        Parameter("wait", 0.0, 4.0, unit="s"),
        Parameter("fixed", 0, 0, choices=("x",)),
    ]
)


def rows(count=300, seed=0):
    points = SPACE.snap(np.random.default_rng(seed).random((count, 4)))
    return SPACE.values(points)


def column(found, name):
    return np.array([values[name] for values in found])


def test_a_box_in_the_parameter_space_is_told_by_its_bounds():
    ran = rows()
    members = (column(ran, "start") > 3.0) & (column(ran, "start") <= 7.0) & (column(ran, "wait") <= 2.0)
    (rule,) = find_rules(SPACE, ran, members)
    low, _, rest = rule.text.partition(" < start <= ")
    high, _, wait = rest.partition(" m and wait <= ")
    assert float(low) == pytest.approx(3.0, abs=0.1)
    assert float(high) == pytest.approx(7.0, abs=0.1)
    assert float(wait.removesuffix(" s")) == pytest.approx(2.0, abs=0.05)
    # Bounds found from nine tenths miss one or two of the others.
    assert rule.covers == pytest.approx(0.98, abs=0.02)
    assert rule.purity == pytest.approx(0.98, abs=0.02)


def test_names_stand_in_a_rule_and_what_touches_is_one_part():
    ran = rows()
    (rule,) = find_rules(SPACE, ran, column(ran, "kind") == "truck")
    assert rule.text == "kind is truck"
    others = find_rules(SPACE, ran, column(ran, "kind") != "truck")
    assert [one.text for one in others] == ["kind is not truck"]


def test_two_parts_are_two_rules_the_larger_first():
    ran = rows(600)
    start = column(ran, "start")
    found = find_rules(SPACE, ran, (start < 1.0) | (start > 7.0))
    assert [rule.text.split()[1] for rule in found] == [">", "<="]
    assert sum(rule.covers for rule in found) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("members", [np.ones(300, dtype=bool), np.random.default_rng(5).random(300) < 0.001])
def test_what_nothing_sets_apart_is_everywhere_or_nowhere_pure(members):
    members[0] = True
    for rule in find_rules(SPACE, rows(), members):
        assert 0.0 < rule.covers <= 1.0
        assert 0.0 < rule.purity <= 1.0


@pytest.mark.parametrize("count", at_night([20, 60, 300], {20, 300}))
def test_labels_that_are_noise_get_no_rule(count):
    told = 0
    for seed in range(40):
        ran = rows(count, seed=seed + 500)
        members = np.random.default_rng(seed + 900).random(count) < (0.5, 0.1, 0.3)[seed % 3]
        members[0] = True
        (first, *_) = find_rules(SPACE, ran, members)
        told += first.text != "everywhere"
        if first.text == "everywhere":
            assert (first.covers, first.purity) == (1.0, members.mean())
    assert told <= 2


@pytest.mark.parametrize("mixed", at_night([0.0, 0.1, 0.2], {0.0, 0.2}))
def test_a_rule_holds_as_often_as_it_says_for_scenarios_that_did_not_find_it(mixed):
    told, held = [], []
    for seed in range(20):
        ran = rows(3200, seed=seed)
        inside = (column(ran, "start") > 5.0) & (column(ran, "wait") > 2.0)
        members = inside ^ (np.random.default_rng(seed).random(3200) < mixed)
        for rule in find_rules(SPACE, ran[:200], members[:200]):
            there = np.array([follows(rule.text, values) for values in ran[200:]])
            told.append((rule.covers, rule.purity))
            held.append((members[200:][there].sum() / members[200:].sum(), members[200:][there].mean()))
    assert len(told) >= 15
    # Their mean: the figures of a single rule are off by chance, but unbiased.
    assert np.mean(told, axis=0) == pytest.approx(np.mean(held, axis=0), abs=0.04)


def follows(text, values):
    """Whether a scenario satisfies a rule, parsed from its text."""
    for part in text.split(" and "):
        words = [word for word in part.split() if word not in ("m", "s")]
        if "is" in words:
            yes = values[words[0]] == words[-1]
            if yes == ("not" in words):
                return False
        elif len(words) == 5:
            if not float(words[0]) < values[words[2]] <= float(words[4]):
                return False
        elif (values[words[0]] <= float(words[2])) != (words[1] == "<="):
            return False
    return True


def test_agreement_does_not_look_at_the_names_of_clusters():
    ids, one = np.arange(10, 22), np.repeat([0, 1, -1], 4)
    same = compare_labels(ids, one, np.repeat([2, 0, 1], 4))
    assert (same.adjusted_rand, same.differing) == (1.0, ())
    assert same.mutual_information == pytest.approx(1.0)
    other = np.repeat([2, 0, 1], 4)
    other[3] = 1
    found = compare_labels(ids, one, other)
    assert found.differing == (13,)
    assert found.adjusted_rand == pytest.approx(adjusted_rand_score(one, other))
    # Three clusters against one: the largest is matched.
    assert len(compare_labels(ids, one, np.zeros(12, dtype=int)).differing) == 8


def test_outcomes_say_who_was_first_and_who_collides():
    time = np.arange(0.0, 10.0, 0.1)
    early, late = actor(x=-30, v=10), actor(y=-60, yaw=math.pi / 2, v=10)
    recording = recorded([early, late], time)
    assert describe_outcome(recording, "0", "1") == describe_outcome(recording, "1", "0") == "0 first"
    assert describe_outcome(recorded([late, early], time), "0", "1") == "1 first"
    assert describe_outcome(recorded([early, actor(y=200)], time), "0", "1") == "ways do not cross"
    hit = replace(recording, collisions=(Collision(3.0, ("1", "0")),))
    assert describe_outcome(hit, "0", "1") == "0 and 1 collide"


@pytest.mark.slow
def test_show_and_report_tell_what_the_clusters_are(tmp_path):
    study = tmp_path / "study.db"
    explore_config(paper_experiment_config("t-intersection", budget=60, seed=1), study)
    for command in (("analyze", study), ("report", study, "-o", tmp_path / "report.html")):
        done = cornercase(*command)
        assert done.returncode == 0, done.stderr
    shown = json.loads(cornercase("show", study, "--json").stdout)
    clusters = [one for key, one in shown["clusters"]["ego-trajectory"].items() if key.startswith("cluster_")]
    assert sum(one["scenarios"] for one in clusters) + shown["clusters"]["ego-trajectory"]["noise"] == 60
    assert any("C first" in one["outcomes"] for one in clusters)
    assert all(one["where"] for one in clusters)
    assert "ego-trajectory and ttc" in shown["agreement"]
    page = (tmp_path / "report.html").read_text()
    assert "how it ends" in page
    assert "adjusted Rand" in page
