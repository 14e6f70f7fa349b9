"""Arrays and recordings as bytes, and back: NumPy's ``.npz``, so that any program can read them."""

from __future__ import annotations

import io
import math
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Collection, Mapping, Sequence
from functools import lru_cache
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from cornercase._common.errors import InputError
from cornercase.recordings import Collision, Recording

# Bytes of what belongs to one scenario: ten entities for a day at 20 instants a second.
LARGEST: Final = 1 << 30
_BROKEN: Final = (
    ValueError, TypeError, LookupError, OSError, EOFError, OverflowError, MemoryError, RecursionError, SyntaxError,
    NotImplementedError, RuntimeError, zipfile.BadZipFile, zlib.error, struct.error, tokenize.TokenError,
)  # fmt: skip
# How NumPy writes the members of an archive.
_METHODS: Final = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_FORMAT: Final[Any] = np.lib.format
# Of 1 to 9; 6 takes twice as long, for recordings that are smaller by 4 %.
_EFFORT: Final = 1
_HEADERS: Final = 1024
# Where a member of an archive says how long its name is and what follows it, before its content.
_LENGTHS: Final = struct.Struct("<HH")
_LENGTHS_AT: Final = 26
_ENCRYPTED: Final = 0x1
# A member in the list at the end of an archive, before its name, and the end of that list.
_LISTED: Final = struct.Struct("<4s6H3L5H2L")
_END: Final = struct.Struct("<4s4H2LH")
# Version of the format that NumPy's archives need at most.
_NEEDED: Final = 45
# What stands where a number needs more than four bytes.
_ELSEWHERE: Final = 0xFFFFFFFF
_BOX: Final = ("length", "width", "center_x")
_ARRAYS: Final = ("time", "x", "y", "heading", "speed", "acceleration", "length", "width", "center_x")


def pack_arrays(arrays: Mapping[str, npt.ArrayLike]) -> bytes:
    """Make an archive of arrays; its bytes depend on them alone.

    Parameters
    ----------
    arrays : mapping of str to array_like

    Returns
    -------
    bytes
    """
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=_EFFORT) as archive:
        for name, array in arrays.items():
            # A member that is named this way has no time stamp, as those of np.savez.
            member = zipfile.ZipInfo(f"{name}.npy")
            archive.writestr(member, _npy(np.asarray(array)), zipfile.ZIP_DEFLATED, _EFFORT)
    return buffer.getvalue()


def _npy(array: npt.NDArray[Any]) -> bytes:
    """Content of a ``.npy`` file."""
    return _written_header(array.dtype.str, array.shape) + array.tobytes()


@lru_cache(maxsize=_HEADERS)
def _written_header(dtype: str, shape: tuple[int, ...]) -> bytes:
    stream = io.BytesIO()
    _FORMAT.write_array_header_1_0(stream, {"descr": dtype, "fortran_order": False, "shape": shape})
    return stream.getvalue()


def unpack_arrays(
    data: bytes, largest: int = LARGEST, only: Collection[str] | None = None
) -> dict[str, npt.NDArray[Any]]:
    """Arrays of an archive, by name.

    Parameters
    ----------
    data : bytes
    largest : int, optional
        Bytes that all arrays together may have; a few bytes of an archive can claim to be many.
    only : collection of str, optional
        Names of those that are read; by default all.

    Returns
    -------
    dict of str to ndarray

    Raises
    ------
    InputError
        It is no such archive, it holds something else than plain arrays, or it is larger.
    """
    try:
        members = _members(data)
        if (size := sum(one.file_size for one in members)) > largest:
            raise ValueError(f"{size} bytes where at most {largest} are read")
        if any(one.compress_type not in _METHODS for one in members):
            raise ValueError("a way of packing that NumPy does not use")
        named = [(one.filename.removesuffix(".npy"), one) for one in members]
        return {name: _array(_content(data, one)) for name, one in named if only is None or name in only}
    except _BROKEN as error:
        raise InputError(f"The study holds arrays that cannot be read ({error}).") from error


class _Member(NamedTuple):
    """What `zipfile.ZipInfo` says of a member, by the same names."""

    filename: str
    header_offset: int
    flag_bits: int
    compress_type: int
    compress_size: int
    file_size: int
    CRC: int


def _members(data: bytes) -> Sequence[_Member | zipfile.ZipInfo]:
    """List the members of an archive as `zipfile.ZipFile` does, but a plain list in a fraction of its time."""
    end = len(data) - _END.size
    if end >= 0:
        sign, disk, first_disk, _, _, size, begin, comment = _END.unpack_from(data, end)
        plain = sign == b"PK\5\6" and begin + size == end and not (disk or first_disk or comment)
        if plain and (found := _listed(data, begin, end)) is not None:
            return found
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return archive.infolist()


def _listed(data: bytes, at: int, end: int) -> list[_Member] | None:
    """Read a list of members; None where a member is anything but what NumPy and this module write."""
    found = []
    while at + _LISTED.size <= end:
        listed = _LISTED.unpack_from(data, at)
        sign, _, needed, flags, method, _, _, crc, packed, size, long, extra, comment, _, _, _, begin = listed
        name = data[at + _LISTED.size : at + _LISTED.size + long]
        plain = sign == b"PK\1\2" and needed <= _NEEDED and not (flags or extra or comment) and name.isascii()
        if not plain or b"\0" in name or b"\\" in name or _ELSEWHERE in (packed, size, begin):
            return None
        found.append(_Member(name.decode(), begin, flags, method, packed, size, crc))
        at += _LISTED.size + long
    return found if at == end else None


