"""Data of the charts in the report page."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.reduction._coverage import percent_within
from cornercase.reduction._hulls import find_hull_edges
from cornercase.report._report_data import ReportData
from cornercase.study._objective import Objective


def search_progress_chart(data: ReportData) -> dict[str, Any]:
    """Return the data of the chart that shows the progress of the search.

    The data hold, for the end of each round, the number of scenarios run, the best score and the number of critical
    scenarios. For some rounds, they also hold the estimated fraction of the critical set that was not found yet, with
    its interval.
    """
    meta = data.summary.meta
    objective = Objective.from_study_meta(meta)
    oriented = objective.compute_scores_to_minimize(
        np.stack([data.scores[metric.name] for metric in objective.metrics], axis=1)
    )
    searched = oriented[:, 0] if objective.pareto else oriented
    rounds = np.array([row.round for row in data.rows])
    # Scenarios are numbered in the order of their rounds.
    ends = np.flatnonzero(np.append(np.diff(rounds) != 0, True))
    best_scores = [objective.convert_orientation(value) for value in np.fmin.accumulate(searched)[ends].tolist()]
    return {
        "metric": data.metrics[0].name if objective.pareto else data.summary.objective,
        "unit": data.metrics[0].unit if objective.pareto else objective.unit,
        "run": (ends + 1).tolist(),
        "best": [_rounded(value) for value in best_scores],
        "critical": np.cumsum(data.is_critical)[ends].tolist(),
        "missed": [
            {
                "run": missed.n_run,
                "value": _rounded(missed.missed_fraction.value),
                "low": None if missed.interval_unavailable else _rounded(missed.missed_fraction.low),
                "high": None if missed.interval_unavailable else _rounded(missed.missed_fraction.high),
                "doubt": missed.interval_unavailable,
            }
            for missed in data.missed_fractions
        ],
    }


def sensitivity_chart(data: ReportData) -> dict[str, Any] | None:
    """Return the sensitivity to each parameter with 90 % intervals; None if there is no meaningful estimate."""
    sensitivity = data.summary.estimates.sensitivity
    if sensitivity is None or not sensitivity.is_meaningful:
        return None
    return {
        "names": list(sensitivity.names),
        "first": [_rounded(share) for share in sensitivity.first],
        "first_interval": [[_rounded(low), _rounded(high)] for low, high in sensitivity.first_interval],
        "total": [_rounded(share) for share in sensitivity.total],
        "total_interval": [[_rounded(low), _rounded(high)] for low, high in sensitivity.total_interval],
        "metric": data.summary.objective,
    }


def coverage_charts(data: ReportData) -> dict[str, Any]:
    """Return the data of the charts of coverage, by aspect (what the scenarios are compared by).

    The main curve is the percentage of scenarios within a distance of the reduced set, as a function of the distance.
    Curves for comparison: the same percentage with k-medoids instead of the reduced set, the range that contains 90 of
    100 random selections, and the percentage of the critical scenarios alone.
    """
    charts = {}
    for name, curves in data.coverage_curves.items():
        analysis = data.summary.analyses[name]
        critical = curves.to_selected[data.is_critical[data.row_indices(analysis.ids.tolist())]]
        charts[name] = {
            "unit": analysis.unit,
            "reach": _rounded_list(curves.reach),
            "kept": _rounded_list(percent_within(curves.to_selected, curves.reach)),
            "medoids": _rounded_list(percent_within(curves.to_medoids, curves.reach)),
            "random_low": _rounded_list(curves.random_low),
            "random_high": _rounded_list(curves.random_high),
            "critical": _rounded_list(percent_within(critical, curves.reach)) if len(critical) else None,
        }
    return charts


def hull_edges(data: ReportData) -> dict[str, list[list[int]]]:
    """Return the edges of the hull of each cluster in the parameter space, by cluster: pairs of scenario ids."""
    reduced = data.summary.reduced_set
    hulls = {} if reduced is None else reduced.hulls
    return {str(cluster): [list(pair) for pair in find_hull_edges(facets)] for cluster, facets in hulls.items()}


def _rounded_list(values: FloatArray) -> list[float | None]:
    return [_rounded(value) for value in values.tolist()]


def _rounded(value: float) -> float | None:
    return float(f"{value:.5g}") if math.isfinite(value) else None
