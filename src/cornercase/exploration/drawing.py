"""Scenarios of an estimate, drawn, run, and counted."""

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

# Scenarios in a round once it is known where to draw; of a kill at most what was running is lost all the same.
_ROUND: Final = 500
# Scenarios of a space up to which it is looked at whether all that its constraints leave may be run.
_MOST_LISTED: Final = 100_000


class ProbabilityEstimator:
    """Draws scenarios until the budget is used up, and says how probable what came out of them is.

    Each scenario is stored the moment it has ended; an estimator that is given a study goes on where that one stopped.

    Parameters
    ----------
    configuration : Configuration
    simulator : Simulator
    sampling : ImportanceSampling
        A fresh one: it is told what the study holds.
    study : Study
        Open for writing.
    within : float
        Gap in m up to which two entities have an encounter.
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
        # All scenarios of the space where all are run, and those of them that were not yet.
        self._every = self._rest = np.zeros((0, self._space.dimension))
        self._whole = self._runs_all()
        self._total = len(study.rows()) + len(self._rest) if self._whole else None
        self._word = ""

    def _runs_all(self) -> bool:
        """Whether the budget is for all scenarios of a small space: then they say it without error."""
        rows, budget, size = self._study.rows(), self._about.budget, self._space.size
        if size is None or size > max(budget, _MOST_LISTED):
            return False
        every = self._space.lattice()
        every = every[self._space.admits(every)]
        keys, begun = row_keys(self._space.snap(every)), self._keys(rows)
        ran = set(begun)
        rest = every[[key not in ran for key in keys]]
        if not len(rest) or len(rows) + len(rest) <= budget:
            self._every, self._rest = every, rest
            return True
        if rows and begun == keys[: len(rows)]:
            raise InputError(
                f"{self._study.path}: runs all {len(every)} scenarios of the space one after the other; give `budget`"
                f" {len(every)} or more."
            )
        return False

    def _keys(self, rows: Sequence[Row]) -> list[bytes]:
        return row_keys(self._space.snap(np.array([row.point for row in rows]).reshape(-1, self._space.dimension)))

    def run(self, progress: bool = False) -> Estimation:
        """Draw and run scenarios until the budget is used up.

        Parameters
        ----------
        progress : bool, default False
            Show a bar with the probability so far; lines instead where there is no terminal.

        Returns
        -------
        Estimation
        """
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
        found = self._found(interrupted)
        self._save(found)
        return found

    def _save(self, found: Estimation) -> None:
        """Keep the result, and how much each scenario that it was found from counts."""
        counting = "whole" if self._whole else "estimate"
        rows = [row for stage, members, _ in self._stages if stage == counting for row in members]
        points, _ = self._of(counting)
        if rows:
            ids = np.array([row.id for row in rows])
            weights = self._space.shares(points) if self._whole else self._sampling.weights(points)
            if self._whole:
                once = self._once(rows)
                ids, weights = ids[once], weights[once]
            self._study.writer.save_analysis("estimate", {"ids": ids, "weights": weights}, found.to_json())

    def _once(self, rows: Sequence[Row]) -> IntArray:
        """Where each scenario is for the first time: what was drawn before all were run may have come again."""
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
        """Points of the next round; none once all are run."""
        if self._whole:
            new, self._rest = self._rest[:_ROUND], self._rest[_ROUND:]
            return new
        most = min(_ROUND, self._about.budget - done)
        return self._sampling.ask(most) if most > 0 else np.zeros((0, self._space.dimension))

    def _take(self, rows: Sequence[Row], bar: ProgressBar | None) -> None:
        """Run what of a round was not run yet, and learn from all of it."""
        for number, _ in self._runner.run([row for row in rows if row.state == "pending"]):
            if bar is not None:
                bar.update(number, self._word)
        self._runner.try_repeatability()
        ended = self._study.rows_of(rows[0].round)
        outcomes = self._outcomes(ended)
        stage = "whole" if self._whole else self._sampling.stage
        self._stages.append((stage, ended, outcomes))
        if not self._whole:
            points = np.array([row.point for row in ended])
            with self._clock("optimize"):
                self._sampling.tell(points, outcomes.scores, outcomes.events)
        found = self._probability(lambda one: one.critical)
        if found.met and found.error is None:
            self._word = f"critical {found.low:.2g} to {found.high:.2g}"
        else:
            self._word = f"critical {found.value:.2g}" if found.met else "looking for critical ones"

    def _outcomes(self, rows: Sequence[Row]) -> Outcomes:
        """Read what came out of scenarios."""
        done = [row for row in rows if row.state == "done"]
        known = np.array([row.state == "done" for row in rows], dtype=np.bool_)
        scores = np.full(len(rows), np.nan)
        collision, encounter = np.zeros(len(rows), dtype=np.bool_), np.zeros(len(rows), dtype=np.bool_)
        if done:
            # A course alone does not say that both touch.
            each = [self._study.scores_of(row.id) for row in done]
            found = [[one[metric.name] for metric in self._objective.metrics] for one in each]
            scores[known] = self._objective.oriented(np.array(found))
        ego, others = self._about.ego, self._about.others
        with self._clock("measure"):
            for k, row in zip(np.flatnonzero(known).tolist(), done, strict=True):
                recording = self._study.recording(row.id)
                collision[k] = any(recording.first_collision(ego, other) is not None for other in others)
                gaps = [self._clearance.score(self._clearance.course(recording, ego, other)) for other in others]
                encounter[k] = min(gaps) <= self._within
        return Outcomes(scores, scores <= self._threshold, collision, encounter)

    def _of(self, *stages: str) -> tuple[FloatArray, Outcomes]:
        """Points and outcomes of the rounds of some stages."""
        chosen = [(rows, outcomes) for stage, rows, outcomes in self._stages if stage in stages]
        points = [row.point for rows, _ in chosen for row in rows]
        return np.array(points).reshape(-1, self._space.dimension), Outcomes.joined([one for _, one in chosen])

    def _probability(self, event: Callable[[Outcomes], BoolArray]) -> Probability:
        """Probability of an event, from what was drawn for it."""
        points, outcomes = self._of("whole" if self._whole else "estimate")
        if self._whole:
            once = self._once([row for _, rows, _ in self._stages for row in rows])
            others = float(self._space.shares(self._every).sum()) if len(once) < len(self._every) else None
            return of_all(self._space.shares(points)[once], event(outcomes)[once], others)
        if not len(points) or not event(outcomes).any():
            # What the law itself brought is the only bound there is.
            _, outcomes = self._of("law")
            return of_law(event(outcomes))
        return of_weights(self._sampling.weights(points), event(outcomes), self._sampling.weights_error)

    def _found(self, interrupted: bool) -> Estimation:
        """Put together what the scenarios so far say."""
        _, law = self._of("whole" if self._whole else "law")
        _, every = self._of("law", "learn", "estimate", "whole")
        _, learned = self._of("law", "learn")
        critical = self._probability(lambda one: one.critical)
        collision = self._probability(lambda one: one.collision)
        encounter = self._probability(lambda one: one.encounter) if self._whole else of_law(law.encounter)
        warnings = [] if self._whole else [
            *warnings_of("critical scenario", critical, of_law(law.critical)),
            *warnings_of("collision", collision, of_law(law.collision)),
        ]  # fmt: skip
        if failed := int(every.failed.sum()):
            warnings.append(f"{failed} scenarios failed, and count as neither critical nor as a collision.")
        return Estimation(
            study=self._study.path,
            criterion=self._criterion(),
            within=self._within,
            critical=critical,
            collision=collision,
            encounter=encounter,
            critical_given_encounter=quotient(self._probability(lambda one: one.critical & one.encounter), encounter),
            collision_given_encounter=quotient(self._probability(lambda one: one.collision & one.encounter), encounter),
            scenarios=len(every.scores),
            learned=len(learned.scores),
            failed=failed,
            warnings=tuple(warnings),
            interrupted=interrupted,
        )

    def _criterion(self) -> str:
        objective: Objective = self._objective
        value = objective.flip(self._threshold)
        return f"{objective.text} {'<=' if objective.lower_is_critical else '>='} {value:g} {objective.unit}".rstrip()
