"""Parser of formulas."""

from __future__ import annotations

from typing import Final, Literal, NoReturn, TypeAlias, cast

import numpy as np

from cornercase._common.errors import InputError
from cornercase.metrics.formulas._ast import Comparison, Constant, Node, Operation, Relation, Signal
from cornercase.metrics.formulas._lexer import KEYWORDS, Lexer, Token, suggest_operator
from cornercase.metrics.formulas._signals import signal_unit
from cornercase.metrics.formulas._units import convert_to_unit, is_known_unit, normalize_unit

_MAX_LENGTH: Final = 10_000
_MAX_DEPTH: Final = 50
_RELATIONS: Final = ("<=", ">=", "<", ">")
_MIRRORED_RELATIONS: Final[dict[str, Relation]] = {"<": ">", "<=": ">=", ">": "<", ">=": "<="}

_Term: TypeAlias = "tuple[Signal, Token] | tuple[_NumberWithUnit, Token]"


class _NumberWithUnit:
    """A number with its unit; it is not yet known which signal it is compared with."""

    def __init__(self, value: float, unit: Token | None) -> None:
        self.value, self.unit = value, unit


def parse_formula(text: str) -> Node:
    """Parse a formula. InputError names the position of the fault and what to write there."""
    if len(text) > _MAX_LENGTH:
        raise InputError(f"The formula '{text[:60]}…' has {len(text)} characters; give {_MAX_LENGTH} at most.")
    return _FormulaParser(Lexer(text)).parse_whole()


def parse_comparison(lexer: Lexer) -> Comparison:
    """Parse a comparison, and leave the rest of the text unread. InputError if there is none."""
    return _FormulaParser(lexer).parse_comparison()


