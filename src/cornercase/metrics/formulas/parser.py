"""Parser of formulas."""

from __future__ import annotations

from typing import Final, Literal, NoReturn, TypeAlias, cast

import numpy as np

from cornercase._common.errors import InputError
from cornercase.metrics.formulas.signals import unit_of
from cornercase.metrics.formulas.terms import Bound, Node, Operation, Predicate, Relation, Signal
from cornercase.metrics.formulas.units import in_si, is_unit, spelt
from cornercase.metrics.formulas.words import KEYWORDS, Word, Words, operator_meant

_LONGEST: Final = 10_000
_DEEPEST: Final = 50
_RELATIONS: Final = ("<=", ">=", "<", ">")
_TURNED: Final[dict[str, Relation]] = {"<": ">", "<=": ">=", ">": "<", ">=": "<="}

_Term: TypeAlias = "tuple[Signal, Word] | tuple[_Number, Word]"


class _Number:
    """A number with its unit, before the signal that it is compared with is known."""

    def __init__(self, value: float, unit: Word | None) -> None:
        self.value, self.unit = value, unit


def parse(text: str) -> Node:
    """Parse a formula. InputError names the position of the fault and what to write there."""
    if len(text) > _LONGEST:
        raise InputError(f"The formula '{text[:60]}…' has {len(text)} characters; give {_LONGEST} at most.")
    return _Parser(Words(text)).whole()


def read_comparison(words: Words) -> Predicate:
    """Parse a comparison, and leave the rest of the text unread. InputError if there is none."""
    return _Parser(words).comparison()


