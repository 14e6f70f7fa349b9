"""Function `summarize`: main results of a study as typed values."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

from cornercase._common.unknown_names import suggest_arguments
from cornercase.report._summary import Summary, entities_hit_by_ego, summarize_with_collisions
from cornercase.study import StudyFile
from cornercase.study._study_file import open_study


@suggest_arguments
def summarize(study: StudyFile | Path | str, *, critical: float | None = None) -> Summary:
    """Summarize the scenarios that were run in a study and their results.

    Parameters
    ----------
    study : Study, StudyFile or path
        An open study, or its file; it is only read.
    critical : float, optional
        Score from which a scenario is critical, in the unit of the objective; by default the threshold of the study.

    Returns
    -------
    Summary
        Typed values; ``print`` shows the same text as ``cornercase show``.

    Raises
    ------
    InputError
        There is no such study, or `critical` is given for a study with a condition, a Pareto front or an estimate of
        probabilities.

    See Also
    --------
    cornercase.write_report : Write the same results with figures as a page.

    Examples
    --------
    >>> import cornercase as cc
    >>> cc.summarize("study.db").n_collisions  # doctest: +SKIP
    12
    """
    with open_study(study, readonly=True, critical=critical) as opened, opened.snapshot():
        entities_hit = [entities_hit_by_ego(opened.meta, hits) for hits in opened.collisions().values()]
        summary = summarize_with_collisions(opened, entities_hit, list(opened.impacts().values()))
        return replace(summary, _describe=partial(_describe, opened.path.absolute(), critical))


def _describe(study: Path, critical: float | None) -> str:
    """Return the text that ``cornercase show`` prints for a study; empty if the file was removed or has no results."""
    if not study.exists():
        return ""
    # A summary alone needs no sentences.
    from cornercase.report._sentences import iter_sentences

    with open_study(study, readonly=True, critical=critical) as opened, opened.snapshot():
        return "\n".join(iter_sentences(opened))
