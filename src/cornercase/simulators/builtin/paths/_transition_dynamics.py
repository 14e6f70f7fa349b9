"""Transitions from one value to another: shapes and dimensions of ``TransitionDynamics`` in scenario files."""

from __future__ import annotations

from typing import Final

import numpy as np
from lxml import etree

from cornercase._common.typing import BoolArray, FloatArray
from cornercase.scenario._scope import Scope
from cornercase.simulators.builtin.kernels._action_table import DYNAMICS_DIMENSIONS, DYNAMICS_SHAPES

# Largest slope of a transition from 0 to 1 in a time of 1.
_PEAK_SLOPE: Final = {"linear": 1.0, "cubic": 1.5, "sinusoidal": 0.5 * np.pi, "step": 1.0}

# s and m/s; smaller differences are ignored.
_EPSILON: Final = 1e-6


class TransitionDynamics:
    """A transition from one value to another, with shape, dimension and value from a scenario file."""

    def __init__(self, element: etree._Element, scope: Scope) -> None:
        self.shape = scope.read_text(element, "dynamicsShape")
        self.dimension = scope.read_text(element, "dynamicsDimension", "time")
        self.value = scope.read_numbers(element, "value", 0.0)
        check_dynamics_shape(self.shape, element, scope)
        if self.dimension not in ("time", "rate", "distance"):
            raise scope.error_at(
                element, f"dynamicsDimension '{self.dimension}' of <{element.tag}> is not time, rate or distance."
            )
        # The sign of a rate is ignored, as files give braking with a minus.
        if self.dimension != "rate":
            scope.mark_invalid(element, "value", "is below 0", self.value < 0.0)

    @property
    def kernel_options(self) -> tuple[int, int]:
        return DYNAMICS_SHAPES.index(self.shape), DYNAMICS_DIMENSIONS.index(self.dimension)

    def speed_change_duration(
        self, start: FloatArray, end: FloatArray, unlimited_end: FloatArray, max_slope: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the duration in s of a change of speed, and the factor that stretches this duration, shape (N,) each.

        The factor limits the slope to `max_slope` in m/s². Speeds are in m/s; `unlimited_end` is the final speed before
        it is limited to the vehicle's maximum speed. With the dimension rate, the returned duration is 0, since kernels
        compute the duration in each step: the final speed may follow the speed of another entity.
        """
        change, peak = np.abs(end - start), _PEAK_SLOPE[self.shape]
        if self.shape == "step":
            return np.zeros_like(start), np.ones_like(start)
        if self.dimension == "rate":
            span, slope = np.zeros_like(start), np.abs(self.value)
        else:
            span = self.value if self.dimension == "time" else self._time_for_distance(start, unlimited_end)
            with np.errstate(divide="ignore"):
                slope = np.where(span < _EPSILON, 0.0, peak * change / np.maximum(span, _EPSILON))
        with np.errstate(divide="ignore"):
            return span, np.maximum(slope / np.maximum(max_slope, _EPSILON), 1.0)

    def is_immediate(self, span: FloatArray) -> BoolArray:
        """Return in which scenarios a change with a duration of `span` s is immediate, shape (N,)."""
        return np.asarray((span < _EPSILON) & (self.shape == "step" or self.dimension != "rate"))

    def lateral_extent(self, start: FloatArray, end: FloatArray) -> FloatArray:
        """Return the duration of a lateral change in s, or its length in m if the dimension is distance, shape (N,)."""
        if self.shape == "step":
            return np.zeros_like(start)
        if self.dimension != "rate":
            return self.value
        with np.errstate(divide="ignore", invalid="ignore"):
            change = np.abs(end - start)
            return np.where(change > 0, _PEAK_SLOPE[self.shape] * change / np.abs(self.value), 0.0)

    def _time_for_distance(self, start: FloatArray, end: FloatArray) -> FloatArray:
        # A change of sign is a change to 0 and one from 0; their distances have the ratio of the squared speeds.
        with np.errstate(divide="ignore", invalid="ignore"):
            fraction = start**2 / (start**2 + end**2)
            through_zero = 2.0 * fraction * self.value / np.abs(start) + 2.0 * (1.0 - fraction) * self.value / np.abs(
                end
            )
            direct = 2.0 * self.value / np.abs(start + end)
        changes_sign = (np.sign(start) * np.sign(end)) < 0
        changes_sign &= (np.abs(start) > _EPSILON) & (np.abs(end) > _EPSILON)
        return np.where(np.abs(start - end) < _EPSILON, 0.0, np.where(changes_sign, through_zero, direct))


def check_dynamics_shape(shape: str, element: etree._Element, scope: Scope) -> None:
    """Raise `InputError` if `shape` is not a known ``dynamicsShape``."""
    if shape not in _PEAK_SLOPE:
        raise scope.error_at(
            element, f"dynamicsShape '{shape}' of <{element.tag}> is not one of {', '.join(_PEAK_SLOPE)}."
        )


def duration_at_peak_acceleration(shape: str, change: FloatArray, max_acceleration: FloatArray) -> FloatArray:
    """Return the duration in s of a lateral change of `change` m whose peak acceleration is `max_acceleration` in m/s².

    A linear change gets the duration of a cubic change, since its lateral acceleration has no finite peak.
    """
    with np.errstate(divide="ignore"):
        if shape == "step":
            return np.zeros_like(change)
        if shape == "sinusoidal":
            return np.asarray(np.pi * np.sqrt(np.abs(change) / (2.0 * max_acceleration)))
        return np.asarray(np.sqrt(6.0 * np.abs(change) / max_acceleration))
