"""All details of a study in tables, in the order of the page."""

from __future__ import annotations

from collections.abc import Iterator

from cornercase.report.data import ReportData
from cornercase.report.sections.kept import show_kept
from cornercase.report.sections.kinds import compare_kinds, show_kinds
from cornercase.report.sections.knowledge import show_knowledge
from cornercase.report.sections.overview import tell_failures, tell_scores
from cornercase.report.sections.part import Part
from cornercase.report.sections.verdicts import show_verdicts


def page_details(data: ReportData) -> Iterator[Part]:
    """Tell all details.

    Parameters
    ----------
    data : ReportData
        What the report shows.

    Yields
    ------
    Part
        Each with its title.
    """
    yield from show_verdicts(data)
    yield from tell_scores(data)
    yield from show_knowledge(data)
    yield from show_kinds(data)
    yield from compare_kinds(data)
    yield from show_kept(data)
    yield from tell_failures(data)
