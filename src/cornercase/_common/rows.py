"""Rows of arrays as keys."""

from __future__ import annotations

from collections.abc import Collection
from typing import Final

import numpy as np

from cornercase._common.typing import FloatArray

# Odd, with its bits spread: 2**64 divided by the golden ratio.
_FACTOR: Final = np.uint64(0x9E3779B97F4A7C15)


def row_keys(points: FloatArray) -> list[bytes]:
    """Bytes of each row, by which equal rows are found.

    Parameters
    ----------
    points : ndarray of float64, shape (n, d)

    Returns
    -------
    list of bytes, length n
    """
    rows = np.ascontiguousarray(points, dtype=np.float64)
    found: list[bytes] = rows.view(np.dtype((np.void, rows.itemsize * rows.shape[1]))).ravel().tolist()
    return found


def surely_distinct(points: FloatArray, keys: Collection[bytes]) -> bool:
    """Tell at a glance that no row is there twice, nor its key among others.

    Parameters
    ----------
    points : ndarray of float64, shape (n, d)
    keys : collection of bytes
        As of `row_keys`, each once.

    Returns
    -------
    bool
        False may be a mere coincidence, of which there is one in 10 billion calls with 32,768 rows.
    """
    others = np.frombuffer(b"".join(keys), dtype=np.uint64).reshape(-1, points.shape[1])
    words = np.concatenate([np.ascontiguousarray(points, dtype=np.float64).view(np.uint64), others])
    hashes = np.zeros(len(words), dtype=np.uint64)
    for column in words.T:
        hashes = (hashes ^ (hashes >> np.uint64(29)) ^ column) * _FACTOR
    hashes.sort()
    return bool((hashes[1:] != hashes[:-1]).all())
