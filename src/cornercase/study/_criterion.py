"""The criterion for critical scenarios: a threshold of scores, and the side of the threshold that is critical."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray


@dataclass(frozen=True)
class Criterion:
    """Threshold of scores, with the side of the threshold that is critical.

    `threshold` is in `unit`, as users give it and studies store it. The methods take oriented scores, as models and
    optimizers get them: the sign is changed if high scores are critical, so that lower is always more critical.
    """

    threshold: float
    lower_is_critical: bool = True
    unit: str = ""

    def __str__(self) -> str:
        return f"{'<=' if self.lower_is_critical else '>='} {self.threshold:g} {self.unit}".rstrip()

    @property
    def oriented(self) -> float:
        """Threshold of oriented scores (lower is more critical)."""
        return self.threshold if self.lower_is_critical else -self.threshold

    def margins(self, oriented_scores: FloatArray) -> FloatArray:
        """Return oriented scores minus the threshold, of the same shape; a score is critical if this is 0 or less."""
        return oriented_scores - self.oriented

    def is_critical(self, oriented_scores: FloatArray) -> BoolArray:
        """Return a mask of critical scores, of the same shape; NaN is not critical."""
        return np.asarray(oriented_scores <= self.oriented)
