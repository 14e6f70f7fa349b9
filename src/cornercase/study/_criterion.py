"""When a scenario is critical: the threshold of an objective, and which side of it counts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.study._meta import StudyMeta
from cornercase.study._objective import Objective


@dataclass(frozen=True)
class Criterion:
    """The threshold of an objective; None if there is none.

    `raw` is in the unit of the objective, as users give it and studies store it. `oriented` is for minimized scores.
    """

    objective: Objective
    raw: float | None

    @classmethod
    def from_study_meta(cls, meta: StudyMeta, raw: float | None = None) -> Criterion:
        """Return the criterion of a stored study, with the threshold `raw` if it is given."""
        return cls(Objective.from_study_meta(meta), meta.critical if raw is None else raw)

    @classmethod
    def from_given(cls, objective: Objective, given: float | None, *, is_required: bool = True) -> Criterion:
        """Return the criterion with the user's threshold, or else with the default threshold of the metric.

        `InputError` if a threshold is given for a Pareto front, or if one is required and there is none.
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
        """The threshold for minimized scores; None if there is none.

        A scenario is critical if its minimized score is at most this.
        """
        return None if self.raw is None or self.objective.pareto else self.objective.convert_orientation(self.raw)

    def is_critical(self, scores: FloatArray) -> BoolArray:
        """Return a mask, shape (m,), of critical scenarios from minimized scores; all False without a threshold."""
        threshold = self.oriented
        return np.zeros(len(scores), dtype=np.bool_) if threshold is None else np.asarray(scores <= threshold)

    def is_critical_raw(self, scores: FloatArray) -> BoolArray:
        """Return a mask, shape (m,), of critical scenarios from scores in the metrics' units, shape (m, metrics)."""
        return self.is_critical(self.objective.minimized(scores))
