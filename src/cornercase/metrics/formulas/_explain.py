"""Find the comparison and the instant that decide whether a formula holds."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cornercase._common.typing import FloatArray, IntArray
from cornercase.metrics.formulas._ast import Comparison, Node
from cornercase.metrics.formulas._robustness import compute_robustness


def find_decisive_comparison(
    root: Node, margins: Mapping[Comparison, FloatArray], time: FloatArray
) -> tuple[Comparison, int] | None:
    """Find the comparison and the instant whose margin is the robustness at the first instant; None if it is infinite.

    Other instants may have the same margin by chance, even some that do not affect the formula. The result is the first
    one with which the robustness changes. `margins` has shape (T,) for each comparison.
    """
    robustness = compute_robustness(root, dict(margins), time)[0]
    if not np.isfinite(robustness):
        return None
    for comparison, margin in margins.items():
        # Inside a 'not' the robustness is the negative margin.
        for sign in (1.0, -1.0):
            candidates = np.flatnonzero(sign * margin == robustness)
            for towards in (np.inf, -np.inf):
                instant = _first_decisive_instant(candidates, towards, comparison, root, margins, time)
                if instant is not None:
                    return comparison, instant
    return None


def _first_decisive_instant(
    candidates: IntArray,
    direction: float,
    comparison: Comparison,
    root: Node,
    margins: Mapping[Comparison, FloatArray],
    time: FloatArray,
) -> int | None:
    """Last of the shortest prefix of `candidates` that changes the robustness if their margins change slightly."""
    before = compute_robustness(root, dict(margins), time)[0]

    def robustness_changes(count: int) -> bool:
        margin = margins[comparison].copy()
        # By the last bit only: after a large change other comparisons would decide.
        margin[candidates[:count]] = np.nextafter(margin[candidates[:count]], direction)
        return bool(compute_robustness(root, {**margins, comparison: margin}, time)[0] != before)

    high, low = len(candidates), 0
    if not high or not robustness_changes(high):
        return None
    # Bisection works since the robustness is monotonic in each margin: a longer prefix changes it no less.
    while high - low > 1:
        middle = (high + low) // 2
        high, low = (middle, low) if robustness_changes(middle) else (high, middle)
    return int(candidates[high - 1])
