"""What was found, in sentences that answer what is asked first."""

from __future__ import annotations

from cornercase.report.data import ReportData
from cornercase.study import IMPORTED


def tell_about(data: ReportData) -> str:
    """Say what the study is about.

    Parameters
    ----------
    data : ReportData
        What the report shows.

    Returns
    -------
    str
        Sentences.
    """
    summary, meta = data.summary, data.summary.meta
    said = [f"{meta.ego} is the ego, {meta.other} the other."]
    if meta.simulator == IMPORTED:
        said.append(f"The recordings of {summary.run} scenarios were imported.")
    else:
        searched = f"{'the ' if meta.pareto else ''}{summary.searched}"
        said.append(f"{summary.run} scenarios were run, searched by {meta.optimizer} for {searched}.")
    if summary.pending:
        said.append(f"{summary.pending} have not been run yet.")
    return " ".join(said)
