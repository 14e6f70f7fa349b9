"""Check whether the critical set is known well enough to stop."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray
from cornercase.evidence._critical_set_estimate import CriticalSet
from cornercase.evidence._multi_fidelity import SourceStudyModel
from cornercase.exploration._study_critical_set import is_score_independent
from cornercase.metrics import registered_features
from cornercase.scenario import ParameterSpace
from cornercase.stop._stop_rules import StopCriterion
from cornercase.study._criterion import Criterion

# Minimum number of scenarios to judge a critical set.
_MIN_SCENARIOS: Final = 40


class StopCriteria:
    """Collects results, and checks if all stop criteria hold.

    `criterion` is that of being critical. `optimizer` determines which points are independent of scores. Raises
    `InputError` if there are stop criteria but no criterion, or ``audited-missed`` without audits.
    """

    def __init__(
        self,
        criteria: Sequence[StopCriterion],
        space: ParameterSpace,
        criterion: Criterion | None,
        seed: int,
        optimizer: str,
        has_audits: bool = False,
        source_model: SourceStudyModel | None = None,
    ) -> None:
        if not has_audits and any(rule.quantity == "audited-missed" for rule in criteria):
            raise InputError("`stop_when`: audited-missed needs audits; begin a study with `audit`, for example 0.1.")
        if criteria and criterion is None:
            raise InputError("`stop_when`: needs a threshold; set one with `critical`.")
        self._criteria, self._space, self._criterion, self._seed = tuple(criteria), space, criterion, seed
        self._optimizer, self._source_model = optimizer, source_model
        self._points, self._scores = np.zeros((0, space.dimension)), np.zeros(0)
        self._audit_points, self._audit_scores = self._points, self._scores
        self._features: list[FloatArray] = []

    def add_results(self, points: FloatArray, scores: FloatArray, features: FloatArray | None = None) -> None:
        """Add points (m, d) and scores (m,), lower where more critical, NaN if failed.

        `features` (m, f) are added if the search uses features.
        """
        if self._criteria:
            self._features += [] if features is None else [features]
            self._points = np.concatenate([self._points, points])
            self._scores = np.concatenate([self._scores, scores])

    def add_audits(self, points: FloatArray, scores: FloatArray) -> None:
        """Add the points and scores of audits, like `add_results`."""
        if self._criteria:
            self._audit_points = np.concatenate([self._audit_points, points])
            self._audit_scores = np.concatenate([self._audit_scores, scores])

    @property
    def is_ready(self) -> bool:
        """Whether there are criteria and enough scenarios to check them."""
        return bool(self._criteria) and len(self._scores) >= _MIN_SCENARIOS

    def describe_if_all_reached(self) -> str | None:
        """Describe how well the critical set is known if all criteria hold, else None."""
        values = self._values()
        if values is None or not all(value < rule.bound for rule, value in values):
            return None
        return " and ".join(rule.describe_value(value) for rule, value in values)

    def describe_not_reached(self) -> str:
        """Continue a sentence on why the search ended: which criteria do not hold. Empty if all do."""
        if not self._criteria:
            return ""
        values = self._values()
        if values is None:
            return f", and too little is known to judge {' and '.join(map(str, self._criteria))}"
        return "".join(
            f", and {rule} is not reached: {rule.describe_value(value)}"
            for rule, value in values
            if value >= rule.bound
        )

    def _values(self) -> list[tuple[StopCriterion, float]] | None:
        """Return each criterion with the value of its quantity; None if too little is known."""
        if not self.is_ready or self._criterion is None:
            return None
        try:
            critical_set = CriticalSet(
                self._space,
                self._points,
                self._scores,
                self._criterion,
                self._seed,
                initial_design=is_score_independent(self._optimizer, self._space, self._seed, self._points),
                audits=(self._audit_points, self._audit_scores),
                features=(registered_features(), np.concatenate(self._features)) if self._features else None,
                source_model=self._source_model,
            )
        except ValueError:
            return None
        return [(rule, rule.evaluate(critical_set)) for rule in self._criteria]
