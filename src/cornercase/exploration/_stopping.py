"""Stop criteria on how well the critical set is known."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray
from cornercase.evidence._critical_set_estimate import MIN_REGION_FRACTION, CriticalSet
from cornercase.evidence._multi_fidelity import SourceStudyModel
from cornercase.exploration._study_critical_set import is_score_independent
from cornercase.metrics import registered_features
from cornercase.scenario import ParameterSpace

# Minimum number of scenarios to judge a critical set.
_MIN_SCENARIOS: Final = 40

_CRITERION_PATTERN = re.compile(r"(?P<what>[a-z-]+)(?:\((?P<size>[^()]*)\))?<(?P<below>.+)")

_SIZED_QUANTITIES = ("overlooked", "unvisited")
_QUANTITIES = ("missed", "interval", "audited-missed", *_SIZED_QUANTITIES)


@dataclass(frozen=True)
class StopCriterion:
    """An upper bound on a quantity of a `CriticalSet`.

    `what`: ``missed``: upper end of the 90 % interval of the missed fraction of the critical set, plus what an
    undetected region could add; ``interval``: width of the interval of the critical fraction of the space;
    ``audited-missed``: upper bound of the missed fraction by the audits; ``overlooked``: probability that a critical
    region was overlooked; ``unvisited``: fraction of the space around which nothing was run. `size` is the smallest
    region that counts, as a fraction of the space.
    """

    quantity: str
    bound: float
    size: float = MIN_REGION_FRACTION

    @classmethod
    def parse(cls, text: str) -> StopCriterion:
        """Parse a criterion such as ``missed<0.01`` or ``overlooked(0.02)<0.05``."""
        match = _CRITERION_PATTERN.fullmatch(text.replace(" ", ""))
        if match is None or match["what"] not in _QUANTITIES:
            raise InputError(
                f"`stop_when` {text}: write it as missed<0.01, interval<0.05, overlooked(0.01)<0.05,"
                " unvisited(0.01)<0.05 or audited-missed<0.1, in quotes."
            )
        if match["size"] is not None and match["what"] not in _SIZED_QUANTITIES:
            raise InputError(f"`stop_when` {text}: only overlooked and unvisited accept a size.")
        size = _parse_fraction(match["size"], text) if match["size"] else MIN_REGION_FRACTION
        return cls(match["what"], _parse_fraction(match["below"], text), size)

    def evaluate(self, critical_set: CriticalSet) -> float:
        """Value of the quantity, from 0 to 1; 1 if it is unknown."""
        if self.quantity == "missed":
            return (
                1.0
                if critical_set.missed_interval_unavailable
                else min(critical_set.missed_fraction.high + critical_set.max_hidden_fraction, 1.0)
            )
        if self.quantity == "audited-missed":
            return critical_set.audited_missed_upper_bound
        if self.quantity == "interval":
            return (
                1.0
                if critical_set.interval_unavailable
                else critical_set.critical_fraction.high - critical_set.critical_fraction.low
            )
        return (
            critical_set.p_overlooked_region(self.size)
            if self.quantity == "overlooked"
            else critical_set.unexplored_fraction(self.size)
        )

    def describe_value(self, value: float) -> str:
        """Describe the value that was reached."""
        if self.quantity == "missed":
            return f"at most {value:.2%} of the critical set is missed"
        if self.quantity == "audited-missed":
            return f"according to the audits, at most {value:.2%} of the critical set is missed"
        if self.quantity == "interval":
            return f"the critical share is known within {value:.2%}"
        if self.quantity == "unvisited":
            return f"in {value:.2%} of the space, no scenario was run within a region of {self.size:.2%}"
        return f"with a probability of {value:.2%} a critical region of {self.size:.2%} or more was overlooked"


class StopCriteria:
    """Collects results and checks if all stop criteria hold.

    `threshold` is a minimized score, `optimizer` the search (it determines which points are independent of scores).
    Raises `InputError` if there are criteria without a threshold, or ``audited-missed`` without audits.
    """

    def __init__(
        self,
        criteria: Sequence[StopCriterion],
        space: ParameterSpace,
        threshold: float | None,
        seed: int,
        optimizer: str,
        has_audits: bool = False,
        source_model: SourceStudyModel | None = None,
    ) -> None:
        if not has_audits and any(criterion.quantity == "audited-missed" for criterion in criteria):
            raise InputError("`stop_when`: audited-missed needs audits; set `audit`, for example to 0.1.")
        if criteria and threshold is None:
            raise InputError("`stop_when`: needs a threshold; set one with `critical`.")
        self._criteria, self._space, self._threshold, self._seed = tuple(criteria), space, threshold, seed
        self._optimizer, self._source_model = optimizer, source_model
        self._points, self._scores = np.zeros((0, space.dimension)), np.zeros(0)
        self._audit_points, self._audit_scores = self._points, self._scores
        self._features: list[FloatArray] = []

    def add_results(self, points: FloatArray, scores: FloatArray, features: FloatArray | None = None) -> None:
        """Add points (m, d), minimized scores (m,), NaN if failed, and features (m, f) if the search uses them."""
        if self._criteria:
            self._features += [] if features is None else [features]
            self._points = np.concatenate([self._points, points])
            self._scores = np.concatenate([self._scores, scores])

    def add_audits(self, points: FloatArray, scores: FloatArray) -> None:
        """Add audits as in `add_results`."""
        if self._criteria:
            self._audit_points = np.concatenate([self._audit_points, points])
            self._audit_scores = np.concatenate([self._audit_scores, scores])

    @property
    def is_ready(self) -> bool:
        """Whether there are criteria and enough scenarios to check them."""
        return bool(self._criteria) and len(self._scores) >= _MIN_SCENARIOS

    def describe_reached(self) -> str | None:
        """Describe how well the critical set is known if all criteria hold, else None."""
        if not self.is_ready or self._threshold is None:
            return None
        try:
            critical_set = CriticalSet(
                self._space,
                self._points,
                self._scores,
                self._threshold,
                self._seed,
                initial_design=is_score_independent(self._optimizer, self._space, self._seed, self._points),
                audits=(self._audit_points, self._audit_scores),
                features=(registered_features(), np.concatenate(self._features)) if self._features else None,
                source_model=self._source_model,
            )
        except ValueError:
            return None
        values = [criterion.evaluate(critical_set) for criterion in self._criteria]
        if any(value >= criterion.bound for criterion, value in zip(self._criteria, values, strict=True)):
            return None
        return " and ".join(
            criterion.describe_value(value) for criterion, value in zip(self._criteria, values, strict=True)
        )


def _parse_fraction(text: str, criterion: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = float("nan")
    if not 0.0 < number <= 1.0:
        raise InputError(f"`stop_when` {criterion}: '{text}' has to be a number above 0 and up to 1.")
    return number
