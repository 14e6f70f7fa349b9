"""Courses of metrics as a table."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

from cornercase.files import written_whole
from cornercase.typing import FloatArray


def write_courses(path: Path | str, time: FloatArray, courses: Mapping[str, FloatArray]) -> None:
    """Write one row per instant, with the header ``time,METRIC,…``; empty where a metric is not defined.

    Parameters
    ----------
    path : path
    time : ndarray of float64, shape (T,)
        s.
    courses : mapping of str to ndarray of float64, shape (T,)
    """
    with written_whole(path) as temporary, open(temporary, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("time", *courses))
        for row in zip(time.tolist(), *(course.tolist() for course in courses.values()), strict=True):
            writer.writerow(["" if value != value else value for value in row])
