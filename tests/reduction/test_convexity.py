"""Archetypes of clusters that are not convex."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from conftest import at_night
from cornercase._common.errors import InputError
from cornercase.clustering import cluster
from cornercase.dtw import distance_matrix
from cornercase.reduction._archetypal_analysis import find_archetypes, find_kernel_archetypes
from cornercase.reduction._cluster_shapes import classify_cluster_shapes
from cornercase.reduction._convexity import MIN_CONVEXITY, measure_convexity, split_into_convex_parts
from cornercase.reduction._hulls import find_hull_archetypes
from cornercase.reduction.selection._per_cluster import select_per_cluster


def horseshoe(count, seed, legs=2.0):
    """Points of a horseshoe 0.25 wide: half a ring with two straight legs."""
    rng = np.random.default_rng(seed)
    found: list[tuple[float, float]] = []
    while len(found) < count:
        x, y = rng.uniform(-1, 1), rng.uniform(-1, legs)
        if 0.75 <= (np.hypot(x, y) if y <= 0 else abs(x)) <= 1.0:
            found.append((x, y))
    return np.array(found)


def standing(places):
    """Trajectories of unequal length of an entity that stands for 20 instants."""
    return [np.repeat(place[None], 20, axis=0) for place in places]


def everyone(points):
    return np.ones(len(points), dtype=bool)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("count", "dimensions"), [(30, 3), (100, 2), (300, 3)])
def test_cubes_and_balls_are_convex(count, dimensions, seed):
    rng = np.random.default_rng(seed)
    for points in (rng.random((count, dimensions)), rng.normal(size=(count, dimensions))):
        assert measure_convexity(points, everyone(points)) > 0.95
        assert len(split_into_convex_parts(points, everyone(points))) == 1
    halves = rng.random((count, dimensions))
    assert measure_convexity(halves, halves[:, 0] < halves[:, 1]) > 0.9


@pytest.mark.parametrize("seed", range(3))
def test_a_horseshoe_is_not_and_falls_into_parts_that_are(seed):
    points = horseshoe(200, seed)
    assert measure_convexity(points, everyone(points)) < 0.7
    parts = split_into_convex_parts(points, everyone(points))
    assert 2 <= len(parts) <= 4
    assert sorted(np.concatenate(parts).tolist()) == list(range(200))
    for part in parts:
        assert measure_convexity(points[part], everyone(part)) >= MIN_CONVEXITY


def test_what_lies_around_others_is_not_convex():
    points = np.random.default_rng(0).random((400, 2))
    inner = np.linalg.norm(points - 0.5, axis=1) < 0.3
    assert measure_convexity(points, ~inner) < 0.7
    assert measure_convexity(points, inner) > 0.9


def test_too_few_to_know_count_as_convex():
    assert measure_convexity(np.random.default_rng(0).random((9, 3)), np.arange(9) < 4) == 1.0
    assert measure_convexity(np.zeros((20, 2)), everyone(np.zeros((20, 2)))) == 1.0


@pytest.mark.parametrize("seed", at_night(range(3), {1, 2}))
@pytest.mark.parametrize("corners", [3, 4, 5])
def test_archetypes_are_the_known_corners(corners, seed):
    rng = np.random.default_rng(seed)
    places = np.concatenate([np.zeros((1, 4)), np.eye(4)])[:corners]
    points = np.concatenate([places, rng.dirichlet(np.full(corners, 0.8), 200) @ places])
    found = find_archetypes(points)
    assert len(found.indices) == corners == len(found.explained_variance)
    assert found.explained_variance[-1] > 0.98
    away = cdist(places, points[found.indices])
    assert away.min(axis=1).max() < 0.15
    assert find_archetypes(points).indices.tolist() == found.indices.tolist()


def test_the_number_of_archetypes_can_be_given_and_none_is_there_twice():
    points = np.random.default_rng(1).random((50, 3))
    for k in (1, 2, 7, 15, 50, 60):
        indices = find_archetypes(points, k).indices
        assert len(set(indices.tolist())) == min(k, 50)
    assert len(find_archetypes(np.zeros((5, 2)), 3).indices) == 1
    assert find_archetypes(np.array([[1.0, 2.0]])).indices.tolist() == [0]
    assert len(find_kernel_archetypes(np.zeros((5, 5)), 2).indices) == 1


@pytest.mark.parametrize("seed", range(5))
def test_kernel_archetypes_cover_a_horseshoe_of_trajectories(seed):
    points = horseshoe(200, seed, legs=3.0)
    distances = distance_matrix(standing(points))
    around = find_hull_archetypes(points, 16)
    along = find_kernel_archetypes(distances, len(around)).indices
    left = [float(distances[:, kept].min(axis=1).max()) for kept in (around, along)]
    assert left[1] < 0.5 * left[0]


@pytest.mark.parametrize("seed", range(3))
def test_the_shape_decides(seed):
    rng = np.random.default_rng(seed)
    bent, round_ = horseshoe(200, seed), rng.normal(size=(100, 2)) * 0.2 + [6, 0]
    points = np.concatenate([bent, round_])
    labels = np.repeat([0, 1], [200, 100])
    found = classify_cluster_shapes(points, labels)
    assert [one.shape.method for one in found] == ["parts", "hull"]
    assert len(found[0].parts) > 1
    assert found[0].shape.convexity < MIN_CONVEXITY <= found[1].shape.convexity
    # The same region, but bent in kernel space, since the distances are those of the horseshoe.
    clustered = cluster(distance_matrix(standing(points)))
    flat = np.concatenate([rng.random((200, 2)), 2.0 + rng.random((100, 2))])
    assert classify_cluster_shapes(flat, labels, clustered.embedding)[0].shape.method == "kernel"
    assert [one.shape.method for one in classify_cluster_shapes(points, labels, method="pcha")] == ["pcha", "pcha"]
    assert classify_cluster_shapes(rng.random((100, 8)), np.zeros(100, dtype=np.int64))[0].shape.method == "pcha"


def test_all_ways_keep_scenarios_of_the_cluster_and_as_many_as_wanted():
    points = horseshoe(120, 0)
    distances, labels = cdist(points, points), np.repeat([0, -1], [100, 20])
    for method in ("auto", "hull", "pcha", "parts", "kernel"):
        shaped = classify_cluster_shapes(points, labels, method=method)
        kept = select_per_cluster(points, distances, labels, archetypes=8, shaped_clusters=shaped)
        assert len({one.index for one in kept}) == len(kept) <= 9
        assert all(one.cluster == 0 and one.index < 100 for one in kept)
        assert kept == select_per_cluster(points, distances, labels, archetypes=8, shaped_clusters=shaped)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: find_archetypes(np.empty((0, 2))), "have no archetypes"),
        (lambda: find_archetypes(np.array([[1.0], [2.0]]), 0), "`k` 0"),
        (lambda: find_archetypes(np.array([[1.0], [2.0]]), max_k=0), "`max_k` 0"),
        (
            lambda: classify_cluster_shapes(np.zeros((3, 1)), np.zeros(3, dtype=np.int64), method="hul"),  # type: ignore[arg-type]
            "did you mean 'hull'",
        ),
    ],
)
def test_refuses_in_one_sentence(call, words):
    with pytest.raises(InputError, match=words):
        call()
