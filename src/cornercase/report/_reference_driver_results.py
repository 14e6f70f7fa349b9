"""Numbers of scenarios in which a reference driver (model of a careful driver) avoids a collision."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from cornercase.metrics import CriticalIf
from cornercase.study import StudyFile
from cornercase.study._damage import reraise_read_errors
from cornercase.suite import Requirement


@dataclass(frozen=True)
class ReferenceDriverResults:
    """Numbers of scenarios by result, after a second run in which a reference driver (a model) drives the ego.

    Attributes
    ----------
    n_prevented, n_colliding : int
        Number of scenarios in which the reference driver avoids the collision, and in which the reference driver
        collides, too.
    n_not_applicable : int
        Number of scenarios for which the reference driver is not defined.
    n_colliding_later : int
        Number of scenarios in which the reference driver collides, but which `n_prevented` counts: the other vehicle
        cut in with a time to collision above 2 s, in which UN Regulation No. 157 sees no danger.

    Examples
    --------
    The results of a study with the condition ``collision and not reference:cc-human``:

    >>> import cornercase as cc
    >>> human = cc.summarize("study.db").references["cc-human"]  # doctest: +SKIP
    >>> print(f"cc-human avoids {human.n_prevented} of {human.n_scenarios} collisions")  # doctest: +SKIP
    cc-human avoids 15 of 18 collisions
    """

    n_prevented: int
    n_colliding: int
    n_not_applicable: int
    n_colliding_later: int = 0

    @property
    def n_scenarios(self) -> int:
        """Number of scenarios that were run again with the reference driver."""
        return self.n_prevented + self.n_colliding + self.n_not_applicable


def count_reference_driver_results(study: StudyFile) -> dict[str, ReferenceDriverResults]:
    """Count the results of each reference driver (model) that the condition or a requirement of the study names."""
    meta = study.meta
    with reraise_read_errors(study.path):
        condition = meta.condition
        names = list(CriticalIf.from_text(condition).reference_drivers) if condition else []
        for text in meta.requirements:
            names += Requirement.parse(text).expression.reference_drivers
        counts = {}
        for reference in dict.fromkeys(names):
            outcomes = study.reference_outcomes(reference).values()
            collisions = [outcome.collides for outcome in outcomes]
            counts[reference] = ReferenceDriverResults(
                collisions.count(False),
                collisions.count(True),
                collisions.count(None),
                sum(outcome.collides is False and outcome.time is not None for outcome in outcomes),
            )
        return counts


def describe_reference_drivers(references: Mapping[str, ReferenceDriverResults]) -> str:
    """Return sentences about results of reference drivers; each sentence begins with a space.

    `references` maps names of reference drivers to results.
    """
    sentences = []
    for name, count in references.items():
        avoided = count.n_prevented - count.n_colliding_later
        results = [f"prevents {avoided}", f"does not prevent {count.n_colliding}"]
        if count.n_colliding_later:
            results.append(f"collides in {count.n_colliding_later} that count as prevented")
        results += [f"says nothing of {count.n_not_applicable}"] if count.n_not_applicable else []
        scenarios = "One scenario was" if count.n_scenarios == 1 else f"{count.n_scenarios} scenarios were"
        sentences.append(
            f" {scenarios} run again with {name} at the wheel, which {', '.join(results[:-1])} and {results[-1]}."
        )
        if count.n_colliding_later:
            sentences.append(
                " They count so because the other cut in with a time to collision above 2 s, in which the regulation"
                " sees no danger; do not report them as preventable."
            )
    return "".join(sentences)
