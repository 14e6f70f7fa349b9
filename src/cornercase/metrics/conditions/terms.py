"""Syntax tree of a condition, and its evaluation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal, NamedTuple, TypeAlias

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.metrics.base import Score
from cornercase.metrics.formulas.terms import Relation


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
class ScoreBound:
    """Score of a metric, named with its options, compared with a number in the metric's unit."""

    metric: str
    relation: Relation
    value: float
    text: str

    def holds(self, score: float) -> bool:
        """Whether the comparison holds for a score."""
        if score == self.value:
            return self.relation in ("<=", ">=")
        return (score < self.value) == (self.relation in ("<", "<="))

    def margin(self, scores: Score) -> Score:
        """Distance from holding, in the metric's unit: negative if it holds, 0 at the bound."""
        gap = scores - self.value
        return gap if self.relation in ("<", "<=") else -gap


@dataclass(frozen=True)
class Connected:
    """Parts of a condition, connected by an operator."""

    operator: Literal["not", "and", "or"]
    operands: tuple[Part, ...]

    @property
    def text(self) -> str:
        """The condition in its normalized spelling, with brackets around each connected part."""
        inner = [
            f"({part.text})" if isinstance(part, Connected) and part.operator != "not" else part.text
            for part in self.operands
        ]
        return f"not {inner[0]}" if self.operator == "not" else f" {self.operator} ".join(inner)


Fact: TypeAlias = Collision | ReferenceCollides | ScoreBound
Part: TypeAlias = Fact | Connected


class Span(NamedTuple):
    """Least and greatest distance from holding, negative if it holds: float or shape (T,).

    They differ if it is not known whether a reference collides.
    """

    low: FloatArray | float
    high: FloatArray | float


def facts_in(part: Part) -> Iterator[Fact]:
    """Iterate over the elementary statements of a condition, from left to right."""
    if not isinstance(part, Connected):
        yield part
        return
    for operand in part.operands:
        yield from facts_in(operand)


def truth_of(part: Part, known: Mapping[Fact, bool | None]) -> bool | None:
    """Whether a condition holds, in Kleene's three-valued logic: None if that depends on unknown statements."""
    if not isinstance(part, Connected):
        return known[part]
    results = [truth_of(operand, known) for operand in part.operands]
    if part.operator == "not":
        return None if results[0] is None else not results[0]
    decisive = part.operator == "or"
    if decisive in results:
        return decisive
    return None if None in results else not decisive


def span_of(part: Part, known: Mapping[Fact, Span]) -> Span:
    """Distance of a condition from holding: ``and`` takes the farthest part, ``or`` the nearest."""
    if not isinstance(part, Connected):
        return known[part]
    spans = [span_of(operand, known) for operand in part.operands]
    if part.operator == "not":
        return Span(-spans[0].high, -spans[0].low)
    combine = np.maximum if part.operator == "and" else np.minimum
    low, high = spans[0]
    for span in spans[1:]:
        low, high = combine(low, span.low), combine(high, span.high)
    return Span(low, high)
