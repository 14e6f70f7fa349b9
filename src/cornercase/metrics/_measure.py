"""Measurement of metrics on one recording."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, NoReturn

import numpy as np

from cornercase._common.errors import InputError, PluginError, hide_input_error_traceback
from cornercase._common.plugin_errors import is_built_in, make_scenario_failure, user_code_error
from cornercase._common.process.signals import count_termination_requests
from cornercase._common.typing import FloatArray
from cornercase._common.validation import check_path, repr_short
from cornercase.metrics._base import Metric
from cornercase.metrics._other_entities import present_others, resolve_others
from cornercase.metrics._own_metrics import resolve_metrics
from cornercase.metrics._registry import METRICS
from cornercase.metrics._severity import find_first_contact
from cornercase.recordings import Recording, read_recording
from cornercase.recordings._recording import read_only

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False, repr=False)
class Measurement:
    """Courses and scores of metrics on a recording. Each mapping has the names of the metrics as keys.

    Attributes
    ----------
    time : ndarray of float64, shape (T,)
        Times of the T instants in s.
    courses : mapping of str to ndarray of float64, shape (T,)
        Values at the instants; NaN at instants at which a metric is not defined.
    scores : mapping of str to float
    units : mapping of str to str
        Units of courses and scores; ``"1"`` for metrics without unit.
    lower_is_critical : mapping of str to bool
    against : mapping of str to (str or None)
        Other entity that each score comes from. None if the score is the cap, or if all entities give the same result.
        Empty if there is only one other entity.

    Examples
    --------
    >>> import cornercase as cc
    >>> recording = cc.simulate("examples/x_intersection/x_intersection.xosc")
    >>> measurement = cc.measure(recording, "Ego", "Pedestrian", ["distance"])
    >>> round(measurement.scores["distance"], 2), measurement.units["distance"]
    (7.97, 'm')
    >>> float(measurement.time[measurement.courses["distance"].argmin()])
    9.3
    """

    time: FloatArray
    courses: Mapping[str, FloatArray]
    scores: Mapping[str, float]
    units: Mapping[str, str]
    lower_is_critical: Mapping[str, bool]
    against: Mapping[str, str | None] = field(default_factory=dict)

    def column_names(self) -> tuple[str, ...]:
        """Return the names of the columns of `rows`.

        Returns
        -------
        tuple of str
        """
        return ("metric", "score", "unit", "critical is", *(["against"] if self.against else []))

    def rows(self) -> list[tuple[str, ...]]:
        """Return one row per metric: name, score, unit, and whether low or high is critical.

        With several other entities, a last column names the entity that the score comes from.

        Returns
        -------
        list of tuple of str
            Columns as in `column_names`.
        """
        plain = [
            (name, f"{score:.4g}", self.units[name], "low" if self.lower_is_critical[name] else "high")
            for name, score in self.scores.items()
        ]
        return [(*row, self.against[row[0]] or "–") for row in plain] if self.against else list(plain)

    def to_dataframe(self) -> pd.DataFrame:
        """Return the courses as a table.

        Returns
        -------
        pandas.DataFrame
            A column for each metric, in its unit; the index is the time in s.
        """
        import pandas as pd

        return pd.DataFrame(dict(self.courses), index=pd.Index(self.time, name="time"))

    def __getitem__(self, name: object) -> NoReturn:
        raise TypeError(f"A Measurement has no items; use scores[{name!r}], courses[{name!r}] or units[{name!r}].")

    def __repr__(self) -> str:
        rows = [self.column_names(), *self.rows()]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        return "\n".join("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)


@hide_input_error_traceback()
def measure(
    recording: Recording | Path | str,
    ego: str,
    other: str | Sequence[str],
    metrics: Metric | str | Sequence[Metric | str] | None = None,
) -> Measurement:
    """Measure how critical a recording is.

    Parameters
    ----------
    recording : Recording or path
        A path of anything that `read_recording` reads.
    ego : str
        Name of the entity under test.
    other : str or sequence of str
        Entities to measure against; ``"*"`` stands for all but the ego. With several entities, each metric takes the
        most critical value.
    metrics : Metric or str, or sequence of these, optional
        A metric is given as its name, with options after a colon, such as ``"ttc:accelerating=true"``, or a `Metric`
        object, which can be of your own class. By default all registered metrics that need no option.

    Returns
    -------
    Measurement

    Raises
    ------
    InputError
        The recording cannot be read, there is no such entity or metric, or ego and other are the same entity.

    Examples
    --------
    >>> import numpy as np
    >>> from cornercase.metrics import measure
    >>> from cornercase.recordings import Recording
    >>> still = np.zeros((2, 3))
    >>> recording = Recording(
    ...     time=np.array([0.0, 0.1, 0.2]), names=("Ego", "Other"), object_types=("car", "car"),
    ...     x=np.array([[0.0, 1.0, 2.0], [20.0, 20.0, 20.0]]), y=still, heading=still,
    ...     speed=np.array([[10.0] * 3, [0.0] * 3]), acceleration=still,
    ...     length=np.full(2, 4.0), width=np.full(2, 2.0), center_x=np.zeros(2),
    ... )
    >>> measure(recording, "Ego", "Other", ["ttc", "drac"])
    metric  score  unit  critical is
    ttc     1.4    s     low
    drac    3.571  m/s²  high
    """
    loaded = recording if isinstance(recording, Recording) else read_recording(check_path("recording", recording))
    loaded.entity_index(ego)
    others = resolve_others(other, ego, loaded.names)
    for entity in others:
        loaded.entity_index(entity)
    if metrics is None:
        metrics = [name for name in METRICS.names() if not METRICS.get_class(name).required_option]
    created = resolve_metrics(metrics)
    for metric in created:
        metric.check_installed()
    try:
        results = evaluate_metrics(created, loaded, ego, others)
    except PluginError as error:
        raise user_code_error(error) from error.__cause__
    return Measurement(
        time=loaded.time,
        courses={name: result.course for name, result in results.items()},
        scores={name: result.score for name, result in results.items()},
        units={metric.name: metric.unit for metric in created},
        lower_is_critical={metric.name: metric.lower_is_critical for metric in created},
        against={name: result.against for name, result in results.items()} if len(others) > 1 else {},
    )


class MetricResult(NamedTuple):
    """Course and score of a metric; with several other entities, the most critical values.

    `against` is the name of the other entity that the score comes from; the first if several entities give this score.
    `against` is None if there is only one other entity, if the score is the cap, or if all entities give the same
    result.
    """

    course: FloatArray
    score: float
    against: str | None = None


def evaluate_metrics(
    metrics: Iterable[Metric], recording: Recording, ego: str, other: str | Sequence[str]
) -> dict[str, MetricResult]:
    """Evaluate metrics on a recording; return the results by name of the metric.

    Other entities that never exist in the recording are skipped. If the ego touches the other entity,
    `Metric.score_with_contact` adapts the score of a metric that has a `contact_score`. Raises PluginError if a metric
    raises an exception or returns no numbers.
    """
    named = (other,) if isinstance(other, str) else tuple(other)
    others = present_others(recording, named)
    contacts: dict[str, tuple[int, float] | None] = {}  # cache by entity, shared by all metrics
    results = {}
    for metric in metrics:
        per_entity = [_evaluate_against(metric, recording, ego, entity, contacts) for entity in others]
        results[metric.name] = per_entity[0] if len(named) == 1 else _combine_most_critical(metric, others, per_entity)
    return results


def _evaluate_against(
    metric: Metric, recording: Recording, ego: str, other: str, contacts: dict[str, tuple[int, float] | None]
) -> MetricResult:
    course, score = compute_course_and_score(metric, recording, ego, other)
    if metric.contact_score is not None:
        if other not in contacts:
            contacts[other] = find_first_contact(recording, ego, other)
        contact = contacts[other]
        score = score if contact is None else metric.score_with_contact(score, contact[1])
    return MetricResult(course, score)


def compute_course_and_score(metric: Metric, recording: Recording, ego: str, other: str) -> tuple[FloatArray, float]:
    """Compute course and score of a metric, and check both, since the metric may be third-party code."""
    part, interrupts = f"the metric {metric.name}", count_termination_requests()
    try:
        course = metric.course(recording if is_built_in(metric) else read_only(recording), ego, other)
        score = metric.score(course)
    except (InputError, PluginError):
        raise
    except BaseException as error:
        raise make_scenario_failure(part, error, interrupts) from error
    if not (np.shape(course) == recording.time.shape and _has_real_dtype(course)):
        raise PluginError(
            f"{part} gave {repr_short(course)} as its course; it has to return one number for each of the"
            f" {recording.time.size} instants"
        )
    if not (np.ndim(score) == 0 and _has_real_dtype(score)) or np.isnan(score):
        raise PluginError(f"{part} gave {repr_short(score)} as its score, which is not a number")
    if np.isinf(score) and not is_built_in(metric):
        raise PluginError(f"{part} gave an infinite score; set its attribute `bound` to the most critical value")
    return course, score


def _has_real_dtype(value: object) -> bool:
    return np.asarray(value).dtype.kind in "fiub"


def _combine_most_critical(metric: Metric, others: Sequence[str], results: Sequence[MetricResult]) -> MetricResult:
    """Combine the results against several other entities into the most critical one.

    `others` are the entities that exist in the recording, or a single entity if none exists.
    """
    courses = metric.to_minimize(np.stack([np.asarray(result.course, dtype=np.float64) for result in results]))
    scores = [metric.to_minimize(result.score) for result in results]
    k = scores.index(min(scores))
    all_equal = len(results) > 1 and all(
        score == scores[0] and np.array_equal(course, courses[0], equal_nan=True)
        for score, course in zip(scores, courses, strict=True)
    )
    has_source = scores[k] < metric.to_minimize(metric.cap) and not all_equal
    return MetricResult(
        metric.to_minimize(np.fmin.reduce(courses)), results[k].score, others[k] if has_source else None
    )
