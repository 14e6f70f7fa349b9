"""Parser of expressions."""

from __future__ import annotations

import re
from typing import Final, Literal, NoReturn, TypeAlias, cast

import numpy as np

from cornercase._common.errors import InputError, suggest_name
from cornercase._common.text.sanitize import parse_json
from cornercase.metrics.expressions._ast import (
    ENTITY_NAME,
    TEMPORAL,
    Bound,
    Constant,
    EgoCollides,
    EgoDrives,
    EgoReaches,
    Node,
    Operation,
    Operator,
    ReferenceCollides,
    Relation,
    Signal,
)
from cornercase.metrics.expressions._lexer import KEYWORDS, Lexer, Token, suggest_operator
from cornercase.metrics.expressions._signals import SCORE_PREFIX, has_signal, signal_names, signal_unit
from cornercase.metrics.expressions._units import convert_to_unit, is_known_unit, normalize_unit

Language = Literal["formula", "requirement", "condition"]

DEFAULT_RADIUS: Final = 2.0
"""Default radius in m around a position that the ego has to reach."""

_MAX_DEPTH: Final = 50
_MAX_NUMBER: Final = 1e6
_RELATIONS: Final = ("<=", ">=", "<", ">")
_MIRRORED_RELATIONS: Final[dict[str, Relation]] = {"<": ">", "<=": ">=", ">": "<", ">=": "<="}
# Operators of two and more operands, from the one that binds least.
_CONNECTIVES: Final[tuple[Operator, ...]] = ("->", "or", "and")
_STATEMENTS: Final = ("collision", "no collision", "reference:NAME", "reach", "drive")
_RELATION_AHEAD: Final = re.compile(r"\s*[<>]")
_QUOTED_NAME: Final = re.compile(r'"(?:[^"\\]|\\.)*"')
_DRIVER_NAME: Final = re.compile(r'[A-Za-z_][^\s()\[\]<>":]*(?:\s*:\s*[^\s()\[\]<>":]+)*')
_DRIVER_COLLIDES: Final = re.compile(r"(?:reference:)?(\S+)\s+collides\b", re.IGNORECASE)

_Term: TypeAlias = "tuple[Signal | _NumberWithUnit, Token]"


class _NumberWithUnit:
    """A number with its unit; it is not yet known which signal it is compared with."""

    def __init__(self, value: float, unit: Token | None) -> None:
        self.value, self.unit = value, unit


def parse_expression(text: str, language: Language = "formula") -> Node:
    """Parse an expression. ExpressionError marks the place of the fault and says what to write there.

    In a condition, a bound on a metric outside of temporal operators is on its score.
    """
    return _Parser(text, language).parse_whole()


