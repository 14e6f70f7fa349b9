"""Traffic signal controllers, which cycle through their phases."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt
from lxml import etree

from cornercase._common.errors import InputError, suggestion
from cornercase._common.recorded_xml import adapt
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.scenario import Scope
from cornercase.simulators.builtin.world.held import nobody_asks

SIGNAL_CONDITIONS: Final = ("TrafficSignalCondition", "TrafficSignalControllerCondition")
"""Conditions on traffic signals."""

# Tolerance in s for times that are multiples of the time step.
_TINY: Final = 1e-6


class SignalController:
    """Switches traffic signals at the start of each phase; in between, a signal keeps any other state it is given.

    `states`: state of each signal in each of P phases; `durations` (P, N) and `delay` (N,) in s.
    """

    def __init__(
        self, names: Sequence[str], states: Sequence[dict[str, str]], durations: FloatArray, delay: FloatArray
    ) -> None:
        self.names = tuple(names)
        self._states = tuple(states)
        self._ends = np.cumsum(durations, axis=0)
        self.delay = delay
        self._begin = delay.copy()
        self._phase = np.full(len(delay), -1)

    def phase(self, time: FloatArray) -> IntArray:
        """Index of the phase at times in s, shape (N,)."""
        since = np.mod(time - self._begin + _TINY, self._ends[-1])
        return np.asarray(np.minimum((self._ends <= since).sum(axis=0), len(self.names) - 1), dtype=np.int64)

    def go_to(self, phase: int, time: FloatArray, where: BoolArray) -> None:
        """Start a phase now in the scenarios of a mask, and continue from there."""
        begins = self._ends[phase - 1] if phase else np.zeros(self._ends.shape[1])
        self._begin[where] = (time - begins)[where]
        self._phase[where] = -1

    def switch(self, signals: dict[str, npt.NDArray[np.str_]], time: FloatArray, where: BoolArray) -> None:
        """Set the signals where a phase has begun, in the scenarios of a mask."""
        phases = np.where(where, self.phase(time), self._phase)
        for k in np.unique(phases[phases != self._phase]):
            has_begun = (phases == k) & (phases != self._phase)
            for signal, state in self._states[k].items():
                signals[signal] = np.where(has_begun, state, signals.get(signal, np.full(len(phases), "")))
        self._phase = phases


def read_signal_controllers(root: etree._Element, scope: Scope) -> dict[str, SignalController]:
    """Read the traffic signal controllers below ``OpenSCENARIO``, by name."""
    controllers: dict[str, SignalController] = {}
    for element in root.iterfind("RoadNetwork/TrafficSignals/TrafficSignalController"):
        name, where = scope.text(element, "name"), f"{scope.source}, line {element.sourceline}: <{element.tag}>"
        phases = list(element.iterfind("Phase"))
        durations = np.array([scope.number(phase, "duration") for phase in phases])
        is_instant = np.ones(scope.scenarios, dtype=np.bool_) if not phases else durations.sum(axis=0) <= 0
        is_instant |= (durations < 0).any(axis=0)
        if is_instant.any() and not any(scope.origins(phase.get("duration", "")) for phase in phases):
            if nobody_asks(element, *SIGNAL_CONDITIONS):
                why = f"'{name}' is skipped, as none of its phases takes time, and no condition uses signals"
                adapt(element, "<TrafficSignalController>", why, "a signal controller has phases that take time")
                continue
            raise InputError(f"{where}: the signal controller '{name}' needs phases with a duration above 0.")
        for phase, duration in zip(phases, durations, strict=True):
            scope.refuse(phase, "duration", "is below 0", duration < 0)
        if is_instant.any():
            scope.refuse(phases[0], "duration", "is 0, as are those of the other phases", is_instant)
        delay, other = scope.number(element, "delay", 0.0), scope.text(element, "reference", "")
        if other:
            delay = delay + named_controller(controllers, other, where).delay
        states = [
            {
                scope.text(signal_state, "trafficSignalId"): scope.text(signal_state, "state")
                for signal_state in phase.iterfind("TrafficSignalState")
            }
            for phase in phases
        ]
        controllers[name] = SignalController([scope.text(phase, "name") for phase in phases], states, durations, delay)
    return controllers


def named_controller(controllers: dict[str, SignalController], name: str, where: str) -> SignalController:
    """Return the controller with a name; raise `InputError`, starting with `location`, if there is none."""
    if name not in controllers:
        raise InputError(f"{where}: there is no signal controller '{name}'; {suggestion(name, controllers)}")
    return controllers[name]


def named_phase(controller: SignalController, name: str, where: str) -> int:
    """Index of the phase with a name; raises `InputError`, starting with `location`, if there is none."""
    if name not in controller.names:
        raise InputError(f"{where}: the signal controller has no phase '{name}'; {suggestion(name, controller.names)}")
    return controller.names.index(name)
