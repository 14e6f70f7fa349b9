"""List the numbers of a scenario file that can be varied, with names that can be typed."""

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
from cornercase._common.ledger import warn
from cornercase._common.numbers import finite_number
from cornercase._common.places import line_of
from cornercase._common.texts import shorten
from cornercase.scenario.criteria import is_never_true
from cornercase.scenario.declared_types import INTEGERS, NUMERIC
from cornercase.scenario.openscenario import Scenario
from cornercase.scenario.road_extent import RoadExtent, read_extents
from cornercase.scenario.variable_kinds import DYNAMICS, ELSEWHERE, LANE, NUMBERS, RATE_OF_LANES, SPEED_FACTOR, Kind
from cornercase.scenario.xml import parse_xml

# Largest lengths of parts of names, so that the table of names fits a terminal.
_LONGEST: Final = 24
_LONGEST_BETWEEN: Final = 16
_LONGEST_SHOWN: Final = 60
_BRAKING: Final = ("m/s²", "m/s³")
_ON_ROADS: Final = ("LanePosition", "RoadPosition")


@dataclass(frozen=True)
class Variable:
    """A number of a scenario file that can be varied, or the reason why it cannot.

    Attributes
    ----------
    name : str
        Its name for `vary`: ``"Ego.initial.speed"``.
    group : str
        What it belongs to: ``"entity Ego"``, ``"event CutIn"``.
    text : str
        As written in the file.
    unit : str
        Empty for numbers without one.
    line : int
        Line in the file; the first of several.
    low, high : float or None
        Proposed range; None if there is none.
    least, most : float or None
        Bounds for any range; None if there are none.
    whole : bool
        Whether it is an integer.
    parameter : str
        Name of the parameter that replaces it when it is varied, or its own if it is a parameter already.
    fixed : str
        Why it cannot be varied; empty if it can.
    declared : bool
        Whether it is a parameter already.
    lanes : frozenset of int
        Possible values of a lane number, if the road could be read.
    places : tuple of (int, str)
        Index of each element that holds it, in the order of the file from 0, and the attribute.

    Examples
    --------
    >>> from cornercase.scenario import variables
    >>> listed = {variable.name: variable for variable in variables("examples/x_intersection/x_intersection.xosc")}
    >>> listed["C_stops.rate"].text, listed["C_stops.rate"].unit, listed["C_stops.rate"].proposal
    ('4', 'm/s²', '2.8:5.2')
    """

    name: str
    group: str
    text: str
    unit: str = ""
    line: int = 0
    low: float | None = None
    high: float | None = None
    least: float | None = None
    most: float | None = None
    whole: bool = False
    parameter: str = ""
    fixed: str = ""
    declared: bool = False
    lanes: frozenset[int] = frozenset()
    places: tuple[tuple[int, str], ...] = field(default=(), repr=False)

    @property
    def proposal(self) -> str:
        """Proposed range, as ``"5:20"``; empty if there is none."""
        return "" if self.low is None or self.high is None else f"{_plain(self.low)}:{_plain(self.high)}"


@dataclass(frozen=True)
class _Found:
    """A number before it gets a name that is unique in its group."""

    base: str
    qualifier: str
    suffix: str
    variable: Variable


def variables(scenario: Scenario | Path | str) -> tuple[Variable, ...]:
    """List the numbers of a scenario that can be varied.

    These are the numeric parameters that it declares, and the numbers in it: initial speeds and positions, values of
    triggers, targets and dynamics of actions. Each has a name that includes its entity or event, and a proposed range.

    Parameters
    ----------
    scenario : Scenario or path
        OpenSCENARIO file; the numbers are in its own axes.

    Returns
    -------
    tuple of Variable
        In the order of the file; includes those that cannot be varied, with the reason.

    Raises
    ------
    InputError
        The file cannot be used.

    See Also
    --------
    vary : Writes a scenario with varied numbers.

    Examples
    --------
    >>> from cornercase.scenario import variables
    >>> for variable in variables("examples/r157/cut_in.xosc")[4:6]:
    ...     print(variable.name, variable.text, variable.unit, variable.proposal)
    Ego.initial.x 100 m 95:105
    Ego.initial.y -5.25 m -10.2:-0.2
    """
    file = Scenario.read(scenario.path if isinstance(scenario, Scenario) else scenario)
    return variables_of(file, parse_xml(file.contents()[file.path], file.path))


def variables_of(scenario: Scenario, root: etree._Element) -> tuple[Variable, ...]:
    """List the variables of a parsed scenario file; reading `root` does not mark its elements as used."""
    return _Listing(scenario, root).all()


