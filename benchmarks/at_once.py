"""A simulator that returns the same recording at once: what is left is the work around the simulation.

It is known wherever this module is loaded, so also on the workers of a cluster that get its `Answer`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import SIMULATORS, Simulator


class Answer:
    """The recording that it returns."""

    def __init__(self, recording: Recording) -> None:
        self.recording = recording


class AtOnceSimulator(Simulator):
    """Returns one recording whatever it is asked."""

    name = "at-once"

    def __init__(self, *, answer: Answer) -> None:
        self.settings: dict[str, Any] = {}
        self._answer = answer

    def run(self, concretes: Sequence[ConcreteScenario]) -> Iterator[Recording]:
        """Give the recording for each."""
        for _ in concretes:
            yield self._answer.recording


SIMULATORS.register(AtOnceSimulator.name, AtOnceSimulator)
