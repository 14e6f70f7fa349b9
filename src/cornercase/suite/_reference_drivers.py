"""Run scenarios of a suite again with reference drivers, if a requirement compares the ego with a reference driver."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from cornercase._common.errors import SimulationError
from cornercase.drivers.references.r157._preventability import assess_preventability
from cornercase.simulators import Simulator
from cornercase.simulators._results import run_scenarios
from cornercase.study import ScenarioRecord, StudyFile
from cornercase.suite._judge import depends_on_reference
from cornercase.suite._requirement import Requirement
from cornercase.suite._suite_contents import SuiteContents


def run_reference_drivers(
    suite: SuiteContents,
    study: StudyFile,
    requirements: Sequence[Requirement],
    simulators_by_driver: Mapping[str, Simulator],
) -> None:
    """Run scenarios again whose verdict depends on reference drivers, and store the outcomes.

    `study` has to be open for writing; outcomes that are stored already are not computed again. `simulators_by_driver`
    maps the name of a reference driver to a simulator in which it drives the ego.
    """
    ego, others = study.meta.ego, study.meta.others
    for name, simulator in simulators_by_driver.items():
        applicable = [item for item in requirements if name in item.expression.reference_drivers]
        rows = [row for row in study.finished_rows() if _needs_reference_run(suite, study, row, name, applicable)]
        outcomes = run_scenarios(simulator, [suite.scenarios[row.id - 1].concrete_scenario for row in rows])
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
