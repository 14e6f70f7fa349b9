"""Rules that end a search: their text, and what is no rule."""

from __future__ import annotations

import pytest

import cornercase as cc
from cornercase._common.errors import InputError
from cornercase.stop import *  # noqa: F403 - for `eval`
from cornercase.stop._stop_rules import resolve_stop_rules


@pytest.mark.parametrize(
    ("rule", "text"),
    [
        (cc.stop.missed(0.05), "missed<0.05"),
        (cc.stop.missed(0.05, confidence=0.7), "missed(0.7)<0.05"),
        (cc.stop.interval(0.05), "interval<0.05"),
        (cc.stop.overlooked(0.05, size=0.02), "overlooked(0.02)<0.05"),
        (cc.stop.unvisited(0.05), "unvisited(0.01)<0.05"),
        (cc.stop.audited_missed(0.1), "audited-missed<0.1"),
        (cc.stop.seconds(3600), "max_seconds=3600"),
        (cc.stop.seconds(1234567.5), "max_seconds=1234567.5"),
        (cc.stop.no_improvement(rounds=20), "patience=20"),
    ],
)
def test_stop_rules_are_compared_by_value(rule, text):
    assert eval(repr(rule)) == rule
    assert str(rule) == text
    assert resolve_stop_rules(text) == resolve_stop_rules(rule)


def test_a_stop_rule_that_cannot_hold_is_refused():
    for make in (lambda: cc.stop.missed(0.0), lambda: cc.stop.overlooked(0.1, size=2), lambda: cc.stop.seconds(-1)):
        with pytest.raises(InputError):
            make()


class OwnRule(cc.stop.StopRule):
    """A rule of the user's own."""


@pytest.mark.parametrize("rule", [OwnRule(), cc.stop.StopRule(), lambda study: True, [cc.stop.missed(0.1), OwnRule()]])
def test_own_rules_are_refused_with_what_to_do(rule):
    with pytest.raises(
        InputError, match=r"rules of your own are not possible, so call `explore` in a loop with a grow"
    ):
        resolve_stop_rules(rule)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("missd<0.1", r"missed<0.01, .* audited-missed<0.1, max_seconds=60 or patience=5, in quotes\.$"),
        ("max_seconds=x", "'x' has to be a number"),
        ("max_seconds=-1", "`max_seconds` -1"),
        ("patience=0", "`patience` 0"),
        ("patience=2.5", "`patience` 2.5"),
        ("patience=inf", "`patience` inf"),
    ],
)
def test_the_text_of_no_rule_is_refused(text, says):
    with pytest.raises(InputError, match=says):
        resolve_stop_rules(text)
