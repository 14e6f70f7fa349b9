"""A distance matrix that does not fit in memory: written to a file square by square (block by block), and resumable.

Next to the matrix is the journal ``NAME.progress``. Its first line is a fingerprint of the series and the settings. A
line for each finished square follows, with the CRC-32 of the square. A square is recorded after it has been flushed to
disk, so a killed process loses only unfinished squares. The same call with ``resume=True`` computes all squares that
are missing or do not match their checksum.
"""

from __future__ import annotations

import hashlib
import mmap
import os
import shutil
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from cornercase._common.errors import InputError
from cornercase._common.memory import format_size
from cornercase._common.platform import allocate_file, count_unallocated_bytes
from cornercase.dtw import _in_memory as pairs
from cornercase.dtw._dask_squares import DaskSquares
from cornercase.dtw._in_memory import DtwSettings

if TYPE_CHECKING:
    from distributed import Client

# Series per side of a square: a few seconds of work, and 16 MB of the file with its mirror image.
SIDE = 1024

_FORMAT: Any = np.lib.format

Floats = npt.NDArray[np.floating[Any]]
FloatMap = np.memmap[Any, np.dtype[np.floating[Any]]]


def fill_matrix_file(
    series: Sequence[Floats],
    out: str | os.PathLike[str] | FloatMap,
    *,
    resume: bool,
    settings: DtwSettings,
    report_progress: Callable[[int], None],
    client: Client | None = None,
    side: int = SIDE,
) -> FloatMap:
    """Compute the distances between validated series into a file; return a memmap of the file, shape (n, n).

    `out` is the path of a new file, or a memmap of an existing file. With `resume`, finished squares (blocks) in the
    file are not computed again. With a Dask `client`, the Dask cluster computes the squares, and this process writes
    them. A square has `side` series per side. Raises `InputError` if `out` has another shape or type, exists without
    `resume`, or belongs to other series or settings, or if the disk has too little space.
    """
    size = len(series)
    path = Path(_path_of_memmap(out, size, settings.dtype) if isinstance(out, np.memmap) else out)
    journal = path.with_name(path.name + ".progress")
    fingerprint = _fingerprint(series, settings, side)
    if isinstance(out, np.memmap):
        if not resume:
            journal.unlink(missing_ok=True)
    elif not resume and path.exists():
        raise InputError(f"{path}: already exists; continue it with resume=True, or give another path.")
    elif resume and path.exists() and not journal.exists():
        raise InputError(
            f"{path}: {journal.name} is missing, so it is unknown which blocks are finished; give another path."
        )
    elif not path.exists():
        journal.unlink(missing_ok=True)
    existed = path.exists()
    try:
        checksums = _read_or_create_journal(journal, fingerprint)
        view = out if isinstance(out, np.memmap) else _open_memmap(path, size, settings.dtype, new=not checksums)
        try:
            _allocate_disk_space(path)
        except (InputError, OSError):
            if not existed:
                path.unlink()
                journal.unlink()
            raise
        _compute_missing_squares(view, series, journal, checksums, settings, report_progress, client, side)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}).") from error
    return view


def _compute_missing_squares(
    view: FloatMap,
    series: Sequence[Floats],
    journal: Path,
    checksums: dict[tuple[int, int], int],
    settings: DtwSettings,
    report_progress: Callable[[int], None],
    client: Client | None,
    side: int,
) -> None:
    bands = [range(first, min(first + side, len(series))) for first in range(0, len(series), side)]
    parts = [[series[i] for i in band] for band in bands]
    missing = []
    for a in range(len(bands)):
        for b in range(a, len(bands)):
            if (a, b) in checksums and _matches_checksum(view, bands[a], bands[b], checksums[a, b]):
                report_progress(pairs.count_cells(parts[a], None if a == b else parts[b]))
            else:
                missing.append((a, b))
    with journal.open("ab") as notes:
        for a, b, square in _iter_squares(parts, missing, settings, report_progress, client):
            rows, columns = bands[a], bands[b]
            pairs.require_finite_distances(square, rows.start, columns.start)
            # Map each square separately: unmapped pages no longer count as this process's memory.
            memmap = np.memmap(str(view.filename), view.dtype, "r+", view.offset, view.shape)
            memmap[rows.start : rows.stop, columns.start : columns.stop] = square
            memmap[columns.start : columns.stop, rows.start : rows.stop] = square.T
            memmap.flush()
            del memmap
            notes.write(f"{a} {b} {_checksum(square)}\n".encode())
            notes.flush()
            os.fsync(notes.fileno())


def _matches_checksum(view: FloatMap, rows: range, columns: range, checksum: int) -> bool:
    """Return True if a square (block of the matrix) and its mirror image match a checksum."""
    # Map each square separately, as for writing.
    memmap = np.memmap(str(view.filename), view.dtype, "r", view.offset, view.shape)
    square = memmap[rows.start : rows.stop, columns.start : columns.stop]
    mirror = memmap[columns.start : columns.stop, rows.start : rows.stop].T
    return _checksum(square) == checksum == _checksum(mirror)


