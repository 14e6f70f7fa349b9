"""Robustness of a formula of signal temporal logic (STL)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.metrics._base import Metric
from cornercase.metrics._registry import METRICS
from cornercase.metrics.formulas._ast import Comparison, Constant
from cornercase.metrics.formulas._formula import Formula
from cornercase.metrics.formulas._signals import is_metric_signal, signals_from_recording
from cornercase.recordings import Recording

_DEFAULT_CAP: Final = 100.0


class Stl(Metric):
    """Robustness of a formula of signal temporal logic: positive if it holds, negative if it is violated.

    The course is the robustness from each instant on, the score that at the first instant. The unit is that of the
    formula's comparisons, and 1 if they have several. Not defined (NaN throughout) if no comparison was ever defined.

    Cap: for a comparison of a metric with a number, how far the number is from the metric's own cap, so that
    ``stl:always(clearance > 0.5)`` scores the ``clearance`` less 0.5; for any other comparison 100; of several the
    largest. Most critical value: -100, or how far a number is beyond the most critical value of the metric that it is
    compared with, if that is more.

    Source: G. E. Fainekos, G. J. Pappas, "Robustness of temporal logic specifications for continuous-time signals",
    Theoretical Computer Science 410 (2009); A. Donzé, O. Maler, "Robust satisfaction of temporal logic over real-valued
    signals", FORMATS (2010); temporal operators by RTAMT (D. Ničković, T. Yamaguchi, ATVA 2020).

    Parameters
    ----------
    formula : str, default "clearance > 0"
        Everything behind the colon: ``"stl:always[0:5](ttc > 1.5)"``. Its language is that of
        `cornercase.metrics.Formula`.
    """

    name = "stl"
    unit = "1"
    lower_is_critical = True
    cap = _DEFAULT_CAP
    default_threshold = 0.0
    required_option = "FORMULA"
    source = "Fainekos and Pappas 2009, Donzé and Maler 2010"

    def __init__(self, formula: str = "clearance > 0", /) -> None:
        self.formula = Formula.parse(formula)
        self.unit = self.formula.unit
        comparisons = self.formula.comparisons
        self.cap = max(map(_cap_of_comparison, comparisons))
        self.bound = -max(
            _DEFAULT_CAP, *(gap for comparison in comparisons for gap in _distance_to_metric_bound(comparison)), 0.0
        )

    def check_installed(self) -> None:
        self.formula.check_installed()

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        signals = signals_from_recording(recording, ego, other)
        if all(np.isnan(comparison.margin(signals)).all() for comparison in self.formula.comparisons):
            return np.full(len(signals.time), np.nan)
        return self.formula.robustness(signals)

    def score(self, course: FloatArray) -> float:
        return float(self.clip_course(course[:1])[0])


def _cap_of_comparison(comparison: Comparison) -> float:
    name, limit = comparison.left.name, comparison.right
    if not isinstance(limit, Constant) or not is_metric_signal(name):
        return _DEFAULT_CAP
    return abs(METRICS.create(name).cap - limit.value)


def _distance_to_metric_bound(comparison: Comparison) -> Iterator[float]:
    name, limit = comparison.left.name, comparison.right
    if isinstance(limit, Constant) and is_metric_signal(name):
        worst = METRICS.create(name).bound
        if worst is not None:
            yield abs(worst - limit.value)
