"""What a formula is made of."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.metrics.formulas.signals import Signals

Relation = Literal["<", "<=", ">", ">="]
Operator = Literal["not", "and", "or", "->", "always", "eventually", "until"]

TEMPORAL = frozenset({"always", "eventually", "until"})


@dataclass(frozen=True)
class Signal:
    """A signal as it stands in a comparison.

    Attributes
    ----------
    name : str
        As of `Signals`.
    unit : str
    absolute : bool
        Whether its absolute value is meant.
    """

    name: str
    unit: str
    absolute: bool = False

    @property
    def text(self) -> str:
        """As it is written."""
        return f"abs({self.name})" if self.absolute else self.name

    def values(self, signals: Signals) -> FloatArray:
        """Values at each instant.

        Parameters
        ----------
        signals : Signals

        Returns
        -------
        ndarray of float64, shape (T,)
            NaN where it is not defined.
        """
        found = signals.values[self.name]
        return np.abs(found) if self.absolute else found

    def tell_value(self, value: float) -> str:
        """Write a value of it with its unit.

        Parameters
        ----------
        value : float

        Returns
        -------
        str
        """
        return f"{value:.4g}" if self.unit == "1" else f"{value:.4g} {self.unit}"


@dataclass(frozen=True)
class Bound:
    """A number that a signal is compared with.

    Attributes
    ----------
    value : float
        In the unit of the signal.
    text : str
        As it is written, with its unit.
    """

    value: float
    text: str


@dataclass(frozen=True)
class Predicate:
    """A signal compared with a number or another signal.

    Attributes
    ----------
    left : Signal
    relation : {"<", "<=", ">", ">="}
    right : Signal or Bound
    """

    left: Signal
    relation: Relation
    right: Signal | Bound

    @property
    def text(self) -> str:
        """As it is written."""
        return f"{self.left.text} {self.relation} {self.right.text}"

    @property
    def signals(self) -> tuple[Signal, ...]:
        """Signals that are compared."""
        return (self.left, self.right) if isinstance(self.right, Signal) else (self.left,)

    def tell_right(self, signals: Signals, k: int) -> str:
        """Say what the signal is compared with at an instant, in its unit.

        Parameters
        ----------
        signals : Signals
        k : int
            Which instant.

        Returns
        -------
        str
            ``"1.389 m/s (5 km/h)"``, or ``"other.speed, which is 3 m/s"``.
        """
        if isinstance(self.right, Signal):
            return f"{self.right.text}, which is {self.left.tell_value(float(self.right.values(signals)[k]))}"
        value, written = self.left.tell_value(self.right.value), self.right.text
        return value if value.startswith(written) else f"{value} ({written})"

    def margin(self, signals: Signals) -> FloatArray:
        """How far it holds at each instant.

        Parameters
        ----------
        signals : Signals

        Returns
        -------
        ndarray of float64, shape (T,)
            In the unit of the signals: positive where it holds, negative where it does not, 0 at the bound; NaN where
            a signal is not defined.
        """
        left = self.left.values(signals)
        right = self.right.values(signals) if isinstance(self.right, Signal) else np.full_like(left, self.right.value)
        # Where both are infinite their difference would be undefined, though they are equal.
        same = left == right
        gap = np.where(same, 0.0, left - np.where(same, 0.0, right))
        return np.asarray(gap if self.relation in (">", ">=") else 0.0 - gap)

    def holds(self, signals: Signals) -> FloatArray:
        """Whether it holds at each instant.

        Parameters
        ----------
        signals : Signals

        Returns
        -------
        ndarray of float64, shape (T,)
            1 where it does, -1 where it does not, NaN where a signal is not defined.
        """
        margin = self.margin(signals)
        reached = margin >= 0.0 if self.relation in ("<=", ">=") else margin > 0.0
        return np.where(np.isnan(margin), np.nan, np.where(reached, 1.0, -1.0))


@dataclass(frozen=True)
class Operation:
    """An operator and what it stands before or between.

    Attributes
    ----------
    operator : {"not", "and", "or", "->", "always", "eventually", "until"}
    operands : tuple of Predicate or Operation
    interval : tuple of two float, optional
        Begin and end in s, of temporal operators; inf for the end of the recording. None without an interval.
    """

    operator: Operator
    operands: tuple[Node, ...]
    interval: tuple[float, float] | None = None

    @property
    def text(self) -> str:
        """As it is written, with a bracket around each operation in it."""
        name: str = self.operator
        if self.interval is not None:
            begin, end = self.interval
            name += f"[{begin:.15g}:{'' if end == np.inf else f'{end:.15g}'}]"
        if len(self.operands) == 1:
            return f"{name}({self.operands[0].text})"
        inner = (one.text if isinstance(one, Predicate) or _alone(one) else f"({one.text})" for one in self.operands)
        return f" {name} ".join(inner)


Node: TypeAlias = Predicate | Operation


def comparisons_in(node: Node) -> Iterator[Predicate]:
    """Go through the comparisons, from left to right.

    Parameters
    ----------
    node : Predicate or Operation

    Yields
    ------
    Predicate
    """
    if isinstance(node, Predicate):
        yield node
        return
    for operand in node.operands:
        yield from comparisons_in(operand)


def is_temporal(node: Node) -> bool:
    """Whether a temporal operator stands in it.

    Parameters
    ----------
    node : Predicate or Operation

    Returns
    -------
    bool
    """
    return isinstance(node, Operation) and (node.operator in TEMPORAL or any(map(is_temporal, node.operands)))


def _alone(node: Node) -> bool:
    return isinstance(node, Operation) and len(node.operands) == 1
