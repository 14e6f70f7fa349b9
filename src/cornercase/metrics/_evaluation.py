"""Evaluation of a logical expression in one run: robustness, truth, and the part that decides."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Literal

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.metrics._other_entities import present_others
from cornercase.metrics._outcome import Fault
from cornercase.metrics._registry import METRICS
from cornercase.metrics.expressions._ast import (
    Bound,
    Leaf,
    Node,
    Operation,
    ReferenceCollides,
    has_temporal_operator,
    iter_leaves,
)
from cornercase.metrics.expressions._leaf_evaluation import LeafValues, evaluate_leaf
from cornercase.metrics.expressions._recorded_signals import Signals, signals_from_recording
from cornercase.metrics.expressions._temporal import always, until
from cornercase.recordings import Collision, Recording


@dataclass(frozen=True, eq=False)
class Evaluation:
    """An expression evaluated in one run, from the values of its bounds (``ttc < 1``) and statements (``collision``).

    The robustness follows Fainekos and Pappas 2009 and Donzé and Maler 2010: minimum for ``and`` and ``always``,
    maximum for ``or`` and ``eventually``. If the run does not show whether a statement holds, the caller chooses which
    robustness is assumed: inf is in favour of the expression, -inf is against it. A bound that is never defined counts
    as not violated.
    """

    root: Node
    signals: Signals
    leaves: Mapping[Leaf, LeafValues]

    @classmethod
    def from_signals(cls, root: Node, signals: Signals, shared: Mapping[Leaf, LeafValues] | None = None) -> Evaluation:
        """Evaluate the bounds and statements of an expression; values that `shared` contains are used again."""
        leaves = dict(shared or {})
        leaves |= {leaf: evaluate_leaf(leaf, signals) for leaf in iter_leaves(root) if leaf not in leaves}
        return cls(root, signals, leaves)

    def with_references(self, references: Mapping[str, bool | None]) -> Evaluation:
        """Return a copy of the evaluation with other outcomes of the reference drivers.

        `references` says for each driver whether it collides.
        """
        others: dict[Leaf, LeafValues] = {
            leaf: values for leaf, values in self.leaves.items() if not isinstance(leaf, ReferenceCollides)
        }
        return Evaluation.from_signals(self.root, replace(self.signals, references=references), others)

    def robustness(self, assumed: float = np.inf) -> FloatArray:
        """Return the robustness from each instant on, shape (T,), never NaN.

        `assumed` is the robustness of statements whose truth the run does not show.
        """
        return _Evaluator(self, "margin", assumed).evaluate_from_each_instant(self.root)

    def robustness_at_instants(self) -> FloatArray:
        """Return the robustness at each instant, shape (T,); the expression need not hold for the rest of the run."""
        return _Evaluator(self, "margin", np.inf).evaluate_at_instants(self.root, in_time=True)

    def holds(self, assumed: float = np.inf) -> BoolArray:
        """Return whether the expression holds from each instant on, shape (T,).

        Unlike robustness, this distinguishes ``<`` from ``<=``. `assumed` is as in `robustness`.
        """
        return _Evaluator(self, "truth", assumed).evaluate_from_each_instant(self.root) > 0.0

    def is_fulfilled(self) -> bool | None:
        """Return whether the expression holds from the first instant on; None if the run does not show this."""
        if not self.holds()[0]:
            return False
        if any(isinstance(leaf, Bound) and not values.is_known for leaf, values in self.leaves.items()):
            return None
        return True if self.holds(-np.inf)[0] else None

    def robustness_if_known(self) -> FloatArray:
        """Return the robustness from each instant on, shape (T,); all NaN if the run does not show the verdict.

        The verdict is whether the expression holds from the first instant on. The run does not show the verdict if the
        known parts do not violate the expression, but unknown statements could; or if no part is known and one part is
        a bound. Otherwise unknown statements are assumed to contradict the verdict, so that its margin is not
        overstated.
        """
        unknown = [leaf for leaf, values in self.leaves.items() if not values.is_known]
        if not unknown or not self.holds()[0]:
            return self.robustness()
        is_nothing_known = len(unknown) == len(self.leaves) and any(isinstance(leaf, Bound) for leaf in unknown)
        if is_nothing_known or not self.holds(-np.inf)[0]:
            return np.full(self.signals.time.shape, np.nan)
        return self.robustness(-np.inf)

    def find_decisive_leaf(self) -> tuple[Leaf, int] | None:
        """Return the leaf that decides the robustness of the whole run, and the instant at which it does.

        A leaf is a bound (``ttc < 1``) or a statement (``collision``). At this instant the margin of the leaf equals
        the robustness, with the opposite sign inside a ``not``. Other instants may have the same margin by chance, so
        the result is the first instant at which a change of the margin would change the robustness. None if the
        robustness is infinite.
        """
        robustness = self.robustness()[0]
        if not np.isfinite(robustness):
            return None
        for leaf, values in self.leaves.items():
            # Inside a 'not' the robustness is the negative margin.
            for sign in (1.0, -1.0):
                candidates = np.flatnonzero(sign * values.margin == robustness)
                for towards in (np.inf, -np.inf):
                    instant = self._first_decisive_instant(candidates, towards, leaf)
                    if instant is not None:
                        return leaf, instant
        return None

    def _first_decisive_instant(self, candidates: IntArray, direction: float, leaf: Leaf) -> int | None:
        """Return the first decisive instant among the `candidates`; None if none is decisive.

        An instant is decisive if the robustness changes when the margins of the leaf (a bound or statement) change in
        `direction` (inf or -inf) at this candidate and all earlier candidates.
        """
        before, values = self.robustness()[0], self.leaves[leaf]

        def robustness_changes(count: int) -> bool:
            margin = values.margin.copy()
            # By the last bit only: after a large change other leaves would decide.
            margin[candidates[:count]] = np.nextafter(margin[candidates[:count]], direction)
            changed = Evaluation(self.root, self.signals, {**self.leaves, leaf: values._replace(margin=margin)})
            return bool(changed.robustness()[0] != before)

        high, low = len(candidates), 0
        if not high or not robustness_changes(high):
            return None
        # Bisection works since the robustness is monotonic in each margin: a longer prefix changes it no less.
        while high - low > 1:
            middle = (high + low) // 2
            high, low = (middle, low) if robustness_changes(middle) else (high, middle)
        return int(candidates[high - 1])


def evaluate_run(
    root: Node,
    recording: Recording,
    ego: str,
    other: str | Sequence[str],
    courses: Mapping[str, FloatArray] | None = None,
    references: Mapping[str, bool | None] = MappingProxyType({}),
    faults: Mapping[Collision, Fault] = MappingProxyType({}),
) -> dict[str, Evaluation]:
    """Evaluate an expression against each other entity in the recording; return the evaluations by entity name.

    An expression that does not depend on the other entity is evaluated once. `courses` are courses of metrics that are
    already computed; with several other entities, only courses of metrics of the ego alone are used. `references` says
    for each reference driver whether it collides. `faults` says for collisions, if known, whose fault they are.
    """
    named = (other,) if isinstance(other, str) else tuple(other)
    if len(named) > 1 and courses is not None:
        courses = {name: course for name, course in courses.items() if METRICS.create(name).ego_only}
    others = present_others(recording, named)
    depends_on_other = any(
        isinstance(leaf, Bound) and not _is_same_against_all_others(leaf) for leaf in iter_leaves(root)
    )
    evaluations: dict[str, Evaluation] = {}
    shared: dict[Leaf, LeafValues] = {}
    known_faults = dict(faults)
    for other_name in others if depends_on_other else others[:1]:
        # If nothing looks at the other entity, it may not even exist.
        partner = other_name if depends_on_other else ego
        signals = signals_from_recording(recording, ego, partner, courses, others)
        evaluation = Evaluation.from_signals(root, replace(signals, references=references, faults=known_faults), shared)
        evaluations[other_name] = evaluation
        shared = {leaf: values for leaf, values in evaluation.leaves.items() if _is_same_against_all_others(leaf)}
    return evaluations


def _is_same_against_all_others(leaf: Leaf) -> bool:
    """Return whether a leaf (a bound or a statement) has the same values against each other entity."""
    return not isinstance(leaf, Bound) or all(signal.is_score for signal in leaf.signals)


class _Evaluator:
    """Evaluator of an expression, part by part; negations are passed down to the bounds and statements."""

    def __init__(self, evaluation: Evaluation, values: Literal["margin", "truth"], assumed: float) -> None:
        self.leaves, self.time = evaluation.leaves, evaluation.signals.time
        self.values: dict[Leaf, FloatArray] = {
            leaf: getattr(leaf_values, values) for leaf, leaf_values in self.leaves.items()
        }
        self.assumed = assumed

    def evaluate_from_each_instant(self, node: Node) -> FloatArray:
        """Return the value of an expression from each instant on, shape (T,).

        An expression without temporal operators has to hold until the end.
        """
        if has_temporal_operator(node):
            if isinstance(node, Operation) and node.operator == "and":
                return np.asarray(np.minimum.reduce(list(map(self.evaluate_from_each_instant, node.operands))))
            return self.evaluate_at_instants(node)
        return always(self.evaluate_at_instants(node), None, self.time)

    def evaluate_at_instants(
        self, node: Node, negated: bool = False, undefined_value: float = np.inf, in_time: bool = False
    ) -> FloatArray:
        """Return the value of a part of the expression, or of its negation, at each instant, shape (T,).

        `undefined_value` replaces the value of a bound at instants at which it is not defined. `in_time` says whether
        the part is inside a temporal operator. Inside, a statement such as ``collision`` is about each instant;
        outside, it is about the whole run.
        """
        if not isinstance(node, Operation):
            return self._leaf_values(node, negated, undefined_value, in_time)
        if node.operator == "until":
            return self._until_values(node, negated)
        if node.operator in ("always", "eventually"):
            sign = 1.0 if (node.operator == "always") != negated else -1.0
            inner = self.evaluate_at_instants(node.operands[0], negated, sign * np.inf, in_time=True)
            return sign * always(sign * inner, node.interval, self.time)
        values = [
            self.evaluate_at_instants(operand, is_negated, undefined_value, in_time)
            for operand, is_negated in zip(node.operands, _are_operands_negated(node, negated), strict=True)
        ]
        return np.asarray(_choose_combining_function(node, negated).reduce(values))

    def _leaf_values(self, leaf: Leaf, negated: bool, undefined_value: float, in_time: bool) -> FloatArray:
        values, is_known = self.values[leaf], self.leaves[leaf].is_known
        if isinstance(leaf, Bound):
            # A bound that is never defined violates nothing, wherever it stands.
            default = undefined_value if is_known else np.inf
            return np.where(np.isnan(values), default, -values if negated else values)
        if not is_known:
            return np.full(self.time.shape, self.assumed)
        if not in_time:
            values = np.full(self.time.shape, values.max())
        return -values if negated else values

    def _until_values(self, node: Operation, negated: bool) -> FloatArray:
        neutral, sign = (-np.inf, -1.0) if negated else (np.inf, 1.0)
        left, right = (
            sign * self.evaluate_at_instants(operand, negated, default, in_time=True)
            for operand, default in zip(node.operands, (neutral, -neutral), strict=True)
        )
        return sign * until(left, right, node.interval, self.time)


def _are_operands_negated(node: Operation, negated: bool) -> list[bool]:
    """Return for each operand of a logical operator whether the operand is negated."""
    if node.operator in ("->", "unless"):
        return [not negated, negated]
    return [negated != (node.operator in ("not", "no"))] * len(node.operands)


def _choose_combining_function(node: Operation, negated: bool) -> np.ufunc:
    """Return the function that combines the operands: minimum if all of them have to hold, else maximum."""
    return np.minimum if (node.operator == "and") != negated else np.maximum
