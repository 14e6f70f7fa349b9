"""Traffic signal controllers, which repeat a cycle of phases."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt
from lxml import etree

from cornercase._common.errors import suggest_name
from cornercase._common.io.tracked_xml import note_adaptation
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.scenario._scope import Scope
from cornercase.simulators.builtin.world._text_values import has_no_conditions_with_tags

SIGNAL_CONDITIONS: Final = ("TrafficSignalCondition", "TrafficSignalControllerCondition")
"""Tags of conditions on traffic signals."""

# Tolerance in s for times that are multiples of the time step.
_TINY: Final = 1e-6


class SignalController:
    """Controller that sets the states of traffic signals at the start of each phase, in a cycle of P phases.

    A signal that an action changes keeps its state until the next phase. `names` are the names of the phases. `states`
    has a dictionary for each phase: the state by signal. `durations` (P, N) are those of the phases in s, and `delay`
    (N,) is a time in s at which a cycle begins.
    """

    def __init__(
        self, names: Sequence[str], states: Sequence[dict[str, str]], durations: FloatArray, delay: FloatArray
    ) -> None:
        self.names = tuple(names)
        self._states = tuple(states)
        self._phase_ends = np.cumsum(durations, axis=0)
        self.delay = delay
        self._cycle_start = delay.copy()
        self._phase = np.full(len(delay), -1)
        self._cycle = np.zeros(len(delay))

    def postpone(self, time: FloatArray) -> None:
        """Let the first cycle begin later by a time in s in each scenario, shape (N,)."""
        self.delay = self.delay + time
        self._cycle_start = self.delay.copy()

    def phase_at(self, time: FloatArray) -> IntArray:
        """Return the index of the phase at a time in s in each scenario, shape (N,)."""
        since = np.mod(time - self._cycle_start + _TINY, self._phase_ends[-1])
        return np.asarray(np.minimum((self._phase_ends <= since).sum(axis=0), len(self.names) - 1), dtype=np.int64)

    def next_phase_start(self, time: FloatArray) -> FloatArray:
        """Return the time in s at which the next phase begins, shape (N,).

        The result is the present time if the signals of the present phase have not been set yet: at the start, and
        after an action has begun a phase.
        """
        since = np.mod(time - self._cycle_start + _TINY, self._phase_ends[-1])
        ends = np.take_along_axis(self._phase_ends, self.phase_at(time)[None], axis=0)[0]
        return np.where(self._phase < 0, time, time + (ends - since))

    def start_phase(self, phase: int, time: FloatArray, where: BoolArray) -> None:
        """Start a phase now in the scenarios of a mask; the cycle continues from this phase."""
        begins = self._phase_ends[phase - 1] if phase else np.zeros(self._phase_ends.shape[1])
        self._cycle_start[where] = (time - begins)[where]
        self._phase[where] = -1

    def update_signals(self, signals: dict[str, npt.NDArray[np.str_]], time: FloatArray, where: BoolArray) -> None:
        """Set the states of signals in those scenarios of a mask in which a new phase has begun."""
        phases = np.where(where, self.phase_at(time), self._phase)
        cycles = np.where(where, (time - self._cycle_start + _TINY) // self._phase_ends[-1], self._cycle)
        is_new = (phases != self._phase) | (cycles != self._cycle)
        for k in np.unique(phases[is_new]):
            has_started = (phases == k) & is_new
            for signal, state in self._states[k].items():
                signals[signal] = np.where(has_started, state, signals.get(signal, np.full(len(phases), "")))
        self._phase, self._cycle = phases, cycles


def read_signal_controllers(root: etree._Element, scope: Scope) -> dict[str, SignalController]:
    """Read the traffic signal controllers of a scenario from the root of its file; return them by name."""
    controllers: dict[str, SignalController] = {}
    references: dict[str, tuple[etree._Element, str]] = {}
    for element in root.iterfind("RoadNetwork/TrafficSignals/TrafficSignalController"):
        name = scope.read_text(element, "name")
        phases = list(element.iterfind("Phase"))
        durations = np.array([scope.read_numbers(phase, "duration") for phase in phases])
        is_instant = np.ones(scope.n_scenarios, dtype=np.bool_) if not phases else durations.sum(axis=0) <= 0
        is_instant |= (durations < 0).any(axis=0)
        if is_instant.any() and not any(scope.find_origin_parameters(phase.get("duration", "")) for phase in phases):
            if has_no_conditions_with_tags(element, *SIGNAL_CONDITIONS):
                why = f"'{name}' is skipped, as none of its phases takes time, and no condition uses signals"
                note_adaptation(
                    element, "<TrafficSignalController>", why, "a signal controller has phases that take time"
                )
                continue
            raise scope.error_at(
                element, f"<{element.tag}>: the signal controller '{name}' needs phases with a duration above 0."
            )
        for phase, duration in zip(phases, durations, strict=True):
            scope.mark_invalid(phase, "duration", "is below 0", duration < 0)
        if is_instant.any():
            scope.mark_invalid(phases[0], "duration", "is 0, as are those of the other phases", is_instant)
        delay, other = scope.read_numbers(element, "delay", 0.0), scope.read_text(element, "reference", "")
        if other:
            references[name] = element, other
        states = [
            {
                scope.read_text(signal_state, "trafficSignalId"): scope.read_text(signal_state, "state")
                for signal_state in phase.iterfind("TrafficSignalState")
            }
            for phase in phases
        ]
        controllers[name] = SignalController(
            [scope.read_text(phase, "name") for phase in phases], states, durations, delay
        )
    _add_delays_of_references(controllers, references, scope)
    return controllers


def _add_delays_of_references(
    controllers: dict[str, SignalController], references: Mapping[str, tuple[etree._Element, str]], scope: Scope
) -> None:
    """Postpone each traffic signal controller by the delays of those to which it refers, directly or through others."""
    settled = controllers.keys() - references.keys()
    for name in references:
        chain, following = list[str](), name
        while following not in settled:
            chain.append(following)
            element, following = references[following]
            _require_signal_controller(element, following, scope, controllers)
            if following in chain:
                names = ", ".join(chain[chain.index(following) :])
                raise scope.error_at(
                    element, f"<{element.tag}>: signal controllers refer to each other ({names}); remove one reference."
                )
        for name_in_chain in reversed(chain):
            controllers[name_in_chain].postpone(controllers[references[name_in_chain][1]].delay)
        settled.update(chain)


def _require_signal_controller(
    element: etree._Element, name: str, scope: Scope, controllers: dict[str, SignalController]
) -> SignalController:
    if name not in controllers:
        message = f"<{element.tag}>: there is no signal controller '{name}'; {suggest_name(name, controllers)}"
        raise scope.error_at(element, message)
    return controllers[name]


def read_signal_phase(
    element: etree._Element, scope: Scope, controllers: dict[str, SignalController]
) -> tuple[SignalController, int]:
    """Return the traffic signal controller that an element names, and the index of the phase that it names."""
    name, phase = scope.read_text(element, "trafficSignalControllerRef"), scope.read_text(element, "phase")
    controller = _require_signal_controller(element, name, scope, controllers)
    if phase not in controller.names:
        hint = suggest_name(phase, controller.names)
        raise scope.error_at(element, f"<{element.tag}>: the signal controller has no phase '{phase}'; {hint}")
    return controller, controller.names.index(phase)
