"""What is searched: the score of one metric, a weighted sum of several, or the Pareto front of all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from cornercase._common.errors import InputError, suggestion
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.metrics import METRICS, Metric
from cornercase.study import Study, StudyMeta


class Objective:
    """Turns the scores of the metrics into oriented scores, which a search makes as low as it can.

    What is searched is the first metric, or with weights the sum of weight times oriented score. For a Pareto front
    each metric stays by itself.

    Parameters
    ----------
    metrics : sequence of Metric
    weights : mapping of str to float, optional
        By metric, per unit of its score; a metric without weight does not count.
    pareto : bool, default False

    Raises
    ------
    InputError
        There is no metric, a weight is of none of them or not above 0, there are weights of a Pareto front, or a
        front of one metric.
    """

    def __init__(
        self, metrics: Sequence[Metric], weights: Mapping[str, float] | None = None, pareto: bool = False
    ) -> None:
        if not metrics:
            raise InputError("There is no metric to search; name one with `metrics`.")
        self.metrics, self.weights, self.pareto = list(metrics), dict(weights or {}), pareto
        if pareto and (self.weights or len(metrics) < 2):
            raise InputError("`pareto`: takes two metrics or more, and no `weights`.")
        names = [metric.name for metric in metrics]
        for name, weight in self.weights.items():
            if name not in names:
                raise InputError(f"`weights` {name}: is none of the metrics; {suggestion(name, names)}")
            if not 0.0 < weight < np.inf:
                raise InputError(f"`weights` {name}={weight:g}: give a number above 0.")
        self._factors = self._matrix()

    @classmethod
    def of_study(cls, meta: StudyMeta) -> Objective:
        """Make the objective of a study.

        Parameters
        ----------
        meta : StudyMeta

        Returns
        -------
        Objective
        """
        metrics = [METRICS.create(name) for name in meta.metrics]
        return cls(metrics, meta.weights, meta.pareto)

    def _matrix(self) -> FloatArray:
        signs = np.array([metric.oriented(1.0) for metric in self.metrics])
        if self.pareto:
            return np.diag(signs)
        weights = [self.weights.get(metric.name, 0.0) for metric in self.metrics]
        chosen = np.array(weights) if self.weights else np.eye(len(signs))[0]
        return np.asarray((chosen * signs)[:, None])

    def oriented(self, scores: FloatArray) -> FloatArray:
        """Oriented scores of what is searched.

        Parameters
        ----------
        scores : ndarray of float64, shape (m, metrics)

        Returns
        -------
        ndarray of float64, shape (m,), or (m, metrics) for a Pareto front
        """
        # Left out of the sum, since NaN times 0 is NaN.
        used = self._factors.any(axis=1)
        # Weights without measure give infinite sums.
        with np.errstate(over="ignore", invalid="ignore"):
            values = scores[:, used] @ self._factors[used]
        return np.asarray(values if self.pareto else values[:, 0])

    def oriented_of(self, study: Study) -> FloatArray:
        """Oriented scores of all scenarios of a study that did not fail.

        Parameters
        ----------
        study : Study

        Returns
        -------
        ndarray of float64, shape (n,), or (n, metrics) for a Pareto front
        """
        return self.oriented(self._scores(study))

    def _scores(self, study: Study) -> FloatArray:
        return np.stack([study.scores(metric.name) for metric in self.metrics], axis=1)

    def critical(self, scores: FloatArray, threshold: float | None) -> BoolArray:
        """Tell which scenarios are critical.

        Parameters
        ----------
        scores : ndarray of float64, shape (m, metrics)
            In the metrics' units.
        threshold : float or None
            As `StudyMeta.critical` has it.

        Returns
        -------
        ndarray of bool, shape (m,)
            None is where no threshold says so, or a Pareto front is searched.
        """
        if threshold is None or self.pareto:
            return np.zeros(len(scores), dtype=np.bool_)
        return np.asarray(self.oriented(scores) <= self.flip(threshold))

    def critical_of(self, study: Study) -> BoolArray:
        """Tell which scenarios of a study are critical, of all that did not fail.

        Parameters
        ----------
        study : Study

        Returns
        -------
        ndarray of bool, shape (n,)
        """
        return self.critical(self._scores(study), study.critical)

    @property
    def text(self) -> str:
        """What is searched, in words."""
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
        """Whether less of what is searched is more critical; of a weighted sum it is."""
        return bool(self.weights) or self.metrics[0].lower_is_critical

    @property
    def unit(self) -> str:
        """Unit of what is searched; empty for a weighted sum."""
        return "" if self.weights or self.pareto or self.metrics[0].unit == "1" else self.metrics[0].unit

    def threshold(self, given: float | None) -> float:
        """Oriented score up to which a scenario is critical.

        Parameters
        ----------
        given : float, optional
            As the user says it: a score of the metric that is searched, or a weighted sum. By default the metric's
            own threshold.

        Returns
        -------
        float

        Raises
        ------
        InputError
            A Pareto front has none; or there is none of its own, and none is given.
        """
        if self.pareto:
            raise InputError("`pareto`: what is critical needs one score; weigh the metrics with `weights` instead.")
        if self.weights:
            if given is None:
                raise InputError("`weights`: give with `critical` the weighted sum up to which a scenario is critical.")
            return float(given)
        return self.flip(self.metrics[0].find_threshold(given))

    def known_threshold(self, given: float | None) -> float | None:
        """Oriented score up to which a scenario is critical, where that is known.

        Parameters
        ----------
        given : float, optional
            As for `threshold`.

        Returns
        -------
        float or None
            None where none is given and the metric has none of its own.

        Raises
        ------
        InputError
            The one that is given cannot be used.
        """
        try:
            return self.threshold(given)
        except InputError:
            if given is not None:
                raise
            return None

    def flip(self, value: float) -> float:
        """Orient one score of what is searched, or turn an oriented one back.

        Parameters
        ----------
        value : float

        Returns
        -------
        float
            A weighted sum is oriented already, and stays as it is.
        """
        return value if self.weights else self.metrics[0].oriented(value)

    @property
    def uncritical(self) -> FloatArray:
        """Oriented scores of a scenario with every score at its cap, shape (1,) or (metrics,)."""
        return self.oriented(np.array([[metric.cap for metric in self.metrics]])).ravel()


def on_front(values: FloatArray) -> BoolArray:
    """Tell which rows lie on the Pareto front: no other is lower or equal in all columns, and lower in one.

    Parameters
    ----------
    values : ndarray of float64, shape (m, k)
        A row with NaN is on no front.

    Returns
    -------
    ndarray of bool, shape (m,)

    Notes
    -----
    Source: H. T. Kung, F. Luccio, F. P. Preparata, "On finding the maxima of a set of vectors", Journal of the ACM 22
    (1975); implemented in moocore.
    """
    known = np.isfinite(values).all(axis=1)
    if not known.any():
        return np.asarray(known)
    front = known.copy()
    if values.shape[1] == 1:
        front[known] = values[known, 0] == values[known].min()
    else:
        # Slow to import, and only fronts need it.
        from moocore import is_nondominated

        front[known] = is_nondominated(values[known], keep_weakly=True)
    return np.asarray(front)


class Best:
    """The most critical there was so far: a value, or a Pareto front."""

    def __init__(self, objective: Objective) -> None:
        self._objective = objective
        self._front = np.zeros((0, 1))

    def add(self, scores: FloatArray) -> bool:
        """Take the oriented scores of a round.

        Parameters
        ----------
        scores : ndarray of float64, shape (m,) or (m, k)
            NaN for a scenario that failed.

        Returns
        -------
        bool
            Whether any is new: nothing that was known dominates it, and it is not known already with every score at
            its cap.
        """
        values = scores.reshape(len(scores), -1)
        values = values[np.isfinite(values).all(axis=1)]
        if not len(values):
            return False
        if values.shape[1] == 1:
            return self._add_single(values)
        before = self._front if len(self._front) else np.full((1, values.shape[1]), np.inf)
        worse = (before[:, None] <= values).all(axis=2) & (before[:, None] < values).any(axis=2)
        same = (before[:, None] == values).all(axis=2).any(axis=0)
        capped = (values >= self._objective.uncritical).all(axis=1)
        news = ~worse.any(axis=0) & ~(same & capped)
        everyone = np.unique(np.concatenate([self._front.reshape(-1, values.shape[1]), values]), axis=0)
        self._front = everyone[on_front(everyone)]
        return bool(news.any())

    def _add_single(self, values: FloatArray) -> bool:
        """As `add`, of one score each: it is called for each scenario, and a front is its lowest score."""
        best = float(self._front[0, 0]) if len(self._front) else np.inf
        news = (values <= best) & ~((values == best) & (values >= self._objective.uncritical))
        self._front = np.full((1, 1), min(best, float(values.min())))
        return bool(news.any())

    @property
    def text(self) -> str:
        """In a few words; empty before anything is known."""
        if not len(self._front):
            return ""
        if self._objective.pareto:
            return f"front of {len(self._front)}"
        return f"best {self._objective.flip(float(self._front[0, 0])):.3g} {self._objective.unit}".rstrip()
