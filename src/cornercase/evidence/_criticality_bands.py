"""Bands of criticality: groups of scenarios by their scores alone, for scores in which clustering finds no gap."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np

from cornercase._common.errors import InputError, suggest_name
from cornercase._common.typing import FloatArray, IntArray
from cornercase.metrics import Metric
from cornercase.study import StudyFile

BANDS_PREFIX: Final = "bands:"
"""Prefix of a metric's name that selects its bands instead of a clustering, as in ``bands:ttc``."""

BAND_NAMES: Final = ("high", "medium", "low")
"""Names of the bands, the most critical first."""

_PUBLISHED: Final[Mapping[str, tuple[tuple[float, float], str]]] = MappingProxyType(
    {
        "ttc": ((1.5, 4.0), "1.5 s: Gettman et al. 2008, 4 s: Hirst and Graham 1997"),
        "pet": ((1.0, 5.0), "1 s: Allen et al. 1978, 5 s: Gettman et al. 2008"),
        "thw": ((0.9, 2.0), "0.9 s and 2 s: Vogel 2003"),
    }
)
"""Published thresholds by metric, with their sources: in the metric's unit, the most critical first."""

# Greatest number of distinct scores that are divided exactly; more scores are merged into this many quantiles.
_MAX_DISTINCT: Final = 500
_MAX_REFINEMENTS: Final = 100


