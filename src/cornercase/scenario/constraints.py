"""Constraint groups: which values of a scenario's parameters belong together."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError, suggestion
from cornercase._common.typing import BoolArray

_RULES: Final[dict[str, Callable[[Any, Any], Any]]] = {
    "equalTo": np.equal,
    "notEqualTo": np.not_equal,
    "greaterThan": np.greater,
    "greaterOrEqual": np.greater_equal,
    "lessThan": np.less,
    "lessOrEqual": np.less_equal,
}

# Values are handed on with six decimals, so that a bound may be missed by the last of them.
_TOLERANCE: Final = 1e-6


def violations(
    root: etree._Element, source: str, scenarios: int, value_of: Callable[[str], Any], read: Callable[[str], Any]
) -> dict[str, BoolArray]:
    """Find concrete scenarios whose parameters break a constraint of their declarations.

    A parameter has to fulfil all constraints of at least one of its groups (OpenSCENARIO 1.3, ``ConstraintGroup``).

    Parameters
    ----------
    root : lxml element
        ``OpenSCENARIO``.
    source : str
        Name of the file, for messages.
    scenarios : int
        N.
    value_of : callable
        Name of a parameter to its value, one or (N,).
    read : callable
        Text of a constraint's value to that value, one or (N,).

    Returns
    -------
    dict of str to ndarray of bool, shape (N,)
        Where each parameter with constraints breaks them; without those that never do.

    Raises
    ------
    InputError
        A constraint has no rule that exists.
    """
    found = {}
    for declaration in root.iterfind("ParameterDeclarations/ParameterDeclaration"):
        groups = list(declaration.iterfind("ConstraintGroup"))
        if not groups:
            continue
        name = declaration.get("name", "")
        fulfilled = np.zeros(scenarios, dtype=np.bool_)
        for group in groups:
            holds = np.ones(scenarios, dtype=np.bool_)
            for constraint in group.iterfind("ValueConstraint"):
                rule = constraint.get("rule", "")
                if rule not in _RULES:
                    raise InputError(
                        f"{source}, line {constraint.sourceline}: the rule '{rule}' of a <ValueConstraint>:"
                        f" {suggestion(rule, _RULES)}"
                    )
                holds &= _compare(rule, value_of(name), read(constraint.get("value", "")))
            fulfilled |= holds
        if not fulfilled.all():
            found[name] = ~fulfilled
    return found


def _compare(rule: str, value: Any, bound: Any) -> Any:
    try:
        value, bound = np.asarray(value, dtype=np.float64), np.asarray(bound, dtype=np.float64)
    except ValueError:
        return _RULES[rule](np.asarray(value, dtype=str), np.asarray(bound, dtype=str))
    near = np.abs(value - bound) <= _TOLERANCE
    return near if rule == "equalTo" else _RULES[rule](value, bound) & ~near | (near & (rule.endswith("OrEqual")))