class _Listing:
    def __init__(self, scenario: Scenario, root: etree._Element) -> None:
        self._scenario, self._root = scenario, root
        self._numbers = {element: k for k, element in enumerate(root.iter("*"))}
        self._declared = {e.get("name", ""): e.get("value", "") for e in _each(root, "ParameterDeclarations")}
        self._parts: dict[etree._Element, str] = {}
        self._known: dict[str, _Names] = {}
        self._roads: dict[str, RoadExtent] | None = None

    def all(self) -> tuple[Variable, ...]:
        """All variables, with unique names and parameter names."""
        with suppress(InputError):
            # Invalid paths are reported when the scenario runs.
            if problem := self._without_road():
                warn(f"no range is proposed for positions on roads: {problem}")
        numbers = [*self._of_init(), *self._of_storyboard()]
        several = Counter((number.base, number.suffix) for number in numbers)
        listed = list(self._of_parameters())
        names = _Names(number.name for number in listed)
        parameters = _Names(
            str(e.get("name", "")) for e in self._root.iter("ParameterDeclaration", "VariableDeclaration")
        )
        for number in numbers:
            middle = (number.qualifier,) if several[number.base, number.suffix] > 1 and number.qualifier else ()
            name = names.new(".".join((number.base, *middle, number.suffix)))
            identifier = re.sub(r"[^A-Za-z0-9_]", "_", name)
            parameter = parameters.new(identifier if identifier[:1].isalpha() else f"v_{identifier}")
            listed.append(replace(number.variable, name=name, parameter=parameter))
        return tuple(listed)

    def _of_parameters(self) -> Iterator[Variable]:
        for element in _each(self._root, "ParameterDeclarations"):
            kind = element.get("parameterType", "string")
            if kind in NUMERIC:
                name, text = element.get("name", ""), element.get("value", "")
                yield Variable(
                    name,
                    "parameters",
                    text,
                    line=line_of(element),
                    whole=kind in INTEGERS,
                    parameter=name,
                    declared=True,
                )

    def _of_init(self) -> Iterator[_Found]:
        for private in self._root.iterfind("Storyboard/Init/Actions/Private"):
            entity = self._text(private.get("entityRef", ""))
            for action in private.iterchildren("PrivateAction"):
                leaf = next((e for e in action.iterdescendants("*") if str(e.tag).endswith("Action")), action)
                qualifier = re.sub("Action$", "", str(leaf.tag))
                yield from self._below(action, f"{_part(entity)}.initial", qualifier, f"entity {entity}")

    def _of_storyboard(self) -> Iterator[_Found]:
        for act in self._root.iterfind("Storyboard/Story/Act"):
            name = self._name(act, "act")
            yield from self._of_trigger(act.find("StartTrigger"), f"{name}.start", f"act {_called(act)}")
            for group in act.iterfind("ManeuverGroup"):
                for maneuver in group.iterchildren("Maneuver", "CatalogReference"):
                    yield from self._of_maneuver(maneuver)
            yield from self._of_trigger(act.find("StopTrigger"), f"{name}.stop", f"act {_called(act)}")
        yield from self._of_trigger(self._root.find("Storyboard/StopTrigger"), "storyboard.stop", "storyboard")

    def _of_maneuver(self, maneuver: etree._Element) -> Iterator[_Found]:
        if maneuver.tag == "CatalogReference":
            yield from self._of_reference(maneuver)
            return
        for element in _each(maneuver, "ParameterDeclarations"):
            kind = element.get("parameterType", "string")
            if kind in NUMERIC:
                base, group = self._name(maneuver, "maneuver"), f"maneuver {_called(maneuver)}"
                suffix = _part(element.get("name", ""))
                yield from self._number([element], "value", base, "", suffix, Kind(whole=kind in INTEGERS), group)
        for event in maneuver.iterfind("Event"):
            name, group = self._name(event, "event"), f"event {_called(event)}"
            yield from self._of_trigger(event.find("StartTrigger"), f"{name}.trigger", group)
            for action in event.iterfind("Action"):
                yield from self._below(action, name, _part(action.get("name", ""), longest=_LONGEST_BETWEEN), group)

    def _of_reference(self, reference: etree._Element) -> Iterator[_Found]:
        """Values that are assigned to a maneuver of a catalog; its other numbers are in the catalog."""
        catalog, entry = self._text(reference.get("catalogName", "")), self._text(reference.get("entryName", ""))
        group = f"maneuver {shorten(entry, _LONGEST_SHOWN)} of the catalog {shorten(catalog, _LONGEST_SHOWN)}"
        try:
            declared = self._scenario.catalog_entry(catalog, entry)
            kinds = {e.get("name", ""): e.get("parameterType", "") for e in _each(declared, "ParameterDeclarations")}
        except InputError:
            kinds = {}
        for element in reference.iterfind("ParameterAssignments/ParameterAssignment"):
            name = element.get("parameterRef", "").lstrip("$")
            if kinds.get(name) in NUMERIC:
                kind = Kind(whole=kinds[name] in INTEGERS)
                yield from self._number([element], "value", _part(entry), "", _part(name), kind, group)
        shown_catalog = shorten(catalog, _LONGEST_SHOWN)
        reason = f"its numbers are in the catalog {shown_catalog}; copy the maneuver into the scenario to vary them"
        yield _Found(
            _part(entry), "", "catalog", Variable("", group, "in a catalog", line=line_of(reference), fixed=reason)
        )

    def _of_trigger(self, trigger: etree._Element | None, base: str, group: str) -> Iterator[_Found]:
        """Numbers of conditions; identical conditions in several groups of a trigger share their variables."""
        identical: dict[Any, list[etree._Element]] = {}
        groups = () if trigger is None else trigger.iterfind("ConditionGroup")
        # Groups that are never true have no effect.
        possible = (group for group in groups if not self._is_never_true(group))
        for condition in (condition_ for group in possible for condition_ in group.iterchildren("Condition")):
            content = tuple(_content(child) for child in condition.iterchildren("*"))
            identical.setdefault((condition.get("delay", ""), content), []).append(condition)
        for conditions in identical.values():
            qualifier = _part(conditions[0].get("name", ""), longest=_LONGEST_BETWEEN)
            yield from self._below(conditions[0], base, qualifier, group, conditions)

    def _is_never_true(self, group: etree._Element) -> bool:
        """Whether a group contains a criterion of ScenarioRunner, or another condition that is never true."""
        for condition in group.iterfind("Condition/ByValueCondition/ParameterCondition"):
            name = condition.get("parameterRef", "").lstrip("$")
            if name not in self._declared and is_never_true(condition, name):
                return True
        return False

    def _below(
        self, top: etree._Element, base: str, qualifier: str, group: str, same: list[etree._Element] | None = None
    ) -> Iterator[_Found]:
        """Numbers of an element and its descendants; `identical_elements` share them."""
        rows = zip(*(_looked_into(twin) for twin in same or [top]), strict=True)
        entries = 0
        for row in rows:
            element = row[0]
            entries += element.tag == "SpeedProfileEntry"
            row_qualifier = f"entry_{entries}" if element.tag == "SpeedProfileEntry" else qualifier
            for attribute, (suffix, kind) in _numbers_of(element).items():
                full_suffix = f"{_role(element, top)}{suffix}"
                yield from self._number(list(row), attribute, base, row_qualifier, full_suffix, kind, group)

    def _number(
        self, elements: list[etree._Element], attribute: str, base: str, qualifier: str, suffix: str, kind: Kind,
        group: str,
    ) -> Iterator[_Found]:  # fmt: skip
        element = elements[0]
        text = (element.get(attribute) or "").strip()
        variable = Variable("", group, text, kind.unit, line_of(element), whole=kind.whole)
        if text.startswith("$"):
            reason = f"it is {shorten(text, _LONGEST_SHOWN)}" + (
                "; vary the parameter" if text[1:] in self._declared else ""
            )
            yield _Found(base, qualifier, suffix, replace(variable, fixed=reason))
            return
        value = finite_number(text)
        if value is None or (kind.whole and value != round(value)):
            return
        least, most = kind.least, None
        if least is not None and value < least and kind.unit in _BRAKING:
            # Many files write a negative value for braking.
            least = None
        inner_least, inner_most, lanes = least, most, frozenset[int]()
        road, lane, s = self._on_road(element)
        if road is not None and attribute in ("s", "laneId"):
            if attribute == "s":
                most = road.length
                inner_least, inner_most = (0.0, most) if lane is None else road.stretch(lane, value)
            elif s is not None:
                lanes = road.lanes_at(s)
                inner_least, inner_most = road.alike(round(value), s) or (None, None)
                kind = replace(kind, half=math.inf) if inner_least is not None else kind
        # The value in the file stays possible.
        least = None if least is not None and value < least else least
        most = None if most is not None and value > most else most
        if road is None and attribute == "s" and element.tag in _ON_ROADS:
            # Propose no range, as the length of the road is unknown.
            kind = Kind(kind.unit)
        range_ = _proposed(kind, value, inner_least, inner_most)
        yield _Found(
            base, qualifier, suffix,
            replace(
                variable, low=range_[0], high=range_[1], least=least, most=most, lanes=lanes,
                places=tuple((self._numbers[twin], attribute) for twin in elements),
            ),
        )  # fmt: skip

    def _on_road(self, element: etree._Element) -> tuple[RoadExtent | None, int | None, float | None]:
        """Return road, lane and s of a position, as far as they are known."""
        if element.tag not in _ON_ROADS:
            return None, None, None
        if self._roads is None:
            self._roads = read_extents(self._scenario.road_file())
        lane, s = (finite_number(self._text(element.get(name) or "")) for name in ("laneId", "s"))
        lane_id = None if lane is None or lane != round(lane) else round(lane)
        return self._roads.get(self._text(element.get("roadId", ""))), lane_id, s

    def _without_road(self) -> str:
        """Return why the road file cannot be read; empty if it can."""
        if "$" in self._scenario.road_reference():
            return "an expression names the road file"
        return self._scenario.missing_road()

    def _text(self, text: str) -> str:
        """Return a text, or the value of the parameter that it refers to."""
        return self._declared.get(text[1:], text) if text.startswith("$") else text

    def _name(self, element: etree._Element, what: str) -> str:
        """Return the part of a name that stands for an element, unique among elements of its kind."""
        if element not in self._parts:
            self._parts[element] = self._known.setdefault(what, _Names(())).new(_part(element.get("name", ""), what))
        return self._parts[element]


