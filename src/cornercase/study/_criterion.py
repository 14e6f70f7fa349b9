"""When a scenario is critical: threshold and orientation of an objective."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.study._meta import StudyMeta
from cornercase.study._objective import Objective


@dataclass(frozen=True)
class Criterion:
    """Threshold of an objective: `raw` in its unit, as users give it and studies store it; None without one."""

    objective: Objective
    raw: float | None

    @classmethod
    def from_study_meta(cls, meta: StudyMeta, raw: float | None = None) -> Criterion:
        """Criterion of a stored study; `raw` replaces its threshold."""
        return cls(Objective.from_study_meta(meta), meta.critical if raw is None else raw)

    @classmethod
    def from_given(cls, objective: Objective, given: float | None, *, is_required: bool = True) -> Criterion:
        """Criterion of the threshold that the user gives, or of the metric's own without one.

        Raises `InputError` if a threshold is given for a Pareto front, or if one is required and there is none.
        """
        raw, reason = given, ""
        if objective.pareto:
            reason = "`pareto`: a Pareto front has no threshold; use `weights` to combine the metrics into one score."
        elif objective.weights:
            if given is None:
                reason = "`weights`: set `critical` to the weighted sum up to which a scenario is critical."
        elif given is not None or is_required or objective.metrics[0].default_threshold is not None:
            raw = objective.metrics[0].resolve_threshold(given)
        if reason and (is_required or given is not None):
            raise InputError(reason)
        return cls(objective, None if raw is None else float(raw))

    @property
    def oriented(self) -> float | None:
        """Oriented score up to which a scenario is critical; None without a threshold and for a Pareto front."""
        return None if self.raw is None or self.objective.pareto else self.objective.convert_orientation(self.raw)

    def is_critical(self, scores: FloatArray) -> BoolArray:
        """Return which scenarios are critical, shape (m,), by their oriented scores; none without a threshold."""
        threshold = self.oriented
        return np.zeros(len(scores), dtype=np.bool_) if threshold is None else np.asarray(scores <= threshold)

    def is_critical_raw(self, scores: FloatArray) -> BoolArray:
        """Return which scenarios are critical, shape (m,), by raw scores of shape (m, metrics)."""
        return self.is_critical(self.objective.minimized(scores))
