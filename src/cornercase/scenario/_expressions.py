"""Evaluate OpenSCENARIO expressions ``${…}`` for many concrete scenarios at once.

The grammar is that of ASAM OpenSCENARIO XML 1.3, section "Expressions": arithmetic, comparison and logic on
numbers, booleans and strings, with the standard's functions. Expressions are parsed here and never run as code.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from typing import Any, Final

import numpy as np

from cornercase._common.errors import InputError, suggest_name
from cornercase._common.text.parse_number import parse_number

Operand = Any  # float, bool or str, or an array of them over concrete scenarios

_MAX_CHARACTERS: Final = 10_000
_MAX_NESTING: Final = 100
_MAX_SHOWN_CHARACTERS: Final = 100
_CACHE_SIZE: Final = 1024

_TOKEN: Final = re.compile(
    r"\s*(?:(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)|\$?(?P<name>[A-Za-z_][\w.]*)"
    r"|(?P<string>\"[^\"]*\"|'[^']*')|(?P<operator><=|>=|==|!=|\*\*|[-+*/%()<>,]))"
)

_BINARY_OPERATORS: Final[dict[str, tuple[int, Callable[[Operand, Operand], Operand]]]] = {
    "or": (1, np.logical_or),
    "and": (2, np.logical_and),
    "==": (3, np.equal),
    "!=": (3, np.not_equal),
    "<": (4, np.less),
    "<=": (4, np.less_equal),
    ">": (4, np.greater),
    ">=": (4, np.greater_equal),
    "+": (5, np.add),
    "-": (5, np.subtract),
    "*": (6, np.multiply),
    "/": (6, np.divide),
    "%": (6, np.fmod),
}

_FUNCTIONS: Final[dict[str, tuple[int, Callable[..., Operand]]]] = {
    "abs": (1, np.abs),
    "acos": (1, np.arccos),
    "asin": (1, np.arcsin),
    "atan": (1, np.arctan),
    "ceil": (1, np.ceil),
    "cos": (1, np.cos),
    "floor": (1, np.floor),
    "max": (2, np.maximum),
    "min": (2, np.minimum),
    "pow": (2, np.power),
    "round": (1, lambda value: np.copysign(np.floor(np.abs(value) + 0.5), value)),
    "sign": (1, np.sign),
    "sin": (1, np.sin),
    "sqrt": (1, np.sqrt),
    "tan": (1, np.tan),
}

_CONSTANTS: Final[dict[str, bool | float]] = {"true": True, "false": False, "pi": math.pi, "e": math.e}


def evaluate_expression(expression: str, values: Mapping[str, Operand]) -> Operand:
    """Evaluate an expression, given without ``${`` and ``}``.

    `values` has a scalar or an array for each parameter; arrays broadcast. If the expression has no value, as after a
    division by zero, the result is not finite.
    """
    if len(expression) > _MAX_CHARACTERS:
        raise InputError(f"An expression has {len(expression)} characters; at most {_MAX_CHARACTERS} are read.")
    parser = _ExpressionEvaluator(expression, values)
    try:
        with np.errstate(all="ignore"):
            result = parser.evaluate_binary(0, 0)
    except TypeError:
        raise InputError(f"The expression '{_shorten(expression)}' mixes text and numbers.") from None
    parser.require_end()
    return result


def _is_text(value: Operand) -> bool:
    return isinstance(value, str)


def _number_from_text(value: Operand) -> Operand:
    """Convert a text to a number if possible; return any other operand unchanged."""
    try:
        return parse_number(value) if _is_text(value) else value
    except ValueError:
        return value


def parameter_names_in(text: str) -> set[str]:
    """Return the parameters that the text of an attribute refers to, as ``$name`` or within ``${…}``."""
    text = text.strip()
    if text.startswith("${") and text.endswith("}"):
        try:
            names = {kind[1] for kind in _tokenize(text[2:-1]) if kind[0] == "name"}
        except InputError:
            return set()
        return names - set(_FUNCTIONS) - set(_CONSTANTS) - {"and", "or", "not"}
    return {text[1:]} if text.startswith("$") else set()


def _tokenize(expression: str) -> Iterator[tuple[str, str]]:
    position = 0
    while expression[position:].strip():
        match = _TOKEN.match(expression, position)
        if match is None:
            rest = expression[position:].strip()[:20]
            raise InputError(f"The expression '{_shorten(expression)}' cannot be read from '{rest}' on.")
        position = match.end()
        kind = str(match.lastgroup)
        yield kind, match.group(kind)


@lru_cache(_CACHE_SIZE)
def _tokenize_cached(expression: str) -> tuple[tuple[str, str], ...]:
    """Return the tokens of an expression; cached, since each batch evaluates the same expressions."""
    return tuple(_tokenize(expression))


def _shorten(expression: str) -> str:
    return expression if len(expression) <= _MAX_SHOWN_CHARACTERS else f"{expression[:_MAX_SHOWN_CHARACTERS]}…"


class _ExpressionEvaluator:
    def __init__(self, expression: str, values: Mapping[str, Operand]) -> None:
        self._expression = expression
        self._values = values
        self._tokens = _tokenize_cached(expression)
        self._position = 0

    def evaluate_binary(self, min_precedence: int, depth: int) -> Operand:
        if depth > _MAX_NESTING:
            raise self._error(f"it is nested more than {_MAX_NESTING} deep")
        left = self._evaluate_unary(depth)
        while (word := self._peek()) in _BINARY_OPERATORS and _BINARY_OPERATORS[word][0] > min_precedence:
            self._position += 1
            strength, apply = _BINARY_OPERATORS[word]
            right = self.evaluate_binary(strength, depth + 1)
            # Compare two texts as texts, but a text with a number as numbers.
            if word not in ("==", "!=") or _is_text(left) != _is_text(right):
                left, right = _number_from_text(left), _number_from_text(right)
            left = apply(left, right)
        return left

    def require_end(self) -> None:
        if self._position < len(self._tokens):
            raise self._error(f"'{self._peek()}' is not expected")

    def _evaluate_unary(self, depth: int) -> Operand:
        word = self._peek()
        if word in ("-", "+", "not"):
            if depth > _MAX_NESTING:
                raise self._error("it is nested too deep")
            self._position += 1
            if word == "not":
                return np.logical_not(self.evaluate_binary(2, depth + 1))
            value = _number_from_text(self._evaluate_unary(depth + 1))
            return np.negative(value) if word == "-" else value
        return self._evaluate_primary(depth)

    def _evaluate_primary(self, depth: int) -> Operand:
        if self._position >= len(self._tokens):
            raise self._error("it ends too early")
        kind, word = self._tokens[self._position]
        self._position += 1
        if kind == "number":
            return float(word)
        if kind == "string":
            return word[1:-1]
        if word == "(":
            value = self.evaluate_binary(0, depth + 1)
            self._expect(")")
            return value
        if kind != "name":
            raise self._error(f"'{word}' is not expected")
        if self._peek() == "(":
            return self._evaluate_function_call(word, depth)
        if word in _CONSTANTS and word not in self._values:
            return _CONSTANTS[word]
        if word not in self._values:
            raise self._error(f"there is no parameter '{word}', {suggest_name(word, self._values).rstrip('.')}")
        return self._values[word]

    def _evaluate_function_call(self, name: str, depth: int) -> Operand:
        if name not in _FUNCTIONS:
            raise self._error(f"there is no function '{name}', {suggest_name(name, _FUNCTIONS).rstrip('.')}")
        count, function = _FUNCTIONS[name]
        self._expect("(")
        arguments = [self.evaluate_binary(0, depth + 1)]
        while self._peek() == ",":
            self._position += 1
            arguments.append(self.evaluate_binary(0, depth + 1))
        self._expect(")")
        if len(arguments) != count:
            raise self._error(f"'{name}' takes {count} argument{'s' if count > 1 else ''}, not {len(arguments)}")
        return function(*map(_number_from_text, arguments))

    def _peek(self) -> str:
        return self._tokens[self._position][1] if self._position < len(self._tokens) else ""

    def _expect(self, word: str) -> None:
        if self._peek() != word:
            raise self._error(f"'{word}' is missing")
        self._position += 1

    def _error(self, reason: str) -> InputError:
        return InputError(
            f"The expression '{_shorten(self._expression)}' cannot be read: {reason}{'' if reason[-1] == '?' else '.'}"
        )


def round_result(value: Any) -> Any:
    """Round the result of an expression to six decimals."""
    # As in esmini, which passes results as texts with six decimals; events may depend on the last one.
    array = np.asarray(value)
    return np.round(array, 6)[()] if array.dtype.kind == "f" else value
