"""Order scenarios by criticality; scenarios with the same score are ordered by the speed of their collisions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cornercase._common.typing import FloatArray, IntArray
from cornercase.metrics._outcome import Impact


def order_by_criticality(oriented_scores: FloatArray, impacts: Sequence[Sequence[Impact]]) -> IntArray:
    """Return indices of scenarios, the most critical first, shape (n,).

    Scenarios with the same score are sorted by the relative speed of the ego's first collision, the fastest first;
    scenarios without a collision come last. `impacts` has the ego's collisions in each scenario.
    """
    # The speed is NaN if an entity has no speed.
    speeds = np.array([np.nan_to_num(hits[0].speed) if hits else -1.0 for hits in impacts])
    order: IntArray = np.lexsort((-speeds, oriented_scores))
    return order
