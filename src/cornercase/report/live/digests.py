"""What the page shows of one scenario, read as soon as it has ended."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.exploration import Objective
from cornercase.report.contents import plain_score, plain_values, tell_against
from cornercase.report.course_lines import draw_course, pack_courses
from cornercase.report.summary import touched_by_ego
from cornercase.study import Row, Study, StudyMeta


@dataclass(frozen=True, eq=False)
class Digest:
    """What the page shows of one scenario by itself.

    Attributes
    ----------
    row : Row
    scores : mapping of str to float
        By metric; empty where it failed.
    critical, collides : bool
        Whether it is critical, and whether the ego collides with whom it is measured against.
    span : tuple of float
        When its recording begins and ends, in s.
    courses : mapping of str to ndarray of float64, shape (P,)
        Capped courses by metric, at evenly spread times.
    against : mapping of str to (str or None)
        By metric, whom of several others the score is against; empty where there is one.
    """

    row: Row
    scores: dict[str, float]
    critical: bool
    collides: bool
    span: tuple[float, float]
    courses: dict[str, FloatArray]
    against: dict[str, str | None] = field(default_factory=dict)


class Digester:
    """Reads digests from a study.

    Parameters
    ----------
    study : Study
        Open.
    """

    def __init__(self, study: Study) -> None:
        self._study = study
        self._objective = Objective.of_study(study.meta)

    def read(self, row: Row) -> Digest:
        """Read the digest of a scenario.

        Parameters
        ----------
        row : Row
            Of a scenario that has ended.

        Returns
        -------
        Digest
        """
        if row.state == "failed":
            return Digest(row, {}, False, False, (0.0, 0.0), {})
        study, meta = self._study, self._study.meta
        recording, scores = study.recording(row.id), study.scores_of(row.id)
        time = recording.time
        courses = {
            one.name: draw_course(
                time, one.capped(study.course(row.id, one.name)).astype(np.float32), one.lower_is_critical
            )
            for one in self._objective.metrics
        }
        return Digest(
            row,
            scores,
            self._is_critical(scores),
            not touched_by_ego(meta, recording.collisions).isdisjoint(meta.others),
            (float(time[0]), float(time[-1])),
            courses,
            study.against_of(row.id),
        )

    def _is_critical(self, scores: dict[str, float]) -> bool:
        every = np.array([[scores[one.name] for one in self._objective.metrics]])
        return bool(self._objective.critical(every, self._study.meta.critical)[0])


def tell_scenarios(meta: StudyMeta, digests: Sequence[Digest]) -> dict[str, Any]:
    """Put digests into the columns of the page, without what only an analysis knows.

    Parameters
    ----------
    meta : StudyMeta
        What the study is about.
    digests : sequence of Digest
        In the order of the page's rows.

    Returns
    -------
    dict of str to object
        ``scenarios`` and ``errors`` as in `cornercase.report.contents.page_contents`.
    """
    rows = [one.row for one in digests]

    def scores(name: str) -> list[float | None]:
        return [plain_score(one.scores[name]) if name in one.scores else None for one in digests]

    return {
        "scenarios": {
            "id": [row.id for row in rows],
            "round": [row.round for row in rows],
            "failed": [int(row.state == "failed") for row in rows],
            "values": plain_values(meta.space.parameters, rows),
            "scores": {name: scores(name) for name in meta.metrics},
            "critical": [int(one.critical) for one in digests],
            "collides": [int(one.collides) if one.scores else None for one in digests],
            "outcome": [None] * len(rows),
            "kept": [0] * len(rows),
            "audit": [int(meta.is_audit(row.id)) for row in rows],
        }
        | tell_against(
            meta, [[one.against.get(name) for name in meta.metrics] if one.scores else None for one in digests]
        ),
        "errors": {str(row.id): row.error or "" for row in rows if row.state == "failed"},
    }


def tell_courses(meta: StudyMeta, digests: Sequence[Digest]) -> dict[str, Any]:
    """Put the courses of digests into the page's form.

    Parameters
    ----------
    meta : StudyMeta
        What the study is about.
    digests : sequence of Digest
        In the order of the page's rows.

    Returns
    -------
    dict of str to object
        By metric, as ``courses`` in `cornercase.report.contents.page_contents`.
    """
    return {
        name: pack_courses([one.courses.get(name) for one in digests], [one.span for one in digests])
        for name in meta.metrics
    }
