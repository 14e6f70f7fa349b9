"""Choice of the aspect whose clusters are shown first in the report and are the default of `reduce`.

An aspect is what scenarios are compared by, such as the ego's trajectory.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from cornercase.clustering._stored_analysis import Analysis

SOME_INFORMATION: Final = 0.4
"""Least adjusted mutual information with which clusters count as informative about a fact, such as the outcome."""


def find_headline_aspect(analyses: Mapping[str, Analysis]) -> str | None:
    """Return the aspect whose clusters agree most with how scenarios end; None if there are no analyses.

    An aspect is what scenarios are compared by. `analyses` maps each aspect to its analysis. If aspects are tied, or
    all of them have only one cluster, the last of them is returned.
    """
    highest, aspect = -1.0, None
    for by, analysis in analyses.items():
        # If tied, the later aspect wins: the ego's trajectory, which comes first, says least about what happens.
        information = round(_outcome_agreement(analysis), 3) if analysis.clustering.n_clusters > 1 else -1.0
        if information >= highest:
            highest, aspect = information, by
    return aspect


def has_useful_clusters(analysis: Analysis) -> bool:
    """Return True if an analysis has several clusters, and the clusters agree with how the scenarios end.

    Agreement is not required if all scenarios end in the same way.
    """
    outcomes = {outcome for profile in analysis.profiles for outcome in profile.outcomes}
    separates = len(outcomes) < 2 or _outcome_agreement(analysis) >= SOME_INFORMATION
    return analysis.clustering.n_clusters > 1 and separates


def _outcome_agreement(analysis: Analysis) -> float:
    return analysis.fact_agreement.get("outcome", 0.0)
