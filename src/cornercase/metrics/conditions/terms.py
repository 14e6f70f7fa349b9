"""What a condition is made of, and whether it holds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.metrics.base import Score
from cornercase.metrics.formulas.terms import Relation


@dataclass(frozen=True)
class Collision:
    """The ego collides, with anybody."""

    @property
    def text(self) -> str:
        """As it is written."""
        return "collision"


@dataclass(frozen=True)
class ReferenceCollides:
    """The ego would collide if a reference drove it.

    Attributes
    ----------
    driver : str
        Name of the reference.
    """

    driver: str

    @property
    def text(self) -> str:
        """As it is written."""
        return f"reference:{self.driver}"


@dataclass(frozen=True)
class ScoreBound:
    """The score of a metric compared with a number.

    Attributes
    ----------
    metric : str
        Its name, with its options.
    relation : {"<", "<=", ">", ">="}
    value : float
        In the unit of the metric.
    text : str
        As it is written.
    """

    metric: str
    relation: Relation
    value: float
    text: str

    def holds(self, score: float) -> bool:
        """Whether it holds of a score."""
        if score == self.value:
            return self.relation in ("<=", ">=")
        return (score < self.value) == (self.relation in ("<", "<="))

    def margin(self, scores: Score) -> Score:
        """How far it is from holding, in the unit of the metric: negative where it holds, 0 at the bound."""
        gap = scores - self.value
        return gap if self.relation in ("<", "<=") else -gap


@dataclass(frozen=True)
class Connected:
    """Parts of a condition, connected.

    Attributes
    ----------
    operator : {"not", "and", "or"}
    operands : tuple of Collision, ReferenceCollides, ScoreBound or Connected
    """

    operator: Literal["not", "and", "or"]
    operands: tuple[Part, ...]

    @property
    def text(self) -> str:
        """As it is written, with brackets around each part that is made of several."""
        inner = [f"({one.text})" if _joined(one) else one.text for one in self.operands]
        return f"not {inner[0]}" if self.operator == "not" else f" {self.operator} ".join(inner)


Fact: TypeAlias = Collision | ReferenceCollides | ScoreBound
Part: TypeAlias = Fact | Connected


class Span(NamedTuple):
    """How far something is from holding, at least and at most: negative where it holds.

    Attributes
    ----------
    low, high : float, or ndarray of float64, shape (T,)
        They differ where it is not known whether a reference collides.
    """

    low: FloatArray | float
    high: FloatArray | float


def facts_in(part: Part) -> Iterator[Fact]:
    """Go through what a condition speaks of, from left to right.

    Parameters
    ----------
    part : Collision, ReferenceCollides, ScoreBound or Connected

    Yields
    ------
    Collision, ReferenceCollides or ScoreBound
    """
    if not isinstance(part, Connected):
        yield part
        return
    for one in part.operands:
        yield from facts_in(one)


def truth_of(part: Part, known: Mapping[Fact, bool | None]) -> bool | None:
    """Tell whether a condition holds, by Kleene's logic of three values.

    Parameters
    ----------
    part : Collision, ReferenceCollides, ScoreBound or Connected
    known : mapping of a fact to bool or None
        None where it is not known.

    Returns
    -------
    bool or None
        None where that depends on what is not known.
    """
    if not isinstance(part, Connected):
        return known[part]
    found = [truth_of(one, known) for one in part.operands]
    if part.operator == "not":
        return None if found[0] is None else not found[0]
    decisive = part.operator == "or"
    if decisive in found:
        return decisive
    return None if None in found else not decisive


def span_of(part: Part, known: Mapping[Fact, Span]) -> Span:
    """Say how far a condition is from holding: of parts that all have to hold the farthest counts.

    Parameters
    ----------
    part : Collision, ReferenceCollides, ScoreBound or Connected
    known : mapping of a fact to Span

    Returns
    -------
    Span
    """
    if not isinstance(part, Connected):
        return known[part]
    found = [span_of(one, known) for one in part.operands]
    if part.operator == "not":
        return Span(-found[0].high, -found[0].low)
    joined = np.maximum if part.operator == "and" else np.minimum
    low, high = found[0]
    for one in found[1:]:
        low, high = joined(low, one.low), joined(high, one.high)
    return Span(low, high)


def _joined(part: Part) -> bool:
    return isinstance(part, Connected) and part.operator != "not"
