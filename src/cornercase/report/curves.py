"""What the page's charts draw of all scenarios together."""

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
    """Tell how far the search had come at the end of each round.

    Parameters
    ----------
    data : ReportData
        What the report shows.

    Returns
    -------
    dict of str to object
        ``run`` the scenarios that had been run by then, ``best`` the most critical score of ``metric`` in ``unit``,
        and ``critical`` the critical ones; of some of them, ``missed`` the share of the critical set.
    """
    meta = data.summary.meta
    objective = Objective.of_study(meta)
    oriented = objective.oriented(np.stack([data.scores[one.name] for one in objective.metrics], axis=1))
    searched = oriented[:, 0] if objective.pareto else oriented
    rounds = np.array([row.round for row in data.rows])
    # Scenarios are numbered in the order of their rounds.
    ends = np.flatnonzero(np.append(np.diff(rounds) != 0, True))
    best = [objective.flip(value) for value in np.fmin.accumulate(searched)[ends].tolist()]
    return {
        "metric": data.metrics[0].name if objective.pareto else data.summary.searched,
        "unit": data.metrics[0].unit if objective.pareto else objective.unit,
        "run": (ends + 1).tolist(),
        "best": [_short(value) for value in best],
        "critical": np.cumsum(data.critical)[ends].tolist(),
        "missed": [
            {
                "run": one.run,
                "value": _short(one.share.value),
                "low": None if one.doubt else _short(one.share.low),
                "high": None if one.doubt else _short(one.share.high),
                "doubt": one.doubt,
            }
            for one in data.missed
        ],
    }


def sensitivity_bars(data: ReportData) -> dict[str, Any] | None:
    """Tell how much each parameter matters.

    Parameters
    ----------
    data : ReportData
        What the report shows.

    Returns
    -------
    dict of str to object, or None
        Shares of the variance by parameter, with 90 % intervals; None where nothing is known of it.
    """
    found = data.summary.knowledge.sensitivity
    if found is None or not found.foretold:
        return None
    return {
        "names": list(found.names),
        "first": [_short(one) for one in found.first],
        "first_interval": [[_short(low), _short(high)] for low, high in found.first_interval],
        "total": [_short(one) for one in found.total],
        "total_interval": [[_short(low), _short(high)] for low, high in found.total_interval],
        "metric": data.summary.searched,
    }


def coverage_curves(data: ReportData) -> dict[str, Any]:
    """Tell how many scenarios have a kept one within a distance, over the distance.

    Parameters
    ----------
    data : ReportData
        What the report shows.

    Returns
    -------
    dict of str to object
        By aspect: distances in ``reach``, in ``unit``, and percentages of the scenarios for the kept ones, for
        k-medoids, for the range of 90 of 100 random choices, and of the critical ones for the kept ones.
    """
    found = {}
    for name, gaps in data.gaps.items():
        analysis = data.summary.analyses[name]
        farthest = max(float(gaps.kept.max()), float(gaps.medoids.max()), float(np.quantile(gaps.random, 0.99)), 1e-9)
        reach = np.linspace(0.0, 1.05 * farthest, _REACHES)
        low, high = np.quantile([_within(one, reach) for one in gaps.random], (0.05, 0.95), axis=0)
        critical = gaps.kept[data.critical[data.rows_of(analysis.ids.tolist())]]
        found[name] = {
            "unit": analysis.unit,
            "reach": _listed(reach),
            "kept": _listed(_within(gaps.kept, reach)),
            "medoids": _listed(_within(gaps.medoids, reach)),
            "random_low": _listed(low),
            "random_high": _listed(high),
            "critical": _listed(_within(critical, reach)) if len(critical) else None,
        }
    return found


def hull_edges(data: ReportData) -> dict[str, list[list[int]]]:
    """Tell the edges of the hull of each cluster in the parameter space.

    Parameters
    ----------
    data : ReportData
        What the report shows.

    Returns
    -------
    dict of str to list of (int, int)
        By cluster of the aspect that the study was reduced by, the ids of the scenarios at both ends of each edge.
    """
    reduced = data.summary.reduced
    hulls = {} if reduced is None else reduced.hulls
    found = {}
    for cluster, facets in hulls.items():
        edges = {(min(pair), max(pair)) for facet in facets for pair in combinations(facet, 2)}
        found[str(cluster)] = [list(pair) for pair in sorted(edges)]
    return found


def _within(gaps: FloatArray, reach: FloatArray) -> FloatArray:
    """Percentage of distances up to each reach."""
    return np.asarray(100.0 * np.searchsorted(np.sort(gaps), reach, side="right") / max(len(gaps), 1))


def _listed(values: FloatArray) -> list[float | None]:
    return [_short(value) for value in values.tolist()]


def _short(value: float) -> float | None:
    return float(f"{value:.5g}") if math.isfinite(value) else None
