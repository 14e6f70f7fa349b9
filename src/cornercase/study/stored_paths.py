"""How a study names files: by their way from its folder, or by their names where that would tell how somebody's lie."""

from __future__ import annotations

import os
import re
from pathlib import Path, PurePosixPath
from typing import Final

from cornercase._common.files import LARGEST

# Folders that a way leads up.
_HIGHEST: Final = 3


def stored_path(file: Path, study: Path) -> str:
    """Name a file or folder as a study stores it.

    Its path is relative to the study's folder, with ``/`` between its parts, so that the same files elsewhere make the
    same study. Where it would lead up more than three folders, or down again from the root of the file system or from
    the user's home or above, it tells how the folders of a machine lie: then the name has to do.

    Parameters
    ----------
    file : Path
        The file or folder.
    study : Path
        The study's file.

    Returns
    -------
    str

    Examples
    --------
    >>> stored_path(Path("/data/acc/scenarios/cut_in.xosc"), Path("/data/acc/results/s.db"))
    '../scenarios/cut_in.xosc'
    >>> stored_path(Path("/data/acc/cut_in.xosc"), Path("/tmp/s.db"))
    'cut_in.xosc'
    """
    # A link has the name by which it was given; `..` has none.
    file = Path(os.path.abspath(file))
    name, folder, start = file.name, file.parent.resolve(), study.parent.resolve()
    try:
        way = Path(os.path.relpath(folder, start))
    except ValueError:
        # Of another drive there is no way from here.
        return name
    ups = way.parts.count("..")
    down = way.parts[ups:]
    if ups:
        common = Path(os.path.commonpath([folder, start]))
        if ups > _HIGHEST or (down and (common.parent == common or _is_home_or_above(common))):
            return name
    return (PurePosixPath(*way.parts) / name).as_posix()


def file_named(stored: str, study: Path) -> Path | None:
    """Find the file that a study names by its way from the study's folder.

    The study may come from anywhere: only a way that `stored_path` gives is gone, and only an OpenSCENARIO file of a
    size that is read is found at its end.

    Parameters
    ----------
    stored : str
        What `stored_path` gave.
    study : Path
        The study's file.

    Returns
    -------
    Path or None
        None where there is none, or the path is absolute.
    """
    parts = stored.split("/")
    ups = parts.count("..")
    plain = all(part not in ("", ".") and not re.search(r"[\\:\x00-\x1f]", part) for part in parts)
    if not plain or ups > _HIGHEST or ".." in parts[ups:] or not stored.lower().endswith(".xosc"):
        return None
    folders = (study.parent.resolve() / study.name).parents
    if ups >= len(folders):
        return None
    file = folders[ups].joinpath(*parts[ups:])
    try:
        # What the system makes up as it is read has no size.
        return file if file.is_file() and 0 < file.stat().st_size <= LARGEST else None
    except OSError:
        return None


def _is_home_or_above(folder: Path) -> bool:
    try:
        return Path.home().resolve().is_relative_to(folder)
    except (RuntimeError, OSError):
        return False
