"""Coverage of the critical scenarios."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.distance import cdist
from scipy.stats import qmc

from conftest import at_night
from cornercase._common.errors import InputError
from cornercase.evidence._critical_set_estimate import CriticalSet
from cornercase.reduction._coverage import NearestDistances, measure_nearest_distances
from cornercase.reduction._critical_coverage import CriticalCoverage, max_similar_distance, measure_critical_coverage
from cornercase.scenario import ParameterSpace
from cornercase.study._criterion import Criterion

SPACE = ParameterSpace.from_ranges(["a=0:1", "b=0:1"])


def covered(points, scores, threshold, distances, kept, within, seed=0) -> CriticalCoverage:
    """How well the scenarios `kept` represent the critical ones."""
    gaps = measure_nearest_distances(distances, kept, seed=seed)
    return measure_critical_coverage(SPACE, points, scores, Criterion(threshold), gaps, within, seed=seed)


def disc(points):
    """Score that is critical (up to 0.3) within a disc in the middle of the space."""
    return np.linalg.norm(points - 0.5, axis=1)


def explored(count=150, seed=0):
    points = qmc.Sobol(2, seed=np.random.default_rng(seed)).random(count)
    return points, disc(points), cdist(points, points)


def nearest(points, *places):
    return np.array([int(np.linalg.norm(points - place, axis=1).argmin()) for place in places])


@pytest.mark.filterwarnings("ignore:The balance properties")
@pytest.mark.parametrize("seed", at_night(range(3), {1, 2}))
@pytest.mark.parametrize("places", at_night([[(0.5, 0.5)], [(0.35, 0.5), (0.65, 0.5)], [(0.1, 0.1)]], [[(0.5, 0.5)]]))
def test_the_space_is_as_unlike_as_a_dense_sample_says(places, seed):
    points, scores, distances = explored(seed=seed)
    kept = nearest(points, *places)
    found = covered(points, scores, 0.3, distances, kept, 0.2, seed=seed)
    dense = np.random.default_rng(99).random((20_000, 2))
    dense = dense[disc(dense) <= 0.3]
    truth = float((cdist(dense, points[kept]).min(axis=1) > 0.2).mean())
    assert found.unlike is not None
    assert found.unlike.value == pytest.approx(truth, abs=0.06)
    assert found.unlike.low - 0.03 <= truth <= found.unlike.high + 0.03


def test_of_many_scenarios_in_the_order_of_a_grid_those_are_learned_from_that_are_all_over_the_space():
    a, b = np.meshgrid((np.arange(1024) + 0.5) / 1024, [0.25, 0.75], indexing="ij")
    points = np.column_stack([a.ravel(), b.ravel()])
    # 1,024 are critical, of which every second one, with the larger b, is far from what was selected.
    distance = np.where(points[:, 1] > 0.5, 1.0, 0.0)
    gaps = NearestDistances(distance, distance, distance[None])
    found = measure_critical_coverage(SPACE, points, points[:, 0], Criterion(0.5), gaps, 0.5)
    assert found.unlike is not None
    assert found.unlike.value == pytest.approx(0.5, abs=0.05)


@pytest.mark.filterwarnings("ignore:The balance properties")
def test_shares_of_what_was_run():
    points, scores, distances = explored()
    kept = nearest(points, (0.5, 0.5))
    found = covered(points, scores, 0.3, distances, kept, 0.2)
    critical = scores <= 0.3
    gap = distances[:, kept[0]]
    assert found.within == 0.2
    assert found.critical == pytest.approx((gap[critical] <= 0.2).mean())
    # The boundary is the rim of the disc, farther away than similar scenarios.
    assert found.boundary == 0.0
    assert found.largest == pytest.approx(gap[critical].max())
    assert found.mean == pytest.approx(gap[critical].mean())
    everything = covered(points, scores, 0.3, distances, np.flatnonzero(critical), 0.2)
    assert (everything.critical, everything.boundary, everything.largest) == (1.0, 1.0, 0.0)
    half = covered(points, scores, 0.3, distances, np.flatnonzero(critical)[::2], 0.2)
    assert half.unlike is not None
    assert half.unlike.value < 0.02
    assert half.medoids is not None
    assert half.random is not None
    assert half.critical == 1.0 >= half.medoids >= half.random


@pytest.mark.filterwarnings("ignore:The balance properties")
def test_without_critical_scenarios_nothing_is_said():
    points, scores, distances = explored()
    found = covered(points, scores, -1.0, distances, np.array([0]), 0.2)
    assert (found.critical, found.boundary, found.random, found.medoids, found.unlike) == (None,) * 5


@pytest.mark.filterwarnings("ignore:The balance properties")
def test_all_of_a_set_lies_in_itself_and_nothing_in_what_is_apart():
    points, scores, _ = explored()
    one = CriticalSet(SPACE, points, scores, Criterion(0.3))
    whole = CriticalSet(SPACE, points, scores - 1.0, Criterion(0.3))
    assert one.fraction_inside(whole).value > 0.97
    assert one.fraction_inside(CriticalSet(SPACE, points, 1.0 - points[:, 0], Criterion(0.05))).value < 0.05


def test_alike_is_half_of_what_is_usual_within_clusters():
    places = np.array([0.0, 1.0, 2.0, 100.0, 101.0, 102.0, 500.0])
    distances = cdist(places[:, None], places[:, None])
    labels = np.array([0, 0, 0, 1, 1, 1, -1])
    assert max_similar_distance(distances, labels) == 0.5
    assert max_similar_distance(distances, labels, 2.0) == 2.0
    assert max_similar_distance(distances, np.full(7, -1)) == 0.5 * np.median(distances[np.triu_indices(7, 1)])
    for share in (0.0, -1.0, np.inf, np.nan):
        with pytest.raises(InputError, match="give a number above 0"):
            max_similar_distance(distances, labels, share)
