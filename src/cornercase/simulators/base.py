"""What a simulator is."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Protocol

from cornercase.errors import SimulationError
from cornercase.recording import Recording
from cornercase.registry import Registry
from cornercase.scenario.logical import ConcreteScenario


class Simulator(Protocol):
    """Runs concrete scenarios.

    Attributes
    ----------
    name : str
        As on the command line: ``"builtin"``.
    settings : dict
        Everything besides the scenario that the recordings depend on, as plain JSON values. It is stored with a
        study, and a study goes on only with the same settings.
    """

    name: str
    settings: dict[str, object]

    def run(self, concretes: Sequence[ConcreteScenario]) -> Iterator[Recording | SimulationError]:
        """Give one recording or one error per concrete scenario, in order.

        Raises
        ------
        InputError
            The scenario file itself cannot be used, so none of them can run.
        """
        ...


SIMULATORS: Registry[Simulator] = Registry("simulator", "cornercase.simulators")
