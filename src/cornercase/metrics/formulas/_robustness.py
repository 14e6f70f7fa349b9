"""Robustness of a formula from each instant on."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.metrics.formulas._ast import Comparison, Node, Operation, has_temporal_operator
from cornercase.metrics.formulas._operators import always, eventually, until


def compute_robustness(
    root: Node, margins: Mapping[Comparison, FloatArray], time: FloatArray, implicit_always: bool = True
) -> FloatArray:
    """Robustness of a formula from each instant on, shape (T,), never NaN.

    Quantitative semantics of Fainekos and Pappas 2009, Donzé and Maler 2010: minimum for conjunction and `always`,
    maximum for disjunction and `eventually`. `margins` are those of the comparisons, (T,), NaN where not defined.
    `implicit_always`: whether comparisons outside of temporal operators, by themselves or in a conjunction, have to
    hold all the time. InputError if the formula has a temporal operator and the extra ``stl`` is not installed.
    """
    follower = _RobustnessEvaluator(margins, time)
    return follower.required_robustness(root) if implicit_always else follower.robustness_values(root, False, np.inf)


class _RobustnessEvaluator:
    """Evaluates a formula with negations moved inwards, so that the role of each comparison is known."""

    def __init__(self, margins: Mapping[Comparison, FloatArray], time: FloatArray) -> None:
        self.margins, self.time = margins, time
        self.defined = {comparison: ~np.isnan(margin) for comparison, margin in margins.items()}

    def required_robustness(self, node: Node) -> FloatArray:
        """Robustness of a part that has to hold from the start on: for ever, unless a temporal operator limits it."""
        if not has_temporal_operator(node):
            held = self.robustness_values(node, False, np.inf)
            return np.asarray(np.minimum.accumulate(held[::-1])[::-1])
        if isinstance(node, Operation) and node.operator == "and":
            return np.asarray(np.minimum.reduce(list(map(self.required_robustness, node.operands))))
        return self.robustness_values(node, False, np.inf)

    def robustness_values(self, node: Node, negated: bool, undefined_value: float) -> FloatArray:
        """Robustness of a part or of its negation; `undefined_value` is the value of instants that are not defined."""
        if isinstance(node, Comparison):
            defined, margin = self.defined[node], self.margins[node]
            # A comparison that is never defined violates nothing, wherever it stands.
            default = undefined_value if defined.any() else np.inf
            return np.where(defined, -margin if negated else margin, default)
        if node.operator == "not":
            return self.robustness_values(node.operands[0], not negated, undefined_value)
        if node.operator in ("and", "or", "->"):
            *first, last = node.operands
            values = [
                self.robustness_values(operand, negated != (node.operator == "->"), undefined_value)
                for operand in first
            ]
            values.append(self.robustness_values(last, negated, undefined_value))
            is_conjunction = (node.operator == "and") != negated
            return np.asarray((np.minimum if is_conjunction else np.maximum).reduce(values))
        if node.operator == "until":
            return self._until_robustness(node, negated)
        is_always = (node.operator == "always") != negated
        inner = self.robustness_values(node.operands[0], negated, np.inf if is_always else -np.inf)
        return (always if is_always else eventually)(inner, node.interval, self.time)

    def _until_robustness(self, node: Operation, negated: bool) -> FloatArray:
        neutral, sign = (-np.inf, -1.0) if negated else (np.inf, 1.0)
        left, right = (
            sign * self.robustness_values(operand, negated, default)
            for operand, default in zip(node.operands, (neutral, -neutral), strict=True)
        )
        return sign * until(left, right, node.interval, self.time)
