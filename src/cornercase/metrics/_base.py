"""Base class of criticality metrics."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TypeVar

import numpy as np

from cornercase._common.configurable import Configurable
from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray
from cornercase.recordings import Recording

Score = TypeVar("Score", float, FloatArray)

# Weight of a change of velocity of 1 m/s in collision scores, in the metric's unit.
_SEVERITY_WEIGHT = 0.1


class Metric(Configurable, ABC):
    """A criticality metric: how critical a recording is for the ego and one other entity.

    A subclass sets the attributes and defines `course`, the value at each instant. An object of the subclass is given
    like any other metric: ``Problem(…, metrics=[SpeedDifference()])``. A study stores the class name, unit, direction
    and cap of the metric. So the study can be read without the class. To continue the study, give the object again.

    Attributes
    ----------
    name : str
        Name as on the command line, such as ``"wttc"``; no other metric may have this name. Options of the constructor
        are added after a colon.
    unit : str
        Unit of the course and the score; ``"1"`` for a metric without unit.
    lower_is_critical : bool
        True if low values are critical, False if high values are critical.
    cap : float
        Least critical value. Less critical values are clipped to the cap, and undefined values are replaced by the cap.
    bound : float or None, default None
        Most critical value, for metrics that can be infinitely critical. More critical values are clipped to the bound.
        None for metrics that are bounded by their definition.
    default_threshold : float or None, default None
        Score from which a scenario counts as critical, unless the user gives another threshold. None if the literature
        has no threshold.
    contact_score : float or None, default None
        Least critical score of a recording in which both entities touch, for metrics whose course does not show
        contacts. With this attribute, no collision counts as less critical than a near miss.
    severity : bool, default False
        True if harder collisions get scores beyond `contact_score`; see `score_with_contact`.
    required_option : str, default ""
        Placeholder, such as ``"FORMULA"``, for an option that the user has to write after the colon, since the metric
        means nothing without this option. Such metrics are left out if all metrics are measured.
    ego_only : bool, default False
        True if the metric depends on the ego and the roads alone, so that other entities do not matter.
    source : str
        Publication that defines the metric.

    See Also
    --------
    cornercase.metrics.METRICS : Metrics by name, including those of other packages.

    Examples
    --------
    >>> import cornercase as cc
    >>> import numpy as np
    >>> class SpeedDifference(cc.Metric):
    ...
    ...     name, unit, source = "speed-difference", "m/s", "an example"
    ...     lower_is_critical, cap = False, 0.0
    ...
    ...     def course(self, recording, ego, other):
    ...         i, j = recording.entity_index(ego), recording.entity_index(other)
    ...         return np.abs(recording.speed[i] - recording.speed[j])
    >>> SpeedDifference().score(np.array([2.0, np.nan, 7.0]))
    7.0
    >>> recording = cc.simulate("examples/x_intersection/x_intersection.xosc", duration=2.0)
    >>> cc.measure(recording, "Ego", "Pedestrian", [SpeedDifference(), "distance"])
    metric            score  unit  critical is
    speed-difference  10     m/s   high
    distance          48.03  m     low
    """

    unit: str
    lower_is_critical: bool
    cap: float
    bound: float | None = None
    default_threshold: float | None = None
    contact_score: float | None = None
    severity: bool = False
    required_option: str = ""
    ego_only: bool = False
    source: str = ""

    @abstractmethod
    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        """Compute the metric at each instant.

        Parameters
        ----------
        recording : Recording
        ego, other : str
            Names of two entities.

        Returns
        -------
        ndarray of float64, shape (T,)
            Values in the metric's unit; NaN at instants at which the metric is not defined.

        Raises
        ------
        InputError
            There is no entity of that name.
        """

    def check_installed(self) -> None:
        """Raise if a package that the metric requires is not installed.

        This is called before any scenario is run. The constructor does not check for the package, so that studies of
        the metric can be read without it.

        Raises
        ------
        InputError
            The package is missing; the message says how to install it. By default nothing is required.
        """

    def clip_course(self, course: FloatArray) -> FloatArray:
        """Clip a course to the range between `cap` and `bound`, and replace undefined values by `cap`.

        Parameters
        ----------
        course : ndarray of float64, shape (T,)

        Returns
        -------
        ndarray of float64, shape (T,)
            Clipped values; `cap` at instants at which the metric is not defined.
        """
        filled = np.where(np.isnan(course), self.cap, course)
        low, high = (self.bound, self.cap) if self.lower_is_critical else (self.cap, self.bound)
        return np.asarray(np.clip(filled, low, high))

    def score(self, course: FloatArray) -> float:
        """Return the most critical value of the clipped course.

        Parameters
        ----------
        course : ndarray of float64, shape (T,)

        Returns
        -------
        float
            In the metric's unit; infinite if the course is infinitely critical and `bound` is None.
        """
        values = self.clip_course(course)
        return float(values.min() if self.lower_is_critical else values.max())

    def score_with_contact(self, score: float, velocity_change: float) -> float:
        """Return the score of a recording in which both entities touch: at least as critical as `contact_score`.

        With `severity`, the score becomes more critical by a tenth of the velocity change in m/s: a touch without speed
        scores `contact_score`, and a velocity change of 10 m/s is more critical by 1. Thresholds keep their meaning,
        since only collisions score beyond `contact_score`.

        Parameters
        ----------
        score : float
            Score of the course, without regard to the contact.
        velocity_change : float
            Velocity change in m/s of the entity whose velocity changes more.

        Returns
        -------
        float
        """
        if self.contact_score is None:
            return score
        more_critical = min if self.lower_is_critical else max
        sign = -1.0 if self.lower_is_critical else 1.0
        base = more_critical(score, self.contact_score)
        return base + sign * _SEVERITY_WEIGHT * velocity_change if self.severity else base

    def to_minimize(self, scores: Score) -> Score:
        """Orient scores so that lower is more critical: negate them if the metric is critical when high.

        A second call gives the original scores again.

        Parameters
        ----------
        scores : float or ndarray of float64 of any shape

        Returns
        -------
        float or ndarray of float64 of the same shape
        """
        return scores if self.lower_is_critical else -scores

    def resolve_threshold(self, threshold: float | None = None) -> float:
        """Return the score from which a scenario counts as critical.

        Parameters
        ----------
        threshold : float, optional
            Threshold given by the user; by default `default_threshold`.

        Returns
        -------
        float

        Raises
        ------
        InputError
            The metric has no default threshold, or `threshold` is not finite.
        """
        value = self.default_threshold if threshold is None else threshold
        if value is None:
            raise InputError(f"The metric '{self.name}' has no default threshold; give one with `critical`.")
        if not np.isfinite(value):
            raise InputError(f"`critical` {value}: give a finite number.")
        return float(value)
