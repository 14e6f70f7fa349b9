"""What simulators have in common that run in other processes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from cornercase.scenario import ConcreteScenario, Scenario
from cornercase.simulators.base import Simulator
from cornercase.simulators.registry import SIMULATORS


class SimulatorElsewhere(Simulator):
    """Runs scenarios in other processes, and lets a simulator of this one check them.

    Parameters
    ----------
    name : str
        Registered simulator.
    options : dict
        What to make it with.

    Raises
    ------
    InputError
        The simulator cannot be made so.
    """

    def __init__(self, name: str, options: dict[str, Any]) -> None:
        self.name = name
        self.declared = SIMULATORS.class_of(name)
        self.values_by = self.declared.values_by
        # This one runs nothing; it checks options, and scenarios before they are run.
        self._unused = SIMULATORS.create(name, **options)
        self.settings = self._unused.settings
        # Shared by those that `beside` gives.
        self._noticed: set[str] = set()

    def require_means(self, scenario: Scenario) -> None:
        """Let the simulator refuse a scenario that it cannot run.

        Parameters
        ----------
        scenario : Scenario

        Raises
        ------
        InputError
            It lacks what the scenario asks for.
        """
        self._unused.require_means(scenario)

    def require_runnable(self, concretes: Sequence[ConcreteScenario]) -> None:
        """Let the simulator refuse scenarios of which it can run none.

        Parameters
        ----------
        concretes : sequence of ConcreteScenario

        Raises
        ------
        InputError
            None can be run, as far as that shows beforehand.
        """
        self._unused.require_runnable(concretes)

    def close(self) -> None:
        """End what the simulator of this process has started."""
        self._unused.close()
