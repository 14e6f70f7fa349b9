"""Arrays of an analysis in the file of a study: in pieces, as SQLite takes no value of more than 1e9 bytes."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from cornercase.study.codec import pack_arrays, unpack_arrays
from cornercase.study.damage import require
from cornercase.study.seals import put

_Rows = Callable[..., list[Any]]

DISTANCES: Final = "distances"
"""The array between all pairs, of which the upper half is stored."""

# Bytes of a piece before it is packed: small beside the whole, so that little is in memory twice.
_PIECE: Final = 1 << 25
# Bytes of an array that is not one of all pairs.
_LARGEST_OTHERS: Final = 1 << 26
# Rows that are mirrored at once, which keeps both in the processor's cache.
_BLOCK: Final = 256


def write_arrays(connection: sqlite3.Connection, analysis: str, arrays: Mapping[str, npt.ArrayLike]) -> None:
    """Store arrays of an analysis, within a transaction.

    Parameters
    ----------
    connection : sqlite3.Connection
    analysis : str
        Its name.
    arrays : mapping of str to array_like
        Those that are called ``"distances"`` are square and symmetric, with zeros on the diagonal.
    """
    put(connection, "arrays", packed_pieces(connection, analysis, arrays))


def packed_pieces(
    connection: sqlite3.Connection, analysis: str, arrays: Mapping[str, npt.ArrayLike]
) -> Iterator[tuple[str, str, int, bytes]]:
    """Cut arrays of an analysis into pieces; as `write_arrays`.

    Parameters
    ----------
    connection : sqlite3.Connection
    analysis : str
    arrays : mapping of str to array_like

    Yields
    ------
    tuple of (str, str, int, bytes)
        Analysis, name of the array, number of the piece from 0 on, and archive.
    """
    # What is packed may be a little longer than what is not.
    most = min(_PIECE, connection.getlimit(sqlite3.SQLITE_LIMIT_LENGTH) // 2)
    for name, array in arrays.items():
        cut = _halved if name == DISTANCES else _cut
        for k, one in enumerate(cut(np.asarray(array), most)):
            yield analysis, name, k, pack_arrays({name: one})


def _cut(array: npt.NDArray[Any], most: int) -> Iterator[npt.NDArray[Any]]:
    """Rows of an array, as many at a time as `most` bytes hold."""
    if array.ndim == 0 or array.nbytes <= most:
        yield array
        return
    count = max(1, most // (array.nbytes // len(array)))
    for first in range(0, len(array), count):
        yield array[first : first + count]


def _halved(matrix: npt.NDArray[Any], most: int) -> Iterator[npt.NDArray[Any]]:
    """What lies right of the diagonal, row by row, as many rows at a time as `most` bytes hold."""
    rows: list[npt.NDArray[Any]] = []
    size = 0
    for i in range(len(matrix)):
        row = matrix[i, i + 1 :]
        if rows and size + row.nbytes > most:
            yield np.concatenate(rows)
            rows, size = [], 0
        rows.append(row)
        size += row.nbytes
    yield np.concatenate(rows) if rows else np.zeros(0, matrix.dtype)


def read_arrays(rows: _Rows, analysis: str, names: list[str], scenarios: int) -> dict[str, npt.NDArray[Any]]:
    """Read arrays of an analysis; within `damage_told`.

    Parameters
    ----------
    rows : callable
        Reads rows of a table, as `cornercase.study.database.Database.rows`.
    analysis : str
        Its name.
    names : list of str
        Which arrays.
    scenarios : int
        Number of scenarios in the study; a file may not claim distances between more.

    Returns
    -------
    dict of str to ndarray, of the shapes that were stored

    Raises
    ------
    InputError
        An array cannot be read.
    ValueError
        The pieces do not belong together.
    """
    return {
        name: _square(rows, analysis, scenarios) if name == DISTANCES else _joined(list(_pieces(rows, analysis, name)))
        for name in names
    }


def _pieces(rows: _Rows, analysis: str, name: str) -> Iterator[npt.NDArray[Any]]:
    """Pieces of an array one after the other, as all together may be large."""
    numbers = [part for _, _, part in rows("arrays", "analysis = ? AND name = ?", analysis, name)]
    require(numbers == list(range(len(numbers))), f"pieces of {name} are missing")
    for part in numbers:
        ((*_, data),) = rows("arrays", "analysis = ? AND name = ? AND part = ?", analysis, name, part, blob=True)
        yield unpack_arrays(data, _LARGEST_OTHERS)[name]


def _joined(pieces: list[npt.NDArray[Any]]) -> npt.NDArray[Any]:
    return pieces[0] if len(pieces) == 1 else np.concatenate(pieces)


def _square(rows: _Rows, analysis: str, scenarios: int) -> npt.NDArray[Any]:
    n = len(_joined(list(_pieces(rows, analysis, "ids"))))
    require(n <= scenarios, f"distances between {n} scenarios")
    matrix: npt.NDArray[Any] | None = None
    row = 0
    for piece in _pieces(rows, analysis, DISTANCES):
        require(piece.ndim == 1 and piece.dtype.kind == "f", "distances that are no numbers")
        if matrix is None:
            matrix = np.zeros((n, n), piece.dtype)
        at = 0
        while at < len(piece) and row < n:
            count = n - 1 - row
            matrix[row, row + 1 :] = piece[at : at + count]
            at, row = at + count, row + 1
        require(at == len(piece), "distances of other scenarios")
    require(matrix is not None and row >= n - 1, "distances that are missing")
    assert matrix is not None
    _mirror(matrix)
    return matrix


def _mirror(matrix: npt.NDArray[Any]) -> None:
    """Fill what lies below the diagonal with what lies above it, in place."""
    for first in range(0, len(matrix), _BLOCK):
        last = first + _BLOCK
        middle = matrix[first:last, first:last]
        middle += middle.T
        matrix[last:, first:last] = matrix[first:last, last:].T
