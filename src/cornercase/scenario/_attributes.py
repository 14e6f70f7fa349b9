"""Read the XML attributes of a scenario file for a batch of concrete scenarios at once."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any, Final

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.io.tracked_xml import note_adaptation
from cornercase._common.text.element_locations import format_location
from cornercase._common.text.parse_number import parse_finite_number, parse_number
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.scenario._batch_split import BatchSplitError
from cornercase.scenario._constraints import ParameterDeclaration
from cornercase.scenario._expressions import evaluate_expression, parameter_names_in, round_result
from cornercase.scenario._parameter import Value
from cornercase.scenario._types import format_value

_SourceElement = etree._Element | ParameterDeclaration
"""Something with a line number in the file."""

# Integers are lane numbers and repetitions.
_MAX_INTEGER: Final = 1e9


# Cached, since files repeat the same few numbers.
_parse_number_cached = lru_cache(4096)(parse_finite_number)


class AttributeReader:
    """Reads XML attributes as numbers or texts, for the parameter values of N concrete scenarios.

    `parameter_values` has the value of each parameter, a scalar or an array of shape (N,). `origin_parameters` has, for
    each parameter, the parameters of the logical scenario that determine its value. `split_parameters` collects the
    parameters that must have the same value in all N scenarios, since an attribute that depends on them was read as one
    value for all.
    """

    def __init__(
        self,
        file_name: str,
        n_scenarios: int,
        parameter_values: Mapping[str, Any],
        origin_parameters: Mapping[str, set[str]],
    ) -> None:
        self.file_name = file_name
        self.n_scenarios = n_scenarios
        self.parameter_values = dict(parameter_values)
        self._origin_parameters = dict(origin_parameters)
        self.split_parameters: set[str] = set()
        self._invalid_values: list[tuple[str, BoolArray]] = []

    def find_origin_parameters(self, text: str) -> set[str]:
        """Return the parameters of the logical scenario that the text of an attribute depends on."""
        return {origin for name in parameter_names_in(text) for origin in self._origin_parameters.get(name, set())}

    def read_numbers(self, element: etree._Element, attribute: str, default: float | None = None) -> FloatArray:
        """Read an attribute as a number for each scenario, shape (N,).

        In scenarios in which an expression has no value, the number is not finite, and `invalid_values` lists the
        attribute. If the attribute is missing, return `default`, or raise `InputError` if that is None.
        """
        text = element.get(attribute)
        if text is None:
            if default is None:
                raise self._error(element, attribute, "is missing")
            return self._constant_array(float(default))
        literal = _parse_number_cached(text)
        if literal is not None:
            return self._constant_array(literal)
        value = self._evaluate(text, element, attribute)
        if isinstance(value, str):
            value = self._parse_float(
                value, element, attribute, allow_infinite=default is not None and np.isinf(default)
            )
        elif isinstance(value, np.ndarray | np.floating | float):
            broken = ~np.isfinite(value)
            if np.all(broken) and not self.find_origin_parameters(text):
                raise self._error(element, attribute, f"is '{text[:60]}', which has no finite value")
            if np.any(broken):
                everywhere = np.broadcast_to(broken, (self.n_scenarios,))
                self.mark_invalid(element, attribute, f"is '{text[:60]}', which has no finite value", everywhere)
        numbers = np.asarray(value, dtype=np.float64)
        if numbers.shape == (self.n_scenarios,):
            return numbers.copy()
        return np.full(self.n_scenarios, numbers)

    def _constant_array(self, number: float) -> FloatArray:
        # Twice as fast as `np.full`; a file has hundreds of numbers.
        result = np.empty(self.n_scenarios)
        result.fill(number)
        return result

    def mark_invalid(self, element: _SourceElement, attribute: str, reason: str, invalid: BoolArray) -> None:
        """Record that an attribute is invalid in the scenarios where the mask `invalid` is True.

        `reason` completes a sentence about the attribute, such as "is not above 0".
        """
        if invalid.any():
            self._invalid_values.append(
                (f"line {element.sourceline}: {attribute} of <{element.tag}> {reason}", invalid.copy())
            )

    def invalid_values(self) -> list[tuple[str, BoolArray]]:
        """Return a description and a mask for each invalid attribute, in the order of reading.

        The description has no full stop. The mask has shape (N,) and marks the scenarios in which it is invalid.
        """
        return list(self._invalid_values)

    def read_number(self, element: etree._Element, attribute: str, default: float | None = None) -> float:
        """Read an attribute as one number for all scenarios; raises `BatchSplitError` if their numbers differ."""
        text = element.get(attribute, "")
        literal = _parse_number_cached(text)
        if literal is not None:
            return literal
        values = self.read_numbers(element, attribute, default)
        origins = self.find_origin_parameters(text)
        if (values != values[0]).any() and not np.isnan(values).all():
            raise BatchSplitError(origins)
        self.split_parameters |= origins
        if np.isnan(values[0]):
            raise self._error(element, attribute, f"is '{text[:60]}', which has no finite value")
        return float(values[0])

    def read_integer(
        self, element: etree._Element, attribute: str, default: int | None = None, minimum: int | None = None
    ) -> int:
        """Read an attribute as one integer for all scenarios; raises `BatchSplitError` if their integers differ."""
        value = self.read_number(element, attribute, default)
        if not abs(value) < _MAX_INTEGER or value != round(value):
            raise self._error(element, attribute, f"is {value:g}, which is not a whole number that can be used")
        if minimum is not None and value < minimum:
            raise self._error(element, attribute, f"is {value:g}; it has to be at least {minimum}")
        return round(value)

    def read_text(self, element: etree._Element, attribute: str, default: str | None = None) -> str:
        """Read an attribute as one text for all scenarios; raises `BatchSplitError` if their texts differ."""
        text = element.get(attribute)
        if text is None:
            if default is None:
                raise self._error(element, attribute, "is missing")
            return default
        if "$" not in text:
            return text.strip()
        value, origins = self._evaluate(text, element, attribute), self.find_origin_parameters(text)
        if isinstance(value, np.ndarray):
            if len(np.unique(value)) > 1:
                raise BatchSplitError(origins)
            value = value.flat[0].item()
        self.split_parameters |= origins
        return format_value(value)

    def read_boolean(self, element: etree._Element, attribute: str, default: bool) -> bool:
        """Read an attribute as one boolean for all scenarios; raises `BatchSplitError` if their booleans differ."""
        text = self.read_text(element, attribute, "true" if default else "false")
        if text.lower() not in ("true", "false", "1", "0"):
            raise self._error(element, attribute, f"is '{text}', not true or false")
        if text != text.lower() and isinstance(element, etree._Element):
            reason = f"'{text}' is read as {text.lower()}"
            note_adaptation(element, f"{attribute} of <{element.tag}>", reason, "a boolean is true, false, 1 or 0")
            text = text.lower()
        return text in ("true", "1")

    def _evaluate(self, text: str, element: _SourceElement, attribute: str = "value") -> Any:
        text = text.strip()
        try:
            if text.startswith("${") and text.endswith("}"):
                result = round_result(evaluate_expression(text[2:-1], self.parameter_values))
                self._record_text_used_as_number(text, result, element, attribute)
                return result
            if text[:1] == "$" and text[1:] in self.parameter_values:
                return self.parameter_values[text[1:]]
            if text.startswith("$"):
                return evaluate_expression(text, self.parameter_values)
        except InputError as error:
            raise self._error(element, attribute, f"cannot be evaluated. {str(error).removesuffix('.')}") from None
        return text

    def _record_text_used_as_number(self, text: str, result: Any, element: _SourceElement, attribute: str) -> None:
        """Record on the element if the expression `text` calculates with parameters whose values are texts."""
        texts = [name for name in sorted(parameter_names_in(text)) if isinstance(self.parameter_values.get(name), str)]
        if texts and isinstance(element, etree._Element) and isinstance(result, float | np.floating | np.ndarray):
            note_adaptation(
                element,
                f"{attribute} of <{element.tag}>",
                f"the text of the parameter {', '.join(texts)} is taken as a number",
                "an expression calculates with numbers, not with texts",
            )

    def _parse_float(
        self, text: Value, element: _SourceElement, attribute: str = "value", allow_infinite: bool = False
    ) -> float:
        try:
            number = parse_number(text)
        except ValueError:
            comma = isinstance(text, str) and _parse_number_cached(text.replace(",", ".", 1)) is not None
            hint = f"; write it with a point, as {text.replace(',', '.', 1)}" if comma and isinstance(text, str) else ""
            raise self._error(element, attribute, f"is '{text}', which is not a number{hint}") from None
        if not np.isfinite(number) and not (allow_infinite and number == np.inf):
            raise self._error(element, attribute, f"is '{text}', which is not a finite number")
        return number

    def _error(self, element: _SourceElement, attribute: str, reason: str) -> InputError:
        ending = "" if reason.endswith("?") else "."
        return self.error_at(element, f"{attribute} of <{element.tag}> {reason}{ending}")

    def error_at(self, element: _SourceElement, message: str) -> InputError:
        """Return an error with a message that begins with the file and line of an element."""
        return InputError(f"{format_location(element, self.file_name)}: {message}")
