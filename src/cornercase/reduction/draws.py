"""Random selections of scenarios, as a baseline.

A selection that was made with regard to some random draws must not be evaluated with the same ones. So there are
independent random streams: for choosing, for grading, and for dividing scenarios into folds.
"""

from __future__ import annotations

from typing import Final, Literal

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering import Distances, PlacedDistances

DRAWS: Final = 100
"""Default number of random selections."""

# Spawn keys of NumPy's `SeedSequence`; sequences with different keys are independent, whatever the seeds.
_KEYS: Final[dict[str, tuple[int, ...]]] = {"choosing": (), "grading": (1,), "dividing": (2,)}


def draw_choices(
    count: int, size: int, *, stream: Literal["choosing", "grading"], draws: int = DRAWS, seed: int = 0
) -> IntArray:
    """Draw random selections of scenarios, indices of shape (draws, size); the streams are independent."""
    if draws < 1:
        raise InputError(f"`draws` {draws}: give at least 1.")
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=_KEYS[stream]))
    return np.array([rng.choice(count, size=size, replace=False) for _ in range(draws)], dtype=np.int64)


def draw_order(count: int) -> IntArray:
    """Draw a random order of scenarios, from which folds are made."""
    rng = np.random.default_rng(np.random.SeedSequence(0, spawn_key=_KEYS["dividing"]))
    return rng.permutation(count)


def nearest_of(distances: Distances, choices: IntArray) -> FloatArray:
    """Return the distance of every scenario to the nearest one of each selection, shape (draws, m)."""
    if isinstance(distances, PlacedDistances):
        return distances.nearest_of(choices)
    # The matrix is symmetric, and rows are contiguous in memory.
    return np.array([distances[choice].min(axis=0) for choice in choices])


def nearest(distances: Distances, choice: IntArray) -> FloatArray:
    """Return the distance of every scenario to the nearest one of a selection, shape (n,)."""
    if isinstance(distances, PlacedDistances):
        return distances.nearest(choice)
    distances_to_choice: FloatArray = distances[:, choice].min(axis=1)
    return distances_to_choice


def part_of(distances: Distances, rows: IntArray, columns: IntArray) -> Distances:
    """Return the distances from some scenarios to some others, in the form in which they were given."""
    if isinstance(distances, PlacedDistances):
        return distances.part(rows, columns)
    part: FloatArray = distances[np.ix_(rows, columns)]
    return part
