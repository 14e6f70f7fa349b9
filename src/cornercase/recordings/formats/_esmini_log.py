"""Log files that esmini writes with ``--csv_logger``."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterator
from pathlib import Path

from cornercase._common.errors import InputError
from cornercase._common.io.files import read_file
from cornercase.recordings._from_samples import EntitySamples, box_center_from_point, recording_from_samples
from cornercase.recordings._recording import Recording

ESMINI_LOG_START = "esmini GIT"
_ENTITY_COLUMN = re.compile(r"#(\d{1,9}) ")
_REQUIRED_COLUMNS = (
    "Entity_Name", "Current_Speed", "bb_x", "bb_y", "bb_length", "bb_width", "World_Position_X", "World_Position_Y",
    "World_Heading_Angle",
)  # fmt: skip


def read_esmini_log(path: Path | str) -> Recording:
    """Read a log of esmini; all entities become cars, since the log does not contain their types."""
    path = Path(path)
    try:
        lines = read_file(path).decode("utf-8").splitlines()
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: cannot be read ({error}).") from error
    header_line = next((k for k, line in enumerate(lines) if line.startswith("Index [-]")), None)
    if header_line is None:
        raise InputError(f"{path}: has no header beginning with 'Index [-]'; write it with esmini --csv_logger.")
    header = [name.partition("[")[0].strip() for name in lines[header_line].split(",")]
    columns = {name: k for k, name in enumerate(header) if name}
    numbers = sorted({int(match[1]) for name in columns if (match := _ENTITY_COLUMN.match(name))})
    for number in numbers:
        for name in _REQUIRED_COLUMNS:
            if f"#{number} {name}" not in columns:
                raise InputError(f"{path}: the header lacks '#{number} {name}'.")
    tracks: dict[str, EntitySamples] = {}
    for k, row in enumerate(_iter_rows(path, lines[header_line + 1 :]), header_line + 2):
        if not row:
            continue
        # Complete lines end with a comma.
        if len(row) < 3 or row[-1].strip():
            raise InputError(f"{path}, line {k}: is cut off; leave it out or write the log again.")
        _add_samples(tracks, path, k, row, columns, numbers)
    return recording_from_samples(path, tracks)


def _iter_rows(path: Path, lines: list[str]) -> Iterator[list[str]]:
    try:
        yield from csv.reader(lines, skipinitialspace=True)
    except csv.Error as error:
        raise InputError(f"{path}: is not a CSV table ({error}).") from error


def _add_samples(
    tracks: dict[str, EntitySamples],
    path: Path,
    line: int,
    row: list[str],
    columns: dict[str, int],
    entity_numbers: list[int],
) -> None:
    for number in entity_numbers:
        name_column = columns[f"#{number} Entity_Name"]
        # Columns of deleted entities are missing at the end of the line.
        if name_column >= len(row) - 1 or not row[name_column].strip():
            continue
        try:
            time = float(row[columns["TimeStamp"]])
            speed, ahead, left, length, width, x, y, heading = (
                float(row[columns[f"#{number} {name}"]]) for name in _REQUIRED_COLUMNS[1:]
            )
        except (ValueError, IndexError, KeyError):
            raise InputError(f"{path}, line {line}: a number is missing or malformed.") from None
        name = row[name_column].strip()
        track = tracks.setdefault(name, EntitySamples("car", length, width))
        track.samples[time] = (*box_center_from_point(x, y, heading, ahead, left), heading, speed, math.nan)
