"""Find the scenario file of a study, from its file name and fingerprint."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import Final

from cornercase._common.errors import InputError
from cornercase.scenario._file import ScenarioFile
from cornercase.scenario._space import ParameterSpace
from cornercase.scenario._varied_road_files import add_varied_roads

# Search depth, and largest number of entries per folder and of folders per level.
_MAX_DEPTH: Final = 2
_MAX_ENTRIES: Final = 1000


def find_scenario_file(
    file_name: str, fingerprint: str, folders: Iterable[Path], space: ParameterSpace
) -> tuple[ScenarioFile | None, list[Path]]:
    """Search folders, down to two levels below them, for the scenario file with the given fingerprint.

    Return the scenario (None if it is not found), and the files that have the given name, but have another fingerprint
    or cannot be read. Directly in `folders`, any ``.xosc`` file can match; below, only files with the given name.
    `file_name` is only compared with the names of files, and never opened as a path, since a study may be untrusted.
    """
    changed: list[Path] = []
    for folder in folders:
        for file in _candidate_files(file_name, folder):
            if (scenario := read_if_fingerprint_matches(file, fingerprint, space)) is not None:
                return scenario, changed
            if file.name == file_name:
                changed.append(file)
    return None, changed


def read_if_fingerprint_matches(path: Path, fingerprint: str, space: ParameterSpace) -> ScenarioFile | None:
    """Return the scenario in a file if its fingerprint matches; None for another fingerprint or an unreadable file."""
    try:
        scenario = add_varied_roads(ScenarioFile(path), space)
        return scenario if scenario.fingerprint() == fingerprint else None
    except (InputError, OSError):
        return None


def find_files_below(folder: Path, file_name: str) -> Iterator[Path]:
    """Yield the files with the given name in a folder and down to two levels below it, the upper levels first."""
    return (file for file in _candidate_files(file_name, folder) if file.name == file_name)


def _candidate_files(file_name: str, folder: Path) -> Iterator[Path]:
    level = [folder]
    for depth in range(_MAX_DEPTH + 1):
        subfolders = []
        for current in level:
            for entry in _list_folder(current):
                if _is_folder(entry):
                    # Do not follow links.
                    subfolders += [] if entry.is_symlink() else [entry]
                elif entry.name == file_name or (depth == 0 and entry.suffix == ".xosc"):
                    yield entry
        level = subfolders[:_MAX_ENTRIES]


def _is_folder(entry: Path) -> bool:
    try:
        return entry.is_dir()
    except OSError:
        # A link whose target this user may not read.
        return False


def _list_folder(folder: Path) -> list[Path]:
    try:
        return sorted(islice(folder.iterdir(), _MAX_ENTRIES))
    except OSError:
        return []
