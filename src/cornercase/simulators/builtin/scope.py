"""The parameters of a batch: each attribute of the file is one value for every concrete scenario."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from lxml import etree

from cornercase.errors import InputError, suggestion
from cornercase.scenario.expressions import evaluate, names_in
from cornercase.scenario.space import Value
from cornercase.typing import FloatArray

_NUMERIC = {"double", "integer", "int", "unsignedInt", "unsignedShort"}


class VariesError(Exception):
    """An attribute that shapes the storyboard differs between the scenarios of a batch.

    Attributes
    ----------
    names : set of str
        The varied parameters it depends on; the batch has to be split by their values.
    """

    def __init__(self, names: set[str]) -> None:
        super().__init__(f"varies with {', '.join(sorted(names))}")
        self.names = names


class Scope:
    """Values of parameters for N concrete scenarios.

    Parameters
    ----------
    source : str
        Name of the file, for messages.
    scenarios : int
        N.
    values : mapping of str to float, bool, str or ndarray of shape (N,)
    origins : mapping of str to set of str
        For each parameter, the parameters of the logical scenario that its value depends on.
    """

    def __init__(self, source: str, scenarios: int, values: Mapping[str, Any], origins: Mapping[str, set[str]]) -> None:
        self.source = source
        self.scenarios = scenarios
        self.values = dict(values)
        self._origins = dict(origins)

    @classmethod
    def of_file(cls, source: str, root: etree._Element, concretes: Sequence[Mapping[str, Value]]) -> Scope:
        """Scope of a scenario file's parameter declarations, for the given concrete scenarios."""
        scope = cls(source, len(concretes), {}, {})
        names = {name for values in concretes for name in values}
        for declaration in root.iterfind("ParameterDeclarations/ParameterDeclaration"):
            name = declaration.get("name", "")
            kind = declaration.get("parameterType", "string")
            if name not in names:
                scope._declare(declaration)
                continue
            default = declaration.get("value", "")
            texts = [values.get(name, default) for values in concretes]
            if kind in _NUMERIC:
                scope.values[name] = np.array([scope._float(text, declaration) for text in texts])
            else:
                different = {str(text) for text in texts}
                if len(different) > 1:
                    raise VariesError({name})
                scope.values[name] = _typed(different.pop(), kind)
            scope._origins[name] = {name}
            names.discard(name)
        if names:
            name = min(names)
            raise InputError(f"{source}: declares no parameter '{name}'; {suggestion(name, scope.values)}")
        return scope

    def within(self, element: etree._Element, assignments: etree._Element | None = None) -> Scope:
        """Scope of a catalog entry or maneuver: its own declarations, overwritten by assignments from here."""
        inner = Scope(self.source, self.scenarios, self.values, self._origins)
        for declaration in element.iterfind("ParameterDeclarations/ParameterDeclaration"):
            inner._declare(declaration)
        if assignments is not None:
            for assignment in assignments.iterfind("ParameterAssignment"):
                name = assignment.get("parameterRef", "").lstrip("$")
                text = assignment.get("value", "")
                inner.values[name] = self._value(text, assignment)
                inner._origins[name] = self.origins(text)
        return inner

    def origins(self, text: str) -> set[str]:
        """Parameters of the logical scenario that an attribute's text depends on."""
        return {origin for name in names_in(text) for origin in self._origins.get(name, set())}

    def number(self, element: etree._Element, attribute: str, default: float | None = None) -> FloatArray:
        """Attribute as a number for each scenario, shape (N,)."""
        text = element.get(attribute)
        if text is None:
            if default is None:
                raise self._error(element, attribute, "is missing")
            return np.full(self.scenarios, float(default))
        value = self._value(text, element, attribute)
        if isinstance(value, str):
            value = self._float(value, element, attribute)
        return np.broadcast_to(np.asarray(value, dtype=np.float64), (self.scenarios,)).copy()

    def one_number(self, element: etree._Element, attribute: str, default: float | None = None) -> float:
        """Attribute as one number; raises `VariesError` where it is not the same for all scenarios."""
        values = self.number(element, attribute, default)
        if (values != values[0]).any():
            raise VariesError(self.origins(element.get(attribute, "")))
        return float(values[0])

    def text(self, element: etree._Element, attribute: str, default: str | None = None) -> str:
        """Attribute as one text; raises `VariesError` where it is not the same for all scenarios."""
        text = element.get(attribute)
        if text is None:
            if default is None:
                raise self._error(element, attribute, "is missing")
            return default
        value = self._value(text, element, attribute)
        if isinstance(value, np.ndarray):
            if (value != value.flat[0]).any():
                raise VariesError(self.origins(text))
            value = value.flat[0].item()
        if isinstance(value, bool | np.bool_):
            return "true" if value else "false"
        if isinstance(value, float):
            return str(int(value)) if value.is_integer() else repr(value)
        return str(value)

    def flag(self, element: etree._Element, attribute: str, default: bool) -> bool:
        """Attribute as a boolean, the same for all scenarios."""
        text = self.text(element, attribute, "true" if default else "false")
        if text not in ("true", "false", "1", "0"):
            raise self._error(element, attribute, f"is '{text}', not true or false")
        return text in ("true", "1")

    def _declare(self, declaration: etree._Element) -> None:
        name, text = declaration.get("name", ""), declaration.get("value", "")
        value = self._value(text, declaration)
        self.values[name] = (
            _typed(value, declaration.get("parameterType", "string")) if isinstance(value, str) else value
        )
        self._origins[name] = self.origins(text)

    def _value(self, text: str, element: etree._Element, attribute: str = "value") -> Any:
        text = text.strip()
        try:
            if text.startswith("${") and text.endswith("}"):
                return evaluate(text[2:-1], self.values)
            if text.startswith("$"):
                return evaluate(text, self.values)
        except InputError as error:
            raise self._error(element, attribute, f"cannot be evaluated. {error}") from None
        return text

    def _float(self, text: Value, element: etree._Element, attribute: str = "value") -> float:
        try:
            return float(text)
        except ValueError:
            raise self._error(element, attribute, f"is '{text}', which is not a number") from None

    def _error(self, element: etree._Element, attribute: str, why: str) -> InputError:
        line = f", line {element.sourceline}" if element.sourceline else ""
        return InputError(f"{self.source}{line}: {attribute} of <{element.tag}> {why}.")


def _typed(text: str, kind: str) -> Any:
    if kind in _NUMERIC:
        try:
            return float(text)
        except ValueError:
            return text
    if kind == "boolean":
        return text in ("true", "1")
    return text
