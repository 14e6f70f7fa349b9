"""Use the rows of arrays as dictionary keys."""

from __future__ import annotations

from collections.abc import Collection
from typing import Final

import numpy as np

from cornercase._common.typing import FloatArray

# 2**64 divided by the golden ratio: odd, with well-spread bits.
_HASH_FACTOR: Final = np.uint64(0x9E3779B97F4A7C15)


def row_keys(points: FloatArray) -> list[bytes]:
    """Return the bytes of each row of `points`, shape (n, d); equal rows have equal bytes."""
    rows = np.ascontiguousarray(points, dtype=np.float64)
    keys: list[bytes] = rows.view(np.dtype((np.void, rows.itemsize * rows.shape[1]))).ravel().tolist()
    return keys


def no_duplicates(points: FloatArray, keys: Collection[bytes]) -> bool:
    """Return whether all rows of `points` differ from one another and from the rows with the given `keys`.

    `points` has the shape (n, d); `keys` are results of `row_keys`. True is always right. False is wrong if two
    different rows have the same 64-bit hash: less than once in 10 billion calls with 32,768 rows.
    """
    known_words = np.frombuffer(b"".join(keys), dtype=np.uint64).reshape(-1, points.shape[1])
    words = np.concatenate([np.ascontiguousarray(points, dtype=np.float64).view(np.uint64), known_words])
    hashes = np.zeros(len(words), dtype=np.uint64)
    for column in words.T:
        hashes = (hashes ^ (hashes >> np.uint64(29)) ^ column) * _HASH_FACTOR
    hashes.sort()
    return bool((hashes[1:] != hashes[:-1]).all())
