"""The exploration loop in rounds: the paper's figure "scenario exploration workflow"."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from typing import Any, Final

import numpy as np

from cornercase._common.errors import UserCodeError as UserCodeError
from cornercase._common.plugin_errors import group_failure_messages
from cornercase._common.process.signals import collect_interrupts
from cornercase._common.progress import ProgressBar
from cornercase._common.row_keys import row_keys
from cornercase._common.text.notebook_html import render_html
from cornercase._common.typing import FloatArray
from cornercase.exploration._best_scores import BestScores
from cornercase.exploration._config import ExplorationConfig
from cornercase.exploration._constant_metrics import MIN_SCENARIOS_TO_COMPARE, describe_constant_metrics
from cornercase.exploration._proposals import AskTell, ProposalSource, warn_of_repeated_proposals
from cornercase.exploration._runner import ScenarioRunner, StageTimer
from cornercase.exploration._stop_criteria import StopCriteria
from cornercase.exploration._study_critical_set import source_study_model
from cornercase.optimizers import Optimizer
from cornercase.simulators import Simulator
from cornercase.study import ScenarioRecord, StudyFile
from cornercase.study._objective import Objective

# Largest space whose scenarios within the constraints are counted.
_MAX_COUNTED_SPACE: Final = 1 << 18


@dataclass(frozen=True)
class ExplorationResult:
    """Result of an exploration: how many scenarios were run, and why it ended.

    Attributes
    ----------
    study : Path
    done, failed : int
        Number of scenarios in the study that gave a result, and that failed.
    reason : str
        Why the exploration ended, as a part of a sentence.
    interrupted : bool
        Whether Ctrl-C ended the exploration. It can only be True in a result of `cornercase.explore`: `Study.explore`
        raises KeyboardInterrupt instead.
    constant_metrics : tuple of str
        A sentence for each searched metric that has the same score in all scenarios.
    new_constant_metrics : tuple of str
        A sentence for each metric that is not searched and has the same score in all scenarios; empty if this was
        reported before for this study.
    reproducible : bool or None
        Whether the optimizer proposed the same scenarios again from the stored results; None if this was not checked.
    failure_counts : mapping of str to int
        Number of failed scenarios by reason, the most frequent first.
    roles : str
        The entity under test, its driver and the simulator, as sentences.

    Examples
    --------
    >>> import cornercase as cc
    >>> folder = "examples/x_intersection/x_intersection"
    >>> scenario = cc.LogicalScenario.read(f"{folder}.xosc", f"{folder}.space.xosc")
    >>> problem = cc.Problem(scenario, ego="Ego", other="Pedestrian", metrics=["wttc"])
    >>> result = cc.Study.create("study.db", problem).explore("sobol", budget=4)
    >>> result.done, result.failed, result.reason
    (4, 0, 'the budget of 4 scenarios is used up')
    """

    study: Path
    done: int
    failed: int
    reason: str
    interrupted: bool = False
    constant_metrics: tuple[str, ...] = ()
    new_constant_metrics: tuple[str, ...] = ()
    reproducible: bool | None = None
    failure_counts: Mapping[str, int] = field(default_factory=dict)
    roles: str = ""

    @classmethod
    def from_study(
        cls, study: StudyFile, reason: str, interrupted: bool = False, n_done_before: int | None = None
    ) -> ExplorationResult:
        """Create the result from an open study.

        Parameters
        ----------
        study : StudyFile
        reason : str
        interrupted : bool, default False
        n_done_before : int, optional
            Number of scenarios with a result when this search started or was resumed. If it is not given,
            `new_constant_metrics` is empty.

        Returns
        -------
        ExplorationResult
        """
        messages = describe_constant_metrics(study)
        searched = [messages.pop(name) for name in study.meta.objective_metrics if name in messages]
        # Reported once, when the study reaches the minimum number of scenarios.
        notes = (
            tuple(messages.values()) if n_done_before is not None and n_done_before < MIN_SCENARIOS_TO_COMPARE else ()
        )
        failed = study.failed_rows()
        reasons = {
            reason_text: len(rows)
            for reason_text, rows in group_failure_messages(row.error or "" for row in failed).items()
        }
        return cls(
            study.path,
            len(study.finished_rows()),
            len(failed),
            reason,
            interrupted,
            tuple(searched),
            notes,
            failure_counts=reasons,
            roles=study.meta.roles_text,
        )

    @property
    def n_finished(self) -> int:
        """Number of scenarios that gave a result or failed."""
        return self.done + self.failed

    def __repr__(self) -> str:
        failed = f", {self.failed} failed" if self.failed else ""
        return f"<ExplorationResult: {self.done} scenarios done{failed} in {self.study}; {self.reason}>"

    def _repr_html_(self) -> str:
        """HTML for notebooks: why the exploration ended, which metrics never vary, and why scenarios failed."""
        failures = [f"{count} failed: {reason}" for reason, count in self.failure_counts.items()]
        lines = [*self.constant_metrics, *self.new_constant_metrics, *failures]
        return render_html(repr(self), "".join(map(render_html, lines)))


class ScenarioExplorer:
    """Explorer that searches a logical scenario in rounds: steps (1) to (6) of the paper's activity diagram.

    In each round the optimizer chooses parameters, the simulator runs the scenarios, and the metrics evaluate them.
    Rounds are repeated until a termination criterion holds. Each scenario is stored as soon as it has ended. An
    existing study is resumed. `optimizer` must be new, since it first observes the results that the study holds.
    `references` are simulators with a reference driver in the ego, by name of the driver.
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
        self._config, self._optimizer, self._study = config, optimizer, study
        self._space = config.logical.space
        self._objective = config.make_objective() if objective is None else objective
        criterion = self._objective.criterion
        self._stopping = StopCriteria(
            config.stop_criteria,
            self._space,
            criterion,
            config.seed,
            str(config.search),
            has_audits=config.audit > 0.0,
            source_model=None if criterion is None or not config.stop_when else source_study_model(study, criterion),
        )
        self._clock = StageTimer(study)
        self._runner = ScenarioRunner(config, simulator, self._objective, study, self._clock, references)
        self._incumbent, self._n_without_improvement = BestScores(self._objective), 0
        self._patience, self._patience_unit = config.patience, "rounds"
        self._uses_features = "features" in optimizer.requires
        if (warm_start := study.warm_start_data()) is not None:
            optimizer.warm_start(*warm_start)

    def run(self, progress: bool = False) -> ExplorationResult:
        """Explore until a termination criterion holds; `progress` shows best score, rate and remaining time."""
        self._ask_tell = AskTell(self._optimizer, self._study, self._objective)
        self._proposal_source = ProposalSource(self._ask_tell, self._study)
        before, n_stored = len(self._study.finished_rows()), len(self._study.rows())
        bar = ProgressBar(self._config.budget, "exploring", "scenarios") if progress else None
        try:
            with collect_interrupts() as check:
                reason = self._run_until_stop(bar, check)
        except KeyboardInterrupt:
            return ExplorationResult.from_study(
                self._study, "it was interrupted", interrupted=True, n_done_before=before
            )
        finally:
            if bar is not None:
                bar.stop()
            self._clock.save_times()
            self._runner.notices.issue_warnings()
            warn_of_repeated_proposals(self._study, self._optimizer, n_stored)
        return ExplorationResult.from_study(self._study, reason, n_done_before=before)

    def _run_until_stop(self, bar: ProgressBar | None, check_interrupt: Callable[[], None]) -> str:
        """Run rounds until the search ends; return why it ended."""
        start = time.monotonic()
        done, number = self._resume_study(bar)
        while True:
            self._runner.check_repeatability()
            check_interrupt()
            if bar is not None:
                bar.update(done, self._incumbent.label)
            if (reason := self._stop_reason(done, time.monotonic() - start)) is not None:
                return reason
            number += 1
            rows = self._propose_round(number, done, min(self._config.batch, self._config.budget - done))
            if not rows:
                return self._exhausted_reason(done)
            self._tell_round(rows, self._simulate_rows(rows, bar))
            done += len(rows)
            self._clock.save_times()

    def _propose_round(self, round_number: int, n_done: int, n_wanted: int) -> list[ScenarioRecord]:
        """Propose and store the scenarios of a round; empty if the search has no more proposals."""
        with self._clock("optimize"):
            points = self._proposal_source.propose(n_done, n_wanted)
        if len(points) == 0:
            return []
        with self._clock("store"):
            return self._study.writer.add_pending(round_number, points, self._space.values(points))

    def _stop_reason(self, n_done: int, seconds: float) -> str | None:
        """Return the termination criterion that holds, as text; None to go on."""
        config = self._config
        if n_done > config.budget:
            return (
                f"the budget of {config.budget} scenarios counts these too, so no new one was run; a budget of"
                f" {n_done + config.budget} runs {config.budget} more"
            )
        if n_done == config.budget:
            reason = f"the budget of {config.budget} scenarios is used up"
        elif self._patience is not None and self._n_without_improvement >= self._patience:
            reason = f"{self._patience} {self._patience_unit} brought no improvement"
        elif config.max_seconds is not None and seconds >= config.max_seconds:
            reason = f"{config.max_seconds:g} s have passed"
        else:
            return self._stop_criteria_reason()
        with self._clock("judge"):
            return reason + self._stopping.describe_not_reached()

    def _exhausted_reason(self, n_done: int) -> str:
        """Return why the search has no more proposals: the space is exhausted, or the constraints exclude the rest."""
        size = self._space.size
        # An audit may be the same scenario as a proposal of the search.
        points = np.array([row.point for row in self._study.rows()]).reshape(-1, self._space.dimension)
        n_run = len(set(row_keys(self._space.snap(points))))
        if size is not None and n_run < size <= _MAX_COUNTED_SPACE:
            size = int(self._space.is_admissible(self._space.full_factorial()).sum())
        if size is not None and n_run >= size:
            return f"all {size} scenarios of the space were run"
        return f"the search has no proposals after these {n_done} scenarios"

    def _stop_criteria_reason(self) -> str | None:
        """Return how well the critical set is known, as text, if all stop criteria hold; else None."""
        if not self._stopping.has_criteria:
            return None
        with self._clock("judge"):
            return self._stopping.describe_if_all_reached()

    def _resume_study(self, bar: ProgressBar | None) -> tuple[int, int]:
        """Run pending scenarios and pass all results to the optimizer; return the numbers of scenarios and rounds.

        If the optimizer's proposals depend on earlier calls of `ask`, these calls are repeated for each round.
        """
        rows = self._study.rows()
        minimized = self._objective.minimized_scores(self._study)
        scores = dict(zip((row.id for row in rows if row.state == "done"), minimized, strict=True))
        for _, members in groupby(rows, key=lambda row: row.round):
            round_rows = list(members)
            n_searched = sum(not self._study.meta.is_audit(row.id) for row in round_rows)
            if self._optimizer.is_stateful_ask and n_searched:
                with self._clock("optimize"):
                    self._ask_tell.ask(n_searched)
            scores |= self._simulate_rows([row for row in round_rows if row.state == "pending"], bar)
            self._tell_round(round_rows, scores)
        return len(rows), rows[-1].round if rows else 0

    def _simulate_rows(self, rows: list[ScenarioRecord], bar: ProgressBar | None) -> dict[int, Any]:
        """Run scenarios; return the scores of the successful scenarios by id. Lower scores are more critical."""
        scores: dict[int, Any] = {}
        best, farthest = copy(self._incumbent), 0
        for number, score in self._runner.run_and_score(rows):
            scores[number] = score
            best.update(score[None])
            # A scenario with extra runs ends after later ones.
            farthest = max(farthest, number)
            if bar is not None:
                bar.update(farthest, best.label)
        return scores

    def _tell_round(self, rows: list[ScenarioRecord], scores_by_id: Mapping[int, Any]) -> None:
        """Pass the scores of one round to the optimizer and the stop criteria.

        The optimizer does not get audits (scenarios drawn at random as a check).
        """
        failed = np.full_like(self._objective.least_critical_scores, np.nan)
        missing = failed if self._objective.pareto else np.nan
        scores = np.array([scores_by_id.get(row.id, missing) for row in rows])
        points = np.array([row.point for row in rows])
        audits = np.array([self._study.meta.is_audit(row.id) for row in rows], dtype=np.bool_)
        with self._clock("judge"):
            self._stopping.add_audits(points[audits], scores[audits])
        searched = [row for row, audit in zip(rows, audits, strict=True) if not audit]
        if not searched:
            return
        points, scores = points[~audits], scores[~audits]
        features: tuple[FloatArray, ...] = ()
        if self._uses_features or self._stopping.has_criteria:
            features = (self._read_features(searched, scores_by_id),)
        with self._clock("judge"):
            self._stopping.add_results(points, scores, *features)
        with self._clock("optimize"):
            self._ask_tell.tell(points, scores, *(features if self._uses_features else ()))
        self._update_patience(scores)

    def _update_patience(self, scores: FloatArray) -> None:
        """Count the consecutive rounds without an improvement."""
        self._n_without_improvement = 0 if self._incumbent.update(scores) else self._n_without_improvement + 1

    def _read_features(self, rows: list[ScenarioRecord], scores_by_id: Mapping[int, Any]) -> FloatArray:
        """Return f features of the recording of each of m scenarios, shape (m, f); NaN for a failed scenario."""
        with self._clock("measure"):
            return self._study.features([row.id if row.id in scores_by_id else None for row in rows])
