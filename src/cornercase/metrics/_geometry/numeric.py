"""Checks of numeric options of metrics, and a safe quotient."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray


def check_nonnegative_options(metric_name: str, **numbers: float) -> None:
    """Raise InputError if an option of the metric `metric_name` is negative or not finite."""
    for option, number in numbers.items():
        if not 0.0 <= number < np.inf:
            raise InputError(f"{metric_name} cannot take {number} for {option}; give a finite number of 0 or more.")


def divide_by_positive_or_inf(numerator: npt.NDArray[Any], divisor: npt.NDArray[Any] | float) -> FloatArray:
    """Return the quotient: 0 if the numerator is 0, otherwise inf if the divisor is not positive."""
    divisor = np.broadcast_to(divisor, numerator.shape)
    positive = divisor > 0.0
    quotient = np.where(positive, numerator / np.where(positive, divisor, 1.0), np.inf)
    return np.where(np.isnan(numerator + divisor), np.nan, np.where(numerator == 0.0, 0.0, quotient))
