"""Syntax tree of an expression, and how it is written."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.metrics.expressions._signals import Signals, metric_of_signal

Relation = Literal["<", "<=", ">", ">="]
Operator = Literal["no", "unless", "not", "and", "or", "->", "always", "eventually", "until"]

TEMPORAL: Final = frozenset({"always", "eventually", "until"})
_PART_OF_NAME: Final = r"(?!(?:and|or|until|->)(?:[\s)]|$))(?:\([^()]*\)|[^\s()])+"
ENTITY_NAME: Final = re.compile(rf'(?!"){_PART_OF_NAME}(?:\s+{_PART_OF_NAME})*')
"""Name of an entity that needs no quotes."""


@dataclass(frozen=True)
class Signal:
    """A signal in a bound, named as in `Signals`; `absolute` takes its absolute value."""

    name: str
    unit: str
    absolute: bool = False

    @property
    def text(self) -> str:
        """The signal in its normalized spelling."""
        return f"abs({self.name})" if self.absolute else self.name

    @property
    def metric(self) -> str:
        """Name of its metric, with options; empty for the motion of an entity and time."""
        return metric_of_signal(self.name)

    @property
    def is_score(self) -> bool:
        """Whether it is the score of its metric, one number for the whole run."""
        return self.metric not in ("", self.name)

    def values(self, signals: Signals) -> FloatArray:
        """Values at each instant, (T,); NaN where it is not defined."""
        values = signals.values[self.name]
        return np.abs(values) if self.absolute else values

    def format_value(self, value: float) -> str:
        """Format a value of the signal with its unit."""
        return f"{value:.4g}" if self.unit == "1" else f"{value:.4g} {self.unit}"


@dataclass(frozen=True)
class Constant:
    """Number that a signal is compared with, in the signal's unit; `text` is how the expression spells it."""

    value: float
    text: str


@dataclass(frozen=True)
class Bound:
    """A signal compared with a number or another signal."""

    left: Signal
    relation: Relation
    right: Signal | Constant

    @property
    def text(self) -> str:
        """The bound in its normalized spelling."""
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

        Positive if it holds, negative if not, 0 at the bound; NaN where a signal is not defined.
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
class EgoCollides:
    """The ego collides: with an entity, or with any if `entity` is empty; `at_fault` counts only its own faults."""

    entity: str = ""
    at_fault: bool = False

    @property
    def text(self) -> str:
        """The statement in its normalized spelling."""
        is_plain = ENTITY_NAME.fullmatch(self.entity) and " ".join(self.entity.split()) == self.entity
        name = self.entity if is_plain else json.dumps(self.entity, ensure_ascii=False)
        return f"collision{' at fault' if self.at_fault else ''}{f' with {name}' if self.entity else ''}"


@dataclass(frozen=True)
class ReferenceCollides:
    """The ego would collide if the reference driver `driver` drove it."""

    driver: str

    @property
    def text(self) -> str:
        """The statement in its normalized spelling."""
        return f"reference:{self.driver}"


@dataclass(frozen=True)
class EgoReaches:
    """The centre of the ego's box is within `radius` m of a position, at most `time_limit` s after the beginning."""

    x: float
    y: float
    radius: float
    time_limit: float

    @property
    def text(self) -> str:
        """The statement in its normalized spelling."""
        return f"reach {self.x:.15g},{self.y:.15g},{self.radius:.15g} within {self.time_limit:.15g}"


@dataclass(frozen=True)
class EgoDrives:
    """The ego has driven `distance` m since the beginning."""

    distance: float

    @property
    def text(self) -> str:
        """The statement in its normalized spelling."""
        return f"drive {self.distance:.15g}"


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
        """The expression in its normalized spelling, with brackets around each operation in it."""
        return format_node(self)

    @property
    def depth(self) -> int:
        """How many operations are nested in each other, this one included."""
        return 1 + max(operand.depth if isinstance(operand, Operation) else 0 for operand in self.operands)

    def is_conjunction(self, negated: bool) -> bool:
        """Whether the operation, or its negation, holds only if all its operands (negated as needed) do."""
        return (self.operator == "and") != negated


Statement: TypeAlias = EgoCollides | ReferenceCollides | EgoReaches | EgoDrives
Leaf: TypeAlias = Bound | Statement
Node: TypeAlias = Leaf | Operation


def format_node(node: Node, as_condition: bool = False) -> str:
    """Write an expression; `as_condition` writes ``not collision`` for ``not(collision)``, and ``ttc`` for its score."""
    if isinstance(node, Bound) and as_condition and node.left.is_score:
        return f"{node.left.metric} {node.relation} {node.right.text}"
    if not isinstance(node, Operation):
        return node.text
    name: str = node.operator
    if name == "unless":
        driver = node.operands[1]
        return f"no {node.operands[0].text} unless {driver.text.removeprefix('reference:')} collides"
    # Below a temporal operator a bound is on the course of a metric, as in a formula.
    as_condition = as_condition and name not in TEMPORAL
    if node.interval is not None:
        begin, end = node.interval
        name += f"[{begin:.15g}:{'' if end == np.inf else f'{end:.15g}'}]"
    inner = [format_node(operand, as_condition) for operand in node.operands]
    if len(inner) == 1:
        bare = name == "no" or (as_condition and not _is_connection(node.operands[0]))
        return f"{name} {inner[0]}" if bare else f"{name} ({inner[0]})" if as_condition else f"{name}({inner[0]})"
    parts = (f"({text})" if _is_connection(part) else text for part, text in zip(node.operands, inner, strict=True))
    return f" {name} ".join(parts)


def _is_connection(node: Node) -> bool:
    return isinstance(node, Operation) and len(node.operands) > 1 and node.operator != "unless"


def iter_leaves(node: Node) -> Iterator[Leaf]:
    """Iterate over the bounds and statements, from left to right."""
    if not isinstance(node, Operation):
        yield node
        return
    for operand in node.operands:
        yield from iter_leaves(operand)


def has_temporal_operator(node: Node) -> bool:
    """Whether the expression contains a temporal operator."""
    return isinstance(node, Operation) and (node.operator in TEMPORAL or any(map(has_temporal_operator, node.operands)))
