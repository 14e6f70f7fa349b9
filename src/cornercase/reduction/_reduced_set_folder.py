"""Folder of a reduced set, replaced atomically: it holds the earlier set or the new set, never parts of both.

The new set is first written into a hidden subfolder, whose name is derived from the manifest. Then its
``manifest.json`` is moved into the folder; from this moment the new set counts. Last, the other files are moved into
the folder. If these moves are interrupted, the next reader or writer of the set completes them.
"""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final

from cornercase._common.errors import InputError
from cornercase._common.io.atomic import fsync_all, make_folders, unwritable_file_error
from cornercase._common.io.files import read_file
from cornercase._common.platform import fsync_folder, new_file_mode, replace_file

MANIFEST: Final = "manifest.json"
"""Name of the file that lists the selected scenarios."""

# Names of hidden folders: common prefix, prefix of incomplete folders, and pattern of complete folders.
_HIDDEN_PREFIX: Final = ".cornercase-"
_INCOMPLETE_PREFIX: Final = f"{_HIDDEN_PREFIX}new-"
_COMPLETE_PATTERN: Final = re.compile(re.escape(_HIDDEN_PREFIX) + "[0-9a-f]{16}")
# Manifest of the replaced set, within the hidden folder.
_EARLIER_MANIFEST: Final = "earlier.json"
_MALFORMED_ERRORS: Final = (ValueError, LookupError, TypeError, AttributeError, RecursionError)


class ReducedSetFolder:
    """Folder whose reduced set is about to be replaced by a new set; the new files are in the subfolder `hidden`."""

    def __init__(self, folder: Path, hidden: Path) -> None:
        self._folder, self._hidden = folder, hidden
        self._is_replaced = False
        self._digests: dict[str, str] = {}
        earlier = folder / MANIFEST
        self._earlier = _read_manifest(earlier) if earlier.exists() else {}
        if not isinstance(self._earlier.get("scenarios"), list):
            self._refuse_to_overwrite(earlier)

    @property
    def digests(self) -> Mapping[str, str]:
        """SHA-256 of each file that was added, by path relative to the folder."""
        return dict(sorted(self._digests.items()))

    def add(self, relative_path: str, content: bytes) -> None:
        """Write a file of the new set; InputError if a file that belongs to no set would be overwritten.

        `relative_path` is the path of the file relative to the folder, with ``/`` as separator. A path may be added
        again with the same content.
        """
        digest = hashlib.sha256(content).hexdigest()
        if self._digests.get(relative_path) == digest:
            return
        target = self._folder / relative_path
        parents = [
            parent for parent in target.parents if parent != self._folder and parent.is_relative_to(self._folder)
        ]
        if (target.exists() and not target.is_file()) or any(
            parent.exists() and not parent.is_dir() for parent in parents
        ):
            raise InputError(
                f"`folder` {target}: cannot be written, another file or folder is in the way; choose another folder."
            )
        if relative_path not in _file_digests(self._earlier) and not (
            target.is_file() and read_file(target) == content
        ):
            self._refuse_to_overwrite(target)
        _write(self._hidden / relative_path, content, target)
        self._digests[relative_path] = digest

    def write_manifest(self, manifest: Mapping[str, Any]) -> None:
        """Write the manifest of the new set, and flush all files of the set to disk."""
        content = (json.dumps(manifest, indent=2) + "\n").encode()
        manifest_path = self._folder / MANIFEST
        _write(self._hidden / MANIFEST, content, manifest_path)
        if manifest_path.is_file():
            _write(self._hidden / _EARLIER_MANIFEST, read_file(manifest_path), manifest_path)
        files = [path for path in sorted(self._hidden.rglob("*")) if path.is_file()]
        fsync_all(files, [self._folder / path.relative_to(self._hidden) for path in files])
        complete = self._folder / _hidden_name(content)
        try:
            for path in (self._hidden, *(path for path in self._hidden.rglob("*") if path.is_dir())):
                fsync_folder(path)
            # The same set may have been written before.
            if complete.is_dir() and not complete.is_symlink():
                shutil.rmtree(complete)
            replace_file(self._hidden, complete)
        except OSError as error:
            raise unwritable_file_error(self._folder, error) from error
        self._hidden = complete

    def replace(self) -> None:
        """Replace the earlier set by the new set; if an error occurs, the earlier set is unchanged."""
        try:
            fsync_folder(self._folder)
            replace_file(self._hidden / MANIFEST, self._folder / MANIFEST)
        except OSError as error:
            raise unwritable_file_error(self._folder, error) from error
        self._is_replaced = True

    def discard(self) -> None:
        """Remove the new set, unless it has replaced the earlier set."""
        if not self._is_replaced:
            shutil.rmtree(self._hidden, ignore_errors=True)

    def _refuse_to_overwrite(self, target: Path) -> None:
        if target.exists() or target.is_symlink():
            raise InputError(
                f"`folder` {target}: this file does not belong to an earlier set, so it is not overwritten; choose"
                " another folder, or remove the file."
            )


