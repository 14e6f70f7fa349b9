"""Arrays of an analysis in the study file, split into pieces because SQLite stores at most 1e9 bytes per value."""

from __future__ import annotations

import sqlite3
import zlib
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from cornercase.study._checksums import insert_rows
from cornercase.study._codec import pack_arrays, unpack_arrays
from cornercase.study._damage import require_condition

_RowReader = Callable[..., list[Any]]

DISTANCES: Final = "distances"
"""Name of the matrix of all pairwise distances; only its upper triangle is stored."""

# Bytes of a piece before packing; pieces are small, so that little memory is used twice.
_PIECE_BYTES: Final = 1 << 25
# Limit of bytes of a piece after unpacking.
_MAX_ARRAY_BYTES: Final = 1 << 26
# Larger arrays are compressed only if a sample becomes shorter by a tenth; a sample of coordinates does not.
_ALWAYS_COMPRESSED_BYTES, _SAMPLE_BYTES, _WORTHWHILE_SHARE = 1 << 16, 1 << 14, 0.9
# Rows mirrored at a time, so that both blocks stay in the processor's cache.
_MIRROR_BLOCK_ROWS: Final = 256


def write_arrays(connection: sqlite3.Connection, analysis: str, arrays: Mapping[str, npt.ArrayLike]) -> None:
    """Store the arrays of an analysis, a mapping from name to array; call this function within a transaction.

    An array named ``"distances"`` has to be square and symmetric with a zero diagonal; only its upper half is stored.
    """
    insert_rows(connection, "arrays", pack_array_pieces(connection, analysis, arrays))


def pack_array_pieces(
    connection: sqlite3.Connection, analysis: str, arrays: Mapping[str, npt.ArrayLike]
) -> Iterator[tuple[str, str, int, bytes]]:
    """Split the arrays of an analysis into pieces, and yield a database row for each piece.

    A row is (analysis, array name, piece number from 0, bytes in NumPy's `.npz` format).
    """
    # Packing may make a piece a little longer.
    max_bytes = min(_PIECE_BYTES, connection.getlimit(sqlite3.SQLITE_LIMIT_LENGTH) // 2)
    for name, array in arrays.items():
        split = _split_upper_triangle if name == DISTANCES else _split_rows
        for number, piece in enumerate(split(np.asarray(array), max_bytes)):
            yield analysis, name, number, pack_arrays({name: piece}, compress=_is_compressible(piece))


def _is_compressible(array: npt.NDArray[Any]) -> bool:
    """Return whether compressing an array saves enough bytes to be worth the time."""
    if array.nbytes <= _ALWAYS_COMPRESSED_BYTES:
        return True
    sample = array.ravel()[: _SAMPLE_BYTES // array.itemsize].tobytes()
    return len(zlib.compress(sample, 1)) < _WORTHWHILE_SHARE * len(sample)


def _split_rows(array: npt.NDArray[Any], max_bytes: int) -> Iterator[npt.NDArray[Any]]:
    """Yield slices of consecutive rows of an array; a slice of more than one row has at most `max_bytes`."""
    if array.ndim == 0 or array.nbytes <= max_bytes:
        yield array
        return
    count = max(1, max_bytes // (array.nbytes // len(array)))
    for first in range(0, len(array), count):
        yield array[first : first + count]


def _split_upper_triangle(matrix: npt.NDArray[Any], max_bytes: int) -> Iterator[npt.NDArray[Any]]:
    """Yield the entries right of the diagonal of a matrix, row by row, in pieces of at most `max_bytes`."""
    rows: list[npt.NDArray[Any]] = []
    size = 0
    for i in range(len(matrix)):
        row = matrix[i, i + 1 :]
        if rows and size + row.nbytes > max_bytes:
            yield np.concatenate(rows)
            rows, size = [], 0
        rows.append(row)
        size += row.nbytes
    yield np.concatenate(rows) if rows else np.zeros(0, matrix.dtype)


def read_arrays(
    read_rows: _RowReader, analysis: str, names: list[str], n_scenarios: int
) -> dict[str, npt.NDArray[Any]]:
    """Read the arrays `names` of an analysis; call this function within `reraise_read_errors`.

    `n_scenarios` limits the size of the distance matrix, since a damaged file could demand a huge matrix.
    """
    return {
        name: _read_distance_matrix(read_rows, analysis, n_scenarios)
        if name == DISTANCES
        else _concatenate_pieces(list(_read_pieces(read_rows, analysis, name)))
        for name in names
    }


def _read_pieces(read_rows: _RowReader, analysis: str, name: str) -> Iterator[npt.NDArray[Any]]:
    """Yield the pieces of an array one by one, to save memory."""
    numbers = [part for _, _, part in read_rows("arrays", "analysis = ? AND name = ?", analysis, name)]
    require_condition(numbers == list(range(len(numbers))), f"pieces of {name} are missing")
    for part in numbers:
        ((*_, data),) = read_rows(
            "arrays", "analysis = ? AND name = ? AND part = ?", analysis, name, part, with_blob=True
        )
        yield unpack_arrays(data, _MAX_ARRAY_BYTES)[name]


def _concatenate_pieces(pieces: list[npt.NDArray[Any]]) -> npt.NDArray[Any]:
    return pieces[0] if len(pieces) == 1 else np.concatenate(pieces)


def _read_distance_matrix(read_rows: _RowReader, analysis: str, n_scenarios: int) -> npt.NDArray[Any]:
    """Rebuild the symmetric distance matrix from the pieces of its upper triangle."""
    n = len(_concatenate_pieces(list(_read_pieces(read_rows, analysis, "ids"))))
    require_condition(n <= n_scenarios, f"there are distances between {n} scenarios, but only {n_scenarios} scenarios")
    matrix: npt.NDArray[Any] | None = None
    row = 0
    for piece in _read_pieces(read_rows, analysis, DISTANCES):
        require_condition(piece.ndim == 1 and piece.dtype.kind == "f", "its distances are not numbers")
        if matrix is None:
            matrix = np.zeros((n, n), piece.dtype)
        offset = 0
        while offset < len(piece) and row < n:
            count = n - 1 - row
            matrix[row, row + 1 :] = piece[offset : offset + count]
            offset, row = offset + count, row + 1
        require_condition(offset == len(piece), "its distances do not fit the number of scenarios")
    require_condition(matrix is not None and row >= n - 1, "some of its distances are missing")
    assert matrix is not None
    _mirror_upper_triangle(matrix)
    return matrix


def _mirror_upper_triangle(matrix: npt.NDArray[Any]) -> None:
    """Copy the upper triangle into the lower one, in place."""
    for first in range(0, len(matrix), _MIRROR_BLOCK_ROWS):
        last = first + _MIRROR_BLOCK_ROWS
        middle = matrix[first:last, first:last]
        middle += middle.T
        matrix[last:, first:last] = matrix[first:last, last:].T
