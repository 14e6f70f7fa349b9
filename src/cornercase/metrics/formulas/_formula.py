"""Formulas of signal temporal logic over recorded signals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray
from cornercase.metrics.formulas._ast import Comparison, Node, has_temporal_operator, iter_comparisons
from cornercase.metrics.formulas._explain import find_decisive_comparison
from cornercase.metrics.formulas._formula_parser import parse_formula
from cornercase.metrics.formulas._operators import require_rtamt
from cornercase.metrics.formulas._robustness import compute_robustness
from cornercase.metrics.formulas._signals import Signals, is_metric_signal
from cornercase.metrics.formulas._units import normalize_unit


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
    cornercase.metrics.signals_from_recording : Signals of a recording.

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
        root = parse_formula(text)
        # The normalized text, which has all brackets, is stored; check that it can be parsed again.
        parse_formula(root.text)
        return cls(root)

    def __str__(self) -> str:
        return self.text

    @property
    def text(self) -> str:
        """Normalized spelling, equal for formulas that differ in spelling only."""
        return self.root.text

    @property
    def comparisons(self) -> tuple[Comparison, ...]:
        """Its comparisons, from left to right."""
        return tuple(iter_comparisons(self.root))

    @property
    def single_comparison(self) -> Comparison | None:
        """The comparison, if the formula is a single one."""
        return self.root if isinstance(self.root, Comparison) else None

    @property
    def metrics(self) -> tuple[str, ...]:
        """Names of the metrics in it, with their options."""
        names = [signal.name for comparison in self.comparisons for signal in comparison.signals]
        return tuple(dict.fromkeys(filter(is_metric_signal, names)))

    @property
    def unit(self) -> str:
        """Unit of all its comparisons; ``"1"`` if they have several."""
        units = {normalize_unit(comparison.left.unit) for comparison in self.comparisons}
        return self.comparisons[0].left.unit if len(units) == 1 else "1"

    @property
    def is_temporal(self) -> bool:
        """Whether it has a temporal operator, so that the extra ``stl`` is required."""
        return has_temporal_operator(self.root)

    def check_installed(self) -> None:
        """Raise if a package that the formula requires is not installed."""
        if self.is_temporal:
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
        return compute_robustness(
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
            compute_robustness(
                self.root,
                {comparison: comparison.truth_values(signals) for comparison in self.comparisons},
                signals.time,
            )
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
        held = {comparison: comparison.truth_values(signals) for comparison in self.comparisons}
        return compute_robustness(self.root, held, signals.time, implicit_always=False) > 0.0

    def find_decisive_comparison(self, signals: Signals) -> tuple[Comparison, int] | None:
        """Comparison and instant that decide whether it holds from the first instant on.

        Parameters
        ----------
        signals : Signals

        Returns
        -------
        tuple of Predicate and int, or None
            The margin there is the robustness, or inside a ``not`` its negative. None if the robustness is infinite.
        """
        return find_decisive_comparison(
            self.root, {comparison: comparison.margin(signals) for comparison in self.comparisons}, signals.time
        )

    def is_defined(self, signals: Signals) -> bool:
        """Whether each of its comparisons was defined at some instant.

        Parameters
        ----------
        signals : Signals

        Returns
        -------
        bool
        """
        return all(not np.isnan(comparison.margin(signals)).all() for comparison in self.comparisons)
