"""Files that are written under other names first, and get their own together, once all of them are on the disk."""

from __future__ import annotations

import os
import platform
import re
import tempfile
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from functools import cache
from pathlib import Path
from typing import Final
from zlib import crc32

from cornercase._common.errors import InputError
from cornercase._common.platform import force_file, force_folder, is_process, new_file_mode, replace_file

# A disk takes the files that several threads wait for at once; beyond this it gets no faster.
_AT_ONCE: Final = 16
# Characters of a file's name in its temporary one, which may be no longer than 255 bytes.
_OF_THE_NAME: Final = 50
OF_SQLITE: Final = ("-journal", "-wal", "-shm")
"""How the names of files end that SQLite writes beside a database."""
# How temporary names end.
_LEFT: Final = re.compile(rf"\.[0-9a-f]{{8}}-(\d{{1,9}})-[a-z0-9_]{{8}}({'|'.join(OF_SQLITE)})?$")


class PendingFiles:
    """Files that have not got their names yet."""

    def __init__(self) -> None:
        self._temporary: dict[Path, Path] = {}
        self._made: list[Path] = []
        self._swept: set[Path] = set()

    def begin(self, path: Path) -> Path:
        """Make an empty file beside where one is to be.

        Parameters
        ----------
        path : Path
            Where the file is to be. Missing folders are made.

        Returns
        -------
        Path
            Where to write it.

        Raises
        ------
        InputError
            The folder is not writable, the disk is full, or something that is no file has the name.
        """
        # A folder, a pipe or a device must not be replaced by a file.
        with _sentence(path):
            other = path.exists() and not path.is_file()
        if other:
            raise InputError(f"{path}: is not a file; choose another name.")
        # A link stays a link: the file that it points to is written.
        try:
            path = path.resolve()
        except (OSError, RuntimeError) as error:
            raise InputError(f"{path}: is a link that leads nowhere; choose another name.") from error
        earlier = self._temporary.get(path)
        if earlier is not None:
            return earlier
        try:
            self._made += made_folders(path.parent)
            self._sweep(path.parent)
            prefix = f".{path.name[:_OF_THE_NAME]}.{_mark(os.getpid())}-"
            handle, name = tempfile.mkstemp(prefix=prefix, dir=path.parent)
            self._temporary[path] = Path(name)
            os.close(handle)
        except OSError as error:
            raise unwritten(path, error) from error
        return self._temporary[path]

    def place(self) -> None:
        """Give the files their names, once their contents are on the disk.

        Raises
        ------
        InputError
            It cannot be done. Before the last content is on the disk, no file has got its name.
        """
        mode = new_file_mode()
        for path, temporary in self._temporary.items():
            with _sentence(path):
                os.chmod(temporary, mode)
        force_all(self._temporary.values(), list(self._temporary))
        folders = {one.parent for one in self._made}
        for path, temporary in list(self._temporary.items()):
            with _sentence(path):
                replace_file(temporary, path)
            del self._temporary[path]
            folders.add(path.parent)
        self._made.clear()
        for folder in sorted(folders):
            with _sentence(folder):
                force_folder(folder)

    def discard(self) -> None:
        """Remove what has no name yet, and the folders that were made for it."""
        for temporary in self._temporary.values():
            for ending in ("", *OF_SQLITE):
                with suppress(OSError):
                    temporary.with_name(temporary.name + ending).unlink(missing_ok=True)
        for folder in reversed(self._made):
            # One that somebody else has put something into stays.
            with suppress(OSError):
                folder.rmdir()
        self._temporary.clear()
        self._made.clear()

    def _sweep(self, folder: Path) -> None:
        """Remove what writers that were killed have left in a folder."""
        if folder in self._swept:
            return
        self._swept.add(folder)
        # One may be writable and not readable.
        with suppress(PermissionError):
            for one in list(folder.iterdir()):
                found = _LEFT.search(one.name)
                if found and found[0].startswith(f".{_mark(int(found[1]))}-") and not is_process(int(found[1])):
                    with suppress(OSError):
                        one.unlink(missing_ok=True)


def _mark(process: int) -> str:
    """Tell which process of which machine or container writes a file; others may share its folder."""
    return f"{crc32(f'{platform.node()} {_of_processes()}'.encode()):08x}-{process}"


@cache
def _of_processes() -> str:
    # Containers of one name do not see each other's processes.
    try:
        return os.readlink("/proc/self/ns/pid")
    except OSError:
        return ""


_together: ContextVar[PendingFiles | None] = ContextVar("together", default=None)


@contextmanager
def pending_files() -> Iterator[PendingFiles]:
    """Give the files of the `written_together` that this stands in, or some that get their names after the block.

    Yields
    ------
    PendingFiles
    """
    together = _together.get()
    if together is not None:
        yield together
        return
    files = PendingFiles()
    try:
        yield files
        files.place()
    finally:
        files.discard()


@contextmanager
def written_together() -> Iterator[None]:
    """Let all files that are written within the block get their names at its end, and none of them when it fails.

    Many files get to the disk this way in little more time than one.

    Yields
    ------
    None

    Raises
    ------
    InputError
        As `cornercase._common.files.written_whole`.
    """
    with pending_files() as files:
        before = _together.set(files)
        try:
            yield
        finally:
            _together.reset(before)


def made_folders(folder: Path) -> list[Path]:
    """Make a folder and those that it lies in, and tell which were not there.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    list of Path
        The outermost first.

    Raises
    ------
    OSError
        It cannot be made; none that was made is left.
    """
    missing = [one for one in (folder, *folder.parents) if not one.exists()][::-1]
    made = []
    try:
        for one in missing:
            one.mkdir(exist_ok=True)
            made.append(one)
        # A file may be in the way.
        folder.mkdir(exist_ok=True)
    except OSError:
        for one in reversed(made):
            with suppress(OSError):
                one.rmdir()
        raise
    return made


def force_all(files: Iterable[Path], names: Iterable[Path]) -> None:
    """Wait until the contents of files are on the disk.

    Parameters
    ----------
    files : iterable of Path
    names : iterable of Path
        What each is called in messages.

    Raises
    ------
    InputError
        One of them cannot be brought there.
    """
    pairs = list(zip(files, names, strict=True))

    def force(pair: tuple[Path, Path]) -> None:
        with _sentence(pair[1]):
            force_file(pair[0])

    if len(pairs) < 2:
        for one in pairs:
            force(one)
        return
    with ThreadPoolExecutor(min(_AT_ONCE, len(pairs))) as pool:
        for _ in pool.map(force, pairs):
            pass


def unwritten(path: Path, error: OSError) -> InputError:
    """Say in a sentence that a file cannot be written.

    Parameters
    ----------
    path : Path
    error : OSError

    Returns
    -------
    InputError
    """
    return InputError(f"{path}: cannot be written ({error.strerror or error}); choose another place or make room.")


@contextmanager
def _sentence(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise unwritten(path, error) from error
