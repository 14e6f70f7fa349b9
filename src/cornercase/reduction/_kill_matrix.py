"""Mutation analysis: which scenarios kill (expose) which mutants (drivers made worse in one respect)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from cornercase._common.clopper_pearson import clopper_pearson_interval
from cornercase._common.typing import BoolArray
from cornercase.drivers import Mutant

_TAIL_PROBABILITY: Final = 0.025


@dataclass(frozen=True, eq=False)
class KillMatrix:
    """Kill matrix: which scenarios kill which mutants (versions of a driver made worse in one respect).

    A scenario kills a mutant if, in this scenario, the original driver violates no requirement and the mutant violates
    at least one.

    Attributes
    ----------
    driver : str
        Original driver.
    requirements : tuple of str
        Requirements that a driver must not violate.
    scenarios : tuple of int
        Ids of the scenarios that were run with the mutants.
    failed : ndarray of bool, shape (n,)
        True for a scenario in which the original driver violates a requirement, or that could not be run. This
        scenario kills nothing.
    mutants : tuple of Mutant
        Mutants with which the scenarios were run.
    kills : ndarray of bool, shape (n, m)
        Whether a scenario (row) kills a mutant (column).
    held_out : KillMatrix or None
        Kill matrix of the same scenarios for other mutants of the driver. If scenarios are selected by the mutants of
        this matrix, the other mutants evaluate the selection.

    Examples
    --------
    `cornercase.suite.analyze_mutants` makes a kill matrix. This one has two scenarios and two mutants:

    >>> import numpy as np
    >>> from cornercase.drivers import generate_mutants
    >>> from cornercase.reduction import KillMatrix
    >>> mutants, kills = generate_mutants("normal", 2), np.array([[True, False], [False, False]])
    >>> matrix = KillMatrix("normal", ("no collision",), (17, 18), np.zeros(2, dtype=bool), mutants, kills)
    >>> matrix.mutation_score([17])
    MutationScore(mutants=2, killable=1, killed=1)
    >>> matrix.survivors
    ('normal:min_gap=0.338',)
    """

    driver: str
    requirements: tuple[str, ...]
    scenarios: tuple[int, ...]
    failed: BoolArray
    mutants: tuple[Mutant, ...]
    kills: BoolArray
    held_out: KillMatrix | None = None

    def kills_of(self, scenarios: Sequence[int]) -> BoolArray:
        """Return, for each of the given scenarios, which of the m mutants the scenario kills.

        Parameters
        ----------
        scenarios : sequence of int, length k
            Ids of scenarios.

        Returns
        -------
        ndarray of bool, shape (k, m)
            Rows are scenarios. A scenario that was not run with the mutants kills none.
        """
        index_of = {scenario: i for i, scenario in enumerate(self.scenarios)}
        rows = np.zeros((len(scenarios), len(self.mutants)), dtype=np.bool_)
        for k, scenario in enumerate(scenarios):
            if scenario in index_of:
                rows[k] = self.kills[index_of[scenario]]
        return rows

    def mutation_score(self, scenarios: Sequence[int] | None = None) -> MutationScore:
        """Return the mutation score of the given scenarios: how many mutants they kill together.

        Parameters
        ----------
        scenarios : sequence of int, optional
            Ids of scenarios; by default all.

        Returns
        -------
        MutationScore
        """
        ids = self.scenarios if scenarios is None else scenarios
        return MutationScore(
            len(self.mutants), int(self.kills.any(axis=0).sum()), int(self.kills_of(ids).any(axis=0).sum())
        )

    @property
    def counts_by_mutation(self) -> dict[str, tuple[int, int]]:
        """For each kind of mutation: the number of killed mutants, and the number of all mutants."""
        is_killed = self.kills.any(axis=0)
        mutations = np.array([mutant.mutation for mutant in self.mutants])
        return {
            mutation: (int(is_killed[mutations == mutation].sum()), int((mutations == mutation).sum()))
            for mutation in sorted({mutant.mutation for mutant in self.mutants})
        }

    @property
    def survivors(self) -> tuple[str, ...]:
        """Names of the mutants that survive all scenarios."""
        is_killed = self.kills.any(axis=0)
        return tuple(mutant.driver for mutant, exposed in zip(self.mutants, is_killed, strict=True) if not exposed)

    @property
    def summary_text(self) -> str:
        """Number of mutants that all scenarios together kill, as a sentence without a full stop."""
        count, total = len(self.mutants) - len(self.survivors), len(self.mutants)
        low, high = clopper_pearson_interval(count, total, _TAIL_PROBABILITY)
        interval = f"{low:.0%} to {high:.0%} with 95 % confidence"
        return f"{count} of {total} mutants of {self.driver} are exposed, {count / total:.0%} ({interval})"

    def to_json(self) -> dict[str, Any]:
        """Return what ``cornercase test --mutants --json`` prints.

        Returns
        -------
        dict of str to object
        """
        count, total = len(self.mutants) - len(self.survivors), len(self.mutants)
        return {
            "driver": self.driver,
            "requirements": list(self.requirements),
            "mutants": total,
            "exposed": count,
            "share": count / total,
            "interval_95": list(clopper_pearson_interval(count, total, _TAIL_PROBABILITY)),
            "failed_with_the_driver": [i for i, failed in zip(self.scenarios, self.failed, strict=True) if failed],
            "by_mutant": [
                {
                    "driver": mutant.driver,
                    "mutation": mutant.mutation,
                    "exposed_by": [self.scenarios[i] for i in np.flatnonzero(exposed)],
                }
                for mutant, exposed in zip(self.mutants, self.kills.T, strict=True)
            ],
        }


@dataclass(frozen=True)
class MutationScore:
    """Mutation score: how many mutants (drivers made worse in one respect) some scenarios kill.

    Attributes
    ----------
    mutants : int
        Number of mutants.
    killable : int
        Number of mutants that at least one of all scenarios that were run kills. The remaining mutants may behave as
        well as the original driver in all these scenarios (equivalent mutants).
    killed : int
        Number of mutants killed by the scenarios in question.

    Examples
    --------
    >>> from cornercase.reduction import MutationScore
    >>> score = MutationScore(mutants=20, killable=9, killed=6)
    >>> f"{score.share:.0%}, {score.interval[0]:.0%} to {score.interval[1]:.0%}"
    '67%, 30% to 93%'
    """

    mutants: int
    killable: int
    killed: int

    @property
    def share(self) -> float:
        """Share of the killable mutants that are killed: `killed` divided by `killable`; NaN if `killable` is 0."""
        return self.killed / self.killable if self.killable else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """95 % Clopper-Pearson interval of `share`, if the mutants are seen as a random sample of possible mutants."""
        return clopper_pearson_interval(self.killed, self.killable, _TAIL_PROBABILITY)

    def to_json(self) -> dict[str, Any]:
        """Convert to plain values, for JSON.

        Returns
        -------
        dict of str to object
        """
        return {
            "mutants": self.mutants,
            "possible": self.killable,
            "exposed": self.killed,
            "share": self.share if self.killable else None,
            "interval_95": list(self.interval),
        }


@dataclass(frozen=True)
class MutantSelection:
    """Result of a selection by mutants (drivers made worse in one respect): scores of the selected scenarios.

    Attributes
    ----------
    driver : str
        Driver from which the mutants are derived.
    requirements : tuple of str
        Requirements that a mutant could violate.
    candidates : int
        Number of scenarios that were run with the mutants.
    chosen_by : MutationScore
        Mutation score for the mutants by which scenarios were selected.
    held_out : MutationScore or None
        Mutation score for held-out mutants, which did not influence the selection; None if there are none.
    without : MutationScore or None
        For comparison: the score for the held-out mutants if `reduce` selects scenarios without regard to mutants.
        None if there are no held-out mutants.

    Examples
    --------
    >>> import cornercase as cc
    >>> from cornercase.suite import analyze_mutants
    >>> matrix = analyze_mutants("study.db", 20)  # doctest: +SKIP
    >>> reduced = cc.reduce("study.db", "exposing", size=10, kill_matrix=matrix)  # doctest: +SKIP
    >>> reduced.exposing.held_out, reduced.exposing.without  # doctest: +SKIP
    (MutationScore(mutants=20, killable=10, killed=10), MutationScore(mutants=20, killable=10, killed=1))
    """

    driver: str
    requirements: tuple[str, ...]
    candidates: int
    chosen_by: MutationScore
    held_out: MutationScore | None = None
    without: MutationScore | None = None

    @property
    def summary_text(self) -> str:
        """Mutation scores of the selection, as a sentence without a full stop."""
        score = self.held_out
        if score is None:
            return f"it exposes {self.chosen_by.killed} of the {self.chosen_by.mutants} mutants that chose"
        if not score.killable:
            return f"no scenario exposes any of the {score.mutants} other mutants of {self.driver} that judge"
        low, high = score.interval
        comparison = "" if self.without is None else f"; a set chosen without mutants exposes {self.without.killed}"
        return (
            f"of {score.mutants} other mutants of {self.driver}, all {self.candidates} scenarios expose"
            f" {score.killable}, and the set exposes {score.killed} of these, {score.share:.0%} ({low:.0%} to"
            f" {high:.0%} with 95 % confidence){comparison}"
        )

    def to_json(self) -> dict[str, Any]:
        """Convert to plain values, for JSON.

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
