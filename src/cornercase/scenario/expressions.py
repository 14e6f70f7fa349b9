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

from cornercase._common.errors import InputError, suggestion
from cornercase._common.numbers import number_of

Operand = Any  # float, bool or str, or an array of them over concrete scenarios

_MOST_CHARACTERS: Final = 10_000
_MOST_NESTED: Final = 100
_MOST_SHOWN: Final = 100
_REMEMBERED: Final = 1024

_TOKEN: Final = re.compile(
    r"\s*(?:(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)|\$?(?P<name>[A-Za-z_][\w.]*)"
    r"|(?P<string>\"[^\"]*\"|'[^']*')|(?P<operator><=|>=|==|!=|\*\*|[-+*/%()<>,]))"
)

_BINARY: Final[dict[str, tuple[int, Callable[[Operand, Operand], Operand]]]] = {
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


def evaluate(expression: str, values: Mapping[str, Operand]) -> Operand:
    """Evaluate an expression, given without ``${`` and ``}``; arrays in `values` broadcast.

    The result is not finite if the expression has no value, as for a division by zero.
    """
    if len(expression) > _MOST_CHARACTERS:
        raise InputError(f"An expression has {len(expression)} characters; at most {_MOST_CHARACTERS} are read.")
    parser = _Parser(expression, values)
    try:
        with np.errstate(all="ignore"):
            result = parser.binary(0, 0)
    except TypeError:
        raise InputError(f"The expression '{_shortened(expression)}' mixes text and numbers.") from None
    parser.end()
    return result


def _is_text(value: Operand) -> bool:
    return isinstance(value, str)


def _number(value: Operand) -> Operand:
    """Convert a text to a number if possible; return anything else as it is."""
    try:
        return number_of(value) if _is_text(value) else value
    except ValueError:
        return value


def names_in(text: str) -> set[str]:
    """Return the parameters that an attribute's text refers to, as ``$name`` or within ``${…}``."""
    text = text.strip()
    if text.startswith("${") and text.endswith("}"):
        try:
            names = {kind[1] for kind in _tokens(text[2:-1]) if kind[0] == "name"}
        except InputError:
            return set()
        return names - set(_FUNCTIONS) - set(_CONSTANTS) - {"and", "or", "not"}
    return {text[1:]} if text.startswith("$") else set()


def _tokens(expression: str) -> Iterator[tuple[str, str]]:
    position = 0
    while expression[position:].strip():
        match = _TOKEN.match(expression, position)
        if match is None:
            rest = expression[position:].strip()[:20]
            raise InputError(f"The expression '{_shortened(expression)}' cannot be read at '{rest}'.")
        position = match.end()
        kind = str(match.lastgroup)
        yield kind, match.group(kind)


@lru_cache(_REMEMBERED)
def _token_list(expression: str) -> tuple[tuple[str, str], ...]:
    """Tokens of an expression, cached: the same ones are evaluated for each batch."""
    return tuple(_tokens(expression))


def _shortened(expression: str) -> str:
    return expression if len(expression) <= _MOST_SHOWN else f"{expression[:_MOST_SHOWN]}…"


class _Parser:
    def __init__(self, expression: str, values: Mapping[str, Operand]) -> None:
        self._expression = expression
        self._values = values
        self._tokens = _token_list(expression)
        self._next = 0

    def binary(self, weakest: int, depth: int) -> Operand:
        if depth > _MOST_NESTED:
            raise self._error(f"it is nested more than {_MOST_NESTED} deep")
        left = self._unary(depth)
        while (word := self._peek()) in _BINARY and _BINARY[word][0] > weakest:
            self._next += 1
            strength, apply = _BINARY[word]
            right = self.binary(strength, depth + 1)
            # Compare two texts as texts, but a text with a number as numbers.
            if word not in ("==", "!=") or _is_text(left) != _is_text(right):
                left, right = _number(left), _number(right)
            left = apply(left, right)
        return left

    def end(self) -> None:
        if self._next < len(self._tokens):
            raise self._error(f"'{self._peek()}' is not expected")

    def _unary(self, depth: int) -> Operand:
        word = self._peek()
        if word in ("-", "+", "not"):
            if depth > _MOST_NESTED:
                raise self._error("it is nested too deep")
            self._next += 1
            if word == "not":
                return np.logical_not(self.binary(2, depth + 1))
            value = _number(self._unary(depth + 1))
            return np.negative(value) if word == "-" else value
        return self._primary(depth)

    def _primary(self, depth: int) -> Operand:
        if self._next >= len(self._tokens):
            raise self._error("it ends too early")
        kind, word = self._tokens[self._next]
        self._next += 1
        if kind == "number":
            return float(word)
        if kind == "string":
            return word[1:-1]
        if word == "(":
            value = self.binary(0, depth + 1)
            self._expect(")")
            return value
        if kind != "name":
            raise self._error(f"'{word}' is not expected")
        if self._peek() == "(":
            return self._call(word, depth)
        if word in _CONSTANTS and word not in self._values:
            return _CONSTANTS[word]
        if word not in self._values:
            raise self._error(f"there is no parameter '{word}', {suggestion(word, self._values).rstrip('.')}")
        return self._values[word]

    def _call(self, name: str, depth: int) -> Operand:
        if name not in _FUNCTIONS:
            raise self._error(f"there is no function '{name}', {suggestion(name, _FUNCTIONS).rstrip('.')}")
        count, function = _FUNCTIONS[name]
        self._expect("(")
        arguments = [self.binary(0, depth + 1)]
        while self._peek() == ",":
            self._next += 1
            arguments.append(self.binary(0, depth + 1))
        self._expect(")")
        if len(arguments) != count:
            raise self._error(f"'{name}' takes {count} argument{'s' if count > 1 else ''}, not {len(arguments)}")
        return function(*map(_number, arguments))

    def _peek(self) -> str:
        return self._tokens[self._next][1] if self._next < len(self._tokens) else ""

    def _expect(self, word: str) -> None:
        if self._peek() != word:
            raise self._error(f"'{word}' is missing")
        self._next += 1

    def _error(self, why: str) -> InputError:
        return InputError(
            f"The expression '{_shortened(self._expression)}' cannot be read: {why}{'' if why[-1] == '?' else '.'}"
        )


def rounded(value: Any) -> Any:
    """Round the result of an expression to six decimals."""
    # As in esmini, which passes results as texts with six decimals; events may depend on the last one.
    array = np.asarray(value)
    return np.round(array, 6)[()] if array.dtype.kind == "f" else value
