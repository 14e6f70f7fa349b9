"""When a scenario is critical: a threshold of scores, and which side of it counts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray


@dataclass(frozen=True)
class Criterion:
    """A threshold of scores, and which side of it is critical.

    `threshold` is in `unit`, as users give it and studies store it. The methods take oriented scores, as models and
    optimizers get them: lower is more critical, whatever side of the threshold is critical.
    """

    threshold: float
    lower_is_critical: bool = True
    unit: str = ""

    def __str__(self) -> str:
        return f"{'<=' if self.lower_is_critical else '>='} {self.threshold:g} {self.unit}".rstrip()

    @property
    def oriented(self) -> float:
        """The threshold of oriented scores."""
        return self.threshold if self.lower_is_critical else -self.threshold

    def margins(self, oriented_scores: FloatArray) -> FloatArray:
        """Return how far scores are from being critical, of the same shape; negative if they are."""
        return oriented_scores - self.oriented

    def is_critical(self, oriented_scores: FloatArray) -> BoolArray:
        """Return a mask of critical scores, of the same shape; NaN is not critical."""
        return np.asarray(oriented_scores <= self.oriented)
