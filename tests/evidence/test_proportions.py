"""Bounds of proportions, compared with how often they hold."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom

from cornercase.evidence._proportions import anytime_upper_bound, proportion_interval


@pytest.mark.parametrize("share", [0.01, 0.1, 0.5])
@pytest.mark.parametrize("drawn", [20, 100])
def test_bounds_hold_in_at_least_nine_of_ten_draws(share, drawn):
    bounds = [proportion_interval(hits, drawn) for hits in range(drawn + 1)]
    held = [one.low <= share <= one.high for one in bounds]
    assert binom.pmf(np.arange(drawn + 1), drawn, share) @ held >= 0.9


def test_without_a_hit_it_is_the_rule_of_three():
    bounds = proportion_interval(0, 300)
    assert bounds.low == 0.0
    assert bounds.high == pytest.approx(3 / 300, rel=0.01)
    assert (proportion_interval(0, 0).low, proportion_interval(0, 0).high) == (0.0, 1.0)
    assert proportion_interval(7, 7).high == 1.0


def test_the_highest_share_holds_also_if_one_looks_after_each_draw():
    rng = np.random.default_rng(0)
    for share in (0.05, 0.3):
        wrong = 0
        for _ in range(60):
            hits = np.cumsum(rng.random(120) < share)
            wrong += any(anytime_upper_bound(int(hits[k]), k + 1) < share for k in range(0, 120, 4))
        # Of 60 with a probability of at most 0.05 each: 7 or more in one of a hundred cases.
        assert wrong < 7
    assert anytime_upper_bound(0, 0) == anytime_upper_bound(3, 3) == 1.0
    assert proportion_interval(2, 50).high < anytime_upper_bound(2, 50) < 1.0
