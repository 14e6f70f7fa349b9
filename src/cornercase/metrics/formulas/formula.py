"""Formulas of signal temporal logic over what was recorded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray
from cornercase.metrics.formulas.deciding import find_decisive
from cornercase.metrics.formulas.parser import parse
from cornercase.metrics.formulas.robustness import follow
from cornercase.metrics.formulas.signals import Signals, is_metric
from cornercase.metrics.formulas.temporal import require_rtamt
from cornercase.metrics.formulas.terms import Node, Predicate, comparisons_in, is_temporal
from cornercase.metrics.formulas.units import spelt


@dataclass(frozen=True)
class Formula:
    """A formula of signal temporal logic in discrete time.

    A comparison that stands in no temporal operator has to hold all the time, by itself or in a conjunction.
    Docs: "Formulas" in docs/metrics.md.

    Attributes
    ----------
    root : Predicate or Operation
        What it is made of; `Formula.parse` makes it.

    See Also
    --------
    cornercase.metrics.signals_of : What it is told of a recording.

    Examples
    --------
    >>> import numpy as np
    >>> from cornercase.metrics import Formula, Signals
    >>> formula = Formula.parse("ttc>1.5s and ego.speed <= 50 km/h")
    >>> print(formula)
    ttc > 1.5 s and ego.speed <= 50 km/h
    >>> formula.metrics
    ('ttc',)
    >>> values = {"ttc": np.array([9.0, 2.0, 4.0]), "ego.speed": np.array([5.0, 5.0, 5.0])}
    >>> formula.robustness(Signals(np.array([0.0, 0.1, 0.2]), values))
    array([0.5, 0.5, 2.5])
    """

    root: Node

    @classmethod
    def parse(cls, text: str) -> Formula:
        """Read a formula.

        Parameters
        ----------
        text : str
            Such as ``"always[0:5] (clearance > 0.5 or ego.speed < 1 km/h)"``.

        Returns
        -------
        Formula

        Raises
        ------
        InputError
            It is none; the message names the place and what helps.
        """
        root = parse(text)
        # What is stored is the other way of writing, which has all brackets.
        parse(root.text)
        return cls(root)

    def __str__(self) -> str:
        return self.text

    @property
    def text(self) -> str:
        """As it is written, with one way of writing for all formulas that say the same in the same order."""
        return self.root.text

    @property
    def comparisons(self) -> tuple[Predicate, ...]:
        """Comparisons in it, from left to right."""
        return tuple(comparisons_in(self.root))

    @property
    def bound(self) -> Predicate | None:
        """The comparison that it is, where it is one alone."""
        return self.root if isinstance(self.root, Predicate) else None

    @property
    def metrics(self) -> tuple[str, ...]:
        """Names of the metrics that it looks at, with their options."""
        names = [signal.name for one in self.comparisons for signal in one.signals]
        return tuple(dict.fromkeys(filter(is_metric, names)))

    @property
    def unit(self) -> str:
        """Unit that all its comparisons are in; ``"1"`` where they are in several."""
        units = {spelt(one.left.unit) for one in self.comparisons}
        return self.comparisons[0].left.unit if len(units) == 1 else "1"

    @property
    def temporal(self) -> bool:
        """Whether it has a temporal operator, so that the extra ``stl`` is needed."""
        return is_temporal(self.root)

    def require(self) -> None:
        """Refuse to go on where something is not installed that the formula needs.

        Raises
        ------
        InputError
            It has a temporal operator, and the extra ``stl`` is not installed.
        """
        if self.temporal:
            require_rtamt()

    def robustness(self, signals: Signals) -> FloatArray:
        """Say how far it holds from each instant on.

        Parameters
        ----------
        signals : Signals

        Returns
        -------
        ndarray of float64, shape (T,)
            Positive where it holds, negative where it is violated, in `unit`: by so much every comparison can change
            at every instant before the answer does. inf where nothing can violate it, -inf where nothing can fulfil it.

        Raises
        ------
        InputError
            It has a temporal operator, and the extra ``stl`` is not installed.
        """
        return follow(self.root, {one: one.margin(signals) for one in self.comparisons}, signals.time)

    def holds(self, signals: Signals) -> BoolArray:
        """Say whether it holds from each instant on; at a bound itself this tells ``<`` from ``<=``.

        Parameters
        ----------
        signals : Signals

        Returns
        -------
        ndarray of bool, shape (T,)

        Raises
        ------
        InputError
            It has a temporal operator, and the extra ``stl`` is not installed.
        """
        return follow(self.root, {one: one.holds(signals) for one in self.comparisons}, signals.time) > 0.0

    def holds_at_each(self, signals: Signals) -> BoolArray:
        """Say whether it holds at each instant, without asking that it does all the time.

        Parameters
        ----------
        signals : Signals

        Returns
        -------
        ndarray of bool, shape (T,)
            True where a formula without temporal operators is not defined, as nothing is violated there.

        Raises
        ------
        InputError
            It has a temporal operator, and the extra ``stl`` is not installed.
        """
        held = {one: one.holds(signals) for one in self.comparisons}
        return follow(self.root, held, signals.time, for_good=False) > 0.0

    def decisive(self, signals: Signals) -> tuple[Predicate, int] | None:
        """Find which comparison, at which instant, decides whether it holds from the first instant on.

        Parameters
        ----------
        signals : Signals

        Returns
        -------
        tuple of Predicate and int, or None
            The margin there is the robustness, or behind a ``not`` its negative. None where the robustness is infinite.

        Raises
        ------
        InputError
            It has a temporal operator, and the extra ``stl`` is not installed.
        """
        return find_decisive(self.root, {one: one.margin(signals) for one in self.comparisons}, signals.time)

    def observed(self, signals: Signals) -> bool:
        """Whether each of its comparisons was defined at some instant.

        Parameters
        ----------
        signals : Signals

        Returns
        -------
        bool
        """
        return all(not np.isnan(one.margin(signals)).all() for one in self.comparisons)
