"""Syntax tree of a formula."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.metrics.formulas._signals import Signals

Relation = Literal["<", "<=", ">", ">="]
Operator = Literal["not", "and", "or", "->", "always", "eventually", "until"]

TEMPORAL = frozenset({"always", "eventually", "until"})


@dataclass(frozen=True)
class Signal:
    """A signal in a comparison, named as in `Signals`; `absolute` takes its absolute value."""

    name: str
    unit: str
    absolute: bool = False

    @property
    def text(self) -> str:
        """The signal in its normalized spelling."""
        return f"abs({self.name})" if self.absolute else self.name

    def values(self, signals: Signals) -> FloatArray:
        """Values at each instant, (T,); NaN where it is not defined."""
        values = signals.values[self.name]
        return np.abs(values) if self.absolute else values

    def format_value(self, value: float) -> str:
        """Format a value of the signal with its unit."""
        return f"{value:.4g}" if self.unit == "1" else f"{value:.4g} {self.unit}"


@dataclass(frozen=True)
class Constant:
    """Number that a signal is compared with, in the signal's unit; `text` is how the formula spells it."""

    value: float
    text: str


@dataclass(frozen=True)
class Comparison:
    """A signal compared with a number or another signal.

    Attributes
    ----------
    left : Signal
    relation : {"<", "<=", ">", ">="}
    right : Signal or Constant
    """

    left: Signal
    relation: Relation
    right: Signal | Constant

    @property
    def text(self) -> str:
        """The comparison in its normalized spelling."""
        return f"{self.left.text} {self.relation} {self.right.text}"

    @property
    def signals(self) -> tuple[Signal, ...]:
        """Signals that are compared."""
        return (self.left, self.right) if isinstance(self.right, Signal) else (self.left,)

    def describe_right_side(self, signals: Signals, instant: int) -> str:
        """Describe the right side at an instant: ``"1.389 m/s (5 km/h)"``, or ``"other.speed, which is 3 m/s"``."""
        if isinstance(self.right, Signal):
            return f"{self.right.text}, which is {self.left.format_value(float(self.right.values(signals)[instant]))}"
        value, text = self.left.format_value(self.right.value), self.right.text
        return value if value.startswith(text) else f"{value} ({text})"

    def margin(self, signals: Signals) -> FloatArray:
        """Distance from the bound at each instant, (T,), in the unit of the signals.

        Positive if the comparison holds, negative if not, 0 at the bound; NaN where a signal is not defined.
        """
        left = self.left.values(signals)
        right = self.right.values(signals) if isinstance(self.right, Signal) else np.full_like(left, self.right.value)
        # The difference of two infinite values would be NaN, though they are equal.
        same = left == right
        gap = np.where(same, 0.0, left - np.where(same, 0.0, right))
        return np.asarray(gap if self.relation in (">", ">=") else 0.0 - gap)

    def truth_values(self, signals: Signals) -> FloatArray:
        """Whether it holds at each instant, (T,): 1 or -1; NaN where a signal is not defined."""
        margin = self.margin(signals)
        reached = margin >= 0.0 if self.relation in ("<=", ">=") else margin > 0.0
        return np.where(np.isnan(margin), np.nan, np.where(reached, 1.0, -1.0))


@dataclass(frozen=True)
class Operation:
    """An operator and its operands.

    `interval` is start and end in s, of temporal operators; inf for the end of the recording. None without an interval.
    """

    operator: Operator
    operands: tuple[Node, ...]
    interval: tuple[float, float] | None = None

    @property
    def text(self) -> str:
        """The formula in its normalized spelling, with brackets around each operation in it."""
        name: str = self.operator
        if self.interval is not None:
            begin, end = self.interval
            name += f"[{begin:.15g}:{'' if end == np.inf else f'{end:.15g}'}]"
        if len(self.operands) == 1:
            return f"{name}({self.operands[0].text})"
        inner = (
            operand.text if isinstance(operand, Comparison) or len(operand.operands) == 1 else f"({operand.text})"
            for operand in self.operands
        )
        return f" {name} ".join(inner)


Node: TypeAlias = Comparison | Operation


def iter_comparisons(node: Node) -> Iterator[Comparison]:
    """Iterate over the comparisons, from left to right."""
    if isinstance(node, Comparison):
        yield node
        return
    for operand in node.operands:
        yield from iter_comparisons(operand)


def has_temporal_operator(node: Node) -> bool:
    """Whether the formula contains a temporal operator."""
    return isinstance(node, Operation) and (node.operator in TEMPORAL or any(map(has_temporal_operator, node.operands)))
