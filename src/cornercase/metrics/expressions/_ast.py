"""Syntax tree of a logical expression, and its normalized spelling."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.metrics.expressions._recorded_signals import Signals, metric_of_signal

Relation = Literal["<", "<=", ">", ">="]
Operator = Literal["no", "unless", "not", "and", "or", "->", "always", "eventually", "until"]

TEMPORAL: Final = frozenset({"always", "eventually", "until"})
# A name ends before an operator, in upper or lower case.
_END_OF_NAME: Final = r"(?:(?i:and|or|until|unless)(?=[\s()\[]|$)|->|&&|\|\|)"
_PART_OF_NAME: Final = rf"(?!{_END_OF_NAME})(?:\([^()]*\)|(?!->)[^\s()<>])+"
ENTITY_NAME: Final = rf'(?!"){_PART_OF_NAME}(?:\s+{_PART_OF_NAME})*'
"""Pattern of the names of entities that need no quotes."""


@dataclass(frozen=True)
class Signal:
    """Signal of a recording in a bound, such as ``ttc`` or ``ego.speed``, named as in `Signals`.

    With `absolute`, the absolute value of the signal is compared.
    """

    name: str
    unit: str
    absolute: bool = False

    @property
    def text(self) -> str:
        """The signal in its normalized spelling."""
        return f"abs({self.name})" if self.absolute else self.name

    @property
    def metric(self) -> str:
        """Name of the metric of the signal, with options; empty for time and the motion of an entity."""
        return metric_of_signal(self.name)

    @property
    def is_score(self) -> bool:
        """True if the signal is the score of a metric, which is one number for the whole run."""
        return self.metric not in ("", self.name)

    def values(self, signals: Signals) -> FloatArray:
        """Return the values of the signal at each instant, shape (T,); NaN if it is not defined."""
        values = signals.values[self.name]
        return np.abs(values) if self.absolute else values

    def format_value(self, value: float) -> str:
        """Format a value of the signal with its unit."""
        return f"{value:.4g}" if self.unit == "1" else f"{value:.4g} {self.unit}"


@dataclass(frozen=True)
class Bound:
    """Comparison of a signal with another signal, or with a number in the unit of the signal: ``ttc > 1.5 s``.

    `number_text` is the normalized spelling of the number.
    """

    left: Signal
    relation: Relation
    right: Signal | float
    number_text: str = ""

    @property
    def signals(self) -> tuple[Signal, ...]:
        """Signals that the bound compares."""
        return (self.left, self.right) if isinstance(self.right, Signal) else (self.left,)

    @property
    def is_lower(self) -> bool:
        """True if the bound limits the left signal from below: ``>`` or ``>=``."""
        return self.relation in (">", ">=")

    def describe_right_side(self, signals: Signals, instant: int) -> str:
        """Describe the right side at an instant: ``"1.389 m/s (5 km/h)"``, or ``"other.speed, which is 3 m/s"``."""
        if isinstance(self.right, Signal):
            return f"{self.right.text}, which is {self.left.format_value(float(self.right.values(signals)[instant]))}"
        value = self.left.format_value(self.right)
        return value if value.startswith(self.number_text) else f"{value} ({self.number_text})"


@dataclass(frozen=True)
class EgoCollides:
    """Statement that the ego collides with `entity`, or with at least one entity if `entity` is empty.

    With `at_fault`, only collisions that are the ego's fault count.
    """

    entity: str = ""
    at_fault: bool = False


@dataclass(frozen=True)
class ReferenceCollides:
    """Statement that the ego would collide if the reference driver named `driver` drove the ego."""

    driver: str


@dataclass(frozen=True)
class EgoReaches:
    """Statement that the centre of the ego's box gets within `radius` m of the position (`x`, `y`).

    This has to happen at most `time_limit` s after the start.
    """

    x: float
    y: float
    radius: float
    time_limit: float


@dataclass(frozen=True)
class EgoDrives:
    """Statement that the ego has driven `distance` m since the start."""

    distance: float


@dataclass(frozen=True)
class EgoLeaves:
    """Statement that the ego's box is partly outside of its lane, or of the road."""

    what: Literal["lane", "road"]

    @property
    def metric(self) -> str:
        """Name of the metric of the distance from the ego's box to the edge of the lane or road."""
        return "lane-margin" if self.what == "lane" else f"lane-margin:edge={self.what}"


