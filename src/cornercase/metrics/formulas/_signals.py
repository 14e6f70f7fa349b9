"""Signals that formulas can use: metrics, the motion of the ego and of another entity, time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np

from cornercase._common.errors import InputError, PluginError, suggest_name
from cornercase._common.plugin_errors import make_scenario_failure
from cornercase._common.process.signals import count_requests
from cornercase._common.typing import FloatArray
from cornercase.metrics._base import Metric
from cornercase.metrics._registry import METRICS
from cornercase.metrics._severity import find_first_contact
from cornercase.recordings import Recording

_MOTION_UNITS: Final = MappingProxyType({"x": "m", "y": "m", "heading": "rad", "speed": "m/s", "acceleration": "m/s²"})
_NON_METRIC_UNITS: Final = MappingProxyType(
    {f"{who}.{what}": unit for who in ("ego", "other") for what, unit in _MOTION_UNITS.items()} | {"time": "s"}
)
"""Unit by name, of signals that are not metrics."""

FORMULA_METRIC: Final = "stl"
"""Name of the metric of a formula, which cannot be used in another formula."""

CONDITION_METRIC: Final = "critical-if"
"""Name of the metric of a condition, which cannot be used in a formula either."""


@dataclass(frozen=True, eq=False)
class Signals:
    """Signals of a recording.

    Attributes
    ----------
    time : ndarray of float64, shape (T,)
        s, increasing.
    values : mapping of str to ndarray of float64, shape (T,)
        By name: that of a metric with its options, ``"ego.speed"`` and the like, ``"time"``. NaN where a signal is not
        defined.
    """

    time: FloatArray
    values: Mapping[str, FloatArray]


def signals_from_recording(
    recording: Recording, ego: str, other: str, courses: Mapping[str, FloatArray] | None = None
) -> Signals:
    """Create the signals of a recording; metrics are computed on first access.

    The signal of a metric is its course. At the first instant of a contact it is at least as critical as the metric's
    score for contacts, so that a collision violates a bound on a metric that does not see collisions.

    Parameters
    ----------
    recording : Recording
    ego, other : str
        Names of two entities.
    courses : mapping of str to ndarray of float64, shape (T,), optional
        Courses of metrics that are already computed, by name.

    Returns
    -------
    Signals

    Raises
    ------
    InputError
        There is no entity of that name.
    """
    return Signals(recording.time, _LazySignals(recording, ego, other, dict(courses or {})))


def signal_unit(name: str) -> str:
    """Unit of a signal. InputError, with a suggestion, if there is no such signal."""
    if name in _NON_METRIC_UNITS:
        return _NON_METRIC_UNITS[name]
    base = name.partition(":")[0]
    if base == FORMULA_METRIC:
        raise InputError(f"'{FORMULA_METRIC}' is the metric of a formula; write the formula itself, in brackets.")
    if base == CONDITION_METRIC:
        raise InputError(f"'{CONDITION_METRIC}' is the metric of a condition, which a formula cannot use.")
    if base not in METRICS:
        raise InputError(
            f"there is no signal '{name}'; {suggest_name(name, [*_NON_METRIC_UNITS, *signal_metric_names()])}"
        )
    return METRICS.create(name).unit


def signal_metric_names() -> list[str]:
    """Names of the metrics that can be signals."""
    return [name for name in METRICS.names() if name not in (FORMULA_METRIC, CONDITION_METRIC)]


def is_metric_signal(name: str) -> bool:
    """Whether a signal, which has to exist, is a metric."""
    return name not in _NON_METRIC_UNITS


class _LazySignals(Mapping[str, FloatArray]):
    """Signals of a recording, each computed on first access."""

    def __init__(self, recording: Recording, ego: str, other: str, courses: dict[str, FloatArray]) -> None:
        self._recording, self._courses = recording, courses
        self._names = {"ego": ego, "other": other}
        self._rows = {who: recording.entity_index(name) for who, name in self._names.items()}
        self._cache: dict[str, FloatArray] = {}
        self._contact: tuple[int, float] | None = None
        self._contact_searched = False

    def __getitem__(self, name: str) -> FloatArray:
        if name not in self._cache:
            self._cache[name] = self._compute_signal(name)
        return self._cache[name]

    def __iter__(self) -> Iterator[str]:
        return iter([*_NON_METRIC_UNITS, *self._courses])

    def __len__(self) -> int:
        return len(_NON_METRIC_UNITS) + len(self._courses)

    def _compute_signal(self, name: str) -> FloatArray:
        if name == "time":
            return self._recording.time
        if name in _NON_METRIC_UNITS:
            who, _, what = name.partition(".")
            motion: FloatArray = getattr(self._recording, what)[self._rows[who]]
            return motion
        return self._course_with_contact(METRICS.create(name), self._courses.get(name))

    def _course_with_contact(self, metric: Metric, stored_course: FloatArray | None) -> FloatArray:
        ego, other = self._names["ego"], self._names["other"]
        course = _compute_course(metric, self._recording, ego, other) if stored_course is None else stored_course
        if metric.contact_score is None:
            return course
        if not self._contact_searched:
            self._contact, self._contact_searched = find_first_contact(self._recording, ego, other), True
        if self._contact is None:
            return course
        instant, change = self._contact
        signal = np.array(course, dtype=np.float64)
        signal[instant] = metric.score_with_contact(float(metric.clip_course(signal[instant : instant + 1])[0]), change)
        return signal


def _compute_course(metric: Metric, recording: Recording, ego: str, other: str) -> FloatArray:
    """Course of a metric, which may be third-party code."""
    interrupts = count_requests()
    try:
        return metric.course(recording, ego, other)
    except (InputError, PluginError):
        raise
    except BaseException as error:
        raise make_scenario_failure(f"the metric {metric.name}", error, interrupts) from error
