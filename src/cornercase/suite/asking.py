"""Scenarios of a suite run again with references, where the ego collides and a requirement asks who would not."""

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
    """Run each scenario that ended in a collision of the ego again, and store what comes of it.

    Parameters
    ----------
    suite : SuiteContents
    study : Study
        Of the suite, open for writing. What it knows already is not run again.
    requirements : sequence of Requirement
    references : mapping of str to Simulator
        With the drivers that requirements name at the wheel of the ego, by name.
    """
    ego, others = study.meta.ego, study.meta.others
    for name, simulator in references.items():
        asking = [one for one in requirements if one.reference == name]
        rows = [row for row in study.done() if _is_asked(suite, study, row, asking)]
        outcomes = outcomes_of(simulator, [suite.scenarios[row.id - 1].concrete for row in rows])
        for row, run in zip(rows, outcomes, strict=False):
            if not isinstance(run, SimulationError):
                outcome = judge_reference(name, run, study.recording(row.id), ego, others)
                study.save_reference(row.id, name, outcome)


def _is_asked(suite: SuiteContents, study: Study, row: Row, asking: Sequence[Requirement]) -> bool:
    one = suite.scenarios[row.id - 1]
    concerned = any(required.concerns(one.file, one.kind) for required in asking)
    if not concerned or study.reference_of(row.id, asking[0].reference) is not None:
        return False
    return any(study.meta.ego in hit.entities for hit in study.recording(row.id).collisions)
