"""Data of the page's charts."""

from __future__ import annotations

import math
from itertools import combinations
from typing import Any, Final

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.exploration import Objective
from cornercase.report.data import ReportData

_REACHES: Final = 120


def search_curve(data: ReportData) -> dict[str, Any]:
    """Return the progress of the search per round: scenarios run, best score, critical scenarios, missed share."""
    meta = data.summary.meta
    objective = Objective.of_study(meta)
    oriented = objective.oriented(np.stack([data.scores[metric.name] for metric in objective.metrics], axis=1))
    searched = oriented[:, 0] if objective.pareto else oriented
    rounds = np.array([row.round for row in data.rows])
    # Scenarios are numbered in the order of their rounds.
    ends = np.flatnonzero(np.append(np.diff(rounds) != 0, True))
    best_scores = [objective.flip(value) for value in np.fmin.accumulate(searched)[ends].tolist()]
    return {
        "metric": data.metrics[0].name if objective.pareto else data.summary.searched,
        "unit": data.metrics[0].unit if objective.pareto else objective.unit,
        "run": (ends + 1).tolist(),
        "best": [_short(value) for value in best_scores],
        "critical": np.cumsum(data.critical)[ends].tolist(),
        "missed": [
            {
                "run": missed.run,
                "value": _short(missed.share.value),
                "low": None if missed.doubt else _short(missed.share.low),
                "high": None if missed.doubt else _short(missed.share.high),
                "doubt": missed.doubt,
            }
            for missed in data.missed
        ],
    }


def sensitivity_bars(data: ReportData) -> dict[str, Any] | None:
    """Return the sensitivity of each parameter with 90 % intervals; None if unknown."""
    sensitivity = data.summary.knowledge.sensitivity
    if sensitivity is None or not sensitivity.foretold:
        return None
    return {
        "names": list(sensitivity.names),
        "first": [_short(share) for share in sensitivity.first],
        "first_interval": [[_short(low), _short(high)] for low, high in sensitivity.first_interval],
        "total": [_short(share) for share in sensitivity.total],
        "total_interval": [[_short(low), _short(high)] for low, high in sensitivity.total_interval],
        "metric": data.summary.searched,
    }


def coverage_curves(data: ReportData) -> dict[str, Any]:
    """Return by aspect the percentage of scenarios within a distance of the reduced set, over the distance.

    For comparison: k-medoids, the range of 90 of 100 random choices, and the critical scenarios alone.
    """
    charts = {}
    for name, gaps in data.gaps.items():
        analysis = data.summary.analyses[name]
        farthest = max(float(gaps.kept.max()), float(gaps.medoids.max()), float(np.quantile(gaps.random, 0.99)), 1e-9)
        distances_axis = np.linspace(0.0, 1.05 * farthest, _REACHES)
        low, high = np.quantile([_within(distances, distances_axis) for distances in gaps.random], (0.05, 0.95), axis=0)
        critical = gaps.kept[data.critical[data.rows_of(analysis.ids.tolist())]]
        charts[name] = {
            "unit": analysis.unit,
            "reach": _listed(distances_axis),
            "kept": _listed(_within(gaps.kept, distances_axis)),
            "medoids": _listed(_within(gaps.medoids, distances_axis)),
            "random_low": _listed(low),
            "random_high": _listed(high),
            "critical": _listed(_within(critical, distances_axis)) if len(critical) else None,
        }
    return charts


def hull_edges(data: ReportData) -> dict[str, list[list[int]]]:
    """Return the edges of each cluster's hull in the parameter space, as pairs of scenario ids by cluster."""
    reduced = data.summary.reduced
    hulls = {} if reduced is None else reduced.hulls
    edges_by_cluster = {}
    for cluster, facets in hulls.items():
        edges = {(min(pair), max(pair)) for facet in facets for pair in combinations(facet, 2)}
        edges_by_cluster[str(cluster)] = [list(pair) for pair in sorted(edges)]
    return edges_by_cluster


def _within(gaps: FloatArray, reach: FloatArray) -> FloatArray:
    """Percentage of gaps up to each distance in `reach`."""
    return np.asarray(100.0 * np.searchsorted(np.sort(gaps), reach, side="right") / max(len(gaps), 1))


def _listed(values: FloatArray) -> list[float | None]:
    return [_short(value) for value in values.tolist()]


def _short(value: float) -> float | None:
    return float(f"{value:.5g}") if math.isfinite(value) else None
