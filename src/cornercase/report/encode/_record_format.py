"""Binary format of recordings in a page: compressed blocks that the browser unpacks when they are needed."""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping
from typing import Final

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.recordings import Recording

# Resolution of each array in its unit: finer than a pixel of any drawing.
_RESOLUTIONS: Final = {"time": 1e-4, "x": 1e-3, "y": 1e-3, "heading": 1e-4, "speed": 1e-3, "acceleration": 1e-3}
_COURSE_RESOLUTION: Final = 1e-4
# Largest number that is written; larger values would be drawn at the end of the axis anyway.
_MAX_NUMBER: Final = 2**29


def encode_recording(scenario_id: int, recording: Recording, courses: Mapping[str, FloatArray]) -> bytes:
    """Encode a recording and its metric courses as one uncompressed record for the page.

    A record has three parts: the length of the head (uint32), the head (JSON), and the arrays. ``fields`` in the head
    lists name, number of rows and step of each array. An array begins with one byte per row and instant, 1 if there is
    a value. Then follow, row by row, the second differences in units of the step, as int32. All numbers are
    little-endian.
    """
    # Coordinates may be those of a national grid, millions of metres from its origin.
    origin = {name: _first_finite_rounded(getattr(recording, name)) for name in ("x", "y")}
    rows: list[FloatArray] = [recording.time]
    fields = [("time", 1, _RESOLUTIONS["time"])]
    for name in ("x", "y", "heading", "speed", "acceleration"):
        values = getattr(recording, name) - origin.get(name, 0.0)
        rows += list(values)
        fields.append((name, len(values), _RESOLUTIONS[name]))
    for name, course in courses.items():
        rows.append(course)
        fields.append((f"course {name}", 1, _COURSE_RESOLUTION))
    head = {
        "id": scenario_id,
        "instants": len(recording.time),
        "origin": origin,
        "names": recording.names,
        "kinds": recording.object_types,
        "length": recording.length.tolist(),
        "width": recording.width.tolist(),
        "center_x": recording.center_x.tolist(),
        "collisions": [[hit.time, *map(recording.entity_index, hit.entities)] for hit in recording.collisions],
        "fields": fields,
    }
    steps = np.concatenate([np.full(count, step) for _, count, step in fields])
    values = np.vstack(rows)
    present = np.isfinite(values)
    whole = np.clip(np.rint(np.where(present, values, 0.0) / steps[:, None]), -_MAX_NUMBER, _MAX_NUMBER).astype("<i4")
    second_differences = np.diff(np.diff(whole, axis=1, prepend=0), axis=1, prepend=0).astype("<i4")
    text = json.dumps(head, separators=(",", ":")).encode()
    return b"".join(
        (len(text).to_bytes(4, "little"), text, present.astype(np.uint8).tobytes(), second_differences.tobytes())
    )


def _first_finite_rounded(values: FloatArray) -> float:
    finite = values[np.isfinite(values)]
    return float(np.rint(finite[0])) if len(finite) else 0.0


def compress_records(records: list[bytes]) -> tuple[bytes, list[int]]:
    """Compress several records together with zlib.

    Return the compressed block, and the offset of each record in the uncompressed block.
    """
    starts = np.cumsum([0, *map(len, records)])[:-1].tolist()
    # Level 9 takes three times as long and saves almost nothing.
    return zlib.compress(b"".join(records), 6), starts
