"""What an estimate of probabilities found."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray
from cornercase.evidence import Probability, of_counts

# Below so many effective scenarios, or with such a share of one scenario, an interval may not hold.
_FEW: Final = 30.0
_LARGE: Final = 0.2


@dataclass(frozen=True, eq=False)
class Outcomes:
    """What came out of the scenarios of an estimate.

    Attributes
    ----------
    scores : ndarray of float64, shape (n,)
        Oriented; NaN for a scenario that failed.
    critical, collision, encounter : ndarray of bool, shape (n,)
        All False for a scenario that failed.
    """

    scores: FloatArray
    critical: BoolArray
    collision: BoolArray
    encounter: BoolArray

    @property
    def events(self) -> BoolArray:
        """Critical, and collision, shape (n, 2)."""
        return np.stack([self.critical, self.collision], axis=1)

    @property
    def failed(self) -> BoolArray:
        """Which scenarios could not be run, shape (n,)."""
        return np.isnan(self.scores)

    @classmethod
    def joined(cls, parts: list[Outcomes]) -> Outcomes:
        """Put parts one after the other.

        Parameters
        ----------
        parts : list of Outcomes

        Returns
        -------
        Outcomes
        """
        names = ("scores", "critical", "collision", "encounter")
        kinds = (np.float64, np.bool_, np.bool_, np.bool_)
        return cls(
            *(
                np.concatenate([np.zeros(0, kind), *(getattr(one, name) for one in parts)])
                for name, kind in zip(names, kinds, strict=True)
            )
        )


@dataclass(frozen=True, repr=False)
class Estimation:
    """Probabilities under the distributions of a space.

    Attributes
    ----------
    study : Path
        Holds all scenarios that were run for it.
    criterion : str
        What is critical, as ``"ttc <= 0.5 s"``.
    within : float
        Gap in m up to which two entities have an encounter.
    critical, collision, encounter : Probability
        That a scenario is critical; that the ego and the other collide; that they have an encounter.
    critical_given_encounter, collision_given_encounter : Probability or None
        None where it is not known.
    scenarios, learned, failed : int
        Scenarios in all; those from which only was learned where to draw; those that could not be run.
    warnings : tuple of str
        Why not to trust it, as sentences.
    interrupted : bool
        Whether it ended before its budget was used up.
    """

    study: Path
    criterion: str
    within: float
    critical: Probability
    collision: Probability
    encounter: Probability
    critical_given_encounter: Probability | None
    collision_given_encounter: Probability | None
    scenarios: int
    learned: int
    failed: int
    warnings: tuple[str, ...] = ()
    interrupted: bool = False

    def __repr__(self) -> str:
        return (
            f"<Estimation: critical {self.critical}, collision {self.collision}; {self.scenarios} scenarios in"
            f" {self.study}>"
        )

    def to_json(self) -> dict[str, Any]:
        """Return plain values, as a study holds them.

        Returns
        -------
        dict of str to object
            By words; ``cornercase estimate --json`` prints identifiers in their place.
        """
        given = {
            "critical given an encounter": self.critical_given_encounter,
            "collision given an encounter": self.collision_given_encounter,
        }
        return {
            "critical is": self.criterion,
            "an encounter is": f"gap <= {self.within:g} m",
            "critical": self.critical.to_json(),
            "collision": self.collision.to_json(),
            "encounter": self.encounter.to_json(),
            **{name: None if one is None else one.to_json() for name, one in given.items()},
            "scenarios": self.scenarios,
            "to learn where to draw": self.learned,
            "failed": self.failed,
            "warnings": list(self.warnings),
        }


def warnings_of(name: str, found: Probability, plain: Probability) -> list[str]:
    """Say why not to trust a probability.

    Parameters
    ----------
    name : str
        Of the event, as ``"collision"``.
    found : Probability
    plain : Probability
        Of the same event, from the scenarios that were drawn by the law.

    Returns
    -------
    list of str
        Sentences.
    """
    if found.error == 0.0:
        return []
    if not found.met:
        return [
            f"No {name} was met; the {plain.scenarios} scenarios that were drawn by the distributions themselves bound"
            f" its probability by {plain.high:.3g} (95 %)."
        ]
    said = []
    if found.effective < _FEW:
        said.append(
            f"The probability of a {name} rests on {found.effective:.0f} effective scenarios; its interval may be too"
            " narrow. Give a larger budget."
        )
    elif found.largest > _LARGE:
        said.append(
            f"One scenario makes {found.largest:.0%} of the probability of a {name}; its interval may be too narrow."
            " Give a larger budget."
        )
    if found.high < plain.low or found.low > plain.high:
        said.append(
            f"The {plain.scenarios} scenarios that were drawn by the distributions themselves say that the probability"
            f" of a {name} is {plain}, and the others {found}; some region may not have been found."
        )
    return said


def of_law(met: BoolArray) -> Probability:
    """Probability of an event from scenarios that were drawn by the law itself.

    Parameters
    ----------
    met : ndarray of bool, shape (n,)

    Returns
    -------
    Probability
    """
    return of_counts(int(met.sum()), len(met))
