"""Bands of criticality: published thresholds, and natural breaks against all ways to divide the scores."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import examples
from cornercase.evidence._criticality_bands import Bands, find_bands
from cornercase.metrics import METRICS


def divided(metric: str, scores) -> Bands:
    bands = find_bands(METRICS.create(metric), np.asarray(scores, dtype=float))
    assert bands is not None
    return bands


def squared_deviations(groups):
    return sum(float(((group - group.mean()) ** 2).sum()) for group in groups)


@settings(max_examples=examples(60), deadline=None)
@given(st.lists(st.integers(-20, 20), min_size=3, max_size=12).filter(lambda scores: len(set(scores)) >= 3))
def test_natural_breaks_leave_the_least_of_all_divisions(scores):
    scores = np.array(scores, dtype=float)
    bands = divided("wttc", scores)
    values = np.unique(scores)
    least = min(
        squared_deviations(np.split(np.sort(scores), np.searchsorted(np.sort(scores), [values[i], values[j]])))
        for i, j in itertools.combinations(range(1, len(values)), 2)
    )
    found = squared_deviations([scores[bands.labels == k] for k in range(3)])
    assert found == pytest.approx(least, abs=1e-6)
    assert bands.explained == pytest.approx(1.0 - least / squared_deviations([scores]), abs=1e-9)
    # Bands follow each other, the most critical first: a low time to collision.
    assert all(scores[bands.labels == k].max() < scores[bands.labels == k + 1].min() for k in (0, 1))
    assert bands.bounds == tuple(scores[bands.labels == k].max() for k in (0, 1))


def test_the_most_critical_band_of_a_metric_that_is_critical_when_high_has_the_highest_scores():
    scores = np.array([0.0, 0.1, 3.0, 3.1, 9.0, 9.1])
    bands = divided("drac", scores)
    assert bands.labels.tolist() == [2, 2, 1, 1, 0, 0]
    assert bands.bounds == (9.0, 3.0)
    assert [bands.describe_range(k) for k in range(3)] == [
        "9 m/s² and above", "below 9 m/s², to 3 m/s²", "below 3 m/s²"
    ]  # fmt: skip


def test_published_thresholds_come_first_unless_all_scores_are_in_one_of_their_bands():
    bands = divided("ttc", np.array([0.0, 1.5, 1.6, 4.0, 9.0, 10.0]))
    assert (bands.labels.tolist(), bands.bounds) == ([0, 0, 1, 1, 2, 2], (1.5, 4.0))
    assert bands.describe() == (
        "ttc, bands of criticality by published thresholds (1.5 s: Gettman et al. 2008, 4 s: Hirst and Graham 1997),"
        " no clusters: high (1.5 s and below) 2, medium (above 1.5 s, to 4 s) 2, low (above 4 s) 2"
    )
    near = divided("ttc", np.array([0.0, 0.1, 0.6, 0.7, 1.2, 1.3]))
    assert (near.method, near.labels.tolist()) == ("natural breaks", [0, 0, 1, 1, 2, 2])


def test_two_scores_make_two_bands_and_one_makes_none():
    assert find_bands(METRICS.create("wttc"), np.zeros(5)) is None
    bands = divided("wttc", [0.0, 0.0, 2.0])
    assert (bands.names, bands.sizes) == (("high", "low"), (2, 1))


def test_many_scores_are_divided_nearly_as_well():
    scores = np.concatenate([np.random.default_rng(0).normal(center, 0.1, 3000) for center in (0.0, 2.0, 4.0)])
    bands = divided("wttc", scores)
    assert bands.sizes == (3000, 3000, 3000)
    assert bands.explained > 0.99
