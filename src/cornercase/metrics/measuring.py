"""Metrics of one recording."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from cornercase._common.arguments import path, texts
from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray
from cornercase.metrics.base import Metric
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
    """

    time: FloatArray
    courses: Mapping[str, FloatArray]
    scores: Mapping[str, float]
    units: Mapping[str, str]
    lower_is_critical: Mapping[str, bool]

    def rows(self) -> list[tuple[str, str, str, str]]:
        """Say the score of each metric: its name, the score, the unit, and whether low or high is critical.

        Returns
        -------
        list of tuple of four str
        """
        return [
            (name, f"{score:.4g}", self.units[name], "low" if self.lower_is_critical[name] else "high")
            for name, score in self.scores.items()
        ]

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
        rows = [("metric", "score", "unit", "critical is"), *self.rows()]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        return "\n".join("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)


def measure(
    recording: Recording | Path | str, ego: str, other: str, metrics: Sequence[str] | None = None
) -> Measurement:
    """Measure how critical a recording is.

    Parameters
    ----------
    recording : Recording or path
        A path of whatever `read_recording` reads.
    ego, other : str
        Names of the entity under test and of the one that it is measured against.
    metrics : sequence of str, optional
        Options stand behind a colon, as in ``"ttc:accelerating=true"``; by default all metrics.

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
    require_another(ego, other)
    read = recording if isinstance(recording, Recording) else read_recording(path("recording", recording))
    names = METRICS.names() if metrics is None else texts("metrics", metrics)
    made = [METRICS.create(name) for name in dict.fromkeys(names)]
    found = measured(made, read, ego, other)
    return Measurement(
        time=read.time,
        courses={name: course for name, (course, _) in found.items()},
        scores={name: score for name, (_, score) in found.items()},
        units={metric.name: metric.unit for metric in made},
        lower_is_critical={metric.name: metric.lower_is_critical for metric in made},
    )


def require_another(ego: str, other: str) -> None:
    """Refuse to measure an entity against itself.

    Parameters
    ----------
    ego, other : str

    Raises
    ------
    InputError
        They are the same.
    """
    if ego == other:
        raise InputError(f"`other` {other}: is the ego itself; name the entity that it meets.")


def measured(
    metrics: Iterable[Metric], recording: Recording, ego: str, other: str
) -> dict[str, tuple[FloatArray, float]]:
    """Measure a recording.

    Parameters
    ----------
    metrics : iterable of Metric
    recording : Recording
    ego, other : str
        Names of two entities.

    Returns
    -------
    dict of str to (ndarray of float64, shape (T,), float)
        Course and score by the metric's name; the score of a recording in which both touch as of
        `Metric.score_of_contact`.

    Raises
    ------
    InputError
        There is no entity of that name.
    """
    courses = {}
    asked: list[float | None] = []
    for metric in metrics:
        course = metric.course(recording, ego, other)
        score = metric.score(course)
        if metric.contact is not None:
            # Once for all metrics.
            asked = asked or [velocity_change(recording, ego, other)]
            score = score if asked[0] is None else metric.score_of_contact(score, asked[0])
        courses[metric.name] = (course, score)
    return courses
