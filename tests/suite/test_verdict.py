"""How several verdicts of one scenario count together."""

from __future__ import annotations

import pytest

from cornercase.suite import Verdict
from cornercase.suite._verdict import worst_state


@pytest.mark.parametrize(
    ("states", "worst"),
    [
        ([], "inconclusive"),
        (["passed", "passed"], "passed"),
        (["passed", "inconclusive"], "inconclusive"),
        (["failed", "inconclusive", "passed"], "failed"),
    ],
)
def test_the_worst_verdict_is_that_of_the_scenario(states, worst):
    assert worst_state(Verdict(state, "no collision", "") for state in states) == worst
