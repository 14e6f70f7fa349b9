"""Encode arrays and recordings as bytes in NumPy's `.npz` format, which many programs can read."""

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

# Limit of bytes per scenario: ten entities for a day at 20 Hz.
MAX_ARCHIVE_BYTES: Final = 1 << 30
_READ_ERRORS: Final = (
    ValueError, TypeError, LookupError, OSError, EOFError, OverflowError, MemoryError, RecursionError, SyntaxError,
    NotImplementedError, RuntimeError, zipfile.BadZipFile, zlib.error, struct.error, tokenize.TokenError,
)  # fmt: skip
# How NumPy writes the members of an archive.
_COMPRESSION_METHODS: Final = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_NPY_FORMAT: Final[Any] = np.lib.format
# From 1 to 9; 6 takes twice as long and makes recordings 4 % smaller.
_COMPRESSION_LEVEL: Final = 1
_HEADER_CACHE_SIZE: Final = 1024
# Lengths of name and extra field in the header of a member, and their offset.
_LOCAL_LENGTHS: Final = struct.Struct("<HH")
_LOCAL_LENGTHS_OFFSET: Final = 26
_ENCRYPTED_FLAG: Final = 0x1
# Entry of the central directory without its name, and the record after the directory.
_DIRECTORY_ENTRY: Final = struct.Struct("<4s6H3L5H2L")
_END_OF_DIRECTORY: Final = struct.Struct("<4s4H2LH")
_LOCAL_HEADER: Final = struct.Struct("<4s5H3L2H")
# What `zipfile` writes: the version that it needs and the system, 1 January 1980, and the rights of a file.
_ZIP_VERSION: Final = 20
_MADE_ON_UNIX: Final = 3 << 8
_ZIP_DATE: Final = 1 << 5 | 1
_OWNER_MAY_READ_AND_WRITE: Final = 0o600 << 16
# Larger archives are left to `zipfile`: sizes of four bytes may not be enough.
_MAX_SIMPLE_BYTES: Final = 1 << 30
# Highest ZIP version that NumPy's archives need.
_MAX_ZIP_VERSION: Final = 45
# Marks a number that needs more than four bytes (ZIP64).
_ZIP64_MARKER: Final = 0xFFFFFFFF
_BOX_ARRAYS: Final = ("length", "width", "center_x")
_RECORDING_ARRAYS: Final = ("time", "x", "y", "heading", "speed", "acceleration", "length", "width", "center_x")


def pack_arrays(arrays: Mapping[str, npt.ArrayLike], compress: bool = True) -> bytes:
    """Return an archive of arrays in `.npz` format; equal arrays always give equal bytes."""
    members = {f"{name}.npy": _encode_npy(np.asarray(array)) for name, array in arrays.items()}
    method = zipfile.ZIP_DEFLATED if compress else zipfile.ZIP_STORED
    if sum(map(len, members.values())) < _MAX_SIMPLE_BYTES and all(map(str.isascii, members)):
        return _write_simple_zip(members, method)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method, compresslevel=_COMPRESSION_LEVEL) as archive:
        for name, content in members.items():
            # Unlike np.savez, this leaves out the time stamp.
            archive.writestr(zipfile.ZipInfo(name), content, method, _COMPRESSION_LEVEL)
    return buffer.getvalue()


def _write_simple_zip(members: Mapping[str, bytes], method: int) -> bytes:
    """Make an archive as `zipfile.ZipFile` does, several times faster for small members."""
    parts, directory, offset = [], [], 0
    for name, content in members.items():
        packed = content
        if method == zipfile.ZIP_DEFLATED:
            compressor = zlib.compressobj(_COMPRESSION_LEVEL, zlib.DEFLATED, -zlib.MAX_WBITS)
            packed = compressor.compress(content) + compressor.flush()
        encoded, checksum = name.encode(), zlib.crc32(content)
        common = (_ZIP_VERSION, 0, method, 0, _ZIP_DATE, checksum, len(packed), len(content), len(encoded), 0)
        parts += [_LOCAL_HEADER.pack(b"PK\3\4", *common), encoded, packed]
        entry = _DIRECTORY_ENTRY.pack(
            b"PK\1\2", _MADE_ON_UNIX | _ZIP_VERSION, *common, 0, 0, 0, _OWNER_MAY_READ_AND_WRITE, offset
        )
        directory += [entry, encoded]
        offset += sum(map(len, parts[-3:]))
    size = sum(map(len, directory))
    end = _END_OF_DIRECTORY.pack(b"PK\5\6", 0, 0, len(members), len(members), size, offset, 0)
    return b"".join((*parts, *directory, end))


