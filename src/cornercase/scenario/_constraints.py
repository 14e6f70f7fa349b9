"""Declarations of a scenario's parameters, and the constraints on their values."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Final

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError, suggest_name
from cornercase._common.io.tracked_xml import cached_on_element, note_adaptation
from cornercase._common.typing import BoolArray
from cornercase.scenario._types import NUMERIC_TYPES, convert_to_type

_COMPARISONS: Final[dict[str, Callable[[Any, Any], Any]]] = {
    "equalTo": np.equal,
    "notEqualTo": np.not_equal,
    "greaterThan": np.greater,
    "greaterOrEqual": np.greater_equal,
    "lessThan": np.less,
    "lessOrEqual": np.less_equal,
}

# Rules for types without an order.
_TEXT_RULES: Final = {"equalTo", "notEqualTo"}

_RULE_SYMBOLS: Final = {
    "equalTo": "=",
    "notEqualTo": "≠",
    "greaterThan": ">",
    "greaterOrEqual": ">=",
    "lessThan": "<",
    "lessOrEqual": "<=",
}

# Values are passed on with six decimals.
_TOLERANCE: Final = 1e-6


@dataclass(frozen=True)
class Constraint:
    """A condition on the value of a parameter (OpenSCENARIO 1.3, ``ValueConstraint``).

    Attributes
    ----------
    rule : str
        ``"equalTo"``, ``"notEqualTo"``, ``"greaterThan"``, ``"greaterOrEqual"``, ``"lessThan"`` or ``"lessOrEqual"``.
    value : str
        Right-hand side; may be an expression of other parameters.

    Examples
    --------
    >>> from cornercase.scenario import Constraint
    >>> longest = Constraint("lessOrEqual", "${2 * $ego_length}")
    >>> longest.rule, longest.value
    ('lessOrEqual', '${2 * $ego_length}')
    """

    rule: str
    value: str


@dataclass(frozen=True)
class ParameterDeclaration:
    """A parameter that a scenario file declares (OpenSCENARIO 1.3, ``ParameterDeclaration``).

    Attributes
    ----------
    name : str
        Name of the parameter.
    type_name : str
        Type of the values, such as ``"double"`` or ``"string"``.
    value : str
        Default value; may be an expression of the parameters declared before it.
    constraint_groups : tuple of tuple of Constraint
        A value must fulfil all constraints of at least one group. Without groups, any value is allowed.
    sourceline : int or None
        Line in the file.

    Examples
    --------
    A declaration limits the space to the values that its constraints allow:

    >>> import numpy as np
    >>> import cornercase as cc
    >>> from cornercase.scenario import Constraint, ParameterDeclaration
    >>> above_10_m = ParameterDeclaration("gap", "double", "30", ((Constraint("greaterThan", "10"),),))
    >>> space = cc.ParameterSpace(cc.ParameterSpace.from_ranges(["gap=0:40"]).parameters, [above_10_m])
    >>> space.is_admissible(np.array([[0.1], [0.5]]))
    array([False,  True])
    """

    tag: ClassVar[str] = "ParameterDeclaration"

    name: str
    type_name: str
    value: str
    constraint_groups: tuple[tuple[Constraint, ...], ...] = ()
    sourceline: int | None = field(default=None, repr=False, compare=False)

    @classmethod
    def from_xml(cls, element: etree._Element, file_name: str) -> ParameterDeclaration:
        """Read a declaration from a file.

        Parameters
        ----------
        element : lxml element
            ``ParameterDeclaration``.
        file_name : str
            Name of the file, for messages.

        Returns
        -------
        ParameterDeclaration

        Raises
        ------
        InputError
            A constraint has an unknown rule.
        """
        for constraint in element.iterfind("ConstraintGroup/ValueConstraint"):
            rule = constraint.get("rule", "")
            if rule not in _COMPARISONS:
                raise InputError(
                    f"{file_name}, line {constraint.sourceline}: <ValueConstraint> has the unknown rule '{rule}';"
                    f" {suggest_name(rule, _COMPARISONS)}"
                )
        groups = tuple(
            tuple(
                Constraint(condition.get("rule", ""), condition.get("value", ""))
                for condition in group.iterfind("ValueConstraint")
            )
            for group in element.iterfind("ConstraintGroup")
        )
        kind = element.get("parameterType", "string")
        ordered = {condition.rule for group in groups for condition in group} - _TEXT_RULES
        if kind == "string" and ordered:
            note_adaptation(
                element,
                f"<ValueConstraint> of {element.get('name', '')}",
                "texts that are numbers are compared as numbers",
                "the rule for texts is equalTo or notEqualTo",
            )
        line: Any = element.sourceline
        return cls(element.get("name", ""), kind, element.get("value", ""), groups, line)


def read_declarations(root: etree._Element, file_name: str) -> tuple[ParameterDeclaration, ...]:
    """Read the parameters that an element declares, in order; `file_name` is for messages."""
    return cached_on_element(root, "declarations", lambda: _parse_declarations(root, file_name))


def _parse_declarations(root: etree._Element, file_name: str) -> tuple[ParameterDeclaration, ...]:
    declarations: dict[str, ParameterDeclaration] = {}
    for element in root.iterfind("ParameterDeclarations/ParameterDeclaration"):
        declaration = ParameterDeclaration.from_xml(element, file_name)
        # Keep the later position: its value may refer to parameters declared in between.
        earlier = declarations.pop(declaration.name, None)
        if earlier is not None:
            name, line = declaration.name, earlier.sourceline
            reason = f"'{name}' is declared in line {line}, too; the later one counts, as in esmini"
            note_adaptation(element, "repeated <ParameterDeclaration>", reason, "a parameter is declared once")
        declarations[declaration.name] = declaration
    return tuple(declarations.values())


def find_constraint_violations(
    declarations: Sequence[ParameterDeclaration],
    n_scenarios: int,
    get_value: Callable[[str], Any],
    evaluate_bound: Callable[[str], Any],
) -> dict[str, BoolArray]:
    """Find the scenarios that violate constraints.

    Return a mask of these scenarios, shape (n_scenarios,), for each parameter whose constraints are violated.
    `get_value` takes the name of a parameter and returns its value. `evaluate_bound` takes the text on the right-hand
    side of a constraint and returns its value. Values are scalars, or arrays of shape (n_scenarios,).
    """
    masks = {}
    for declaration in declarations:
        if not declaration.constraint_groups:
            continue
        fulfilled = np.zeros(n_scenarios, dtype=np.bool_)
        for group in declaration.constraint_groups:
            holds = np.ones(n_scenarios, dtype=np.bool_)
            for constraint in group:
                value, reference = get_value(declaration.name), evaluate_bound(constraint.value)
                try:
                    holds &= _apply_rule(constraint.rule, value, reference, declaration.type_name)
                except ValueError:
                    raise InputError(
                        f"The constraint {format_constraints([constraint])} of the parameter {declaration.name} cannot"
                        f" be checked, since the value or its bound is not of the type {declaration.type_name}."
                    ) from None
            fulfilled |= holds
        if not fulfilled.all():
            masks[declaration.name] = ~fulfilled
    return masks


def format_constraints(group: Sequence[Constraint]) -> str:
    """Format a group of constraints, as ``"> 18 and <= 20"``."""
    return " and ".join(f"{_RULE_SYMBOLS[constraint.rule]} {constraint.value}" for constraint in group)


def declarations_to_json(declarations: Sequence[ParameterDeclaration]) -> list[dict[str, Any]]:
    """Return declarations of parameters as JSON values, the inverse of `declarations_from_json`."""
    return [
        {
            "name": declaration.name,
            "type": declaration.type_name,
            "value": declaration.value,
            "groups": [
                [{"rule": constraint.rule, "value": constraint.value} for constraint in group]
                for group in declaration.constraint_groups
            ],
        }
        for declaration in declarations
    ]


def declarations_from_json(data: Sequence[Mapping[str, Any]]) -> tuple[ParameterDeclaration, ...]:
    """Restore declarations from `declarations_to_json`."""
    return tuple(
        ParameterDeclaration(
            declaration["name"],
            declaration["type"],
            declaration["value"],
            tuple(
                tuple(Constraint(_require_known_rule(constraint["rule"]), constraint["value"]) for constraint in group)
                for group in declaration["groups"]
            ),
        )
        for declaration in data
    )


def _require_known_rule(rule: str) -> str:
    if rule not in _COMPARISONS:
        raise InputError(f"A constraint has the unknown rule '{rule}'; {suggest_name(rule, _COMPARISONS)}")
    return rule


def _apply_rule(rule: str, value: Any, bound: Any, type_name: str) -> Any:
    """Compare a value with a bound; raises `ValueError` if one of them cannot be converted to the declared type."""
    if type_name not in NUMERIC_TYPES and not (
        type_name == "string" and rule not in _TEXT_RULES and _are_numbers(value, bound)
    ):
        of_kind = np.vectorize(lambda item: str(convert_to_type(_to_python_scalar(item), type_name)), otypes=[str])
        return _COMPARISONS[rule](of_kind(value), of_kind(bound))
    value, bound = np.asarray(value, dtype=np.float64), np.asarray(bound, dtype=np.float64)
    close = np.abs(value - bound) <= _TOLERANCE
    return (
        close if rule == "equalTo" else _COMPARISONS[rule](value, bound) & ~close | (close & (rule.endswith("OrEqual")))
    )


def _are_numbers(*values: Any) -> bool:
    try:
        return all(np.isfinite(np.asarray(value, dtype=np.float64)).all() for value in values)
    except ValueError:
        return False


def _to_python_scalar(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value
