"""A scenario with all of its files, packed for use on another machine."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from cornercase._common.errors import InputError
from cornercase.scenario._file import ScenarioFile


@dataclass(frozen=True)
class ScenarioBundle:
    """Contents of a scenario file and of all files that it needs, as they were first read.

    `files` has the content of each file, by its path relative to `common_folder` (with ``/``). `scenario_path` is this
    path of the scenario file. `varied_roads` are the road files that a varied parameter can select, as written in the
    scenario.
    """

    common_folder: str
    files: Mapping[str, bytes]
    scenario_path: str
    varied_roads: tuple[str, ...]
    fingerprint: str

    @classmethod
    def from_file(cls, scenario: ScenarioFile) -> ScenarioBundle:
        """Pack a scenario file with all files that it needs; raises `InputError` for a file with an absolute path."""
        contents = {
            scenario.road_path_without_map_folders(file): content for file, content in scenario.read_all_files().items()
        }
        absolute_paths = [
            scenario.resolve_path(reference, "file")
            for reference in scenario.file_references()
            if Path(reference.replace("\\", "/")).anchor
        ]
        for file in contents:
            if any(file.is_relative_to(path) for path in absolute_paths):
                raise InputError(
                    f"{scenario.path}: names {file} by an absolute path, but other machines have no such path;"
                    " write the path relative to the scenario file."
                )
        packed: dict[str, bytes] = {}
        for file, content in contents.items():
            # With symbolic links, equal normalized paths may be different files.
            if packed.setdefault(os.path.abspath(file), content) != content:
                raise InputError(
                    f"{scenario.path}: because of symbolic links, two different files have the path {file};"
                    " give each file its own path."
                )
        try:
            folder = os.path.commonpath([os.path.dirname(path) for path in packed])
        except ValueError as error:
            raise InputError(
                f"{scenario.path}: the scenario's files are on several drives; put them on the same drive."
            ) from error
        return cls(
            common_folder=folder,
            files={_relative_posix_path(folder, path): content for path, content in packed.items()},
            scenario_path=_relative_posix_path(folder, os.path.abspath(scenario.path)),
            varied_roads=scenario.varied_roads,
            fingerprint=scenario.fingerprint(),
        )

    def unpack(self, folder: Path) -> ScenarioFile:
        """Write all files to an empty folder, and return the scenario file there, with its original fingerprint."""
        for name, content in self.files.items():
            target = folder / name
            try:
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(content)
            except OSError as error:
                raise InputError(
                    f"{target}: cannot be written ({error.strerror}); free some disk space or change the permissions."
                ) from error
        return ScenarioFile(folder / self.scenario_path, self.fingerprint, self.varied_roads)


def _relative_posix_path(folder: str, path: str) -> str:
    return PurePosixPath(*Path(path).relative_to(folder).parts).as_posix()
