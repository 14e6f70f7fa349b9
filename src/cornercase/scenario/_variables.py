"""List the numbers of a scenario file that can be varied, and give each a name that users can type."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.io.support_table import issue_notice_warning
from cornercase._common.text.element_locations import line_number
from cornercase._common.text.parse_number import parse_finite_number
from cornercase._common.text.sanitize import shorten
from cornercase.scenario._file import ScenarioFile
from cornercase.scenario._quantities import (
    DYNAMICS_QUANTITIES,
    LANE_CHANGE_RATE,
    LANE_NUMBER,
    QUANTITIES,
    SKIPPED_ELEMENTS,
    SPEED_FACTOR,
    Quantity,
)
from cornercase.scenario._road_extent import RoadExtent, read_road_extents
from cornercase.scenario._scenario_runner_criteria import is_condition_never_true
from cornercase.scenario._types import INTEGER_TYPES, NUMERIC_TYPES
from cornercase.scenario._xml import parse_xml

# Largest lengths of parts of names, so that the table of names fits a terminal.
_MAX_NAME_PART: Final = 24
_MAX_MIDDLE_PART: Final = 16
_MAX_SHOWN: Final = 60
_DECELERATION_UNITS: Final = ("m/s²", "m/s³")
_ROAD_POSITION_TAGS: Final = ("LanePosition", "RoadPosition")


@dataclass(frozen=True)
class Variable:
    """A number of a scenario file that can be varied, or the reason why it cannot.

    Attributes
    ----------
    name : str
        Name that `vary` takes: ``"Ego.initial.speed"``.
    group : str
        Entity or event that the number belongs to: ``"entity Ego"``, ``"event CutIn"``.
    value_text : str
        The number as written in the file.
    unit : str
        Unit; empty for numbers without unit.
    line : int
        Line in the file; the first line if the number occurs several times.
    proposed_low, proposed_high : float or None
        Proposed range; None if no range is proposed.
    minimum, maximum : float or None
        Smallest and largest value that a range may have; None if there is no such limit.
    is_integer : bool
        Whether the number must be an integer.
    parameter_name : str
        Name of the parameter that replaces the number when the number is varied. If the number is the value of a
        declared parameter, the name of that parameter.
    reason_fixed : str
        Why the number cannot be varied; empty if it can be varied.
    is_declared : bool
        Whether the number is the value of a declared parameter.
    allowed_lanes : frozenset of int
        If the number is a lane number, the lanes of the road at this position; empty for other numbers, and if the road
        file could not be read.
    occurrences : tuple of (int, str)
        For each place at which the number stands in the file: the index of the element (in file order, from 0), and the
        name of the attribute. Empty if the number is the value of a declared parameter, or cannot be varied.

    Examples
    --------
    >>> from cornercase.scenario import list_variables
    >>> listed = {variable.name: variable for variable in list_variables("examples/x_intersection/x_intersection.xosc")}
    >>> listed["C_stops.rate"].value_text, listed["C_stops.rate"].unit, listed["C_stops.rate"].proposed_range
    ('4', 'm/s²', '2.8:5.2')
    """

    name: str
    group: str
    value_text: str
    unit: str = ""
    line: int = 0
    proposed_low: float | None = None
    proposed_high: float | None = None
    minimum: float | None = None
    maximum: float | None = None
    is_integer: bool = False
    parameter_name: str = ""
    reason_fixed: str = ""
    is_declared: bool = False
    allowed_lanes: frozenset[int] = frozenset()
    occurrences: tuple[tuple[int, str], ...] = field(default=(), repr=False)

    @property
    def proposed_range(self) -> str:
        """Proposed range as text, such as ``"5:20"``; empty if no range is proposed."""
        return (
            ""
            if self.proposed_low is None or self.proposed_high is None
            else f"{_format_number(self.proposed_low)}:{_format_number(self.proposed_high)}"
        )


@dataclass(frozen=True)
class _UnnamedVariable:
    """A number in a scenario file, with the parts of its future name: names are made unique when all are known."""

    base: str
    qualifier: str
    suffix: str
    variable: Variable


def list_variables(scenario: ScenarioFile | Path | str) -> tuple[Variable, ...]:
    """List the numbers of a scenario that can be varied.

    The list contains declared numeric parameters, initial speeds and positions, values of triggers, and targets and
    dynamics of actions. The name of a number includes its entity or event. Most numbers have a proposed range.

    Parameters
    ----------
    scenario : ScenarioFile or path
        OpenSCENARIO file. Coordinates are in the axes of this file.

    Returns
    -------
    tuple of Variable
        First the declared parameters, then the numbers of the initial actions and of the other parts of the
        storyboard; a start trigger comes before what it starts. Numbers that cannot be varied are included, with the
        reason.

    Raises
    ------
    InputError
        The file cannot be used.

    See Also
    --------
    vary : Writes a scenario with varied numbers.

    Examples
    --------
    >>> from cornercase.scenario import list_variables
    >>> for variable in list_variables("examples/r157/cut_in.xosc")[4:6]:
    ...     print(variable.name, variable.value_text, variable.unit, variable.proposed_range)
    Ego.initial.x 100 m 95:105
    Ego.initial.y -5.25 m -10.2:-0.2
    """
    file = ScenarioFile.read(scenario.path if isinstance(scenario, ScenarioFile) else scenario)
    return list_variables_in(file, parse_xml(file.read_all_files()[file.path], file.path))


def list_variables_in(scenario: ScenarioFile, root: etree._Element) -> tuple[Variable, ...]:
    """List the numbers of a parsed scenario file that can be varied, without marking its elements as used."""
    return _VariableCollector(scenario, root).collect()


class _VariableCollector:
    def __init__(self, scenario: ScenarioFile, root: etree._Element) -> None:
        self._scenario, self._root = scenario, root
        self._element_indices = {element: k for k, element in enumerate(root.iter("*"))}
        self._declared_values = {
            e.get("name", ""): e.get("value", "") for e in _parameter_declarations(root, "ParameterDeclarations")
        }
        self._name_parts: dict[etree._Element, str] = {}
        self._name_pools: dict[str, _UniqueNames] = {}
        self._roads: dict[str, RoadExtent] | None = None

    def collect(self) -> tuple[Variable, ...]:
        """Return all variables, with unique names and parameter names."""
        with suppress(InputError):
            # Invalid paths are reported when the scenario runs.
            if problem := self._describe_missing_road():
                issue_notice_warning(f"no range is proposed for positions on roads: {problem}")
        numbers = [*self._collect_init_actions(), *self._collect_storyboard()]
        several = Counter((number.base, number.suffix) for number in numbers)
        listed = list(self._collect_parameters())
        names = _UniqueNames(number.name for number in listed)
        parameters = _UniqueNames(
            str(e.get("name", "")) for e in self._root.iter("ParameterDeclaration", "VariableDeclaration")
        )
        for number in numbers:
            middle = (number.qualifier,) if several[number.base, number.suffix] > 1 and number.qualifier else ()
            name = names.make_unique(".".join((number.base, *middle, number.suffix)))
            identifier = re.sub(r"[^A-Za-z0-9_]", "_", name)
            parameter = parameters.make_unique(identifier if identifier[:1].isalpha() else f"v_{identifier}")
            listed.append(replace(number.variable, name=name, parameter_name=parameter))
        return tuple(listed)

    def _collect_parameters(self) -> Iterator[Variable]:
        for element in _parameter_declarations(self._root, "ParameterDeclarations"):
            kind = element.get("parameterType", "string")
            if kind in NUMERIC_TYPES:
                name, text = element.get("name", ""), element.get("value", "")
                yield Variable(
                    name,
                    "parameters",
                    text,
                    line=line_number(element),
                    is_integer=kind in INTEGER_TYPES,
                    parameter_name=name,
                    is_declared=True,
                )

    def _collect_init_actions(self) -> Iterator[_UnnamedVariable]:
        for private in self._root.iterfind("Storyboard/Init/Actions/Private"):
            entity = self._resolve_parameter(private.get("entityRef", ""))
            for action in private.iterchildren("PrivateAction"):
                leaf = next((e for e in action.iterdescendants("*") if str(e.tag).endswith("Action")), action)
                qualifier = re.sub("Action$", "", str(leaf.tag))
                yield from self._collect_descendants(
                    action, f"{_to_identifier(entity)}.initial", qualifier, f"entity {entity}"
                )

    def _collect_storyboard(self) -> Iterator[_UnnamedVariable]:
        for act in self._root.iterfind("Storyboard/Story/Act"):
            name = self._unique_name_part(act, "act")
            yield from self._collect_trigger(act.find("StartTrigger"), f"{name}.start", f"act {_shortened_name(act)}")
            for group in act.iterfind("ManeuverGroup"):
                for maneuver in group.iterchildren("Maneuver", "CatalogReference"):
                    yield from self._collect_maneuver(maneuver)
            yield from self._collect_trigger(act.find("StopTrigger"), f"{name}.stop", f"act {_shortened_name(act)}")
        yield from self._collect_trigger(self._root.find("Storyboard/StopTrigger"), "storyboard.stop", "storyboard")

    def _collect_maneuver(self, maneuver: etree._Element) -> Iterator[_UnnamedVariable]:
        if maneuver.tag == "CatalogReference":
            yield from self._collect_catalog_maneuver(maneuver)
            return
        for element in _parameter_declarations(maneuver, "ParameterDeclarations"):
            kind = element.get("parameterType", "string")
            if kind in NUMERIC_TYPES:
                base, group = self._unique_name_part(maneuver, "maneuver"), f"maneuver {_shortened_name(maneuver)}"
                suffix = _to_identifier(element.get("name", ""))
                yield from self._collect_number(
                    [element], "value", base, "", suffix, Quantity(is_integer=kind in INTEGER_TYPES), group
                )
        for event in maneuver.iterfind("Event"):
            name, group = self._unique_name_part(event, "event"), f"event {_shortened_name(event)}"
            yield from self._collect_trigger(event.find("StartTrigger"), f"{name}.trigger", group)
            for action in event.iterfind("Action"):
                yield from self._collect_descendants(
                    action, name, _to_identifier(action.get("name", ""), max_length=_MAX_MIDDLE_PART), group
                )

    def _collect_catalog_maneuver(self, reference: etree._Element) -> Iterator[_UnnamedVariable]:
        """Yield the numbers that a scenario assigns to parameters of a maneuver of a catalog.

        Also yield one item that says why the numbers in the catalog itself cannot be varied.
        """
        catalog, entry = (
            self._resolve_parameter(reference.get("catalogName", "")),
            self._resolve_parameter(reference.get("entryName", "")),
        )
        group = f"maneuver {shorten(entry, _MAX_SHOWN)} of the catalog {shorten(catalog, _MAX_SHOWN)}"
        try:
            declared = self._scenario.find_catalog_entry(catalog, entry)
            kinds = {
                e.get("name", ""): e.get("parameterType", "")
                for e in _parameter_declarations(declared, "ParameterDeclarations")
            }
        except InputError:
            kinds = {}
        for element in reference.iterfind("ParameterAssignments/ParameterAssignment"):
            name = element.get("parameterRef", "").lstrip("$")
            if kinds.get(name) in NUMERIC_TYPES:
                kind = Quantity(is_integer=kinds[name] in INTEGER_TYPES)
                yield from self._collect_number(
                    [element], "value", _to_identifier(entry), "", _to_identifier(name), kind, group
                )
        shown_catalog = shorten(catalog, _MAX_SHOWN)
        reason = f"its numbers are in the catalog {shown_catalog}; copy the maneuver into the scenario to vary them"
        yield _UnnamedVariable(
            _to_identifier(entry),
            "",
            "catalog",
            Variable("", group, "in a catalog", line=line_number(reference), reason_fixed=reason),
        )

    def _collect_trigger(self, trigger: etree._Element | None, base: str, group: str) -> Iterator[_UnnamedVariable]:
        """Yield the numbers in the conditions of a trigger.

        If several condition groups have the same condition, yield each of its numbers once, for all copies together.
        """
        identical: dict[Any, list[etree._Element]] = {}
        groups = () if trigger is None else trigger.iterfind("ConditionGroup")
        # Groups that are never true have no effect.
        possible = (group for group in groups if not self._is_group_never_true(group))
        for condition in (condition_ for group in possible for condition_ in group.iterchildren("Condition")):
            content = tuple(_element_content(child) for child in condition.iterchildren("*"))
            identical.setdefault((condition.get("delay", ""), content), []).append(condition)
        for conditions in identical.values():
            qualifier = _to_identifier(conditions[0].get("name", ""), max_length=_MAX_MIDDLE_PART)
            yield from self._collect_descendants(conditions[0], base, qualifier, group, conditions)

    def _is_group_never_true(self, group: etree._Element) -> bool:
        """Return whether a condition group can never be true, for example a request for a ScenarioRunner criterion."""
        for condition in group.iterfind("Condition/ByValueCondition/ParameterCondition"):
            name = condition.get("parameterRef", "").lstrip("$")
            if name not in self._declared_values and is_condition_never_true(condition, name):
                return True
        return False

    def _collect_descendants(
        self,
        top: etree._Element,
        base: str,
        qualifier: str,
        group: str,
        identical_elements: list[etree._Element] | None = None,
    ) -> Iterator[_UnnamedVariable]:
        """Yield the numbers of an element and its descendants.

        `identical_elements` are `top` and elements with the same content. Each number is yielded once for all of them.
        """
        rows = zip(*(_iter_searched_elements(twin) for twin in identical_elements or [top]), strict=True)
        entries = 0
        for row in rows:
            element = row[0]
            entries += element.tag == "SpeedProfileEntry"
            row_qualifier = f"entry_{entries}" if element.tag == "SpeedProfileEntry" else qualifier
            for attribute, (suffix, kind) in _quantities_of(element).items():
                full_suffix = f"{_synchronize_position_prefix(element, top)}{suffix}"
                yield from self._collect_number(list(row), attribute, base, row_qualifier, full_suffix, kind, group)

    def _collect_number(
        self,
        elements: list[etree._Element],
        attribute: str,
        base: str,
        qualifier: str,
        suffix: str,
        quantity: Quantity,
        group: str,
    ) -> Iterator[_UnnamedVariable]:
        element = elements[0]
        text = (element.get(attribute) or "").strip()
        variable = Variable("", group, text, quantity.unit, line_number(element), is_integer=quantity.is_integer)
        if text.startswith("$"):
            reason = f"it is {shorten(text, _MAX_SHOWN)}" + (
                "; vary the parameter" if text[1:] in self._declared_values else ""
            )
            yield _UnnamedVariable(base, qualifier, suffix, replace(variable, reason_fixed=reason))
            return
        value = parse_finite_number(text)
        if value is None or (quantity.is_integer and value != round(value)):
            return
        least, most = quantity.minimum, None
        if least is not None and value < least and quantity.unit in _DECELERATION_UNITS:
            # Many files write a negative value for braking.
            least = None
        inner_least, inner_most, lanes = least, most, frozenset[int]()
        road, lane, s = self._road_position(element)
        if road is not None and attribute in ("s", "laneId"):
            if attribute == "s":
                most = road.length
                inner_least, inner_most = (0.0, most) if lane is None else road.lane_interval(lane, value)
            elif s is not None:
                lanes = road.lanes_at(s)
                inner_least, inner_most = road.adjacent_lanes_of_same_type(round(value), s) or (None, None)
                quantity = replace(quantity, half_width=math.inf) if inner_least is not None else quantity
        # The value in the file stays possible.
        least = None if least is not None and value < least else least
        most = None if most is not None and value > most else most
        if road is None and attribute == "s" and element.tag in _ROAD_POSITION_TAGS:
            # Propose no range, as the length of the road is unknown.
            quantity = Quantity(quantity.unit)
        range_ = _propose_range(quantity, value, inner_least, inner_most)
        yield _UnnamedVariable(
            base,
            qualifier,
            suffix,
            replace(
                variable,
                proposed_low=range_[0],
                proposed_high=range_[1],
                minimum=least,
                maximum=most,
                allowed_lanes=lanes,
                occurrences=tuple((self._element_indices[twin], attribute) for twin in elements),
            ),
        )

    def _road_position(self, element: etree._Element) -> tuple[RoadExtent | None, int | None, float | None]:
        """Return the road, the lane number and s in m of a position element; parts that are not known are None."""
        if element.tag not in _ROAD_POSITION_TAGS:
            return None, None, None
        if self._roads is None:
            self._roads = read_road_extents(self._scenario.road_path_for())
        lane, s = (parse_finite_number(self._resolve_parameter(element.get(name) or "")) for name in ("laneId", "s"))
        lane_id = None if lane is None or lane != round(lane) else round(lane)
        return self._roads.get(self._resolve_parameter(element.get("roadId", ""))), lane_id, s

    def _describe_missing_road(self) -> str:
        """Return a part of a sentence on why the road file cannot be read; empty if no road file is missing."""
        if "$" in self._scenario.road_reference_for():
            return "an expression names the road file"
        return self._scenario.describe_missing_road()

    def _resolve_parameter(self, text: str) -> str:
        """Return the declared value of the parameter that a text (``$NAME``) refers to; otherwise the text itself."""
        return self._declared_values.get(text[1:], text) if text.startswith("$") else text

    def _unique_name_part(self, element: etree._Element, default: str) -> str:
        """Return the name of an element as a part of names of numbers, or `default` if the element has no name.

        A number is appended if another element with the same `default` has this name.
        """
        if element not in self._name_parts:
            self._name_parts[element] = self._name_pools.setdefault(default, _UniqueNames(())).make_unique(
                _to_identifier(element.get("name", ""), default)
            )
        return self._name_parts[element]


def _quantities_of(element: etree._Element) -> Mapping[str, tuple[str, Quantity]]:
    tag = str(element.tag)
    if tag == "RelativeTargetSpeed" and element.get("speedTargetValueType") == "factor":
        return {"value": SPEED_FACTOR}
    if tag in ("SpeedActionDynamics", "LaneChangeActionDynamics"):
        dimension = element.get("dynamicsDimension", "")
        # A step takes no time, whatever the value.
        if element.get("dynamicsShape") == "step" or dimension not in DYNAMICS_QUANTITIES:
            return {}
        lanes = tag == "LaneChangeActionDynamics" and dimension == "rate"
        return {"value": LANE_CHANGE_RATE if lanes else DYNAMICS_QUANTITIES[dimension]}
    return {name: entry for name, entry in QUANTITIES.get(tag, {}).items() if element.get(name) is not None}


def _synchronize_position_prefix(element: etree._Element, top: etree._Element) -> str:
    """Return a prefix for numbers in a synchronize action, which has a position for the master and a target position.

    The prefix is ``master_`` or ``target_`` for an element within these positions, and empty for other elements.
    """
    ancestor: etree._Element | None = element.getparent()
    while ancestor is not None and ancestor is not top:
        if ancestor.tag in ("TargetPositionMaster", "TargetPosition"):
            return "master_" if ancestor.tag == "TargetPositionMaster" else "target_"
        ancestor = ancestor.getparent()
    return ""


def _iter_searched_elements(element: etree._Element) -> Iterator[etree._Element]:
    yield element
    for child in element.iterchildren("*"):
        if child.tag not in SKIPPED_ELEMENTS:
            yield from _iter_searched_elements(child)


def _element_content(element: etree._Element) -> tuple[Any, ...]:
    """Return tags and attributes of an element and its descendants, for comparisons regardless of white space."""
    attributes = tuple(sorted((str(key), str(value)) for key, value in element.attrib.items()))
    return str(element.tag), attributes, tuple(_element_content(child) for child in element.iterchildren("*"))


def _propose_range(
    quantity: Quantity, value: float, low: float | None, high: float | None
) -> tuple[float | None, float | None]:
    if quantity is LANE_NUMBER:
        return None, None
    if quantity.is_integer and math.isinf(quantity.half_width):
        return (low, high) if low is not None and high is not None and low < high else (None, None)
    return quantity.propose_range(value, low, high) or (None, None)


def _parameter_declarations(element: etree._Element, holder: str) -> Iterator[etree._Element]:
    yield from element.iterfind(f"{holder}/ParameterDeclaration")


def _to_identifier(text: str, default: str = "", max_length: int = _MAX_NAME_PART) -> str:
    """Convert a text to a part of a name: letters, digits, hyphens and underscores; `default` if none is left."""
    identifier = re.sub(r"[^\w-]+", "_", text).strip("_-")
    return identifier[:max_length].rstrip("_-") or default


def _shortened_name(element: etree._Element) -> str:
    return shorten(str(element.get("name", "")), _MAX_SHOWN)


class _UniqueNames:
    """Record of the names in use, which makes new names unique."""

    def __init__(self, existing: Iterable[str]) -> None:
        self._counts = dict.fromkeys(existing, 1)

    def make_unique(self, name: str) -> str:
        """Return the name, with a number appended if the name is already in use."""
        unique = name
        while unique in self._counts:
            self._counts[name] += 1
            unique = f"{name}_{self._counts[name]}"
        self._counts[unique] = 1
        return unique


def _format_number(value: float) -> str:
    return f"{value:.12g}"
