"""The metric of a condition that says which scenarios are critical."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray
from cornercase.metrics.base import Metric
from cornercase.metrics.conditions.parser import parse
from cornercase.metrics.conditions.terms import (
    Collision,
    Fact,
    Part,
    ReferenceCollides,
    ScoreBound,
    Span,
    facts_in,
    span_of,
    truth_of,
)
from cornercase.metrics.distance import Clearance
from cornercase.metrics.formulas.signals import CONDITION
from cornercase.metrics.formulas.units import spelt
from cornercase.metrics.measuring import measured
from cornercase.metrics.registry import METRICS
from cornercase.recordings import Recording

_FAR: Final = 100.0
# Least score of a run of which the condition does not hold, though it is at the bound.
_HAIR: Final = 1e-9
_UNKNOWN: Final = Span(-np.inf, np.inf)


class CriticalIf(Metric):
    """How far a run is from fulfilling a condition on collisions, scores, and what a reference driver prevents.

    The score is 0 or below where the condition holds. Of ``and`` the part counts that is farthest from holding, of
    ``or`` the nearest. A collision is as far away as the clearance to the other entity, a bound as the score is from
    it; a reference decides without any distance, so where it alone decides, and decides against, the score is the cap.
    The course is how far it is from holding at each instant, if references decide for it.

    Searched by ``cornercase explore --critical-if``, which runs the references; a recording alone cannot be measured.
    Cap: the farthest that a part can be from holding; 100 for a collision, and where no part can be far. Most critical
    value: the same below 0, -100 at least.

    Parameters
    ----------
    condition : str, default "collision"
        All that stands behind the colon: ``"critical-if:collision and not reference:cc-human"``.

    Notes
    -----
    Source: UN Regulation No. 157, Annex 4, Appendix 3, where preventable is what a reference driver prevents; distances
    are combined as in G. E. Fainekos, G. J. Pappas, "Robustness of temporal logic specifications for continuous-time
    signals", Theoretical Computer Science 410 (2009).
    """

    name = CONDITION
    unit = "1"
    lower_is_critical = True
    cap = _FAR
    critical = 0.0
    wants = "CONDITION"
    source = "UN Regulation No. 157, Fainekos and Pappas 2009"

    def __init__(self, condition: str = "collision", /) -> None:
        self.condition: Part = parse(condition)
        self._facts = tuple(dict.fromkeys(facts_in(self.condition)))
        bounds = [one for one in self._facts if isinstance(one, ScoreBound)]
        self._parts: dict[Fact, Metric] = {one: METRICS.create(one.metric) for one in bounds}
        if Collision() in self._facts:
            self._parts[Collision()] = Clearance()
        units = {spelt(one.unit) for one in self._parts.values()}
        self.unit = next(iter(self._parts.values())).unit if len(units) == 1 else "1"
        far = [abs(one.margin(self._parts[one].cap)) for one in bounds]
        # A bound at its metric's cap is at no distance from it.
        if Collision() in self._facts or not any(far):
            far.append(_FAR)
        self.cap = max(far)
        self.most_critical = -max(self.cap, _FAR)

    @classmethod
    def of(cls, condition: str) -> CriticalIf:
        """Make the metric of a condition; its name has one way of writing for all that say the same in the same order.

        Parameters
        ----------
        condition : str

        Returns
        -------
        CriticalIf

        Raises
        ------
        InputError
            It is none.
        """
        made = cls(condition)
        made.name = f"{CONDITION}:{made.condition.text}"
        return made

    @property
    def references(self) -> tuple[str, ...]:
        """Names of the reference drivers that it speaks of."""
        return tuple(one.driver for one in self._facts if isinstance(one, ReferenceCollides))

    def require(self) -> None:
        raise InputError(
            f"The metric '{self.name}' needs runs of reference drivers, which `explore` alone makes; give its condition"
            " there with `critical_if`."
        )

    def require_parts(self) -> None:
        """Refuse to go on where something is not installed that the metrics of the condition need."""
        for one in self._parts.values():
            one.require()

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        spans: dict[Fact, Span] = dict.fromkeys(self._facts, _UNKNOWN)
        defined = np.full(recording.time.shape, not self._parts)
        for fact, metric in self._parts.items():
            course = metric.course(recording, ego, other)
            defined |= ~np.isnan(course)
            margin = metric.capped(course)
            if isinstance(fact, ScoreBound):
                margin = fact.margin(margin)
            else:
                for at in _collisions(recording, ego):
                    margin[int(np.abs(recording.time - at).argmin())] = 0.0
            spans[fact] = Span(margin, margin)
        low = span_of(self.condition, spans).low
        return np.asarray(np.where(defined, np.broadcast_to(low, recording.time.shape), np.nan))

    def look(self, recording: Recording, ego: str, other: str | Sequence[str]) -> LookedAt:
        """Look at a run: what of the condition it fulfils by itself.

        Parameters
        ----------
        recording : Recording
        ego : str
            Name of an entity.
        other : str or sequence of str
            Names of one or several others; of several the nearest counts, and the worst score.

        Returns
        -------
        LookedAt

        Raises
        ------
        InputError
            There is no entity of that name.
        """
        scores = measured(dict.fromkeys(self._parts.values()), recording, ego, other)
        truths: dict[Fact, bool] = {}
        spans: dict[Fact, Span] = {}
        for fact, metric in self._parts.items():
            score = scores[metric.name].score
            if isinstance(fact, ScoreBound):
                truths[fact], margin = fact.holds(score), fact.margin(score)
            else:
                truths[fact] = any(True for _ in _collisions(recording, ego))
                margin = 0.0 if truths[fact] else score
            spans[fact] = Span(margin, margin)
        return LookedAt(self, truths, spans)


@dataclass(frozen=True, eq=False)
class LookedAt:
    """What of a condition a run fulfils by itself, before it is known what references do.

    Outcomes are mappings of the name of a reference to whether it collides: None where it says nothing of the
    scenario, not in there where it was not run.

    Attributes
    ----------
    metric : CriticalIf
    truths : mapping of Collision or ScoreBound to bool
    spans : mapping of Collision or ScoreBound to Span
    """

    metric: CriticalIf
    truths: Mapping[Fact, bool]
    spans: Mapping[Fact, Span]

    def undecided(self, outcomes: Mapping[str, bool | None]) -> str | None:
        """Name the reference that has to be run next.

        Parameters
        ----------
        outcomes : mapping of str to bool or None

        Returns
        -------
        str or None
            None where it is decided, or no reference could decide it.
        """
        if self.holds(outcomes) is not None:
            return None
        left = [one for one in self.metric.references if one not in outcomes]
        decisive = (one for one in left if self.holds({**outcomes, one: True}) != self.holds({**outcomes, one: False}))
        return next(decisive, left[0] if left else None)

    def holds(self, outcomes: Mapping[str, bool | None]) -> bool | None:
        """Tell whether the condition holds.

        Parameters
        ----------
        outcomes : mapping of str to bool or None

        Returns
        -------
        bool or None
            None where that depends on a reference that was not run, or says nothing.
        """
        known = dict.fromkeys(self.metric._facts) | dict(self.truths)
        known |= {ReferenceCollides(name): collides for name, collides in outcomes.items()}
        return truth_of(self.metric.condition, known)

    def score(self, outcomes: Mapping[str, bool | None]) -> float:
        """Score of the run.

        Parameters
        ----------
        outcomes : mapping of str to bool or None

        Returns
        -------
        float
            0 or below where the condition holds, above where it does not; the cap where nothing can decide it.
        """
        holds = self.holds(outcomes)
        spans = dict.fromkeys(self.metric._facts, _UNKNOWN) | dict(self.spans)
        for name, collides in outcomes.items():
            if collides is not None:
                at = -np.inf if collides else np.inf
                spans[ReferenceCollides(name)] = Span(at, at)
        low, high = span_of(self.metric.condition, spans)
        if holds is None:
            return self.metric.cap
        value = min(float(high), 0.0) if holds else max(float(low), _HAIR)
        return float(np.clip(value, self.metric.most_critical, self.metric.cap))


def condition_of(metrics: Iterable[str]) -> str:
    """Find the condition that says which scenarios of a study are critical.

    Parameters
    ----------
    metrics : iterable of str
        Names of the metrics of the study.

    Returns
    -------
    str
        Empty where there is none.
    """
    found = (one.partition(":") for one in metrics)
    return next((text for name, _, text in found if name == CONDITION), "")


def _collisions(recording: Recording, ego: str) -> Iterable[float]:
    """Instants in s at which the ego collides, with anybody."""
    return (one.time for one in recording.collisions if ego in one.entities)