def _checksum(square: Floats) -> int:
    return zlib.crc32(np.ascontiguousarray(square).tobytes())


def _iter_squares(
    parts: Sequence[Sequence[Floats]],
    missing: Sequence[tuple[int, int]],
    settings: DtwSettings,
    report_progress: Callable[[int], None],
    client: Client | None,
) -> Iterator[tuple[int, int, Floats]]:
    if client is None:
        for a, b in missing:
            yield a, b, pairs.compute_distances(parts[a], None if a == b else parts[b], settings, report_progress)
        return
    for a, b, square in DaskSquares(client, settings, parts).iter_squares(missing):
        yield a, b, square
        report_progress(pairs.count_cells(parts[a], None if a == b else parts[b]))


def _path_of_memmap(out: FloatMap, size: int, dtype: np.dtype[Any]) -> str:
    """Return the path of the file of a memmap; raise `InputError` if the matrix cannot be written to the memmap."""
    if out.shape != (size, size) or out.dtype != dtype:
        raise InputError(f"out is {out.dtype} of shape {out.shape}; give {dtype} of shape ({size}, {size}).")
    if out.filename is None or not isinstance(out.base, mmap.mmap) or not out.flags.c_contiguous:
        raise InputError("out has to map a whole file in row-major order; give such a numpy.memmap, or a path.")
    if out.mode not in ("r+", "w+"):
        raise InputError(f"out is open in mode {out.mode!r}; open it with 'r+'.")
    return os.fspath(out.filename)


def _open_memmap(path: Path, size: int, dtype: np.dtype[Any], *, new: bool) -> FloatMap:
    if not new:
        # Extend a truncated file; its missing squares are computed again.
        end = _header_size(path) + size * size * dtype.itemsize
        if path.stat().st_size < end:
            os.truncate(path, end)
    try:
        view: FloatMap = np.lib.format.open_memmap(path, "w+" if new else "r+", dtype, (size, size))
    except ValueError as error:
        raise InputError(f"{path}: is not a NumPy file; give another path.") from error
    if view.shape != (size, size) or view.dtype != dtype or not view.flags.c_contiguous:
        raise InputError(
            f"{path}: holds {view.dtype} of shape {view.shape} instead of {dtype} of shape ({size}, {size}); give"
            " another path."
        )
    return view


def _allocate_disk_space(path: Path) -> None:
    """Allocate the whole file in advance.

    If the disk became full later, the operating system would kill the process when it writes into the memory map.
    """
    lacking = count_unallocated_bytes(path)
    free = shutil.disk_usage(path).free
    if lacking > free:
        raise InputError(
            f"{path}: needs {format_size(lacking)} more disk space, but only {format_size(free)} are free;"
            " free some space, or give a path on another disk."
        )
    if lacking > 0:
        allocate_file(path)


def _header_size(path: Path) -> int:
    """Return the size of the header of a NumPy file in bytes."""
    with path.open("rb") as file:
        try:
            version = _FORMAT.read_magic(file)
            (_FORMAT.read_array_header_1_0 if version == (1, 0) else _FORMAT.read_array_header_2_0)(file)
        except ValueError as error:
            raise InputError(f"{path}: is not a NumPy file; give another path.") from error
        return file.tell()


def _read_or_create_journal(journal: Path, fingerprint: str) -> dict[tuple[int, int], int]:
    """Return the checksum of each finished square (block of the matrix), by the square's position (i, j) among all.

    i is the number of squares above it, j the number of squares on its left.

    The journal is created if there is none. Raises `InputError` if the journal belongs to other series or settings.
    """
    if not journal.exists():
        journal.write_text(fingerprint + "\n", encoding="utf-8", newline="\n")
        return {}
    content = journal.read_bytes()
    # Drop an incomplete last line.
    complete = content[: content.rfind(b"\n") + 1]
    if len(complete) < len(content):
        journal.write_bytes(complete)
    first, *squares = complete.decode(errors="replace").splitlines() or [fingerprint]
    if not complete:
        journal.write_text(fingerprint + "\n", encoding="utf-8", newline="\n")
    if first != fingerprint:
        raise InputError(
            f"{journal}: belongs to other series or settings; give the same series and settings again, or delete this"
            " file and the matrix."
        )
    checksums = {}
    for line in squares:
        # A damaged line: its square is computed again.
        with suppress(ValueError):
            a, b, checksum = map(int, line.split())
            checksums[a, b] = checksum
    return checksums


def _fingerprint(series: Sequence[Floats], settings: DtwSettings, side: int) -> str:
    digest = hashlib.sha256()
    for values in series:
        digest.update(repr(values.shape).encode())
        digest.update(values.tobytes())
    cost = "squared" if settings.squared else "euclidean"
    return (
        f"cornercase-dtw 2 {digest.hexdigest()} {len(series)} {cost} window={settings.window} "
        f"{settings.dtype} {settings.device} side={side}"
    )
