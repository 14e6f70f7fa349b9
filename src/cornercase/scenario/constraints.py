"""Declarations of a scenario's parameters, and the constraints on their values."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Final

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError, suggestion
from cornercase._common.recorded_xml import adapt, made_once
from cornercase._common.typing import BoolArray
from cornercase.scenario.declared_types import NUMERIC, typed_value

_RULES: Final[dict[str, Callable[[Any, Any], Any]]] = {
    "equalTo": np.equal,
    "notEqualTo": np.not_equal,
    "greaterThan": np.greater,
    "greaterOrEqual": np.greater_equal,
    "lessThan": np.less,
    "lessOrEqual": np.less_equal,
}

# Rules for types without an order.
_OF_TEXTS: Final = {"equalTo", "notEqualTo"}

_SIGNS: Final = {
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
    """

    rule: str
    value: str


@dataclass(frozen=True)
class Declaration:
    """A parameter that a scenario file declares (OpenSCENARIO 1.3, ``ParameterDeclaration``).

    Attributes
    ----------
    name : str
        Name of the parameter.
    kind : str
        Type of its values, such as ``"double"`` or ``"string"``.
    value : str
        Default value; may be an expression of the parameters declared before it.
    groups : tuple of tuple of Constraint
        The value has to fulfil all constraints of at least one group. Without groups any value is allowed.
    sourceline : int or None
        Line in the file.
    """

    tag: ClassVar[str] = "ParameterDeclaration"

    name: str
    kind: str
    value: str
    groups: tuple[tuple[Constraint, ...], ...] = ()
    sourceline: int | None = field(default=None, repr=False, compare=False)

    @classmethod
    def read(cls, element: etree._Element, source: str) -> Declaration:
        """Read a declaration from a file.

        Parameters
        ----------
        element : lxml element
            ``ParameterDeclaration``.
        source : str
            Name of the file, for messages.

        Returns
        -------
        Declaration

        Raises
        ------
        InputError
            A constraint has an unknown rule.
        """
        for constraint in element.iterfind("ConstraintGroup/ValueConstraint"):
            rule = constraint.get("rule", "")
            if rule not in _RULES:
                raise InputError(
                    f"{source}, line {constraint.sourceline}: the rule '{rule}' of a <ValueConstraint>:"
                    f" {suggestion(rule, _RULES)}"
                )
        groups = tuple(
            tuple(
                Constraint(condition.get("rule", ""), condition.get("value", ""))
                for condition in group.iterfind("ValueConstraint")
            )
            for group in element.iterfind("ConstraintGroup")
        )
        kind = element.get("parameterType", "string")
        ordered = {condition.rule for group in groups for condition in group} - _OF_TEXTS
        if kind == "string" and ordered:
            adapt(
                element,
                f"<ValueConstraint> of {element.get('name', '')}",
                "texts that are numbers are compared as numbers",
                "the rule for texts is equalTo or notEqualTo",
            )
        line: Any = element.sourceline
        return cls(element.get("name", ""), kind, element.get("value", ""), groups, line)


def read_declarations(root: etree._Element, source: str) -> tuple[Declaration, ...]:
    """Read the parameters that an element declares, in order; `file_name` is for messages."""
    return made_once(root, "declarations", lambda: _read(root, source))


def _read(root: etree._Element, source: str) -> tuple[Declaration, ...]:
    declarations: dict[str, Declaration] = {}
    for element in root.iterfind("ParameterDeclarations/ParameterDeclaration"):
        declaration = Declaration.read(element, source)
        # Keep the later position: its value may refer to parameters declared in between.
        earlier = declarations.pop(declaration.name, None)
        if earlier is not None:
            name, line = declaration.name, earlier.sourceline
            reason = f"'{name}' is declared in line {line}, too; the later one counts, as in esmini"
            adapt(element, "repeated <ParameterDeclaration>", reason, "a parameter is declared once")
        declarations[declaration.name] = declaration
    return tuple(declarations.values())


def violations(
    declarations: Sequence[Declaration], scenarios: int, value_of: Callable[[str], Any], bound: Callable[[str], Any]
) -> dict[str, BoolArray]:
    """Return masks of shape (N,) of the scenarios that violate constraints, by parameter; only if there are any.

    `get_value` maps a parameter to its value, `evaluate_bound` the text of a constraint; both scalars or shape (N,).
    """
    masks = {}
    for declaration in declarations:
        if not declaration.groups:
            continue
        fulfilled = np.zeros(scenarios, dtype=np.bool_)
        for group in declaration.groups:
            holds = np.ones(scenarios, dtype=np.bool_)
            for constraint in group:
                value, reference = value_of(declaration.name), bound(constraint.value)
                try:
                    holds &= _compare(constraint.rule, value, reference, declaration.kind)
                except ValueError:
                    raise InputError(
                        f"The constraint {in_words([constraint])} of the parameter {declaration.name} has no value of"
                        f" the type {declaration.kind}."
                    ) from None
            fulfilled |= holds
        if not fulfilled.all():
            masks[declaration.name] = ~fulfilled
    return masks


def in_words(group: Sequence[Constraint]) -> str:
    """Format a group of constraints, as ``"> 18 and <= 20"``."""
    return " and ".join(f"{_SIGNS[constraint.rule]} {constraint.value}" for constraint in group)


def to_json(declarations: Sequence[Declaration]) -> list[dict[str, Any]]:
    """Return JSON values, the inverse of `declarations_from_json`."""
    return [
        {
            "name": declaration.name,
            "type": declaration.kind,
            "value": declaration.value,
            "groups": [
                [{"rule": constraint.rule, "value": constraint.value} for constraint in group]
                for group in declaration.groups
            ],
        }
        for declaration in declarations
    ]


def from_json(plain: Sequence[Mapping[str, Any]]) -> tuple[Declaration, ...]:
    """Restore declarations from `declarations_to_json`."""
    return tuple(
        Declaration(
            declaration["name"],
            declaration["type"],
            declaration["value"],
            tuple(
                tuple(Constraint(_known(constraint["rule"]), constraint["value"]) for constraint in group)
                for group in declaration["groups"]
            ),
        )
        for declaration in plain
    )


def _known(rule: str) -> str:
    if rule not in _RULES:
        raise InputError(f"The rule '{rule}' of a constraint: {suggestion(rule, _RULES)}")
    return rule


def _compare(rule: str, value: Any, bound: Any, kind: str) -> Any:
    """Compare values as their declared type; raises `ValueError` if one does not have that type."""
    if kind not in NUMERIC and not (kind == "string" and rule not in _OF_TEXTS and _are_numbers(value, bound)):
        of_kind = np.vectorize(lambda item: str(typed_value(_plain(item), kind)), otypes=[str])
        return _RULES[rule](of_kind(value), of_kind(bound))
    value, bound = np.asarray(value, dtype=np.float64), np.asarray(bound, dtype=np.float64)
    close = np.abs(value - bound) <= _TOLERANCE
    return close if rule == "equalTo" else _RULES[rule](value, bound) & ~close | (close & (rule.endswith("OrEqual")))


def _are_numbers(*values: Any) -> bool:
    try:
        return all(np.isfinite(np.asarray(value, dtype=np.float64)).all() for value in values)
    except ValueError:
        return False


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value
