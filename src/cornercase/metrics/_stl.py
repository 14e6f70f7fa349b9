"""Metric of the robustness of a formula of signal temporal logic (STL)."""

from __future__ import annotations

from collections.abc import Iterator

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray
from cornercase.metrics._base import Metric
from cornercase.metrics._evaluation import Evaluation
from cornercase.metrics._expression import DEFAULT_CAP, Expression
from cornercase.metrics._registry import METRICS
from cornercase.metrics.expressions._ast import Bound, Signal
from cornercase.metrics.expressions._recorded_signals import signals_from_recording
from cornercase.recordings import Recording


class Stl(Metric):
    """Robustness of a formula of signal temporal logic: positive if it holds, negative if it is violated.

    The course is the robustness from each instant on; the score is the robustness at the first instant. The unit is
    the common unit of all parts of the formula, or 1 if they have several units. 0 is exactly at the limit, where the
    formula may hold or be violated: ``clearance > 0`` at a contact. Not defined (NaN at all instants) if the formula
    has a bound and no part of it was ever defined, or if the result depends on something that the run does not show,
    such as the lanes if the roads are unknown.

    Each part of the formula has a cap, and the largest of these is the cap of the metric. If a part compares a metric
    with a number, its cap is the distance of the number from the cap of that metric. So ``stl:always(clearance > 0.5)``
    scores the ``clearance`` less 0.5. Every other part has the cap 100. The most critical value is -100, or lower if a
    number is more than 100 away from the `bound` of its metric. Metrics without `bound`, such as the ``clearance``, do
    not count.

    Source: G. E. Fainekos, G. J. Pappas, "Robustness of temporal logic specifications for continuous-time signals",
    Theoretical Computer Science 410 (2009); A. Donzé, O. Maler, "Robust satisfaction of temporal logic over real-valued
    signals", FORMATS (2010).

    Parameters
    ----------
    formula : str, default "clearance > 0"
        Text behind the colon of the name, as in ``"stl:always[0:5](ttc > 1.5)"``, in the language of
        `cornercase.metrics.Expression`.

    Raises
    ------
    InputError
        The text is no expression, or it needs a run with a reference driver.

    Examples
    --------
    >>> import cornercase as cc
    >>> recording = cc.simulate("examples/x_intersection/x_intersection.xosc")
    >>> cc.measure(recording, "Ego", "Pedestrian", [cc.metrics.Stl("always(clearance > 2 m)")])
    metric                       score  unit  critical is
    stl:always(clearance > 2 m)  4.023  m     low
    """

    name = "stl"
    unit = "1"
    lower_is_critical = True
    cap = DEFAULT_CAP
    default_threshold = 0.0
    required_option = "FORMULA"
    source = "Fainekos and Pappas 2009, Donzé and Maler 2010"

    def __init__(self, formula: str = "clearance > 0", /) -> None:
        self.formula = Expression.parse(formula)
        if references := self.formula.reference_drivers:
            raise InputError(
                f"The formula '{self.formula}' needs a run with the driver {references[0]}, but a metric cannot"
                " run a scenario; use the formula in `critical_if` or `require`."
            )
        self.unit, self.cap = self.formula.unit, self.formula.cap
        self.bound = -max(
            DEFAULT_CAP, *(gap for bound in self.formula.bounds for gap in _distance_to_metric_bound(bound)), 0.0
        )

    def check_installed(self) -> None:
        self.formula.check_installed()

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        signals = signals_from_recording(recording, ego, other)
        return Evaluation.from_signals(self.formula.root, signals).robustness_if_known()

    def score(self, course: FloatArray) -> float:
        return float(self.clip_course(course[:1])[0])


def _distance_to_metric_bound(bound: Bound) -> Iterator[float]:
    if not isinstance(bound.right, Signal) and bound.left.metric:
        worst = METRICS.create(bound.left.metric).bound
        if worst is not None:
            yield abs(worst - bound.right)
