"""Signals that expressions can compare: metrics, the motion of the ego and of another entity, time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray
from cornercase.metrics._measure import compute_course_and_score, evaluate_metrics
from cornercase.metrics._outcome import Fault
from cornercase.metrics._registry import METRICS
from cornercase.metrics._severity import find_first_contact
from cornercase.recordings import Collision, Recording

_MOTION_UNITS: Final = MappingProxyType({"x": "m", "y": "m", "heading": "rad", "speed": "m/s", "acceleration": "m/s²"})
LATERAL_ACCELERATION: Final = "ego.lateral_acceleration"
"""Name of the signal of the ego's acceleration across its heading, positive to the left."""

_LATERAL_ACCELERATIONS: Final = (LATERAL_ACCELERATION, "other.lateral_acceleration")
_NON_METRIC_UNITS: Final = MappingProxyType(
    {f"{who}.{what}": unit for who in ("ego", "other") for what, unit in _MOTION_UNITS.items()}
    | dict.fromkeys(_LATERAL_ACCELERATIONS, "m/s²")
    | {"time": "s"}
)
"""Unit by name, of signals that are not metrics."""

FORMULA_METRIC: Final = "stl"
"""Name of the metric that measures a formula; it cannot be used in an expression."""

CONDITION_METRIC: Final = "critical-if"
"""Name of the metric that measures a condition; it cannot be used in an expression."""

SCORE_PREFIX: Final = "score("
"""Beginning of the name of a signal that is the score of a metric, such as ``score(ttc)``."""


@dataclass(frozen=True, eq=False)
class Signals:
    """Signals of a recording, and what statements such as ``no collision`` need to know about the recording.

    Attributes
    ----------
    time : ndarray of float64, shape (T,)
        Times of the T instants in s, increasing.
    values : mapping of str to ndarray of float64, shape (T,)
        Values at the instants by name of the signal: a metric with its options, such as ``"ttc"``, its score, such as
        ``"score(ttc)"``, the motion of an entity, such as ``"ego.speed"``, or ``"time"``. NaN if a signal is not
        defined at an instant.
    recording : Recording or None, default None
        Only statements on collisions, positions and driven distances need it.
    ego : str, default ""
        Name of the ego in the recording.
    others : tuple of str, default ()
        Entities that the ego is measured against.
    references : mapping of str to (bool or None), default {}
        For the name of each reference driver, whether the ego collides if this driver drives it. None if the driver is
        not made for such a scenario. Drivers that were not run are missing.
    faults : dict of Collision to Fault, default {}
        Results on whose fault collisions of the ego are, as far as they are already known.

    Examples
    --------
    >>> import numpy as np
    >>> from cornercase.metrics import Expression, Signals
    >>> time = np.array([0.0, 0.1, 0.2])
    >>> signals = Signals(time, {"ttc": np.array([9.0, 2.0, 1.0])})
    >>> float(Expression.parse("always(ttc > 1.5)").robustness(signals)[0])
    -0.5
    """

    time: FloatArray
    values: Mapping[str, FloatArray]
    recording: Recording | None = None
    ego: str = ""
    others: tuple[str, ...] = ()
    references: Mapping[str, bool | None] = field(default_factory=dict)
    faults: dict[Collision, Fault] = field(default_factory=dict)


def signals_from_recording(
    recording: Recording,
    ego: str,
    other: str,
    courses: Mapping[str, FloatArray] | None = None,
    others: Sequence[str] = (),
) -> Signals:
    """Create the signals of a recording; metrics are computed on first access.

    The signal of a metric is its course. At the first instant of a contact, the value is replaced by the metric's score
    for contacts if this score is more critical. So a collision can violate a bound on a metric even if the course of
    the metric itself does not show the collision.

    Parameters
    ----------
    recording : Recording
    ego, other : str
        Names of two entities.
    courses : mapping of str to ndarray of float64, shape (T,), optional
        Courses of metrics that are already computed, by name.
    others : sequence of str, optional
        All entities that scores refer to; by default `other` alone.

    Returns
    -------
    Signals

    Raises
    ------
    InputError
        There is no entity of that name.

    Examples
    --------
    >>> import cornercase as cc
    >>> from cornercase.metrics import signals_from_recording
    >>> recording = cc.simulate("examples/x_intersection/x_intersection.xosc")
    >>> signals = signals_from_recording(recording, "Ego", "Pedestrian")
    >>> float(signals.values["ego.speed"][0]), round(float(signals.values["clearance"].min()), 2)
    (10.0, 6.02)
    """
    names = tuple(others) or (other,)
    values = _LazySignals(recording, ego, other, names)
    for name, course in (courses or {}).items():
        values.add_course(name, course)
    return Signals(recording.time, values, recording, ego, names)


