"""What a suite holds: scenarios that run by themselves, and how they were run."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cornercase._common.errors import InputError
from cornercase.scenario import ConcreteScenario, ParameterSpace, Scenario, Value


@dataclass(frozen=True)
class SuiteScenario:
    """A scenario of a suite.

    Attributes
    ----------
    file : str
        Its name in the folder.
    scenario : Scenario
        The file as it was read.
    values : mapping of str to float or str
        Its parameters, by which it is told from others.
    kind : str
        Cluster that it represents, in words; empty where it is not known.
    role : str
        ``"archetype"``, ``"prototype"``, ``"gap"`` or ``"exposing"``; empty where it is not known.
    why : str
        Why it was kept, in words; empty where it is not known.
    origin : int or None
        Id of the scenario of the study that it was kept from.
    wrong : str
        Why its file cannot be run, as why a scenario failed; empty where it can.
    """

    file: str
    scenario: Scenario
    values: Mapping[str, Value]
    kind: str = ""
    role: str = ""
    why: str = ""
    origin: int | None = None
    wrong: str = ""

    @property
    def concrete(self) -> ConcreteScenario:
        """What a simulator runs: the file as it stands."""
        return ConcreteScenario(self.scenario.path, {}, self.scenario)

    @property
    def files(self) -> tuple[Path, ...]:
        """The file and all that it uses; of one that cannot be read only itself."""
        try:
            return self.scenario.files()
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
    """What a suite holds.

    Attributes
    ----------
    place : Path
        The manifest, or the folder.
    scenarios : tuple of SuiteScenario
        At least one.
    space : ParameterSpace
        What differs between them.
    ego : str
        Name of the entity that was measured; empty where nothing says it.
    other : str or tuple of str
        Whom it was measured against; empty where nothing says it.
    metrics : tuple of str
        Those that were measured.
    critical : float or None
        Score of the first from which a scenario is critical.
    simulator : str
        What ran them, with its options; empty where nothing says it.
    settings : mapping of str to object
        Of ``time_step``, ``duration`` and ``on_collision`` those that are known.
    lost_drivers : mapping of str to str
        By entity that a driver of somebody's own drove, what a command calls that driver; empty where that is not
        known. No file makes such a driver drive.
    study, fingerprint : str
        Name of the study that the scenarios were kept from, and SHA-256 of the files that were explored; empty
        where there is none.
    """

    place: Path
    scenarios: tuple[SuiteScenario, ...]
    space: ParameterSpace
    ego: str = ""
    other: str | tuple[str, ...] = ""
    metrics: tuple[str, ...] = ()
    critical: float | None = None
    simulator: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)
    lost_drivers: Mapping[str, str] = field(default_factory=dict)
    study: str = ""
    fingerprint: str = ""

    @property
    def usable(self) -> tuple[SuiteScenario, ...]:
        """Scenarios whose files can be run."""
        return tuple(one for one in self.scenarios if not one.wrong)

    @property
    def folder(self) -> Path:
        """Where the files lie."""
        return self.place if self.place.is_dir() else self.place.parent

    @property
    def files(self) -> list[Path]:
        """The manifest, where there is one, and all files of the scenarios."""
        own = [file for one in self.scenarios for file in one.files]
        return own if self.place.is_dir() else [self.place, *own]

    @property
    def digest(self) -> str:
        """SHA-256 of all files, and of those that they use."""
        digest = hashlib.sha256()
        for one in self.scenarios:
            digest.update(f"{one.file}\0{one.fingerprint}\0".encode())
        return digest.hexdigest()
