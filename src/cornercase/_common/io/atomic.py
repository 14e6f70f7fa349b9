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
from cornercase._common.platform import (
    fsync_file,
    fsync_folder,
    is_process_running,
    new_file_mode,
    replace_file,
)

# Parallel syncs get no faster beyond this.
_MAX_THREADS: Final = 16
# Characters of the file's name in its temporary name, which may have 255 bytes.
_NAME_PREFIX_LENGTH: Final = 50
SQLITE_SUFFIXES: Final = ("-journal", "-wal", "-shm")
"""Suffixes of the files that SQLite writes beside a database."""
# Suffix of temporary names.
_TEMPORARY_NAME: Final = re.compile(rf"\.[0-9a-f]{{8}}-(\d{{1,9}})-[a-z0-9_]{{8}}({'|'.join(SQLITE_SUFFIXES)})?$")


class AtomicWriteGroup:
    """Files that are written under temporary names, and renamed together once all are complete."""

    def __init__(self) -> None:
        self._temporary_paths: dict[Path, Path] = {}
        self._new_folders: list[Path] = []
        self._swept_folders: set[Path] = set()

    def add_file(self, path: Path) -> Path:
        """Make an empty temporary file next to `path`, and folders that are missing; return the path of this file.

        If `path` is a link, the temporary file is next to the target of the link. If `path` was added before, its
        temporary file is returned unchanged.
        """
        # A file must not replace a folder, a pipe or a device.
        with _convert_write_errors(path):
            is_other = path.exists() and not path.is_file()
        if is_other:
            raise InputError(f"{path}: is not a file; choose another name.")
        # The target of a link is written; the link stays.
        try:
            path = path.resolve()
        except (OSError, RuntimeError) as error:
            raise InputError(f"{path}: is a broken link; choose another name.") from error
        earlier = self._temporary_paths.get(path)
        if earlier is not None:
            return earlier
        try:
            self._new_folders += make_folders(path.parent)
            self._remove_leftovers(path.parent)
            prefix = f".{path.name[:_NAME_PREFIX_LENGTH]}.{_process_mark(os.getpid())}-"
            handle, name = tempfile.mkstemp(prefix=prefix, dir=path.parent)
            self._temporary_paths[path] = Path(name)
            os.close(handle)
        except OSError as error:
            raise unwritable_file_error(path, error) from error
        return self._temporary_paths[path]

    def commit(self) -> None:
        """Sync all files to disk, then rename them; if syncing fails, raise `InputError` and rename none."""
        mode = new_file_mode()
        for path, temporary in self._temporary_paths.items():
            with _convert_write_errors(path):
                os.chmod(temporary, mode)
        fsync_all(self._temporary_paths.values(), list(self._temporary_paths))
        folders = {folder_made.parent for folder_made in self._new_folders}
        for path, temporary in list(self._temporary_paths.items()):
            with _convert_write_errors(path):
                replace_file(temporary, path)
            del self._temporary_paths[path]
            folders.add(path.parent)
        self._new_folders.clear()
        for folder in sorted(folders):
            with _convert_write_errors(folder):
                fsync_folder(folder)

    def discard(self) -> None:
        """Remove the temporary files, and the folders that were made for them."""
        for temporary in self._temporary_paths.values():
            for ending in ("", *SQLITE_SUFFIXES):
                with suppress(OSError):
                    temporary.with_name(temporary.name + ending).unlink(missing_ok=True)
        for folder in reversed(self._new_folders):
            # A folder that somebody else has put a file into stays.
            with suppress(OSError):
                folder.rmdir()
        self._temporary_paths.clear()
        self._new_folders.clear()

    def _remove_leftovers(self, folder: Path) -> None:
        """Remove temporary files of processes that were killed while they were writing."""
        if folder in self._swept_folders:
            return
        self._swept_folders.add(folder)
        # A folder may be writable but not readable.
        with suppress(PermissionError):
            for entry in list(folder.iterdir()):
                match = _TEMPORARY_NAME.search(entry.name)
                if (
                    match
                    and match[0].startswith(f".{_process_mark(int(match[1]))}-")
                    and not is_process_running(int(match[1]))
                ):
                    with suppress(OSError):
                        entry.unlink(missing_ok=True)


def _process_mark(process_id: int) -> str:
    """Return a text that identifies a writing process and its machine or container.

    Other machines may write into the same folder.
    """
    return f"{crc32(f'{platform.node()} {_process_namespace()}'.encode()):08x}-{process_id}"


@cache
def _process_namespace() -> str:
    # Containers with the same name do not see each other's processes.
    try:
        return os.readlink("/proc/self/ns/pid")
    except OSError:
        return ""


_current_group: ContextVar[AtomicWriteGroup | None] = ContextVar("together", default=None)


@contextmanager
def current_or_new_group() -> Iterator[AtomicWriteGroup]:
    """Yield the group of the enclosing `atomic_write_group`, or a new group that is committed after the block."""
    group = _current_group.get()
    if group is not None:
        yield group
        return
    files = AtomicWriteGroup()
    try:
        yield files
        files.commit()
    finally:
        files.discard()


@contextmanager
def atomic_write_group() -> Iterator[None]:
    """At the end of the block, rename all files that were written within the block; rename none if the block fails.

    Within another `atomic_write_group`, the files are renamed at the end of the outer block. Syncing many files to disk
    together takes little more time than syncing one.
    """
    with current_or_new_group() as files:
        before = _current_group.set(files)
        try:
            yield
        finally:
            _current_group.reset(before)


def make_folders(folder: Path) -> list[Path]:
    """Make a folder with its parents, and return the folders that were missing, outermost first.

    If one of them cannot be made, the others are removed again.
    """
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


def fsync_all(files: Iterable[Path], names: Iterable[Path]) -> None:
    """Sync files to disk in parallel; `names` are the paths that error messages show instead of `files`."""
    pairs = list(zip(files, names, strict=True))

    def fsync_one(pair: tuple[Path, Path]) -> None:
        with _convert_write_errors(pair[1]):
            fsync_file(pair[0])

    if len(pairs) < 2:
        for single in pairs:
            fsync_one(single)
        return
    with ThreadPoolExecutor(min(_MAX_THREADS, len(pairs))) as pool:
        for _ in pool.map(fsync_one, pairs):
            pass


def unwritable_file_error(path: Path, error: OSError) -> InputError:
    """Return the `InputError` that says that a file cannot be written, and why."""
    return InputError(
        f"{path}: cannot be written ({error.strerror or error}); choose another location or free some space."
    )


@contextmanager
def _convert_write_errors(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise unwritable_file_error(path, error) from error
