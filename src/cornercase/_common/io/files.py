"""Read files; write files atomically; check output paths before work begins."""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from cornercase._common.errors import InputError
from cornercase._common.io.atomic import (
    SQLITE_SUFFIXES,
    atomic_write_group,
    current_or_new_group,
    unwritable_file_error,
)
from cornercase._common.validation import check_path as path_argument

# Characters that Windows refuses or that control a terminal; device names; maximum length: file systems allow 255
# bytes, and a suffix and a temporary name need some of them.
_INVALID_CHARACTERS: Final = re.compile(
    r'[<>:"/\\|?*\x00-\x1f\x7f-\x9f\u200b-\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]+'
)
_DEVICE_NAMES: Final = re.compile(r"(con|prn|aux|nul|conin\$|conout\$|com[\d¹²³]|lpt[\d¹²³])\s*(\.|$)", re.IGNORECASE)
_MAX_NAME_BYTES: Final = 150
_CHUNK_SIZE: Final = 1 << 20
MAX_FILE_SIZE: Final = 200_000_000
"""Size in bytes of the largest file that is read."""


def make_portable_file_name(text: str) -> str:
    """Turn a text into a file name that is valid on every platform.

    It has at most 150 bytes, names no folder and does not begin with a dot.

    >>> make_portable_file_name("criticality-ttc:accelerating=true")
    'criticality-ttc-accelerating=true'
    """
    name = _cut_name(_INVALID_CHARACTERS.sub("-", text)) or "-"
    return _cut_name(f"-{name}") if _DEVICE_NAMES.match(name) or name.startswith(".") else name


def _cut_name(name: str) -> str:
    return name.encode()[:_MAX_NAME_BYTES].decode(errors="ignore").rstrip(". ")


def read_file(path: Path | str, max_size: int = MAX_FILE_SIZE) -> bytes:
    """Return the content of a regular file; `InputError` if it cannot be read or has more than `max_size` bytes."""
    path = Path(path)
    # No file system allows null characters in names.
    if "\0" in str(path):
        raise InputError(f"{path}: is not a valid file name.")
    # Reading a device or a pipe may never end.
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: is not a file.")
    try:
        with open(path, "rb") as file:
            # Requesting the maximum would allocate it, whatever the size.
            content = file.read(min(os.fstat(file.fileno()).st_size, max_size) + 1)
            # Some system files report size 0.
            while len(content) <= max_size and (more := file.read(_CHUNK_SIZE)):
                content += more
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).") from error
    if len(content) > max_size:
        raise InputError(f"{path}: has more than {max_size} bytes; larger files are not read.")
    return content


def read_utf8(path: Path, max_size: int = MAX_FILE_SIZE) -> str:
    """Return the text of a file in UTF-8; `InputError` as in `read_file`, or if it is in another encoding."""
    try:
        return read_file(path, max_size).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not UTF-8 text ({error.reason}).") from error


def parse_toml(path: Path, text: str) -> dict[str, Any]:
    """Parse the text of a TOML file; `InputError` if it is not valid."""
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        # Also raised for integers that are too long for Python.
        raise InputError(f"{path}: is not valid TOML ({str(error)[:200]}).") from error


@contextmanager
def atomic_write(path: Path | str) -> Iterator[Path]:
    """Yield a temporary path next to `path`, and rename that file to `path` when the block succeeds.

    The content is synced to disk first, so that a power cut leaves either the old or the new file. Within
    `atomic_write_group`, the file is renamed at the end of the group. If writing fails, `InputError` is raised and no
    temporary file is left.
    """
    path = Path(path)
    with current_or_new_group() as files:
        temporary = files.add_file(path)
        try:
            yield temporary
        except OSError as error:
            raise unwritable_file_error(path, error) from error


# Suffixes of SQLite's files, and of the lock file of earlier versions.
_SIDE_FILE_SUFFIXES: Final = (*SQLITE_SUFFIXES, ".lock")


def check_output_differs_from_source(output: Path | str, source: Path | str, name: str = "output") -> None:
    """Raise `InputError` if `output` is the same file as `source`, or a file that SQLite keeps beside `source`."""
    output, source = Path(output), Path(source)
    if output.exists() and source.exists() and output.samefile(source):
        raise InputError(f"`{name}` {output}: is the input file; choose another name.")
    if _is_sqlite_side_file(output, source):
        raise InputError(f"`{name}` {output}: is a file that SQLite keeps beside the input; choose another name.")


def check_output_is_not_study(output: Path, study: Path, name: str) -> None:
    """Raise `InputError` if `output` is the study being written, or a file that SQLite keeps beside the study."""
    if os.path.realpath(output) == os.path.realpath(study) or _is_sqlite_side_file(output, study):
        raise InputError(
            f"`{name}` {output}: is the study, or a file that SQLite keeps beside it; choose another name."
        )


def _is_sqlite_side_file(output: Path, database: Path) -> bool:
    # A circular link is left as it is; writing to it is refused later.
    database_path, output_path = os.path.realpath(database), os.path.realpath(output)
    return output_path in {database_path + ending for ending in _SIDE_FILE_SUFFIXES}


def check_writable_file(name: str, path: Path) -> None:
    """Raise `InputError` if no file can be written to `path`; call it before long work begins."""
    if path.exists() and not path.is_file():
        raise InputError(f"`{name}` {path}: is not a file; choose another name.")
    folder = next(parent for parent in (path.parent, *path.parent.parents) if parent.exists())
    if not folder.is_dir() or not os.access(folder, os.W_OK | os.X_OK):
        raise InputError(f"`{name}` {path}: cannot be written into {folder}; choose another place.")


def write_files(contents: Mapping[Path, bytes]) -> None:
    """Write several files, all or none."""
    with atomic_write_group():
        for path, content in contents.items():
            with atomic_write(path) as temporary:
                temporary.write_bytes(content)


def check_output_folder(name: str, folder: Path | str) -> Path:
    """Return the path of a folder; `InputError` if the folder, or a folder above it, has the name of a file."""
    folder = path_argument(name, folder)
    for parent in (folder, *folder.parents):
        if parent.is_dir():
            break
        if parent.exists():
            raise InputError(f"`{name}` {folder}: {parent} is a file, not a folder; choose another name.")
    return folder
