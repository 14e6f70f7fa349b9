"""Syntax tree of a condition, and its evaluation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal, NamedTuple, TypeAlias

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.metrics._base import Score
from cornercase.metrics.formulas._ast import Relation


@dataclass(frozen=True)
class Collision:
    """The ego collides with any entity."""

    text: ClassVar[str] = "collision"


@dataclass(frozen=True)
class ReferenceCollides:
    """The ego would collide if the reference driver `driver` drove it."""

    driver: str

    @property
    def text(self) -> str:
        """The condition in its normalized spelling."""
        return f"reference:{self.driver}"


@dataclass(frozen=True)
class ScoreComparison:
    """Score of a metric, named with its options, compared with a number in the metric's unit."""

    metric: str
    relation: Relation
    value: float
    text: str

    def is_fulfilled_by(self, score: float) -> bool:
        """Whether the comparison holds for a score."""
        if score == self.value:
            return self.relation in ("<=", ">=")
        return (score < self.value) == (self.relation in ("<", "<="))

    def distance_from_holding(self, scores: Score) -> Score:
        """Distance from holding, in the metric's unit: negative if it holds, 0 at the bound."""
        gap = scores - self.value
        return gap if self.relation in ("<", "<=") else -gap


@dataclass(frozen=True)
class LogicalOperation:
    """Parts of a condition, connected by an operator."""

    operator: Literal["not", "and", "or"]
    operands: tuple[Condition, ...]

    @property
    def text(self) -> str:
        """The condition in its normalized spelling, with brackets around each connected part."""
        inner = [
            f"({part.text})" if isinstance(part, LogicalOperation) and part.operator != "not" else part.text
            for part in self.operands
        ]
        return f"not {inner[0]}" if self.operator == "not" else f" {self.operator} ".join(inner)


Statement: TypeAlias = Collision | ReferenceCollides | ScoreComparison
Condition: TypeAlias = Statement | LogicalOperation


class DistanceRange(NamedTuple):
    """Least and greatest distance from holding, negative if it holds: float or shape (T,).

    They differ if it is not known whether a reference collides.
    """

    low: FloatArray | float
    high: FloatArray | float


def iter_statements(part: Condition) -> Iterator[Statement]:
    """Iterate over the elementary statements of a condition, from left to right."""
    if not isinstance(part, LogicalOperation):
        yield part
        return
    for operand in part.operands:
        yield from iter_statements(operand)


def evaluate_truth(part: Condition, truths: Mapping[Statement, bool | None]) -> bool | None:
    """Whether a condition holds, in Kleene's three-valued logic: None if that depends on unknown statements."""
    if not isinstance(part, LogicalOperation):
        return truths[part]
    results = [evaluate_truth(operand, truths) for operand in part.operands]
    if part.operator == "not":
        return None if results[0] is None else not results[0]
    decisive = part.operator == "or"
    if decisive in results:
        return decisive
    return None if None in results else not decisive


def evaluate_distance(part: Condition, distances: Mapping[Statement, DistanceRange]) -> DistanceRange:
    """Distance of a condition from holding: ``and`` takes the farthest part, ``or`` the nearest."""
    if not isinstance(part, LogicalOperation):
        return distances[part]
    spans = [evaluate_distance(operand, distances) for operand in part.operands]
    if part.operator == "not":
        return DistanceRange(-spans[0].high, -spans[0].low)
    combine = np.maximum if part.operator == "and" else np.minimum
    low, high = spans[0]
    for span in spans[1:]:
        low, high = combine(low, span.low), combine(high, span.high)
    return DistanceRange(low, high)
