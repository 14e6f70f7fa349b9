"""Random selections of scenarios, as a baseline.

A selection that was chosen by comparison with some random draws must not be evaluated with the same draws. So there are
independent random streams: one to choose a selection, one to evaluate it, and one to divide scenarios into folds.
"""

from __future__ import annotations

from typing import Final, Literal

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering._embedding import Distances, EmbeddedDistances

DEFAULT_DRAWS: Final = 100
"""Default number of random selections."""

# Spawn keys of NumPy's `SeedSequence`; sequences with different keys are independent, whatever the seeds.
_SPAWN_KEYS: Final[dict[str, tuple[int, ...]]] = {"choosing": (), "grading": (1,), "dividing": (2,)}


def draw_random_selections(
    n_scenarios: int, size: int, *, stream: Literal["choosing", "grading"], draws: int = DEFAULT_DRAWS, seed: int = 0
) -> IntArray:
    """Draw random selections of scenarios, as indices of shape (draws, size).

    The stream ``"choosing"`` is for choosing a selection, and the independent stream ``"grading"`` for evaluating one.
    """
    if draws < 1:
        raise InputError(f"`draws` {draws}: give at least 1.")
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=_SPAWN_KEYS[stream]))
    return np.array([rng.choice(n_scenarios, size=size, replace=False) for _ in range(draws)], dtype=np.int64)


def draw_fold_order(n_scenarios: int) -> IntArray:
    """Draw a random order of scenarios, by which scenarios are divided into folds for cross-validation."""
    rng = np.random.default_rng(np.random.SeedSequence(0, spawn_key=_SPAWN_KEYS["dividing"]))
    return rng.permutation(n_scenarios)


def distances_to_nearest_per_selection(
    distances: Distances, selections: IntArray, scenarios: IntArray | None = None
) -> FloatArray:
    """Return the distances from m scenarios, by default all, to the nearest scenario of each selection.

    The result has shape (draws, m), with a row for each of the `selections`.
    """
    if isinstance(distances, EmbeddedDistances):
        return distances.distances_to_nearest_per_choice(selections, scenarios)
    columns = slice(None) if scenarios is None else scenarios
    # The matrix is symmetric, and rows are contiguous in memory.
    return np.array([distances[choice].min(axis=0)[columns] for choice in selections])


def distances_to_nearest(distances: Distances, selection: IntArray) -> FloatArray:
    """Return the distance of every scenario to the nearest scenario of a selection, shape (n,)."""
    if isinstance(distances, EmbeddedDistances):
        return distances.distances_to_nearest(selection)
    distances_to_choice: FloatArray = distances[:, selection].min(axis=1)
    return distances_to_choice


def submatrix(distances: Distances, rows: IntArray, columns: IntArray) -> Distances:
    """Return the distances from the scenarios `rows` to the scenarios `columns`, in the same form as `distances`."""
    if isinstance(distances, EmbeddedDistances):
        return distances.subset(rows, columns)
    part: FloatArray = distances[np.ix_(rows, columns)]
    return part