@contextmanager
def replace_reduced_set(folder: Path) -> Iterator[ReducedSetFolder]:
    """Write a new reduced set into a folder (context manager); the earlier set stays unless the block calls `replace`.

    The folder is created if necessary. Files that belong to neither set are left unchanged.
    """
    created: list[Path] = []
    try:
        created = make_folders(folder)
        complete_replacement(folder)
        _remove_discarded(folder)
        hidden = Path(tempfile.mkdtemp(prefix=_INCOMPLETE_PREFIX, dir=folder))
    except OSError as error:
        _remove_empty_folders(created)
        raise unwritable_file_error(folder, error) from error
    try:
        set_folder = ReducedSetFolder(folder, hidden)
    except BaseException:
        shutil.rmtree(hidden, ignore_errors=True)
        raise
    try:
        yield set_folder
        complete_replacement(folder)
        for path in created:
            fsync_folder(path.parent)
    except OSError as error:
        raise unwritable_file_error(folder, error) from error
    finally:
        set_folder.discard()
        _remove_empty_folders(created)


def complete_replacement(folder: Path) -> None:
    """Complete an interrupted replacement of the reduced set in a folder."""
    manifest = folder / MANIFEST
    if not manifest.is_file() or not _is_replacement_interrupted(folder):
        return
    hidden = folder / _hidden_name(read_file(manifest))
    current, earlier = (
        _read_manifest(manifest),
        _read_manifest(hidden / _EARLIER_MANIFEST) if (hidden / _EARLIER_MANIFEST).is_file() else {},
    )
    if not isinstance(current.get("scenarios"), list):
        return
    new_files = _file_digests(current)
    try:
        # If the manifest were lost, the files that are moved below would belong to no set.
        fsync_folder(folder)
        for path in new_files:
            source, target = _safe_path(hidden, path), _safe_path(folder, path)
            # Another process may be completing the replacement, too.
            if source.is_file():
                target.parent.mkdir(parents=True, exist_ok=True)
                with suppress(FileNotFoundError):
                    replace_file(source, target)
        for parent in {(folder / path).parent for path in new_files} | {folder}:
            fsync_folder(parent)
        _remove_earlier_files(folder, earlier, new_files)
        shutil.rmtree(hidden, ignore_errors=True)
    except OSError as error:
        raise InputError(
            f"{folder}: an interrupted write of the reduced set in this folder cannot be completed"
            f" ({error.strerror or error}); make the folder writable, and run the command again."
        ) from error


def _remove_earlier_files(folder: Path, earlier_manifest: Mapping[str, Any], current_files: Mapping[str, str]) -> None:
    """Remove scenario files of the earlier set that the new set lacks, except files that were changed after writing."""
    digests, new_files = _file_digests(earlier_manifest), {path.casefold() for path in current_files}
    for path in [str(scenario["file"]) for scenario in earlier_manifest["scenarios"]] if digests else ():
        if path not in digests or path.casefold() in new_files:
            continue
        file = _safe_path(folder, path)
        with suppress(FileNotFoundError):
            if file.is_file() and hashlib.sha256(read_file(file)).hexdigest() == digests[path]:
                file.unlink()


def _is_replacement_interrupted(folder: Path) -> bool:
    hidden = folder / _hidden_name(read_file(folder / MANIFEST))
    # With a manifest in it, the folder belongs to a set that was discarded.
    return hidden.is_dir() and not hidden.is_symlink() and not (hidden / MANIFEST).exists()


def _hidden_name(manifest_content: bytes) -> str:
    return f"{_HIDDEN_PREFIX}{hashlib.sha256(manifest_content).hexdigest()[:16]}"


def _remove_discarded(folder: Path) -> None:
    """Remove hidden folders of replacements that were never completed."""
    for path in folder.glob(f"{_HIDDEN_PREFIX}*"):
        if (
            (path.name.startswith(_INCOMPLETE_PREFIX) or _COMPLETE_PATTERN.fullmatch(path.name))
            and path.is_dir()
            and not path.is_symlink()
        ):
            shutil.rmtree(path, ignore_errors=True)


def _write(path: Path, content: bytes, target: Path) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
        path.chmod(new_file_mode())
    except OSError as error:
        raise unwritable_file_error(target, error) from error


def _read_manifest(manifest: Path) -> dict[str, Any]:
    """Read a manifest; the result is empty if the file is not a manifest."""
    # An unreadable manifest is an error: if it counted as empty, the files that it lists would be forgotten.
    content = read_file(manifest)
    try:
        values = json.loads(content)
    except (ValueError, RecursionError):
        return {}
    return values if isinstance(values, dict) else {}


def _file_digests(manifest_values: Mapping[str, Any]) -> dict[str, str]:
    """Return the SHA-256 of each file of a set, by path.

    The digests are empty if an early version of cornercase wrote the set. A set of imported recordings has no files:
    its scenarios name the recordings, which are not in the folder.
    """
    try:
        scenario_files = {str(scenario["file"]): "" for scenario in manifest_values["scenarios"]}
        return {str(path): str(digest) for path, digest in manifest_values.get("files", scenario_files).items()}
    except _MALFORMED_ERRORS:
        return {}


def _safe_path(folder: Path, relative_path: str) -> Path:
    """Return the path of a file of a set; InputError if the path is outside the folder.

    The path comes from a manifest, which is not trusted.
    """
    file = folder / relative_path
    parts = re.split(r"[\\/]", relative_path)
    if any(
        part in ("", ".", "..") or ":" in part or "\0" in part for part in parts
    ) or not file.parent.resolve().is_relative_to(folder.resolve()):
        raise InputError(
            f"{folder}: the manifest lists {relative_path[:100]}, which is not a file in the folder; run `reduce`"
            " again."
        )
    return file


def _remove_empty_folders(folders: list[Path]) -> None:
    for path in reversed(folders):
        with suppress(OSError):
            path.rmdir()
