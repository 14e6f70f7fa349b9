"""The score that is searched: one metric, a weighted sum of several, or the Pareto front of all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from cornercase._common.errors import InputError, suggest_name
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.metrics import METRICS, Metric
from cornercase.study import StudyFile, StudyMeta


class Objective:
    """Converts the scores of the metrics into scores to minimize: the first metric, a weighted sum, or all for a front.

    `weights` are per unit of a metric's score; a metric without weight does not count. Raises `InputError` without
    metrics, for an unknown or non-positive weight, weights of a front, or a front of one metric.
    """

    def __init__(
        self, metrics: Sequence[Metric], weights: Mapping[str, float] | None = None, pareto: bool = False
    ) -> None:
        if not metrics:
            raise InputError("There is no metric to search; name one with `metrics`.")
        self.metrics, self.weights, self.pareto = list(metrics), dict(weights or {}), pareto
        if pareto and (self.weights or len(metrics) < 2):
            raise InputError("`pareto`: needs two metrics or more, and no `weights`.")
        names = [metric.name for metric in metrics]
        for name, weight in self.weights.items():
            if name not in names:
                raise InputError(f"`weights` {name}: is not one of the metrics; {suggest_name(name, names)}")
            if not 0.0 < weight < np.inf:
                raise InputError(f"`weights` {name}={weight:g}: give a number above 0.")
        self._score_factors = self._make_score_factors()

    @classmethod
    def from_study_meta(cls, meta: StudyMeta) -> Objective:
        """Create the objective of a stored study."""
        metrics = [METRICS.create(name) for name in meta.metrics]
        return cls(metrics, meta.weights, meta.pareto)

    def _make_score_factors(self) -> FloatArray:
        signs = np.array([metric.to_minimize(1.0) for metric in self.metrics])
        if self.pareto:
            return np.diag(signs)
        weights = [self.weights.get(metric.name, 0.0) for metric in self.metrics]
        weight_vector = np.array(weights) if self.weights else np.eye(len(signs))[0]
        return np.asarray((weight_vector * signs)[:, None])

    def minimized(self, scores: FloatArray) -> FloatArray:
        """Return scores to minimize, shape (m,) or (m, metrics) for a front, from raw scores of shape (m, metrics)."""
        # Skip unused metrics: NaN times 0 is NaN.
        has_weight = self._score_factors.any(axis=1)
        # Extreme weights may overflow.
        with np.errstate(over="ignore", invalid="ignore"):
            values = scores[:, has_weight] @ self._score_factors[has_weight]
        return np.asarray(values if self.pareto else values[:, 0])

    def minimized_scores(self, study: StudyFile) -> FloatArray:
        """Return scores to minimize for all successful scenarios of a study, shape (n,) or (n, metrics) for a front."""
        return self.minimized(self._raw_scores(study))

    def _raw_scores(self, study: StudyFile) -> FloatArray:
        return np.stack([study.scores(metric.name) for metric in self.metrics], axis=1)

    def is_critical(self, scores: FloatArray, threshold: float | None) -> BoolArray:
        """Return which scenarios are critical, shape (m,), for raw scores (m, metrics) and a stored (raw) threshold.

        All False without a threshold and for a Pareto front.
        """
        if threshold is None or self.pareto:
            return np.zeros(len(scores), dtype=np.bool_)
        return np.asarray(self.minimized(scores) <= self.convert_orientation(threshold))

    def is_critical_in_study(self, study: StudyFile) -> BoolArray:
        """Return which of the successful scenarios of a study are critical, shape (n,)."""
        return self.is_critical(self._raw_scores(study), study.critical)

    @property
    def label(self) -> str:
        """Label of the objective, such as ``2 ttc + 1 (-speed)``."""
        if self.pareto:
            return "Pareto front of " + ", ".join(metric.name for metric in self.metrics)
        if not self.weights:
            return self.metrics[0].name
        return " + ".join(
            f"{self.weights[m.name]:g} {m.name}" if m.lower_is_critical else f"{self.weights[m.name]:g} (-{m.name})"
            for m in self.metrics
            if m.name in self.weights
        )

    @property
    def lower_is_critical(self) -> bool:
        """Whether lower raw values are more critical; always for a weighted sum."""
        return bool(self.weights) or self.metrics[0].lower_is_critical

    @property
    def unit(self) -> str:
        """Unit of the objective; empty for a weighted sum or a front."""
        return "" if self.weights or self.pareto or self.metrics[0].unit == "1" else self.metrics[0].unit

    def minimized_threshold(self, raw_threshold: float | None) -> float:
        """Return the threshold as a minimized score; `given` is a raw score or weighted sum, None the metric's own.

        Raises `InputError` for a Pareto front, or if neither is available.
        """
        if self.pareto:
            raise InputError(
                "`pareto`: a Pareto front has no threshold; use `weights` to combine the metrics into one score."
            )
        if self.weights:
            if raw_threshold is None:
                raise InputError("`weights`: set `critical` to the weighted sum up to which a scenario is critical.")
            return float(raw_threshold)
        return self.convert_orientation(self.metrics[0].resolve_threshold(raw_threshold))

    def minimized_threshold_or_none(self, raw_threshold: float | None) -> float | None:
        """Return the threshold as `threshold` does, but None if none is given and the metric has none."""
        try:
            return self.minimized_threshold(raw_threshold)
        except InputError:
            if raw_threshold is not None:
                raise
            return None

    def convert_orientation(self, score: float) -> float:
        """Convert one score between raw and minimized; a weighted sum is minimized already."""
        return score if self.weights else self.metrics[0].to_minimize(score)

    @property
    def least_critical_scores(self) -> FloatArray:
        """Minimized scores of a scenario in which every metric is at its cap, shape (1,) or (metrics,)."""
        return self.minimized(np.array([[metric.cap for metric in self.metrics]])).ravel()


def is_on_pareto_front(values: FloatArray) -> BoolArray:
    """Return which rows are on the Pareto front (not dominated, lower is better), shape (m,); never rows with NaN.

    Source: H. T. Kung, F. Luccio, F. P. Preparata, "On finding the maxima of a set of vectors", Journal of the ACM 22
    (1975); implemented in moocore.
    """
    is_finite = np.isfinite(values).all(axis=1)
    if not is_finite.any():
        return np.asarray(is_finite)
    front = is_finite.copy()
    if values.shape[1] == 1:
        front[is_finite] = values[is_finite, 0] == values[is_finite].min()
    else:
        # Imported late: slow to import.
        from moocore import is_nondominated

        front[is_finite] = is_nondominated(values[is_finite], keep_weakly=True)
    return np.asarray(front)


class Incumbent:
    """The most critical result so far: a score, or a Pareto front."""

    def __init__(self, objective: Objective) -> None:
        self._objective = objective
        self._front = np.zeros((0, 1))

    def update(self, scores: FloatArray) -> bool:
        """Add minimized scores, shape (m,) or (m, k), NaN if failed; return whether any is an improvement.

        An improvement is dominated by no earlier score. A score with every metric at its cap counts only once.
        """
        values = scores.reshape(len(scores), -1)
        values = values[np.isfinite(values).all(axis=1)]
        if not len(values):
            return False
        if values.shape[1] == 1:
            return self._update_single(values)
        before = self._front if len(self._front) else np.full((1, values.shape[1]), np.inf)
        worse = (before[:, None] <= values).all(axis=2) & (before[:, None] < values).any(axis=2)
        same = (before[:, None] == values).all(axis=2).any(axis=0)
        capped = (values >= self._objective.least_critical_scores).all(axis=1)
        is_new = ~worse.any(axis=0) & ~(same & capped)
        candidates = np.unique(np.concatenate([self._front.reshape(-1, values.shape[1]), values]), axis=0)
        self._front = candidates[is_on_pareto_front(candidates)]
        return bool(is_new.any())

    def _update_single(self, values: FloatArray) -> bool:
        """Like `add` for single scores; faster, since it is called for every scenario."""
        best = float(self._front[0, 0]) if len(self._front) else np.inf
        is_new = (values <= best) & ~((values == best) & (values >= self._objective.least_critical_scores))
        self._front = np.full((1, 1), min(best, float(values.min())))
        return bool(is_new.any())

    @property
    def label(self) -> str:
        """Short label such as ``best 0.3 s``; empty before the first score."""
        if not len(self._front):
            return ""
        if self._objective.pareto:
            return f"front of {len(self._front)}"
        return (
            f"best {self._objective.convert_orientation(float(self._front[0, 0])):.3g} {self._objective.unit}".rstrip()
        )
