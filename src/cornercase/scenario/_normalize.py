"""Correct OpenSCENARIO files where they violate the standard but can only mean one thing."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Final

from lxml import etree

from cornercase._common.io.tracked_xml import iter_descendants_untracked, note_adaptation
from cornercase._common.text.parse_number import parse_number

_PARAMETER_TYPES: Final = ("boolean", "dateTime", "double", "integer", "string", "unsignedInt", "unsignedShort", "int")
_VEHICLE_CATEGORIES: Final = (
    "bicycle", "bus", "car", "motorbike", "semitrailer", "trailer", "train", "tram", "truck", "van",
)  # fmt: skip
_ELEMENT_STATES: Final = (
    "completeState", "endTransition", "runningState", "skipTransition", "standbyState", "startTransition",
    "stopTransition",
)  # fmt: skip

# Allowed values by attribute, or by element/attribute.
_ENUMERATIONS: Final[dict[str, tuple[str, ...]]] = {
    "parameterType": _PARAMETER_TYPES,
    "variableType": _PARAMETER_TYPES,
    "angleType": ("heading", "pitch", "roll"),
    "conditionEdge": ("falling", "none", "rising", "risingOrFalling"),
    "coordinateSystem": ("entity", "lane", "road", "trajectory", "world"),
    "AccelerationCondition/direction": ("longitudinal", "lateral", "vertical"),
    "RelativeSpeedCondition/direction": ("longitudinal", "lateral", "vertical"),
    "SpeedCondition/direction": ("longitudinal", "lateral", "vertical"),
    "displacement": (
        "any", "leftToReferencedEntity", "rightToReferencedEntity", "trailingReferencedEntity",
        "leadingReferencedEntity",
    ),
    "domainAbsoluteRelative": ("absolute", "relative"),
    "dynamicsDimension": ("distance", "rate", "time"),
    "dynamicsShape": ("cubic", "linear", "sinusoidal", "step"),
    "followingMode": ("follow", "position"),
    "priority": ("overwrite", "override", "parallel", "skip"),
    "relativeDistanceType": ("lateral", "longitudinal", "cartesianDistance", "euclidianDistance"),
    "routeStrategy": ("fastest", "leastIntersections", "random", "shortest"),
    "routingAlgorithm": ("assignedRoute", "fastest", "leastIntersections", "shortest", "undefined"),
    "rule": ("equalTo", "greaterThan", "lessThan", "greaterOrEqual", "lessOrEqual", "notEqualTo"),
    "speedTargetValueType": ("delta", "factor"),
    "StoryboardElementStateCondition/state": _ELEMENT_STATES,
    "storyboardElementType": ("act", "action", "event", "maneuver", "maneuverGroup", "story"),
    "triggeringEntitiesRule": ("all", "any"),
    "Orientation/type": ("absolute", "relative"),
    "ByObjectType/type": ("miscellaneous", "pedestrian", "vehicle", "external"),
    "objectType": ("miscellaneous", "pedestrian", "vehicle", "external"),
    "vehicleCategory": _VEHICLE_CATEGORIES,
    "pedestrianCategory": ("animal", "pedestrian", "wheelchair"),
}  # fmt: skip

# Other spellings of these values, in lower case.
_SYNONYMS: Final = {
    "bool": "boolean", "float": "double", "real": "double", "number": "double", "long": "integer", "short": "integer",
    "str": "string", "text": "string", "uint": "unsignedInt", "unsigned": "unsignedInt",
    "unsignedinteger": "unsignedInt", "ushort": "unsignedShort",
    "euclideandistance": "euclidianDistance", "greaterthanorequal": "greaterOrEqual",
    "greaterthanorequalto": "greaterOrEqual", "greaterorequalto": "greaterOrEqual", "lessthanorequal": "lessOrEqual",
    "lessthanorequalto": "lessOrEqual", "lessorequalto": "lessOrEqual", "equal": "equalTo", "equals": "equalTo",
    "notequal": "notEqualTo", "motorcycle": "motorbike", "bike": "bicycle",
}  # fmt: skip

_BOOLEAN_ATTRIBUTES: Final = frozenset({
    "activateAnimation", "activateLateral", "activateLighting", "activateLongitudinal", "active", "alongRoute",
    "animation", "closed", "continuous", "freeSpace", "freespace", "graphics", "lateral", "lighting", "longitudinal",
    "loop", "oppositeLanes", "selectTriggeringEntities", "sensors", "traffic",
})  # fmt: skip

# Defaults for missing mandatory attributes, by element.
_DEFAULTS: Final[dict[str, dict[str, str]]] = {
    "Condition": {"conditionEdge": "none", "delay": "0"},
    "Event": {"priority": "parallel"},
    "ManeuverGroup": {"maximumExecutionCount": "1"},
    "Actors": {"selectTriggeringEntities": "false"},
    "TriggeringEntities": {"triggeringEntitiesRule": "any"},
    "Vehicle": {"vehicleCategory": "car"},
    "Center": {"x": "0", "y": "0", "z": "0"},
    "Trajectory": {"closed": "false"},
    "Route": {"closed": "false"},
    "Timing": {"domainAbsoluteRelative": "relative", "scale": "1", "offset": "0"},
    "TrajectoryFollowingMode": {"followingMode": "follow"},
    "DistanceCondition": {"freespace": "false"},
    "RelativeDistanceCondition": {"freespace": "false", "relativeDistanceType": "euclidianDistance"},
    "TimeHeadwayCondition": {"freespace": "false"},
    "TimeToCollisionCondition": {"freespace": "false"},
    "LaneOffsetAction": {"continuous": "false"},
    "LateralDistanceAction": {"continuous": "false", "freespace": "false"},
    "LongitudinalDistanceAction": {"continuous": "false", "freespace": "false"},
    "RelativeTargetSpeed": {"continuous": "false"},
    "RelativeLanePosition": {"dLane": "0"},
    "RelativeObjectPosition": {"dx": "0", "dy": "0"},
    "RelativeRoadPosition": {"ds": "0", "dt": "0"},
    "RelativeWorldPosition": {"dx": "0", "dy": "0"},
    "SpeedActionDynamics": {"dynamicsDimension": "time"},
    "LaneChangeActionDynamics": {"dynamicsDimension": "time"},
}
# Attributes that a step transition ignores.
_STEP_DEFAULTS: Final = {"dynamicsDimension": "time", "value": "0"}

# Elements with free text, where spaces matter.
_FREE_TEXT_ELEMENTS: Final = frozenset(
    {"FileHeader", "Property", "License", "UserDefinedAction", "CustomCommandAction"}
)
_TYPE_ATTRIBUTES: Final = {"ParameterDeclaration": "parameterType", "VariableDeclaration": "variableType"}
_UNLIMITED_COUNT: Final = "999999999"


def normalize_openscenario(root: etree._Element) -> None:
    """Correct violations of the standard in place where the meaning is clear; record each correction on its element.

    Scenarios, catalogs and parameter distributions are corrected. Other files stay as they are.
    """
    name = etree.QName(root).localname
    if name.lower() != "openscenario":
        return
    _remove_namespaces(root)
    if root.tag != "OpenSCENARIO":
        root.tag = "OpenSCENARIO"
        _record_change(root, f"<{name}>", "is read as <OpenSCENARIO>", "the root element is <OpenSCENARIO>")
    elements = list(iter_descendants_untracked(root, etree.Element))
    if not any(element.tag == "FileHeader" for element in etree.ElementBase.iterchildren(root, "FileHeader")):
        reason = "the file is read as OpenSCENARIO 1.3, in right-handed axes"
        _record_change(root, "missing <FileHeader>", reason, "a file begins with its <FileHeader>")
    for element in elements:
        _strip_attribute_values(element)
        _normalize_declaration(element)
        _normalize_values(element)
        _add_or_rename_attributes(element)


def _remove_namespaces(root: etree._Element) -> None:
    """Remove namespaces from element names."""
    spaces = set()
    for element in iter_descendants_untracked(root, "{*}*"):
        qualified = etree.QName(element)
        if qualified.namespace is not None:
            spaces.add(qualified.namespace)
            element.tag = qualified.localname
    if spaces:
        etree.cleanup_namespaces(root, keep_ns_prefixes=["xsi"])
        namespace = f"namespace {sorted(spaces)[0]}"
        _record_change(root, namespace, "is left out", "elements of OpenSCENARIO are in no namespace")


def _strip_attribute_values(element: etree._Element) -> None:
    if element.tag in _FREE_TEXT_ELEMENTS:
        return
    for key, value in _attribute_items(element):
        stripped = value.strip()
        if stripped != value:
            element.set(key, stripped)
            # XML allows spaces around numbers and booleans.
            if not (_is_number(stripped) or stripped in ("true", "false") or stripped.startswith("$")):
                reason = f"'{stripped}' is read without the spaces around it"
                _record_change(element, f"{key} of <{element.tag}>", reason, "spaces are part of a name")


def _normalize_declaration(element: etree._Element) -> None:
    """Correct the declaration of a parameter or variable, or the parameter name of a distribution."""
    kind = _TYPE_ATTRIBUTES.get(str(element.tag))
    name_attribute = (
        "name" if kind is not None else "parameterName" if str(element.tag).endswith("Distribution") else None
    )
    name = "" if name_attribute is None else element.attrib.get(name_attribute, "")
    if name_attribute is not None and len(name) > 1 and name.startswith("$"):
        element.set(name_attribute, name[1:])
        reason = f"'{name}' is read as '{name[1:]}'"
        _record_change(
            element, f"{name_attribute} of <{element.tag}>", reason, "names are declared without a dollar sign"
        )
    if kind is None or element.attrib.get(kind):
        return
    value = element.attrib.get("value", "")
    inferred = "double" if _is_number(value) else "boolean" if value.lower() in ("true", "false") else "string"
    element.set(kind, inferred)
    reason = f"'{element.attrib.get('name', '')}' is read as {inferred} because of its value '{value[:40]}'"
    _record_change(element, f"missing {kind} of <{element.tag}>", reason, f"a declaration has a {kind}")


def _normalize_values(element: etree._Element) -> None:
    """Correct the spelling of enumerations, booleans and counts."""
    tag, declared = str(element.tag), _TYPE_ATTRIBUTES.get(str(element.tag))
    for key, value in _attribute_items(element):
        allowed = _ENUMERATIONS.get(key) or _ENUMERATIONS.get(f"{tag}/{key}")
        if allowed is not None and value not in allowed and not value.startswith("$"):
            match = _match_allowed_value(value, allowed)
            if match is not None:
                element.set(key, match)
                _record_change(
                    element, f"{key} of <{tag}>", f"'{value}' is read as {match}", f"it is {_join_with_or(allowed)}"
                )
        elif key in _BOOLEAN_ATTRIBUTES and value.lower() in ("true", "false") and value != value.lower():
            _lowercase_boolean(element, key, value)
    value = element.attrib.get("value", "")
    if declared is not None and element.attrib.get(declared) == "boolean" and value.lower() in ("true", "false"):
        _lowercase_boolean(element, "value", value)
    if tag == "ConnectTrailerAction" and element.attrib.get("trailer") and not element.attrib.get("trailerRef"):
        element.set("trailerRef", element.attrib.pop("trailer"))
        _record_change(element, f"trailer of <{tag}>", "is read as trailerRef", f"<{tag}> has a trailerRef")
    if tag in ("Event", "ManeuverGroup") and element.attrib.get("maximumExecutionCount") == "-1":
        element.set("maximumExecutionCount", _UNLIMITED_COUNT)
        reason = "-1 is read as unlimited, as in esmini"
        _record_change(element, f"maximumExecutionCount of <{tag}>", reason, "it is a whole number above 0")


def _attribute_items(element: etree._Element) -> list[tuple[str, str]]:
    return [(str(key), str(value)) for key, value in element.items()]


def _lowercase_boolean(element: etree._Element, key: str, value: str) -> None:
    if value != value.lower():
        element.set(key, value.lower())
        reason = f"'{value}' is read as {value.lower()}"
        _record_change(element, f"{key} of <{element.tag}>", reason, "a boolean is true, false, 1 or 0")


def _add_or_rename_attributes(element: etree._Element) -> None:
    """Add missing mandatory attributes with default values; also correct the letter case of their names."""
    tag = str(element.tag)
    needed = _DEFAULTS.get(tag)
    if needed is None:
        return
    if tag.endswith("ActionDynamics") and element.attrib.get("dynamicsShape") == "step":
        needed = _STEP_DEFAULTS
    for key, value in needed.items():
        misspelled = next(
            (name for name, _ in _attribute_items(element) if name.lower() == key.lower() and name != key), None
        )
        if misspelled is not None and key not in element.attrib:
            element.set(key, element.attrib.pop(misspelled))
            _record_change(element, f"{misspelled} of <{tag}>", f"is read as {key}", f"<{tag}> has a {key}")
        elif element.attrib.get(key, "") == "":
            element.set(key, value)
            _record_change(element, f"missing {key} of <{tag}>", f"is read as {value}", f"<{tag}> has a {key}")


def _match_allowed_value(value: str, allowed: tuple[str, ...]) -> str | None:
    """Return the allowed value that a misspelled value means; None if the meaning is not clear."""
    letters = re.sub("[^a-z]", "", value.lower())
    if letters in _SYNONYMS and _SYNONYMS[letters] in allowed:
        return _SYNONYMS[letters]
    return next((candidate for candidate in allowed if candidate.lower() == letters), None)


def _join_with_or(values: tuple[str, ...]) -> str:
    return f"{', '.join(values[:-1])} or {values[-1]}"


def _is_number(text: str) -> bool:
    try:
        parse_number(text)
    except ValueError:
        return False
    return True


def _record_change(element: etree._Element, subject: str, change: str, rule: str) -> None:
    for noted in _elements_to_annotate(element):
        note_adaptation(noted, subject, change, rule)


def _elements_to_annotate(element: etree._Element) -> Iterator[etree._Element]:
    """Yield the elements on which to record a correction of an element.

    This is the element itself. For the root of a catalog file, it is each catalog entry.
    """
    catalog = None if element.getparent() is not None else etree.ElementBase.find(element, "Catalog")
    yield from (element,) if catalog is None else etree.ElementBase.iterchildren(catalog, etree.Element)
