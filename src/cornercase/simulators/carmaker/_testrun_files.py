"""Content of the files of a TestRun: named values that it uses, boxes, and the version of CarMaker that wrote it."""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from cornercase._common.errors import InputError
from cornercase._common.io.files import read_file
from cornercase.recordings._from_samples import EntityBox

# `$speed=50` in a value, or a script that asks for it.
_NAMED_VALUE: Final = re.compile(r"\$\{?([A-Za-z_]\w*)|\bNamedValue\s+get\s+\{?([A-Za-z_]\w*)")
_VERSION: Final = re.compile(r"CarMaker\s+(\d+(?:\.\d+)*)")
_TRAFFIC_NAME: Final = re.compile(r"Traffic\.(\d{1,4})\.Name")
# Largest TestRun and number of files that belong to it.
_MAX_FILE_SIZE, _MAX_FILES = 20_000_000, 100
# Largest file that is searched for named values, besides the TestRun; roads may be large.
_MAX_NAMED_FILE_SIZE: Final = 2_000_000
_OBJECT_TYPES: Final = {
    "Car": "car", "Truck": "truck", "Bus": "bus", "Van": "van", "Pedestrian": "pedestrian", "Bicycle": "bicycle",
    "Motorcycle": "motorbike",
}  # fmt: skip


@dataclass(frozen=True)
class TestRunFiles:
    """Content of a TestRun, and of the files in the project's ``Data`` that the TestRun names (vehicle, roads, …).

    `path`: file of the TestRun. `named_values`: names of the named values that any of the files uses. `boxes`: boxes of
    ``Ego`` and of traffic objects, if the files contain them. `version`: version of CarMaker that wrote the TestRun, or
    empty. `trailer`: name of the data set of a trailer, or empty.
    """

    path: Path
    named_values: frozenset[str] = frozenset()
    boxes: dict[str, EntityBox] = field(default_factory=dict)
    version: str = ""
    trailer: str = ""


def read_testrun_files(project: Path, testrun: str) -> TestRunFiles | None:
    """Read a TestRun and the files that it names; return None if the project does not contain the TestRun.

    For instance, IPG's example TestRuns are in CarMaker's installation, not in the project.
    """
    data = project / "Data"
    path = data / "TestRun" / testrun
    if not path.is_file():
        return None
    entries = _read_entries(path, _MAX_FILE_SIZE)
    named = _named_values(entries)
    boxes = _traffic_boxes(entries)
    vehicle = data / "Vehicle" / entries.get("Vehicle", "")
    files, seen = [*_find_referenced_files(data, entries)], {path}
    while files and len(seen) < _MAX_FILES:
        file = files.pop()
        if file in seen:
            continue
        seen.add(file)
        # Anything may be in Data; files that are too large or cannot be read are skipped.
        with suppress(InputError):
            others = _read_entries(file, _MAX_NAMED_FILE_SIZE)
            named |= _named_values(others)
            files.extend(_find_referenced_files(data, others))
            if file == vehicle:
                boxes |= _vehicle_box(others)
    version = _VERSION.search(entries.get("FileCreator", ""))
    return TestRunFiles(
        path, frozenset(named), boxes, version[1] if version else "", entries.get("Trailer", "").strip()
    )


def _read_entries(path: Path, max_size: int) -> dict[str, str]:
    """Return the values of a file of CarMaker by key.

    A value of several lines is indented, and follows a line with its key and a colon. `max_size` is in bytes.
    """
    entries, key = dict[str, str](), ""
    for line in _decode(read_file(path, max_size)).splitlines():
        if line.startswith("#") or not line.strip():
            continue
        if line[0].isspace():
            if key:
                entries[key] += f"\n{line.strip()}"
            continue
        name, sign, value = line.partition("=")
        if sign and ":" not in name:
            key = name.strip()
            entries[key] = value.strip()
        else:
            key = line.partition(":")[0].strip()
            entries[key] = ""
    return entries


def _decode(content: bytes) -> str:
    """Decode a file as UTF-8, or as Latin-1 if it is not valid UTF-8."""
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("latin-1")


def _named_values(entries: dict[str, str]) -> set[str]:
    """Return the named values that the entries use; the entry ``Description`` is free text and skipped."""
    values = (value for key, value in entries.items() if key != "Description")
    return {first or second for value in values for first, second in _NAMED_VALUE.findall(value)}


def _find_referenced_files(data: Path, entries: dict[str, str]) -> list[Path]:
    """Return the files in subfolders of ``Data`` that the values of entries name, as in ``Vehicle = DemoCar``."""
    names = {value for value in entries.values() if value and len(value) < 200 and "\n" not in value}
    files = []
    for folder in sorted(data.iterdir()):
        for name in sorted(names):
            # A value may be no path at all, and must not lead out of the project.
            with suppress(OSError, ValueError):
                file = folder / name
                if file.is_file() and file.resolve().is_relative_to(data.resolve()):
                    files.append(file)
    return files


def _vehicle_box(entries: dict[str, str]) -> dict[str, EntityBox]:
    """Return the ego's box from the outer skin of its vehicle; empty if there is none.

    The outer skin is given by a corner at the rear and the opposite corner at the front.
    """
    skin = _numbers(entries.get("Vehicle.OuterSkin", ""))
    if len(skin) != 6:
        return {}
    length, width = abs(skin[3] - skin[0]), abs(skin[4] - skin[1])
    return {"Ego": EntityBox("car", length, width, 0.5 * (skin[0] + skin[3]))} if length and width else {}


def _traffic_boxes(entries: dict[str, str]) -> dict[str, EntityBox]:
    boxes = {}
    for key, name in entries.items():
        if match := _TRAFFIC_NAME.fullmatch(key):
            prefix = f"Traffic.{match[1]}."
            size = _numbers(entries.get(f"{prefix}Basics.Dimension", ""))
            if len(size) >= 2 and size[0] > 0.0 and size[1] > 0.0:
                kind = entries.get(f"{prefix}ObjectClass", "Car")
                boxes[name] = EntityBox(_OBJECT_TYPES.get(kind, "misc"), size[0], size[1], 0.5 * size[0])
    return boxes


def _numbers(text: str) -> list[float]:
    """Return the numbers in a value; an empty list if the value contains anything else."""
    with suppress(ValueError):
        return [float(word) for word in text.split()]
    return []
