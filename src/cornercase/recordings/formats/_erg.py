"""Result files of CarMaker (ERG)."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from cornercase._common.errors import InputError
from cornercase._common.io.files import read_file
from cornercase._common.typing import FloatArray
from cornercase.recordings._box_contacts import find_collisions
from cornercase.recordings._from_samples import EntityBox, EntitySamples, recording_from_samples
from cornercase.recordings._recording import Recording

_HEADER_SIZE: Final = 16
_NUMPY_TYPES: Final = {
    "Double": "f8", "Float": "f4", "Int": "i4", "UInt": "u4", "Long": "i4", "ULong": "u4", "LongLong": "i8",
    "ULongLong": "u8", "Short": "i2", "UShort": "u2", "Char": "i1", "UChar": "u1",
}  # fmt: skip
_NAME_KEY: Final = re.compile(r"File\.At\.(\d{1,9})\.Name")
_COLLISION_COUNT: Final = re.compile(r"Sensor\.Collision\.Vhcl\.\w+\.Count")
_PADDING_TYPE: Final = re.compile(r"(\d{1,5}) Bytes")
# Largest file in bytes: an hour of a thousand quantities.
_MAX_FILE_SIZE: Final = 2_000_000_000
# CarMaker's files do not hold the size of an entity.
_DEFAULT_BOX: Final = EntityBox("car", 4.5, 1.8)


def read_erg_columns(path: Path | str) -> dict[str, npt.NDArray[Any]]:
    """Read all quantities of a CarMaker result file by name, in SI units; its ``.info`` file must be next to it."""
    path = Path(path)
    info = path.with_name(path.name + ".info")
    data, text = read_file(path, _MAX_FILE_SIZE), read_file(info).decode("utf-8", "replace")
    if len(data) < _HEADER_SIZE or data[:8] != b"CM-ERG\0\0":
        raise InputError(f"{path}: is not a result file of CarMaker, which begins with CM-ERG.")
    facts = dict(_iter_info_entries(text))
    names = {int(match[1]): name for key, name in facts.items() if (match := _NAME_KEY.fullmatch(key))}
    end = ">" if facts.get("File.ByteOrder") == "BigEndian" else "<"
    fields: list[tuple[str, str]] = []
    for number, name in sorted(names.items()):
        kind = facts.get(f"File.At.{number}.Type", "")
        if kind in _NUMPY_TYPES:
            fields.append((name, end + _NUMPY_TYPES[kind]))
        elif padding := _PADDING_TYPE.fullmatch(kind):
            fields.append((name, f"V{padding[1]}"))
        else:
            raise InputError(f"{info}: '{name}' has the type '{kind}', which is not known.")
    if not fields:
        raise InputError(f"{info}: names no quantity.")
    if not all(names.values()):
        raise InputError(f"{info}: has a quantity without a name.")
    if len(set(names.values())) < len(names):
        raise InputError(f"{info}: names a quantity twice.")
    record = np.dtype(fields)
    if not record.itemsize:
        raise InputError(f"{info}: all quantities have a size of 0 bytes.")
    size = int.from_bytes(data[10:12], "little" if end == "<" else "big")
    if size != record.itemsize:
        raise InputError(
            f"{path}: has records of {size} bytes, but {info.name} describes records of {record.itemsize} bytes."
        )
    count, rest = divmod(len(data) - _HEADER_SIZE, record.itemsize)
    if rest:
        raise InputError(f"{path}: is cut in the middle of record {count + 1}; run the TestRun again.")
    table = np.frombuffer(data, record, count, _HEADER_SIZE)
    return {name: table[name] for name, kind in fields if not kind.startswith("V")}


def _iter_info_entries(text: str) -> Iterator[tuple[str, str]]:
    """Yield the keys and values of an ``.info`` file of CarMaker."""
    for line in text.splitlines():
        key, sign, value = line.partition("=")
        if sign:
            yield key.strip(), value.strip()


@np.errstate(all="ignore")
def read_erg(path: Path | str, entity_boxes: Mapping[str, EntityBox] | None = None) -> Recording:
    """Read the motion of ``Ego`` and of traffic objects (``T00``, ``T01``, …) from a CarMaker result file.

    A position in the file is the middle of the vehicle's rear end, as in CarMaker's vehicle frame, unless the entity's
    box has `ahead`. Result files contain no boxes: entities that are not in `entity_boxes` are cars of 4.5 m x 1.8 m.
    Two entities collide when their boxes touch, or when the ego's collision sensor counts a contact and another box is
    near.
    """
    path = Path(path)
    columns = read_erg_columns(path)
    needed = ("Time", "Car.tx", "Car.ty", "Car.Yaw", "Car.v")
    missing = [name for name in needed if name not in columns]
    if missing:
        raise InputError(f"{path}: has no {', '.join(missing)}; add it to the quantities that CarMaker stores.")
    time = columns["Time"].astype(np.float64)
    boxes = entity_boxes or {}
    tracks = {
        "Ego": _create_entity_samples(boxes.get("Ego", _DEFAULT_BOX), time, *(columns[name] for name in needed[1:]))
    }
    for name in sorted(match.group(1) for key in columns if (match := re.fullmatch(r"Traffic\.(T\d+)\.tx", key))):
        x, y = columns[f"Traffic.{name}.tx"], columns.get(f"Traffic.{name}.ty")
        if y is None:
            raise InputError(f"{path}: has Traffic.{name}.tx, but no Traffic.{name}.ty.")
        along, across = (columns.get(f"Traffic.{name}.v_0.{axis}") for axis in "xy")
        heading, speed = columns.get(f"Traffic.{name}.rz"), columns.get(f"Traffic.{name}.LongVel")
        # Overflows are refused when the recording is created.
        if heading is None:
            heading = _direction_of_motion(time, x, y) if along is None or across is None else np.arctan2(across, along)
        if speed is None:
            speed = np.full(len(time), np.nan) if along is None or across is None else np.hypot(along, across)
        tracks[name] = _create_entity_samples(boxes.get(name, _DEFAULT_BOX), time, x, y, heading, speed)
    counts = [column for name, column in columns.items() if _COLLISION_COUNT.fullmatch(name)]
    hits = time[1:][np.sum([np.diff(count.astype(np.float64)) > 0 for count in counts], axis=0) > 0] if counts else []
    recording = recording_from_samples(path, tracks)
    return replace(recording, collisions=find_collisions(recording, "Ego", [float(hit) for hit in hits]))


def _create_entity_samples(
    box: EntityBox, time: FloatArray, x: FloatArray, y: FloatArray, heading: FloatArray, speed: FloatArray
) -> EntitySamples:
    track = EntitySamples(box.object_type, box.length, box.width)
    ahead = 0.5 * box.length if box.ahead is None else box.ahead
    rows = np.stack([x + ahead * np.cos(heading), y + ahead * np.sin(heading), heading, speed], axis=1)
    for instant, row in zip(time.tolist(), rows.astype(np.float64).tolist(), strict=True):
        track.samples[instant] = (row[0], row[1], row[2], row[3], float("nan"))
    return track


def _direction_of_motion(time: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    """Return the direction of motion in rad; an entity that stands keeps its last direction."""
    if len(time) < 2:
        return np.zeros(len(time))
    dx, dy = np.gradient(x.astype(np.float64), time), np.gradient(y.astype(np.float64), time)
    moving = np.hypot(dx, dy) > 0.01
    if not moving.any():
        return np.zeros(len(time))
    last = np.maximum.accumulate(np.where(moving, np.arange(len(time)), np.flatnonzero(moving)[0]))
    return np.asarray(np.arctan2(dy, dx)[last])
