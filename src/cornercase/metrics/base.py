"""What a criticality metric is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TypeVar

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray
from cornercase.recordings import Recording

Score = TypeVar("Score", float, FloatArray)

# What a change of velocity of 1 m/s counts among collisions, in the metric's unit.
_SCALE = 0.1


class Metric(ABC):
    """How critical a recording is, for the ego and one other entity.

    A subclass names itself, says its unit, its cap and which values are critical, and defines `course`.

    Attributes
    ----------
    name : str
        As on the command line: ``"wttc"``.
    unit : str
        Of the course and the score; ``"1"`` for none.
    lower_is_critical : bool
        False where a large value is critical.
    cap : float
        The least critical value that a course keeps apart from others. Where the metric is not defined, or is less
        critical than the cap, the course counts as the cap when scenarios are compared.
    most_critical : float or None, default None
        The most critical value that a course keeps apart from others, for metrics that can be infinitely critical;
        what is more critical counts as this value. None where the metric is bounded by itself.
    critical : float or None, default None
        Threshold: score from which a scenario counts as critical unless the user gives another. None where the
        literature knows none.
    contact : float or None, default None
        Score that a recording has at least, towards critical, in which both touch: for metrics whose course says
        nothing of a contact, so that no collision counts as less critical than a near miss.
    severity : bool, default False
        Whether the score of a recording in which both touch goes on below `contact` with how hard they collide; see
        `score_of_contact`.
    wants : str, default ""
        What has to stand behind the colon of its name, in a word, for a metric that means nothing by its name alone; it
        is left out where all metrics are measured.
    source : str
        Where the definition stands.

    See Also
    --------
    cornercase.metrics.METRICS : Metrics by name, also those of other packages.

    Examples
    --------
    >>> import numpy as np
    >>> from cornercase.metrics import Metric
    >>> class SpeedDifference(Metric):
    ...
    ...     name, unit, source = "speed-difference", "m/s", "an example"
    ...     lower_is_critical, cap = False, 0.0
    ...
    ...     def course(self, recording, ego, other):
    ...         return np.abs(recording.speed[recording.index(ego)] - recording.speed[recording.index(other)])
    >>> SpeedDifference().score(np.array([2.0, np.nan, 7.0]))
    7.0
    """

    name: str
    unit: str
    lower_is_critical: bool
    cap: float
    most_critical: float | None = None
    critical: float | None = None
    contact: float | None = None
    severity: bool = False
    wants: str = ""
    source: str = ""

    @abstractmethod
    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        """Measure each instant.

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

    def require(self) -> None:  # noqa: B027 - optional
        """Refuse to measure where a package that is needed is not installed; asked before anything is run.

        Studies of the metric can be read without it, so it is not asked for when the metric is made.

        Raises
        ------
        InputError
            It is missing; the message says how to install it. By default nothing is needed.
        """

    def capped(self, course: FloatArray) -> FloatArray:
        """Bring a course between the cap and the most critical value, so that it is finite everywhere.

        Parameters
        ----------
        course : ndarray of float64, shape (T,)

        Returns
        -------
        ndarray of float64, shape (T,)
            The cap where the metric is not defined.
        """
        filled = np.where(np.isnan(course), self.cap, course)
        low, high = (self.most_critical, self.cap) if self.lower_is_critical else (self.cap, self.most_critical)
        return np.asarray(np.clip(filled, low, high))

    def score(self, course: FloatArray) -> float:
        """Most critical value of the capped course.

        Parameters
        ----------
        course : ndarray of float64, shape (T,)

        Returns
        -------
        float
            In the metric's unit; finite.
        """
        values = self.capped(course)
        return float(values.min() if self.lower_is_critical else values.max())

    def score_of_contact(self, score: float, change: float) -> float:
        """Score of a recording in which both touch.

        At least as critical as `contact`. With `severity` a tenth of the change of velocity in m/s, of the one whose
        velocity changes more, goes beyond that, so that a search has something to follow among collisions: a touch
        without speed keeps the score of a contact, and one that takes 10 m/s is more critical by 1. Thresholds that
        no contact reaches by itself keep their meaning, as all that is beyond them is a collision.

        Parameters
        ----------
        score : float
            Of the course.
        change : float
            m/s.

        Returns
        -------
        float
        """
        if self.contact is None:
            return score
        worse = min if self.lower_is_critical else max
        sign = -1.0 if self.lower_is_critical else 1.0
        at_least = worse(score, self.contact)
        return at_least + sign * _SCALE * change if self.severity else at_least

    def oriented(self, scores: Score) -> Score:
        """Turn scores so that lower ones are more critical, whatever the metric.

        Parameters
        ----------
        scores : float or ndarray of float64 of any shape

        Returns
        -------
        float or ndarray of float64 of the same shape
            The same where lower is critical, else the negative. Oriented twice they are what they were.
        """
        return scores if self.lower_is_critical else -scores

    def find_threshold(self, given: float | None = None) -> float:
        """Score from which a scenario counts as critical.

        Parameters
        ----------
        given : float, optional
            What the user asks for; by default the metric's own threshold.

        Returns
        -------
        float

        Raises
        ------
        InputError
            The metric has none of its own, or the one that is given is not finite.
        """
        value = self.critical if given is None else given
        if value is None:
            raise InputError(f"The metric '{self.name}' has no default threshold; give one with `critical`.")
        if not np.isfinite(value):
            raise InputError(f"`critical` {value}: give a finite number.")
        return float(value)
