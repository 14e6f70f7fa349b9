"""Recordings and metric time series as CSV."""

from __future__ import annotations

import csv
import io
from array import array
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from cornercase._common.errors import InputError, suggestion
from cornercase._common.files import read_file, written_whole
from cornercase._common.texts import cell_text, text_of_cell
from cornercase._common.typing import FloatArray, IntArray
from cornercase.recordings.recording import BOX, COLUMNS, MOTION, Collision, Recording
from cornercase.recordings.samples import require_box, require_motion, require_size, require_times


def read_csv(path: Path) -> Recording:
    """Read a table with one row per entity and instant, with at least the columns `CSV_COLUMNS`."""
    rows = _Rows()
    for line, row in _read_rows(path):
        rows.add(path, line, row)
    if not rows.lines:
        raise InputError(f"{path}: has a header but no rows.")
    numbers = np.frombuffer(rows.numbers, dtype=np.float64).reshape(len(rows.lines), -1)
    names, entity = tuple(rows.kinds), np.frombuffer(rows.entities, dtype=np.int64)
    if not np.isfinite(numbers[:, 0]).all():
        raise InputError(f"{path}: every row needs a finite time.")
    require_times(path, numbers[:, 0])
    time, instant = np.unique(numbers[:, 0], return_inverse=True)
    require_size(path, len(names), len(time))
    _refuse_doubles(path, rows.lines, entity * len(time) + instant)
    require_motion(path, numbers[:, 1 : 1 + len(MOTION)].T)
    motion = np.full((len(MOTION), len(names), len(time)), np.nan)
    motion[:, entity, instant] = numbers[:, 1 : 1 + len(MOTION)].T
    _, first_rows = np.unique(entity, return_index=True)
    box = numbers[first_rows, 1 + len(MOTION) :].T
    if not (np.isfinite(box).all() and (box[:2] >= 0).all()):
        raise InputError(f"{path}: length and width must be finite and not negative for every entity.")
    for name, values in zip(names, box.T.tolist(), strict=True):
        require_box(path, name, *values)
    x, y, heading, speed, acceleration = motion
    length, width, center_x = box
    entities = set(names)
    collisions = [
        Collision(float(numbers[i, 0]), (names[entity[i]], partner))
        for i, text in rows.touched.items()
        for partner in _touched(path, rows.lines[i], text, entities)
    ]
    return Recording(
        time=time,
        names=names,
        kinds=tuple(rows.kinds.values()),
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


class _Rows:
    """Content of the rows in little memory: numbers in one array, each text once."""

    def __init__(self) -> None:
        self.lines: list[int] = []
        self.numbers, self.entities = array("d"), array("q")
        self.kinds: dict[str, str] = {}
        self.touched: dict[int, str] = {}
        self._index: dict[str, int] = {}

    def add(self, path: Path, line: int, row: dict[str, str | None]) -> None:
        if None in row or any(row[column] is None for column in COLUMNS):
            raise InputError(f"{path}, line {line}: has too many or too few fields.")
        name = text_of_cell(row["entity"] or "")
        if touched := row.get("collision"):
            self.touched[len(self.lines)] = text_of_cell(touched)
        self.lines.append(line)
        self.entities.append(self._index.setdefault(name, len(self._index)))
        self.kinds.setdefault(name, text_of_cell(row["kind"] or ""))
        self.numbers.extend(_number(path, line, row, column) for column in ("time", *MOTION, *BOX))


def _read_rows(path: Path) -> Iterator[tuple[int, dict[str, str | None]]]:
    """Yield line numbers and rows, by column."""
    try:
        reader = csv.DictReader(io.StringIO(read_file(path).decode("utf-8-sig"), newline=""))
        missing = [column for column in COLUMNS if column not in (reader.fieldnames or ())]
        if missing:
            raise InputError(
                f"{path}: the header lacks {', '.join(missing)}; a recording has the columns {', '.join(COLUMNS)}."
            )
        for row in reader:
            yield reader.line_num, row
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: is not a CSV table in UTF-8 ({error}).") from error


def write_courses(path: Path | str, time: FloatArray, courses: Mapping[str, FloatArray]) -> None:
    """Write time series of metrics, one row per instant; empty cells for NaN."""
    with written_whole(path) as temporary, open(temporary, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("time", *map(cell_text, courses)))
        columns = (
            ["" if value != value else value for value in series.tolist()] for series in (time, *courses.values())
        )
        writer.writerows(zip(*columns, strict=True))


def _refuse_doubles(path: Path, lines: list[int], place: IntArray) -> None:
    """Refuse two rows of an entity at one instant."""
    order = np.argsort(place, kind="stable")
    double = np.flatnonzero(np.diff(place[order]) == 0)
    if len(double):
        first, second = order[double[0]], order[double[0] + 1]
        raise InputError(
            f"{path}, line {lines[second]}: the entity already has a row of this time in line {lines[first]}; "
            "remove one of them."
        )


def _touched(path: Path, line: int, text: str, names: set[str]) -> list[str]:
    """Return the entities in the column ``collision``."""
    names_touched = [part.strip() for part in text.split(";") if part.strip()]
    for name in names_touched:
        if name not in names:
            raise InputError(f"{path}, line {line}: collision names '{name}'; {suggestion(name, names)}")
    return names_touched


def _number(path: Path, line: int, row: dict[str, str | None], column: str) -> float:
    text = (row[column] or "").strip()
    if text == "":
        return float("nan")
    try:
        return float(text)
    except ValueError:
        raise InputError(f"{path}, line {line}: {column} is '{text}', which is not a number.") from None
