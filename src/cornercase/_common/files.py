"""Writing files so that none is ever half there."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from cornercase._common.arguments import path as path_argument
from cornercase._common.errors import InputError
from cornercase._common.pending_files import OF_SQLITE, pending_files, unwritten, written_together

# What a file name of Windows must not have in it and what a terminal takes for orders, the names of its devices, and
# how long a name may be: file systems take 255 bytes, of which an ending and a temporary name need some.
_REFUSED: Final = re.compile(r'[<>:"/\\|?*\x00-\x1f\x7f-\x9f\u200b-\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]+')
_DEVICES: Final = re.compile(r"(con|prn|aux|nul|conin\$|conout\$|com[\d¹²³]|lpt[\d¹²³])\s*(\.|$)", re.IGNORECASE)
_LONGEST: Final = 150
_AT_ONCE: Final = 1 << 20
LARGEST: Final = 200_000_000
"""Bytes of a file that is read whole."""


def portable_name(text: str) -> str:
    """Return a text as the name of a file that every platform takes.

    Parameters
    ----------
    text : str

    Returns
    -------
    str
        The same for all platforms; characters that one of them refuses become hyphens, and what is beyond 150 bytes is
        cut off. It names neither a folder nor a hidden file.

    Examples
    --------
    >>> portable_name("criticality-ttc:accelerating=true")
    'criticality-ttc-accelerating=true'
    """
    name = _REFUSED.sub("-", text).encode()[:_LONGEST].decode(errors="ignore").rstrip(". ") or "-"
    return f"-{name}" if _DEVICES.match(name) or name.startswith(".") else name


def read_file(path: Path | str, largest: int = LARGEST) -> bytes:
    """Content of a file.

    Parameters
    ----------
    path : path
        A regular file of at most 200 MB.
    largest : int, optional
        Bytes that it may have instead.

    Returns
    -------
    bytes

    Raises
    ------
    InputError
        The file cannot be read, or is too large.
    """
    path = Path(path)
    # No system has such a name.
    if "\0" in str(path):
        raise InputError(f"{path}: is not a valid file name.")
    # A device or a pipe may never end.
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: is not a file.")
    try:
        with open(path, "rb") as file:
            # To ask for the largest would take its memory, whatever the size.
            content = file.read(min(os.fstat(file.fileno()).st_size, largest) + 1)
            # Some files of the system say that they are empty.
            while len(content) <= largest and (more := file.read(_AT_ONCE)):
                content += more
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).") from error
    if len(content) > largest:
        raise InputError(f"{path}: has more than {largest} bytes, which are not read.")
    return content


@contextmanager
def written_whole(path: Path | str) -> Iterator[Path]:
    """Give a temporary name beside `path`, and rename it to `path` when the block ends well.

    The content is on the disk before that, so that a power cut leaves what was there or what is new. Within
    `cornercase._common.pending_files.written_together` it is renamed at the end of that block.

    Parameters
    ----------
    path : path
        Where the file is to be. Missing folders are made.

    Yields
    ------
    Path
        The temporary name.

    Raises
    ------
    InputError
        The folder is not writable, the disk is full, or something that is no file has the name; nothing is left
        behind.
    """
    path = Path(path)
    with pending_files() as files:
        temporary = files.begin(path)
        try:
            yield temporary
        except OSError as error:
            raise unwritten(path, error) from error


# What SQLite and the lock of a study of earlier versions add to its name.
_BESIDE: Final = (*OF_SQLITE, ".lock")


def require_other_file(output: Path | str, source: Path | str, name: str = "output") -> None:
    """Refuse to write a file over the one that it is made from.

    Parameters
    ----------
    output, source : path
        What will be written, and what it is made from.
    name : str, default "output"
        Parameter that the former was given for.

    Raises
    ------
    InputError
        Both are the same file, by whatever names, or the output is one that a database keeps beside itself.
    """
    output, source = Path(output), Path(source)
    if output.exists() and source.exists() and output.samefile(source):
        raise InputError(f"`{name}` {output}: is the file that is read; choose another name.")
    if _is_beside(output, source):
        raise InputError(f"`{name}` {output}: belongs to the file that is read; choose another name.")


def require_apart(output: Path, study: Path, name: str) -> None:
    """Refuse to write a file over a study that is written too.

    Parameters
    ----------
    output, study : Path
        What will be written, and the study.
    name : str
        Parameter that the former was given for.

    Raises
    ------
    InputError
        Both are the same file, or the output is one that a database keeps beside itself.
    """
    if os.path.realpath(output) == os.path.realpath(study) or _is_beside(output, study):
        raise InputError(f"`{name}` {output}: is the study, or belongs to it; choose another name.")


def _is_beside(output: Path, database: Path) -> bool:
    # A link that leads to itself is left as it is, and refused when it is written.
    whole, written = os.path.realpath(database), os.path.realpath(output)
    return written in {whole + ending for ending in _BESIDE}


def require_place(name: str, path: Path) -> None:
    """Refuse a file that could not be written, before what takes time.

    Parameters
    ----------
    name : str
        Parameter that it was given for.
    path : Path
        What will be written.

    Raises
    ------
    InputError
        Something that is no file has its name, or its folder is none or not writable.
    """
    if path.exists() and not path.is_file():
        raise InputError(f"`{name}` {path}: is not a file; choose another name.")
    folder = next(one for one in (path.parent, *path.parent.parents) if one.exists())
    if not folder.is_dir() or not os.access(folder, os.W_OK | os.X_OK):
        raise InputError(f"`{name}` {path}: cannot be written into {folder}; choose another place.")


def write_files(contents: Mapping[Path, bytes]) -> None:
    """Write several files, all of them or none.

    Parameters
    ----------
    contents : mapping of Path to bytes

    Raises
    ------
    InputError
        As `written_whole`.
    """
    with written_together():
        for path, content in contents.items():
            with written_whole(path) as temporary:
                temporary.write_bytes(content)


def require_folder(name: str, folder: Path | str) -> Path:
    """Refuse a folder that cannot be made because a file is in its way.

    Parameters
    ----------
    name : str
        Parameter that it was given for.
    folder : path
        That is there or will be made.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    InputError
        It, or one that it lies in, is no folder, or it is no path.
    """
    folder = path_argument(name, folder)
    for one in (folder, *folder.parents):
        if one.is_dir():
            break
        if one.exists():
            raise InputError(f"`{name}` {folder}: {one} is a file, not a folder; choose another name.")
    return folder
