"""Check whether the critical set is known well enough to stop."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray
from cornercase.evidence._critical_set_estimate import CriticalSet
from cornercase.evidence._multi_fidelity import SourceStudyModel
from cornercase.exploration._study_critical_set import is_score_independent, uses_features_for_critical_set
from cornercase.metrics import registered_features
from cornercase.scenario import ParameterSpace
from cornercase.stop._stop_rules import StopCriterion
from cornercase.study._criterion import Criterion

# Minimum number of scenarios to judge a critical set, and the growth after which it is judged again.
_MIN_SCENARIOS, _GROWTH = 40, 1.1


class StopCriteria:
    """Stop criteria of a search, with the results by which they are checked.

    `criterion` says which scores are critical. `optimizer` determines which points were chosen independently of scores.
    Raises `InputError` if there are stop criteria but no criterion, or ``audited-missed`` without audits (scenarios
    drawn at random as a check).
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
            raise InputError(
                "`stop_when`: audited-missed needs audits, scenarios drawn at random as a check; begin a new study with"
                " `audit`, for example 0.1."
            )
        if criteria and criterion is None:
            raise InputError("`stop_when`: needs a threshold; set one with `critical`.")
        self._criteria, self._space, self._criterion, self._seed = tuple(criteria), space, criterion, seed
        self._optimizer, self._source_model = optimizer, source_model
        self._points, self._scores = np.zeros((0, space.dimension)), np.zeros(0)
        self._audit_points, self._audit_scores = self._points, self._scores
        self._features: list[FloatArray] = []
        # How many scenarios and audits the check that is due uses, None for all; None if no check is due.
        self._due: tuple[int | None, int | None] | None = None

    @property
    def has_criteria(self) -> bool:
        """True if there are criteria; without criteria, results are not collected."""
        return bool(self._criteria)

    def add_results(self, points: FloatArray, scores: FloatArray, features: FloatArray | None = None) -> None:
        """Add m points, shape (m, d), with scores, shape (m,), and features, shape (m, f), if known.

        Lower scores are more critical. Scores and features are NaN if the scenario failed.
        """
        if self._criteria:
            n_before = len(self._scores)
            self._features += [] if features is None else [features]
            self._points = np.concatenate([self._points, points])
            self._scores = np.concatenate([self._scores, scores])
            if _n_checks(len(self._scores)) > _n_checks(n_before):
                self._due = len(self._scores), len(self._audit_scores)

    def add_audits(self, points: FloatArray, scores: FloatArray) -> None:
        """Add the points and scores of audits, like `add_results`."""
        if self._criteria:
            self._audit_points = np.concatenate([self._audit_points, points])
            self._audit_scores = np.concatenate([self._audit_scores, scores])

    def describe_if_all_reached(self) -> str | None:
        """Describe how well the critical set is known if all criteria hold, else None.

        Criteria are checked whenever the number of scenarios has grown by a tenth. When they are checked depends on the
        number of scenarios alone, so a resumed search ends like an uninterrupted search. It first repeats the last
        check that was due, with the scenarios of that time, since its criteria may be new.
        """
        if self._due is None:
            return None
        values, self._due = self._values(*self._due), None
        if values is None or not all(value < rule.bound for rule, value in values):
            return None
        return " and ".join(rule.describe_value(value) for rule, value in values)

    def request_check(self) -> None:
        """Make the next call of `describe_if_all_reached` check the criteria, whatever the number of scenarios.

        So a resumed search that had ended by its criteria ends again at once if the criteria still hold.
        """
        self._due = None, None

    def describe_not_reached(self) -> str:
        """Return which criteria do not hold, as text to append to a sentence; empty if all criteria hold."""
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

    def _values(
        self, n_scenarios: int | None = None, n_audits: int | None = None
    ) -> list[tuple[StopCriterion, float]] | None:
        """Return each criterion with the value of its quantity; None if too little is known.

        Only the first `n_scenarios` and `n_audits` count; all by default.
        """
        points, scores = self._points[:n_scenarios], self._scores[:n_scenarios]
        if not self._criteria or self._criterion is None or len(scores) < _MIN_SCENARIOS:
            return None
        features = None
        if self._features and uses_features_for_critical_set(self._optimizer, int(np.isfinite(scores).sum())):
            features = registered_features(), np.concatenate(self._features)[:n_scenarios]
        try:
            critical_set = CriticalSet(
                self._space,
                points,
                scores,
                self._criterion,
                self._seed,
                initial_design=is_score_independent(self._optimizer, self._space, self._seed, points),
                audits=(self._audit_points[:n_audits], self._audit_scores[:n_audits]),
                features=features,
                source_model=self._source_model,
            )
        except ValueError:
            return None
        return [(rule, rule.evaluate(critical_set)) for rule in self._criteria]


def _n_checks(n_scenarios: int) -> int:
    """Return how many checks of the criteria are due by the time there are `n_scenarios` scenarios."""
    return 0 if n_scenarios < _MIN_SCENARIOS else 1 + int(math.log(n_scenarios / _MIN_SCENARIOS, _GROWTH))
