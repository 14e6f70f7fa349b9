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
# What a variable holds by the name that the standard gives it; views have configurations, too.
_NAME: Final = re.compile(
    r"OSMP(SensorView|SensorData|GroundTruth|TrafficCommand|TrafficCommandUpdate|TrafficUpdate|MotionRequest"
    r"|StreamingUpdate)(?:InConfig(?:Request)?|Init|In|Out)(?:\[\d+\])?"
)
_PASSED: Final = ("Integer", "Int32", "UInt32")


@dataclass(frozen=True)
class MessageVariable:
    """A message in three integers: lower and upper half of its address, and its size.

    `references` are their value references in this order, and `kind` their type. `message` is the type of the message,
    such as ``"SensorView"``; empty if it is none of OSI. `misdeclared` is the type in its MIME type, if its name is one
    of the standard for another message.
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
    """Return the messages that a model description declares, and the names of the integers that they consist of.

    `refuse` makes the error for a sentence.
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
    messages = [_join(name, members, refuse) for name, members in members_by_name.items()]
    return tuple(messages), frozenset(
        variable.name for members in members_by_name.values() for _, _, variable in members
    )


def _join(
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
    # Both are to say the same. Code is written by names, and MIME types are copied from other variables.
    message = declared and (_message_of_name(name) or declared)
    low, high, size = (of_role[role] for role in _ROLES)
    misdeclared = "" if message == declared else declared
    return MessageVariable(name, causalities.pop(), message, kinds.pop(), (low, high, size), misdeclared)


def _message_of_name(name: str) -> str:
    match = _NAME.fullmatch(name)
    if match is None:
        return ""
    return f"{match[1]}Configuration" if "InConfig" in name else match[1]
