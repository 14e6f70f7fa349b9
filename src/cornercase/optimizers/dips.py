"""Where scores fall towards a threshold without reaching it."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from cornercase._common.typing import FloatArray

# So many times as far as from the scores about it a score may be from the threshold.
_MOST: Final = 3.0


def below_dips(at: FloatArray, scores: FloatArray, threshold: float, most: int | None = None) -> FloatArray:
    """Places that are likely to be lower than the scenarios that are lower than all those about them.

    A process of all scores, most of which may be flat, does not tell such a scenario from noise, and a search for a
    boundary goes to the one that is known. But the next critical region may lie there.

    Looked at is each scenario that is not critical and has the least score among its nearest ones, as many as a cube
    has sides, if its score is at most three times as far from the threshold as from their median. From there it goes
    downhill by the slope through these neighbours, half as far as to the nearest of them.

    Parameters
    ----------
    at : ndarray of float64, shape (n, e)
        Scenarios that were run, as `encoded`.
    scores : ndarray of float64, shape (n,)
        Oriented; NaN for a scenario that failed, which counts as the highest.
    threshold : float
    most : int, optional
        How many are looked for; by default all.

    Returns
    -------
    ndarray of float64, shape (m, e)
        At most so many; first from where the score is nearest to the threshold by that measure.
    """
    count = 2 * at.shape[1]
    if len(at) <= count:
        return at[:0]
    scores = np.where(np.isnan(scores), np.nanmax(scores), scores)
    far, near = map(np.asarray, cKDTree(at).query(at, k=count + 1))
    about = scores[near[:, 1:]]
    height, depth = scores - threshold, np.median(about, axis=1) - scores
    lowest = (height > 0.0) & (scores < about.min(axis=1)) & (height <= _MOST * depth)
    dips = np.flatnonzero(lowest)
    dips = dips[np.argsort(height[dips] / depth[dips], kind="stable")][:most]
    places = np.empty((len(dips), at.shape[1]))
    for k, i in enumerate(dips):
        others = near[i, 1:]
        slope = np.linalg.lstsq(at[others] - at[i], scores[others] - scores[i], rcond=None)[0]
        places[k] = at[i] - 0.5 * far[i, 1] * slope / max(float(np.linalg.norm(slope)), 1e-12)
    return places