def _numbers_of(element: etree._Element) -> Mapping[str, tuple[str, Kind]]:
    tag = str(element.tag)
    if tag == "RelativeTargetSpeed" and element.get("speedTargetValueType") == "factor":
        return {"value": SPEED_FACTOR}
    if tag in ("SpeedActionDynamics", "LaneChangeActionDynamics"):
        dimension = element.get("dynamicsDimension", "")
        # A step takes no time, whatever the value.
        if element.get("dynamicsShape") == "step" or dimension not in DYNAMICS:
            return {}
        lanes = tag == "LaneChangeActionDynamics" and dimension == "rate"
        return {"value": RATE_OF_LANES if lanes else DYNAMICS[dimension]}
    return {name: entry for name, entry in NUMBERS.get(tag, {}).items() if element.get(name) is not None}


def _role(element: etree._Element, top: etree._Element) -> str:
    """What goes before the name of a number, where an action has two positions."""
    ancestor: etree._Element | None = element.getparent()
    while ancestor is not None and ancestor is not top:
        if ancestor.tag in ("TargetPositionMaster", "TargetPosition"):
            return "master_" if ancestor.tag == "TargetPositionMaster" else "target_"
        ancestor = ancestor.getparent()
    return ""


def _looked_into(element: etree._Element) -> Iterator[etree._Element]:
    yield element
    for child in element.iterchildren("*"):
        if child.tag not in ELSEWHERE:
            yield from _looked_into(child)


