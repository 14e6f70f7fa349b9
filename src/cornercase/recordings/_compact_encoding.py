"""Recordings encoded in few bytes for an HTML page, rounded to what drawings can show; `web/recordings.js` decodes."""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping
from typing import Final

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.recordings._recording import Recording

# Resolution of each array in its unit: finer than a pixel of any drawing.
_RESOLUTIONS: Final = {"time": 1e-4, "x": 1e-3, "y": 1e-3, "heading": 1e-4, "speed": 1e-3, "acceleration": 1e-3}
_COURSE_RESOLUTION: Final = 1e-4
# Largest number that is written; larger values would be drawn at the end of the axis anyway.
_MAX_NUMBER: Final = 2**29
# From 1 to 9; 6 takes half as long again and saves almost nothing.
_COMPRESSION_LEVEL: Final = 4


def encode_rounded(recording: Recording, courses: Mapping[str, FloatArray]) -> bytes:
    """Encode a recording and its courses (time series of metrics), rounded and compressed by zlib.

    A row is the time series of a metric, of one value of one entity, or of the time itself. The unpacked bytes are, in
    this order:

    - the length in bytes of the head (uint32), and the head, a JSON object with names and sizes,
    - if ``gaps`` in the head is true, one byte per row and instant: 1 if there is a value,
    - the first value of each row,
    - the first difference of each row, unless there is only one instant,
    - the second differences, row by row.

    ``fields`` in the head lists for each array its name, its number of rows, its resolution, and the number of bytes of
    a second difference. Numbers are little-endian integers in units of the resolution. First values and first
    differences have 4 bytes.
    """
    # Coordinates may be those of a national grid, millions of metres from its origin.
    origin = {name: _first_finite_rounded(getattr(recording, name)) for name in ("x", "y")}
    arrays = {
        "time": recording.time[None],
        "x": recording.x - origin["x"],
        "y": recording.y - origin["y"],
        "heading": recording.heading,
        "speed": recording.speed,
        "acceleration": recording.acceleration,
    } | {f"course {name}": course[None] for name, course in courses.items()}
    counts = [len(values) for values in arrays.values()]
    steps = [_RESOLUTIONS.get(name, _COURSE_RESOLUTION) for name in arrays]
    values = np.concatenate(list(arrays.values())) / np.repeat(steps, counts)[:, None]
    present = np.isfinite(values)
    has_gaps = not bool(present.all())
    if has_gaps:
        values[~present] = 0.0
    numbers = np.rint(values)
    if np.abs(numbers).max() > _MAX_NUMBER:
        numbers = numbers.clip(-_MAX_NUMBER, _MAX_NUMBER)
    numbers = numbers.astype("<i4")
    differences = np.diff(numbers, axis=1)
    changes = np.diff(differences, axis=1)
    ends = np.cumsum(counts).tolist()
    # The bits of a number, or of its complement if it is negative.
    largest = np.maximum.reduceat((changes ^ (changes >> 31)).max(axis=1, initial=0), [0, *ends[:-1]])
    fields, packed = [], []
    for name, count, step, end, value in zip(arrays, counts, steps, ends, largest.tolist(), strict=True):
        width = next(width for width in (1, 2, 4) if value < 1 << (8 * width - 1))
        fields.append((name, count, step, width))
        packed.append(changes[end - count : end].astype(f"<i{width}").tobytes())
    head = {
        "instants": len(recording.time),
        "origin": origin,
        "names": recording.names,
        "kinds": recording.object_types,
        "length": recording.length.tolist(),
        "width": recording.width.tolist(),
        "center_x": recording.center_x.tolist(),
        "collisions": [[hit.time, *map(recording.entity_index, hit.entities)] for hit in recording.collisions],
        "fields": fields,
        "gaps": has_gaps,
    }
    text = json.dumps(head, separators=(",", ":")).encode()
    parts = [len(text).to_bytes(4, "little"), text, present.tobytes() if has_gaps else b""]
    parts += [numbers[:, :1].tobytes(), differences[:, :1].tobytes(), *packed]
    return zlib.compress(b"".join(parts), _COMPRESSION_LEVEL)


def _first_finite_rounded(values: FloatArray) -> float:
    finite = values[np.isfinite(values)]
    return float(np.rint(finite[0])) if len(finite) else 0.0
