"""A scenario with all of its files, to be read on another machine."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from cornercase._common.errors import InputError
from cornercase.scenario.openscenario import Scenario


@dataclass(frozen=True)
class ScenarioParcel:
    """Content of a scenario file and of the files that belong to it, as they were when they were read.

    Attributes
    ----------
    folder : str
        Innermost folder that all of them lie in, where they were packed.
    files : mapping of str to bytes
        Content by the path in that folder, with ``/`` between its parts.
    main : str
        Path of the scenario file in that folder.
    roads : tuple of str
        Road files that a varied parameter names, as the scenario would name them.
    fingerprint : str
        That of the scenario.
    """

    folder: str
    files: Mapping[str, bytes]
    main: str
    roads: tuple[str, ...]
    fingerprint: str

    @classmethod
    def of(cls, scenario: Scenario) -> ScenarioParcel:
        """Pack a scenario.

        Parameters
        ----------
        scenario : Scenario

        Returns
        -------
        ScenarioParcel

        Raises
        ------
        InputError
            The scenario names a file by an absolute path, which other machines do not have, or different files by one.
        """
        contents = {scenario.road_near(file): content for file, content in scenario.contents().items()}
        for file in contents:
            if not _is_relative(file, scenario.path.parent):
                raise InputError(
                    f"{scenario.path}: names {file} by an absolute path, which other machines do not have; name it"
                    " relative to the scenario file."
                )
        places: dict[str, bytes] = {}
        for file, content in contents.items():
            # Where links are on the way, what two paths come to may differ.
            if places.setdefault(os.path.abspath(file), content) != content:
                raise InputError(f"{scenario.path}: names different files by one path, {file}; name each by its own.")
        try:
            folder = os.path.commonpath([os.path.dirname(place) for place in places])
        except ValueError as error:
            raise InputError(f"{scenario.path}: names files of several drives; put them on one.") from error
        return cls(
            folder=folder,
            files={_within(folder, place): content for place, content in places.items()},
            main=_within(folder, os.path.abspath(scenario.path)),
            roads=scenario.varied_roads,
            fingerprint=scenario.fingerprint(),
        )

    def unpack(self, folder: Path) -> Scenario:
        """Write the files, and give the scenario.

        Parameters
        ----------
        folder : Path
            An empty one.

        Returns
        -------
        Scenario
            Its fingerprint is that of the one that was packed.

        Raises
        ------
        InputError
            The files cannot be written.
        """
        for name, content in self.files.items():
            place = folder / name
            try:
                place.parent.mkdir(parents=True, exist_ok=True)
                place.write_bytes(content)
            except OSError as error:
                raise InputError(f"{place}: cannot be written ({error.strerror}); make room for it.") from error
        return Scenario(folder / self.main, self.fingerprint, self.roads)


def _is_relative(file: Path, folder: Path) -> bool:
    return file.parts[: len(folder.parts)] == folder.parts and (folder.is_absolute() or not file.is_absolute())


def _within(folder: str, place: str) -> str:
    return PurePosixPath(*Path(place).relative_to(folder).parts).as_posix()