def _content(element: etree._Element) -> tuple[Any, ...]:
    """Content of an element, independent of its formatting."""
    attributes = tuple(sorted((str(key), str(value)) for key, value in element.attrib.items()))
    return str(element.tag), attributes, tuple(_content(child) for child in element.iterchildren("*"))


def _proposed(kind: Kind, value: float, low: float | None, high: float | None) -> tuple[float | None, float | None]:
    if kind is LANE:
        return None, None
    if kind.whole and math.isinf(kind.half):
        return (low, high) if low is not None and high is not None and low < high else (None, None)
    return kind.proposed(value, low, high) or (None, None)


def _each(element: etree._Element, holder: str) -> Iterator[etree._Element]:
    yield from element.iterfind(f"{holder}/ParameterDeclaration")


def _part(text: str, empty: str = "", longest: int = _LONGEST) -> str:
    """Make a text usable as a part of a name: letters, digits, hyphens and underscores."""
    identifier = re.sub(r"[^\w-]+", "_", text).strip("_-")
    return identifier[:longest].rstrip("_-") or empty


def _called(element: etree._Element) -> str:
    return shorten(str(element.get("name", "")), _LONGEST_SHOWN)


class _Names:
    """Makes names unique."""

    def __init__(self, taken: Iterable[str]) -> None:
        self._counts = dict.fromkeys(taken, 1)

    def new(self, name: str) -> str:
        """Return the name, with a number appended if it exists."""
        unique = name
        while unique in self._counts:
            self._counts[name] += 1
            unique = f"{name}_{self._counts[name]}"
        self._counts[unique] = 1
        return unique


def _plain(value: float) -> str:
    return f"{value:.12g}"
