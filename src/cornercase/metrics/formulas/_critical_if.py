"""Metric of a condition that defines which scenarios are critical."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray
from cornercase.metrics._base import Metric
from cornercase.metrics._distance import Clearance
from cornercase.metrics._measure import evaluate_metrics
from cornercase.metrics._registry import METRICS
from cornercase.metrics.formulas._condition_ast import (
    Collision,
    Condition,
    DistanceRange,
    ReferenceCollides,
    ScoreComparison,
    Statement,
    evaluate_distance,
    evaluate_truth,
    iter_statements,
)
from cornercase.metrics.formulas._condition_parser import parse_condition
from cornercase.metrics.formulas._signals import CONDITION_METRIC
from cornercase.metrics.formulas._units import normalize_unit
from cornercase.recordings import Recording

_DEFAULT_CAP: Final = 100.0
# Score of a run that is exactly at the bound, though the condition does not hold.
_EPSILON: Final = 1e-9
_UNKNOWN: Final = DistanceRange(-np.inf, np.inf)


class CriticalIf(Metric):
    """How far a run is from fulfilling a condition on collisions, scores, and what a reference driver prevents.

    The score is 0 or below if the condition holds. For ``and`` the part counts that is farthest from holding, for
    ``or`` the nearest. The distance of a collision is the clearance to the other entity, that of a bound the difference
    of score and bound. A reference has no distance, so if it alone decides, and decides against, the score is the cap.
    The course is the distance from holding at each instant, assuming that references decide for it.

    Searched by ``cornercase explore --critical-if``, which runs the references; a recording alone cannot be measured.
    Cap: the farthest that a part can be from holding; 100 for a collision, and if no part can be far. Most critical
    value: the same below 0, -100 at least.

    Source: UN Regulation No. 157, Annex 4, Appendix 3, where preventable is what a reference driver prevents; distances
    are combined as in G. E. Fainekos, G. J. Pappas, "Robustness of temporal logic specifications for continuous-time
    signals", Theoretical Computer Science 410 (2009).

    Parameters
    ----------
    condition : str, default "collision"
        Everything behind the colon: ``"critical-if:collision and not reference:cc-human"``.
    """

    name = CONDITION_METRIC
    unit = "1"
    lower_is_critical = True
    cap = _DEFAULT_CAP
    default_threshold = 0.0
    required_option = "CONDITION"
    source = "UN Regulation No. 157, Fainekos and Pappas 2009"

    def __init__(self, condition: str = "collision", /) -> None:
        self.condition: Condition = parse_condition(condition)
        self._facts = tuple(dict.fromkeys(iter_statements(self.condition)))
        bounds = [fact for fact in self._facts if isinstance(fact, ScoreComparison)]
        self._parts: dict[Statement, Metric] = {bound: METRICS.create(bound.metric) for bound in bounds}
        if Collision() in self._facts:
            self._parts[Collision()] = Clearance()
        units = {normalize_unit(metric.unit) for metric in self._parts.values()}
        self.unit = next(iter(self._parts.values())).unit if len(units) == 1 else "1"
        margins = [abs(bound.distance_from_holding(self._parts[bound].cap)) for bound in bounds]
        # The margin of a bound that equals its metric's cap is 0, which would leave no range.
        if Collision() in self._facts or not any(margins):
            margins.append(_DEFAULT_CAP)
        self.cap = max(margins)
        self.bound = -max(self.cap, _DEFAULT_CAP)

    @classmethod
    def from_text(cls, condition: str) -> CriticalIf:
        """Create the metric of a condition, with the normalized text as name, whatever the spelling.

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
        return tuple(fact.driver for fact in self._facts if isinstance(fact, ReferenceCollides))

    def check_installed(self) -> None:
        raise InputError(
            f"The metric '{self.name}' needs runs of reference drivers, which only `explore` makes; pass its condition"
            " to `explore` with `critical_if`."
        )

    def check_parts_installed(self) -> None:
        """Raise if a package that a metric of the condition requires is not installed."""
        for metric in self._parts.values():
            metric.check_installed()

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        spans: dict[Statement, DistanceRange] = dict.fromkeys(self._facts, _UNKNOWN)
        defined = np.full(recording.time.shape, not self._parts)
        for fact, metric in self._parts.items():
            course = metric.course(recording, ego, other)
            defined |= ~np.isnan(course)
            margin = metric.clip_course(course)
            if isinstance(fact, ScoreComparison):
                margin = fact.distance_from_holding(margin)
            else:
                for time in _collision_times(recording, ego):
                    margin[int(np.abs(recording.time - time).argmin())] = 0.0
            spans[fact] = DistanceRange(margin, margin)
        low = evaluate_distance(self.condition, spans).low
        return np.asarray(np.where(defined, np.broadcast_to(low, recording.time.shape), np.nan))

    def evaluate(self, recording: Recording, ego: str, other: str | Sequence[str]) -> ConditionState:
        """Evaluate the parts of the condition that need no reference driver.

        Parameters
        ----------
        recording : Recording
        ego : str
            Name of an entity.
        other : str or sequence of str
            Names of one or several others; of several the nearest counts, and the worst score.

        Returns
        -------
        ConditionState

        Raises
        ------
        InputError
            There is no entity of that name.
        """
        scores = evaluate_metrics(dict.fromkeys(self._parts.values()), recording, ego, other)
        truths: dict[Statement, bool] = {}
        spans: dict[Statement, DistanceRange] = {}
        for fact, metric in self._parts.items():
            score = scores[metric.name].score
            if isinstance(fact, ScoreComparison):
                truths[fact], margin = fact.is_fulfilled_by(score), fact.distance_from_holding(score)
            else:
                truths[fact] = any(True for _ in _collision_times(recording, ego))
                margin = 0.0 if truths[fact] else score
            spans[fact] = DistanceRange(margin, margin)
        return ConditionState(self, truths, spans)


