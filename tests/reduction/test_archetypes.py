import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog
from scipy.spatial.distance import pdist, squareform

from conftest import examples
from cornercase._common.errors import InputError
from cornercase.reduction._coverage import measure_coverage
from cornercase.reduction._hulls import find_convex_hull, find_hull_archetypes, find_hull_edges
from cornercase.reduction._medoids import find_prototype
from cornercase.reduction._selection_state import Selected
from cornercase.reduction.selection._per_cluster import select_per_cluster


def is_mixture(point, others):
    """Whether a point is a convex combination of others."""
    equations = np.vstack((others.T, np.ones(len(others))))
    answer = linprog(np.zeros(len(others)), A_eq=equations, b_eq=np.append(point, 1.0), method="highs")
    return answer.status == 0


def test_corners_of_a_cube():
    corners = np.array(list(itertools.product([0.0, 1.0], repeat=3)))
    inside = np.random.default_rng(0).uniform(0.05, 0.95, (40, 3))
    points = np.concatenate((inside, corners))
    hull = find_convex_hull(points)
    assert hull.vertices.tolist() == list(range(40, 48))
    # Twelve triangles, which enclose the volume of the cube.
    assert hull.simplices.shape == (12, 3)
    middle = np.full(3, 0.5)
    volume = sum(abs(np.linalg.det(points[triangle] - middle)) / 6 for triangle in hull.simplices)
    assert volume == pytest.approx(1.0)


@settings(max_examples=examples(30), deadline=None)
@given(n=st.integers(1, 25), d=st.integers(1, 4), flat=st.integers(0, 4), seed=st.integers(0, 10**6))
def test_every_scenario_lies_between_the_archetypes(n, d, flat, seed):
    # Points of any rank: in a subspace of `flat` dimensions through the cube, rotated and shifted.
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1, 1, (n, min(flat, d))) @ rng.uniform(-1, 1, (min(flat, d), d)) + rng.random(d)
    vertices = find_hull_archetypes(points)
    assert len(set(vertices.tolist())) == len(vertices)
    assert (np.diff(vertices) > 0).all()
    centre = points[vertices].mean(axis=0)
    for point in points:
        assert is_mixture(centre + (point - centre) * (1 - 1e-6), points[vertices])
    for vertex in vertices if len(vertices) > 1 else ():
        others = points[vertices[vertices != vertex]]
        assert not is_mixture(points[vertex] + (points[vertex] - centre) * 1e-6, others)


@pytest.mark.parametrize(
    ("points", "vertices", "facets"),
    [
        ([[0.5, 0.5, 0.5]], [0], (0, 0)),
        ([[0.5, 0.5]] * 4, [0], (0, 0)),
        ([[0.0, 0.0], [1.0, 1.0]], [0, 1], (2, 1)),
        ([[0.2, 0.2, 0.2], [0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [0.5, 0.5, 0.5]], [1, 2], (2, 1)),
        ([[0, 0, 0.3], [1, 0, 0.3], [1, 1, 0.3], [0, 1, 0.3], [0.5, 0.4, 0.3]], [0, 1, 2, 3], (4, 2)),
        ([[0, 0, 0.3], [1, 0, 0.3 + 1e-12], [1, 1, 0.3], [0, 1, 0.3 - 1e-12]], [0, 1, 2, 3], (4, 2)),
        ([[0.1], [0.9], [0.4], [0.9]], [0, 1], (2, 1)),
    ],
)
def test_flat_hulls(points, vertices, facets):
    hull = find_convex_hull(points)
    assert hull.vertices.tolist() == vertices
    assert hull.simplices.shape == facets
    assert set(hull.simplices.ravel().tolist()) <= set(vertices)


def test_a_hull_on_a_line_has_an_edge_from_end_to_end():
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    line = np.array([[0.4, 0.4], [0.0, 0.0], [1.0, 1.0]])
    # Two near-convex parts of a cluster on a line, and a part that spans the plane.
    facets = [facet for points in (line, square, line) for facet in find_convex_hull(points).simplices.tolist()]
    assert find_hull_edges(facets) == [(0, 1), (0, 3), (1, 2), (2, 3)]
    assert find_hull_edges(find_convex_hull(line).simplices.tolist()) == [(1, 2)]
    assert find_hull_edges(find_convex_hull(line[:1]).simplices.tolist()) == []


def test_few_archetypes_are_spread_over_the_hull():
    angles = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    four = find_hull_archetypes(circle, 4)
    turns = np.diff(np.append(angles[four], angles[four[0]] + 2 * np.pi))
    np.testing.assert_allclose(turns, np.pi / 2)
    assert set(four) <= set(find_hull_archetypes(circle, 9))
    assert len(find_hull_archetypes(circle)) == 40
    assert len(find_hull_archetypes(circle, 100)) == 40


def test_many_dimensions_end():
    points = np.random.default_rng(0).random((60, 12))
    assert 10 < len(find_hull_archetypes(points)) <= 60


def test_prototype_is_the_medoid():
    points = np.array([[0.0], [9.0], [1.0], [5.0], [2.0]])
    distances = squareform(pdist(points))
    assert find_prototype(distances, [0, 1, 2, 3, 4]) == 4
    assert find_prototype(distances, [1, 3]) == 1
    assert find_prototype(distances, [3, 1]) == 1
    assert find_prototype(distances, [2]) == 2


def test_reduces_400_scenarios_in_2_clusters_to_32():
    rng = np.random.default_rng(0)
    points = rng.random((400, 3))
    labels = (points[:, 0] > points[:, 1]).astype(int)
    distances = squareform(pdist(points))
    kept = select_per_cluster(points, distances, labels)
    assert len(kept) == 32
    assert len({one.index for one in kept}) == 32
    for name in (0, 1):
        roles = [one.role for one in kept if one.cluster == name]
        assert roles == ["prototype"] + ["archetype"] * 15
    assert all(labels[one.index] == one.cluster for one in kept)
    assert kept == select_per_cluster(points, distances, labels)


def test_keeps_about_a_tenth_and_nothing_of_the_noise():
    rng = np.random.default_rng(1)
    points = rng.random((300, 3))
    labels = rng.integers(-1, 3, 300)
    kept = select_per_cluster(points, squareform(pdist(points)), labels)
    assert len(kept) == 30
    assert {one.cluster for one in kept} == {0, 1, 2}
    assert len(select_per_cluster(points, squareform(pdist(points)), labels, archetypes=2)) == 9


def test_nothing_is_kept_twice():
    points = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 0.0], [0.0, 1.0], [0.5, 0.5]])
    distances = squareform(pdist(points))
    kept = select_per_cluster(points, distances, [0, 0, 0, 1, -1])
    assert kept == (Selected(0, 0, "prototype"), Selected(1, 0, "archetype"), Selected(3, 1, "prototype"))
    assert select_per_cluster(points, distances, [-1] * 5) == ()


