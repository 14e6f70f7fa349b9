"""Metrics of one recording."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cornercase._common.arguments import path, shown, texts
from cornercase._common.errors import InputError, PartError
from cornercase._common.interrupts import requests_heard
from cornercase._common.parts import failure_of
from cornercase._common.typing import FloatArray
from cornercase.metrics.base import Metric
from cornercase.metrics.others import name_others, others_there
from cornercase.metrics.registry import METRICS
from cornercase.metrics.severity import velocity_change
from cornercase.recordings import Recording, read_recording

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False, repr=False)
class Measurement:
    """What metrics say of a recording; each mapping has the names of the metrics as keys.

    Attributes
    ----------
    time : ndarray of float64, shape (T,)
        s.
    courses : mapping of str to ndarray of float64, shape (T,)
        NaN where a metric is not defined.
    scores : mapping of str to float
    units : mapping of str to str
        Of courses and scores; ``"1"`` for none.
    lower_is_critical : mapping of str to bool
    against : mapping of str to (str or None)
        Of several others the one that each score is against, as in `Measured`; empty where there is one.
    """

    time: FloatArray
    courses: Mapping[str, FloatArray]
    scores: Mapping[str, float]
    units: Mapping[str, str]
    lower_is_critical: Mapping[str, bool]
    against: Mapping[str, str | None] = field(default_factory=dict)

    def head(self) -> tuple[str, ...]:
        """Say what `rows` has in its columns.

        Returns
        -------
        tuple of str
        """
        return ("metric", "score", "unit", "critical is", *(["against"] if self.against else []))

    def rows(self) -> list[tuple[str, ...]]:
        """Say the score of each metric, with its unit, whether low or high is critical, and of several others whom.

        Returns
        -------
        list of tuple of str
            As `head` says.
        """
        plain = [
            (name, f"{score:.4g}", self.units[name], "low" if self.lower_is_critical[name] else "high")
            for name, score in self.scores.items()
        ]
        return [(*row, self.against[row[0]] or "–") for row in plain] if self.against else list(plain)

    def table(self) -> pd.DataFrame:
        """Courses as a table.

        Returns
        -------
        pandas.DataFrame
            A column for each metric, in its unit; the index is the time in s.
        """
        import pandas as pd

        return pd.DataFrame(dict(self.courses), index=pd.Index(self.time, name="time"))

    def __repr__(self) -> str:
        rows = [self.head(), *self.rows()]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        return "\n".join("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)


def measure(
    recording: Recording | Path | str, ego: str, other: str | Sequence[str], metrics: Sequence[str] | None = None
) -> Measurement:
    """Measure how critical a recording is.

    Parameters
    ----------
    recording : Recording or path
        A path of whatever `read_recording` reads.
    ego : str
        Name of the entity under test.
    other : str or sequence of str
        Whom it is measured against; of several the one counts to whom it is most critical, metric by metric. ``"*"``
        stands for all others.
    metrics : sequence of str, optional
        Options stand after a colon, as in ``"ttc:accelerating=true"``; by default all metrics that need none.

    Returns
    -------
    Measurement

    Raises
    ------
    InputError
        The recording cannot be read, there is no such entity or metric, or the two are one entity.

    Examples
    --------
    >>> import numpy as np
    >>> from cornercase.metrics import measure
    >>> from cornercase.recordings import Recording
    >>> still = np.zeros((2, 3))
    >>> recording = Recording(
    ...     time=np.array([0.0, 0.1, 0.2]), names=("Ego", "Other"), kinds=("car", "car"),
    ...     x=np.array([[0.0, 1.0, 2.0], [20.0, 20.0, 20.0]]), y=still, heading=still,
    ...     speed=np.array([[10.0] * 3, [0.0] * 3]), acceleration=still,
    ...     length=np.full(2, 4.0), width=np.full(2, 2.0), center_x=np.zeros(2),
    ... )
    >>> measure(recording, "Ego", "Other", ["ttc", "drac"])
    metric  score  unit  critical is
    ttc     1.4    s     low
    drac    3.571  m/s²  high
    """
    read = recording if isinstance(recording, Recording) else read_recording(path("recording", recording))
    read.index(ego)
    others = name_others(other, ego, read.names)
    for one in others:
        read.index(one)
    names = _plain_names() if metrics is None else texts("metrics", metrics)
    made = [METRICS.create(name) for name in dict.fromkeys(names)]
    for metric in made:
        metric.require()
    try:
        found = measured(made, read, ego, others)
    except PartError as error:
        raise InputError(f"{str(error)[0].upper()}{str(error)[1:]}.") from error
    return Measurement(
        time=read.time,
        courses={name: one.course for name, one in found.items()},
        scores={name: one.score for name, one in found.items()},
        units={metric.name: metric.unit for metric in made},
        lower_is_critical={metric.name: metric.lower_is_critical for metric in made},
        against={name: one.against for name, one in found.items()} if len(others) > 1 else {},
    )


def _plain_names() -> list[str]:
    """Names that are metrics by themselves."""
    return [name for name in METRICS.names() if not METRICS.class_of(name).wants]


class Measured(NamedTuple):
    """What a metric says of a recording.

    Attributes
    ----------
    course : ndarray of float64, shape (T,)
        With several others, at each instant the most critical of the values against each; NaN where it is defined
        against none of them.
    score : float
        With several others the most critical of the scores against each.
    against : str or None
        Of several others the one whose score that is, of equal ones the first. None where there is one other only,
        where the score is the metric's cap, and where course and score are the same against all, as of a metric that
        does not look at the other.
    """

    course: FloatArray
    score: float
    against: str | None = None


def measured(
    metrics: Iterable[Metric], recording: Recording, ego: str, other: str | Sequence[str]
) -> dict[str, Measured]:
    """Measure a recording.

    Parameters
    ----------
    metrics : iterable of Metric
    recording : Recording
    ego : str
        Name of an entity.
    other : str or sequence of str
        Names of one or several others. Of several, one that is never there counts as nothing.

    Returns
    -------
    dict of str to Measured
        Course and score by the metric's name; the score of a recording in which both touch as of
        `Metric.score_of_contact`.

    Raises
    ------
    InputError
        There is no entity of that name.
    PartError
        A metric raised an exception, or gave no numbers.
    """
    named = (other,) if isinstance(other, str) else tuple(other)
    others = others_there(recording, named)
    # Once for all metrics.
    changes: dict[str, float | None] = {}
    found = {}
    for metric in metrics:
        each = [_measured_against(metric, recording, ego, one, changes) for one in others]
        found[metric.name] = each[0] if len(named) == 1 else _worst(metric, others, each)
    return found


def _measured_against(
    metric: Metric, recording: Recording, ego: str, other: str, changes: dict[str, float | None]
) -> Measured:
    course, score = _asked(metric, recording, ego, other)
    if metric.contact is not None:
        if other not in changes:
            changes[other] = velocity_change(recording, ego, other)
        change = changes[other]
        score = score if change is None else metric.score_of_contact(score, change)
    return Measured(course, score)


def _asked(metric: Metric, recording: Recording, ego: str, other: str) -> tuple[FloatArray, float]:
    """Course and score of a metric, which may be a class of anybody."""
    part, heard = f"the metric {metric.name}", requests_heard()
    try:
        course = metric.course(recording, ego, other)
        score = metric.score(course)
    except (InputError, PartError):
        raise
    except BaseException as error:
        raise failure_of(part, error, heard) from error
    if not (np.shape(course) == recording.time.shape and _is_numeric(course)):
        each = f"a number for each of {recording.time.size} instants"
        raise PartError(f"{part} gave {shown(course)} as its course, which is not {each}")
    if not (np.ndim(score) == 0 and _is_numeric(score)) or np.isnan(score):
        raise PartError(f"{part} gave {shown(score)} as its score, which is not a number")
    return course, score


def _is_numeric(given: object) -> bool:
    return np.asarray(given).dtype.kind in "fiub"


def _worst(metric: Metric, others: Sequence[str], each: Sequence[Measured]) -> Measured:
    """Put together what a metric says against each of several others, of which one is there at least."""
    courses = metric.oriented(np.stack([np.asarray(one.course, dtype=np.float64) for one in each]))
    scores = [metric.oriented(one.score) for one in each]
    k = scores.index(min(scores))
    alike = len(each) > 1 and all(
        score == scores[0] and np.array_equal(course, courses[0], equal_nan=True)
        for score, course in zip(scores, courses, strict=True)
    )
    decides = scores[k] < metric.oriented(metric.cap) and not alike
    return Measured(metric.oriented(np.fmin.reduce(courses)), each[k].score, others[k] if decides else None)
