"""Search without rounds: as soon as a scenario has ended, the optimizer proposes the next one."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from functools import partial
from typing import Any

import numpy as np

from cornercase._common.progress import ProgressBar
from cornercase._common.typing import FloatArray
from cornercase.exploration._config import ExplorationConfig
from cornercase.exploration._explorer import ScenarioExplorer
from cornercase.exploration._proposals import iter_rounds
from cornercase.exploration._reference_driver_runs import PendingCondition, make_scenario_for_reference_driver
from cornercase.exploration._repeat_policy import RepeatedScenario
from cornercase.optimizers import Optimizer
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import Simulator
from cornercase.simulators._executor import SimulatorExecutor
from cornercase.study import ScenarioRecord, StudyFile
from cornercase.study._objective import Objective


def max_pending_scenarios(n_parallel: int) -> int:
    """Return how many scenarios are in progress at the same time, for `n_parallel` parallel simulators.

    A single simulator gets one scenario, so that each proposal is based on all results. With several simulators, the
    number is 1.5 times `n_parallel`, rounded up, so that no simulator has to wait.
    """
    return n_parallel if n_parallel == 1 else n_parallel + -(-n_parallel // 2)


class AsynchronousExplorer(ScenarioExplorer):
    """Explorer that searches a logical scenario without rounds.

    When a scenario has ended, the optimizer observes all results that have arrived, and proposes another scenario. The
    study stores the order of the results. A killed search is resumed identically: the optimizer observes the results in
    this order, and pending scenarios run first. The parameters are the same as for `ScenarioExplorer`.
    """

    def __init__(
        self,
        config: ExplorationConfig,
        simulator: Simulator,
        optimizer: Optimizer,
        study: StudyFile,
        objective: Objective | None = None,
        references: Mapping[str, Simulator] | None = None,
    ) -> None:
        super().__init__(config, simulator, optimizer, study, objective, references)
        self._simulators = {"": simulator, **(references or {})}
        if config.patience is not None:
            self._patience, self._patience_unit = config.patience * config.batch, "scenarios"
        # By scenario id: scenarios in progress, their runs, and conditions that need a run with a reference driver.
        # After that: results that the optimizer has not observed yet.
        self._pending: dict[int, ScenarioRecord] = {}
        self._repeated_runs: dict[int, RepeatedScenario] = {}
        self._pending_conditions: dict[int, PendingCondition] = {}
        self._new_results: list[ScenarioRecord] = []
        self._new_scores: dict[int, Any] = {}

    def _run_until_stop(self, bar: ProgressBar | None, check_interrupt: Callable[[], None]) -> str:
        """Run scenarios until the search ends, then check if runs are deterministic; return why the search ended."""
        reason = self._run_without_rounds(bar, check_interrupt)
        self._runner.check_repeatability()
        return reason

    def _run_without_rounds(self, bar: ProgressBar | None, check_interrupt: Callable[[], None]) -> str:
        """Run scenarios until a termination criterion holds and all runs have ended; return the criterion as text."""
        start, reason = time.monotonic(), None
        with closing(SimulatorExecutor(self._simulators)) as stream:
            proposed, number = self._resume_without_rounds(stream)
            while True:
                if bar is not None:
                    bar.update(proposed - len(self._pending), self._incumbent.label)
                n_free = max_pending_scenarios(stream.count_parallel()) - len(self._pending)
                if reason is None and n_free > 0:
                    self._tell_new_results()
                    reason = self._stop_reason(proposed, time.monotonic() - start)
                if reason is None and n_free > 0:
                    rows = self._propose_next(number + 1, proposed, min(n_free, self._config.budget - proposed))
                    if rows:
                        self._submit_rows(stream, rows)
                        proposed, number = proposed + len(rows), number + 1
                    else:
                        reason = self._exhausted_reason(proposed)
                if not self._pending:
                    self._tell_new_results()
                    assert reason is not None
                    return reason
                self._wait_for_result(stream, check_interrupt)
                # Collect results that arrived meanwhile.
                while self._pending and stream.has_result:
                    self._wait_for_result(stream, check_interrupt)
                self._clock.save_times()

    def _resume_without_rounds(self, stream: SimulatorExecutor) -> tuple[int, int]:
        """Pass the stored results to the optimizer in their order, and submit pending scenarios.

        Returns the number of stored scenarios, and the number of the last round: scenarios that are proposed together
        count as a round.
        """
        rows = self._study.rows()
        minimized = self._objective.minimized_scores(self._study)
        scores = dict(zip((row.id for row in rows if row.state == "done"), minimized, strict=True))
        for turn in iter_rounds(self._study):
            if not turn.proposed:
                # The optimizer observes these results together with further ones, before the next round.
                self._new_results, self._new_scores = list(turn.finished), scores
                break
            if turn.finished:
                self._tell_round(list(turn.finished), scores)
            if self._optimizer.is_stateful_ask and (searched := self._select_rows_without_audits(turn.proposed)):
                self._ask_tell.pending = self._points_without_audits(turn.pending)
                self._ask_tell.ask(len(searched))
        pending = [row for row in rows if row.state == "pending"]
        if not pending:
            # The search had ended, and scenarios that were still running at that time have given results since.
            self._stopping.request_check()
        self._submit_rows(stream, pending)
        return len(rows), rows[-1].round if rows else 0

    def _propose_next(self, round_number: int, n_proposed: int, n_wanted: int) -> list[ScenarioRecord]:
        self._ask_tell.pending = self._points_without_audits(list(self._pending.values()))
        return self._propose_round(round_number, n_proposed, n_wanted)

    def _select_rows_without_audits(self, rows: Sequence[ScenarioRecord]) -> list[ScenarioRecord]:
        return [row for row in rows if not self._study.meta.is_audit(row.id)]

    def _submit_rows(self, stream: SimulatorExecutor, rows: Sequence[ScenarioRecord]) -> None:
        for row in rows:
            self._pending[row.id] = row
            self._submit_scenario(stream, self._runner.request_first_runs(row))

    def _submit_scenario(self, stream: SimulatorExecutor, repeated_run: RepeatedScenario) -> None:
        self._repeated_runs[repeated_run.row.id] = repeated_run
        stream.submit(
            repeated_run.row.id,
            partial(self._simulate_in_thread, self._runner.requested_concrete_scenarios(repeated_run)),
        )

    def _simulate_in_thread(self, concretes: Sequence[ConcreteScenario], simulator: Simulator) -> list[Any]:
        """Run scenarios in a worker thread, where no other state of the search may be used."""
        return list(self._runner.simulate(simulator, concretes))

    def _wait_for_result(self, stream: SimulatorExecutor, check_interrupt: Callable[[], None]) -> None:
        """Wait until runs of a scenario end; store its result, or submit further runs if the scenario needs them."""
        with self._clock("simulate"):
            key, outcomes = stream.wait_for_result(check_interrupt)
        row = self._pending[key]
        if row.id in self._pending_conditions:
            result: Any = self._pending_conditions.pop(row.id)
            self._runner.record_reference_run(result, outcomes[0])
        else:
            result = self._runner.record_outcomes(self._repeated_runs.pop(row.id), outcomes)
        if isinstance(result, RepeatedScenario):
            self._submit_scenario(stream, result)
            return
        if isinstance(result, PendingCondition) and result.next_reference is not None:
            self._pending_conditions[row.id] = result
            stream.submit(
                row.id,
                partial(self._simulate_in_thread, [make_scenario_for_reference_driver(self._config, row)]),
                result.next_reference,
            )
            return
        score = self._runner.store_decided(result) if isinstance(result, PendingCondition) else result
        if score is not None:
            self._new_scores[row.id] = score
        self._new_results.append(self._pending.pop(row.id))
        self._runner.require_any_result()

    def _tell_new_results(self) -> None:
        """Pass new results to the optimizer in the order of their arrival."""
        if self._new_results:
            self._tell_round(self._new_results, self._new_scores)
        self._new_results, self._new_scores = [], {}

    def _update_patience(self, scores: FloatArray) -> None:
        for score in scores:
            self._n_without_improvement = 0 if self._incumbent.update(score[None]) else self._n_without_improvement + 1

    def _points_without_audits(self, rows: Sequence[ScenarioRecord]) -> FloatArray:
        """Return the points, shape (p, d), of scenarios except audits (scenarios drawn at random as a check)."""
        return np.array([row.point for row in self._select_rows_without_audits(rows)]).reshape(
            -1, self._space.dimension
        )