def test_coverage_of_points_on_a_line():
    distances = squareform(pdist(np.arange(11.0)[:, None]))
    found = measure_coverage(distances, [0, 5, 5])
    assert (found.kept, found.largest, found.worst) == (2, 5.0, 10)
    assert found.mean == pytest.approx((0 + 1 + 2 + 2 + 1 + 0 + 1 + 2 + 3 + 4 + 5) / 11)
    assert found.largest_relative == pytest.approx(0.5)
    assert found.mean_relative == pytest.approx(found.mean / 10)
    assert measure_coverage(distances, range(11)).largest == 0.0
    # All subsets of one: the farthest is 5 to 10 away, by symmetry 8 in the median.
    assert measure_coverage(distances, [5], draws=2000).random_largest == 8.0
    assert measure_coverage(np.zeros((4, 4)), [1]).largest_relative == 0.0


def test_archetypes_cover_the_extremes_better_than_chance():
    points = np.random.default_rng(2).random((300, 3))
    distances = squareform(pdist(points))
    labels = (points[:, 2] > 0.5).astype(int)
    found = measure_coverage(distances, [one.index for one in select_per_cluster(points, distances, labels)])
    assert found.largest < found.random_largest


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: find_convex_hull(np.empty((0, 3))), "have no hull"),
        (lambda: find_convex_hull([1.0, 2.0]), "have no hull"),
        (lambda: find_convex_hull([[1.0], [np.nan]]), "Point 1 is not finite"),
        (lambda: find_hull_archetypes([[1.0]], 0), "`k` 0"),
        (lambda: find_prototype(np.zeros((2, 2)), []), "has no prototype"),
        (lambda: select_per_cluster(np.zeros((3, 1)), np.zeros((2, 2)), [0, 0]), "same scenarios"),
        (lambda: select_per_cluster(np.zeros((1, 1)), [[0.0]], [0], archetypes=0), "`archetypes` 0"),
        (lambda: measure_coverage(np.zeros((2, 2)), []), "No scenario is selected"),
        (lambda: measure_coverage(np.zeros((2, 2)), [2]), "not in the distance matrix"),
        (lambda: measure_coverage(np.zeros((2, 2)), [-1]), "not in the distance matrix"),
        (lambda: measure_coverage(np.zeros((2, 3)), [0]), "is not square"),
        (lambda: measure_coverage(np.zeros((2, 2)), [0], draws=0), "`draws` 0"),
    ],
)
def test_refuses_in_one_sentence(call, words):
    with pytest.raises(InputError, match=words):
        call()
