"""Selection of the OSI messages that an FMU is given, and of the message that says where its vehicle drives."""

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
# Parameters that are set, by the beginning of the name and the type of the message.
_STATIC: Final = {
    ("OSMPGroundTruthInit", "GroundTruth"): "roads, once",
    ("OSMPSensorViewInConfig", "SensorViewConfiguration"): "how the views are, once",
}
# Messages that can decide the motion; the first type that an FMU writes is used.
_DECIDES: Final = {
    "TrafficUpdate": "pose and speed at the end of the step",
    "MotionRequest": "trajectory or acceleration",
}


class OsmpMap:
    """Selection of the OSI messages that are exchanged with an FMU.

    The FMU is given `inputs` in each step, and `static` once before the first step. `has_roads_once` is True if
    `static` contains the roads. `decides` says whether a message may decide the motion of the vehicle, and `motion` is
    this message; None if none may decide, or the FMU writes no such message. `listing` has every message with its use
    (empty if unused) and a remark.
    """

    def __init__(self, variables: Sequence[MessageVariable], *, decides: bool) -> None:
        self.inputs = [
            variable for variable in variables if variable.causality == "input" and variable.message in _GIVEN
        ]
        self.static = [
            variable
            for variable in variables
            if variable.causality == "parameter" and _describe_static_message(variable)
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
                use = f"{_describe_static_message(variable)}, as OSI {kind}"
            elif variable is self.motion:
                use = f"{_DECIDES[variable.message]}, as OSI {kind}"
            remarks = [] if use else [f"OSI {kind}" if variable.message else kind]
            if variable.misdeclared:
                remarks.append(f"by its name; its MIME type says {variable.misdeclared}")
            self.listing.append((variable, use, ", ".join(remarks)))

    def __bool__(self) -> bool:
        return bool(self.inputs or self.static or self.motion)

    def layouts(self, static: Sequence[bytes]) -> MessageLayouts:
        """Return the layouts of the used messages; `static` has the content of each message in `self.static`."""
        return MessageLayouts(
            [(variable.kind, variable.references) for variable in self.inputs],
            [(self.motion.kind, self.motion.references)] if self.motion is not None else [],
            [
                ((variable.kind, variable.references), message)
                for variable, message in zip(self.static, static, strict=True)
            ],
        )


def _describe_static_message(variable: MessageVariable) -> str:
    """Return the use of an OSI message that is passed once as a parameter; an empty text if the message is unused."""
    return next(
        (
            use
            for (name, message), use in _STATIC.items()
            if variable.name.startswith(name) and variable.message == message
        ),
        "",
    )
