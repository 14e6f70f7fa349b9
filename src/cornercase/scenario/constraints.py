"""Declarations of a scenario's parameters, and which of their values belong together."""

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

# Rules for what has no order.
_OF_TEXTS: Final = {"equalTo", "notEqualTo"}

_SIGNS: Final = {
    "equalTo": "=",
    "notEqualTo": "≠",
    "greaterThan": ">",
    "greaterOrEqual": ">=",
    "lessThan": "<",
    "lessOrEqual": "<=",
}

# Values are handed on with six decimals, so that a bound may be missed by the last of them.
_TOLERANCE: Final = 1e-6


@dataclass(frozen=True)
class Constraint:
    """What the value of a parameter has to fulfil (OpenSCENARIO 1.3, ``ValueConstraint``).

    Attributes
    ----------
    rule : str
        ``"equalTo"``, ``"notEqualTo"``, ``"greaterThan"``, ``"greaterOrEqual"``, ``"lessThan"`` or ``"lessOrEqual"``.
    value : str
        What the parameter is compared with; it may be an expression of other parameters.
    """

    rule: str
    value: str


@dataclass(frozen=True)
class Declaration:
    """A parameter of a scenario, as its file declares it (OpenSCENARIO 1.3, ``ParameterDeclaration``).

    Attributes
    ----------
    name : str
        Its name.
    kind : str
        Type of its values, ``"double"`` or ``"string"`` for instance.
    value : str
        What it is where nothing else is said; it may be an expression of the parameters before it.
    groups : tuple of tuple of Constraint
        The value has to fulfil all constraints of at least one group; without groups it may be any.
    sourceline : int or None
        Where it stands in the file.
    """

    tag: ClassVar[str] = "ParameterDeclaration"

    name: str
    kind: str
    value: str
    groups: tuple[tuple[Constraint, ...], ...] = ()
    sourceline: int | None = field(default=None, repr=False, compare=False)

    @classmethod
    def read(cls, element: etree._Element, source: str) -> Declaration:
        """Read an element of a file.

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
            A constraint has no rule that exists.
        """
        for constraint in element.iterfind("ConstraintGroup/ValueConstraint"):
            rule = constraint.get("rule", "")
            if rule not in _RULES:
                raise InputError(
                    f"{source}, line {constraint.sourceline}: the rule '{rule}' of a <ValueConstraint>:"
                    f" {suggestion(rule, _RULES)}"
                )
        groups = tuple(
            tuple(Constraint(one.get("rule", ""), one.get("value", "")) for one in group.iterfind("ValueConstraint"))
            for group in element.iterfind("ConstraintGroup")
        )
        kind = element.get("parameterType", "string")
        ordered = {one.rule for group in groups for one in group} - _OF_TEXTS
        if kind == "string" and ordered:
            adapt(
                element,
                f"<ValueConstraint> of {element.get('name', '')}",
                "its texts are compared as numbers where they are numbers",
                "texts are only equalTo and notEqualTo each other",
            )
        line: Any = element.sourceline
        return cls(element.get("name", ""), kind, element.get("value", ""), groups, line)


def read_declarations(root: etree._Element, source: str) -> tuple[Declaration, ...]:
    """Read the parameters that an element of a file declares.

    Parameters
    ----------
    root : lxml element
        ``OpenSCENARIO``, an entry of a catalog, or another one with ``ParameterDeclarations``.
    source : str
        Name of the file, for messages.

    Returns
    -------
    tuple of Declaration
        In the order of the file.

    Raises
    ------
    InputError
        A constraint has no rule that exists.
    """
    return made_once(root, "declarations", lambda: _read(root, source))


