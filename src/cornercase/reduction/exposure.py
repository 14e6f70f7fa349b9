"""Which scenarios expose which mutants of a driver."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from cornercase._common.shares import clopper_pearson
from cornercase._common.typing import BoolArray
from cornercase.drivers import Mutant

_TAIL: Final = 0.025


@dataclass(frozen=True, eq=False)
class Exposure:
    """Which scenarios expose which mutants of a driver.

    A scenario exposes a mutant where the driver itself fails none of the requirements, and the mutant fails one. (The
    literature of mutation testing says that the test kills the mutant.)

    Attributes
    ----------
    driver : str
        Whose mutants they are.
    requirements : tuple of str
    scenarios : tuple of int
        Ids.
    failed : ndarray of bool, shape (n,)
        Scenarios in which the driver itself fails, or that could not be run; they expose nothing.
    mutants : tuple of Mutant
    exposed : ndarray of bool, shape (n, m)
    held_out : Exposure or None
        The same for other mutants of the driver in the same scenarios, which judge what was chosen by these.
    """

    driver: str
    requirements: tuple[str, ...]
    scenarios: tuple[int, ...]
    failed: BoolArray
    mutants: tuple[Mutant, ...]
    exposed: BoolArray
    held_out: Exposure | None = None

    def rows_of(self, scenarios: Sequence[int]) -> BoolArray:
        """Return which mutants some scenarios expose.

        Parameters
        ----------
        scenarios : sequence of int, length k
            Ids.

        Returns
        -------
        ndarray of bool, shape (k, m)
            A scenario that was not run with the mutants exposes none.
        """
        place = {one: i for i, one in enumerate(self.scenarios)}
        rows = np.zeros((len(scenarios), len(self.mutants)), dtype=np.bool_)
        for k, one in enumerate(scenarios):
            if one in place:
                rows[k] = self.exposed[place[one]]
        return rows

    def grade(self, scenarios: Sequence[int] | None = None) -> Grade:
        """Say how many mutants scenarios expose.

        Parameters
        ----------
        scenarios : sequence of int, optional
            Ids; by default all.

        Returns
        -------
        Grade
        """
        chosen = self.scenarios if scenarios is None else scenarios
        return Grade(
            len(self.mutants), int(self.exposed.any(axis=0).sum()), int(self.rows_of(chosen).any(axis=0).sum())
        )

    @property
    def by_mutation(self) -> dict[str, tuple[int, int]]:
        """By what was done to the mutants: how many are exposed, and how many there are."""
        found = self.exposed.any(axis=0)
        kinds = np.array([one.mutation for one in self.mutants])
        return {
            kind: (int(found[kinds == kind].sum()), int((kinds == kind).sum()))
            for kind in sorted({one.mutation for one in self.mutants})
        }

    @property
    def unexposed(self) -> tuple[str, ...]:
        """Names of the mutants that no scenario exposes."""
        found = self.exposed.any(axis=0)
        return tuple(one.driver for one, exposed in zip(self.mutants, found, strict=True) if not exposed)

    @property
    def text(self) -> str:
        """How many mutants all scenarios together expose, in a sentence without a full stop."""
        count, total = len(self.mutants) - len(self.unexposed), len(self.mutants)
        low, high = clopper_pearson(count, total, _TAIL)
        interval = f"{low:.0%} to {high:.0%} with 95 % confidence"
        return f"{count} of {total} mutants of {self.driver} are exposed, {count / total:.0%} ({interval})"

    def to_json(self) -> dict[str, Any]:
        """Return plain values.

        Returns
        -------
        dict of str to object
            What ``cornercase test --mutants --json`` prints of it.
        """
        count, total = len(self.mutants) - len(self.unexposed), len(self.mutants)
        return {
            "driver": self.driver,
            "requirements": list(self.requirements),
            "mutants": total,
            "exposed": count,
            "share": count / total,
            "interval_95": list(clopper_pearson(count, total, _TAIL)),
            "failed_with_the_driver": [one for one, failed in zip(self.scenarios, self.failed, strict=True) if failed],
            "by_mutant": [
                {
                    "driver": one.driver,
                    "mutation": one.mutation,
                    "exposed_by": [self.scenarios[i] for i in np.flatnonzero(exposed)],
                }
                for one, exposed in zip(self.mutants, self.exposed.T, strict=True)
            ],
        }


@dataclass(frozen=True)
class Grade:
    """How many mutants some scenarios expose.

    Attributes
    ----------
    mutants : int
        Number of mutants.
    possible : int
        How many of them at least one scenario exposes, of all that were run; the others may be as good as the
        original there, which is called equivalent.
    exposed : int
        How many of them the scenarios expose that are graded.
    """

    mutants: int
    possible: int
    exposed: int

    @property
    def share(self) -> float:
        """Of the mutants that can be exposed; NaN where there are none."""
        return self.exposed / self.possible if self.possible else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """Interval of 95 % of the share (Clopper and Pearson), for mutants drawn in the same way."""
        return clopper_pearson(self.exposed, self.possible, _TAIL)

    def to_json(self) -> dict[str, Any]:
        """Return plain values.

        Returns
        -------
        dict of str to object
        """
        return {
            "mutants": self.mutants,
            "possible": self.possible,
            "exposed": self.exposed,
            "share": self.share if self.possible else None,
            "interval_95": list(self.interval),
        }


@dataclass(frozen=True)
class ExposingChoice:
    """What mutants chose, and what that is worth.

    Attributes
    ----------
    driver : str
        Whose mutants they are.
    requirements : tuple of str
        Which of them a mutant had to fail.
    candidates : int
        Number of scenarios that were run with the mutants.
    chosen_by : Grade
        Of the mutants that chose.
    held_out : Grade or None
        Of other mutants, which had no part in the choice; None where there are none.
    without : Grade or None
        The same of the set that `reduce` chooses without mutants.
    """

    driver: str
    requirements: tuple[str, ...]
    candidates: int
    chosen_by: Grade
    held_out: Grade | None = None
    without: Grade | None = None

    @property
    def text(self) -> str:
        """What it is worth, in a sentence without a full stop."""
        one = self.held_out
        if one is None:
            return f"it exposes {self.chosen_by.exposed} of the {self.chosen_by.mutants} mutants that chose"
        if not one.possible:
            return f"no scenario exposes any of the {one.mutants} other mutants of {self.driver} that judge"
        low, high = one.interval
        beside = "" if self.without is None else f"; a set chosen without mutants exposes {self.without.exposed}"
        return (
            f"of {one.mutants} other mutants of {self.driver}, all {self.candidates} scenarios expose {one.possible},"
            f" and the set exposes {one.exposed} of these, {one.share:.0%} ({low:.0%} to {high:.0%} with 95 %"
            f" confidence){beside}"
        )

    def to_json(self) -> dict[str, Any]:
        """Return plain values.

        Returns
        -------
        dict of str to object
        """
        return {
            "driver": self.driver,
            "requirements": list(self.requirements),
            "candidates": self.candidates,
            "chosen_by": self.chosen_by.to_json(),
            "held_out": None if self.held_out is None else self.held_out.to_json(),
            "without": None if self.without is None else self.without.to_json(),
        }
