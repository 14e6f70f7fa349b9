"""Metrics time exposed (TET) and time integrated (TIT) time to collision."""

from __future__ import annotations

from abc import abstractmethod
from typing import Literal, get_args

import numpy as np

from cornercase._common.errors import InputError, suggest_name
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.metrics._base import Metric
from cornercase.metrics._geometry.numeric import check_nonnegative_options
from cornercase.metrics._ttc import Ttc
from cornercase.recordings import Recording

Rule = Literal["linear", "samples"]


class _TimeBelowThresholdMetric(Metric):
    """Base class of metrics that integrate over the time in which the time to collision is below a threshold."""

    lower_is_critical = False
    cap = 0.0
    bound = contact_score = 60.0

    def __init__(self, threshold: float = 1.5, rule: Rule = "linear") -> None:
        check_nonnegative_options(self.name, threshold=threshold)
        if rule not in get_args(Rule):
            raise InputError(f"{self.name} has no rule '{rule}'; {suggest_name(rule, get_args(Rule))}")
        self.threshold, self.rule = threshold, rule

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        below = self.threshold - Ttc().course(recording, ego, other)
        below = np.where(np.isnan(below), -np.inf, below)
        steps = np.diff(recording.time)
        if self.rule == "samples":
            return np.cumsum(self._integrand(below) * np.append(steps, steps[-1:] if len(steps) else 0.0))
        low, high = np.minimum(below[:-1], below[1:]), np.maximum(below[:-1], below[1:])
        mean = self._mean_integrand(low, high, (low < 0.0) & (high > 0.0))
        return np.append(0.0, np.cumsum(mean * steps))

    @abstractmethod
    def _integrand(self, margin: FloatArray) -> FloatArray:
        """Return the integrand at each instant, shape (T,).

        `margin` is the threshold minus the time to collision in s; -inf if the time to collision is not defined.
        """

    @abstractmethod
    def _mean_integrand(self, low: FloatArray, high: FloatArray, crosses: BoolArray) -> FloatArray:
        """Return the mean of the integrand between successive instants, shape (T - 1,).

        The margin (threshold minus time to collision, in s) changes linearly between two instants. `low` is the smaller
        and `high` the larger margin of the two; `crosses` says whether 0 lies between them.
        """


class Tet(_TimeBelowThresholdMetric):
    """Time exposed time to collision: for how long the time to collision has been at most τ.

    ``∫ 1[TTC <= τ] dt`` in s, with the time to collision TTC of `Ttc`. The integral runs from the start to each
    instant, so the course never falls, and its last value is the score. It is defined at all instants: nothing is added
    while one of the two does not exist, or while they move apart. The least critical value (cap) is 0 s. The most
    critical one is 60 s, which is also the score of every recording in which both touch.

    Source: M. M. Minderhoud, P. H. L. Bovy, "Extended time-to-collision measures for road traffic safety assessment",
    Accident Analysis and Prevention 33 (2001).

    Parameters
    ----------
    threshold : float, default 1.5
        τ in s.
    rule : {"linear", "samples"}, default "linear"
        Integration between the instants. With ``"linear"``, the time to collision is interpolated linearly. With
        ``"samples"``, each instant counts for the time step that follows, and the last instant for as long as the
        instant before.

    Examples
    --------
    >>> import cornercase as cc
    >>> recording = cc.simulate("examples/r157/cut_out.xosc")
    >>> cc.measure(recording, "Ego", "Other", [cc.metrics.Tet(threshold=3.0)])
    metric             score  unit  critical is
    tet:threshold=3.0  2.208  s     high
    """

    name = "tet"
    unit = "s"
    source = "Minderhoud and Bovy 2001"

    def _integrand(self, margin: FloatArray) -> FloatArray:
        return (margin >= 0.0).astype(np.float64)

    def _mean_integrand(self, low: FloatArray, high: FloatArray, crosses: BoolArray) -> FloatArray:
        # Interpolating towards a time to collision of inf leaves the threshold at once.
        return np.where(crosses, high / _difference_if_crossing(low, high, crosses), (low >= 0.0).astype(np.float64))


class Tit(_TimeBelowThresholdMetric):
    """Time integrated time to collision: for how long, and by how much, the time to collision has been below τ.

    ``∫ (τ - TTC)₊ dt`` in s², with the time to collision TTC of `Ttc`. The integral runs from the start to each
    instant, so the course never falls, and its last value is the score. It is defined at all instants: nothing is added
    while one of the two does not exist, or while they move apart. The least critical value (cap) is 0 s². The most
    critical one is 60 s², which is also the score of every recording in which both touch.

    Source: M. M. Minderhoud, P. H. L. Bovy, "Extended time-to-collision measures for road traffic safety assessment",
    Accident Analysis and Prevention 33 (2001).

    Parameters
    ----------
    threshold : float, default 1.5
        τ in s.
    rule : {"linear", "samples"}, default "linear"
        Integration between the instants, as in `Tet`.

    Examples
    --------
    >>> import cornercase as cc
    >>> recording = cc.simulate("examples/r157/cut_out.xosc")
    >>> cc.measure(recording, "Ego", "Other", [cc.metrics.Tit(threshold=3.0)])
    metric             score  unit  critical is
    tit:threshold=3.0  1.804  s²    high
    """

    name = "tit"
    unit = "s²"
    source = "Minderhoud and Bovy 2001"

    def _integrand(self, margin: FloatArray) -> FloatArray:
        return np.maximum(margin, 0.0)

    def _mean_integrand(self, low: FloatArray, high: FloatArray, crosses: BoolArray) -> FloatArray:
        triangle = 0.5 * np.where(crosses, high, 0.0) ** 2 / _difference_if_crossing(low, high, crosses)
        return np.where(crosses, triangle, np.maximum(0.5 * (np.maximum(low, 0.0) + high), 0.0))


def _difference_if_crossing(low: FloatArray, high: FloatArray, crosses: BoolArray) -> FloatArray:
    """Return ``high - low`` if `crosses`, otherwise 1, so that the result can be a divisor."""
    return np.where(crosses, np.where(crosses, high, 1.0) - np.where(crosses, low, 0.0), 1.0)
