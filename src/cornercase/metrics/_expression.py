"""Logical expressions about a recording: formulas, requirements and conditions."""

from __future__ import annotations

from dataclasses import dataclass

from cornercase._common.errors import ExpressionError as ExpressionError
from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray
from cornercase._common.validation import repr_short
from cornercase.metrics._evaluation import Evaluation
from cornercase.metrics._registry import METRICS
from cornercase.metrics.expressions._ast import (
    Bound,
    EgoCollides,
    EgoLeaves,
    Leaf,
    Node,
    ReferenceCollides,
    Signal,
    format_node,
    iter_leaves,
)
from cornercase.metrics.expressions._parser import Language, parse_expression
from cornercase.metrics.expressions._recorded_signals import Signals
from cornercase.metrics.expressions._units import normalize_unit

DEFAULT_CAP = 100.0
"""Upper limit of the robustness of a part of an expression that has no cap of its own."""


@dataclass(frozen=True)
class Expression:
    """A logical expression that has to hold in a run: a formula, a requirement or a condition.

    The language is described in docs/reference/expressions.md.

    Attributes
    ----------
    root : Bound, statement or Operation
        Root of the syntax tree; created by `Expression.parse`.
    text : str
        Normalized spelling, equal for expressions that differ in spelling only.

    See Also
    --------
    cornercase.metrics.signals_from_recording : Signals of a recording.

    Examples
    --------
    >>> import numpy as np
    >>> from cornercase.metrics import Expression, Signals
    >>> expression = Expression.parse("ttc>1.5s and ego.speed <= 50 km/h")
    >>> print(expression)
    ttc > 1.5 s and ego.speed <= 50 km/h
    >>> expression.metrics
    ('ttc',)
    >>> values = {"ttc": np.array([9.0, 2.0, 4.0]), "ego.speed": np.array([5.0, 5.0, 5.0])}
    >>> expression.robustness(Signals(np.array([0.0, 0.1, 0.2]), values))
    array([0.5, 0.5, 2.5])
    """

    root: Node
    text: str

    @classmethod
    def parse(cls, text: str, language: Language = "formula") -> Expression:
        """Parse an expression.

        Parameters
        ----------
        text : str
            Expression, such as ``"no collision and ttc > 1.5"`` or
            ``"always[0:5] (clearance > 0.5 or ego.speed < 1 km/h)"``.
        language : {"formula", "requirement", "condition"}, default "formula"
            Use of the expression; error messages name it. In a condition, a bound on a metric refers to the score of
            the metric unless it is inside a temporal operator: ``"ttc < 1"`` means ``"score(ttc) < 1"``.

        Returns
        -------
        Expression

        Raises
        ------
        InputError
            `text` is no str or no expression. The message marks the position of the error and says what to write.
        """
        if not isinstance(text, str):
            raise InputError(f"`text` {repr_short(text)}: give a text.")
        root = parse_expression(text, language)
        return cls(root, format_node(root, as_condition=language == "condition"))

    def __str__(self) -> str:
        return self.text

    @property
    def leaves(self) -> tuple[Leaf, ...]:
        """Bounds and statements of the expression, from left to right."""
        return tuple(dict.fromkeys(iter_leaves(self.root)))

    @property
    def bounds(self) -> tuple[Bound, ...]:
        """Comparisons of signals in the expression, from left to right."""
        return tuple(leaf for leaf in self.leaves if isinstance(leaf, Bound))

    @property
    def metrics(self) -> tuple[str, ...]:
        """Names of the metrics in the expression, with their options."""
        names = [signal.metric for bound in self.bounds for signal in bound.signals]
        names += [leaf.metric for leaf in self.leaves if isinstance(leaf, EgoLeaves)]
        return tuple(dict.fromkeys(filter(None, names)))

    @property
    def reference_drivers(self) -> tuple[str, ...]:
        """Names of the reference drivers in the expression."""
        return tuple(leaf.driver for leaf in self.leaves if isinstance(leaf, ReferenceCollides))

    @property
    def entities(self) -> tuple[str, ...]:
        """Names of the entities whose collision with the ego the expression mentions."""
        return tuple(leaf.entity for leaf in self.leaves if isinstance(leaf, EgoCollides) and leaf.entity)

    @property
    def unit(self) -> str:
        """Unit of the robustness: the common unit of all parts, or ``"1"`` if their units differ.

        The robustness of a statement on a collision, a position or a distance is in m.
        """
        units = [unit for _, unit in self.compared_units]
        return units[0] if len(set(map(normalize_unit, units))) == 1 else "1"

    @property
    def compared_units(self) -> tuple[tuple[str, str], ...]:
        """Pairs of metric and unit for each bound and statement, except statements on reference drivers.

        The metric is the empty string for a statement, and for a bound on a signal that is no metric.
        """
        return tuple(
            (leaf.left.metric, leaf.left.unit) if isinstance(leaf, Bound) else ("", "m")
            for leaf in self.leaves
            if not isinstance(leaf, ReferenceCollides)
        )

    @property
    def cap(self) -> float:
        """Value to which the metric `Stl` limits the robustness: the largest of the caps of its bounds and statements.

        If a bound compares a metric with a number, its cap is the distance of the number from the cap of the metric.
        """
        return max(map(_cap_of_leaf, self.leaves))

    def check_installed(self) -> None:
        """Raise if a package is not installed that a metric in the expression requires."""
        for name in self.metrics:
            METRICS.create(name).check_installed()

    @property
    def has_margin(self) -> bool:
        """True if the robustness says how narrowly the expression is fulfilled.

        False if the expression has a statement on a collision, which happens or not.
        """
        return not any(isinstance(leaf, EgoCollides | ReferenceCollides) for leaf in self.leaves)

    @property
    def asks_for_fault(self) -> bool:
        """True if a statement of the expression asks whose fault a collision is."""
        return any(isinstance(leaf, EgoCollides) and leaf.at_fault for leaf in self.leaves)

    def robustness(self, signals: Signals) -> FloatArray:
        """Compute the robustness from each instant on.

        Parameters
        ----------
        signals : Signals

        Returns
        -------
        ndarray of float64, shape (T,)
            Positive if the expression holds, negative if it is violated, in `unit`. The verdict stays the same as long
            as the difference between the two sides of each bound changes by less than this amount. inf if no change of
            the signals can violate the expression, -inf if no change can fulfil it.

        Raises
        ------
        InputError
            The expression has a statement that needs a recording, such as ``collision``, and `signals` has none.
        """
        return Evaluation.from_signals(self.root, signals).robustness()

    def is_fulfilled(self, signals: Signals) -> bool | None:
        """Return whether the expression holds from the first instant on.

        Parameters
        ----------
        signals : Signals

        Returns
        -------
        bool or None
            False if the expression is violated. None if the expression is not violated, but one of its bounds was never
            defined, or the answer depends on something that was not observed.
        """
        return Evaluation.from_signals(self.root, signals).is_fulfilled()


def _cap_of_leaf(leaf: Leaf) -> float:
    if isinstance(leaf, ReferenceCollides):
        return 0.0
    if not isinstance(leaf, Bound) or isinstance(leaf.right, Signal) or not leaf.left.metric:
        return DEFAULT_CAP
    return abs(METRICS.create(leaf.left.metric).cap - leaf.right)


def format_as_formula(expression: Expression) -> str:
    """Return the text of an expression as a formula, in which a bound on a score is written ``score(ttc) < 1``."""
    return format_node(expression.root)
