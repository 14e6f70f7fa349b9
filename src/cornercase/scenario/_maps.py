"""Find road files that scenarios refer to by the name of a map, such as CARLA's ``Town01``."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from cornercase._common.errors import InputError

MAPS_VARIABLE: Final = "CORNERCASE_MAPS"
"""Environment variable with the folders of maps, separated as in PATH."""

_ROAD_FILE_SUFFIX: Final = ".xodr"
# CARLA's layered variants of its towns have the same roads.
_LAYERED_MAP_SUFFIX: Final = "_Opt"
_CARLA_MAP_NAME: Final = re.compile(r"Town\d\d(HD)?(_Opt)?")
_NETWORK_ADDRESS: Final = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+:|//|\\\\")


def is_network_address(text: str) -> bool:
    """Return whether a text is the address of a file on another machine, such as ``https://…``."""
    return _NETWORK_ADDRESS.match(text) is not None


@contextmanager
def use_map_folders(folders: Sequence[Path]) -> Iterator[None]:
    """Within a ``with`` block, search `folders` for maps (road files that scenarios refer to by name).

    They are searched after the folder of the scenario, and before the folders in ``CORNERCASE_MAPS``. This also holds
    in child processes that start within the block.
    """
    for folder in folders:
        _require_folder("`maps`", str(folder))
        if os.pathsep in str(folder):
            raise InputError(f"`maps` {folder}: '{os.pathsep}' in its name would separate two folders; rename it.")
    previous = os.environ.get(MAPS_VARIABLE)
    read_map_folders()
    if folders:
        search_path = [*(str(Path(folder).absolute()) for folder in folders), *([previous] if previous else [])]
        os.environ[MAPS_VARIABLE] = os.pathsep.join(search_path)
    try:
        yield
    finally:
        if folders and previous is None:
            os.environ.pop(MAPS_VARIABLE, None)
        elif previous is not None:
            os.environ[MAPS_VARIABLE] = previous


def read_map_folders() -> tuple[Path, ...]:
    """Return the folders in ``CORNERCASE_MAPS``, in search order; raises `InputError` if a folder does not exist."""
    folders = [folder for folder in os.environ.get(MAPS_VARIABLE, "").split(os.pathsep) if folder.strip()]
    for folder in folders:
        _require_folder(MAPS_VARIABLE, folder)
    return tuple(map(Path, folders))


def find_map(reference: str, scenario_folder: Path) -> Path | None:
    """Search for the road file of a map in `scenario_folder` and then in the map folders; None if it is not found.

    `reference` is written as in the scenario: ``"Town01"``, ``"/Game/Carla/Maps/Town01"``, ``"maps/Town01.xodr"``.
    """
    name = map_name(reference)
    names = [stem for stem in dict.fromkeys((name, name.removesuffix(_LAYERED_MAP_SUFFIX))) if stem.strip(". ")]
    for folder in (scenario_folder, *read_map_folders()) if names else ():
        for stem in names:
            # The latter two as in CARLA's own folder.
            for subfolders in ((), ("OpenDrive",), (stem, "OpenDrive")):
                file = folder.joinpath(*subfolders, f"{stem}{_ROAD_FILE_SUFFIX}")
                if file.is_file():
                    return file
    return None


def map_name(reference: str) -> str:
    """Return the name of a map, without folders and file extension."""
    return reference.replace("\\", "/").rstrip("/").rpartition("/")[2].removesuffix(_ROAD_FILE_SUFFIX)


def describe_how_to_get_map(reference: str) -> str:
    """Return a part of a sentence that tells the user how to provide a missing road file."""
    name = map_name(reference).removesuffix(_LAYERED_MAP_SUFFIX)
    options = f"name its folder by --maps FOLDER or in the environment variable {MAPS_VARIABLE}"
    if _CARLA_MAP_NAME.fullmatch(name):
        return (
            f"it is a map of CARLA, whose road file is"
            f" CarlaUE4/Content/Carla/Maps/OpenDrive/{name}{_ROAD_FILE_SUFFIX} where"
            f" CARLA is installed; {options}"
        )
    return f"put it there, or {options}"


def _require_folder(option: str, name: str) -> None:
    if is_network_address(name):
        raise InputError(f"{option} {name}: is a network address; name a folder of this machine.")
    if not Path(name).is_dir():
        raise InputError(f"{option} {name}: there is no such folder; name one with road files ({_ROAD_FILE_SUFFIX}).")
