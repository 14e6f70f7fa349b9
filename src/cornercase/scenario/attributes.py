"""Read attributes of a file for a batch of concrete scenarios at once."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any, Final

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.numbers import finite_number, number_of
from cornercase._common.recorded_xml import adapt
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.scenario.constraints import Declaration
from cornercase.scenario.declared_types import value_text
from cornercase.scenario.expressions import evaluate, names_in, rounded
from cornercase.scenario.parameter import Value
from cornercase.scenario.varies import VariesError

_Placed = etree._Element | Declaration
"""Something with a line number in the file."""

# Integers are lane numbers and repetitions.
_MOST: Final = 1e9


# Cached, since files repeat the same few numbers.
_literal = lru_cache(4096)(finite_number)


class Attributes:
    """Reads attributes, given the parameter values of N concrete scenarios.

    `parameter_values` maps a parameter to a scalar or an array of shape (N,), `origin_parameters` to the parameters
    of the logical scenario that its value depends on. `split_parameters` collects those on which an attribute
    depended that was read as one value for all N.
    """

    def __init__(self, source: str, scenarios: int, values: Mapping[str, Any], origins: Mapping[str, set[str]]) -> None:
        self.source = source
        self.scenarios = scenarios
        self.values = dict(values)
        self._origins = dict(origins)
        self.used: set[str] = set()
        self._refused: list[tuple[str, BoolArray]] = []

    def origins(self, text: str) -> set[str]:
        """Return the parameters of the logical scenario that an attribute's text depends on."""
        return {origin for name in names_in(text) for origin in self._origins.get(name, set())}

    def number(self, element: etree._Element, attribute: str, default: float | None = None) -> FloatArray:
        """Read an attribute as a number for each scenario, shape (N,).

        Values are not finite where an expression has no value; `invalid_values` then lists them. Without a default the
        attribute is mandatory.
        """
        text = element.get(attribute)
        if text is None:
            if default is None:
                raise self._error(element, attribute, "is missing")
            return self._same(float(default))
        literal = _literal(text)
        if literal is not None:
            return self._same(literal)
        value = self._value(text, element, attribute)
        if isinstance(value, str):
            value = self._float(value, element, attribute, endless=default is not None and np.isinf(default))
        elif isinstance(value, np.ndarray | np.floating | float):
            broken = ~np.isfinite(value)
            if np.all(broken) and not self.origins(text):
                raise self._error(element, attribute, f"is '{text[:60]}', which has no finite value")
            if np.any(broken):
                everywhere = np.broadcast_to(broken, (self.scenarios,))
                self.refuse(element, attribute, f"is '{text[:60]}', which has no finite value", everywhere)
        numbers = np.asarray(value, dtype=np.float64)
        if numbers.shape == (self.scenarios,):
            return numbers.copy()
        return np.full(self.scenarios, numbers)

    def _same(self, number: float) -> FloatArray:
        # Twice as fast as `np.full`; a file has hundreds of numbers.
        result = np.empty(self.scenarios)
        result.fill(number)
        return result

    def refuse(self, element: _Placed, attribute: str, why: str, where: BoolArray) -> None:
        """Record that an attribute is invalid in some scenarios; `reason` is as in "is not above 0"."""
        if where.any():
            self._refused.append((f"line {element.sourceline}: {attribute} of <{element.tag}> {why}", where.copy()))

    def refused(self) -> list[tuple[str, BoolArray]]:
        """Return invalid attributes in the order read: a sentence without full stop, and a mask of shape (N,)."""
        return list(self._refused)

    def one_number(self, element: etree._Element, attribute: str, default: float | None = None) -> float:
        """Read an attribute as one number; raises `BatchSplitError` if the scenarios differ."""
        text = element.get(attribute, "")
        literal = _literal(text)
        if literal is not None:
            return literal
        values = self.number(element, attribute, default)
        origins = self.origins(text)
        if (values != values[0]).any() and not np.isnan(values).all():
            raise VariesError(origins)
        self.used |= origins
        if np.isnan(values[0]):
            raise self._error(element, attribute, f"is '{text[:60]}', which has no finite value")
        return float(values[0])

    def whole_number(
        self, element: etree._Element, attribute: str, default: int | None = None, least: int | None = None
    ) -> int:
        """Read an attribute as one integer; raises `BatchSplitError` if the scenarios differ."""
        value = self.one_number(element, attribute, default)
        if not abs(value) < _MOST or value != round(value):
            raise self._error(element, attribute, f"is {value:g}, which is not a whole number that can be used")
        if least is not None and value < least:
            raise self._error(element, attribute, f"is {value:g}; it has to be at least {least}")
        return round(value)

    def text(self, element: etree._Element, attribute: str, default: str | None = None) -> str:
        """Read an attribute as one text; raises `BatchSplitError` if the scenarios differ."""
        text = element.get(attribute)
        if text is None:
            if default is None:
                raise self._error(element, attribute, "is missing")
            return default
        if "$" not in text:
            return text.strip()
        value, origins = self._value(text, element, attribute), self.origins(text)
        if isinstance(value, np.ndarray):
            if len(np.unique(value)) > 1:
                raise VariesError(origins)
            value = value.flat[0].item()
        self.used |= origins
        return value_text(value)

    def flag(self, element: etree._Element, attribute: str, default: bool) -> bool:
        """Read an attribute as one boolean; raises `BatchSplitError` if the scenarios differ."""
        text = self.text(element, attribute, "true" if default else "false")
        if text.lower() not in ("true", "false", "1", "0"):
            raise self._error(element, attribute, f"is '{text}', not true or false")
        if text != text.lower() and isinstance(element, etree._Element):
            reason = f"'{text}' is read as {text.lower()}"
            adapt(element, f"{attribute} of <{element.tag}>", reason, "a boolean is true, false, 1 or 0")
            text = text.lower()
        return text in ("true", "1")

    def _value(self, text: str, element: _Placed, attribute: str = "value") -> Any:
        text = text.strip()
        try:
            if text.startswith("${") and text.endswith("}"):
                result = rounded(evaluate(text[2:-1], self.values))
                self._note_texts(text, result, element, attribute)
                return result
            if text[:1] == "$" and text[1:] in self.values:
                return self.values[text[1:]]
            if text.startswith("$"):
                return evaluate(text, self.values)
        except InputError as error:
            raise self._error(element, attribute, f"cannot be evaluated. {str(error).removesuffix('.')}") from None
        return text

    def _note_texts(self, text: str, result: Any, element: _Placed, attribute: str) -> None:
        """Record that an expression uses texts as numbers."""
        texts = [name for name in sorted(names_in(text)) if isinstance(self.values.get(name), str)]
        if texts and isinstance(element, etree._Element) and isinstance(result, float | np.floating | np.ndarray):
            adapt(
                element,
                f"{attribute} of <{element.tag}>",
                f"the text of the parameter {', '.join(texts)} is taken as a number",
                "an expression calculates with numbers, not with texts",
            )

    def _float(self, text: Value, element: _Placed, attribute: str = "value", endless: bool = False) -> float:
        try:
            number = number_of(text)
        except ValueError:
            comma = isinstance(text, str) and _literal(text.replace(",", ".", 1)) is not None
            hint = f"; write it with a point, as {text.replace(',', '.', 1)}" if comma and isinstance(text, str) else ""
            raise self._error(element, attribute, f"is '{text}', which is not a number{hint}") from None
        if not np.isfinite(number) and not (endless and number == np.inf):
            raise self._error(element, attribute, f"is '{text}', which is not a finite number")
        return number

    def _error(self, element: _Placed, attribute: str, why: str) -> InputError:
        line = f", line {element.sourceline}" if element.sourceline else ""
        return InputError(
            f"{self.source}{line}: {attribute} of <{element.tag}> {why}{'' if why.endswith('?') else '.'}"
        )
