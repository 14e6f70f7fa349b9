"""A suite: scenarios that run by themselves, and the settings they were run with."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cornercase._common.errors import InputError
from cornercase.scenario import ConcreteScenario, ParameterSpace, Value
from cornercase.scenario._file import ScenarioFile


@dataclass(frozen=True)
class SuiteScenario:
    """A scenario of a suite; `values` distinguish it from the others.

    `kind` (its cluster), `role` and `why` (it was selected) are texts from the manifest, empty if unknown; `origin` is
    the id in the study it was selected from. `wrong` says why its file cannot be run, empty if it can.
    """

    file_name: str
    scenario: ScenarioFile
    values: Mapping[str, Value]
    cluster_name: str = ""
    role: str = ""
    selection_reason: str = ""
    source_id: int | None = None
    error: str = ""

    @property
    def concrete_scenario(self) -> ConcreteScenario:
        """The scenario for a simulator: the file without changes."""
        return ConcreteScenario(self.scenario.path, {}, self.scenario)

    @property
    def files(self) -> tuple[Path, ...]:
        """The file and all files that it uses; only itself if it cannot be read."""
        try:
            return self.scenario.all_paths()
        except InputError:
            return (self.scenario.path,)

    @property
    def fingerprint(self) -> str:
        """SHA-256 of all files."""
        try:
            return self.scenario.fingerprint()
        except InputError:
            with suppress(OSError):
                return hashlib.sha256(self.scenario.path.read_bytes()).hexdigest()
            return ""


@dataclass(frozen=True)
class SuiteContents:
    """The scenarios of a suite and the settings they were run with; settings are empty if unknown.

    `place` is the manifest or the folder; `study` and `fingerprint` identify the study that the scenarios were selected
    from. `custom_drivers` maps entities that a custom driver drove to the name of that driver in a command, since no
    file can make such a driver drive.
    """

    path: Path
    scenarios: tuple[SuiteScenario, ...]
    space: ParameterSpace
    ego: str = ""
    other: str | tuple[str, ...] = ""
    metrics: tuple[str, ...] = ()
    critical: float | None = None
    simulator: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)
    custom_drivers: Mapping[str, str] = field(default_factory=dict)
    study: str = ""
    fingerprint: str = ""

    @property
    def runnable_scenarios(self) -> tuple[SuiteScenario, ...]:
        """Scenarios whose files can be run."""
        return tuple(scenario for scenario in self.scenarios if not scenario.error)

    @property
    def folder(self) -> Path:
        """Folder of the files."""
        return self.path if self.path.is_dir() else self.path.parent

    @property
    def files(self) -> list[Path]:
        """The manifest, if there is one, and all files of the scenarios."""
        scenario_files = [file for scenario in self.scenarios for file in scenario.files]
        return scenario_files if self.path.is_dir() else [self.path, *scenario_files]

    @property
    def content_hash(self) -> str:
        """SHA-256 of all files, and of those that they use."""
        digest = hashlib.sha256()
        for scenario in self.scenarios:
            digest.update(f"{scenario.file_name}\0{scenario.fingerprint}\0".encode())
        return digest.hexdigest()
