"""Verdicts of a suite, found again from its study alone."""

from __future__ import annotations

from cornercase.study import Row, Study, damage_told
from cornercase.suite.judging import judge
from cornercase.suite.requirement import Requirement
from cornercase.suite.verdict import Verdict


def verdicts_of(study: Study) -> dict[int, list[Verdict]]:
    """Judge the scenarios of a study by the requirements that it holds.

    Parameters
    ----------
    study : Study
        Open.

    Returns
    -------
    dict of int to list of Verdict
        By id of each scenario that ended, in the order of the requirements that are for it; inconclusive where the
        simulator failed. Empty where the study holds no requirements.

    Raises
    ------
    InputError
        A requirement or a recording cannot be used, or a metric is of a package that is not here.
    """
    with damage_told(study.path):
        requirements = [Requirement.parse(one) for one in study.meta.requirements]
        if not requirements:
            return {}
        return {row.id: judge_row(study, row, requirements) for row in study.rows() if row.state != "pending"}


def judge_row(study: Study, row: Row, requirements: list[Requirement]) -> list[Verdict]:
    """Judge one scenario of a study.

    Parameters
    ----------
    study : Study
    row : Row
        Of a scenario that ended.
    requirements : list of Requirement

    Returns
    -------
    list of Verdict
        One for each requirement that is for it.
    """
    meta = study.meta
    file, kind = (_of(row, names) if meta.suite else "" for names in (meta.files, meta.kinds))
    mine = [one for one in requirements if one.concerns(file, kind)]
    if row.state == "failed":
        return [Verdict("inconclusive", one.text, f"it could not be run: {row.error}") for one in mine]
    recording = study.recording(row.id)
    asked = {name for one in mine if one.formula is not None for name in one.formula.metrics}
    # Of several others it is not known which of them a course is against at an instant.
    asked = asked if len(meta.others) == 1 else set()
    courses = {name: study.course(row.id, name) for name in meta.metrics if name in asked}
    return [
        judge(
            one,
            recording,
            meta.ego,
            meta.others,
            courses=courses,
            reference=study.reference_of(row.id, one.reference) if one.reference else None,
        )
        for one in mine
    ]


def _of(row: Row, names: tuple[str, ...]) -> str:
    return names[row.id - 1] if row.id <= len(names) else ""
