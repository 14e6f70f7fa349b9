"""Rules that end a search: their text, and what is no rule."""

from __future__ import annotations

import pytest

import cornercase as cc
from cornercase._common.errors import InputError
from cornercase.stop import *  # noqa: F403 - for `eval`
from cornercase.stop._stop_rules import StopCriterion


@pytest.mark.parametrize(
    ("rule", "text"),
    [
        (cc.stop.missed(0.05), "missed<0.05"),
        (cc.stop.interval(0.05), "interval<0.05"),
        (cc.stop.overlooked(0.05, size=0.02), "overlooked(0.02)<0.05"),
        (cc.stop.unvisited(0.05), "unvisited(0.01)<0.05"),
        (cc.stop.audited_missed(0.1), "audited-missed<0.1"),
        (cc.stop.seconds(3600), "max_seconds=3600"),
        (cc.stop.no_improvement(rounds=20), "patience=20"),
    ],
)
def test_stop_rules_are_compared_by_value(rule, text):
    assert eval(repr(rule)) == rule
    assert str(rule) == text
    if isinstance(rule, StopCriterion):
        assert StopCriterion.parse(text) == rule


def test_a_stop_rule_that_cannot_hold_is_refused():
    for make in (lambda: cc.stop.missed(0.0), lambda: cc.stop.overlooked(0.1, size=2), lambda: cc.stop.seconds(-1)):
        with pytest.raises(InputError):
            make()
