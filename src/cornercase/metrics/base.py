"""What a criticality metric is."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from cornercase.geometry import box_corners
from cornercase.recording import Recording
from cornercase.registry import Registry
from cornercase.typing import FloatArray


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


METRICS: Registry[Metric] = Registry("metric", "cornercase.metrics")


def capped(metric: Metric, course: FloatArray) -> FloatArray:
    """Course with the cap where it is not defined or less critical than the cap, so finite everywhere.

    Parameters
    ----------
    metric : Metric
    course : ndarray of float64, shape (T,)

    Returns
    -------
    ndarray of float64, shape (T,)
    """
    filled = np.where(np.isnan(course), metric.cap, course)
    return np.minimum(filled, metric.cap) if metric.lower_is_critical else np.maximum(filled, metric.cap)


def worst(metric: Metric, course: FloatArray) -> float:
    """Return the most critical value of the capped course."""
    values = capped(metric, course)
    return float(values.min() if metric.lower_is_critical else values.max())


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
