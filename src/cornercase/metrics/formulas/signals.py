"""Signals that formulas can use: metrics, the motion of the ego and of another entity, time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np

from cornercase._common.errors import InputError, PartError, suggestion
from cornercase._common.interrupts import requests_heard
from cornercase._common.parts import failure_of
from cornercase._common.typing import FloatArray
from cornercase.metrics.base import Metric
from cornercase.metrics.registry import METRICS
from cornercase.metrics.severity import find_contact
from cornercase.recordings import Recording

_MOTION: Final = MappingProxyType({"x": "m", "y": "m", "heading": "rad", "speed": "m/s", "acceleration": "m/s²"})
_OWN: Final = MappingProxyType(
    {f"{who}.{what}": unit for who in ("ego", "other") for what, unit in _MOTION.items()} | {"time": "s"}
)
"""Unit by name, of signals that are not metrics."""

FORMULAS: Final = "stl"
"""Name of the metric of a formula, which cannot be used in another formula."""

CONDITION: Final = "critical-if"
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


def signals_of(recording: Recording, ego: str, other: str, courses: Mapping[str, FloatArray] | None = None) -> Signals:
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
    return Signals(recording.time, _Measured(recording, ego, other, dict(courses or {})))


def unit_of(name: str) -> str:
    """Unit of a signal. InputError, with a suggestion, if there is no such signal."""
    if name in _OWN:
        return _OWN[name]
    base = name.partition(":")[0]
    if base == FORMULAS:
        raise InputError(f"'{FORMULAS}' is the metric of a formula; write the formula itself, in brackets.")
    if base == CONDITION:
        raise InputError(f"'{CONDITION}' is the metric of a condition, which a formula cannot use.")
    if base not in METRICS:
        raise InputError(f"there is no signal '{name}'; {suggestion(name, [*_OWN, *metric_names()])}")
    return METRICS.create(name).unit


def metric_names() -> list[str]:
    """Names of the metrics that can be signals."""
    return [name for name in METRICS.names() if name not in (FORMULAS, CONDITION)]


def is_metric(name: str) -> bool:
    """Whether a signal, which has to exist, is a metric."""
    return name not in _OWN


class _Measured(Mapping[str, FloatArray]):
    """Signals of a recording, each computed on first access."""

    def __init__(self, recording: Recording, ego: str, other: str, courses: dict[str, FloatArray]) -> None:
        self._recording, self._courses = recording, courses
        self._names = {"ego": ego, "other": other}
        self._rows = {who: recording.index(name) for who, name in self._names.items()}
        self._found: dict[str, FloatArray] = {}
        self._contact: tuple[int, float] | None = None
        self._looked = False

    def __getitem__(self, name: str) -> FloatArray:
        if name not in self._found:
            self._found[name] = self._find(name)
        return self._found[name]

    def __iter__(self) -> Iterator[str]:
        return iter([*_OWN, *self._courses])

    def __len__(self) -> int:
        return len(_OWN) + len(self._courses)

    def _find(self, name: str) -> FloatArray:
        if name == "time":
            return self._recording.time
        if name in _OWN:
            who, _, what = name.partition(".")
            motion: FloatArray = getattr(self._recording, what)[self._rows[who]]
            return motion
        return self._with_contact(METRICS.create(name), self._courses.get(name))

    def _with_contact(self, metric: Metric, known: FloatArray | None) -> FloatArray:
        ego, other = self._names["ego"], self._names["other"]
        course = _course(metric, self._recording, ego, other) if known is None else known
        if metric.contact is None:
            return course
        if not self._looked:
            self._contact, self._looked = find_contact(self._recording, ego, other), True
        if self._contact is None:
            return course
        instant, change = self._contact
        signal = np.array(course, dtype=np.float64)
        signal[instant] = metric.score_of_contact(float(metric.capped(signal[instant : instant + 1])[0]), change)
        return signal


def _course(metric: Metric, recording: Recording, ego: str, other: str) -> FloatArray:
    """Course of a metric, which may be third-party code."""
    interrupts = requests_heard()
    try:
        return metric.course(recording, ego, other)
    except (InputError, PartError):
        raise
    except BaseException as error:
        raise failure_of(f"the metric {metric.name}", error, interrupts) from error
