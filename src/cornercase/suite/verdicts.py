"""Judge the scenarios of a suite again from its study alone."""

from __future__ import annotations

from cornercase.study import Row, Study, damage_told
from cornercase.suite.judging import judge
from cornercase.suite.requirement import Requirement
from cornercase.suite.verdict import Verdict


def verdicts_of(study: Study) -> dict[int, list[Verdict]]:
    """Judge the scenarios of an open study by the requirements that it holds; empty without requirements.

    Returns verdicts by id of each scenario that ended, one for each requirement that applies to it; inconclusive if the
    simulator failed.
    """
    with damage_told(study.path):
        requirements = [Requirement.parse(text) for text in study.meta.requirements]
        if not requirements:
            return {}
        return {row.id: judge_row(study, row, requirements) for row in study.rows() if row.state != "pending"}


def judge_row(study: Study, row: Row, requirements: list[Requirement]) -> list[Verdict]:
    """Judge one scenario that has ended, by each requirement that applies to it."""
    meta = study.meta
    file, kind = (_of(row, names) if meta.suite else "" for names in (meta.files, meta.kinds))
    applicable = [requirement for requirement in requirements if requirement.concerns(file, kind)]
    if row.state == "failed":
        return [Verdict("inconclusive", requirement.text, f"it failed: {row.error}") for requirement in applicable]
    recording = study.recording(row.id)
    formula_metrics = {
        name for requirement in applicable if requirement.formula is not None for name in requirement.formula.metrics
    }
    # With several others it is unknown which one a course refers to at each time.
    formula_metrics = formula_metrics if len(meta.others) == 1 else set()
    courses = {name: study.course(row.id, name) for name in meta.metrics if name in formula_metrics}
    return [
        judge(
            requirement,
            recording,
            meta.ego,
            meta.others,
            courses=courses,
            reference=study.reference_of(row.id, requirement.reference) if requirement.reference else None,
        )
        for requirement in applicable
    ]


def _of(row: Row, names: tuple[str, ...]) -> str:
    return names[row.id - 1] if row.id <= len(names) else ""