def _content(data: bytes, member: _Member | zipfile.ZipInfo) -> bytes:
    """Read what a member of an archive holds: as `zipfile.ZipFile.read` does, three times as fast for small ones."""
    name, extra = _LENGTHS.unpack_from(data, member.header_offset + _LENGTHS_AT)
    begin = member.header_offset + _LENGTHS_AT + _LENGTHS.size + name + extra
    packed = data[begin : begin + member.compress_size]
    if member.flag_bits & _ENCRYPTED:
        raise ValueError("an encrypted member")
    content = packed
    if member.compress_type == zipfile.ZIP_DEFLATED:
        # A few bytes may hold many more than they claim to.
        content = zlib.decompressobj(-zlib.MAX_WBITS).decompress(packed, member.file_size + 1)
    if len(content) != member.file_size or zlib.crc32(content) != member.CRC:
        raise ValueError(f"{member.filename} is damaged")
    return content


def _array(member: bytes) -> npt.NDArray[Any]:
    """Read one array, once its header was found to say how large it is; never a pickle."""
    # Its header tells how long it is: in two bytes in version 1 of the format, else in four.
    size = slice(8, 10 if member[6:7] == b"\x01" else 12)
    first = size.stop + int.from_bytes(member[size], "little")
    shape, by_columns, dtype = _read_header(member[:first])
    if dtype.hasobject:
        raise ValueError("an array of Python objects, which would have to run code")
    if dtype.itemsize == 0 and math.prod(shape):
        raise ValueError(f"an array of {shape} with nothing in it")
    if math.prod(shape) * dtype.itemsize != len(member) - first or min(shape, default=0) < 0:
        raise ValueError(f"an array of {shape} in {len(member)} bytes")
    if not math.prod(shape):
        return np.zeros(shape, dtype)
    return np.frombuffer(member, dtype, offset=first).reshape(shape, order="F" if by_columns else "C").copy()


@lru_cache(maxsize=_HEADERS)
def _read_header(header: bytes) -> tuple[Any, bool, np.dtype[Any]]:
    """Shape, whether it is stored column by column, and type; parsed once, as many arrays of a study are alike."""
    stream = io.BytesIO(header)
    version = _FORMAT.read_magic(stream)
    read = _FORMAT.read_array_header_1_0 if version == (1, 0) else _FORMAT.read_array_header_2_0
    shape, by_columns, dtype = read(stream)
    return tuple(shape), bool(by_columns), dtype


def pack_recording(recording: Recording) -> bytes:
    """Make an archive of a recording.

    Parameters
    ----------
    recording : Recording

    Returns
    -------
    bytes
    """
    arrays: dict[str, npt.ArrayLike] = {name: getattr(recording, name) for name in _ARRAYS}
    arrays["names"], arrays["kinds"] = np.array(recording.names), np.array(recording.kinds)
    arrays["collision_time"] = np.array([c.time for c in recording.collisions], dtype=np.float64)
    arrays["collision_entities"] = np.array(
        [[recording.names.index(n) for n in c.entities] for c in recording.collisions], dtype=np.int64
    ).reshape(-1, 2)
    return pack_arrays(arrays)


def unpack_recording(data: bytes) -> Recording:
    """Recording of an archive.

    Parameters
    ----------
    data : bytes

    Returns
    -------
    Recording

    Raises
    ------
    InputError
        It is no such archive, or what it holds is no recording.
    """
    arrays = unpack_arrays(data)
    instants, entities = len(arrays["time"]), len(arrays["names"])
    for name in _ARRAYS:
        one, shape = arrays[name], _shape_of(name, entities, instants)
        if one.dtype.kind not in "fiu" or one.shape != shape:
            raise InputError(f"The study holds a recording whose {name} is {one.dtype} {one.shape}, not {shape}.")
    if not instants or not np.isfinite(arrays["time"]).all() or (np.diff(arrays["time"]) <= 0.0).any():
        raise InputError("The study holds a recording whose time does not increase.")
    names, kinds = tuple(map(str, arrays["names"])), tuple(map(str, arrays["kinds"]))
    if len(set(names)) < entities or len(kinds) != entities:
        raise InputError("The study holds a recording whose entities have no names and kinds of their own.")
    return Recording(
        **{name: arrays[name] for name in _ARRAYS},  # type: ignore[arg-type]
        names=names,
        kinds=kinds,
        collisions=_collisions(arrays, names),
    )


def unpack_collisions(data: bytes) -> tuple[Collision, ...]:
    """Collisions of a recording of an archive, which takes a tenth of reading all of it.

    Parameters
    ----------
    data : bytes

    Returns
    -------
    tuple of Collision

    Raises
    ------
    InputError
        It is no such archive, or what it holds is no recording.
    """
    # Most hold none, and each array that is read takes its time.
    if not len(unpack_arrays(data, only=("collision_time",))["collision_time"]):
        return ()
    arrays = unpack_arrays(data, only=("names", "collision_time", "collision_entities"))
    return _collisions(arrays, tuple(map(str, arrays["names"])))


def _collisions(arrays: Mapping[str, npt.NDArray[Any]], names: tuple[str, ...]) -> tuple[Collision, ...]:
    return tuple(
        Collision(float(time), (names[a], names[b]))
        for time, (a, b) in zip(arrays["collision_time"], arrays["collision_entities"], strict=True)
    )


def _shape_of(name: str, entities: int, instants: int) -> tuple[int, ...]:
    if name == "time":
        return (instants,)
    return (entities,) if name in _BOX else (entities, instants)
