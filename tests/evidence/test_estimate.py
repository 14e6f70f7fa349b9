"""Quantities and their intervals."""

from __future__ import annotations

import numpy as np
import pytest

from cornercase.evidence._interval_estimate import Estimate


@pytest.mark.parametrize("rare", [0.9, 0.0])
def test_the_interval_holds_the_mean_of_what_is_nearly_always_the_same(rare):
    draws = np.full(200, rare)
    draws[:3] = 0.45
    one = Estimate.from_draws(draws)
    assert one.low <= one.value <= one.high
    assert one.value == pytest.approx(draws.mean())


def test_nine_of_ten_draws_lie_within():
    one = Estimate.from_draws(np.linspace(0.0, 1.0, 1001))
    assert (one.value, one.low, one.high) == pytest.approx((0.5, 0.05, 0.95))