@dataclass(frozen=True)
class Operation:
    """Operator of an expression and its operands.

    `interval` of a temporal operator is its start and end in s; inf stands for the end of the recording.
    """

    operator: Operator
    operands: tuple[Node, ...]
    interval: tuple[float, float] | None = None

    @property
    def depth(self) -> int:
        """Number of nested operations, including this one."""
        return 1 + max(operand.depth if isinstance(operand, Operation) else 0 for operand in self.operands)


Statement: TypeAlias = EgoCollides | ReferenceCollides | EgoReaches | EgoDrives | EgoLeaves
Leaf: TypeAlias = Bound | Statement
Node: TypeAlias = Leaf | Operation


def format_node(node: Node, as_condition: bool = False) -> str:
    """Return an expression in its normalized spelling; nested operations of several operands get brackets.

    `as_condition` uses the short forms of conditions: ``not collision`` for ``not(collision)``, and ``ttc`` for the
    score of ``ttc``.
    """
    if not isinstance(node, Operation):
        return _format_leaf(node, as_condition)
    name: str = node.operator
    if name == "unless":
        driver = format_node(node.operands[1]).removeprefix("reference:")
        return f"no {format_node(node.operands[0])} unless {driver} collides"
    # Below a temporal operator a bound is on the course of a metric, as in a formula.
    as_condition = as_condition and name not in TEMPORAL
    if node.interval is not None:
        begin, end = node.interval
        name += f"[{begin:.15g}:{'' if end == np.inf else f'{end:.15g}'}]"
    inner = [format_node(operand, as_condition) for operand in node.operands]
    if len(inner) == 1:
        if as_condition or name == "no":
            return f"{name} ({inner[0]})" if _needs_brackets(node.operands[0]) else f"{name} {inner[0]}"
        return f"{name}({inner[0]})"
    parts = (f"({text})" if _needs_brackets(part) else text for part, text in zip(node.operands, inner, strict=True))
    return f" {name} ".join(parts)


def _format_leaf(leaf: Leaf, as_condition: bool) -> str:
    match leaf:
        case Bound(left, relation, right):
            text = left.metric if as_condition and left.is_score else left.text
            return f"{text} {relation} {right.text if isinstance(right, Signal) else leaf.number_text}"
        case EgoCollides(entity, at_fault):
            is_plain = re.fullmatch(ENTITY_NAME, entity) and " ".join(entity.split()) == entity
            name = entity if is_plain else json.dumps(entity, ensure_ascii=False)
            return f"collision{' at fault' if at_fault else ''}{f' with {name}' if entity else ''}"
        case ReferenceCollides(driver):
            return f"reference:{driver}"
        case EgoReaches(x, y, radius, time_limit):
            return f"reach {x:.15g},{y:.15g},{radius:.15g} within {time_limit:.15g}"
        case EgoDrives(distance):
            return f"drive {distance:.15g}"
        case EgoLeaves(what):
            return f"ego leaves {'its' if what == 'lane' else 'the'} {what}"


def _needs_brackets(node: Node) -> bool:
    return isinstance(node, Operation) and len(node.operands) > 1 and node.operator != "unless"


def iter_leaves(node: Node) -> Iterator[Leaf]:
    """Iterate over the bounds and statements of an expression, from left to right."""
    if not isinstance(node, Operation):
        yield node
        return
    for operand in node.operands:
        yield from iter_leaves(operand)


def has_temporal_operator(node: Node) -> bool:
    """Return whether the expression contains a temporal operator."""
    return isinstance(node, Operation) and (node.operator in TEMPORAL or any(map(has_temporal_operator, node.operands)))
