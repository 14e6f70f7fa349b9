"""Locate a scenario file of which only name and fingerprint are known."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import Final

from cornercase._common.errors import InputError
from cornercase.scenario.openscenario import Scenario
from cornercase.scenario.space import ParameterSpace
from cornercase.scenario.varied_roads import with_roads

# Search depth, and largest number of entries per folder and of folders per level.
_DEEPEST: Final = 2
_MOST: Final = 1000


def find_scenario(
    name: str, fingerprint: str, folders: Iterable[Path], space: ParameterSpace
) -> Scenario | Path | None:
    """Search folders, and two levels below them, for a scenario file with a fingerprint.

    Returns the first match; otherwise the path of a file of that name, which has been changed since; otherwise None.
    In the folders themselves any file name matches. `file_name` is only compared and never opened as a path.
    """
    for folder in folders:
        changed = None
        for file in _candidates(name, folder):
            if (scenario := scenario_of(file, fingerprint, space)) is not None:
                return scenario
            if changed is None and file.name == name:
                changed = file
        if changed is not None:
            return changed
    return None


def scenario_of(file: Path, fingerprint: str, space: ParameterSpace) -> Scenario | None:
    """Return the scenario of a file if it has the fingerprint; None if not, or if it cannot be read."""
    try:
        scenario = with_roads(Scenario(file), space)
        return scenario if scenario.fingerprint() == fingerprint else None
    except InputError:
        return None


def _candidates(name: str, top: Path) -> Iterator[Path]:
    level = [top]
    for depth in range(_DEEPEST + 1):
        subfolders = []
        for folder in level:
            for entry in _entries(folder):
                if entry.is_dir():
                    # Do not follow links.
                    subfolders += [] if entry.is_symlink() else [entry]
                elif entry.name == name or (depth == 0 and entry.suffix == ".xosc"):
                    yield entry
        level = subfolders[:_MOST]


def _entries(folder: Path) -> list[Path]:
    try:
        return sorted(islice(folder.iterdir(), _MOST))
    except OSError:
        return []
