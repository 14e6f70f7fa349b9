"""The folder of a reduced set: it holds the earlier set or the new one, never parts of both.

The new set is written into a hidden folder within it first. That ``manifest.json`` gets its place is the moment from
which the new set counts. Its other files follow from the hidden folder, which is called after the manifest; where that
was interrupted, whoever reads or writes the set next ends it.
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
from cornercase._common.files import read_file
from cornercase._common.pending_files import force_all, made_folders, unwritten
from cornercase._common.platform import force_folder, new_file_mode, replace_file

MANIFEST: Final = "manifest.json"
"""Name of the file that says what is kept."""

# What begins the names of hidden folders; what follows, of one that is not complete and of one that is.
_HIDDEN: Final = ".cornercase-"
_BEGUN: Final = f"{_HIDDEN}new-"
_COMPLETE: Final = re.compile(re.escape(_HIDDEN) + "[0-9a-f]{16}")
# In it the manifest of the set that is replaced.
_EARLIER: Final = "earlier.json"
_BROKEN: Final = (ValueError, LookupError, TypeError, AttributeError, RecursionError)


class SetFolder:
    """A folder whose set is about to be replaced; `replaced_set` makes one.

    Parameters
    ----------
    folder, hidden : Path
        The folder, and the one in it that the new set is written into.
    """

    def __init__(self, folder: Path, hidden: Path) -> None:
        self._folder, self._hidden = folder, hidden
        self._counts = False
        self._digests: dict[str, str] = {}
        earlier = folder / MANIFEST
        self._earlier = _read(earlier) if earlier.exists() else {}
        if not isinstance(self._earlier.get("scenarios"), list):
            self._require_free(earlier)

    @property
    def digests(self) -> Mapping[str, str]:
        """SHA-256 of each file that was added, by its place."""
        return dict(sorted(self._digests.items()))

    def add(self, place: str, content: bytes) -> None:
        """Write a file of the new set.

        Parameters
        ----------
        place : str
            From the folder, with ``/`` between its parts.
        content : bytes
            A file that is added again has to hold the same.

        Raises
        ------
        InputError
            It cannot be written, or a file has its place that no set put there.
        """
        digest = hashlib.sha256(content).hexdigest()
        if self._digests.get(place) == digest:
            return
        target = self._folder / place
        folders = [one for one in target.parents if one != self._folder and one.is_relative_to(self._folder)]
        if (target.exists() and not target.is_file()) or any(one.exists() and not one.is_dir() for one in folders):
            raise InputError(f"`folder` {target}: something else has its name there; choose another folder.")
        if place not in _files_of(self._earlier) and not (target.is_file() and read_file(target) == content):
            self._require_free(target)
        _write(self._hidden / place, content, target)
        self._digests[place] = digest

    def seal(self, manifest: Mapping[str, Any]) -> None:
        """Write the manifest of the new set, and wait until all of it is on the disk.

        Parameters
        ----------
        manifest : mapping of str to object
            Plain values.

        Raises
        ------
        InputError
            It cannot be written.
        """
        content = (json.dumps(manifest, indent=2) + "\n").encode()
        earlier = self._folder / MANIFEST
        _write(self._hidden / MANIFEST, content, earlier)
        if earlier.is_file():
            _write(self._hidden / _EARLIER, read_file(earlier), earlier)
        files = [one for one in sorted(self._hidden.rglob("*")) if one.is_file()]
        force_all(files, [self._folder / one.relative_to(self._hidden) for one in files])
        complete = self._folder / _hidden_name(content)
        try:
            for one in (self._hidden, *(one for one in self._hidden.rglob("*") if one.is_dir())):
                force_folder(one)
            # The same set may be written once more.
            if complete.is_dir() and not complete.is_symlink():
                shutil.rmtree(complete)
            replace_file(self._hidden, complete)
        except OSError as error:
            raise unwritten(self._folder, error) from error
        self._hidden = complete

    def replace(self) -> None:
        """Let the new set take the place of the earlier one.

        Raises
        ------
        InputError
            It cannot; the earlier one is still there.
        """
        try:
            force_folder(self._folder)
            replace_file(self._hidden / MANIFEST, self._folder / MANIFEST)
        except OSError as error:
            raise unwritten(self._folder, error) from error
        self._counts = True

    def discard(self) -> None:
        """Remove what was written of the new set, unless it counts already."""
        if not self._counts:
            shutil.rmtree(self._hidden, ignore_errors=True)

    def _require_free(self, target: Path) -> None:
        if target.exists() or target.is_symlink():
            raise InputError(
                f"`folder` {target}: does not belong to an earlier set; choose another folder, or remove the file."
            )


@contextmanager
def replaced_set(folder: Path) -> Iterator[SetFolder]:
    """Give a folder to write a set into; the earlier one stays unless the block replaces it.

    Files that belong to neither stay as they are.

    Parameters
    ----------
    folder : Path
        Made where it is missing.

    Yields
    ------
    SetFolder

    Raises
    ------
    InputError
        It cannot be written.
    """
    made: list[Path] = []
    try:
        made = made_folders(folder)
        finish_set(folder)
        _clear(folder)
        hidden = Path(tempfile.mkdtemp(prefix=_BEGUN, dir=folder))
    except OSError as error:
        _remove_empty(made)
        raise unwritten(folder, error) from error
    try:
        new = SetFolder(folder, hidden)
    except BaseException:
        shutil.rmtree(hidden, ignore_errors=True)
        raise
    try:
        yield new
        finish_set(folder)
        for one in made:
            force_folder(one.parent)
    except OSError as error:
        raise unwritten(folder, error) from error
    finally:
        new.discard()
        _remove_empty(made)


def finish_set(folder: Path) -> None:
    """End the replacing of a set, where it was interrupted.

    Parameters
    ----------
    folder : Path
        Of a reduced set, or any other.

    Raises
    ------
    InputError
        It cannot be ended, or its hidden folder is not one that cornercase wrote.
    """
    manifest = folder / MANIFEST
    if not manifest.is_file() or not _is_replacing(folder):
        return
    hidden = folder / _hidden_name(read_file(manifest))
    new, earlier = _files_of(_read(manifest)), _read(hidden / _EARLIER) if (hidden / _EARLIER).is_file() else {}
    if not new:
        return
    try:
        # What follows would be of no set if this were lost.
        force_folder(folder)
        for place in new:
            source, target = _within(hidden, place), _within(folder, place)
            # Another process may be ending it too.
            if source.is_file():
                target.parent.mkdir(parents=True, exist_ok=True)
                with suppress(FileNotFoundError):
                    replace_file(source, target)
        for one in {(folder / place).parent for place in new} | {folder}:
            force_folder(one)
        _remove_earlier(folder, earlier, new)
        shutil.rmtree(hidden, ignore_errors=True)
    except OSError as error:
        raise InputError(
            f"{folder}: the set in it is incomplete, and cannot be completed ({error.strerror or error}); make the"
            " folder writable, and run the command again."
        ) from error


def _remove_earlier(folder: Path, earlier: Mapping[str, Any], new: Mapping[str, str]) -> None:
    """Remove scenario files of the earlier set, unless somebody has changed them since."""
    digests, kept = _files_of(earlier), {place.casefold() for place in new}
    for place in [str(one["file"]) for one in earlier["scenarios"]] if digests else ():
        if place not in digests or place.casefold() in kept:
            continue
        file = _within(folder, place)
        with suppress(FileNotFoundError):
            if file.is_file() and hashlib.sha256(read_file(file)).hexdigest() == digests[place]:
                file.unlink()


def _is_replacing(folder: Path) -> bool:
    hidden = folder / _hidden_name(read_file(folder / MANIFEST))
    # What lies in it besides is of a set that was discarded.
    return hidden.is_dir() and not hidden.is_symlink() and not (hidden / MANIFEST).exists()


def _hidden_name(manifest: bytes) -> str:
    return f"{_HIDDEN}{hashlib.sha256(manifest).hexdigest()[:16]}"


def _clear(folder: Path) -> None:
    """Remove what was begun and never counted."""
    for one in folder.glob(f"{_HIDDEN}*"):
        if (one.name.startswith(_BEGUN) or _COMPLETE.fullmatch(one.name)) and one.is_dir() and not one.is_symlink():
            shutil.rmtree(one, ignore_errors=True)


def _write(path: Path, content: bytes, target: Path) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
        path.chmod(new_file_mode())
    except OSError as error:
        raise unwritten(target, error) from error


def _read(manifest: Path) -> dict[str, Any]:
    """What a manifest holds; nothing where it is none."""
    # One that cannot be read is not taken for one that says nothing, as what it names would be given up.
    content = read_file(manifest)
    try:
        plain = json.loads(content)
    except (ValueError, RecursionError):
        return {}
    return plain if isinstance(plain, dict) else {}


def _files_of(manifest: Mapping[str, Any]) -> dict[str, str]:
    """Digest of each file of a set by its place; an early version gave none for its scenarios."""
    try:
        named = {str(one["file"]): "" for one in manifest["scenarios"]}
        return named | {str(place): str(digest) for place, digest in manifest.get("files", {}).items()}
    except _BROKEN:
        return {}


def _within(folder: Path, place: str) -> Path:
    """Where a file of a set is; the folder may come from anywhere, and names nothing outside of it."""
    file = folder / place
    parts = re.split(r"[\\/]", place)
    if any(
        part in ("", ".", "..") or ":" in part or "\0" in part for part in parts
    ) or not file.parent.resolve().is_relative_to(folder.resolve()):
        raise InputError(f"{folder}: names {place[:100]}, which is not a file in it; run `reduce` again.")
    return file


def _remove_empty(made: list[Path]) -> None:
    for one in reversed(made):
        with suppress(OSError):
            one.rmdir()
