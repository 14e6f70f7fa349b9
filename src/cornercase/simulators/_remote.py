"""Base class of simulators that run in other processes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from cornercase.scenario import ConcreteScenario
from cornercase.scenario._file import ScenarioFile
from cornercase.simulators._base import Simulator, require_settings
from cornercase.simulators._registry import SIMULATORS


class RemoteSimulator(Simulator):
    """Base class of simulators that run scenarios in other processes; a local instance checks options and scenarios."""

    def __init__(self, name: str | type[Simulator], options: dict[str, Any]) -> None:
        self.simulator_class = SIMULATORS.get_class(name)
        self.parameter_passing = self.simulator_class.parameter_passing
        # Runs nothing; checks options, and scenarios before they are run.
        self._local_instance = SIMULATORS.create(name, **options)
        require_settings(self._local_instance)
        self.name = name if isinstance(name, str) else self._local_instance.name
        self.settings = self._local_instance.settings
        # Shared with `parallel_instances`.
        self._noticed: set[str] = set()

    def check_supported(self, scenario: ScenarioFile) -> None:
        """Refuse a scenario that the local instance does not support."""
        self._local_instance.check_supported(scenario)

    def check_runnable(self, concretes: Sequence[ConcreteScenario]) -> None:
        """Raise `InputError` if the local instance finds that none of the scenarios can be run."""
        self._local_instance.check_runnable(concretes)

    def close(self) -> None:
        """Close the local instance."""
        self._local_instance.close()
