"""Road files that scenarios name without saying where they are, as those for CARLA do."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from cornercase._common.errors import InputError

MAPS_VARIABLE: Final = "CORNERCASE_MAPS"
"""Environment variable with the folders of maps, parted as those of PATH are."""

_ENDING: Final = ".xodr"
# CARLA has each of its towns once more, with layers that can be switched off; the roads are the same.
_LAYERED: Final = "_Opt"
_CARLA: Final = re.compile(r"Town\d\d(HD)?(_Opt)?")
_NETWORK: Final = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+:|//|\\\\")


def is_network_address(text: str) -> bool:
    """Tell whether a text names something on another machine."""
    return _NETWORK.match(text) is not None


@contextmanager
def looking_in(folders: Sequence[Path]) -> Iterator[None]:
    """Look for maps in folders before those of the environment variable, here and in processes that begin meanwhile.

    Parameters
    ----------
    folders : sequence of Path

    Yields
    ------
    None

    Raises
    ------
    InputError
        One is not a folder of this machine, or one of the variable is not.
    """
    for folder in folders:
        _require_folder("`maps`", str(folder))
        if os.pathsep in str(folder):
            raise InputError(f"`maps` {folder}: has '{os.pathsep}' in its name, which parts folders; rename it.")
    before = os.environ.get(MAPS_VARIABLE)
    map_folders()
    if folders:
        every = [*(str(Path(folder).absolute()) for folder in folders), *([before] if before else [])]
        os.environ[MAPS_VARIABLE] = os.pathsep.join(every)
    try:
        yield
    finally:
        if folders and before is None:
            os.environ.pop(MAPS_VARIABLE, None)
        elif before is not None:
            os.environ[MAPS_VARIABLE] = before


def map_folders() -> tuple[Path, ...]:
    """Folders of maps, in the order in which they are looked through.

    Returns
    -------
    tuple of Path

    Raises
    ------
    InputError
        One that the environment variable names is not a folder of this machine.
    """
    named = [one for one in os.environ.get(MAPS_VARIABLE, "").split(os.pathsep) if one.strip()]
    for one in named:
        _require_folder(MAPS_VARIABLE, one)
    return tuple(map(Path, named))


def find_map(reference: str, beside: Path) -> Path | None:
    """Find the road file of a map that a scenario names, where nothing is at the place that it names.

    Parameters
    ----------
    reference : str
        As it stands in the scenario: ``"Town01"``, ``"/Game/Carla/Maps/Town01"``, ``"maps/Town01.xodr"``.
    beside : Path
        Folder of the scenario, which is looked at first.

    Returns
    -------
    Path or None
        Of the first folder that has it; None where none has.

    Raises
    ------
    InputError
        The environment variable names what is not a folder of this machine.
    """
    name = map_name(reference)
    names = [one for one in dict.fromkeys((name, name.removesuffix(_LAYERED))) if one.strip(". ")]
    for folder in (beside, *map_folders()) if names else ():
        for one in names:
            # As maps lie in CARLA's own folder, too.
            for place in ((), ("OpenDrive",), (one, "OpenDrive")):
                file = folder.joinpath(*place, f"{one}{_ENDING}")
                if file.is_file():
                    return file
    return None


def map_name(reference: str) -> str:
    """Name of a map, without the folders and the ending of the file that a scenario names."""
    return reference.replace("\\", "/").rstrip("/").rpartition("/")[2].removesuffix(_ENDING)


def way_to_map(reference: str) -> str:
    """Say how to get a road file that is not there.

    Parameters
    ----------
    reference : str
        As it stands in the scenario.

    Returns
    -------
    str
        A part of a sentence, without a full stop.
    """
    name = map_name(reference).removesuffix(_LAYERED)
    ways = f"name its folder by --maps FOLDER or in the environment variable {MAPS_VARIABLE}"
    if _CARLA.fullmatch(name):
        return (
            f"it is a map of CARLA, whose road file is CarlaUE4/Content/Carla/Maps/OpenDrive/{name}{_ENDING} where"
            f" CARLA is installed; {ways}"
        )
    return f"put it there, or {ways}"


def _require_folder(what: str, name: str) -> None:
    if is_network_address(name):
        raise InputError(f"{what} {name}: is a network address; name a folder of this machine.")
    if not Path(name).is_dir():
        raise InputError(f"{what} {name}: there is no such folder; name one with road files ({_ENDING}).")
