"""Calibration of a surrogate by the record of its predictions."""

from __future__ import annotations

import numpy as np
import pytest

from cornercase.evidence._calibration import ProbitCalibration


def record(count, seed=0):
    rng = np.random.default_rng(seed)
    t = rng.normal(0.0, 2.0, count)
    return t, rng.normal(size=count) > 0.4 + 0.7 * t


def test_it_finds_how_far_to_trust_what_is_said():
    a, b = ProbitCalibration(*record(4000)).draw_parameters(400, np.random.default_rng(1))
    assert a.mean() == pytest.approx(0.4, abs=0.1)
    assert b.mean() == pytest.approx(0.7, abs=0.1)


def test_ten_times_as_many_predictions_are_not_ten_times_as_sure():
    t, critical = record(160)
    few = np.std(ProbitCalibration(t, critical).draw_parameters(400, np.random.default_rng(1))[0])
    many = np.std(
        ProbitCalibration(np.tile(t, 10), np.tile(critical, 10)).draw_parameters(400, np.random.default_rng(1))[0]
    )
    # Ten correlated ones are not ten independent ones: those would narrow it with the root.
    assert few / many == pytest.approx(10.0**0.25, rel=0.15)
