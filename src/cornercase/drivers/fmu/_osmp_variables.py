"""Variables of an FMU that hold messages of ASAM OSI, by the conventions of OSI Sensor Model Packaging (OSMP) 1.x."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from lxml import etree

from cornercase._common.errors import InputError

if TYPE_CHECKING:
    from cornercase.drivers.fmu._model import FmuVariable

_ELEMENT: Final = "{*}osmp-binary-variable"
_ROLES: Final = ("base.lo", "base.hi", "size")
_MESSAGE_TYPE: Final = re.compile(r"application/x-open-simulation-interface\s*;.*?\btype\s*=\s*\"?(\w+)")
# Type of a message in the standard names of variables; the names of configurations contain InConfig.
_NAME: Final = re.compile(
    r"OSMP(SensorView|SensorData|GroundTruth|TrafficCommand|TrafficCommandUpdate|TrafficUpdate|MotionRequest"
    r"|StreamingUpdate)(?:InConfig(?:Request)?|Init|In|Out)(?:\[\d+\])?"
)
_PASSED: Final = ("Integer", "Int32", "UInt32")


@dataclass(frozen=True)
class MessageVariable:
    """OSI message of an FMU, held by three integer variables: lower and upper half of its address, and its size.

    `references` are the value references of these integers, and `kind` is their FMI type. `message` is the type of the
    message, such as ``"SensorView"``; empty if the message is not from OSI. If name and MIME type of the variable
    contradict each other, the name counts, and `misdeclared` is the type of message in the MIME type.
    """

    name: str
    causality: str
    message: str
    kind: str
    references: tuple[int, int, int]
    misdeclared: str = ""


def read_message_variables(
    xml: bytes, by_name: dict[str, FmuVariable], refuse: Callable[[str], InputError]
) -> tuple[tuple[MessageVariable, ...], frozenset[str]]:
    """Return the OSI messages that an FMU's model description declares, and the names of the integers that hold them.

    `refuse` makes an error from a sentence; this error is raised if a message is declared wrongly.
    """
    root = etree.fromstring(xml, etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False))
    members_by_name: dict[str, list[tuple[str, str, FmuVariable]]] = {}
    for element in root.iter(_ELEMENT):
        holder = next((parent for parent in element.iterancestors() if parent.get("valueReference") is not None), None)
        variable = None if holder is None else by_name.get(holder.get("name", ""))
        # Binary variables of FMI 3.0 have the role "full", and are not supported.
        if variable is not None and variable.kind != "Binary":
            role, mime = element.get("role", ""), element.get("mime-type", "")
            members_by_name.setdefault(element.get("name", ""), []).append((role, mime, variable))
    messages = [_join_message_parts(name, members, refuse) for name, members in members_by_name.items()]
    return tuple(messages), frozenset(
        variable.name for members in members_by_name.values() for _, _, variable in members
    )


def _join_message_parts(
    name: str, members: Iterable[tuple[str, str, FmuVariable]], refuse: Callable[[str], InputError]
) -> MessageVariable:
    roles, mimes, variables = zip(*members, strict=True)
    if sorted(roles) != sorted(_ROLES):
        raise refuse(
            f"the OSMP variable '{name}' has the parts {', '.join(sorted(roles))}; it needs {', '.join(_ROLES)}, each"
            " once."
        )
    if len(set(mimes)) > 1:
        raise refuse(f"the parts of the OSMP variable '{name}' have different MIME types; give them the same.")
    causalities, kinds = {variable.causality for variable in variables}, {variable.kind for variable in variables}
    if len(causalities) > 1 or len(kinds) > 1 or not kinds <= {*_PASSED}:
        raise refuse(f"the parts of the OSMP variable '{name}' have to be integers of the same causality.")
    of_role = {role: variable.reference for role, variable in zip(roles, variables, strict=True)}
    match = _MESSAGE_TYPE.match(mimes[0])
    declared = "" if match is None else match[1]
    # If name and MIME type differ, the name counts: MIME types are easily copied from other variables by mistake.
    message = declared and (_message_type_from_name(name) or declared)
    low, high, size = (of_role[role] for role in _ROLES)
    misdeclared = "" if message == declared else declared
    return MessageVariable(name, causalities.pop(), message, kinds.pop(), (low, high, size), misdeclared)


def _message_type_from_name(name: str) -> str:
    match = _NAME.fullmatch(name)
    if match is None:
        return ""
    return f"{match[1]}Configuration" if "InConfig" in name else match[1]
