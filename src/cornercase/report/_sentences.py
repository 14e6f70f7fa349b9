"""Sentences of the report page as lines of plain text."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from cornercase.report._report_data import read_report_data
from cornercase.report.text._answers import describe_study, page_answers
from cornercase.report.text._phrases import describe_dangers
from cornercase.study import StudyFile


def iter_sentences(study: StudyFile) -> Iterator[str]:
    """Yield lines of text: description of the study, then each question of the report with its answer.

    Nothing is yielded before a scenario was run.
    """
    if not study.finished_rows():
        return
    data = read_report_data(study, charts=False)
    yield f"{data.summary.meta.title}. {describe_study(data)}"
    for answer in page_answers(data):
        yield answer.question
        yield f"  {answer.text}"
        yield from (f"  - {point}" for point in answer.points)


def describe_selected_dangers(study: StudyFile, ids: Sequence[int]) -> str:
    """Describe how many of the scenarios with the given ids are critical, and in how many the ego collides."""
    selected = set(ids)
    is_critical = zip(study.finished_rows(), study.critical_mask(), strict=True)
    n_critical = (
        None if study.criterion is None else sum(bool(critical) for row, critical in is_critical if row.id in selected)
    )
    n_colliding = sum(map(bool, study.impacts(selected).values()))
    return describe_dangers(len(selected), n_critical, n_colliding, study.meta.ego)
