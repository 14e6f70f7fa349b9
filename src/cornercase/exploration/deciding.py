"""Scenarios run a second time, with references at the wheel, where a condition depends on them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from cornercase._common.errors import SimulationError
from cornercase.drivers import ReferenceOutcome, judge_reference
from cornercase.exploration.configuration import Configuration
from cornercase.metrics import CriticalIf, LookedAt, Measured
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import Simulator
from cornercase.study import Row

Run = Callable[[Simulator, Sequence[ConcreteScenario]], Iterator[Recording | SimulationError]]
"""Runs scenarios by a simulator."""


@dataclass(eq=False)
class Undecided:
    """A scenario that was run, and whose condition may depend on references.

    Attributes
    ----------
    row : Row
    recording : Recording
    courses : dict of str to Measured
        Course and score by metric.
    looked : LookedAt
        What of the condition it fulfils by itself.
    outcomes : dict of str to ReferenceOutcome
        Of the references that were run.
    error : SimulationError or None
        Why one of them could not be run.
    """

    row: Row
    recording: Recording
    courses: dict[str, Measured]
    looked: LookedAt
    outcomes: dict[str, ReferenceOutcome] = field(default_factory=dict)
    error: SimulationError | None = None

    @property
    def wanted(self) -> str | None:
        """Name of the reference that has to be run next; None where there is none."""
        return None if self.error is not None else self.looked.undecided(self._collides)

    @property
    def _collides(self) -> dict[str, bool | None]:
        return {name: one.collides for name, one in self.outcomes.items()}

    def decided(self) -> dict[str, Measured]:
        """Courses and scores, with the score of the condition as the references have it."""
        metric = self.looked.metric
        found, score = self.courses[metric.name], self.looked.score(self._collides)
        against = found.against if score < metric.cap else None
        return self.courses | {metric.name: Measured(found.course, score, against)}


class SecondRuns:
    """Runs scenarios again, with references at the wheel of the ego.

    Parameters
    ----------
    configuration : Configuration
    condition : CriticalIf
    references : mapping of str to Simulator
        By name of the reference.
    run : callable
    """

    def __init__(
        self, configuration: Configuration, condition: CriticalIf, references: Mapping[str, Simulator], run: Run
    ) -> None:
        self._about, self._condition, self._references, self._run = configuration, condition, references, run

    def look(self, row: Row, recording: Recording, courses: dict[str, Measured]) -> Undecided:
        """Look at a scenario that was run.

        Parameters
        ----------
        row : Row
        recording : Recording
        courses : dict of str to Measured

        Returns
        -------
        Undecided
        """
        return Undecided(row, recording, courses, self._condition.look(recording, self._about.ego, self._about.others))

    def decide(self, scenarios: Sequence[Undecided]) -> Iterator[Undecided]:
        """Run references until nothing depends on them any more.

        Parameters
        ----------
        scenarios : sequence of Undecided

        Yields
        ------
        Undecided
            Each when it is decided.
        """
        left = list(scenarios)
        while left:
            for name in dict.fromkeys(one.wanted for one in left):
                chosen = [one for one in left if one.wanted == name]
                if name is not None:
                    self._ask(name, chosen)
            yield from (one for one in left if one.wanted is None)
            left = [one for one in left if one.wanted is not None]

    def _ask(self, name: str, scenarios: Sequence[Undecided]) -> None:
        concretes = [self._about.logical.concrete(one.row.values) for one in scenarios]
        # All are taken, so that the simulator clears up.
        for one, run in zip(scenarios, list(self._run(self._references[name], concretes)), strict=True):
            self.take(one, name, run)

    def take(self, one: Undecided, name: str, run: Recording | SimulationError) -> None:
        """Take what came of a scenario with a reference at the wheel.

        Parameters
        ----------
        one : Undecided
        name : str
            Of the reference.
        run : Recording or SimulationError
        """
        if isinstance(run, SimulationError):
            one.error = SimulationError(f"run again with reference:{name}: {run}")
        else:
            about = self._about
            one.outcomes[name] = judge_reference(name, run, one.recording, about.ego, about.others)