class _FormulaParser:
    """Recursive descent, from the operator that binds least, `->`, down to comparisons."""

    def __init__(self, lexer: Lexer) -> None:
        self.lexer = lexer
        self.depth = 0

    def parse_whole(self) -> Node:
        if self.lexer.is_at_end:
            self.lexer.raise_expected("a comparison, such as clearance > 0.5")
        formula = self.parse_implication()
        if not self.lexer.is_at_end:
            self._raise_for_rest()
        return formula

    def _increase_depth(self) -> None:
        self.depth += 1
        if self.depth > _MAX_DEPTH:
            self.lexer.raise_error(f"brackets and operators are nested more than {_MAX_DEPTH} deep.")

    def parse_implication(self) -> Node:
        self._increase_depth()
        left = self.parse_disjunction()
        if self.lexer.read_if("->"):
            left = Operation("->", (left, self.parse_implication()))
        self.depth -= 1
        return left

    def parse_disjunction(self) -> Node:
        parts = [self.parse_conjunction()]
        while self.lexer.read_if("or"):
            parts.append(self.parse_conjunction())
        return Operation("or", tuple(parts)) if len(parts) > 1 else parts[0]

    def parse_conjunction(self) -> Node:
        parts = [self.parse_until()]
        while self.lexer.read_if("and"):
            parts.append(self.parse_until())
        return Operation("and", tuple(parts)) if len(parts) > 1 else parts[0]

    def parse_until(self) -> Node:
        left = self.parse_unary()
        if not self.lexer.read_if("until"):
            return left
        interval = self.parse_interval()
        operation = Operation("until", (left, self.parse_unary()), interval)
        if self.lexer.next_token.text == "until":
            self.lexer.raise_error("put brackets around one of the two until.")
        return operation

    def parse_unary(self) -> Node:
        word = self.lexer.next_token
        if word.kind == "name" and word.text in ("not", "always", "eventually"):
            self._increase_depth()
            operator = cast('Literal["not", "always", "eventually"]', self.lexer.read_token().text)
            interval = None if operator == "not" else self.parse_interval()
            operation = Operation(operator, (self.parse_unary(),), interval)
            self.depth -= 1
            return operation
        if not self.lexer.read_if("("):
            return self.parse_comparison()
        inner = self.parse_implication()
        if not self.lexer.read_if(")"):
            if not self.lexer.is_at_end:
                self._raise_for_rest()
            self.lexer.raise_expected("a closing bracket ')'")
        return inner

    def parse_interval(self) -> tuple[float, float] | None:
        opening = self.lexer.next_token
        if not self.lexer.read_if("["):
            return None
        begin = self._parse_time("the begin of the interval in s, as in [0:5]")
        if not self.lexer.read_if(":", ","):
            self.lexer.raise_expected("':' and the end of the interval, as in [0:5]")
        end = (
            np.inf
            if self.lexer.next_token.text == "]"
            else self._parse_time("the end of the interval in s, as in [0:5]")
        )
        if not self.lexer.read_if("]"):
            self.lexer.raise_expected("']', the end of the interval")
        if end < begin:
            self.lexer.raise_error(f"the interval ends at {end:g} s, before it begins at {begin:g} s.", opening)
        return begin, end

    def parse_comparison(self) -> Comparison:
        left, left_token = self.parse_term()
        relation = self.lexer.next_token
        if not self.lexer.read_if(*_RELATIONS):
            self.lexer.raise_expected(f"a comparison of '{left_token.text}': {', '.join(_RELATIONS)}")
        right, right_token = self.parse_term()
        if self.lexer.next_token.text in _RELATIONS:
            self.lexer.raise_error("compare two at a time, as in 1 < ttc and ttc < 5.")
        name = cast(Relation, relation.text)
        if isinstance(left, Signal):
            return Comparison(left, name, self._right_side_of_comparison(left, right, right_token))
        if isinstance(right, Signal):
            bound = self._right_side_of_comparison(right, left, left_token)
            return Comparison(right, _MIRRORED_RELATIONS[name], bound)
        self.lexer.raise_error("two numbers are compared; name a signal, such as ego.speed.", left_token)

    def parse_term(self) -> _Term:
        word = self.lexer.next_token
        if word.kind == "number":
            self.lexer.read_token()
            value = self._finite_number(word)
            return _NumberWithUnit(value, self.lexer.read_unit()), word
        if word.kind != "name":
            self.lexer.raise_expected("a signal, such as ttc or ego.speed, or a number")
        if word.text == "abs":
            self.lexer.read_token()
            if not self.lexer.read_if("("):
                self.lexer.raise_expected("a signal in brackets, as in abs(ego.acceleration)")
            signal, _ = self.parse_signal(absolute=True)
            if not self.lexer.read_if(")"):
                self.lexer.raise_expected("a closing bracket ')'; abs takes one signal")
            return signal, word
        return self.parse_signal()

    def parse_signal(self, absolute: bool = False) -> tuple[Signal, Token]:
        word = self.lexer.next_token
        if word.kind != "name" or word.text in KEYWORDS:
            self.lexer.raise_expected("a signal, such as ttc or ego.speed")
        try:
            unit = signal_unit(word.text)
        except InputError as error:
            hint = suggest_operator(word.text) if word.text.isalpha() else ""
            message = str(error)
            if hint and "known are" in message:
                message = f"there is no signal '{word.text}'; {hint}"
            self.lexer.raise_error(message)
        self.lexer.read_token()
        return Signal(word.text, unit, absolute), word

    def _right_side_of_comparison(
        self, signal: Signal, other: Signal | _NumberWithUnit, token: Token
    ) -> Signal | Constant:
        if isinstance(other, Signal):
            if normalize_unit(other.unit) != normalize_unit(signal.unit):
                self.lexer.raise_error(
                    f"'{signal.text}' in {signal.unit} is compared with '{other.text}' in {other.unit}; compare signals"
                    " of one unit.",
                    token,
                )
            return other
        given = "" if other.unit is None else other.unit.text
        try:
            value = convert_to_unit(other.value, given, signal.unit)
        except InputError as error:
            # The text behind a number may be a misspelt operator.
            hint = "" if is_known_unit(given) else suggest_operator(given)
            self.lexer.raise_error(hint or f"{signal.text} is in {signal.unit}: {error}", other.unit)
        return Constant(value, f"{token.text.removeprefix('+')} {normalize_unit(given)}".rstrip())

    def _parse_time(self, expected: str) -> float:
        word = self.lexer.next_token
        if word.kind != "number":
            self.lexer.raise_expected(expected)
        self.lexer.read_token()
        value = self._finite_number(word)
        unit = self.lexer.read_unit()
        if unit is not None:
            try:
                value = convert_to_unit(value, unit.text, "s")
            except InputError as error:
                self.lexer.raise_error(f"intervals are in s: {error}", unit)
        if value < 0.0:
            self.lexer.raise_error("intervals begin at 0 s or later, as they look ahead.", word)
        return value

    def _finite_number(self, word: Token) -> float:
        value = float(word.text)
        if not np.isfinite(value):
            self.lexer.raise_error("the number is too large.", word)
        return value

    def _raise_for_rest(self) -> NoReturn:
        word = self.lexer.next_token
        if word.text == ")":
            self.lexer.raise_error("this bracket has no opening bracket; remove it.")
        hint = suggest_operator(word.text) if word.kind == "name" else ""
        self.lexer.raise_error(hint or "give and, or, ->, until, or the end of the formula.")
