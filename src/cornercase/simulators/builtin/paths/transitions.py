"""Transitions of values over time: shapes and dimensions of ``TransitionDynamics``."""

from __future__ import annotations

from typing import Final

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.scenario import Scope

# Largest slope of a transition from 0 to 1 over unit time.
_PEAK: Final = {"linear": 1.0, "cubic": 1.5, "sinusoidal": 0.5 * np.pi, "step": 1.0}

# s and m/s; smaller differences are ignored.
_TINY: Final = 1e-6


class Transition:
    """A change from one value to another, as an element's shape, dimension and value describe it."""

    def __init__(self, element: etree._Element, scope: Scope) -> None:
        self.shape = scope.text(element, "dynamicsShape")
        self.dimension = scope.text(element, "dynamicsDimension", "time")
        self.value = scope.number(element, "value", 0.0)
        require_shape(self.shape, element, scope)
        if self.dimension not in ("time", "rate", "distance"):
            raise InputError(
                f"{scope.source}, line {element.sourceline}: dynamicsDimension '{self.dimension}' of"
                f" <{element.tag}> is not time, rate or distance."
            )
        # The sign of a rate is ignored, as files give braking with a minus.
        if self.dimension != "rate":
            scope.refuse(element, "value", "is below 0", self.value < 0.0)

    def time_span(
        self, start: FloatArray, end: FloatArray, asked: FloatArray, steepest: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Duration of a change of speed, and the factor by which it is stretched, each (N,).

        `unlimited_end` is `end` without the vehicle's maximum speed; `max_slope` the largest slope in m/s², which the
        stretched change does not exceed. All speeds in m/s.
        """
        change, peak = np.abs(end - start), _PEAK[self.shape]
        if self.shape == "step":
            return np.zeros_like(start), np.ones_like(start)
        if self.dimension == "rate":
            span, slope = self.time_by_rate(end - start), np.abs(self.value)
        else:
            span = self.value if self.dimension == "time" else self._time_for_distance(start, asked)
            with np.errstate(divide="ignore"):
                slope = np.where(span < _TINY, 0.0, peak * change / np.maximum(span, _TINY))
        with np.errstate(divide="ignore"):
            return span, np.maximum(slope / np.maximum(steepest, _TINY), 1.0)

    def time_by_rate(self, change: FloatArray) -> FloatArray:
        """Duration of a change whose largest slope is the rate, shape (N,)."""
        if self.shape == "step":
            return np.zeros_like(change)
        span = _PEAK[self.shape] * np.abs(change) / np.maximum(np.abs(self.value), _TINY)
        return np.asarray(np.maximum(span, _TINY))

    def is_step(self, span: FloatArray) -> BoolArray:
        """Whether the change is immediate, shape (N,)."""
        return np.asarray((span < _TINY) & (self.shape == "step" or self.dimension != "rate"))

    def between(self, start: FloatArray, end: FloatArray, parameter: FloatArray, span: FloatArray) -> FloatArray:
        """Value after a part of the span, shape (N,)."""
        step = self.is_step(span)
        fraction = self.at(parameter / np.where(step, 1.0, np.maximum(span, _TINY)))
        return np.where(step, end, start + fraction * (end - start))

    def extent(self, start: FloatArray, end: FloatArray) -> FloatArray:
        """Duration or distance of a lateral change, shape (N,)."""
        if self.shape == "step":
            return np.zeros_like(start)
        if self.dimension != "rate":
            return self.value
        with np.errstate(divide="ignore", invalid="ignore"):
            change = np.abs(end - start)
            return np.where(change > 0, _PEAK[self.shape] * change / np.abs(self.value), 0.0)

    def at(self, part: FloatArray) -> FloatArray:
        """Fraction of the change done after a fraction of the time, shape (N,)."""
        return shaped(self.shape, part)

    def slope(self, part: FloatArray) -> FloatArray:
        """Derivative of `fraction_done`, shape (N,)."""
        return steepness(self.shape, part)

    def _time_for_distance(self, start: FloatArray, end: FloatArray) -> FloatArray:
        # A change of sign is a change to 0 and one from 0; their distances have the ratio of the squared speeds.
        with np.errstate(divide="ignore", invalid="ignore"):
            fraction = start**2 / (start**2 + end**2)
            through_zero = 2.0 * fraction * self.value / np.abs(start) + 2.0 * (1.0 - fraction) * self.value / np.abs(
                end
            )
            direct = 2.0 * self.value / np.abs(start + end)
        changes_sign = (np.sign(start) * np.sign(end)) < 0
        changes_sign &= (np.abs(start) > _TINY) & (np.abs(end) > _TINY)
        return np.where(np.abs(start - end) < _TINY, 0.0, np.where(changes_sign, through_zero, direct))


def require_shape(shape: str, element: etree._Element, scope: Scope) -> None:
    """Raise `InputError` if a ``dynamicsShape`` does not exist."""
    if shape not in _PEAK:
        raise InputError(
            f"{scope.source}, line {element.sourceline}: dynamicsShape '{shape}' of <{element.tag}> is not one of"
            f" {', '.join(_PEAK)}."
        )


def shaped(shape: str, part: FloatArray) -> FloatArray:
    """Fraction of a change done after a fraction of the time, clipped to [0, 1], shape (N,)."""
    part = np.clip(part, 0.0, 1.0)
    if shape == "cubic":
        return part * part * (3.0 - 2.0 * part)
    if shape == "sinusoidal":
        return np.asarray(0.5 - 0.5 * np.cos(np.pi * part))
    return part


def steepness(shape: str, part: FloatArray) -> FloatArray:
    """Derivative of `transition_fraction`, shape (N,)."""
    part = np.clip(part, 0.0, 1.0)
    if shape == "cubic":
        return 6.0 * part * (1.0 - part)
    if shape == "sinusoidal":
        return np.asarray(0.5 * np.pi * np.sin(np.pi * part))
    return np.ones_like(part)


def time_by_acceleration(shape: str, change: FloatArray, most: FloatArray) -> FloatArray:
    """Duration in s of a lateral change by `change` m that peaks at `max_acceleration` m/s²; linear as cubic."""
    with np.errstate(divide="ignore"):
        if shape == "step":
            return np.zeros_like(change)
        if shape == "sinusoidal":
            return np.asarray(np.pi * np.sqrt(np.abs(change) / (2.0 * most)))
        return np.asarray(np.sqrt(6.0 * np.abs(change) / most))
