"""Run the scenarios of a probability estimate: draw them, simulate them and count events."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import groupby
from typing import Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.process.signals import collect_interrupts
from cornercase._common.progress import ProgressBar
from cornercase._common.row_keys import row_keys
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.evidence import Probability
from cornercase.evidence._probability import (
    conditional_probability,
    probability_from_enumeration,
    probability_from_weights,
)
from cornercase.evidence._rare_events import ImportanceSampling
from cornercase.exploration._config import ExplorationConfig
from cornercase.exploration._estimation import Estimation, EventOutcomes, describe_doubts, probability_from_direct_draws
from cornercase.exploration._runner import ScenarioRunner, StageTimer
from cornercase.metrics import METRICS
from cornercase.scenario import ParameterSpace
from cornercase.simulators import Simulator
from cornercase.study import ScenarioRecord, StudyFile

# Scenarios per round after learning.
_ROUND_SIZE: Final = 500
# Largest difference of a coordinate in the unit cube that is put down to rounding.
_POINT_TOLERANCE: Final = 1e-6
# Largest space that is listed, to check if the budget covers all scenarios within the constraints.
_MAX_ENUMERATED_SPACE: Final = 100_000


class ProbabilityEstimator:
    """Estimator of the probabilities of events, which draws and runs scenarios until the budget is used up.

    Each scenario is stored as soon as it has ended. An existing study is resumed. `sampling` must be new, since it
    first observes the results that the study holds. Two entities have an encounter if their gap is at most
    `encounter_gap` in m.
    """

    def __init__(
        self,
        config: ExplorationConfig,
        simulator: Simulator,
        sampling: ImportanceSampling,
        study: StudyFile,
        encounter_gap: float,
    ) -> None:
        self._config, self._sampling, self._study, self._encounter_gap = config, sampling, study, encounter_gap
        self._space, self._objective = config.logical.space, config.make_objective(needs_threshold=True)
        self._clearance = METRICS.create("clearance")
        self._clock = StageTimer(study)
        self._runner = ScenarioRunner(config, simulator, self._objective, study, self._clock)
        self._finished_rounds: list[tuple[str, list[ScenarioRecord], EventOutcomes]] = []
        # If all scenarios of the space are run: all of them, and the remaining ones.
        self._all_points = self._remaining_points = np.zeros((0, self._space.dimension))
        self._is_exhaustive = self._plan_exhaustive_run()
        self._n_total = len(study.rows()) + len(self._remaining_points) if self._is_exhaustive else None
        self._progress_label = ""

    def _plan_exhaustive_run(self) -> bool:
        """Plan to run all scenarios of a small space if the budget suffices, and return whether that is planned.

        The estimate is then exact.
        """
        rows, budget, size = self._study.rows(), self._config.budget, self._space.size
        if size is None or size > max(budget, _MAX_ENUMERATED_SPACE):
            return False
        lattice = self._space.full_factorial()
        lattice = lattice[self._space.is_admissible(lattice)]
        keys, row_keys_done = row_keys(self._space.snap(lattice)), self._row_keys(rows)
        done = set(row_keys_done)
        rest = lattice[[key not in done for key in keys]]
        if not len(rest) or len(rows) + len(rest) <= budget:
            self._all_points, self._remaining_points = lattice, rest
            return True
        if rows and row_keys_done == keys[: len(rows)]:
            raise InputError(
                f"{self._study.path}: this estimate runs all {len(lattice)} scenarios of the space; set `budget` to"
                f" {len(lattice)} or more."
            )
        return False

    def _row_keys(self, rows: Sequence[ScenarioRecord]) -> list[bytes]:
        return row_keys(self._space.snap(np.array([row.point for row in rows]).reshape(-1, self._space.dimension)))

    def run(self, progress: bool = False) -> Estimation:
        """Draw and run scenarios until the budget is used up; `progress` shows the estimated probability so far."""
        bar = ProgressBar(self._config.budget, "estimating", "scenarios") if progress else None
        interrupted = False
        try:
            with collect_interrupts() as check:
                self._run_rounds(bar, check)
        except KeyboardInterrupt:
            interrupted = True
        finally:
            if bar is not None:
                bar.stop()
            self._clock.save_times()
            self._runner.notices.issue_warnings()
        result = self._make_estimation(interrupted)
        self._save_estimation(result)
        return result

    def _save_estimation(self, estimation: Estimation) -> None:
        """Store the result, and the importance weights of the scenarios."""
        stage_name = "whole" if self._is_exhaustive else "estimate"
        rows = [row for stage, members, _ in self._finished_rounds if stage == stage_name for row in members]
        points, _ = self._collect_points_and_outcomes(stage_name)
        if rows:
            ids = np.array([row.id for row in rows])
            weights = (
                self._space.probabilities(points) if self._is_exhaustive else self._sampling.importance_weights(points)
            )
            if self._is_exhaustive:
                first_indices = self._first_occurrences(rows)
                ids, weights = ids[first_indices], weights[first_indices]
            self._study.writer.save_analysis("estimate", {"ids": ids, "weights": weights}, estimation.to_json())

    def _first_occurrences(self, rows: Sequence[ScenarioRecord]) -> IntArray:
        """Return the indices of scenarios that do not repeat an earlier scenario.

        Scenarios repeat if they were drawn at random before it was planned to run all scenarios of the space.
        """
        return np.sort(np.unique(np.array(self._row_keys(rows)), return_index=True)[1])

    def _run_rounds(self, bar: ProgressBar | None, check_interrupt: Callable[[], None]) -> None:
        rows = self._study.rows()
        for _, members in groupby(rows, key=lambda row: row.round):
            stored = list(members)
            self._check_draws(stored)
            self._run_round(stored, bar)
        done, number = len(rows), rows[-1].round if rows else 0
        while True:
            check_interrupt()
            if bar is not None:
                bar.update(done, self._progress_label, self._n_total)
            with self._clock("optimize"):
                points = self._next_points(done)
            if len(points) == 0:
                return
            number += 1
            with self._clock("store"):
                new = self._study.writer.add_pending(number, points, self._space.values(points))
            self._run_round(new, bar)
            done += len(new)
            self._clock.save_times()

    def _check_draws(self, rows: Sequence[ScenarioRecord]) -> None:
        """Raise `InputError` if the scenarios of a stored round are not those that the sampling draws.

        Their weights would be wrong.
        """
        if self._is_exhaustive:
            return
        stored, drawn = np.array([row.point for row in rows]), self._sampling.draw_round(len(rows))
        if stored.shape != drawn.shape or np.abs(stored - drawn).max() > _POINT_TOLERANCE:
            raise InputError(
                f"{self._study.path}: its round {rows[0].round} was drawn by another version of cornercase or of its"
                " libraries; write the estimate to another file."
            )

    def _next_points(self, n_done: int) -> FloatArray:
        """Return the points of the next round; empty if there is no further round."""
        if self._is_exhaustive:
            points, self._remaining_points = self._remaining_points[:_ROUND_SIZE], self._remaining_points[_ROUND_SIZE:]
            return points
        count = min(_ROUND_SIZE, self._config.budget - n_done)
        return self._sampling.draw_round(count) if count > 0 else np.zeros((0, self._space.dimension))

    def _run_round(self, rows: Sequence[ScenarioRecord], bar: ProgressBar | None) -> None:
        """Run the pending scenarios of a round, and learn from all scenarios of the round."""
        for number, _ in self._runner.run_and_score([row for row in rows if row.state == "pending"]):
            if bar is not None:
                bar.update(number, self._progress_label)
        self._runner.check_repeatability()
        rows_of_round = self._study.rows_of_round(rows[0].round)
        outcomes = self._read_outcomes(rows_of_round)
        stage = "whole" if self._is_exhaustive else self._sampling.next_stage
        self._finished_rounds.append((stage, rows_of_round, outcomes))
        if not self._is_exhaustive:
            points = np.array([row.point for row in rows_of_round])
            with self._clock("optimize"):
                self._sampling.record_round(points, outcomes.scores, outcomes.event_columns)
        probability = self._estimate_probability(lambda outcomes: outcomes.is_critical)
        if probability.met and probability.error is None:
            self._progress_label = f"critical {probability.low:.2g} to {probability.high:.2g}"
        else:
            self._progress_label = (
                f"critical {probability.value:.2g}" if probability.met else "looking for critical ones"
            )

    def _read_outcomes(self, rows: Sequence[ScenarioRecord]) -> EventOutcomes:
        """Read from the study which scenarios failed, are critical, have a collision, or have an encounter."""
        done = [row for row in rows if row.state == "done"]
        is_done = np.array([row.state == "done" for row in rows], dtype=np.bool_)
        scores = np.full(len(rows), np.nan)
        collision, encounter = np.zeros(len(rows), dtype=np.bool_), np.zeros(len(rows), dtype=np.bool_)
        if done:
            # The time series of a metric alone does not show contact; recordings are checked below.
            scores_by_metric = [self._study.scenario_scores(row.id) for row in done]
            raw_scores = [[values[metric.name] for metric in self._objective.metrics] for values in scores_by_metric]
            scores[is_done] = self._objective.compute_scores_to_minimize(np.array(raw_scores))
        ego, others = self._config.ego, self._config.others
        with self._clock("measure"):
            for k, row in zip(np.flatnonzero(is_done).tolist(), done, strict=True):
                recording = self._study.recording(row.id)
                collision[k] = any(recording.first_collision(ego, other) is not None for other in others)
                courses = [self._clearance.course(recording, ego, other) for other in others]
                # Scores are capped, and entities that never exist together have none.
                encounter[k] = any((course <= self._encounter_gap).any() for course in courses)
        return EventOutcomes(scores, self._objective.critical_mask(scores), collision, encounter)

    def _collect_points_and_outcomes(self, *stages: str) -> tuple[FloatArray, EventOutcomes]:
        """Return the points and outcomes of all rounds in the given stages.

        The stages are "law" (drawn from the distributions of the parameters), "learn", "estimate", and "whole" (all
        scenarios of the space).
        """
        selected = [(rows, outcomes) for stage, rows, outcomes in self._finished_rounds if stage in stages]
        points = [row.point for rows, _ in selected for row in rows]
        return np.array(points).reshape(-1, self._space.dimension), EventOutcomes.concatenate(
            [part for _, part in selected]
        )

    def _estimate_probability(self, event: Callable[[EventOutcomes], BoolArray]) -> Probability:
        """Estimate the probability of an event, for which `event` returns a bool for each scenario."""
        points, outcomes = self._collect_points_and_outcomes("whole" if self._is_exhaustive else "estimate")
        if self._is_exhaustive:
            first_indices = self._first_occurrences([row for _, rows, _ in self._finished_rounds for row in rows])
            other_share = (
                float(self._space.probabilities(self._all_points).sum())
                if len(first_indices) < len(self._all_points)
                else None
            )
            return probability_from_enumeration(
                self._space.probabilities(points)[first_indices], event(outcomes)[first_indices], other_share
            )
        if len(points) and self._sampling.is_plain_after_learning:
            return probability_from_direct_draws(event(outcomes))
        if not len(points) or not event(outcomes).any():
            # Only the draws from the space's own distribution give a bound.
            _, outcomes = self._collect_points_and_outcomes("law")
            return probability_from_direct_draws(event(outcomes))
        return probability_from_weights(
            self._sampling.importance_weights(points), event(outcomes), self._sampling.common_weight_error
        )

    def _make_estimation(self, interrupted: bool) -> Estimation:
        """Create the result from the scenarios so far."""
        _, law = self._collect_points_and_outcomes("whole" if self._is_exhaustive else "law")
        _, all_outcomes = self._collect_points_and_outcomes("law", "learn", "estimate", "whole")
        # Plain draws count for the estimate, even those of the first round.
        _, learned = self._collect_points_and_outcomes(*(() if self._sampling.is_plain else ("law", "learn")))
        # Usually the first draws count, as they bound the probability of an event that no later draw met.
        _, uncounted = self._collect_points_and_outcomes(
            *(("law", "learn") if self._sampling.is_plain_after_learning else ("learn",))
        )
        n_counting = len(all_outcomes.scores) - len(uncounted.scores)
        critical = self._estimate_probability(lambda outcomes: outcomes.is_critical)
        collision = self._estimate_probability(lambda outcomes: outcomes.has_collision)
        encounter = (
            self._estimate_probability(lambda outcomes: outcomes.has_encounter)
            if self._is_exhaustive
            else probability_from_direct_draws(law.has_encounter)
        )
        warnings = []
        if not self._is_exhaustive:
            direct_estimates = (
                (critical, collision)
                if self._sampling.is_plain_after_learning
                else map(probability_from_direct_draws, (law.is_critical, law.has_collision))
            )
            for event, estimate, direct, occurred in zip(
                ("critical scenario", "collision"),
                (critical, collision),
                direct_estimates,
                (uncounted.is_critical, uncounted.has_collision),
                strict=True,
            ):
                warnings += describe_doubts(event, estimate, direct, n_counting, int(occurred.sum()))
        if self._sampling.is_plain:
            warnings.insert(0, _NO_DIRECTION)
        elif self._sampling.is_plain_after_learning:
            warnings.insert(0, _WRONG_DIRECTION)
        if note := _explain_uniform_probabilities(self._study.meta.space):
            warnings.insert(0, note)
        if failed := int(all_outcomes.is_failed.sum()):
            warnings.append(f"{failed} scenarios failed and count as neither critical nor a collision.")
        return Estimation(
            study=self._study.path,
            criterion=f"{self._objective.label} {self._objective.criterion}",
            encounter_gap=self._encounter_gap,
            critical=critical,
            collision=collision,
            encounter=encounter,
            critical_given_encounter=conditional_probability(
                self._estimate_probability(lambda outcomes: outcomes.is_critical & outcomes.has_encounter), encounter
            ),
            collision_given_encounter=conditional_probability(
                self._estimate_probability(lambda outcomes: outcomes.has_collision & outcomes.has_encounter), encounter
            ),
            scenarios=len(all_outcomes.scores),
            n_learning=len(learned.scores),
            failed=failed,
            warnings=tuple(warnings),
            interrupted=interrupted,
        )


_NO_DIRECTION: Final = (
    "The scores take at most two values and do not show where critical scenarios are, so all scenarios were drawn from"
    " the distributions themselves (plain Monte Carlo). A metric that varies tells more with as many."
)
_WRONG_DIRECTION: Final = (
    "What was learned met critical scenarios and collisions no more often than the distributions themselves, so all"
    " scenarios that count were drawn from the distributions (plain Monte Carlo). If critical scenarios are rare,"
    " another metric may tell more with as many."
)


def _explain_uniform_probabilities(space: ParameterSpace) -> str:
    """Describe what probabilities mean if no parameter has a distribution; empty if a parameter has one."""
    if any(parameter.distribution is not None for parameter in space.parameters):
        return ""
    count = len(space.parameters)
    which = "The only parameter is" if count == 1 else f"All {count} parameters are"
    return f"{which} uniform: probabilities are shares of the space, no frequency in traffic."