class _Parser:
    """Recursive descent, from the operator that binds least, `->`, down to bounds and statements."""

    def __init__(self, text: str, language: Language) -> None:
        self.lexer = Lexer(text, language)
        self.language, self.depth = language, 0
        self.bound_tokens: dict[int, Token] = {}

    def parse_whole(self) -> Node:
        if self.lexer.is_at_end:
            self.lexer.raise_expected("a bound such as ttc > 1.5, or a statement such as 'no collision'")
        root = self.parse_connected(0)
        if not self.lexer.is_at_end:
            self._raise_for_rest()
        return self._compare_scores(root) if self.language == "condition" else root

    def parse_connected(self, level: int) -> Node:
        if level == len(_CONNECTIVES):
            return self.parse_until()
        operator = _CONNECTIVES[level]
        parts = [self.parse_connected(level + 1)]
        while self.lexer.read_if(operator):
            parts.append(self.parse_connected(level + 1))
        if operator == "->":
            node = parts.pop()
            while parts:
                node = self._operation(operator, (parts.pop(), node))
            return node
        return self._operation(operator, tuple(parts)) if len(parts) > 1 else parts[0]

    def parse_until(self) -> Node:
        left = self.parse_unary()
        if not self.lexer.read_if("until"):
            return left
        interval = self.parse_interval()
        operation = self._operation("until", (left, self.parse_unary()), interval)
        if self.lexer.next_token.text == "until":
            self.lexer.raise_error("put brackets around one of the two until.")
        return operation

    def parse_unary(self, is_operand: bool = False) -> Node:
        token = self.lexer.next_token
        is_unary = token.kind == "name" and token.text in ("not", "always", "eventually")
        # A bracket right behind an operator is no further level.
        levels = int(is_unary or (token.text == "(" and not is_operand))
        self.depth += levels
        if self.depth > _MAX_DEPTH:
            self._raise_too_deep()
        if is_unary:
            operator = cast(Operator, self.lexer.read_token().text)
            interval = None if operator == "not" else self.parse_interval()
            node = self._operation(operator, (self.parse_unary(is_operand=True),), interval)
        elif self.lexer.read_if("("):
            node = self.parse_connected(0)
            if not self.lexer.read_if(")"):
                if not self.lexer.is_at_end:
                    self._raise_for_rest()
                self.lexer.raise_expected("a closing bracket ')'")
        else:
            node = self.parse_statement()
        self.depth -= levels
        return node

    def parse_interval(self) -> tuple[float, float] | None:
        opening = self.lexer.next_token
        if not self.lexer.read_if("["):
            return None
        begin = self._parse_time("the begin of the interval in s, as in [0:5]")
        if not self.lexer.read_if(":", ","):
            self.lexer.raise_expected("':' and the end of the interval, as in [0:5]")
        is_open = self.lexer.next_token.text == "]"
        end = np.inf if is_open else self._parse_time("the end of the interval in s, as in [0:5]")
        if not self.lexer.read_if("]"):
            self.lexer.raise_expected("']', the end of the interval")
        if end < begin:
            self.lexer.raise_error(f"the interval ends at {end:g} s, before it begins at {begin:g} s.", opening)
        return begin, end

    def parse_statement(self) -> Node:
        token = self.lexer.next_token
        # A metric may have the name of a statement.
        if token.kind != "name" or _RELATION_AHEAD.match(self.lexer.text, token.end):
            return self.parse_bound()
        if self.lexer.read_word("no"):
            if not self.lexer.read_word("collision"):
                self.lexer.raise_expected("collision, as in 'no collision' and 'no collision with NAME'")
            collision = self.parse_collision()
            if not self.lexer.read_word("unless"):
                return self._operation("no", (collision,))
            driver = self.lexer.read_pattern(_DRIVER_COLLIDES, "a driver, as in 'no collision unless cc-human collides'")
            return self._operation("unless", (collision, ReferenceCollides(driver[1])))
        if self.lexer.read_word("collision"):
            return self.parse_collision()
        if self.lexer.read_if("reference"):
            if not self.lexer.read_if(":"):
                self.lexer.raise_expected("a colon and the name of a driver, as in reference:cc-human")
            driver = self.lexer.read_pattern(_DRIVER_NAME, "the name of a driver, as in reference:cc-human")
            return ReferenceCollides(re.sub(r"\s*:\s*", ":", driver[0]))
        if self.lexer.read_if("reach"):
            return self.parse_position(token)
        if self.lexer.read_if("drive"):
            distance = self._parse_quantity("m", "a distance, as in drive 30")
            if not 0.0 < distance <= _MAX_NUMBER:
                self.lexer.raise_error("give a distance above 0 and at most 1000 km.", token)
            return EgoDrives(distance)
        return self.parse_bound()

    def parse_collision(self) -> EgoCollides:
        """Parse what follows the word ``collision``."""
        at_fault = self.lexer.read_word("at")
        if at_fault and not self.lexer.read_word("fault"):
            self.lexer.raise_expected("fault, as in 'collision at fault'")
        if not self.lexer.read_word("with"):
            return EgoCollides("", at_fault)
        expected = "the name of an entity, in quotation marks if it contains brackets or an operator"
        token = self.lexer.next_token
        if not self.lexer.text.startswith('"', token.begin):
            return EgoCollides(" ".join(self.lexer.read_pattern(ENTITY_NAME, expected)[0].split()), at_fault)
        quoted = self.lexer.read_pattern(_QUOTED_NAME, expected)[0]
        try:
            return EgoCollides(str(parse_json(quoted)), at_fault)
        except ValueError:
            self.lexer.raise_error("write the name in quotation marks as in JSON.", token)

    def parse_position(self, token: Token) -> EgoReaches:
        """Parse what follows the word ``reach``, the token."""
        form = "a position and time, as in 'reach X,Y[,R] within T', in m and s"
        values = [self._parse_quantity("m", form)]
        while self.lexer.read_if(",") and len(values) < 3:
            values.append(self._parse_quantity("m", form))
        if len(values) < 2 or not self.lexer.read_if("within"):
            self.lexer.raise_expected(form)
        x, y, radius = (*values, DEFAULT_RADIUS)[:3]
        within = self._parse_quantity("s", form)
        if not (0.0 < radius <= _MAX_NUMBER and 0.0 < within <= _MAX_NUMBER and max(abs(x), abs(y)) <= _MAX_NUMBER):
            self.lexer.raise_error("give a position within 1000 km, and a positive radius and time.", token)
        return EgoReaches(x, y, radius, within)

    def parse_bound(self) -> Bound:
        left, left_token = self.parse_term()
        relation = self.lexer.next_token
        if not self.lexer.read_if(*_RELATIONS):
            self.lexer.raise_expected(f"a comparison of '{left_token.text}': {', '.join(_RELATIONS)}")
        right, right_token = self.parse_term()
        if self.lexer.next_token.text in _RELATIONS:
            self.lexer.raise_error("compare two at a time, as in 1 < ttc and ttc < 5.")
        name = cast(Relation, relation.text)
        if isinstance(left, Signal):
            bound = Bound(left, name, self._right_side_of_bound(left, right, right_token))
        elif isinstance(right, Signal):
            bound = Bound(right, _MIRRORED_RELATIONS[name], self._right_side_of_bound(right, left, left_token))
        else:
            self.lexer.raise_error("two numbers are compared; name a signal, such as ego.speed.", left_token)
        self.bound_tokens[id(bound)] = left_token
        return bound

    def parse_term(self) -> _Term:
        token = self.lexer.next_token
        if token.kind == "number":
            self.lexer.read_token()
            value = self._finite_number(token)
            return _NumberWithUnit(value, self.lexer.read_unit()), token
        if token.kind == "name" and self.lexer.text.startswith("(", token.end):
            if self.lexer.read_if("abs"):
                return self._parse_in_brackets("abs"), token
            if self.lexer.read_if("score"):
                return self._parse_in_brackets("score"), token
        return self.parse_signal(), token

    def parse_signal(self) -> Signal:
        token = self.lexer.next_token
        if token.kind != "name" or token.text in ("not", "and", "or", "always", "eventually", "until"):
            self.lexer.raise_expected("a signal, such as ttc or ego.speed, or a number")
        if not has_signal(token.text):
            known = suggest_name(token.text.partition(":")[0], [*_STATEMENTS, *signal_names()])
            hint = suggest_operator(token.text) if token.text.isalpha() and "known are" in known else ""
            self.lexer.raise_error(f"there is no signal '{token.text}'; {hint or known}")
        try:
            unit = signal_unit(token.text)
        except InputError as error:
            self.lexer.raise_error(str(error))
        self.lexer.read_token()
        return Signal(token.text, unit)

    def _parse_in_brackets(self, function: Literal["abs", "score"]) -> Signal:
        self.lexer.read_token()
        token = self.lexer.next_token
        signal = self.parse_signal()
        if not self.lexer.read_if(")"):
            self.lexer.raise_expected(f"a closing bracket ')'; {function} takes one signal")
        if function == "abs":
            return Signal(signal.name, signal.unit, absolute=True)
        if not signal.metric:
            self.lexer.raise_error(f"only a metric has a score, not {signal.name}.", token)
        return Signal(f"{SCORE_PREFIX}{signal.name})", signal.unit)

    def _right_side_of_bound(self, signal: Signal, other: Signal | _NumberWithUnit, token: Token) -> Signal | Constant:
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
        token = self.lexer.next_token
        value = self._parse_quantity("s", expected)
        if value < 0.0:
            self.lexer.raise_error("intervals begin at 0 s or later, as they look ahead.", token)
        return value

    def _parse_quantity(self, unit: str, expected: str) -> float:
        """Parse a number with or without a unit, and convert it to `unit`."""
        token = self.lexer.next_token
        if token.kind != "number":
            self.lexer.raise_expected(expected)
        self.lexer.read_token()
        value = self._finite_number(token)
        given = self.lexer.read_unit()
        if given is None:
            return value
        try:
            return convert_to_unit(value, given.text, unit)
        except InputError as error:
            self.lexer.raise_error(f"this number is in {unit}: {error}", given)

    def _finite_number(self, token: Token) -> float:
        value = float(token.text)
        if not np.isfinite(value):
            self.lexer.raise_error("the number is too large.", token)
        return value

    def _operation(
        self, operator: Operator, operands: tuple[Node, ...], interval: tuple[float, float] | None = None
    ) -> Operation:
        operation = Operation(operator, operands, interval)
        if operation.depth > _MAX_DEPTH:
            self._raise_too_deep()
        return operation

    def _compare_scores(self, node: Node) -> Node:
        """Replace metrics by their scores outside of temporal operators."""
        if isinstance(node, Operation):
            if node.operator in TEMPORAL:
                return node
            return Operation(node.operator, tuple(map(self._compare_scores, node.operands)))
        if not isinstance(node, Bound) or all(signal.is_score for signal in node.signals):
            return node
        signal = node.left
        if signal.absolute or not signal.metric or not isinstance(node.right, Constant):
            self.lexer.raise_error(
                "compare the score of a metric with a number, as in ttc < 1, or say when this holds, as in"
                f" always({node.text}) or eventually({node.text}).",
                self.bound_tokens[id(node)],
            )
        return Bound(Signal(f"{SCORE_PREFIX}{signal.name})", signal.unit), node.relation, node.right)

    def _raise_too_deep(self) -> NoReturn:
        self.lexer.raise_error(f"brackets and operators are nested more than {_MAX_DEPTH} deep.")

    def _raise_for_rest(self) -> NoReturn:
        token = self.lexer.next_token
        if token.text == ")":
            self.lexer.raise_error("this bracket has no opening bracket; remove it.")
        hint = suggest_operator(token.text) if token.kind == "name" and token.text not in KEYWORDS else ""
        self.lexer.raise_error(hint or f"give and, or, ->, until, or the end of the {self.language}.")
