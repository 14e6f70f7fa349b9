"""Base class of simulators that run in other processes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from cornercase.scenario import ConcreteScenario, Scenario
from cornercase.simulators.base import Simulator
from cornercase.simulators.registry import SIMULATORS


class SimulatorElsewhere(Simulator):
    """Runs scenarios in other processes; a local instance checks options and scenarios."""

    def __init__(self, name: str, options: dict[str, Any]) -> None:
        self.name = name
        self.declared = SIMULATORS.class_of(name)
        self.values_by = self.declared.values_by
        # Runs nothing; checks options, and scenarios before they are run.
        self._unused = SIMULATORS.create(name, **options)
        self.settings = self._unused.settings
        # Shared with `parallel_instances`.
        self._noticed: set[str] = set()

    def require_means(self, scenario: Scenario) -> None:
        """Let the local instance check if it supports the scenario."""
        self._unused.require_means(scenario)

    def require_runnable(self, concretes: Sequence[ConcreteScenario]) -> None:
        """Let the local instance check if any scenario can be run."""
        self._unused.require_runnable(concretes)

    def close(self) -> None:
        """Close the local instance."""
        self._unused.close()
