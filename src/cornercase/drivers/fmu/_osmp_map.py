"""Which messages of OSI an FMU is given, and which variable says where it drives."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from cornercase.drivers.fmu._osmp_variables import MessageVariable
from cornercase.drivers.fmu._processes import MessageLayouts

_GIVEN: Final = {
    "SensorView": "what the sensors know",
    "GroundTruth": "what the sensors know",
    "TrafficCommand": "what the scenario wants",
}
# Parameters that are given, by their names.
_STATIC: Final = {
    ("OSMPGroundTruthInit", "GroundTruth"): "roads, once",
    ("OSMPSensorViewInConfig", "SensorViewConfiguration"): "how the views are, once",
}
# The first one that an FMU has decides.
_DECIDES: Final = {
    "TrafficUpdate": "pose and speed at the end of the step",
    "MotionRequest": "trajectory or acceleration",
}


class OsmpMap:
    """The messages of an FMU that are used.

    `inputs` are given in each step, `static` are given once, the roads among them if `has_roads_once`. `motion` is what
    the FMU decides; None if `decides` is not set, or if it writes no such message. `listing` has each message with its
    use, empty if there is none, and a remark.
    """

    def __init__(self, variables: Sequence[MessageVariable], *, decides: bool) -> None:
        self.inputs = [
            variable for variable in variables if variable.causality == "input" and variable.message in _GIVEN
        ]
        self.static = [
            variable for variable in variables if variable.causality == "parameter" and _name_static(variable)
        ]
        self.has_roads_once = any(variable.message == "GroundTruth" for variable in self.static)
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
                use = f"{_name_static(variable)}, as OSI {kind}"
            elif variable is self.motion:
                use = f"{_DECIDES[variable.message]}, as OSI {kind}"
            remarks = [] if use else [f"OSI {kind}" if variable.message else kind]
            if variable.misdeclared:
                remarks.append(f"by its name; its MIME type says {variable.misdeclared}")
            self.listing.append((variable, use, ", ".join(remarks)))

    def __bool__(self) -> bool:
        return bool(self.inputs or self.static or self.motion)

    def layouts(self, static: Sequence[bytes]) -> MessageLayouts:
        """Return what the process of the FMU has to know; `static` are the messages that are given once."""
        return MessageLayouts(
            [(variable.kind, variable.references) for variable in self.inputs],
            [(self.motion.kind, self.motion.references)] if self.motion is not None else [],
            [
                ((variable.kind, variable.references), message)
                for variable, message in zip(self.static, static, strict=True)
            ],
        )


def _name_static(variable: MessageVariable) -> str:
    """Return what a parameter is given, empty if it is nothing."""
    return next(
        (
            use
            for (name, message), use in _STATIC.items()
            if variable.name.startswith(name) and variable.message == message
        ),
        "",
    )
