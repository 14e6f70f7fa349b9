"""Paths as a study stores them: relative to its folder, or only a name if the path would reveal private folders."""

from __future__ import annotations

import os
import re
from pathlib import Path, PurePosixPath
from typing import Final

from cornercase._common.io.files import MAX_FILE_SIZE

# Largest number of `..` in a stored path.
_MAX_PARENT_STEPS: Final = 3


def format_stored_path(file: Path, study: Path) -> str:
    """Return the path of a file or folder as a study stores it.

    The path is relative to the folder of the study, with ``/`` between its parts. So a study stays the same if it is
    made in another place with the same files. Only the name of the file is stored if the relative path would reveal
    folders of the machine: if the path leads up more than three folders, or if the path leads up to the root of the
    file system, to the user's home or to a folder above the home, and then down into another folder.

    >>> format_stored_path(Path("/data/acc/scenarios/cut_in.xosc"), Path("/data/acc/results/s.db"))
    '../scenarios/cut_in.xosc'
    >>> format_stored_path(Path("/data/acc/cut_in.xosc"), Path("/tmp/s.db"))
    'cut_in.xosc'
    """
    # Keep the name of a link; resolve `..`.
    file = Path(os.path.abspath(file))
    name, folder, start = file.name, file.parent.resolve(), study.parent.resolve()
    try:
        relative = Path(os.path.relpath(folder, start))
    except ValueError:
        # There is no relative path to another drive.
        return name
    n_up = relative.parts.count("..")
    below = relative.parts[n_up:]
    if n_up:
        common = Path(os.path.commonpath([folder, start]))
        if n_up > _MAX_PARENT_STEPS or (below and (common.parent == common or _contains_home(common))):
            return name
    return (PurePosixPath(*relative.parts) / name).as_posix()


def resolve_stored_path(stored: str, study: Path) -> Path | None:
    """Return the scenario file that a result of `format_stored_path` leads to; None if there is no such file.

    A study may come from anyone. So only paths of the form that `format_stored_path` returns are followed, and only to
    OpenSCENARIO files of an accepted size.
    """
    parts = stored.split("/")
    n_up = parts.count("..")
    is_plain = all(part not in ("", ".") and not re.search(r"[\\:\x00-\x1f]", part) for part in parts)
    if not is_plain or n_up > _MAX_PARENT_STEPS or ".." in parts[n_up:] or not stored.lower().endswith(".xosc"):
        return None
    folders = (study.parent.resolve() / study.name).parents
    if n_up >= len(folders):
        return None
    file = folders[n_up].joinpath(*parts[n_up:])
    try:
        # Virtual files of the system have size 0.
        return file if file.is_file() and 0 < file.stat().st_size <= MAX_FILE_SIZE else None
    except OSError:
        return None


def _contains_home(folder: Path) -> bool:
    try:
        return Path.home().resolve().is_relative_to(folder)
    except (RuntimeError, OSError):
        return False