class _Parser:
    """Recursive descent, from the operator that binds least, `->`, down to comparisons."""

    def __init__(self, words: Words) -> None:
        self.words = words
        self.depth = 0

    def whole(self) -> Node:
        if self.words.ended:
            self.words.expected("a comparison, such as clearance > 0.5")
        formula = self.implication()
        if not self.words.ended:
            self._refuse_rest()
        return formula

    def _enter(self) -> None:
        self.depth += 1
        if self.depth > _DEEPEST:
            self.words.refuse(f"brackets and operators are nested more than {_DEEPEST} deep.")

    def implication(self) -> Node:
        self._enter()
        left = self.disjunction()
        if self.words.take_if("->"):
            left = Operation("->", (left, self.implication()))
        self.depth -= 1
        return left

    def disjunction(self) -> Node:
        parts = [self.conjunction()]
        while self.words.take_if("or"):
            parts.append(self.conjunction())
        return Operation("or", tuple(parts)) if len(parts) > 1 else parts[0]

    def conjunction(self) -> Node:
        parts = [self.until()]
        while self.words.take_if("and"):
            parts.append(self.until())
        return Operation("and", tuple(parts)) if len(parts) > 1 else parts[0]

    def until(self) -> Node:
        left = self.unary()
        if not self.words.take_if("until"):
            return left
        interval = self.interval()
        operation = Operation("until", (left, self.unary()), interval)
        if self.words.next.text == "until":
            self.words.refuse("put brackets around one of the two until.")
        return operation

    def unary(self) -> Node:
        word = self.words.next
        if word.kind == "name" and word.text in ("not", "always", "eventually"):
            self._enter()
            operator = cast('Literal["not", "always", "eventually"]', self.words.take().text)
            interval = None if operator == "not" else self.interval()
            operation = Operation(operator, (self.unary(),), interval)
            self.depth -= 1
            return operation
        if not self.words.take_if("("):
            return self.comparison()
        inner = self.implication()
        if not self.words.take_if(")"):
            if not self.words.ended:
                self._refuse_rest()
            self.words.expected("a closing bracket ')'")
        return inner

    def interval(self) -> tuple[float, float] | None:
        opening = self.words.next
        if not self.words.take_if("["):
            return None
        begin = self._instant("the begin of the interval in s, as in [0:5]")
        if not self.words.take_if(":", ","):
            self.words.expected("':' and the end of the interval, as in [0:5]")
        end = np.inf if self.words.next.text == "]" else self._instant("the end of the interval in s, as in [0:5]")
        if not self.words.take_if("]"):
            self.words.expected("']', the end of the interval")
        if end < begin:
            self.words.refuse(f"the interval ends at {end:g} s, before it begins at {begin:g} s.", opening)
        return begin, end

    def comparison(self) -> Predicate:
        left, left_token = self.term()
        relation = self.words.next
        if not self.words.take_if(*_RELATIONS):
            self.words.expected(f"a comparison of '{left_token.text}': {', '.join(_RELATIONS)}")
        right, right_token = self.term()
        if self.words.next.text in _RELATIONS:
            self.words.refuse("compare two at a time, as in 1 < ttc and ttc < 5.")
        name = cast(Relation, relation.text)
        if isinstance(left, Signal):
            return Predicate(left, name, self._compared(left, right, right_token))
        if isinstance(right, Signal):
            bound = self._compared(right, left, left_token)
            return Predicate(right, _TURNED[name], bound)
        self.words.refuse("two numbers are compared; name a signal, such as ego.speed.", left_token)

    def term(self) -> _Term:
        word = self.words.next
        if word.kind == "number":
            self.words.take()
            value = self._finite(word)
            return _Number(value, self.words.take_unit()), word
        if word.kind != "name":
            self.words.expected("a signal, such as ttc or ego.speed, or a number")
        if word.text == "abs":
            self.words.take()
            if not self.words.take_if("("):
                self.words.expected("a signal in brackets, as in abs(ego.acceleration)")
            signal, _ = self.signal(absolute=True)
            if not self.words.take_if(")"):
                self.words.expected("a closing bracket ')'; abs takes one signal")
            return signal, word
        return self.signal()

    def signal(self, absolute: bool = False) -> tuple[Signal, Word]:
        word = self.words.next
        if word.kind != "name" or word.text in KEYWORDS:
            self.words.expected("a signal, such as ttc or ego.speed")
        try:
            unit = unit_of(word.text)
        except InputError as error:
            hint = operator_meant(word.text) if word.text.isalpha() else ""
            message = str(error)
            if hint and "known are" in message:
                message = f"there is no signal '{word.text}'; {hint}"
            self.words.refuse(message)
        self.words.take()
        return Signal(word.text, unit, absolute), word

    def _compared(self, signal: Signal, other: Signal | _Number, place: Word) -> Signal | Bound:
        if isinstance(other, Signal):
            if spelt(other.unit) != spelt(signal.unit):
                self.words.refuse(
                    f"'{signal.text}' in {signal.unit} is compared with '{other.text}' in {other.unit}; compare signals"
                    " of one unit.",
                    place,
                )
            return other
        given = "" if other.unit is None else other.unit.text
        try:
            value = in_si(other.value, given, signal.unit)
        except InputError as error:
            # The text behind a number may be a misspelt operator.
            hint = "" if is_unit(given) else operator_meant(given)
            self.words.refuse(hint or f"{signal.text} is in {signal.unit}: {error}", other.unit)
        return Bound(value, f"{place.text.removeprefix('+')} {spelt(given)}".rstrip())

    def _instant(self, what: str) -> float:
        word = self.words.next
        if word.kind != "number":
            self.words.expected(what)
        self.words.take()
        value = self._finite(word)
        unit = self.words.take_unit()
        if unit is not None:
            try:
                value = in_si(value, unit.text, "s")
            except InputError as error:
                self.words.refuse(f"intervals are in s: {error}", unit)
        if value < 0.0:
            self.words.refuse("intervals begin at 0 s or later, as they look ahead.", word)
        return value

    def _finite(self, word: Word) -> float:
        value = float(word.text)
        if not np.isfinite(value):
            self.words.refuse("the number is too large.", word)
        return value

    def _refuse_rest(self) -> NoReturn:
        word = self.words.next
        if word.text == ")":
            self.words.refuse("this bracket has no opening bracket; remove it.")
        hint = operator_meant(word.text) if word.kind == "name" else ""
        self.words.refuse(hint or "give and, or, ->, until, or the end of the formula.")
