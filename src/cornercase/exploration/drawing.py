"""Draw, run and count the scenarios of a probability estimate."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import groupby
from typing import Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.interrupts import noted_interrupts
from cornercase._common.progress import ProgressBar
from cornercase._common.rows import row_keys
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.evidence import ImportanceSampling, Probability, of_all, of_weights, quotient
from cornercase.exploration.configuration import Configuration
from cornercase.exploration.estimation import Estimation, Outcomes, of_law, warnings_of
from cornercase.exploration.objective import Objective
from cornercase.exploration.running import ScenarioRunner, StageClock
from cornercase.metrics import METRICS
from cornercase.simulators import Simulator
from cornercase.study import Row, Study

# Scenarios per round after learning.
_ROUND: Final = 500
# Largest space that is listed, to check if the budget covers all scenarios within the constraints.
_MOST_LISTED: Final = 100_000


class ProbabilityEstimator:
    """Draws and runs scenarios until the budget is used up, and estimates probabilities of events.

    Each scenario is stored as soon as it has ended; an existing study is resumed. `sampling` has to be a fresh one: it
    is told what the study contains. `within` is the gap in m up to which two entities have an encounter.
    """

    def __init__(
        self,
        configuration: Configuration,
        simulator: Simulator,
        sampling: ImportanceSampling,
        study: Study,
        within: float,
    ) -> None:
        self._about, self._sampling, self._study, self._within = configuration, sampling, study, within
        self._space, self._objective = configuration.logical.space, configuration.objective()
        self._threshold = self._objective.threshold(configuration.critical)
        self._clearance = METRICS.create("clearance")
        self._clock = StageClock(study)
        self._runner = ScenarioRunner(configuration, simulator, self._objective, study, self._clock)
        self._stages: list[tuple[str, list[Row], Outcomes]] = []
        # If all scenarios of the space are run: all of them, and the remaining ones.
        self._every = self._rest = np.zeros((0, self._space.dimension))
        self._whole = self._runs_all()
        self._total = len(study.rows()) + len(self._rest) if self._whole else None
        self._word = ""

    def _runs_all(self) -> bool:
        """Return whether the budget covers all scenarios of a small space; the result is then exact."""
        rows, budget, size = self._study.rows(), self._about.budget, self._space.size
        if size is None or size > max(budget, _MOST_LISTED):
            return False
        lattice = self._space.lattice()
        lattice = lattice[self._space.admits(lattice)]
        keys, row_keys_done = row_keys(self._space.snap(lattice)), self._keys(rows)
        done = set(row_keys_done)
        rest = lattice[[key not in done for key in keys]]
        if not len(rest) or len(rows) + len(rest) <= budget:
            self._every, self._rest = lattice, rest
            return True
        if rows and row_keys_done == keys[: len(rows)]:
            raise InputError(
                f"{self._study.path}: enumerates all {len(lattice)} scenarios of the space; set `budget` to"
                f" {len(lattice)} or more."
            )
        return False

    def _keys(self, rows: Sequence[Row]) -> list[bytes]:
        return row_keys(self._space.snap(np.array([row.point for row in rows]).reshape(-1, self._space.dimension)))

    def run(self, progress: bool = False) -> Estimation:
        """Draw and run scenarios until the budget is used up; `progress` shows the probability so far."""
        bar = ProgressBar(self._about.budget, "estimating", "scenarios") if progress else None
        interrupted = False
        try:
            with noted_interrupts() as check:
                self._run(bar, check)
        except KeyboardInterrupt:
            interrupted = True
        finally:
            if bar is not None:
                bar.stop()
            self._clock.note()
            self._runner.notices.warn()
        result = self._found(interrupted)
        self._save(result)
        return result

    def _save(self, found: Estimation) -> None:
        """Store the result and the weights of its scenarios."""
        stage_name = "whole" if self._whole else "estimate"
        rows = [row for stage, members, _ in self._stages if stage == stage_name for row in members]
        points, _ = self._of(stage_name)
        if rows:
            ids = np.array([row.id for row in rows])
            weights = self._space.shares(points) if self._whole else self._sampling.weights(points)
            if self._whole:
                first_indices = self._once(rows)
                ids, weights = ids[first_indices], weights[first_indices]
            self._study.writer.save_analysis("estimate", {"ids": ids, "weights": weights}, found.to_json())

    def _once(self, rows: Sequence[Row]) -> IntArray:
        """Indices of the first occurrence of each scenario; draws from before all were run may repeat."""
        return np.sort(np.unique(np.array(self._keys(rows)), return_index=True)[1])

    def _run(self, bar: ProgressBar | None, check_interrupt: Callable[[], None]) -> None:
        rows = self._study.rows()
        for _, members in groupby(rows, key=lambda row: row.round):
            self._take(list(members), bar)
        done, number = len(rows), rows[-1].round if rows else 0
        while True:
            check_interrupt()
            if bar is not None:
                bar.update(done, self._word, self._total)
            with self._clock("optimize"):
                points = self._points(done)
            if len(points) == 0:
                return
            number += 1
            with self._clock("store"):
                new = self._study.writer.propose(number, points, self._space.values(points))
            self._take(new, bar)
            done += len(new)
            self._clock.note()

    def _points(self, done: int) -> FloatArray:
        """Points of the next round; empty when done."""
        if self._whole:
            points, self._rest = self._rest[:_ROUND], self._rest[_ROUND:]
            return points
        count = min(_ROUND, self._about.budget - done)
        return self._sampling.ask(count) if count > 0 else np.zeros((0, self._space.dimension))

    def _take(self, rows: Sequence[Row], bar: ProgressBar | None) -> None:
        """Run the pending scenarios of a round, and learn from all of it."""
        for number, _ in self._runner.run([row for row in rows if row.state == "pending"]):
            if bar is not None:
                bar.update(number, self._word)
        self._runner.try_repeatability()
        rows_of_round = self._study.rows_of(rows[0].round)
        outcomes = self._outcomes(rows_of_round)
        stage = "whole" if self._whole else self._sampling.stage
        self._stages.append((stage, rows_of_round, outcomes))
        if not self._whole:
            points = np.array([row.point for row in rows_of_round])
            with self._clock("optimize"):
                self._sampling.tell(points, outcomes.scores, outcomes.events)
        probability = self._probability(lambda outcomes: outcomes.critical)
        if probability.met and probability.error is None:
            self._word = f"critical {probability.low:.2g} to {probability.high:.2g}"
        else:
            self._word = f"critical {probability.value:.2g}" if probability.met else "looking for critical ones"

    def _outcomes(self, rows: Sequence[Row]) -> Outcomes:
        """Read the outcomes of scenarios."""
        done = [row for row in rows if row.state == "done"]
        is_done = np.array([row.state == "done" for row in rows], dtype=np.bool_)
        scores = np.full(len(rows), np.nan)
        collision, encounter = np.zeros(len(rows), dtype=np.bool_), np.zeros(len(rows), dtype=np.bool_)
        if done:
            # The time series of a metric alone does not show contact; recordings are checked below.
            scores_by_metric = [self._study.scores_of(row.id) for row in done]
            raw_scores = [[values[metric.name] for metric in self._objective.metrics] for values in scores_by_metric]
            scores[is_done] = self._objective.oriented(np.array(raw_scores))
        ego, others = self._about.ego, self._about.others
        with self._clock("measure"):
            for k, row in zip(np.flatnonzero(is_done).tolist(), done, strict=True):
                recording = self._study.recording(row.id)
                collision[k] = any(recording.first_collision(ego, other) is not None for other in others)
                gaps = [self._clearance.score(self._clearance.course(recording, ego, other)) for other in others]
                encounter[k] = min(gaps) <= self._within
        return Outcomes(scores, scores <= self._threshold, collision, encounter)

    def _of(self, *stages: str) -> tuple[FloatArray, Outcomes]:
        """Points and outcomes of all rounds of some stages."""
        selected = [(rows, outcomes) for stage, rows, outcomes in self._stages if stage in stages]
        points = [row.point for rows, _ in selected for row in rows]
        return np.array(points).reshape(-1, self._space.dimension), Outcomes.joined([part for _, part in selected])

    def _probability(self, event: Callable[[Outcomes], BoolArray]) -> Probability:
        """Estimate the probability of an event from the draws."""
        points, outcomes = self._of("whole" if self._whole else "estimate")
        if self._whole:
            first_indices = self._once([row for _, rows, _ in self._stages for row in rows])
            other_share = (
                float(self._space.shares(self._every).sum()) if len(first_indices) < len(self._every) else None
            )
            return of_all(self._space.shares(points)[first_indices], event(outcomes)[first_indices], other_share)
        if not len(points) or not event(outcomes).any():
            # Only the draws from the space's own distribution give a bound.
            _, outcomes = self._of("law")
            return of_law(event(outcomes))
        return of_weights(self._sampling.weights(points), event(outcomes), self._sampling.weights_error)

    def _found(self, interrupted: bool) -> Estimation:
        """Create the result from the scenarios so far."""
        _, law = self._of("whole" if self._whole else "law")
        _, all_outcomes = self._of("law", "learn", "estimate", "whole")
        _, learned = self._of("law", "learn")
        critical = self._probability(lambda outcomes: outcomes.critical)
        collision = self._probability(lambda outcomes: outcomes.collision)
        encounter = self._probability(lambda outcomes: outcomes.encounter) if self._whole else of_law(law.encounter)
        warnings = [] if self._whole else [
            *warnings_of("critical scenario", critical, of_law(law.critical)),
            *warnings_of("collision", collision, of_law(law.collision)),
        ]  # fmt: skip
        if failed := int(all_outcomes.failed.sum()):
            warnings.append(f"{failed} scenarios failed and count as neither critical nor a collision.")
        return Estimation(
            study=self._study.path,
            criterion=self._criterion(),
            within=self._within,
            critical=critical,
            collision=collision,
            encounter=encounter,
            critical_given_encounter=quotient(
                self._probability(lambda outcomes: outcomes.critical & outcomes.encounter), encounter
            ),
            collision_given_encounter=quotient(
                self._probability(lambda outcomes: outcomes.collision & outcomes.encounter), encounter
            ),
            scenarios=len(all_outcomes.scores),
            learned=len(learned.scores),
            failed=failed,
            warnings=tuple(warnings),
            interrupted=interrupted,
        )

    def _criterion(self) -> str:
        objective: Objective = self._objective
        value = objective.flip(self._threshold)
        return f"{objective.text} {'<=' if objective.lower_is_critical else '>='} {value:g} {objective.unit}".rstrip()
