"""The scenarios of a suite run, measured and stored."""

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
    "a driver or the simulator draws random numbers, or keeps something from one run to the next: mend it, or verdicts"
    " may be others the next time"
)


def sort_out(suite: SuiteContents, simulator: Simulator) -> SuiteContents:
    """Say of the scenarios of a suite which a simulator cannot run.

    Parameters
    ----------
    suite : SuiteContents
    simulator : Simulator
        Open.

    Returns
    -------
    SuiteContents

    Raises
    ------
    InputError
        None of the scenarios can be run.
    """
    usable = suite.usable
    refused = refusals_of(simulator, [one.concrete for one in usable])
    wrong = {usable[k].file: why for k, why in refused.items()}
    return replace(
        suite, scenarios=tuple(replace(one, wrong=wrong.get(one.file, one.wrong)) for one in suite.scenarios)
    )


def run_suite(
    suite: SuiteContents, meta: StudyMeta, simulator: Simulator, path: Path, workers: int | None, progress: bool
) -> int:
    """Run what a study does not hold yet; each scenario is stored the moment it has ended.

    Parameters
    ----------
    suite : SuiteContents
    meta : StudyMeta
        Of the study.
    simulator : Simulator
        Open.
    path : Path
        The study, which need not be there.
    workers : int or None
        Simulators side by side; None for as many as a cluster has.
    progress : bool
        Whether to show a bar.

    Returns
    -------
    int
        Scenarios that had ended before, and that were not run again.

    Raises
    ------
    InputError
        None of the scenarios can be run, or the study is of something else; it is left as it is.
    """
    _warn(suite, simulator, meta.ego)
    metrics = [METRICS.create(name) for name in meta.metrics]
    with begun_study(path, meta) as study:
        study.continue_with(meta)
        values = [dict(one.values) for one in suite.scenarios]
        rows = study.rows() or study.propose(1, meta.space.points(values), values)
        before = sum(row.state != "pending" for row in rows)
        said = RunNotices(simulator)
        bar = ProgressBar(len(rows), "testing", "scenarios") if progress else None
        try:
            with noted_interrupts() as check:
                for done in _run(study, rows, suite.scenarios, simulator, metrics, workers, said):
                    check()
                    if bar is not None:
                        bar.update(done, "")
                try_repeatability(study, partial(_once_more, suite, simulator), _ADVICE)
        finally:
            if bar is not None:
                bar.stop()
            said.warn()
        failed = study.failed()
        if not study.done():
            # What nothing could be run with must not keep out the corrected command.
            reason = failed[0].error if failed else "there is none"
            study.clear()
            raise InputError(f"None of the {len(rows)} scenarios of {suite.place} could be run; the first: {reason}.")
        return before


def _once_more(suite: SuiteContents, simulator: Simulator, row: Row) -> Recording | SimulationError:
    (outcome,) = outcomes_of(simulator, [suite.scenarios[row.id - 1].concrete])
    return outcome


def _warn(suite: SuiteContents, simulator: Simulator, ego: str) -> None:
    """Tell what of the files has no effect, what is the same in several once, and that nobody drives the ego."""
    warn_of(distinct(notice for one in suite.usable for notice in notices_of(simulator.name, one.scenario)))
    warn_if_nobody_drives(simulator, (one.scenario for one in suite.usable), ego)


def _run(
    study: Study,
    rows: Sequence[Row],
    scenarios: Sequence[SuiteScenario],
    simulator: Simulator,
    metrics: Sequence[Metric],
    workers: int | None,
    said: RunNotices,
) -> Iterator[int]:
    """Run the pending scenarios, and count those that have ended."""
    pending = [row for row in rows if row.state == "pending"]
    done = len(rows) - len(pending)
    yield done
    for row in pending:
        if why := scenarios[row.id - 1].wrong:
            study.fail(row.id, SimulationError(why))
            done += 1
            yield done
    pending = [row for row in pending if not scenarios[row.id - 1].wrong]
    # A simulator that takes many at once would give nothing back before the last of them has ended.
    takes_batches = SIMULATORS.class_of(simulator.name).takes_batches
    at_once = workers if workers is not None and takes_batches else max(len(pending), 1)
    for begin in range(0, len(pending), at_once):
        chosen = pending[begin : begin + at_once]
        outcomes = outcomes_of(simulator, [scenarios[row.id - 1].concrete for row in chosen])
        for row in chosen:
            begun = time.monotonic()
            outcome = next(outcomes)
            ended = time.monotonic()
            try:
                if isinstance(outcome, SimulationError):
                    raise outcome
                courses = measured(metrics, outcome, study.meta.ego, study.meta.others)
            except SimulationError as error:
                study.fail(row.id, error)
            else:
                study.finish(row.id, outcome, courses)
                said.look(outcome, partial(getattr, scenarios[row.id - 1], "scenario"))
            study.add_all_elapsed({"simulate": ended - begun, "store": time.monotonic() - ended})
            done += 1
            yield done
        # Lets the simulator clear up.
        next(outcomes, None)