@dataclass(frozen=True, eq=False)
class Bands:
    """Bands of high, medium and low criticality, into which scenarios are divided by their scores for one metric.

    Attributes
    ----------
    metric, unit : str
    lower_is_critical : bool
    bounds : tuple of float
        Limit of each band except the last, the most critical band first. A score at a limit is in the more critical
        band.
    labels : ndarray of int64, shape (n,)
        Index of each scenario's band; 0 is the most critical band.
    source : str
        Publication of the bounds; empty for natural breaks, which are computed from the scores.
    explained : float
        Share of the variance of the scores that the bands explain (goodness of variance fit).

    Examples
    --------
    >>> import cornercase as cc
    >>> bands = cc.summarize("study.db").bands["wttc"]  # doctest: +SKIP
    >>> [bands.describe_range(band) for band in range(3)], bands.sizes  # doctest: +SKIP
    (['0.499 s and below', 'above 0.499 s, to 1.05 s', 'above 1.05 s'], (50, 115, 35))
    """

    metric: str
    unit: str
    lower_is_critical: bool
    bounds: tuple[float, ...]
    labels: IntArray
    source: str
    explained: float

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the bands, the most critical first."""
        return BAND_NAMES if len(self.bounds) > 1 else (BAND_NAMES[0], BAND_NAMES[-1])

    @property
    def sizes(self) -> tuple[int, ...]:
        """Number of scenarios in each band."""
        return tuple(np.bincount(self.labels, minlength=len(self.names)).tolist())

    @property
    def method(self) -> str:
        """Method by which the bounds were found, in words."""
        return f"published thresholds ({self.source})" if self.source else "natural breaks"

    def describe_range(self, band: int) -> str:
        """Describe the range of scores of a band.

        Parameters
        ----------
        band : int

        Returns
        -------
        str
            For example ``"above 0.2 s, to 1.4 s"``.
        """
        low, high = ("below", "above") if self.lower_is_critical else ("above", "below")
        unit = "" if self.unit in ("", "1") else f" {self.unit}"
        limits = [f"{bound:.3g}{unit}" for bound in self.bounds]
        if band == 0:
            return f"{limits[0]} and {low}"
        return f"{high} {limits[-1]}" if band == len(self.bounds) else f"{high} {limits[band - 1]}, to {limits[band]}"

    def describe(self) -> str:
        """Describe all bands, with the number of scenarios in each.

        Returns
        -------
        str
            One sentence without full stop.
        """
        parts = [
            f"{name} ({self.describe_range(band)}) {count}"
            for band, (name, count) in enumerate(zip(self.names, self.sizes, strict=True))
        ]
        return f"{self.metric}, bands of criticality by {self.method}, no clusters: {', '.join(parts)}"


def find_bands(metric: Metric, scores: FloatArray) -> Bands | None:
    """Divide scenarios into bands of high, medium and low criticality; None if all scores are the same.

    The bounds are published thresholds if the metric has any and they divide the scores into at least two bands.
    Otherwise the bounds are natural breaks: they form the three groups with the least sum of squared deviations from
    the group means (W. D. Fisher, "On grouping for maximum homogeneity", 1958; G. F. Jenks, 1967). With more than 500
    distinct scores, the sum is only nearly the least. Two distinct scores give two bands. A bound need not lie in a
    gap: neighbouring scores may lie in different bands.

    Sources of the thresholds: S. Hirst, R. Graham, "The format and presentation of collision warnings" (1997); B. L.
    Allen, B. T. Shin, P. J. Cooper, "Analysis of traffic conflicts and collisions" (1978); D. Gettman et al.,
    "Surrogate safety assessment model and validation", FHWA-HRT-08-051 (2008); K. Vogel, "A comparison of headway and
    time to collision as safety indicators" (2003).
    """
    oriented = np.asarray(metric.to_minimize(scores), dtype=np.float64)
    finite = oriented[np.isfinite(oriented)]
    if len(np.unique(finite)) < 2:
        return None
    published, source = _PUBLISHED.get(metric.name, ((), ""))
    limits = np.asarray(metric.to_minimize(np.array(published)), dtype=np.float64)
    labels = np.searchsorted(limits, oriented, side="left")
    if len(np.unique(labels)) < 2:
        limits, source = _natural_breaks(finite, len(BAND_NAMES)), ""
        labels = np.searchsorted(limits, oriented, side="left")
    bounds = tuple(float(bound) for bound in np.asarray(metric.to_minimize(limits)))
    return Bands(
        metric.name, metric.unit, metric.lower_is_critical, bounds, labels.astype(np.int64), source,
        explained_variance(oriented, labels),
    )  # fmt: skip


def bands_by_scenario(study: StudyFile, name: str) -> tuple[Bands, dict[int, int]]:
    """Return the bands of a study by the metric `name`, and the index of each scenario's band by scenario id.

    InputError if the study lacks this metric, or all scores are the same.
    """
    if name not in study.meta.metrics:
        raise InputError(
            f"{BANDS_PREFIX}{name}: the study has no such metric; {suggest_name(name, study.meta.metrics)}"
        )
    bands = find_bands(study.meta.create_metric(name), study.scores(name))
    if bands is None:
        raise InputError(
            f"{BANDS_PREFIX}{name}: all scores are the same, so there are no bands; choose another metric."
        )
    return bands, dict(zip((row.id for row in study.finished_rows()), bands.labels.tolist(), strict=True))


def bands_of_study(study: StudyFile) -> dict[str, Bands]:
    """Return the bands of criticality by each metric of a study, except metrics whose scores are all the same."""
    metrics = study.meta.create_metrics()
    candidates = {metric.name: find_bands(metric, study.scores(metric.name)) for metric in metrics}
    return {name: bands for name, bands in candidates.items() if bands is not None}


def explained_variance(scores: FloatArray, labels: IntArray) -> float:
    """Return the share of the variance of scores that their division into groups explains; NaN without variance."""
    is_finite = np.isfinite(scores)
    scores, labels = scores[is_finite], labels[is_finite]
    within = sum(float(((scores[labels == k] - scores[labels == k].mean()) ** 2).sum()) for k in np.unique(labels))
    total = float(((scores - scores.mean()) ** 2).sum())
    return 1.0 - within / total if total > 0.0 else math.nan


def _natural_breaks(scores: FloatArray, n_groups: int) -> FloatArray:
    """Return the natural breaks of scores: the largest score of each group except the last.

    The groups have the least sum of squared deviations from the group means, or nearly the least with more than 500
    distinct scores.
    """
    values, counts = np.unique(scores, return_counts=True)
    if len(values) > _MAX_DISTINCT:
        edges = np.unique(np.quantile(scores, np.linspace(0.0, 1.0, _MAX_DISTINCT + 1), method="lower"))
        groups = np.searchsorted(edges, values, side="left")
        ends = np.flatnonzero(np.append(np.diff(groups) > 0, True))
        sums = np.add.reduceat(values * counts, np.append(0, ends[:-1] + 1))
        squares = np.add.reduceat(values**2 * counts, np.append(0, ends[:-1] + 1))
        counts, values = np.add.reduceat(counts, np.append(0, ends[:-1] + 1)), values[ends]
    else:
        sums, squares = values * counts, values**2 * counts
    n_groups = min(n_groups, len(values))
    weight, first, second = (np.append(0.0, np.cumsum(terms)) for terms in (counts, sums, squares))
    # Row i, column k: sum of the squared deviations of the values from i to k, both included.
    i, j = np.arange(len(values))[:, None], np.arange(1, len(values) + 1)
    n = np.where(j > i, weight[j] - weight[i], 1.0)
    spread = np.where(j > i, second[j] - second[i] - (first[j] - first[i]) ** 2 / n, np.inf)
    best, starts = spread[0], []
    for _ in range(n_groups - 1):
        # The last group begins at value i, and the groups before it end just before i.
        total = np.append(np.inf, best[:-1])[:, None] + spread
        starts.append(total.argmin(axis=0))
        best = total.min(axis=0)
    end, breaks = len(values), []
    for start in reversed(starts):
        end = int(start[end - 1])
        breaks.append(values[end - 1])
    limits = np.array(breaks[::-1])
    return limits if len(np.unique(scores)) <= _MAX_DISTINCT else _refine_breaks(scores, limits)


def _refine_breaks(scores: FloatArray, limits: FloatArray) -> FloatArray:
    """Move each break to the largest score up to the middle between the means of its two groups (Lloyd's algorithm).

    This is repeated until no break changes, at most 100 times.
    """
    for _ in range(_MAX_REFINEMENTS):
        labels = np.searchsorted(limits, scores, side="left")
        means = np.array([scores[labels == k].mean() for k in range(len(limits) + 1)])
        moved = np.array([scores[scores <= middle].max() for middle in 0.5 * (means[1:] + means[:-1])])
        if np.array_equal(moved, limits):
            break
        limits = moved
    return limits
