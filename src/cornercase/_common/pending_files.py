"""Atomic writing: files get temporary names, and are renamed together once all are on the disk."""

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

# Parallel syncs get no faster beyond this.
_AT_ONCE: Final = 16
# Characters of the file's name in its temporary name, which may have 255 bytes.
_OF_THE_NAME: Final = 50
OF_SQLITE: Final = ("-journal", "-wal", "-shm")
"""Suffixes of the files that SQLite writes beside a database."""
# Suffix of temporary names.
_LEFT: Final = re.compile(rf"\.[0-9a-f]{{8}}-(\d{{1,9}})-[a-z0-9_]{{8}}({'|'.join(OF_SQLITE)})?$")


class PendingFiles:
    """Files that are written under temporary names and not renamed yet."""

    def __init__(self) -> None:
        self._temporary: dict[Path, Path] = {}
        self._made: list[Path] = []
        self._swept: set[Path] = set()

    def begin(self, path: Path) -> Path:
        """Make an empty temporary file next to `path`, with missing folders, and return its path."""
        # A file must not replace a folder, a pipe or a device.
        with _sentence(path):
            is_other = path.exists() and not path.is_file()
        if is_other:
            raise InputError(f"{path}: is not a file; choose another name.")
        # The target of a link is written; the link stays.
        try:
            path = path.resolve()
        except (OSError, RuntimeError) as error:
            raise InputError(f"{path}: is a broken link; choose another name.") from error
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
        """Sync all files to disk, then rename them. An `InputError` before that leaves all unrenamed."""
        mode = new_file_mode()
        for path, temporary in self._temporary.items():
            with _sentence(path):
                os.chmod(temporary, mode)
        force_all(self._temporary.values(), list(self._temporary))
        folders = {folder_made.parent for folder_made in self._made}
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
        """Remove the temporary files, and the folders that were made for them."""
        for temporary in self._temporary.values():
            for ending in ("", *OF_SQLITE):
                with suppress(OSError):
                    temporary.with_name(temporary.name + ending).unlink(missing_ok=True)
        for folder in reversed(self._made):
            # A folder that somebody else has put a file into stays.
            with suppress(OSError):
                folder.rmdir()
        self._temporary.clear()
        self._made.clear()

    def _sweep(self, folder: Path) -> None:
        """Remove temporary files of writers that were killed."""
        if folder in self._swept:
            return
        self._swept.add(folder)
        # A folder may be writable but not readable.
        with suppress(PermissionError):
            for entry in list(folder.iterdir()):
                match = _LEFT.search(entry.name)
                if match and match[0].startswith(f".{_mark(int(match[1]))}-") and not is_process(int(match[1])):
                    with suppress(OSError):
                        entry.unlink(missing_ok=True)


def _mark(process: int) -> str:
    """Mark of a writing process and its machine or container, which may share the folder with others."""
    return f"{crc32(f'{platform.node()} {_of_processes()}'.encode()):08x}-{process}"


@cache
def _of_processes() -> str:
    # Containers with the same name do not see each other's processes.
    try:
        return os.readlink("/proc/self/ns/pid")
    except OSError:
        return ""


_together: ContextVar[PendingFiles | None] = ContextVar("together", default=None)


@contextmanager
def pending_files() -> Iterator[PendingFiles]:
    """Yield the group of the enclosing `atomic_write_group`, or a new one that is renamed after the block."""
    group = _together.get()
    if group is not None:
        yield group
        return
    files = PendingFiles()
    try:
        yield files
        files.place()
    finally:
        files.discard()


@contextmanager
def written_together() -> Iterator[None]:
    """Rename all files that are written within the block at its end, or none if it fails.

    Many files are synced to disk this way in little more time than one.
    """
    with pending_files() as files:
        before = _together.set(files)
        try:
            yield
        finally:
            _together.reset(before)


def made_folders(folder: Path) -> list[Path]:
    """Make a folder with its parents, and return those that were missing, outermost first; all or none."""
    missing = [parent for parent in (folder, *folder.parents) if not parent.exists()][::-1]
    made = []
    try:
        for parent in missing:
            parent.mkdir(exist_ok=True)
            made.append(parent)
        # Fails if a file has this name.
        folder.mkdir(exist_ok=True)
    except OSError:
        for parent in reversed(made):
            with suppress(OSError):
                parent.rmdir()
        raise
    return made


def force_all(files: Iterable[Path], names: Iterable[Path]) -> None:
    """Sync files to disk in parallel. `names` are their names in messages."""
    pairs = list(zip(files, names, strict=True))

    def force(pair: tuple[Path, Path]) -> None:
        with _sentence(pair[1]):
            force_file(pair[0])

    if len(pairs) < 2:
        for single in pairs:
            force(single)
        return
    with ThreadPoolExecutor(min(_AT_ONCE, len(pairs))) as pool:
        for _ in pool.map(force, pairs):
            pass


def unwritten(path: Path, error: OSError) -> InputError:
    """The error that a file cannot be written."""
    return InputError(
        f"{path}: cannot be written ({error.strerror or error}); choose another location or free some space."
    )


@contextmanager
def _sentence(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise unwritten(path, error) from error
