"""Which messages of OSI an FMU is given, and which variable says where it drives."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from cornercase.drivers.fmu._osmp_variables import MessageVariable
from cornercase.drivers.fmu._processes import MessageLayouts

_GIVEN: Final = {"SensorView": "what the sensors know", "GroundTruth": "what the sensors know"}
# The first one that an FMU has decides.
_DECIDES: Final = {
    "TrafficUpdate": "pose and speed at the end of the step",
    "MotionRequest": "trajectory or acceleration",
}
_INIT: Final = "OSMPGroundTruthInit"


class OsmpMap:
    """The messages of an FMU that are used.

    `inputs` are given in each step, `static` are given once. `motion` is what the FMU decides; None if `decides` is not
    set, or if it writes no such message. `listing` has each message with its use, empty if there is none, and a remark.
    """

    def __init__(self, variables: Sequence[MessageVariable], *, decides: bool) -> None:
        self.inputs = [
            variable for variable in variables if variable.causality == "input" and variable.message in _GIVEN
        ]
        self.static = [
            variable
            for variable in variables
            if variable.causality == "parameter"
            and variable.message == "GroundTruth"
            and variable.name.startswith(_INIT)
        ]
        motions = [
            variable
            for message in _DECIDES
            for variable in variables
            if variable.causality == "output" and variable.message == message and decides
        ]
        self.motion = motions[0] if motions else None
        self.listing: list[tuple[MessageVariable, str, str]] = []
        for variable in variables:
            kind, use = variable.message or "no message of OSI", ""
            if variable in self.inputs:
                use = f"{_GIVEN[variable.message]}, as OSI {kind}"
            elif variable in self.static:
                use = f"roads, once, as OSI {kind}"
            elif variable is self.motion:
                use = f"{_DECIDES[variable.message]}, as OSI {kind}"
            self.listing.append((variable, use, "" if use else f"OSI {kind}" if variable.message else kind))

    def __bool__(self) -> bool:
        return bool(self.inputs or self.static or self.motion)

    def layouts(self, static: bytes) -> MessageLayouts:
        """Return what the process of the FMU has to know; `static` is the message about the roads."""
        return MessageLayouts(
            [(variable.kind, variable.references) for variable in self.inputs],
            [(self.motion.kind, self.motion.references)] if self.motion is not None else [],
            [((variable.kind, variable.references), static) for variable in self.static],
        )