def _read(root: etree._Element, source: str) -> tuple[Declaration, ...]:
    found: dict[str, Declaration] = {}
    for element in root.iterfind("ParameterDeclarations/ParameterDeclaration"):
        read = Declaration.read(element, source)
        # Its value may refer to parameters that are declared between the two.
        before = found.pop(read.name, None)
        if before is not None:
            why = f"'{read.name}' is declared in line {before.sourceline}, too; the later one counts, as in esmini"
            adapt(element, "repeated <ParameterDeclaration>", why, "a parameter is declared once")
        found[read.name] = read
    return tuple(found.values())


def violations(
    declarations: Sequence[Declaration], scenarios: int, value_of: Callable[[str], Any], bound: Callable[[str], Any]
) -> dict[str, BoolArray]:
    """Find concrete scenarios whose parameters break the constraints of their declarations.

    Parameters
    ----------
    declarations : sequence of Declaration
    scenarios : int
        N.
    value_of : callable
        Name of a parameter to its value, one or (N,).
    bound : callable
        Text of a constraint's value to that value, one or (N,).

    Returns
    -------
    dict of str to ndarray of bool, shape (N,)
        Where each parameter with constraints breaks them; without those that never do.

    Raises
    ------
    InputError
        A constraint compares a parameter with what is no value of its type.
    """
    found = {}
    for declaration in declarations:
        if not declaration.groups:
            continue
        fulfilled = np.zeros(scenarios, dtype=np.bool_)
        for group in declaration.groups:
            holds = np.ones(scenarios, dtype=np.bool_)
            for constraint in group:
                value, other = value_of(declaration.name), bound(constraint.value)
                try:
                    holds &= _compare(constraint.rule, value, other, declaration.kind)
                except ValueError:
                    raise InputError(
                        f"The constraint {in_words([constraint])} of the parameter {declaration.name} has no value of"
                        f" the type {declaration.kind}."
                    ) from None
            fulfilled |= holds
        if not fulfilled.all():
            found[declaration.name] = ~fulfilled
    return found


def in_words(group: Sequence[Constraint]) -> str:
    """Say what a group of constraints asks for, as ``"> 18 and <= 20"``."""
    return " and ".join(f"{_SIGNS[one.rule]} {one.value}" for one in group)


def to_json(declarations: Sequence[Declaration]) -> list[dict[str, Any]]:
    """Plain values from which `from_json` makes the same declarations."""
    return [
        {
            "name": one.name,
            "type": one.kind,
            "value": one.value,
            "groups": [[{"rule": each.rule, "value": each.value} for each in group] for group in one.groups],
        }
        for one in declarations
    ]


def from_json(plain: Sequence[Mapping[str, Any]]) -> tuple[Declaration, ...]:
    """Declarations from `to_json`."""
    return tuple(
        Declaration(
            one["name"],
            one["type"],
            one["value"],
            tuple(tuple(Constraint(_known(each["rule"]), each["value"]) for each in group) for group in one["groups"]),
        )
        for one in plain
    )


def _known(rule: str) -> str:
    if rule not in _RULES:
        raise InputError(f"The rule '{rule}' of a constraint: {suggestion(rule, _RULES)}")
    return rule


def _compare(rule: str, value: Any, bound: Any, kind: str) -> Any:
    """Compare values as those of a type; raises a `ValueError` for what is none of it."""
    if kind not in NUMERIC and not (kind == "string" and rule not in _OF_TEXTS and _are_numbers(value, bound)):
        of_kind = np.vectorize(lambda one: str(typed_value(_plain(one), kind)), otypes=[str])
        return _RULES[rule](of_kind(value), of_kind(bound))
    value, bound = np.asarray(value, dtype=np.float64), np.asarray(bound, dtype=np.float64)
    near = np.abs(value - bound) <= _TOLERANCE
    return near if rule == "equalTo" else _RULES[rule](value, bound) & ~near | (near & (rule.endswith("OrEqual")))


def _are_numbers(*values: Any) -> bool:
    try:
        return all(np.isfinite(np.asarray(value, dtype=np.float64)).all() for value in values)
    except ValueError:
        return False


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value
