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
    """Outcomes of n scenarios of an estimate.

    `scores`, shape (n,), are lower where more critical, and NaN if the scenario failed. `is_critical`, `has_collision`
    and `has_encounter`, shape (n,), say whether the event occurred; False if the scenario failed.
    """

    scores: FloatArray
    is_critical: BoolArray
    has_collision: BoolArray
    has_encounter: BoolArray

    @property
    def event_columns(self) -> BoolArray:
        """The events critical and collision as two columns, shape (n, 2)."""
        return np.stack([self.is_critical, self.has_collision], axis=1)

    @property
    def is_failed(self) -> BoolArray:
        """Which scenarios failed, shape (n,)."""
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


# Of no scenario, of one, and of several.
_CONDITIONS: Final = {
    "critical scenario": ("is critical", "is critical", "are critical"),
    "collision": ("has a collision", "has one", "have one"),
}


@dataclass(frozen=True, repr=False)
class Estimation:
    """Probabilities of events under the distributions of a space.

    They come from different draws, so they agree within their intervals, not to the digit. That of an encounter is the
    fraction of the first draws, which come from the distributions themselves; a larger budget does not add to them.
    Those of critical scenarios and collisions are sums of weights of the later draws, from the proposal distribution:
    weights are 1 only on average, so an event that was met in all of them may have 0.95. Conditional probabilities are
    quotients of the two. `table` says which is which.

    Attributes
    ----------
    study : Path
        Contains all scenarios that were run for the estimate.
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
        Numbers of scenarios: in total, used for learning only, and failed.
    warnings : tuple of str
        Reasons not to trust the result, as sentences.
    interrupted : bool
        Whether it ended before its budget was used up.

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
            One row per event, indexed by its name: ``probability``, the bounds ``low`` and ``high`` of its 95 %
            interval, ``error``, the relative standard error, the number of ``scenarios`` that it is estimated from,
            in how many of these the event was ``met``, and the ``method``. Probabilities that are unknown are left out.
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
            The keys are words; ``cornercase estimate --json`` prints identifiers instead.
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

    `estimate` is the probability from all draws, `direct_estimate` that from draws of the space's own distributions
    only. `n_counting` scenarios were drawn for either. `n_uncounted` others, which only taught where to draw, have the
    event.
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
    """Probability of an event from draws of the space's own distributions; `occurred` has shape (n,)."""
    return probability_from_counts(int(occurred.sum()), len(occurred))
