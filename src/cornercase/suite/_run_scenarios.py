"""Run the scenarios of a suite, also with reference drivers, measure them and store the results."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final

from cornercase._common.errors import InputError, SimulationError
from cornercase._common.io.support_table import deduplicate_notices, warn_notices
from cornercase._common.process.signals import collect_interrupts
from cornercase._common.progress import ProgressBar
from cornercase.drivers.references.r157._preventability import assess_preventability
from cornercase.exploration._repeatability import check_repeatability
from cornercase.metrics import Metric
from cornercase.metrics._measure import evaluate_metrics
from cornercase.recordings import Recording
from cornercase.simulators import Simulator
from cornercase.simulators._random_sensors import find_entities_with_random_sensors
from cornercase.simulators._results import find_refusals, get_simulator_class, list_ignored_content, run_scenarios
from cornercase.simulators._run_notices import RunNotices, warn_if_ego_has_no_driver
from cornercase.study import ScenarioRecord, StudyFile, StudyMeta
from cornercase.study._study_file import open_or_create_study
from cornercase.suite._judge import depends_on_reference
from cornercase.suite._requirement import Requirement
from cornercase.suite._suite_contents import SuiteContents, SuiteScenario

_NONDETERMINISM_ADVICE: Final = (
    "a driver or the simulator draws random numbers, or keeps state between runs: fix it, or verdicts may change from"
    " run to run"
)


def mark_unsupported(suite: SuiteContents, simulator: Simulator) -> SuiteContents:
    """Return the suite with an error on each scenario that the simulator cannot run.

    Raises `InputError` if the simulator can run none of the scenarios.
    """
    usable = suite.runnable_scenarios
    refused = find_refusals(simulator, [scenario.concrete_scenario for scenario in usable])
    reasons = {usable[k].file_name: reason for k, reason in refused.items()}
    return replace(
        suite,
        scenarios=tuple(
            replace(scenario, error=reasons.get(scenario.file_name, scenario.error)) for scenario in suite.scenarios
        ),
    )


def run_pending_scenarios(
    suite: SuiteContents,
    meta: StudyMeta,
    metrics: Sequence[Metric],
    simulator: Simulator,
    study_path: Path,
    workers: int | None,
    progress: bool,
) -> int:
    """Run the scenarios that the study lacks, store each result at once, and return how many had ended before."""
    _warn_about_ignored_content(suite, simulator, meta.ego)
    with open_or_create_study(study_path, meta) as study:
        study.writer.check_and_update_meta(meta)
        values = [dict(scenario.values) for scenario in suite.scenarios]
        rows = study.rows() or study.writer.add_pending(1, meta.space.points(values), values)
        n_before = sum(row.state != "pending" for row in rows)
        notices = RunNotices(simulator)
        bar = ProgressBar(len(rows), "testing", "scenarios", enabled=progress)
        try:
            with collect_interrupts() as raise_interrupt:
                for n_done in _run_pending(study, rows, suite.scenarios, simulator, metrics, workers, notices):
                    raise_interrupt()
                    bar.update(n_done, "")
                run_again, is_random = (
                    partial(_run_again, suite, simulator),
                    partial(_has_random_sensors, suite, simulator),
                )
                check_repeatability(study, run_again, _NONDETERMINISM_ADVICE, is_random)
        finally:
            bar.stop()
            notices.issue_warnings()
        failed = study.failed_rows()
        if not study.finished_rows():
            # Clear the study, so that the corrected command can use it.
            reason = failed[0].error if failed else "there is none"
            study.writer.remove_scenarios()
            raise InputError(f"None of the {len(rows)} scenarios of {suite.path} could be run; the first: {reason}.")
        return n_before


def _run_again(
    suite: SuiteContents, simulator: Simulator, row: ScenarioRecord
) -> Iterator[Recording | SimulationError]:
    return run_scenarios(simulator, [suite.scenarios[row.id - 1].concrete_scenario])


def _has_random_sensors(suite: SuiteContents, simulator: Simulator) -> bool:
    return bool(find_entities_with_random_sensors(simulator, (item.scenario for item in suite.runnable_scenarios)))


def _warn_about_ignored_content(suite: SuiteContents, simulator: Simulator, ego: str) -> None:
    """Warn about content of the scenario files that the simulator ignores; also warn if no driver drives the ego."""
    warn_notices(
        deduplicate_notices(
            notice
            for scenario in suite.runnable_scenarios
            for notice in list_ignored_content(simulator, scenario.scenario)
        )
    )
    warn_if_ego_has_no_driver(simulator, (scenario.scenario for scenario in suite.runnable_scenarios), ego)


def _run_pending(
    study: StudyFile,
    rows: Sequence[ScenarioRecord],
    scenarios: Sequence[SuiteScenario],
    simulator: Simulator,
    metrics: Sequence[Metric],
    workers: int | None,
    notices: RunNotices,
) -> Iterator[int]:
    """Run pending scenarios, and yield the number of scenarios that have ended so far."""
    pending = [row for row in rows if row.state == "pending"]
    done = len(rows) - len(pending)
    yield done
    for row in pending:
        if reason := scenarios[row.id - 1].error:
            study.writer.record_failure(row.id, SimulationError(reason))
            done += 1
            yield done
    pending = [row for row in pending if not scenarios[row.id - 1].error]
    # A batch gives no results before its last scenario has ended.
    takes_batches = get_simulator_class(simulator).batched
    batch_size = workers if workers is not None and takes_batches else max(len(pending), 1)
    for first in range(0, len(pending), batch_size):
        batch = pending[first : first + batch_size]
        outcomes = run_scenarios(simulator, [scenarios[row.id - 1].concrete_scenario for row in batch])
        for row in batch:
            start = time.monotonic()
            outcome = next(outcomes)
            end = time.monotonic()
            try:
                if isinstance(outcome, SimulationError):
                    raise outcome
                courses = evaluate_metrics(metrics, outcome, study.meta.ego, study.meta.others)
            except SimulationError as error:
                study.writer.record_failure(row.id, error)
            else:
                study.writer.record_result(row.id, outcome, courses)
                scenario = scenarios[row.id - 1]
                notices.add_run(outcome, partial(getattr, scenario, "scenario"), scenario.file_name)
            study.writer.add_elapsed_times({"simulate": end - start, "store": time.monotonic() - end})
            done += 1
            yield done
        # Let the simulator clean up.
        next(outcomes, None)


def run_reference_drivers(
    suite: SuiteContents,
    study: StudyFile,
    requirements: Sequence[Requirement],
    simulators_by_driver: Mapping[str, Simulator],
) -> None:
    """Run scenarios with reference drivers where a verdict depends on this, and store the outcomes.

    Outcomes that the study has already are not computed again.
    """
    ego, others = study.meta.ego, study.meta.others
    for name, simulator in simulators_by_driver.items():
        applicable = [item for item in requirements if name in item.expression.reference_drivers]
        rows = [row for row in study.finished_rows() if _needs_reference_run(suite, study, row, name, applicable)]
        concretes = [suite.scenarios[row.id - 1].concrete_scenario.without_driver_parameters(ego) for row in rows]
        outcomes = run_scenarios(simulator, concretes)
        for row, run in zip(rows, outcomes, strict=False):
            if not isinstance(run, SimulationError):
                outcome = assess_preventability(name, run, study.recording(row.id), ego, others)
                study.writer.save_reference_outcome(row.id, name, outcome)


def _needs_reference_run(
    suite: SuiteContents, study: StudyFile, row: ScenarioRecord, reference: str, requirements: Sequence[Requirement]
) -> bool:
    scenario = suite.scenarios[row.id - 1]
    applicable = [item for item in requirements if item.applies_to(scenario.file_name, scenario.cluster_name)]
    if not applicable or study.reference_outcome(row.id, reference) is not None:
        return False
    recording, ego, others = study.recording(row.id), study.meta.ego, study.meta.others
    return any(depends_on_reference(item, recording, ego, others) for item in applicable)
