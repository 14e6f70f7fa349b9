"""Run scenarios of a suite again with reference drivers, if a requirement compares the ego with one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from cornercase._common.errors import SimulationError
from cornercase.drivers import judge_reference
from cornercase.simulators import Simulator, outcomes_of
from cornercase.study import Row, Study
from cornercase.suite.contents import SuiteContents
from cornercase.suite.requirement import Requirement


def ask_references(
    suite: SuiteContents, study: Study, requirements: Sequence[Requirement], references: Mapping[str, Simulator]
) -> None:
    """Run each scenario in which the ego collides again with the reference drivers, and store the outcomes.

    `study` is open for writing; outcomes that it holds already are not run again. `references` are simulators with the
    driver of that name in the ego.
    """
    ego, others = study.meta.ego, study.meta.others
    for name, simulator in references.items():
        applicable = [requirement for requirement in requirements if requirement.reference == name]
        rows = [row for row in study.done() if _is_asked(suite, study, row, applicable)]
        outcomes = outcomes_of(simulator, [suite.scenarios[row.id - 1].concrete for row in rows])
        for row, run in zip(rows, outcomes, strict=False):
            if not isinstance(run, SimulationError):
                outcome = judge_reference(name, run, study.recording(row.id), ego, others)
                study.writer.save_reference(row.id, name, outcome)


def _is_asked(suite: SuiteContents, study: Study, row: Row, asking: Sequence[Requirement]) -> bool:
    scenario = suite.scenarios[row.id - 1]
    applies = any(requirement.concerns(scenario.file, scenario.kind) for requirement in asking)
    if not applies or study.reference_of(row.id, asking[0].reference) is not None:
        return False
    return any(study.meta.ego in collision.entities for collision in study.recording(row.id).collisions)
