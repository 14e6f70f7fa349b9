"""Run, measure and store the scenarios of a suite."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final

from cornercase._common.errors import InputError, SimulationError
from cornercase._common.interrupts import noted_interrupts
from cornercase._common.ledger import distinct, warn_of
from cornercase._common.progress import ProgressBar
from cornercase.exploration import try_repeatability
from cornercase.metrics import METRICS, Metric, measured
from cornercase.recordings import Recording
from cornercase.simulators import (
    SIMULATORS,
    RunNotices,
    Simulator,
    notices_of,
    outcomes_of,
    refusals_of,
    warn_if_nobody_drives,
)
from cornercase.study import Row, Study, StudyMeta, begun_study
from cornercase.suite.contents import SuiteContents, SuiteScenario

_ADVICE: Final = (
    "a driver or the simulator draws random numbers, or keeps state between runs: fix it, or verdicts may change from"
    " run to run"
)


def sort_out(suite: SuiteContents, simulator: Simulator) -> SuiteContents:
    """Mark the scenarios of a suite that a simulator cannot run; raises `InputError` if these are all."""
    usable = suite.usable
    refused = refusals_of(simulator, [scenario.concrete for scenario in usable])
    reasons = {usable[k].file: reason for k, reason in refused.items()}
    return replace(
        suite,
        scenarios=tuple(
            replace(scenario, wrong=reasons.get(scenario.file, scenario.wrong)) for scenario in suite.scenarios
        ),
    )


def run_suite(
    suite: SuiteContents, meta: StudyMeta, simulator: Simulator, path: Path, workers: int | None, progress: bool
) -> int:
    """Run the scenarios that a study does not hold yet, and store each one when it has ended.

    `workers` is the number of parallel simulators, None for as many as a cluster has. Returns the number of scenarios
    that had ended before. Raises `InputError` if no scenario can be run, or the study is of something else, and leaves
    it as it was.
    """
    _warn(suite, simulator, meta.ego)
    metrics = [METRICS.create(name) for name in meta.metrics]
    with begun_study(path, meta) as study:
        study.writer.continue_with(meta)
        values = [dict(scenario.values) for scenario in suite.scenarios]
        rows = study.rows() or study.writer.propose(1, meta.space.points(values), values)
        n_before = sum(row.state != "pending" for row in rows)
        notices = RunNotices(simulator)
        bar = ProgressBar(len(rows), "testing", "scenarios") if progress else None
        try:
            with noted_interrupts() as raise_interrupt:
                for n_done in _run(study, rows, suite.scenarios, simulator, metrics, workers, notices):
                    raise_interrupt()
                    if bar is not None:
                        bar.update(n_done, "")
                try_repeatability(study, partial(_once_more, suite, simulator), _ADVICE)
        finally:
            if bar is not None:
                bar.stop()
            notices.warn()
        failed = study.failed()
        if not study.done():
            # Clear the study, so that the corrected command can use it.
            reason = failed[0].error if failed else "there is none"
            study.writer.clear()
            raise InputError(f"None of the {len(rows)} scenarios of {suite.place} could be run; the first: {reason}.")
        return n_before


def _once_more(suite: SuiteContents, simulator: Simulator, row: Row) -> Recording | SimulationError:
    (outcome,) = outcomes_of(simulator, [suite.scenarios[row.id - 1].concrete])
    return outcome


def _warn(suite: SuiteContents, simulator: Simulator, ego: str) -> None:
    """Warn about everything in the files that has no effect, each once, and if no driver drives the ego."""
    warn_of(distinct(notice for scenario in suite.usable for notice in notices_of(simulator.name, scenario.scenario)))
    warn_if_nobody_drives(simulator, (scenario.scenario for scenario in suite.usable), ego)


def _run(
    study: Study,
    rows: Sequence[Row],
    scenarios: Sequence[SuiteScenario],
    simulator: Simulator,
    metrics: Sequence[Metric],
    workers: int | None,
    said: RunNotices,
) -> Iterator[int]:
    """Run the pending scenarios, and yield the number of those that have ended."""
    pending = [row for row in rows if row.state == "pending"]
    done = len(rows) - len(pending)
    yield done
    for row in pending:
        if reason := scenarios[row.id - 1].wrong:
            study.writer.fail(row.id, SimulationError(reason))
            done += 1
            yield done
    pending = [row for row in pending if not scenarios[row.id - 1].wrong]
    # A batch gives no results before its last scenario has ended.
    takes_batches = SIMULATORS.class_of(simulator.name).takes_batches
    batch_size = workers if workers is not None and takes_batches else max(len(pending), 1)
    for first in range(0, len(pending), batch_size):
        batch = pending[first : first + batch_size]
        outcomes = outcomes_of(simulator, [scenarios[row.id - 1].concrete for row in batch])
        for row in batch:
            start = time.monotonic()
            outcome = next(outcomes)
            end = time.monotonic()
            try:
                if isinstance(outcome, SimulationError):
                    raise outcome
                courses = measured(metrics, outcome, study.meta.ego, study.meta.others)
            except SimulationError as error:
                study.writer.fail(row.id, error)
            else:
                study.writer.finish(row.id, outcome, courses)
                said.look(outcome, partial(getattr, scenarios[row.id - 1], "scenario"))
            study.writer.add_all_elapsed({"simulate": end - start, "store": time.monotonic() - end})
            done += 1
            yield done
        # Let the simulator clean up.
        next(outcomes, None)
