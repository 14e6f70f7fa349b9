"""The result of a probability estimate."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from cornercase._common.text.notebook_html import render_html_table
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.evidence import Probability
from cornercase.evidence._probability import probability_from_counts

if TYPE_CHECKING:
    import pandas as pd

# An interval may be too narrow below this effective sample size, or above this share of a single scenario.
_MIN_EFFECTIVE_SAMPLES: Final = 30.0
_MAX_SINGLE_SHARE: Final = 0.2


@dataclass(frozen=True, eq=False)
class EventOutcomes:
    """Outcomes of n scenarios of an estimate, for three events: critical, collision and encounter.

    `scores`, shape (n,), are lower for more critical scenarios, and NaN if a scenario failed. `is_critical`,
    `has_collision` and `has_encounter`, shape (n,), say whether the event occurred; False if a scenario failed.
    """

    scores: FloatArray
    is_critical: BoolArray
    has_collision: BoolArray
    has_encounter: BoolArray

    @property
    def event_columns(self) -> BoolArray:
        """`is_critical` and `has_collision` as two columns, shape (n, 2)."""
        return np.stack([self.is_critical, self.has_collision], axis=1)

    @property
    def is_failed(self) -> BoolArray:
        """True for each scenario that failed, shape (n,)."""
        return np.isnan(self.scores)

    @classmethod
    def concatenate(cls, parts: list[EventOutcomes]) -> EventOutcomes:
        """Concatenate the outcomes of several groups of scenarios."""
        names = ("scores", "is_critical", "has_collision", "has_encounter")
        dtypes = (np.float64, np.bool_, np.bool_, np.bool_)
        return cls(
            *(
                np.concatenate([np.zeros(0, dtype), *(getattr(part, name) for part in parts)])
                for name, dtype in zip(names, dtypes, strict=True)
            )
        )


# By event: the predicate of a sentence about no scenario, one scenario, and several scenarios.
_CONDITIONS: Final = {
    "critical scenario": ("is critical", "is critical", "are critical"),
    "collision": ("has a collision", "has one", "have one"),
}


@dataclass(frozen=True, repr=False)
class Estimation:
    """Probabilities of events under the distributions of a space.

    The first scenarios are drawn from the distributions themselves; a larger budget does not add to these scenarios.
    The probability of an encounter is the fraction of these scenarios with an encounter. Later scenarios are drawn from
    a learned proposal distribution and have importance weights. The probabilities of critical scenarios and collisions
    are computed from these weights. Since weights are 1 only on average, the estimate may be 0.95 for an event that
    occurs in all scenarios. Conditional probabilities are quotients of two probabilities. Since the
    probabilities come from different scenarios, they may contradict each other slightly, within their intervals.
    `table` lists the method by which each probability was estimated.

    There are four exceptions. The probability of an event that occurs in none of the later scenarios is its fraction of
    the first scenarios. If the budget covers all scenarios of a small space, all are run, and the probabilities are
    exact. If the explored study shows too little, and the first scenarios have at most two different scores, all
    scenarios are drawn from the distributions themselves. If what was learned meets the events no more often than the
    distributions do, the later scenarios are drawn from the distributions, too, and have a weight of 1.

    Attributes
    ----------
    study : Path
        Study file with all scenarios that were run for the estimate.
    criterion : str
        What is critical, such as ``"ttc <= 0.5 s"``.
    encounter_gap : float
        Gap in m up to which two entities have an encounter.
    critical, collision, encounter : Probability
        Probability that a scenario is critical, that the ego and the other entity collide, and that they have an
        encounter.
    critical_given_encounter, collision_given_encounter : Probability or None
        Conditional probabilities, given that there is an encounter; None if unknown.
    scenarios, n_learning, failed : int
        Numbers of scenarios: in total, used for learning, and failed. The scenarios used for learning include the first
        ones, drawn from the distributions themselves, which also give the probability of an encounter.
    warnings : tuple of str
        Reasons not to trust the result, as sentences.
    interrupted : bool
        Whether the estimate ended before its budget was used up.

    Examples
    --------
    >>> import cornercase as cc
    >>> estimation = cc.estimate("study.db", "estimate.db", budget=1000)  # doctest: +SKIP
    >>> print(estimation.critical)  # doctest: +SKIP
    0.00512 (0.00257 to 0.0102)
    >>> estimation.table()["met"].to_dict()["collision"], estimation.scenarios  # doctest: +SKIP
    (12, 1000)
    """

    study: Path
    criterion: str
    encounter_gap: float
    critical: Probability
    collision: Probability
    encounter: Probability
    critical_given_encounter: Probability | None
    collision_given_encounter: Probability | None
    scenarios: int
    n_learning: int
    failed: int
    warnings: tuple[str, ...] = ()
    interrupted: bool = False

    def __repr__(self) -> str:
        return (
            f"<Estimation: critical {self.critical}, collision {self.collision}; {self.scenarios} scenarios in"
            f" {self.study}>"
        )

    def table(self) -> pd.DataFrame:
        """Make a table of the probabilities.

        Returns
        -------
        DataFrame
            One row per event, indexed by the name of the event. The columns are ``probability``; the bounds ``low`` and
            ``high`` of the 95 % interval of the probability; ``error``, the relative standard error of the probability;
            ``scenarios``, the number of scenarios behind the estimate; ``met``, the number of these scenarios in which
            the event occurred; and ``method``. Unknown probabilities are left out.
        """
        import pandas as pd

        events = {
            "critical": self.critical,
            "collision": self.collision,
            "encounter": self.encounter,
            "critical given an encounter": self.critical_given_encounter,
            "collision given an encounter": self.collision_given_encounter,
        }
        columns = ("probability", "low", "high", "error", "scenarios", "met", "method")
        rows = {
            name: (event.value, event.low, event.high, event.error, event.scenarios, event.met, event.method)
            for name, event in events.items()
            if event is not None
        }
        table = pd.DataFrame.from_dict(rows, orient="index", columns=columns).rename_axis("event")
        return table.astype(dict.fromkeys(columns[:4], "float64"))

    def _repr_html_(self) -> str:
        """HTML table of the probabilities, for notebooks."""
        return render_html_table(repr(self), self.table())

    def to_json(self) -> dict[str, Any]:
        """Return the result as plain values, for JSON.

        Returns
        -------
        dict of str to object
            The keys are phrases, such as ``"an encounter is"``; ``cornercase estimate --json`` prints identifiers
            instead.
        """
        conditional = {
            "critical given an encounter": self.critical_given_encounter,
            "collision given an encounter": self.collision_given_encounter,
        }
        return {
            "critical is": self.criterion,
            "an encounter is": f"gap <= {self.encounter_gap:g} m",
            "critical": self.critical.to_json(),
            "collision": self.collision.to_json(),
            "encounter": self.encounter.to_json(),
            **{
                name: None if probability is None else probability.to_json()
                for name, probability in conditional.items()
            },
            "scenarios": self.scenarios,
            "to learn where to draw": self.n_learning,
            "failed": self.failed,
            "warnings": list(self.warnings),
        }


def describe_doubts(
    event: str, estimate: Probability, direct_estimate: Probability, n_counting: int, n_uncounted: int
) -> list[str]:
    """Describe, in sentences, why the estimated probability of `event` may be wrong.

    `estimate` is the estimated probability. `direct_estimate` is the probability estimated only from scenarios that
    were drawn from the space's own distributions. `n_counting` is the number of scenarios behind the two estimates.
    `n_uncounted` is the number of other scenarios with the event, which were run only to learn where to draw.
    """
    if estimate.error == 0.0:
        return []
    if not estimate.met:
        condition, of_one, of_several = _CONDITIONS[event]
        sentence = f"None of the {n_counting} scenarios that count {condition}"
        if n_uncounted == 1:
            sentence += f"; one that was run only to learn where to draw {of_one}"
        elif n_uncounted:
            sentence += f"; {n_uncounted} that were run only to learn where to draw {of_several}"
        return [
            f"{sentence}. The {direct_estimate.scenarios} scenarios drawn from the distributions themselves bound"
            f" the probability of a {event} by {direct_estimate.high:.3g} (95 %)."
        ]
    sentences = []
    if estimate.effective < _MIN_EFFECTIVE_SAMPLES:
        sentences.append(
            f"The probability of a {event} is based on {estimate.effective:.0f} effective"
            f" scenarios; its interval may be"
            " too narrow. Use a larger budget."
        )
    elif estimate.largest > _MAX_SINGLE_SHARE:
        sentences.append(
            f"One scenario accounts for {estimate.largest:.0%} of the probability of a {event}; its interval may be too"
            " narrow. Use a larger budget."
        )
    if estimate.high < direct_estimate.low or estimate.low > direct_estimate.high:
        sentences.append(
            f"The estimates of the probability of a {event} differ: {direct_estimate} from the"
            f" {direct_estimate.scenarios} scenarios drawn"
            f" from the distributions themselves, {estimate} from the others. A region may have been missed."
        )
    return sentences


def probability_from_direct_draws(occurred: BoolArray) -> Probability:
    """Estimate the probability of an event from n scenarios drawn from the space's own distributions.

    `occurred`, shape (n,), says whether the event occurred in a scenario.
    """
    return probability_from_counts(int(occurred.sum()), len(occurred))
