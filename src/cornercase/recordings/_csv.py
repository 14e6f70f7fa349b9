"""Recordings and metric time series as CSV."""

from __future__ import annotations

import csv
import io
from array import array
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from cornercase._common.errors import InputError, suggest_name
from cornercase._common.io.files import atomic_write, read_file
from cornercase._common.text.sanitize import escape_csv_cell, unescape_csv_cell
from cornercase._common.typing import FloatArray, IntArray
from cornercase.recordings._from_samples import (
    require_loadable_size,
    require_valid_box,
    require_valid_motion,
    require_valid_times,
)
from cornercase.recordings._recording import BOX_ARRAYS, CSV_COLUMNS, MOTION_ARRAYS, Collision, Recording


def read_recording_csv(path: Path) -> Recording:
    """Read a CSV table with one row per entity and instant, and at least the columns `CSV_COLUMNS`."""
    rows = _CsvColumns()
    for line, row in _iter_csv_rows(path):
        rows.add_row(path, line, row)
    if not rows.lines:
        raise InputError(f"{path}: has a header but no rows.")
    numbers = np.frombuffer(rows.numbers, dtype=np.float64).reshape(len(rows.lines), -1)
    names, entity = tuple(rows.object_types), np.frombuffer(rows.entities, dtype=np.int64)
    if not np.isfinite(numbers[:, 0]).all():
        raise InputError(f"{path}: every row needs a finite time.")
    require_valid_times(path, numbers[:, 0])
    time, instant = np.unique(numbers[:, 0], return_inverse=True)
    require_loadable_size(path, len(names), len(time))
    _refuse_duplicate_rows(path, rows.lines, entity * len(time) + instant)
    require_valid_motion(path, numbers[:, 1 : 1 + len(MOTION_ARRAYS)].T)
    motion = np.full((len(MOTION_ARRAYS), len(names), len(time)), np.nan)
    motion[:, entity, instant] = numbers[:, 1 : 1 + len(MOTION_ARRAYS)].T
    _, first_rows = np.unique(entity, return_index=True)
    box = numbers[first_rows, 1 + len(MOTION_ARRAYS) :].T
    if not (np.isfinite(box).all() and (box[:2] >= 0).all()):
        raise InputError(
            f"{path}: length, width and center_x must be finite for every entity, and length and width not negative."
        )
    for name, values in zip(names, box.T.tolist(), strict=True):
        require_valid_box(path, name, *values)
    x, y, heading, speed, acceleration = motion
    length, width, center_x = box
    entities = set(names)
    collisions = [
        Collision(float(numbers[i, 0]), (names[entity[i]], partner))
        for i, text in rows.collision_cells.items()
        for partner in _parse_collision_cell(path, rows.lines[i], text, entities)
    ]
    return Recording(
        time=time,
        names=names,
        object_types=tuple(rows.object_types.values()),
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


class _CsvColumns:
    """Content of the rows of a CSV recording, in little memory: numbers in one array, and each distinct text once."""

    def __init__(self) -> None:
        self.lines: list[int] = []
        self.numbers, self.entities = array("d"), array("q")
        self.object_types: dict[str, str] = {}
        self.collision_cells: dict[int, str] = {}
        self._index: dict[str, int] = {}

    def add_row(self, path: Path, line: int, row: dict[str, str | None]) -> None:
        if None in row or any(row[column] is None for column in CSV_COLUMNS):
            raise InputError(f"{path}, line {line}: has too many or too few fields.")
        name = unescape_csv_cell(row["entity"] or "")
        if touched := row.get("collision"):
            self.collision_cells[len(self.lines)] = unescape_csv_cell(touched)
        self.lines.append(line)
        self.entities.append(self._index.setdefault(name, len(self._index)))
        self.object_types.setdefault(name, unescape_csv_cell(row["kind"] or ""))
        self.numbers.extend(
            _parse_float_cell(path, line, row, column) for column in ("time", *MOTION_ARRAYS, *BOX_ARRAYS)
        )


def _iter_csv_rows(path: Path) -> Iterator[tuple[int, dict[str, str | None]]]:
    """Yield the line number of each row, and its cells by column name."""
    try:
        reader = csv.DictReader(io.StringIO(read_file(path).decode("utf-8-sig"), newline=""))
        missing = [column for column in CSV_COLUMNS if column not in (reader.fieldnames or ())]
        if missing:
            raise InputError(
                f"{path}: the header lacks {', '.join(missing)}; a recording has the columns {', '.join(CSV_COLUMNS)}."
            )
        for row in reader:
            yield reader.line_num, row
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: is not a CSV table in UTF-8 ({error}).") from error


def write_courses(path: Path | str, time: FloatArray, courses: Mapping[str, FloatArray]) -> None:
    """Write time series of metrics as CSV, with one row per instant; cells for NaN are empty."""
    with atomic_write(path) as temporary, open(temporary, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("time", *map(escape_csv_cell, courses)))
        columns = (
            ["" if value != value else value for value in series.tolist()] for series in (time, *courses.values())
        )
        writer.writerows(zip(*columns, strict=True))


def _refuse_duplicate_rows(path: Path, lines: list[int], keys: IntArray) -> None:
    """Refuse files with two rows for the same entity and instant."""
    order = np.argsort(keys, kind="stable")
    double = np.flatnonzero(np.diff(keys[order]) == 0)
    if len(double):
        first, second = order[double[0]], order[double[0] + 1]
        raise InputError(
            f"{path}, line {lines[second]}: the entity already has a row for this time, in line {lines[first]}; "
            "remove one of these rows."
        )


def _parse_collision_cell(path: Path, line: int, text: str, names: set[str]) -> list[str]:
    """Return the names of the entities in a cell of the column ``collision``."""
    names_touched = [
        part if part in names else part.strip() for part in text.split(";") if part in names or part.strip()
    ]
    for name in names_touched:
        if name not in names:
            raise InputError(
                f"{path}, line {line}: the column collision names the unknown entity '{name}';"
                f" {suggest_name(name, names)}"
            )
    return names_touched


def _parse_float_cell(path: Path, line: int, row: dict[str, str | None], column: str) -> float:
    text = (row[column] or "").strip()
    if text == "":
        return float("nan")
    try:
        return float(text)
    except ValueError:
        raise InputError(f"{path}, line {line}: {column} is '{text}', which is not a number.") from None
