"""Contents of a suite: concrete scenarios, and the settings that they were run with."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from cornercase._common.errors import InputError
from cornercase.scenario import ConcreteScenario, ParameterSpace, Value
from cornercase.scenario._file import ScenarioFile
from cornercase.simulators._run_options import SIMULATION_OPTIONS

DEFAULT_SETTINGS: Final[dict[str, Any]] = {
    name: SIMULATION_OPTIONS[name].default for name in ("time_step", "duration", "on_collision")
}
"""Default value of each setting, for a suite that does not define the setting."""


@dataclass(frozen=True)
class SuiteScenario:
    """A scenario of a suite; its parameter `values` distinguish it from the other scenarios.

    `cluster_name`, `role` and `selection_reason` come from the manifest; they are empty if unknown. `source_id` is the
    id in the study that the scenario was selected from, and `seed` is the seed of that study. `error` says why the file
    cannot be run; it is empty if the file can be run. `driver_values` are those of `values` that the scenario file does
    not contain; they are passed to the drivers of a run.
    """

    file_name: str
    scenario: ScenarioFile
    values: Mapping[str, Value]
    cluster_name: str = ""
    role: str = ""
    selection_reason: str = ""
    source_id: int | None = None
    error: str = ""
    seed: int = 0
    driver_values: Mapping[str, Value] = field(default_factory=dict)

    @property
    def concrete_scenario(self) -> ConcreteScenario:
        """The scenario for a simulator: the unchanged file, with `driver_values`."""
        return ConcreteScenario(self.scenario.path, self.driver_values, self.scenario, self.seed)

    @property
    def files(self) -> tuple[Path, ...]:
        """The scenario file and all files that it uses; only the scenario file if it cannot be read."""
        try:
            return self.scenario.all_paths()
        except InputError:
            return (self.scenario.path,)

    @property
    def fingerprint(self) -> str:
        """SHA-256 of the scenario file and all files that it uses; of the scenario file alone if it is invalid."""
        try:
            return self.scenario.fingerprint()
        except InputError:
            with suppress(OSError):
                return hashlib.sha256(self.scenario.path.read_bytes()).hexdigest()
            return ""


@dataclass(frozen=True)
class SuiteContents:
    """Scenarios of a suite, and the settings they were run with; settings are empty if unknown.

    `path` is the manifest or the folder. `study` and `fingerprint` identify the study that the scenarios were selected
    from. `custom_drivers` maps an entity to the name that its driver had in the command, if the driver was the user's
    own code. Code that a manifest names is not loaded, so the user has to give such a driver again.
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
        """Folder of the scenario files."""
        return self.path if self.path.is_dir() else self.path.parent

    @property
    def files(self) -> list[Path]:
        """The manifest, if there is one, the scenario files, and all files that the scenario files use."""
        scenario_files = [file for scenario in self.scenarios for file in scenario.files]
        return scenario_files if self.path.is_dir() else [self.path, *scenario_files]

    @property
    def content_hash(self) -> str:
        """SHA-256 of the scenario files (names, contents, and files that they use) and of the values for drivers."""
        digest = hashlib.sha256()
        for scenario in self.scenarios:
            digest.update(f"{scenario.file_name}\0{scenario.fingerprint}\0".encode())
            of_drivers = {} if scenario.error else scenario.scenario.parse_driver_option_names(scenario.values)
            digest.update("".join(f"{name}={scenario.values[name]}\0" for name in of_drivers).encode())
        return digest.hexdigest()
