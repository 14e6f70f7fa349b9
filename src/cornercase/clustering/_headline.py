"""The aspect whose clusters stand for a study: what the page shows first, and what `reduce` keeps by default."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from cornercase.clustering._stored_analysis import Analysis

SOME_INFORMATION: Final = 0.4
"""Mutual information from which clusters say something about a fact."""


def find_headline_aspect(analyses: Mapping[str, Analysis]) -> str | None:
    """Return the aspect whose clusters say most about how scenarios end; None without clusters."""
    highest, aspect = -1.0, None
    for by, analysis in analyses.items():
        # If tied, the later aspect wins: aspects are ordered by how much they say about what happens.
        information = round(_outcome_agreement(analysis), 3) if analysis.clustering.n_clusters > 1 else -1.0
        if information >= highest:
            highest, aspect = information, by
    return aspect


def has_useful_clusters(analysis: Analysis) -> bool:
    """Whether there are several clusters, which say something about how scenarios end if these end differently."""
    outcomes = {outcome for profile in analysis.profiles for outcome in profile.outcomes}
    separates = len(outcomes) < 2 or _outcome_agreement(analysis) >= SOME_INFORMATION
    return analysis.clustering.n_clusters > 1 and separates


def _outcome_agreement(analysis: Analysis) -> float:
    return analysis.fact_agreement.get("outcome", 0.0)