def _encode_npy(array: npt.NDArray[Any]) -> bytes:
    """Return the content of a `.npy` file with the array."""
    return _encode_npy_header(array.dtype.str, array.shape) + array.tobytes()


@lru_cache(maxsize=_HEADER_CACHE_SIZE)
def _encode_npy_header(dtype: str, shape: tuple[int, ...]) -> bytes:
    stream = io.BytesIO()
    _NPY_FORMAT.write_array_header_1_0(stream, {"descr": dtype, "fortran_order": False, "shape": shape})
    return stream.getvalue()


def unpack_arrays(
    data: bytes, max_bytes: int = MAX_ARCHIVE_BYTES, names: Collection[str] | None = None
) -> dict[str, npt.NDArray[Any]]:
    """Read arrays from an archive in `.npz` format, as a dict by name; with `names`, only read these arrays.

    Raises `InputError` if the bytes are not an archive of plain arrays. Also raises it if the archive would unpack to
    more than `max_bytes`, since a few damaged bytes could claim gigabytes.
    """
    try:
        members = _list_zip_members(data)
        if (size := sum(member.file_size for member in members)) > max_bytes:
            raise ValueError(f"the arrays have {size} bytes, more than the limit of {max_bytes}")
        if any(member.compress_type not in _COMPRESSION_METHODS for member in members):
            raise ValueError("an array is compressed by a method that NumPy does not use")
        named = [(member.filename.removesuffix(".npy"), member) for member in members]
        return {
            name: _decode_npy(_read_zip_member(data, member))
            for name, member in named
            if names is None or name in names
        }
    except _READ_ERRORS as error:
        raise InputError(f"The study holds arrays that cannot be read ({error}).") from error


class _ZipMember(NamedTuple):
    """Member of a ZIP archive, with those fields of `zipfile.ZipInfo` that are needed."""

    filename: str
    header_offset: int
    flag_bits: int
    compress_type: int
    compress_size: int
    file_size: int
    CRC: int


def _list_zip_members(data: bytes) -> Sequence[_ZipMember | zipfile.ZipInfo]:
    """List the members of an archive; much faster than `zipfile.ZipFile` for archives that this module wrote."""
    end = len(data) - _END_OF_DIRECTORY.size
    if end >= 0:
        sign, disk, first_disk, _, _, size, start, comment = _END_OF_DIRECTORY.unpack_from(data, end)
        is_simple = sign == b"PK\5\6" and start + size == end and not (disk or first_disk or comment)
        if is_simple and (members := _parse_zip_directory(data, start, end)) is not None:
            return members
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return archive.infolist()


def _parse_zip_directory(data: bytes, offset: int, end: int) -> list[_ZipMember] | None:
    """Parse the central directory of an archive; None unless it has the exact form that NumPy and this module write."""
    members = []
    while offset + _DIRECTORY_ENTRY.size <= end:
        listed = _DIRECTORY_ENTRY.unpack_from(data, offset)
        sign, _, version, flags, method, _, _, crc, packed_size, size, name_length, extra, comment, _, _, _, start = (
            listed
        )
        name = data[offset + _DIRECTORY_ENTRY.size : offset + _DIRECTORY_ENTRY.size + name_length]
        is_simple = (
            sign == b"PK\1\2" and version <= _MAX_ZIP_VERSION and not (flags or extra or comment) and name.isascii()
        )
        if not is_simple or b"\0" in name or b"\\" in name or _ZIP64_MARKER in (packed_size, size, start):
            return None
        members.append(_ZipMember(name.decode(), start, flags, method, packed_size, size, crc))
        offset += _DIRECTORY_ENTRY.size + name_length
    return members if offset == end else None


def _read_zip_member(data: bytes, member: _ZipMember | zipfile.ZipInfo) -> bytes:
    """Read a member of an archive; three times as fast as `zipfile.ZipFile.read` for small members."""
    name, extra = _LOCAL_LENGTHS.unpack_from(data, member.header_offset + _LOCAL_LENGTHS_OFFSET)
    start = member.header_offset + _LOCAL_LENGTHS_OFFSET + _LOCAL_LENGTHS.size + name + extra
    packed = data[start : start + member.compress_size]
    if member.flag_bits & _ENCRYPTED_FLAG:
        raise ValueError("an array is encrypted")
    content = packed
    if member.compress_type == zipfile.ZIP_DEFLATED:
        # A few bytes may unpack to many more than declared.
        content = zlib.decompressobj(-zlib.MAX_WBITS).decompress(packed, member.file_size + 1)
    if len(content) != member.file_size or zlib.crc32(content) != member.CRC:
        raise ValueError(f"{member.filename} is damaged")
    return content


