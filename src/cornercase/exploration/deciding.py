"""Run scenarios again with a reference driver if the condition depends on it."""

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


@dataclass(eq=False)
class Undecided:
    """A finished scenario whose condition may depend on references.

    `courses` are the results by metric, `looked` is the condition evaluated without references, `outcomes` are the
    reference runs by name, `error` says why one of them failed.
    """

    row: Row
    recording: Recording
    courses: dict[str, Measured]
    looked: LookedAt
    outcomes: dict[str, ReferenceOutcome] = field(default_factory=dict)
    error: SimulationError | None = None

    @property
    def wanted(self) -> str | None:
        """Name of the reference to run next; None if none is needed."""
        return None if self.error is not None else self.looked.undecided(self._collides)

    @property
    def _collides(self) -> dict[str, bool | None]:
        return {name: outcome.collides for name, outcome in self.outcomes.items()}

    def decided(self) -> dict[str, Measured]:
        """Results by metric, with the score of the condition according to the references."""
        metric = self.looked.metric
        result, score = self.courses[metric.name], self.looked.score(self._collides)
        against = result.against if score < metric.cap else None
        return self.courses | {metric.name: Measured(result.course, score, against)}


class SecondRuns:
    """Runs scenarios again with reference drivers in the ego."""

    def __init__(
        self, configuration: Configuration, condition: CriticalIf, references: Mapping[str, Simulator], run: Run
    ) -> None:
        self._about, self._condition, self._references, self._run = configuration, condition, references, run

    def look(self, row: Row, recording: Recording, courses: dict[str, Measured]) -> Undecided:
        """Evaluate the condition without references."""
        return Undecided(row, recording, courses, self._condition.look(recording, self._about.ego, self._about.others))

    def decide(self, scenarios: Sequence[Undecided]) -> Iterator[Undecided]:
        """Run references until every condition is decided; yield each scenario when it is."""
        remaining = list(scenarios)
        while remaining:
            for name in dict.fromkeys(item.wanted for item in remaining):
                group = [item for item in remaining if item.wanted == name]
                if name is not None:
                    self._ask(name, group)
            yield from (item for item in remaining if item.wanted is None)
            remaining = [item for item in remaining if item.wanted is not None]

    def _ask(self, name: str, scenarios: Sequence[Undecided]) -> None:
        concretes = [self._about.logical.concrete(scenario.row.values) for scenario in scenarios]
        # Exhaust the iterator, so that the simulator cleans up.
        for scenario, run in zip(scenarios, list(self._run(self._references[name], concretes)), strict=True):
            self.take(scenario, name, run)

    def take(self, one: Undecided, name: str, run: Recording | SimulationError) -> None:
        """Record the run of a scenario with reference `name`."""
        if isinstance(run, SimulationError):
            one.error = SimulationError(f"run again with reference:{name}: {run}")
        else:
            config = self._about
            one.outcomes[name] = judge_reference(name, run, one.recording, config.ego, config.others)
