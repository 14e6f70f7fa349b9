"""Installation of ScenarioRunner, with the Python of its environment and CARLA's agents."""

from __future__ import annotations

import os
import re
import sys
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final, Self

from cornercase._common.errors import InputError
from cornercase.simulators.carla._support_table import VERSIONS

RUNNER_VARIABLE: Final = "SCENARIO_RUNNER_ROOT"
PYTHON_VARIABLE: Final = "CORNERCASE_CARLA_PYTHON"
CARLA_ROOT_VARIABLE: Final = "CARLA_ROOT"
_FRAME_RATE_PATTERN: Final = re.compile(r"""['"]--frameRate['"]""")
# ScenarioRunner has no constant with its version.
_CHANGELOG_FILE: Final = "Docs/CHANGELOG.md"
_VERSION_PATTERN: Final = re.compile(r"^## CARLA ScenarioRunner (\d[\w.]*)", re.MULTILINE)


def describe_download(version: str) -> str:
    """Return how to download a version of ScenarioRunner, for a message such as "get 0.9.15 by `git clone …`"."""
    command = f"git clone --branch v{version} https://github.com/carla-simulator/scenario_runner"
    return f"by `{command}` and set {RUNNER_VARIABLE} to its folder"


@dataclass(frozen=True)
class RunnerEnvironment:
    """Folder of ScenarioRunner, Python of its environment, and folder of CARLA (empty if unknown)."""

    folder: Path
    python: str
    carla_root: str

    @classmethod
    def find(cls, folder: str, python: str, carla_root: str) -> Self:
        """Find the installation of ScenarioRunner; for empty arguments, use the environment variables.

        Raises `InputError` if ScenarioRunner is not found.
        """
        return cls(
            _find_scenario_runner_folder(folder),
            python or os.environ.get(PYTHON_VARIABLE, "") or sys.executable,
            carla_root or os.environ.get(CARLA_ROOT_VARIABLE, ""),
        )

    def variables(self, drivers: Path | None = None) -> dict[str, str]:
        """Return the environment variables of a program that imports ScenarioRunner, CARLA's agents and `drivers`."""
        roots = [self.folder, *filter(None, [drivers])]
        if self.carla_root:
            roots.append(Path(self.carla_root) / "PythonAPI" / "carla")
        python_path = os.environ.get("PYTHONPATH", "")
        return os.environ | {
            "PYTHONPATH": os.pathsep.join([*map(str, roots), *filter(None, [python_path])]),
            "PYTHONUNBUFFERED": "1",
        }

    @cached_property
    def version(self) -> str:
        """Version of ScenarioRunner; empty if unknown."""
        match = _VERSION_PATTERN.search(_read_source(self.folder / _CHANGELOG_FILE))
        return "" if match is None else match[1]

    @cached_property
    def has_frame_rate(self) -> bool:
        """True if ScenarioRunner has the option ``--frameRate``, as in 0.9.16 and later."""
        return bool(_FRAME_RATE_PATTERN.search(_read_source(self.folder / "scenario_runner.py")))

    def check_versions(self, client: str, server: str, address: str) -> None:
        """Raise `InputError` unless ScenarioRunner, client and server have the same version.

        An unknown version of ScenarioRunner is not checked. CARLA 0.10 is always refused, as it has no ScenarioRunner.
        """
        any_version = "; with `simulator` carla:any_version=true cornercase tries to run the scenario all the same."
        for version in (server, client):
            if version.split(".")[:2] == ["0", "10"]:
                raise InputError(
                    f"CARLA {version} has no ScenarioRunner, as it runs on Unreal Engine 5; use CARLA"
                    f" {', '.join(VERSIONS[:-1])} or {VERSIONS[-1]}{any_version}"
                )
        if client != server:
            raise InputError(
                f"CARLA on {address} has version {server}, but its client in {self.python} has {client}; start CARLA"
                f" {client}, or get the other client by `{self.python} -m pip install carla=={server}`{any_version}"
            )
        if self.version not in ("", client):
            release = max(
                (other for other in VERSIONS if _version_numbers(other) <= _version_numbers(client)),
                key=_version_numbers,
                default=VERSIONS[0],
            )
            steps = [] if self.version == release else [f"get {release} {describe_download(release)}"]
            if client != release:
                steps.append(f"use CARLA {release}")
            raise InputError(
                f"{self.folder}: ScenarioRunner {self.version} does not fit CARLA {client}; {', and '.join(steps)}"
                f"{any_version}"
            )


def _version_numbers(version: str) -> list[int]:
    """Return the numbers of a version, to compare versions; also of builds such as 0.9.15-dirty."""
    return [int(number) for number in re.findall(r"\d+", version)]


def _find_scenario_runner_folder(explicit_folder: str) -> Path:
    text = explicit_folder or os.environ.get(RUNNER_VARIABLE, "")
    if not text:
        raise InputError(
            "ScenarioRunner is not found; get the version that matches your CARLA, for example 0.9.15"
            f" {describe_download('0.9.15')}."
        )
    folder = Path(text)
    if not (folder / "scenario_runner.py").is_file():
        raise InputError(
            f"{folder}: contains no scenario_runner.py; set {RUNNER_VARIABLE} to the folder of ScenarioRunner."
        )
    return folder.resolve()


def _read_source(path: Path) -> str:
    """Return the text of a file; empty if there is no such file."""
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