@dataclass(frozen=True, eq=False)
class ConditionState:
    """State of a condition for one run: the parts that the run itself decides, before references are run.

    `truths` and `spans` are by `Collision` or `ScoreComparison`. `outcomes` of the methods map the name of a
    reference to whether it collides: None if it does not apply to the scenario, missing if it was not run.
    """

    metric: CriticalIf
    truths: Mapping[Statement, bool]
    spans: Mapping[Statement, DistanceRange]

    def next_reference_to_run(self, outcomes: Mapping[str, bool | None]) -> str | None:
        """Name of the reference to run next; None if the condition is decided, or no reference could decide it."""
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
        """Whether the condition holds; None if that depends on a reference that was not run or does not apply."""
        truths = dict.fromkeys(self.metric._facts) | dict(self.truths)
        truths |= {ReferenceCollides(name): collides for name, collides in outcomes.items()}
        return evaluate_truth(self.metric.condition, truths)

    def score(self, outcomes: Mapping[str, bool | None]) -> float:
        """Score of the run: 0 or below if the condition holds, above if not, the cap if it cannot be decided."""
        holds = self.is_fulfilled(outcomes)
        spans = dict.fromkeys(self.metric._facts, _UNKNOWN) | dict(self.spans)
        for name, collides in outcomes.items():
            if collides is not None:
                distance = -np.inf if collides else np.inf
                spans[ReferenceCollides(name)] = DistanceRange(distance, distance)
        low, high = evaluate_distance(self.metric.condition, spans)
        if holds is None:
            return self.metric.cap
        value = min(float(high), 0.0) if holds else max(float(low), _EPSILON)
        return float(np.clip(value, self.metric.bound, self.metric.cap))


def find_critical_if_condition(metrics: Iterable[str]) -> str:
    """Condition among the metrics of a study that defines what is critical; empty if there is none."""
    parts = (metric.partition(":") for metric in metrics)
    return next((text for name, _, text in parts if name == CONDITION_METRIC), "")


def _collision_times(recording: Recording, ego: str) -> Iterable[float]:
    """Times in s at which the ego collides with any entity."""
    return (collision.time for collision in recording.collisions if ego in collision.entities)
