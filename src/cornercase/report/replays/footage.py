"""What a replay shows: scenarios of a study, and the road that they are on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray
from cornercase.exploration import Objective
from cornercase.metrics import METRICS, Metric
from cornercase.recordings import Recording
from cornercase.report.roads import find_roads, recorded_region
from cornercase.roads import RoadSketch
from cornercase.scenario import Parameter, Scenario
from cornercase.study import Row, Study, StudyMeta


@dataclass(frozen=True, eq=False)
class Take:
    """One scenario of a replay.

    Attributes
    ----------
    row : Row
        What the study says of it.
    recording : Recording
        Of A entities at T instants.
    courses : mapping of str to ndarray of float64, shape (T,)
        Capped courses by metric.
    scores : mapping of str to float
        By metric.
    outcome : str
        How it ended; empty where that is not known.
    critical : bool
        Whether it is critical.
    against : mapping of str to (str or None)
        By metric, whom of several others the score is against; empty where there is one.
    """

    row: Row
    recording: Recording
    courses: Mapping[str, FloatArray]
    scores: Mapping[str, float]
    outcome: str
    critical: bool
    against: Mapping[str, str | None] = field(default_factory=dict)

    def critical_time(self, metric: Metric) -> float:
        """Find when a metric is most critical.

        Parameters
        ----------
        metric : Metric
            Whose course is looked at.

        Returns
        -------
        float
            The first such instant in s; where the course is the same all along, the first collision, or the begin.
        """
        course = metric.oriented(self.courses[metric.name])
        known = course[np.isfinite(course)]
        if len(known) and known.min() < known.max():
            return float(self.recording.time[int(np.nanargmin(course))])
        return self.recording.collisions[0].time if self.recording.collisions else float(self.recording.time[0])


@dataclass(frozen=True, eq=False)
class Footage:
    """Everything that a replay shows.

    Attributes
    ----------
    study : str
        Name of the study's file.
    meta : StudyMeta
        Of the study.
    metrics : tuple of Metric
        The first one's course is shown.
    threshold : float or None
        Score of the first metric from which a scenario is critical, where it alone says so.
    takes : tuple of Take
        One, or two beside each other.
    road : RoadSketch or None
        None where it is not known.
    road_missing : str
        Why it is not known.
    """

    study: str
    meta: StudyMeta
    metrics: tuple[Metric, ...]
    threshold: float | None
    takes: tuple[Take, ...]
    road: RoadSketch | None
    road_missing: str

    @property
    def parameters(self) -> Sequence[Parameter]:
        """Parameters of the space."""
        return self.meta.space.parameters

    def other_of(self, take: Take) -> str:
        """Choose the other that is looked at in a scenario.

        Parameters
        ----------
        take : Take
            Of the scenario.

        Returns
        -------
        str
            Of several others the one that the score by the first metric is against, or else the first of them.
        """
        return take.against.get(self.metrics[0].name) or self.meta.others[0]

    @property
    def begin(self) -> float:
        """When the first recording begins, in s."""
        return float(self.takes[0].recording.time[0])

    @property
    def end(self) -> float:
        """When the longest recording ends, in s."""
        return max(float(take.recording.time[-1]) for take in self.takes)


def read_footage(study: Study, ids: Sequence[int], scenario: Path | str | Scenario | None = None) -> Footage:
    """Read what a replay shows.

    Parameters
    ----------
    study : Study
        Open.
    ids : sequence of int
        Of the scenarios.
    scenario : path or Scenario, optional
        The scenario file that was explored, where it lies elsewhere than beside the study.

    Returns
    -------
    Footage
        Everything at once.

    Raises
    ------
    InputError
        A scenario is not there, failed, or was not run yet, or the `scenario` is not the one that was explored.
    """
    meta = study.meta
    metrics = tuple(METRICS.create(name) for name in meta.metrics)
    objective = Objective.of_study(meta)
    # A front has no threshold, and that of a weighted sum is none of a course.
    threshold = None if objective.pareto or objective.weights else study.critical
    outcomes = study.outcomes()
    rows = {row.id: row for row in study.rows()}
    takes = []
    for one in ids:
        row = _require_run(study, rows, one)
        scores = study.scores_of(one)
        courses = {metric.name: metric.capped(study.course(one, metric.name)) for metric in metrics}
        every = np.array([[scores[metric.name] for metric in metrics]])
        critical = bool(objective.critical(every, study.critical)[0])
        against = study.against_of(one)
        takes.append(Take(row, study.recording(one), courses, scores, outcomes.get(one, ""), critical, against))
    region = recorded_region(take.recording for take in takes)
    road, missing = find_roads(study, region, scenario, takes[0].row.values)
    return Footage(study.path.name, meta, metrics, threshold, tuple(takes), road, missing)


def _require_run(study: Study, rows: Mapping[int, Row], scenario: int) -> Row:
    row = rows.get(scenario)
    if row is None:
        count = f"its scenarios are 1 to {max(rows)}" if rows else "it has none yet"
        raise InputError(f"{study.path}: has no scenario {scenario}; {count}.")
    if row.state == "failed":
        raise InputError(f"{study.path}: scenario {scenario} failed, so there is nothing to replay: {row.error}")
    if row.state != "done":
        raise InputError(f"{study.path}: scenario {scenario} was not run yet, so there is nothing to replay.")
    return row
