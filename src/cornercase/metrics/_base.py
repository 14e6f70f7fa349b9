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

    A subclass sets the attributes and defines `course`, the value at each instant. An object of it is used itself
    wherever metrics are given in Python: ``Problem(…, metrics=[SpeedDifference()])``. A study stores its class name,
    unit, direction and cap: it can be read without the class, and continued with the same object.

    Attributes
    ----------
    name : str
        As on the command line: ``"wttc"``. It must not be the name of another metric; options of the constructor are
        added after a colon.
    unit : str
        Of the course and the score; ``"1"`` for none.
    lower_is_critical : bool
        False if a large value is critical.
    cap : float
        Least critical value. Values beyond it are clipped, and undefined ones are replaced by it.
    bound : float or None, default None
        Most critical value, for metrics that can be infinitely critical. Values beyond it are clipped. None if the
        metric is bounded by itself.
    default_threshold : float or None, default None
        Score from which a scenario counts as critical unless the user gives another one. None if the literature has
        none.
    contact_score : float or None, default None
        A recording in which both touch scores this or something more critical. For metrics whose course does not see
        contacts, so that no collision counts as less critical than a near miss.
    severity : bool, default False
        Whether collisions score beyond `contact_score` by how hard they are; see `score_with_contact`.
    required_option : str, default ""
        Placeholder of what the user has to write behind the colon, for a metric that means nothing without it, such as
        ``"FORMULA"``. Such metrics are left out if all metrics are measured.
    ego_only : bool, default False
        Whether it depends on the ego and the roads alone, so that it is the same against each other entity.
    source : str
        Where the definition is published.

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
            In the metric's unit; NaN where it is not defined.

        Raises
        ------
        InputError
            There is no entity of that name.
        """

    def check_installed(self) -> None:
        """Raise if a package that the metric requires is not installed.

        This is called before any scenario is run. The constructor does not check it, so studies of the metric can be
        read without the package.

        Raises
        ------
        InputError
            The package is missing; the message says how to install it. By default nothing is required.
        """

    def clip_course(self, course: FloatArray) -> FloatArray:
        """Clip a course between `cap` and `bound`, so that it is finite everywhere.

        Parameters
        ----------
        course : ndarray of float64, shape (T,)

        Returns
        -------
        ndarray of float64, shape (T,)
            `cap` where the metric is not defined.
        """
        filled = np.where(np.isnan(course), self.cap, course)
        low, high = (self.bound, self.cap) if self.lower_is_critical else (self.cap, self.bound)
        return np.asarray(np.clip(filled, low, high))

    def score(self, course: FloatArray) -> float:
        """Most critical value of the clipped course.

        Parameters
        ----------
        course : ndarray of float64, shape (T,)

        Returns
        -------
        float
            In the metric's unit; finite.
        """
        values = self.clip_course(course)
        return float(values.min() if self.lower_is_critical else values.max())

    def score_with_contact(self, score: float, velocity_change: float) -> float:
        """Adapt the score of a recording in which both entities touch: at least as critical as `contact_score`.

        With `severity`, harder collisions score beyond `contact_score`, by a tenth of the velocity change in m/s. A
        touch without speed scores `contact_score`, and a velocity change of 10 m/s is more critical by 1. Thresholds
        keep their meaning, since only collisions score beyond `contact_score`.

        Parameters
        ----------
        score : float
            Score of the course.
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

        Applied twice, it gives the original scores.

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
            As given by the user; by default the metric's own.

        Returns
        -------
        float

        Raises
        ------
        InputError
            The metric has no default threshold, or the given one is not finite.
        """
        value = self.default_threshold if threshold is None else threshold
        if value is None:
            raise InputError(f"The metric '{self.name}' has no default threshold; give one with `critical`.")
        if not np.isfinite(value):
            raise InputError(f"`critical` {value}: give a finite number.")
        return float(value)