def metric_of_signal(name: str) -> str:
    """Return the name, with options, of the metric that a signal belongs to; empty for other signals."""
    return "" if name in _NON_METRIC_UNITS else name.removeprefix(SCORE_PREFIX).removesuffix(")")


def signal_unit(name: str) -> str:
    """Return the unit of a signal. InputError if its metric cannot be used or does not have the given options."""
    if name in _NON_METRIC_UNITS:
        return _NON_METRIC_UNITS[name]
    base = name.partition(":")[0]
    if base == FORMULA_METRIC:
        raise InputError(f"'{FORMULA_METRIC}' is the metric of a formula; write the formula itself, in brackets.")
    if base == CONDITION_METRIC:
        raise InputError(f"'{CONDITION_METRIC}' is the metric of a condition; it cannot be used in an expression.")
    return METRICS.create(name).unit


def has_signal(name: str) -> bool:
    """Return whether `name` is the name of a signal that is no score, or of a metric with any options."""
    return name in _NON_METRIC_UNITS or name.partition(":")[0] in METRICS


def signal_names() -> list[str]:
    """Return the names of all signals except scores."""
    return [*_NON_METRIC_UNITS, *(name for name in METRICS.names() if name not in (FORMULA_METRIC, CONDITION_METRIC))]


class _LazySignals(dict[str, FloatArray]):
    """Signals of a recording, each computed on first access."""

    def __init__(self, recording: Recording, ego: str, other: str, others: Sequence[str]) -> None:
        super().__init__(time=recording.time)
        self._recording, self._ego, self._other, self._others = recording, ego, other, others
        for who, name in (("ego", ego), ("other", other)):
            row = recording.entity_index(name)
            self.update({f"{who}.{what}": getattr(recording, what)[row] for what in _MOTION_UNITS})

    def __missing__(self, name: str) -> FloatArray:
        if name in _LATERAL_ACCELERATIONS:
            self[name] = _lateral_acceleration(self._recording, self._ego if name.startswith("ego") else self._other)
            return self[name]
        metric = METRICS.create(metric_of_signal(name))
        if name.startswith(SCORE_PREFIX):
            score = evaluate_metrics([metric], self._recording, self._ego, self._others)[metric.name].score
            self[name] = np.full(self._recording.time.shape, float(score))
        else:
            self.add_course(name, compute_course_and_score(metric, self._recording, self._ego, self._other)[0])
        return self[name]

    def add_course(self, name: str, course: FloatArray) -> None:
        """Add the course of a metric.

        At the first contact, the score for contacts replaces the value if the score is more critical.
        """
        metric = METRICS.create(name)
        self[name] = course
        if metric.contact_score is not None and self._contact is not None:
            instant, change = self._contact
            score = metric.score_with_contact(float(metric.clip_course(course[instant : instant + 1])[0]), change)
            self[name] = np.array(course, dtype=np.float64)
            self[name][instant] = score

    @cached_property
    def _contact(self) -> tuple[int, float] | None:
        return find_first_contact(self._recording, self._ego, self._other)


def _lateral_acceleration(recording: Recording, name: str) -> FloatArray:
    """Return the acceleration of an entity's reference point across its heading in m/s², shape (T,).

    It is the speed times the turn rate, positive to the left.
    """
    i, time = recording.entity_index(name), recording.time
    if len(time) < 2:
        return np.full(len(time), np.nan)
    heading, present = recording.heading[i], np.isfinite(recording.heading[i])
    unwrapped = np.full(len(time), np.nan)
    unwrapped[present] = np.unwrap(heading[present])
    return np.asarray(recording.speed[i] * np.gradient(unwrapped, time))
