"""Selection of scenarios that kill mutants."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np
import pytest
from scipy.stats import binomtest

from cornercase.drivers import Mutant
from cornercase.reduction import KillMatrix
from cornercase.reduction._mutant_selection import select_killing


def apart_on_a_line(n):
    places = np.arange(float(n)) / n

    def apart(rows):
        return np.abs(places[list(rows)][:, None] - places)

    return apart


def exposure(exposed):
    n, m = exposed.shape
    mutants = tuple(Mutant(f"normal:horizon={7 - i / 10}", "foresees less") for i in range(m))
    return KillMatrix("normal", ("no collision",), tuple(range(1, n + 1)), np.zeros(n, bool), mutants, exposed)


def test_what_is_chosen_is_near_the_best_of_all_choices():
    """Compared with all choices of three: the sum of halves reaches 63 % of the maximum, here 95 % on average."""
    rng = np.random.default_rng(0)
    reached = []
    for _ in range(20):
        exposed = rng.random((12, 15)) < 0.2

        def worth(rows, exposed=exposed):
            return float((2.0 - 2.0 * 0.5 ** exposed[list(rows)].sum(axis=0)).sum())

        chosen = select_killing(exposed, apart_on_a_line(12), 3)
        best = max(worth(rows) for rows in combinations(range(12), 3))
        reached.append(worth(chosen) / best)
    assert min(reached) >= 1.0 - math.exp(-1.0)
    assert np.mean(reached) > 0.95


def test_a_rare_mutant_is_preferred_to_one_more_of_a_common_one():
    exposed = np.array([[1, 1, 0], [1, 1, 0], [0, 0, 1], [0, 0, 0]], dtype=bool)
    assert select_killing(exposed, apart_on_a_line(4), 2) == [0, 2]
    # Scenarios that kill nothing are not selected.
    assert sorted(select_killing(exposed, apart_on_a_line(4), 4)) == [0, 1, 2]


def test_of_equals_the_one_that_is_farthest_is_chosen_and_none_that_is_alike():
    exposed = np.ones((10, 2), dtype=bool)
    assert select_killing(exposed, apart_on_a_line(10), 3)[:2] == [0, 9]
    assert select_killing(exposed, lambda rows: np.zeros((len(rows), 10)), 3) == [0]


def test_grades_count_what_can_be_exposed():
    found = exposure(np.array([[1, 0, 0, 0], [1, 1, 0, 0], [0, 0, 1, 0]], dtype=bool))
    grade = found.mutation_score([1, 3])
    assert (grade.mutants, grade.killable, grade.killed) == (4, 3, 2)
    assert grade.interval == pytest.approx(tuple(binomtest(2, 3).proportion_ci(0.95, "exact")))
    assert found.mutation_score().share == 1.0
    # A scenario that was not run with mutants kills none.
    assert found.mutation_score([99]).killed == 0
    assert found.survivors == ("normal:horizon=6.7",)
    assert found.counts_by_mutation == {"foresees less": (3, 4)}
    low, high = binomtest(3, 4).proportion_ci(0.95, "exact")
    assert (
        found.summary_text
        == f"3 of 4 mutants of normal are exposed, 75% ({low:.0%} to {high:.0%} with 95 % confidence)"
    )
