"""Recordings as a page holds them: compressed blocks, of which a browser unpacks those that it shows."""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping
from typing import Final

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.recordings import Recording

# What the last digit of each array stands for, in its unit: finer than a pixel of any drawing.
_STEPS: Final = {"time": 1e-4, "x": 1e-3, "y": 1e-3, "heading": 1e-4, "speed": 1e-3, "acceleration": 1e-3}
_COURSE_STEP: Final = 1e-4
# Greatest number that is written; what lies beyond is drawn at the end of every axis anyway.
_MOST: Final = 2**29


def pack_record(scenario: int, recording: Recording, courses: Mapping[str, FloatArray]) -> bytes:
    """Write a recording and its courses for the page.

    A record is the length of its head as an unsigned number of 32 bits, the head as JSON, and the rows of its arrays
    of which ``fields`` of the head names those of each array, how many rows it has, and what one stands for: first for
    each row a byte for each instant, 1 where there is a value; then for each row second differences of whole numbers of
    32 bits. All numbers are little-endian.

    Parameters
    ----------
    scenario : int
        Its id.
    recording : Recording
        Of A entities at T instants.
    courses : mapping of str to ndarray of float64, shape (T,)
        By metric.

    Returns
    -------
    bytes
        The record, not compressed.
    """
    # Places may be those of a country's grid, millions of metres from its origin.
    origin = {name: _first(getattr(recording, name)) for name in ("x", "y")}
    rows: list[FloatArray] = [recording.time]
    fields = [("time", 1, _STEPS["time"])]
    for name in ("x", "y", "heading", "speed", "acceleration"):
        values = getattr(recording, name) - origin.get(name, 0.0)
        rows += list(values)
        fields.append((name, len(values), _STEPS[name]))
    for name, course in courses.items():
        rows.append(course)
        fields.append((f"course {name}", 1, _COURSE_STEP))
    head = {
        "id": scenario,
        "instants": len(recording.time),
        "origin": origin,
        "names": recording.names,
        "kinds": recording.kinds,
        "length": recording.length.tolist(),
        "width": recording.width.tolist(),
        "center_x": recording.center_x.tolist(),
        "collisions": [[hit.time, *map(recording.index, hit.entities)] for hit in recording.collisions],
        "fields": fields,
    }
    steps = np.concatenate([np.full(count, step) for _, count, step in fields])
    values = np.vstack(rows)
    there = np.isfinite(values)
    whole = np.clip(np.rint(np.where(there, values, 0.0) / steps[:, None]), -_MOST, _MOST).astype("<i4")
    twice = np.diff(np.diff(whole, axis=1, prepend=0), axis=1, prepend=0).astype("<i4")
    text = json.dumps(head, separators=(",", ":")).encode()
    return b"".join((len(text).to_bytes(4, "little"), text, there.astype(np.uint8).tobytes(), twice.tobytes()))


def _first(values: FloatArray) -> float:
    there = values[np.isfinite(values)]
    return float(np.rint(there[0])) if len(there) else 0.0


def pack_block(records: list[bytes]) -> tuple[bytes, list[int]]:
    """Compress records together.

    Parameters
    ----------
    records : list of bytes, length r
        As of `pack_record`.

    Returns
    -------
    block : bytes
        In zlib's format.
    offsets : list of int, length r
        Where each record begins in what the block unpacks to.
    """
    starts = np.cumsum([0, *map(len, records)])[:-1].tolist()
    # Level 9 takes three times as long, and saves hardly anything.
    return zlib.compress(b"".join(records), 6), starts
