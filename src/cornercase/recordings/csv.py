"""Recordings, and courses of metrics, as CSV."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cornercase._common.errors import InputError, suggestion
from cornercase._common.files import written_whole
from cornercase._common.texts import cell_text, text_of_cell
from cornercase._common.typing import FloatArray, IntArray
from cornercase.recordings.recording import BOX, COLUMNS, MOTION, Collision, Recording


def read_csv(path: Path) -> Recording:
    """Read a table with one row per entity and instant.

    Parameters
    ----------
    path : path
        CSV with at least the columns `COLUMNS`.

    Returns
    -------
    Recording

    Raises
    ------
    InputError
        As in `read_recording`.
    """
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file)
            missing = [column for column in COLUMNS if column not in (reader.fieldnames or ())]
            if missing:
                raise InputError(
                    f"{path}: the header lacks {', '.join(missing)}; a recording has the columns {', '.join(COLUMNS)}."
                )
            rows = [(reader.line_num, _texts(row)) for row in reader]
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: is not a CSV table in UTF-8 ({error}).") from error
    if not rows:
        raise InputError(f"{path}: has a header but no rows.")

    numbers = np.array([[_number(path, line, row, c) for c in ("time", *MOTION, *BOX)] for line, row in rows])
    if not np.isfinite(numbers[:, 0]).all():
        raise InputError(f"{path}: every row needs a finite time.")
    time, instant = np.unique(numbers[:, 0], return_inverse=True)
    names = tuple(dict.fromkeys(row["entity"] for _, row in rows))
    entity = np.array([names.index(row["entity"]) for _, row in rows])
    _refuse_doubles(path, [line for line, _ in rows], entity * len(time) + instant)
    motion = np.full((len(MOTION), len(names), len(time)), np.nan)
    motion[:, entity, instant] = numbers[:, 1 : 1 + len(MOTION)].T
    first = [int(np.flatnonzero(entity == a)[0]) for a in range(len(names))]
    box = numbers[first, 1 + len(MOTION) :].T
    if not (np.isfinite(box).all() and (box[:2] >= 0).all()):
        raise InputError(f"{path}: length and width must be finite and not negative for every entity.")
    x, y, heading, speed, acceleration = motion
    length, width, center_x = box
    collisions = tuple(
        Collision(float(numbers[i, 0]), (row["entity"], other))
        for i, (line, row) in enumerate(rows)
        for other in _touched(path, line, row.get("collision") or "", names)
    )
    return Recording(
        time=time,
        names=names,
        kinds=tuple(rows[i][1]["kind"] for i in first),
        x=x,
        y=y,
        heading=heading,
        speed=speed,
        acceleration=acceleration,
        length=length,
        width=width,
        center_x=center_x,
        collisions=tuple(sorted(collisions, key=lambda c: c.time)),
    )


def _texts(row: dict[str, Any]) -> dict[str, Any]:
    """A row whose texts are what they were before they became cells."""
    return row | {name: text_of_cell(row[name]) for name in ("entity", "kind", "collision") if row.get(name)}


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
        writer.writerow(("time", *map(cell_text, courses)))
        for row in zip(time.tolist(), *(course.tolist() for course in courses.values()), strict=True):
            writer.writerow(["" if value != value else value for value in row])


def _refuse_doubles(path: Path, lines: list[int], place: IntArray) -> None:
    """Refuse a second row of one entity at one instant."""
    order = np.argsort(place, kind="stable")
    double = np.flatnonzero(np.diff(place[order]) == 0)
    if len(double):
        first, second = order[double[0]], order[double[0] + 1]
        raise InputError(
            f"{path}, line {lines[second]}: the entity has a row of this time in line {lines[first]} already; "
            "leave one of the two."
        )


def _touched(path: Path, line: int, text: str, names: tuple[str, ...]) -> list[str]:
    """Entities named in the column ``collision``."""
    found = [part.strip() for part in text.split(";") if part.strip()]
    for name in found:
        if name not in names:
            raise InputError(f"{path}, line {line}: collision names '{name}'; {suggestion(name, names)}")
    return found


def _number(path: Path, line: int, row: dict[str, str | None], column: str) -> float:
    text = (row[column] or "").strip()
    if text == "":
        return float("nan")
    try:
        return float(text)
    except ValueError:
        raise InputError(f"{path}, line {line}: {column} is '{text}', which is not a number.") from None
