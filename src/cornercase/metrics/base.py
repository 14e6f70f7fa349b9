"""What a criticality metric is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from cornercase._common.errors import InputError
from cornercase._common.geometry import box_corners
from cornercase._common.typing import FloatArray
from cornercase.recordings import Recording

_ALIKE = 1e-9
"""Relative speeds in m/s that are rounding: they take 30 years for a metre."""


class Metric(Protocol):
    """How critical a recording is, for the ego and one other entity.

    Attributes
    ----------
    name : str
        As on the command line: ``"wttc"``.
    unit : str
        Of the course and the score; ``"1"`` for none.
    lower_is_critical : bool
        False where a large value is critical.
    cap : float
        The least critical value that a course keeps apart from others. Where the metric is not defined, or
        beyond the cap, the course counts as the cap when scenarios are compared.
    limit : float, optional
        The most critical value that a course keeps apart from others, for metrics that can be infinitely
        critical; beyond it the course counts as the limit.
    critical : float, optional
        Value from which a scenario counts as critical where nobody says otherwise.
    source : str
        Where the definition stands.
    """

    name: str
    unit: str
    lower_is_critical: bool
    cap: float
    source: str

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        """Value at each instant, shape (T,); NaN where not defined."""
        ...

    def score(self, course: FloatArray) -> float:
        """Value of the scenario, finite: the most critical one of the course, the cap if there is none."""
        ...


class PairMetric(ABC):
    """What most metrics share: their score is the most critical value of the capped course."""

    name: str
    unit: str
    lower_is_critical: bool
    cap: float
    source: str

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        """Value at each instant.

        Parameters
        ----------
        recording : Recording
        ego, other : str
            Names of two entities.

        Returns
        -------
        ndarray of float64, shape (T,)
            In the metric's unit; NaN where it is not defined.

        Raises
        ------
        InputError
            There is no entity of that name.
        """
        return self._course(recording, ego, other)

    def score(self, course: FloatArray) -> float:
        """Most critical value of the course in the metric's unit, between its cap and its limit."""
        return worst(self, course)

    @abstractmethod
    def _course(self, recording: Recording, ego: str, other: str) -> FloatArray: ...


def capped(metric: Metric, course: FloatArray) -> FloatArray:
    """Course between cap and limit, and the cap where it is not defined, so finite everywhere.

    Parameters
    ----------
    metric : Metric
    course : ndarray of float64, shape (T,)

    Returns
    -------
    ndarray of float64, shape (T,)
    """
    limit = getattr(metric, "limit", -np.inf if metric.lower_is_critical else np.inf)
    filled = np.where(np.isnan(course), metric.cap, course)
    return np.clip(filled, min(metric.cap, limit), max(metric.cap, limit))


def worst(metric: Metric, course: FloatArray) -> float:
    """Return the most critical value of the capped course."""
    values = capped(metric, course)
    return float(values.min() if metric.lower_is_critical else values.max())


def threshold(metric: Metric, given: float | None = None) -> float:
    """Score from which a scenario counts as critical.

    Parameters
    ----------
    metric : Metric
    given : float, optional
        What the user asks for; by default the metric's own.

    Raises
    ------
    InputError
        The metric has none, or the one that is given is not finite.
    """
    value = getattr(metric, "critical", None) if given is None else given
    if value is None:
        raise InputError(
            f"The metric '{metric.name}' has no threshold of its own; say with --critical what is critical."
        )
    if not np.isfinite(value):
        raise InputError(f"--critical {value}: give a finite number.")
    return float(value)


def measured(
    metrics: Iterable[Metric], recording: Recording, ego: str, other: str
) -> dict[str, tuple[FloatArray, float]]:
    """Course, shape (T,), and score of each metric, by its name."""
    courses = {}
    for metric in metrics:
        course = metric.course(recording, ego, other)
        courses[metric.name] = (course, metric.score(course))
    return courses


def boxes(recording: Recording, name: str) -> FloatArray:
    """Corners of an entity's bounding box in m, shape (T, 4, 2), NaN where it does not exist."""
    i = recording.index(name)
    center = recording.center(name)
    return box_corners(center[:, 0], center[:, 1], recording.heading[i], recording.length[i], recording.width[i])


def velocity(recording: Recording, name: str) -> FloatArray:
    """Speed along the heading as a vector in m/s, shape (T, 2), NaN where the entity does not exist."""
    i = recording.index(name)
    heading = recording.heading[i]
    forward: FloatArray = recording.speed[i][:, None] * np.stack([np.cos(heading), np.sin(heading)], -1)
    return forward


def relative_velocity(recording: Recording, ego: str, other: str) -> FloatArray:
    """Velocity of the other seen from the ego in m/s, shape (T, 2), exactly 0 where only rounding sets them apart."""
    return without_rounding(velocity(recording, other) - velocity(recording, ego))


def without_rounding(relative: FloatArray) -> FloatArray:
    """Return relative velocities (T, 2) with those set to 0 that are rounding."""
    size = np.hypot(relative[:, 0], relative[:, 1])
    return np.where((size <= _ALIKE)[:, None], 0.0, relative)


def checked(name: str, **numbers: float) -> None:
    """Refuse options of a metric that are not finite or negative.

    Raises
    ------
    InputError
    """
    for option, number in numbers.items():
        if not 0.0 <= number < np.inf:
            raise InputError(f"{name} cannot take {number} for {option}; give a finite number of 0 or more.")


def over(numerator: npt.NDArray[Any], divisor: npt.NDArray[Any] | float) -> FloatArray:
    """Quotient; 0 where the numerator is 0, inf where it is not and the divisor is not positive."""
    divisor = np.broadcast_to(divisor, numerator.shape)
    positive = divisor > 0.0
    quotient = np.where(positive, numerator / np.where(positive, divisor, 1.0), np.inf)
    return np.where(np.isnan(numerator + divisor), np.nan, np.where(numerator == 0.0, 0.0, quotient))
