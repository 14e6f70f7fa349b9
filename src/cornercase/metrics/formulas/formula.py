"""Formulas of signal temporal logic over recorded signals."""

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

    A comparison outside of temporal operators, by itself or in a conjunction, has to hold all the time. The language is
    described under "Formulas" in docs/metrics.md. Methods of a formula with a temporal operator raise `InputError` if
    the extra ``stl`` is not installed.

    Attributes
    ----------
    root : Predicate or Operation
        Root of the syntax tree; created by `Formula.parse`.

    See Also
    --------
    cornercase.metrics.signals_of : Signals of a recording.

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
        """Parse a formula.

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
            The text is no formula; the message names the position and what to write there.
        """
        root = parse(text)
        # The normalized text, which has all brackets, is stored; check that it can be parsed again.
        parse(root.text)
        return cls(root)

    def __str__(self) -> str:
        return self.text

    @property
    def text(self) -> str:
        """Normalized spelling, equal for formulas that differ in spelling only."""
        return self.root.text

    @property
    def comparisons(self) -> tuple[Predicate, ...]:
        """Its comparisons, from left to right."""
        return tuple(comparisons_in(self.root))

    @property
    def bound(self) -> Predicate | None:
        """The comparison, if the formula is a single one."""
        return self.root if isinstance(self.root, Predicate) else None

    @property
    def metrics(self) -> tuple[str, ...]:
        """Names of the metrics in it, with their options."""
        names = [signal.name for comparison in self.comparisons for signal in comparison.signals]
        return tuple(dict.fromkeys(filter(is_metric, names)))

    @property
    def unit(self) -> str:
        """Unit of all its comparisons; ``"1"`` if they have several."""
        units = {spelt(comparison.left.unit) for comparison in self.comparisons}
        return self.comparisons[0].left.unit if len(units) == 1 else "1"

    @property
    def temporal(self) -> bool:
        """Whether it has a temporal operator, so that the extra ``stl`` is required."""
        return is_temporal(self.root)

    def require(self) -> None:
        """Raise if a package that the formula requires is not installed."""
        if self.temporal:
            require_rtamt()

    def robustness(self, signals: Signals) -> FloatArray:
        """Robustness from each instant on.

        Parameters
        ----------
        signals : Signals

        Returns
        -------
        ndarray of float64, shape (T,)
            Positive if the formula holds, negative if it is violated, in `unit`: every comparison can change by this
            amount at every instant before the verdict changes. inf if nothing can violate it, -inf if nothing can
            fulfil it.
        """
        return follow(
            self.root, {comparison: comparison.margin(signals) for comparison in self.comparisons}, signals.time
        )

    def holds(self, signals: Signals) -> BoolArray:
        """Whether it holds from each instant on. Unlike the sign of `robustness`, this distinguishes ``<`` from ``<=``.

        Parameters
        ----------
        signals : Signals

        Returns
        -------
        ndarray of bool, shape (T,)
        """
        return (
            follow(self.root, {comparison: comparison.holds(signals) for comparison in self.comparisons}, signals.time)
            > 0.0
        )

    def holds_at_each(self, signals: Signals) -> BoolArray:
        """Whether it holds at each instant, without requiring that comparisons hold all the time.

        Parameters
        ----------
        signals : Signals

        Returns
        -------
        ndarray of bool, shape (T,)
            True where a formula without temporal operators is not defined, since nothing is violated there.
        """
        held = {comparison: comparison.holds(signals) for comparison in self.comparisons}
        return follow(self.root, held, signals.time, for_good=False) > 0.0

    def decisive(self, signals: Signals) -> tuple[Predicate, int] | None:
        """Comparison and instant that decide whether it holds from the first instant on.

        Parameters
        ----------
        signals : Signals

        Returns
        -------
        tuple of Predicate and int, or None
            The margin there is the robustness, or inside a ``not`` its negative. None if the robustness is infinite.
        """
        return find_decisive(
            self.root, {comparison: comparison.margin(signals) for comparison in self.comparisons}, signals.time
        )

    def observed(self, signals: Signals) -> bool:
        """Whether each of its comparisons was defined at some instant.

        Parameters
        ----------
        signals : Signals

        Returns
        -------
        bool
        """
        return all(not np.isnan(comparison.margin(signals)).all() for comparison in self.comparisons)
