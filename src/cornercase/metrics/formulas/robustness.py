"""How far a formula holds from each instant on."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.metrics.formulas.temporal import always, eventually, until
from cornercase.metrics.formulas.terms import Node, Operation, Predicate, is_temporal


def follow(root: Node, margins: Mapping[Predicate, FloatArray], time: FloatArray, for_good: bool = True) -> FloatArray:
    """Say how far a formula holds from each instant on.

    Quantitative semantics of Fainekos and Pappas 2009, Donzé and Maler 2010: the least of what has to hold together and
    always, the greatest of what may hold instead and eventually.

    Parameters
    ----------
    root : Predicate or Operation
    margins : mapping of Predicate to ndarray of float64, shape (T,)
        How far each comparison holds at each instant; NaN where it is not defined.
    time : ndarray of float64, shape (T,)
        s, increasing.
    for_good : bool, default True
        Whether what stands in no temporal operator, by itself or in a conjunction, has to hold all the time.

    Returns
    -------
    ndarray of float64, shape (T,)
        Never NaN.

    Raises
    ------
    InputError
        It has a temporal operator, and the extra ``stl`` is not installed.
    """
    follower = _Follower(margins, time)
    return follower.stated(root) if for_good else follower.values(root, False, np.inf)


class _Follower:
    """Goes through a formula with negations moved inwards, so that it is known what each comparison is there for."""

    def __init__(self, margins: Mapping[Predicate, FloatArray], time: FloatArray) -> None:
        self.margins, self.time = margins, time
        self.defined = {one: ~np.isnan(margin) for one, margin in margins.items()}

    def stated(self, node: Node) -> FloatArray:
        """A part that has to hold from the begin on: for good, if no temporal operator says for how long."""
        if not is_temporal(node):
            held = self.values(node, False, np.inf)
            return np.asarray(np.minimum.accumulate(held[::-1])[::-1])
        if isinstance(node, Operation) and node.operator == "and":
            return np.asarray(np.minimum.reduce(list(map(self.stated, node.operands))))
        return self.values(node, False, np.inf)

    def values(self, node: Node, negated: bool, left_out: float) -> FloatArray:
        """Values of a part or of its negation; `left_out` is what an instant counts for that is not defined."""
        if isinstance(node, Predicate):
            defined, margin = self.defined[node], self.margins[node]
            # What is never defined violates nothing, wherever it stands.
            otherwise = left_out if defined.any() else np.inf
            return np.where(defined, -margin if negated else margin, otherwise)
        if node.operator == "not":
            return self.values(node.operands[0], not negated, left_out)
        if node.operator in ("and", "or", "->"):
            *first, last = node.operands
            found = [self.values(one, negated != (node.operator == "->"), left_out) for one in first]
            found.append(self.values(last, negated, left_out))
            together = (node.operator == "and") != negated
            return np.asarray((np.minimum if together else np.maximum).reduce(found))
        if node.operator == "until":
            return self._until(node, negated)
        lasts = (node.operator == "always") != negated
        inner = self.values(node.operands[0], negated, np.inf if lasts else -np.inf)
        return (always if lasts else eventually)(inner, node.interval, self.time)

    def _until(self, node: Operation, negated: bool) -> FloatArray:
        left, right = node.operands
        neutral = -np.inf if negated else np.inf
        one, two = self.values(left, negated, neutral), self.values(right, negated, -neutral)
        return -until(-one, -two, node.interval, self.time) if negated else until(one, two, node.interval, self.time)
