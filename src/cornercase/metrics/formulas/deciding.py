"""Which comparison decides whether a formula holds, and at which instant."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cornercase._common.typing import FloatArray, IntArray
from cornercase.metrics.formulas.robustness import follow
from cornercase.metrics.formulas.terms import Node, Predicate


def find_decisive(
    root: Node, margins: Mapping[Predicate, FloatArray], time: FloatArray
) -> tuple[Predicate, int] | None:
    """Find what the robustness from the first instant on is the margin of.

    Several instants may have that margin by chance, also some that the formula does not look at. The one that decides
    is the first of them with which the robustness changes.

    Parameters
    ----------
    root : Predicate or Operation
        The formula.
    margins : mapping of Predicate to ndarray of float64, shape (T,)
        Of its comparisons.
    time : ndarray of float64, shape (T,)
        s.

    Returns
    -------
    tuple of Predicate and int, or None
        None where the robustness is infinite.
    """
    robustness = follow(root, dict(margins), time)[0]
    if not np.isfinite(robustness):
        return None
    for one, margin in margins.items():
        # Behind a 'not' the robustness is the negative.
        for sign in (1.0, -1.0):
            candidates = np.flatnonzero(sign * margin == robustness)
            for towards in (np.inf, -np.inf):
                found = _first(candidates, towards, one, root, margins, time)
                if found is not None:
                    return one, found
    return None


def _first(
    candidates: IntArray,
    towards: float,
    one: Predicate,
    root: Node,
    margins: Mapping[Predicate, FloatArray],
    time: FloatArray,
) -> int | None:
    """Last of the fewest first candidates with which the robustness changes when their margins do so a little."""
    before = follow(root, dict(margins), time)[0]

    def changes(count: int) -> bool:
        margin = margins[one].copy()
        # By no more than the last bit: a large change would let others decide.
        margin[candidates[:count]] = np.nextafter(margin[candidates[:count]], towards)
        return bool(follow(root, {**margins, one: margin}, time)[0] != before)

    enough, few = len(candidates), 0
    if not enough or not changes(enough):
        return None
    # What a margin changes it changes in one direction, so that more of them change no less.
    while enough - few > 1:
        middle = (enough + few) // 2
        enough, few = (middle, few) if changes(middle) else (enough, middle)
    return int(candidates[enough - 1])
