"""Rows of arrays as keys."""

from __future__ import annotations

import numpy as np

from cornercase._common.typing import FloatArray


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
