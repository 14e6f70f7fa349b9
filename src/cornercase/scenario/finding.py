"""A scenario file by its content, where only its name and its digest are known."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import Final

from cornercase._common.errors import InputError
from cornercase.scenario.openscenario import Scenario
from cornercase.scenario.space import ParameterSpace
from cornercase.scenario.varied_roads import with_roads

# How deep below a folder, and how many files and folders of one folder, are looked at.
_DEEPEST: Final = 2
_MOST: Final = 1000


def find_scenario(
    name: str, fingerprint: str, folders: Iterable[Path], space: ParameterSpace
) -> Scenario | Path | None:
    """Find a scenario file in folders and up to two levels below them.

    Only what these folders hold is looked at. The name is compared with theirs and never opened as a path.

    Parameters
    ----------
    name : str
        Of the file, without folders. In the folders themselves a file of any name is taken.
    fingerprint : str
        As `LogicalScenario.fingerprint`.
    folders : iterable of Path
    space : ParameterSpace
        What is varied; it may name road files.

    Returns
    -------
    Scenario, Path or None
        The first folder counts that has a file with the fingerprint, or one of the name: then the path of the latter,
        which was changed. None where there is neither.
    """
    for folder in folders:
        other = None
        for file in _candidates(name, folder):
            if (scenario := scenario_of(file, fingerprint, space)) is not None:
                return scenario
            if other is None and file.name == name:
                other = file
        if other is not None:
            return other
    return None


def scenario_of(file: Path, fingerprint: str, space: ParameterSpace) -> Scenario | None:
    """Read a file, where that is the scenario file of a fingerprint.

    Parameters
    ----------
    file : Path
    fingerprint : str
        As `LogicalScenario.fingerprint`.
    space : ParameterSpace
        What is varied; it may name road files.

    Returns
    -------
    Scenario or None
        None where it has another one, or cannot be read.
    """
    try:
        scenario = with_roads(Scenario(file), space)
        return scenario if scenario.fingerprint() == fingerprint else None
    except InputError:
        # What cannot be read is not the one.
        return None


def _candidates(name: str, top: Path) -> Iterator[Path]:
    level = [top]
    for depth in range(_DEEPEST + 1):
        below = []
        for folder in level:
            for entry in _entries(folder):
                if entry.is_dir():
                    # A link may lead anywhere.
                    below += [] if entry.is_symlink() else [entry]
                elif entry.name == name or (depth == 0 and entry.suffix == ".xosc"):
                    yield entry
        level = below[:_MOST]


def _entries(folder: Path) -> list[Path]:
    try:
        return sorted(islice(folder.iterdir(), _MOST))
    except OSError:
        return []
