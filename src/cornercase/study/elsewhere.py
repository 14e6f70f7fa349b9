"""Scores of another study, from which a search begins."""

from __future__ import annotations

import hashlib

from cornercase._common.typing import FloatArray


def digest_of_scores(points: FloatArray, scores: FloatArray) -> str:
    """SHA-256 of points and their scores.

    Parameters
    ----------
    points : ndarray of float64, shape (n, d)
    scores : ndarray of float64, shape (n,)

    Returns
    -------
    str
    """
    return hashlib.sha256(points.astype("<f8").tobytes() + scores.astype("<f8").tobytes()).hexdigest()
