"""Runs in which a reference driver drives the ego, for conditions that depend on reference drivers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from cornercase._common.errors import SimulationError
from cornercase.drivers.references.r157._preventability import ReferenceOutcome, assess_preventability
from cornercase.exploration._config import ExplorationConfig
from cornercase.metrics import CriticalIf
from cornercase.metrics._critical_if import ConditionState
from cornercase.metrics._measure import MetricResult
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import Simulator
from cornercase.study import ScenarioRecord

SimulateScenarios = Callable[[Simulator, Sequence[ConcreteScenario]], Iterator[Recording | SimulationError]]


@dataclass(eq=False)
class PendingCondition:
    """A scenario that has been run, but whose condition may still depend on runs with reference drivers.

    `results` has the results by name of the metric. `condition_state` is the condition evaluated without reference
    drivers. `reference_outcomes` has the outcomes of the runs with reference drivers, by name of the driver. `error` is
    the error of a run that failed.
    """

    row: ScenarioRecord
    recording: Recording
    results: dict[str, MetricResult]
    condition_state: ConditionState
    reference_outcomes: dict[str, ReferenceOutcome] = field(default_factory=dict)
    error: SimulationError | None = None

    @property
    def next_reference(self) -> str | None:
        """Name of the reference driver to run next; None if none is needed."""
        return (
            None
            if self.error is not None
            else self.condition_state.next_reference_to_run(self._collisions_by_reference)
        )

    @property
    def _collisions_by_reference(self) -> dict[str, bool | None]:
        return {name: outcome.collides for name, outcome in self.reference_outcomes.items()}

    def decided_results(self) -> dict[str, MetricResult]:
        """Return the results by metric; the score of the condition includes the runs with reference drivers."""
        metric = self.condition_state.metric
        result, score = self.results[metric.name], self.condition_state.score(self._collisions_by_reference)
        against = result.against if score < metric.cap else None
        return self.results | {metric.name: MetricResult(result.course, score, against)}


def make_scenario_for_reference_driver(config: ExplorationConfig, row: ScenarioRecord) -> ConcreteScenario:
    """Return the scenario to run with a reference driver, without varied parameters of the ego's own driver."""
    return config.concrete_scenario(row.values, config.seed).without_driver_parameters(config.ego)


class ReferenceRuns:
    """Runner that repeats scenarios with a reference driver in place of the ego's driver."""

    def __init__(
        self,
        config: ExplorationConfig,
        condition: CriticalIf,
        references: Mapping[str, Simulator],
        simulate: SimulateScenarios,
    ) -> None:
        self._config, self._condition, self._references, self._simulate = config, condition, references, simulate

    def evaluate_condition(
        self, row: ScenarioRecord, recording: Recording, results: dict[str, MetricResult]
    ) -> PendingCondition:
        """Evaluate the condition of a finished scenario, as far as that is possible without reference drivers."""
        return PendingCondition(
            row, recording, results, self._condition.evaluate(recording, self._config.ego, self._config.others)
        )

    def decide_conditions(self, scenarios: Sequence[PendingCondition]) -> Iterator[PendingCondition]:
        """Run reference drivers until all conditions are decided; yield each scenario as soon as this is so."""
        remaining = list(scenarios)
        while remaining:
            for name in dict.fromkeys(item.next_reference for item in remaining):
                group = [item for item in remaining if item.next_reference == name]
                if name is not None:
                    self._run_reference(name, group)
            yield from (item for item in remaining if item.next_reference is None)
            remaining = [item for item in remaining if item.next_reference is not None]

    def _run_reference(self, reference: str, scenarios: Sequence[PendingCondition]) -> None:
        concretes = [make_scenario_for_reference_driver(self._config, scenario.row) for scenario in scenarios]
        # Exhaust the iterator, so that the simulator cleans up.
        for scenario, run in zip(scenarios, list(self._simulate(self._references[reference], concretes)), strict=True):
            self.record_reference_run(scenario, reference, run)

    def record_reference_run(
        self, scenario: PendingCondition, reference: str, outcome: Recording | SimulationError
    ) -> None:
        """Record the outcome of a run with the driver `reference`."""
        if isinstance(outcome, SimulationError):
            scenario.error = SimulationError(f"run again with reference:{reference}: {outcome}")
        else:
            config = self._config
            scenario.reference_outcomes[reference] = assess_preventability(
                reference, outcome, scenario.recording, config.ego, config.others
            )
