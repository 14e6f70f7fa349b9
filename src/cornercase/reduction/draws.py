"""Random choices of scenarios, to compare other choices with.

A choice that is made with regard to some random draws must not be graded against the same ones. So there are streams of
random numbers of their own: for choosing, for grading, and for dividing scenarios into those that choose and those that
grade.
"""

from __future__ import annotations

from typing import Final, Literal

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering import Distances, PlacedDistances

DRAWS: Final = 100
"""Number of random choices, unless another one is given."""

# Keys of NumPy's `SeedSequence`: sequences of different keys are independent, also of different seeds.
_KEYS: Final[dict[str, tuple[int, ...]]] = {"choosing": (), "grading": (1,), "dividing": (2,)}


def draw_choices(
    count: int, size: int, *, stream: Literal["choosing", "grading"], draws: int = DRAWS, seed: int = 0
) -> IntArray:
    """Draw random choices of scenarios.

    Parameters
    ----------
    count : int
        Number of scenarios to choose from.
    size : int
        Number of scenarios in a choice.
    stream : {"choosing", "grading"}
        What the draws are for; the two share no random numbers, whatever the seeds.
    draws : int, default 100
        Number of choices.
    seed : int, default 0
        Of the random numbers.

    Returns
    -------
    ndarray of int64, shape (draws, size)
        Indices, none twice in a choice.

    Raises
    ------
    InputError
        `draws` is not positive.
    """
    if draws < 1:
        raise InputError(f"`draws` {draws}: give at least 1.")
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=_KEYS[stream]))
    return np.array([rng.choice(count, size=size, replace=False) for _ in range(draws)], dtype=np.int64)


def draw_order(count: int) -> IntArray:
    """Draw an order of scenarios, to divide them by.

    Parameters
    ----------
    count : int
        Number of scenarios.

    Returns
    -------
    ndarray of int64, shape (count,)
        Indices.
    """
    rng = np.random.default_rng(np.random.SeedSequence(0, spawn_key=_KEYS["dividing"]))
    return rng.permutation(count)


def nearest_of(distances: Distances, choices: IntArray) -> FloatArray:
    """Distances from every scenario to the nearest one of each choice.

    Parameters
    ----------
    distances : ndarray of float64, shape (n, m), or PlacedDistances
        From those that are chosen from to all scenarios, in any unit.
    choices : ndarray of int64, shape (draws, size)
        Indices of the scenarios of each choice.

    Returns
    -------
    ndarray of float64, shape (draws, m)
        In the unit of the distances.
    """
    if isinstance(distances, PlacedDistances):
        return distances.nearest_of(choices)
    # Rows, as they lie together in memory: the matrix is symmetric.
    return np.array([distances[one].min(axis=0) for one in choices])


def nearest(distances: Distances, choice: IntArray) -> FloatArray:
    """Distances from every scenario to the nearest one of a choice.

    Parameters
    ----------
    distances : ndarray of float64, shape (n, n), or PlacedDistances
        Between all scenarios, in any unit.
    choice : ndarray of int64, shape (size,)
        Indices.

    Returns
    -------
    ndarray of float64, shape (n,)
        In the unit of the distances.
    """
    if isinstance(distances, PlacedDistances):
        return distances.nearest(choice)
    found: FloatArray = distances[:, choice].min(axis=1)
    return found


def part_of(distances: Distances, rows: IntArray, columns: IntArray) -> Distances:
    """Distances from some scenarios to some others.

    Parameters
    ----------
    distances : ndarray of float64, shape (n, n), or PlacedDistances
        Between all scenarios.
    rows, columns : ndarray of int64, each of shape (m,)
        Indices.

    Returns
    -------
    ndarray of float64, or PlacedDistances
        What was given.
    """
    if isinstance(distances, PlacedDistances):
        return distances.part(rows, columns)
    found: FloatArray = distances[np.ix_(rows, columns)]
    return found
