"""Messages between cornercase and an external driving program: the length in four bytes, then MessagePack."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import replace
from io import BufferedReader
from typing import Any, BinaryIO, Final

import msgpack
import numpy as np

from cornercase._common.errors import suggest_name
from cornercase._common.typing import FloatArray
from cornercase.drivers._controls import Controls, Trajectory

PROTOCOL_VERSION: Final = 1
ANSWER_COLUMNS: Final = ("acceleration", "steering", "throttle", "brake", "lane_change")
"""Columns of numbers in a program's answer to a step; each may be missing."""
_ANSWER_KEYS: Final = ("type", *ANSWER_COLUMNS, "trajectories", "failures")
_LENGTH: Final = struct.Struct("<I")
_MAX_BYTES, _SHOWN_BYTES = 2**28, 20


class ProtocolError(Exception):
    """A driving program has ended, does not answer in time, or sends an answer that the protocol does not allow."""


def write_message(stream: BinaryIO, message: Mapping[str, Any]) -> None:
    """Send a message to a program; `OSError` if the other end of the stream is closed."""
    content = msgpack.packb(message, default=_make_packable)
    stream.write(_LENGTH.pack(len(content)) + content)
    stream.flush()


def read_message(stream: BufferedReader) -> dict[str, Any] | None:
    """Receive a message; None if the stream has ended, `ProtocolError` if the bytes are not a message."""
    head = stream.read(_LENGTH.size)
    if not head:
        return None
    if len(head) == _LENGTH.size and (length := _LENGTH.unpack(head)[0]) <= _MAX_BYTES:
        content = stream.read(length)
        if len(content) < length:
            return None
        try:
            message = msgpack.unpackb(content, strict_map_key=False)
        except ValueError:
            message = None
        if isinstance(message, dict):
            return message
        head += content
    else:
        head += stream.peek()
    text = ascii(head[:_SHOWN_BYTES].decode(errors="replace"))
    raise ProtocolError(f"its output begins with {text}, which is not a message; print to stderr only")


def pack_column(values: Any) -> bytes:
    """Return numbers as bytes of little-endian doubles, row by row."""
    return np.ascontiguousarray(values, dtype="<f8").tobytes()


def read_answer(answer: Mapping[str, Any], n_rows: int) -> tuple[Controls, dict[int, str]]:
    """Return the controls in a program's answer, and the reasons of failed scenarios by row.

    Raises `ProtocolError` if the answer is invalid.
    """
    if unknown := [str(name) for name in answer if name not in _ANSWER_KEYS]:
        hint = suggest_name(unknown[0], _ANSWER_KEYS).rstrip(".?")
        raise ProtocolError(f"its answer has the unknown key '{unknown[0]}'; {hint}")
    controls = Controls.empty(n_rows)
    trajectories: dict[int, Trajectory] = {}
    for name in ANSWER_COLUMNS:
        if (content := answer.get(name)) is not None:
            getattr(controls, name)[:] = _unpack_answer_column(name, content, n_rows)
    for name in ("throttle", "brake"):
        pedal = getattr(controls, name)
        if bool(((pedal < 0.0) | (pedal > 1.0)).any()):
            raise ProtocolError(f"its {name} is {pedal[(pedal < 0.0) | (pedal > 1.0)][0]:g}; it has to be from 0 to 1")
    failures = {_check_row_index(row, n_rows): str(text) for row, text in _read_list(answer, "failures", 2)}
    for row, *columns in _read_list(answer, "trajectories", 4):
        try:
            points = (_unpack("trajectory", column) for column in columns)
            trajectories[_check_row_index(row, n_rows)] = Trajectory(*points)
        except ValueError as error:
            raise ProtocolError(f"its trajectory cannot be used: {error}") from error
    return replace(controls, trajectories=trajectories), failures


def _unpack_answer_column(name: str, content: object, n_rows: int) -> FloatArray:
    values = _unpack(name, content)
    if len(values) != n_rows:
        raise ProtocolError(f"its answer has {len(values)} values of {name} for {n_rows} scenarios")
    if name == "lane_change" and not np.isin(values, (-1.0, 0.0, 1.0)).all():
        raise ProtocolError("its lane_change is not 1 (left), -1 (right) or 0")
    return values


def _unpack(name: str, content: object) -> FloatArray:
    if not isinstance(content, bytes) or len(content) % 8:
        raise ProtocolError(f"its {name} is not binary data of 8 bytes per number")
    return np.frombuffer(content, dtype="<f8").astype(np.float64)


def _read_list(answer: Mapping[str, Any], name: str, length: int) -> list[Any]:
    rows = answer.get(name) or []
    if not isinstance(rows, list) or any(not isinstance(row, list) or len(row) != length for row in rows):
        raise ProtocolError(f"its {name} are not a list of lists of {length} items")
    return rows


def _check_row_index(row: object, n_rows: int) -> int:
    if not isinstance(row, int) or not 0 <= row < n_rows:
        raise ProtocolError(f"its answer has the row {row!r}, but the step has {n_rows} rows")
    return row


def _make_packable(value: Any) -> Any:
    """Convert a value for MessagePack: a NumPy number to a Python number, all other objects to text."""
    return value.item() if isinstance(value, np.generic) else str(value)
