"""Descriptions in words of the conditions of an OpenSCENARIO storyboard, for one concrete scenario."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Final

from lxml import etree

from cornercase._common.text.sanitize import quote_name
from cornercase.report.cards._settable_quantity import KMH_PER_MS
from cornercase.scenario._scope import Scope

_Describe = Callable[[etree._Element, Scope, str], str]

_RULES: Final = {
    "lessThan": "below", "lessOrEqual": "at most", "greaterThan": "above", "greaterOrEqual": "at least",
    "equalTo": "equal to", "notEqualTo": "not",
}  # fmt: skip
_STATES: Final = {
    "completeState": "has ended", "endTransition": "ends", "startTransition": "begins", "runningState": "goes on",
    "standbyState": "waits", "stopTransition": "is stopped", "skipTransition": "is skipped",
}  # fmt: skip


def describe_trigger(trigger: etree._Element | None, scope: Scope) -> str:
    """Describe a start trigger; the text is empty if the trigger has no conditions.

    As in OpenSCENARIO, "and" joins the conditions within a condition group, and "or" joins the groups.
    """
    if trigger is None:
        return ""
    groups = [
        " and ".join(_describe_condition(condition, scope) for condition in group.iterfind("Condition"))
        for group in trigger.iterfind("ConditionGroup")
    ]
    groups = [group for group in groups if group]
    return ", or ".join(groups)


def format_speed(speed: float) -> str:
    """Format a speed, given in m/s, as ``"36.0 km/h (10.00 m/s)"``."""
    return f"{speed * KMH_PER_MS:.1f} km/h ({speed:.2f} m/s)"


def _describe_condition(condition: etree._Element, scope: Scope) -> str:
    leaf = condition.find("ByValueCondition/*")
    who = ""
    if leaf is None:
        leaf = condition.find("ByEntityCondition/EntityCondition/*")
        entities = [
            quote_name(scope.read_text(reference, "entityRef"))
            for reference in condition.iterfind("ByEntityCondition/TriggeringEntities/EntityRef")
        ]
        triggering = condition.find("ByEntityCondition/TriggeringEntities")
        rule = "any" if triggering is None else triggering.get("triggeringEntitiesRule", "any")
        who = (" and " if rule == "all" else " or ").join(entities)
    if leaf is None:
        return _format_kind_and_name(condition)
    describe = _DESCRIPTIONS.get(str(leaf.tag))
    text = _format_kind_and_name(condition) if describe is None else describe(leaf, scope, who)
    delay = scope.read_number(condition, "delay", 0.0)
    edge = scope.read_text(condition, "conditionEdge", "none")
    text += " no longer holds" if edge == "falling" and describe is None else ""
    text = f"not any more: {text}" if edge == "falling" and describe is not None else text
    return f"{text}, {delay:g} s ago" if delay > 0.0 else text


def _format_kind_and_name(condition: etree._Element) -> str:
    leaf = condition.find(".//EntityCondition/*")
    leaf = condition.find("ByValueCondition/*") if leaf is None else leaf
    kind = "condition" if leaf is None else re.sub(r"(?<!^)(?=[A-Z])", " ", str(leaf.tag)).lower()
    return f"the {kind} “{condition.get('name', '')}”"


def _describe_rule(leaf: etree._Element, scope: Scope) -> str:
    return _RULES.get(scope.read_text(leaf, "rule", "greaterOrEqual"), "")


def _make_number_formatter(unit: str, digits: int) -> Callable[[float], str]:
    return lambda value: f"{value:.{digits}f} {unit}"


def _make_comparison_describer(what: str, form: Callable[[float], str]) -> _Describe:
    """Return a function that describes a comparison, such as "the headway of A to B is below 1.50 s"."""

    def describe(leaf: etree._Element, scope: Scope, who: str) -> str:
        other = quote_name(scope.read_text(leaf, "entityRef", ""))
        other = other if leaf.get("entityRef") else "its place"
        text = what.format(who=who, other=other)
        return f"{text} is {_describe_rule(leaf, scope)} {form(scope.read_number(leaf, 'value'))}"

    return describe


def _describe_time(leaf: etree._Element, scope: Scope, who: str) -> str:
    rule, value = scope.read_text(leaf, "rule", "greaterThan"), scope.read_number(leaf, "value")
    since = "since the start"
    return f"{value:.2f} s {since}" if rule.startswith("greater") else f"{_RULES.get(rule, '')} {value:.2f} s {since}"


def _describe_state(leaf: etree._Element, scope: Scope, who: str) -> str:
    name = scope.read_text(leaf, "storyboardElementRef")
    return f"“{name}” {_STATES.get(scope.read_text(leaf, 'state'), '')}"


def _describe_value(leaf: etree._Element, scope: Scope, who: str) -> str:
    name = leaf.get("parameterRef") or leaf.get("variableRef") or "value"
    return f"{name.lstrip('$')} is {_describe_rule(leaf, scope)} {scope.read_text(leaf, 'value')}"


def _describe_arrival(leaf: etree._Element, scope: Scope, who: str) -> str:
    position = leaf.find("Position/*")
    target = "its place" if position is None else describe_position(position, scope)
    return f"{who} is within {scope.read_number(leaf, 'tolerance'):g} m of {target}"


def describe_position(position: etree._Element, scope: Scope) -> str:
    """Describe an OpenSCENARIO position, such as ``"road 1, lane −1, s 20.0 m"``."""
    if position.tag == "LanePosition":
        road, lane = scope.read_text(position, "roadId"), scope.read_text(position, "laneId")
        return f"road {road}, lane {lane.replace('-', '−')}, s {scope.read_number(position, 's'):.1f} m"
    if position.tag == "RoadPosition":
        road, t = scope.read_text(position, "roadId"), scope.read_number(position, "t")
        return f"road {road}, s {scope.read_number(position, 's'):.1f} m, t {t:.1f} m"
    if position.tag == "WorldPosition":
        return f"x {scope.read_number(position, 'x'):.1f} m, y {scope.read_number(position, 'y'):.1f} m"
    if position.get("entityRef"):
        return f"a place relative to {quote_name(scope.read_text(position, 'entityRef'))}"
    if position.tag == "TrajectoryPosition":
        return f"its trajectory at {scope.read_number(position, 's'):.1f} m"
    return "its place"


_METRES: Final = _make_number_formatter("m", 1)
_SECONDS: Final = _make_number_formatter("s", 2)
_DESCRIPTIONS: Final[dict[str, _Describe]] = {
    "SimulationTimeCondition": _describe_time,
    "StoryboardElementStateCondition": _describe_state,
    "ParameterCondition": _describe_value,
    "VariableCondition": _describe_value,
    "ReachPositionCondition": _describe_arrival,
    "TraveledDistanceCondition": lambda leaf, scope, who: f"{who} has gone {scope.read_number(leaf, 'value'):.1f} m",
    "StandStillCondition": lambda leaf, scope, who: f"{who} has stood for {scope.read_number(leaf, 'duration'):g} s",
    "SpeedCondition": _make_comparison_describer("the speed of {who}", format_speed),
    "RelativeSpeedCondition": _make_comparison_describer("the speed of {who} less that of {other}", format_speed),
    "AccelerationCondition": _make_comparison_describer("the acceleration of {who}", _make_number_formatter("m/s²", 2)),
    "TimeHeadwayCondition": _make_comparison_describer("the headway of {who} to {other}", _SECONDS),
    "RelativeDistanceCondition": _make_comparison_describer("the distance of {who} to {other}", _METRES),
    "DistanceCondition": _make_comparison_describer("the distance of {who} to {other}", _METRES),
    "TimeToCollisionCondition": _make_comparison_describer("the time to collision of {who}", _SECONDS),
}
