"""The objective of a search: the score of one metric, a weighted sum of several, or the Pareto front of all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from cornercase._common.errors import InputError, suggest_name
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.metrics import METRICS, Metric
from cornercase.study._criterion import Criterion
from cornercase.study._meta import StudyMeta

if TYPE_CHECKING:
    from cornercase.study._study_file import StudyFile


class Objective:
    """Objective of a search, which turns the scores of metrics into scores to minimize.

    The objective is the first metric, a weighted sum of metrics, or (for a Pareto front) all metrics. `weights` maps a
    metric to its weight per unit of score; metrics without a weight do not count in the sum. `criterion` says when a
    scenario is critical; `criterion` is None without `threshold`, and for a Pareto front. Raises `InputError` if there
    is no metric, or if a weight is not positive, is infinite, or belongs to an unknown metric. A Pareto front takes no
    weights, and needs at least two metrics.
    """

    def __init__(
        self,
        metrics: Sequence[Metric],
        weights: Mapping[str, float] | None = None,
        pareto: bool = False,
        threshold: float | None = None,
    ) -> None:
        if not metrics:
            raise InputError("No metric was given, so there is nothing to search for; name a metric with `metrics`.")
        self.metrics, self.weights, self.pareto = list(metrics), dict(weights or {}), pareto
        if pareto and (self.weights or len(metrics) < 2):
            raise InputError("`pareto`: give at least two `metrics`, and leave `weights` out.")
        names = [metric.name for metric in metrics]
        for name, weight in self.weights.items():
            if name not in names:
                if name.partition(":")[0] in METRICS:
                    raise InputError(
                        f"`weights` {name}: is not one of the `metrics` ({', '.join(names)}); add {name} to `metrics`."
                    )
                raise InputError(f"`weights` {name}: is not one of the metrics; {suggest_name(name, names)}")
            if not 0.0 < weight < np.inf:
                is_low = metrics[names.index(name)].lower_is_critical
                hint = "" if is_low or weight > 0.0 else f"; a high {name} counts as critical without a minus"
                number = "finite number" if weight == np.inf else "number"
                raise InputError(f"`weights` {name}={weight:g}: give a {number} above 0{hint}.")
        self._score_factors = self._make_score_factors()
        self.criterion: Criterion | None = None
        if threshold is not None and not pareto:
            self.criterion = Criterion(float(threshold), self.lower_is_critical, self.unit)

    @classmethod
    def from_study_meta(cls, meta: StudyMeta, threshold: float | None = None) -> Objective:
        """Return the objective of a stored study; `threshold` replaces the stored threshold."""
        return cls(meta.create_metrics(), meta.weights, meta.pareto, meta.critical if threshold is None else threshold)

    def with_threshold(self, given: float | None, *, is_required: bool = True) -> Objective:
        """Return the objective with the given threshold, or with the default of the metric if `given` is None.

        Raises `InputError` if a threshold is given for a Pareto front, or if a threshold is required and there is none.
        """
        threshold = given
        if self.pareto:
            if is_required or given is not None:
                raise InputError(
                    "`pareto`: a Pareto front has no threshold; use `weights` to combine the metrics into one score."
                )
        elif self.weights:
            if is_required and given is None:
                raise InputError(
                    "`weights`: a weighted sum has no default threshold; set `critical` to the highest weighted sum"
                    " that counts as critical."
                )
        elif given is not None or is_required or self.metrics[0].default_threshold is not None:
            threshold = self.metrics[0].resolve_threshold(given)
        return Objective(self.metrics, self.weights, self.pareto, threshold)

    def _make_score_factors(self) -> FloatArray:
        signs = np.array([metric.to_minimize(1.0) for metric in self.metrics])
        if self.pareto:
            return np.diag(signs)
        weights = [self.weights.get(metric.name, 0.0) for metric in self.metrics]
        weight_vector = np.array(weights) if self.weights else np.eye(len(signs))[0]
        return np.asarray((weight_vector * signs)[:, None])

    def compute_scores_to_minimize(self, scores: FloatArray) -> FloatArray:
        """Return the values that the optimizer minimizes, shape (m,), or (m, metrics) for a Pareto front.

        `scores`: scores of m scenarios in the units of the metrics, shape (m, metrics).
        """
        # Skip unused metrics: NaN times 0 is NaN.
        has_weight = self._score_factors.any(axis=1)
        # Extreme weights may overflow.
        with np.errstate(over="ignore", invalid="ignore"):
            values = scores[:, has_weight] @ self._score_factors[has_weight]
        return np.asarray(values if self.pareto else values[:, 0])

    def minimized_scores(self, study: StudyFile) -> FloatArray:
        """Return the values that the optimizer minimizes, for the n scenarios that ran without failing.

        The result has shape (n,), or (n, metrics) for a Pareto front.
        """
        return self.compute_scores_to_minimize(np.stack([study.scores(metric.name) for metric in self.metrics], axis=1))

    def critical_mask(self, minimized: FloatArray) -> BoolArray:
        """Return a mask of critical scenarios from scores to minimize, both of shape (m,); False without threshold."""
        if self.criterion is None:
            return np.zeros(len(minimized), dtype=np.bool_)
        return self.criterion.is_critical(minimized)

    def is_critical(self, scores: Mapping[str, float]) -> bool:
        """Return whether a scenario is critical, from its scores by metric; False without a threshold."""
        return bool(
            self.critical_mask(
                self.compute_scores_to_minimize(np.array([[scores[metric.name] for metric in self.metrics]]))
            )[0]
        )

    @property
    def threshold(self) -> float | None:
        """Threshold in the unit of the objective, as studies store it; None if there is none."""
        return None if self.criterion is None else self.criterion.threshold

    @property
    def label(self) -> str:
        """Text of the objective, such as ``2 ttc + 1 (-speed)``."""
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
        """True if lower values of the objective are more critical; always True for a weighted sum."""
        return bool(self.weights) or self.metrics[0].lower_is_critical

    @property
    def unit(self) -> str:
        """Unit of the objective; empty for a weighted sum or a Pareto front."""
        return "" if self.weights or self.pareto or self.metrics[0].unit == "1" else self.metrics[0].unit

    def convert_orientation(self, score: float) -> float:
        """Turn a score in the objective's unit into a score to minimize, or back.

        The sign is changed if high scores of the metric are critical. A weighted sum stays as it is.
        """
        return score if self.weights else self.metrics[0].to_minimize(score)

    @property
    def least_critical_scores(self) -> FloatArray:
        """Scores to minimize of a scenario in which every metric has its least critical value (cap).

        The shape is (1,), or (metrics,) for a Pareto front.
        """
        return self.compute_scores_to_minimize(np.array([[metric.cap for metric in self.metrics]])).ravel()
