"""The sentences of the page as lines of text."""

from __future__ import annotations

from collections.abc import Iterator

from cornercase.report._report_data import read_report_data
from cornercase.report.text._answers import describe_study, page_answers
from cornercase.study import StudyFile


def iter_sentences(study: StudyFile) -> Iterator[str]:
    """Yield what was run, then each question of the page with its answer; nothing before a scenario was run."""
    if not study.finished_rows():
        return
    data = read_report_data(study, charts=False)
    yield f"{data.summary.meta.title}. {describe_study(data)}"
    for answer in page_answers(data):
        yield answer.question
        yield f"  {answer.text}"
        yield from (f"  - {point}" for point in answer.points)
