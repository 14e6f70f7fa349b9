"""Repeated runs of a scenario, with extra runs as long as they do not show whether the scenario is critical."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from cornercase._common.errors import SimulationError
from cornercase._common.typing import FloatArray
from cornercase.exploration._config import ExplorationConfig
from cornercase.metrics._measure import MetricResult, evaluate_metrics
from cornercase.recordings import Recording
from cornercase.study import ScenarioRecord
from cornercase.study._critical_run_rates import is_criticality_undecided
from cornercase.study._objective import Objective


@dataclass(eq=False)
class RepeatedScenario:
    """A scenario and its runs so far.

    `n_requested` is the number of runs to do next, 0 for none. `n_done` is the number of runs done, including failed
    ones. `runs` has the recording and the results by metric of each successful run. `error` is the error of the first
    failed run.
    """

    row: ScenarioRecord
    n_requested: int
    n_done: int = 0
    runs: list[tuple[Recording, dict[str, MetricResult]]] = field(default_factory=list)
    error: SimulationError | None = None


class RepeatPolicy:
    """Rule for how often a scenario is run.

    Each scenario is run `repeats` times. With `max_repeats`, a scenario gets `repeats` further runs at a time, up to
    `max_repeats` runs in all, while its runs do not show whether it is critical (`is_criticality_undecided`). If all
    runs failed, there are no further runs.
    """

    def __init__(self, config: ExplorationConfig, objective: Objective) -> None:
        self._config, self._objective = config, objective

    def request_first_runs(self, row: ScenarioRecord) -> RepeatedScenario:
        """Create the record of a scenario that has not been run; its first `repeats` runs are requested."""
        return RepeatedScenario(row, self._config.repeats)

    def record_outcomes(self, repeated_run: RepeatedScenario, outcomes: Sequence[Recording | SimulationError]) -> None:
        """Measure finished runs, and set how many more are needed."""
        config = self._config
        for outcome in outcomes:
            try:
                if isinstance(outcome, SimulationError):
                    raise outcome
                repeated_run.runs.append(
                    (outcome, evaluate_metrics(self._objective.metrics, outcome, config.ego, config.others))
                )
            except SimulationError as error:
                repeated_run.error = repeated_run.error or error
        repeated_run.n_done += len(outcomes)
        repeated_run.n_requested = self._count_further_runs(repeated_run)

    def minimized_scores(self, repeated_run: RepeatedScenario) -> FloatArray:
        """Return the scores of n successful runs; lower scores are more critical.

        The shape is (n,), or (n, k) for a Pareto front of k metrics.
        """
        return self._objective.compute_scores_to_minimize(
            np.array([[result.score for result in run.values()] for _, run in repeated_run.runs])
        )

    def _count_further_runs(self, repeated_run: RepeatedScenario) -> int:
        limit, criterion = self._config.max_repeats, self._objective.criterion
        if limit is None or criterion is None or not repeated_run.runs:
            return 0
        n_more = min(self._config.repeats, limit - repeated_run.n_done)
        is_undecided = is_criticality_undecided(self.minimized_scores(repeated_run).tolist(), criterion)
        return n_more if is_undecided else 0
