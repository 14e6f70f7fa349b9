"""Metric that says how far a run is from fulfilling a condition that defines critical scenarios."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray
from cornercase.metrics._base import Metric
from cornercase.metrics._distance import Clearance
from cornercase.metrics._evaluation import Evaluation, evaluate_run
from cornercase.metrics._expression import DEFAULT_CAP, Expression
from cornercase.metrics._registry import METRICS
from cornercase.metrics.expressions._ast import EgoCollides
from cornercase.metrics.expressions._recorded_signals import (
    CONDITION_METRIC,
    SCORE_PREFIX,
    Signals,
    signals_from_recording,
)
from cornercase.recordings import Recording

# Score of a run that is exactly at a bound of the condition, but does not fulfil the condition.
_EPSILON: Final = 1e-9


class CriticalIf(Metric):
    """Distance of a run from fulfilling a condition, such as ``collision and not reference:cc-human``.

    A condition combines collisions, bounds on metrics, and reference drivers (``reference:NAME``: the ego would collide
    if this driver drove it). A bound refers to the score of its metric, unless a temporal operator says when the bound
    has to hold.

    The score of a run is 0 or below if the condition holds. Otherwise the score is the robustness with the opposite
    sign. For ``and``, the part that is farthest from holding counts; for ``or``, the nearest part. The distance of a
    collision is the clearance to the other entity. The distance of a bound is the difference between score and bound. A
    reference driver has no distance: if reference drivers alone decide that the condition does not hold, the score is
    the cap. The course is the distance from holding at each instant, assuming that reference drivers decide in favour
    of the condition. With several other entities, a bound with a temporal operator has to hold against one of them.

    The metric is computed by ``cornercase explore --critical-if``, which runs the reference drivers. It cannot be
    measured on a recording alone. The cap is the largest distance that a part can have; it is 100 for a collision, and
    if no part has a distance. The most critical value is minus the cap, or -100 if that is lower.

    Source: UN Regulation No. 157, Annex 4, Appendix 3, by which a collision is preventable if a reference driver
    prevents it; distances are combined as in G. E. Fainekos, G. J. Pappas, "Robustness of temporal logic specifications
    for continuous-time signals", Theoretical Computer Science 410 (2009).

    Parameters
    ----------
    condition : str, default "collision"
        Text behind the colon of the name, as in ``"critical-if:collision and not reference:cc-human"``.

    Examples
    --------
    >>> import cornercase as cc
    >>> metric = cc.metrics.CriticalIf.from_text("ttc<0.5 and not reference:cc-human")
    >>> metric.name, metric.reference_drivers
    ('critical-if:ttc < 0.5 and not reference:cc-human', ('cc-human',))

    Searches take the condition as text:

    >>> folder = "examples/suite/scenario/cut_in"
    >>> scenario = cc.LogicalScenario.read(f"{folder}.xosc", f"{folder}.space.xosc")
    >>> condition = "collision and not reference:cc-human"
    >>> cc.Problem(scenario, ego="Ego", other="Other", metrics=["ttc"], condition=condition)
    <Problem 'cut_in': Ego and Other, critical if collision and not reference:cc-human>
    """

    name = CONDITION_METRIC
    unit = "1"
    lower_is_critical = True
    cap = DEFAULT_CAP
    default_threshold = 0.0
    required_option = "CONDITION"
    source = "UN Regulation No. 157, Fainekos and Pappas 2009"

    def __init__(self, condition: str = "collision", /) -> None:
        self.condition = Expression.parse(condition, "condition")
        self.unit = self.condition.unit
        # A bound that equals its metric's cap can be 0 from holding, which would leave no range.
        self.cap = self.condition.cap or DEFAULT_CAP
        self.bound = -max(self.cap, DEFAULT_CAP)

    @classmethod
    def from_text(cls, condition: str) -> CriticalIf:
        """Create the metric of a condition; the name of the metric has the condition in its normalized spelling.

        Parameters
        ----------
        condition : str

        Returns
        -------
        CriticalIf

        Raises
        ------
        InputError
            The condition cannot be parsed.
        """
        metric = cls(condition)
        metric.name = f"{CONDITION_METRIC}:{metric.condition.text}"
        return metric

    @property
    def reference_drivers(self) -> tuple[str, ...]:
        """Names of the reference drivers in the condition."""
        return self.condition.reference_drivers

    def check_installed(self) -> None:
        raise InputError(
            f"The metric '{self.name}' cannot be given as a metric; give the condition to a search as `critical_if`,"
            " which adds this metric, or measure a formula with the metric 'stl:…'."
        )

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        # At each instant, the course takes the place of the score.
        parts = {name: METRICS.create(name) for name in self.condition.metrics}
        courses = {name: metric.course(recording, ego, other) for name, metric in parts.items()}
        scores = {f"{SCORE_PREFIX}{name})": parts[name].clip_course(course) for name, course in courses.items()}
        signals = signals_from_recording(recording, ego, other, courses)
        # Some signals are computed on first access only.
        names = {signal.name for bound in self.condition.bounds for signal in bound.signals} | courses.keys()
        values = {name: signals.values[name] for name in names - scores.keys()} | scores
        signals = Signals(recording.time, values, recording, ego, (other,))
        distance = 0.0 - Evaluation.from_signals(self.condition.root, signals).robustness_at_instants()
        defined = [~np.isnan(course) for course in courses.values()]
        if any(isinstance(leaf, EgoCollides) for leaf in self.condition.leaves):
            defined.append(~np.isnan(Clearance().course(recording, ego, other)))
        is_defined = np.logical_or.reduce(defined) if defined else True
        return np.asarray(np.where(is_defined, distance, np.nan))

    def evaluate(self, recording: Recording, ego: str, other: str | Sequence[str]) -> ConditionState:
        """Evaluate the parts of the condition that need no reference driver.

        Parameters
        ----------
        recording : Recording
        ego : str
            Name of an entity.
        other : str or sequence of str
            Names of one or several other entities. If there are several, the nearest counts for a collision, and the
            most critical score for a metric.

        Returns
        -------
        ConditionState

        Raises
        ------
        InputError
            There is no entity of that name.
        """
        return ConditionState(self, tuple(evaluate_run(self.condition.root, recording, ego, other).values()))


@dataclass(frozen=True, eq=False)
class ConditionState:
    """State of a condition for one run, before reference drivers are run.

    `evaluations` holds the evaluation of the condition against each other entity. The methods take `outcomes`, which
    map the name of a reference driver to whether the driver collides: None if the driver does not apply to the
    scenario. Drivers that were not run are missing in `outcomes`.
    """

    metric: CriticalIf
    evaluations: tuple[Evaluation, ...]

    def next_reference_to_run(self, outcomes: Mapping[str, bool | None]) -> str | None:
        """Return the name of the reference driver to run next.

        None if the condition is decided, or if all its reference drivers have been run.
        """
        if self.is_fulfilled(outcomes) is not None:
            return None
        pending = [name for name in self.metric.reference_drivers if name not in outcomes]
        decisive = (
            name
            for name in pending
            if self.is_fulfilled({**outcomes, name: True}) != self.is_fulfilled({**outcomes, name: False})
        )
        return next(decisive, pending[0] if pending else None)

    def is_fulfilled(self, outcomes: Mapping[str, bool | None]) -> bool | None:
        """Return whether the condition holds; None if the run and the given outcomes do not show this."""
        states = [evaluation.with_references(outcomes).is_fulfilled() for evaluation in self.evaluations]
        return True if True in states else None if None in states else False

    def score(self, outcomes: Mapping[str, bool | None]) -> float:
        """Return the score of the run: 0 or below if the condition holds, above 0 if not, the cap if undecided."""
        holds = self.is_fulfilled(outcomes)
        if holds is None:
            return self.metric.cap
        evaluations = [evaluation.with_references(outcomes) for evaluation in self.evaluations]
        # Unknown statements count against the verdict.
        assumed = -np.inf if holds else np.inf
        distance = 0.0 - max(float(evaluation.robustness(assumed)[0]) for evaluation in evaluations)
        value = min(distance, 0.0) if holds else max(distance, _EPSILON)
        return float(np.clip(value, self.metric.bound, self.metric.cap))


def find_critical_if_condition(metrics: Iterable[str]) -> str:
    """Return the condition of the metric ``critical-if:CONDITION`` in a list of metrics; empty without this metric."""
    parts = (metric.partition(":") for metric in metrics)
    return next((text for name, _, text in parts if name == CONDITION_METRIC), "")
