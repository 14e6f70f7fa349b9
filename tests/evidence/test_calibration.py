"""Calibration of a surrogate by the record of its predictions."""

from __future__ import annotations

import numpy as np
import pytest

from cornercase.evidence._probit_calibration import CalibrationPrior, ProbitCalibration


def record(count, seed=0):
    rng = np.random.default_rng(seed)
    t = rng.normal(0.0, 2.0, count)
    return t, rng.normal(size=count) > 0.4 + 0.7 * t


def test_it_finds_how_far_to_trust_what_is_said():
    a, b, rate = ProbitCalibration(*record(4000)).draw_parameters(400, np.random.default_rng(1))
    assert a.mean() == pytest.approx(0.4, abs=0.1)
    assert b.mean() == pytest.approx(0.7, abs=0.1)
    assert rate.mean() < 0.005


def test_ten_times_as_many_predictions_are_not_ten_times_as_sure():
    t, critical = record(160)
    few = np.std(ProbitCalibration(t, critical).draw_parameters(400, np.random.default_rng(1))[0])
    many = np.std(
        ProbitCalibration(np.tile(t, 10), np.tile(critical, 10)).draw_parameters(400, np.random.default_rng(1))[0]
    )
    # Ten correlated ones are not ten independent ones: those would narrow it with the root.
    assert few / many == pytest.approx(10.0**0.25, rel=0.15)


def test_surprises_where_nothing_pointed_to_them_are_a_rate_of_their_own():
    t, critical = record(400)
    far = np.full(400, 6.0)
    surprises = np.arange(400) % 20 == 0
    calibration = ProbitCalibration(np.append(t, far), np.append(critical, surprises))
    _, b, rate = calibration.draw_parameters(400, np.random.default_rng(1))
    # One in twenty of what lies far away, and the rest is trusted as before.
    assert rate.mean() == pytest.approx(0.05, rel=0.4)
    assert b.mean() == pytest.approx(0.7, abs=0.2)
    assert calibration.probability_of_critical(np.array([9.0]))[0] == pytest.approx(rate.mean(), rel=0.1)
    clean = ProbitCalibration(np.append(t, far), np.append(critical, np.zeros(400, dtype=bool)))
    assert clean.probability_of_critical(np.array([9.0]))[0] < 0.005


def test_scenarios_that_a_search_chose_tell_how_far_to_trust_but_not_how_rare_surprises_are():
    t, critical = record(60)
    alone = ProbitCalibration(t, critical).draw_parameters(400, np.random.default_rng(1))
    chosen = ProbitCalibration(t, critical, chosen=record(1000, seed=1)).draw_parameters(400, np.random.default_rng(1))
    for one, other, truth in zip(alone[:2], chosen[:2], (0.4, 0.7), strict=True):
        assert other.std() < 0.9 * one.std()
        assert other.mean() == pytest.approx(truth, abs=2.5 * other.std())
    # Far from anything critical a search chose nothing: a thousand more there that are not critical change no rate.
    far = np.full(1000, 9.0), np.zeros(1000, dtype=bool)
    same = ProbitCalibration(t, critical, chosen=far).draw_parameters(400, np.random.default_rng(1))
    assert same[2].mean() == pytest.approx(alone[2].mean(), rel=0.1)
    # Critical ones there are surprises of the search: they must not make a scenario far away look safer.
    told, outcomes = record(1000, seed=1)
    surprised = ProbitCalibration(
        t, critical, chosen=(np.append(told, np.full(10, 6.0)), np.append(outcomes, np.ones(10, dtype=bool)))
    )
    without = ProbitCalibration(t, critical, chosen=(told, outcomes))
    away = np.array([6.0])
    assert surprised.probability_of_critical(away)[0] > 0.9 * without.probability_of_critical(away)[0]
    random = ProbitCalibration(np.append(t, far[0]), np.append(critical, far[1]))
    assert random.draw_parameters(400, np.random.default_rng(1))[2].mean() < 0.5 * alone[2].mean()


def test_a_prior_narrows_what_few_predictions_say_and_many_outweigh_it():
    wrong = CalibrationPrior(-0.4, 0.3, np.log(1.4), 0.3)
    t, critical = record(30)
    plain, narrow = (
        ProbitCalibration(t, critical, prior=prior).draw_parameters(400, np.random.default_rng(1))
        for prior in (CalibrationPrior(), wrong)
    )
    assert narrow[0].std() < 0.8 * plain[0].std()
    assert narrow[0].mean() < plain[0].mean()
    t, critical = record(20_000)
    a, b, _ = ProbitCalibration(t, critical, prior=wrong).draw_parameters(400, np.random.default_rng(1))
    assert a.mean() == pytest.approx(0.4, abs=0.1)
    assert b.mean() == pytest.approx(0.7, abs=0.1)


def test_chosen_scenarios_may_weigh_less():
    t, critical = record(60)
    whole, quarter = (
        ProbitCalibration(t, critical, 0.5, chosen=record(150, seed=1), chosen_weight=weight).draw_parameters(
            400, np.random.default_rng(1)
        )
        for weight in (0.5, 0.125)
    )
    assert quarter[1].std() > 1.1 * whole[1].std()