def _decode_npy(content: bytes) -> npt.NDArray[Any]:
    """Decode a `.npy` file after checking that header and size fit; never unpickle anything."""
    # The header length has two bytes in version 1 of the format, else four.
    size = slice(8, 10 if content[6:7] == b"\x01" else 12)
    start = size.stop + int.from_bytes(content[size], "little")
    shape, by_columns, dtype = _decode_npy_header(content[:start])
    if dtype.hasobject:
        raise ValueError("an array contains Python objects, whose loading could run code")
    if dtype.itemsize == 0 and math.prod(shape):
        raise ValueError(f"an array of shape {shape} has elements without any bytes")
    if math.prod(shape) * dtype.itemsize != len(content) - start or min(shape, default=0) < 0:
        raise ValueError(f"an array of shape {shape} does not fit the {len(content)} bytes of its file")
    if not math.prod(shape):
        return np.zeros(shape, dtype)
    return np.frombuffer(content, dtype, offset=start).reshape(shape, order="F" if by_columns else "C").copy()


@lru_cache(maxsize=_HEADER_CACHE_SIZE)
def _decode_npy_header(header: bytes) -> tuple[Any, bool, np.dtype[Any]]:
    """Return shape, Fortran order (bool) and dtype from a `.npy` header.

    The result is cached, since many arrays have the same header.
    """
    stream = io.BytesIO(header)
    version = _NPY_FORMAT.read_magic(stream)
    read_array_header = _NPY_FORMAT.read_array_header_1_0 if version == (1, 0) else _NPY_FORMAT.read_array_header_2_0
    shape, by_columns, dtype = read_array_header(stream)
    return tuple(shape), bool(by_columns), dtype


def pack_recording(recording: Recording) -> bytes:
    """Return an archive of the arrays of a recording, in `.npz` format."""
    arrays: dict[str, npt.ArrayLike] = {name: getattr(recording, name) for name in _RECORDING_ARRAYS}
    arrays["names"], arrays["kinds"] = np.array(recording.names), np.array(recording.object_types)
    arrays["collision_time"] = np.array([c.time for c in recording.collisions], dtype=np.float64)
    arrays["collision_entities"] = np.array(
        [[recording.names.index(n) for n in c.entities] for c in recording.collisions], dtype=np.int64
    ).reshape(-1, 2)
    return pack_arrays(arrays)


def unpack_recording(data: bytes) -> Recording:
    """Read a recording from an archive; raises `InputError` if the content is not a valid recording."""
    arrays = unpack_arrays(data)
    n_times, n_entities = len(arrays["time"]), len(arrays["names"])
    for name in _RECORDING_ARRAYS:
        array, shape = arrays[name], _expected_shape(name, n_entities, n_times)
        if array.dtype.kind not in "fiu" or array.shape != shape:
            raise InputError(
                f"The study holds a recording whose {name} is an array of {array.dtype} of shape {array.shape}; it has"
                f" to hold numbers and have the shape {shape}."
            )
    if not n_times or not np.isfinite(arrays["time"]).all() or (np.diff(arrays["time"]) <= 0.0).any():
        raise InputError("The study holds a recording whose times do not increase.")
    names, kinds = tuple(map(str, arrays["names"])), tuple(map(str, arrays["kinds"]))
    if len(set(names)) < n_entities or len(kinds) != n_entities:
        raise InputError(
            "The study holds a recording in which two entities have the same name, or an entity has no type."
        )
    return Recording(
        **{name: arrays[name] for name in _RECORDING_ARRAYS},  # type: ignore[arg-type]
        names=names,
        object_types=kinds,
        collisions=_decode_collisions(arrays, names),
    )


def _decode_collisions(arrays: Mapping[str, npt.NDArray[Any]], names: tuple[str, ...]) -> tuple[Collision, ...]:
    return tuple(
        Collision(float(time), (names[a], names[b]))
        for time, (a, b) in zip(arrays["collision_time"], arrays["collision_entities"], strict=True)
    )


def _expected_shape(name: str, n_entities: int, n_times: int) -> tuple[int, ...]:
    if name == "time":
        return (n_times,)
    return (n_entities,) if name in _BOX_ARRAYS else (n_entities, n_times)
