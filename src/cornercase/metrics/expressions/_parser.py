"""Parser of logical expressions by recursive descent; errors mark the position in the text."""

from __future__ import annotations

import re
import unicodedata
from dataclasses import replace
from typing import Final, Literal, NamedTuple, NoReturn, cast

import numpy as np

from cornercase._common.errors import ExpressionError, InputError, suggest_name
from cornercase._common.text.sanitize import escape_control_characters, parse_json
from cornercase.metrics.expressions._ast import (
    ENTITY_NAME,
    TEMPORAL,
    Bound,
    EgoCollides,
    EgoDrives,
    EgoLeaves,
    EgoReaches,
    Node,
    Operation,
    Operator,
    ReferenceCollides,
    Relation,
    Signal,
    format_node,
)
from cornercase.metrics.expressions._recorded_signals import (
    LATERAL_ACCELERATION,
    SCORE_PREFIX,
    has_signal,
    signal_names,
    signal_unit,
)
from cornercase.metrics.expressions._units import convert_to_unit, is_known_unit, normalize_unit

Language = Literal["formula", "requirement", "condition"]

DEFAULT_RADIUS: Final = 2.0
"""Default radius in m around a position that the ego has to reach."""

_MAX_LENGTH: Final = 10_000
_MAX_DEPTH: Final = 50
_MAX_NUMBER: Final = 1e6
_MIRRORED_RELATIONS: Final[dict[str, Relation]] = {"<": ">", "<=": ">=", ">": "<", ">=": "<="}
# Operators of two and more operands, from the one that binds least.
_CONNECTIVES: Final[tuple[Operator, ...]] = ("->", "or", "and")
_OPERATORS: Final = ("not", "and", "or", "always", "eventually", "until")
_STATEMENTS: Final = ("collision", "no collision", "reference:NAME", "reach", "drive", "ego leaves its lane")
_ANY_CASE: Final = ("no", "collision", "at", "fault", "with", "unless")
# Operators of other languages, and what to write instead.
_FOREIGN_OPERATORS: Final = {
    "&&": "and", "||": "or", "=>": "->", "==": "<= or >=", "!=": "< or >", "&": "and", "|": "or", "!": "not",
    "=": "<= or >=", "≤": "<=", "≥": ">=", "□": "always", "◇": "eventually", "→": "->", "−": "-", "–": "-",
}  # fmt: skip
_OPTION: Final = r"[A-Za-z_]\w*=[^\s()\[\]<>,]+"
_NAME: Final = rf"[A-Za-z_]\w*(?:[-.][A-Za-z_]\w*)*(?::{_OPTION}(?:,{_OPTION})*)?"
_NUMBER: Final = r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
_UNIT: Final = r"(?!(?:and|or|until|within)(?!\w))[A-Za-z°%][\w/^²°]*"
_QUOTED_NAME: Final = r'"(?:[^"\\]|\\.)*"'
_DRIVER_NAME: Final = r'[A-Za-z_][^\s()\[\]<>":]*(?:\s*:\s*[^\s()\[\]<>":]+)*'
_DRIVER_COLLIDES: Final = r"(?:[Rr][Ee][Ff][Ee][Rr][Ee][Nn][Cc][Ee]:)?\S+\s+[Cc][Oo][Ll][Ll][Ii][Dd][Ee][Ss](?!\w)"
# Characters shown before and after the marked position.
_SHOWN_BEFORE, _SHOWN_AFTER = 50, 30


def parse_expression(text: str, language: Language = "formula") -> Node:
    """Parse an expression. ExpressionError marks the position of an error and says what to write there.

    In a condition, a bound on a metric refers to the score, unless the bound is inside a temporal operator.
    """
    return _Parser(text, language).parse_whole()


class _Number(NamedTuple):
    """Number and unit as written; they are converted once the signal on the other side of the comparison is known."""

    value: float
    text: str
    unit: str
    unit_position: int


class _Parser:
    """Recursive-descent parser, from the operator with the lowest precedence, `->`, down to bounds and statements."""

    def __init__(self, text: str, language: Language) -> None:
        self.text, self.language, self.depth = text, language, 0
        self.position = len(text) - len(text.lstrip())
        self.bound_positions: dict[int, int] = {}

    def parse_whole(self) -> Node:
        if len(self.text) > _MAX_LENGTH:
            self.position = _MAX_LENGTH
            self.fail(f"it has {len(self.text)} characters; give {_MAX_LENGTH} at most.")
        if self.position == len(self.text):
            self.fail("give a bound such as ttc > 1.5, or a statement such as 'no collision'.")
        root = self.parse_binary_operators(0)
        if self.position < len(self.text):
            self._fail_on_remaining_text()
        return self._compare_scores(root) if self.language == "condition" else root

    def parse_binary_operators(self, level: int) -> Node:
        if level == len(_CONNECTIVES):
            return self.parse_until()
        operator = _CONNECTIVES[level]
        parts = [self.parse_binary_operators(level + 1)]
        while self.take("->") if operator == "->" else self.word(operator):
            parts.append(self.parse_binary_operators(level + 1))
        if operator != "->":
            return self._operation(operator, *parts) if len(parts) > 1 else parts[0]
        node = parts.pop()
        while parts:
            node = self._operation(operator, parts.pop(), node)
        return node

    def parse_until(self) -> Node:
        left = self.parse_unary()
        if not self.word("until"):
            return left
        interval = self.parse_interval()
        node = self._operation("until", left, self.parse_unary(), interval=interval)
        if self.peek(_NAME) == "until":
            self.fail("two until in a row are ambiguous; put one of them in brackets.")
        return node

    def parse_unary(self, is_operand: bool = False) -> Node:
        name, has_bracket = self.peek(_NAME), self.peek(r"\(")
        is_operator = name in ("not", "always", "eventually")
        # A bracket right behind an operator is not one more level of nesting.
        levels = int(is_operator or bool(has_bracket and not is_operand))
        self.depth += levels
        self._check_depth(self.depth)
        if is_operator:
            self.take(_NAME)
            interval = None if name == "not" else self.parse_interval()
            node: Node = self._operation(cast(Operator, name), self.parse_unary(is_operand=True), interval=interval)
        elif self.take(r"\("):
            node = self.parse_binary_operators(0)
            if not self.take(r"\)"):
                if self.position < len(self.text):
                    self._fail_on_remaining_text()
                self.fail("give a closing bracket ')'.")
        else:
            node = self.parse_statement()
        self.depth -= levels
        return node

    def parse_interval(self) -> tuple[float, float] | None:
        opening = self.position
        if not self.take(r"\["):
            return None
        begin = self._parse_time("the begin of the interval in s, as in [0:5]")
        self.expect("[:,]", "':' and the end of the interval, as in [0:5]")
        end = np.inf if self.peek(r"\]") else self._parse_time("the end of the interval in s, as in [0:5]")
        self.expect(r"\]", "']', the end of the interval")
        if end < begin:
            self.fail(f"the interval ends at {end:g} s, before it begins at {begin:g} s.", opening)
        return begin, end

    def parse_statement(self) -> Node:
        begin = self.position
        # A metric may have the name of a statement.
        if not self.peek(_NAME) or self.peek(rf"(?:{_NAME}|lateral\s+acceleration)\s*[<>]"):
            return self.parse_bound()
        if self.word("no"):
            if not self.word("collision"):
                self.fail("give collision, as in 'no collision' and 'no collision with NAME'.")
            collision = self.parse_collision()
            if not self.word("unless"):
                return self._operation("no", collision)
            driver = self.expect(_DRIVER_COLLIDES, "a driver, as in 'no collision unless cc-human collides'").split()[0]
            name = driver[len("reference:") :] if driver.lower().startswith("reference:") else driver
            return self._operation("unless", collision, ReferenceCollides(name))
        if self.word("collision"):
            return self.parse_collision()
        if self.word("reference"):
            self.expect(":", "a colon and the name of a driver, as in reference:cc-human")
            driver = self.expect(_DRIVER_NAME, "the name of a driver, as in reference:cc-human")
            return ReferenceCollides(re.sub(r"\s*:\s*", ":", driver))
        if self.word("reach"):
            return self.parse_position(begin)
        if self.word("drive"):
            distance = self._parse_quantity("m", "a distance, as in drive 30")
            if not 0.0 < distance <= _MAX_NUMBER:
                self.fail("give a distance above 0 and at most 1000 km.", begin)
            return EgoDrives(distance)
        if self.word("ego"):
            for what in ("lane", "road"):
                leaves = EgoLeaves(what)
                if self.take(rf"leaves\s+(?:its|the)\s+{what}(?!\w)"):
                    return leaves
                if self.take(rf"stays\s+(?:in|on)\s+(?:its|the)\s+{what}(?!\w)"):
                    return self._operation("not", leaves)
            self.fail("give 'ego leaves its lane', 'ego stays on the road', or a signal, such as ego.speed.", begin)
        return self.parse_bound()

    def parse_collision(self) -> EgoCollides:
        """Parse what follows the word ``collision``."""
        at_fault = self.word("at")
        if at_fault and not self.word("fault"):
            self.fail("give fault, as in 'collision at fault'.")
        if not self.word("with"):
            return EgoCollides("", at_fault)
        begin, quoted = self.position, self.take(_QUOTED_NAME)
        if quoted is None:
            expected = "the name of an entity, in quotation marks if it contains brackets or an operator"
            return EgoCollides(" ".join(self.expect(ENTITY_NAME, expected).split()), at_fault)
        try:
            return EgoCollides(str(parse_json(quoted)), at_fault)
        except ValueError:
            self.fail("write the name in quotation marks as in JSON.", begin)

    def parse_position(self, begin: int) -> EgoReaches:
        """Parse what follows the word ``reach``; the word itself is at `begin`."""
        form = "a position and time, as in 'reach X,Y[,R] within T', in m and s"
        values = [self._parse_quantity("m", form)]
        while len(values) < 3 and self.take(","):
            values.append(self._parse_quantity("m", form))
        if len(values) < 2 or not self.word("within"):
            self.fail(f"give {form}.")
        x, y, radius = (*values, DEFAULT_RADIUS)[:3]
        within = self._parse_quantity("s", form)
        if not (0.0 < radius <= _MAX_NUMBER and 0.0 < within <= _MAX_NUMBER and max(abs(x), abs(y)) <= _MAX_NUMBER):
            self.fail("give a position within 1000 km, and a positive radius and time.", begin)
        return EgoReaches(x, y, radius, within)

    def parse_bound(self) -> Bound:
        begin, left = self.position, self.parse_term()
        subject = self.text[begin : self.position].strip()
        relation = cast(Relation, self.expect("<=|>=|<|>", f"a comparison of '{subject}': <=, >=, <, >"))
        right_begin, right = self.position, self.parse_term()
        if self.peek("[<>]"):
            self.fail("compare two values at a time, as in 1 < ttc and ttc < 5.")
        if not isinstance(left, Signal):
            left, relation, right = right, _MIRRORED_RELATIONS[relation], left
        if not isinstance(left, Signal):
            self.fail("two numbers are compared; name a signal, such as ego.speed.", begin)
        if not isinstance(right, Signal):
            value = self._convert(right, left.unit, left.text, may_be_operator=True)
            bound = Bound(left, relation, value, f"{right.text} {normalize_unit(right.unit)}".rstrip())
        elif normalize_unit(right.unit) == normalize_unit(left.unit):
            bound = Bound(left, relation, right)
        else:
            units = f"'{left.text}' in {left.unit} is compared with '{right.text}' in {right.unit}"
            self.fail(f"{units}; compare signals of one unit.", right_begin)
        self.bound_positions[id(bound)] = begin
        return bound

    def parse_term(self) -> Signal | _Number:
        if self.peek(_NUMBER):
            return self._parse_number()
        if self.take(r"abs\s*\("):
            signal = self.parse_signal()
            self.expect(r"\)", "a closing bracket ')'; abs takes one signal")
            return Signal(signal.name, signal.unit, absolute=True)
        if self.take(r"score\s*\("):
            begin, signal = self.position, self.parse_signal()
            if not signal.metric:
                self.fail(f"only a metric has a score, not {signal.name}.", begin)
            self.expect(r"\)", "a closing bracket ')'; score takes one metric")
            return Signal(f"{SCORE_PREFIX}{signal.name})", signal.unit)
        return self.parse_signal()

    def parse_signal(self) -> Signal:
        if self.take(r"lateral\s+acceleration(?!\w)"):
            return Signal(LATERAL_ACCELERATION, signal_unit(LATERAL_ACCELERATION), absolute=True)
        name = self.peek(_NAME)
        if name is None or name in (*_OPERATORS, "abs"):
            self.fail("give a signal, such as ttc or ego.speed, or a number.")
        if not has_signal(name):
            suggestion = suggest_name(name.partition(":")[0], [*_STATEMENTS, *signal_names()])
            operator = _suggest_operator(name) if name.isalpha() and "known are" in suggestion else ""
            if not operator and "known are" in suggestion:
                suggestion = f"add a metric of your own with METRICS.register first; {suggestion}"
            self.fail(f"there is no signal '{name}'; {operator or suggestion}")
        try:
            signal = Signal(name, signal_unit(name))
        except InputError as error:
            self.fail(str(error))
        self.take(_NAME)
        return signal

    def peek(self, pattern: str) -> str | None:
        """Return the text that matches a pattern at the current position; None if there is no match."""
        match = re.compile(pattern).match(self.text, self.position)
        return None if match is None else match[0]

    def take(self, pattern: str) -> str | None:
        """Return the text that matches a pattern at the current position, and move past it and the following spaces."""
        taken = self.peek(pattern)
        if taken is not None:
            self.position = len(self.text) - len(self.text[self.position + len(taken) :].lstrip())
        return taken

    def word(self, word: str) -> bool:
        """Move past `word` if it is next; return whether it was."""
        name = self.peek(_NAME) or ""
        is_next = name == word or (word in _ANY_CASE and name.lower() == word)
        return is_next and self.take(_NAME) is not None

    def expect(self, pattern: str, expected: str) -> str:
        """Move past the text that matches a pattern, or raise an error that names what was `expected`."""
        match = self.take(pattern)
        if match is None:
            self.fail(f"give {expected}.")
        return match

    def fail(self, message: str, position: int | None = None) -> NoReturn:
        """Raise an error at a position, by default the current one; `message` says what is wrong and what to do."""
        if position is None:
            position, rest = self.position, self.text[self.position :]
            foreign = next((operator for operator in _FOREIGN_OPERATORS if rest.startswith(operator)), None)
            if foreign is not None:
                message = f"write '{_FOREIGN_OPERATORS[foreign]}' instead of '{foreign}'."
            elif rest and not re.match(r"[\w°%()\[\],:.<>+\"-]", rest, re.ASCII):
                message = f"{_describe_character(rest[0])} has no meaning here."
        raise ExpressionError(f"The {self.language} cannot be read: {message}", _mark_position(self.text, position))

    def _parse_number(self) -> _Number:
        begin, text = self.position, str(self.take(_NUMBER))
        value = float(text)
        if not np.isfinite(value):
            self.fail("the number is too large.", begin)
        unit_begin = self.position
        return _Number(value, text.removeprefix("+"), self.take(_UNIT) or "", unit_begin)

    def _parse_quantity(self, unit: str, expected: str) -> float:
        """Parse a number with or without a unit, and convert it to `unit`."""
        if not self.peek(_NUMBER):
            self.fail(f"give {expected}.")
        return self._convert(self._parse_number(), unit, "this number")

    def _parse_time(self, expected: str) -> float:
        begin, value = self.position, self._parse_quantity("s", expected)
        if value < 0.0:
            self.fail("intervals begin at 0 s or later, as they look ahead.", begin)
        return value

    def _convert(self, number: _Number, unit: str, subject: str, *, may_be_operator: bool = False) -> float:
        try:
            return convert_to_unit(number.value, number.unit, unit)
        except InputError as error:
            # The word behind a number may be a misspelt operator instead of a unit.
            hint = _suggest_operator(number.unit) if may_be_operator and not is_known_unit(number.unit) else ""
            self.fail(hint or f"{subject} is in {unit}: {error}", number.unit_position)

    def _operation(self, operator: Operator, *operands: Node, interval: tuple[float, float] | None = None) -> Operation:
        operation = Operation(operator, operands, interval)
        self._check_depth(operation.depth)
        return operation

    def _compare_scores(self, node: Node) -> Node:
        """Return a condition in which metrics outside of temporal operators are replaced by their scores."""
        if isinstance(node, Operation):
            if node.operator in TEMPORAL:
                return node
            return Operation(node.operator, tuple(map(self._compare_scores, node.operands)))
        if not isinstance(node, Bound) or all(signal.is_score for signal in node.signals):
            return node
        signal = node.left
        if signal.absolute or not signal.metric or isinstance(node.right, Signal):
            text = format_node(node)
            self.fail(
                "compare the score of a metric with a number, as in ttc < 1, or say when this holds, as in"
                f" always({text}) or eventually({text}).",
                self.bound_positions[id(node)],
            )
        return replace(node, left=Signal(f"{SCORE_PREFIX}{signal.name})", signal.unit))

    def _check_depth(self, depth: int) -> None:
        if depth > _MAX_DEPTH:
            self.fail(f"brackets and operators are nested more than {_MAX_DEPTH} deep.", self.position)

    def _fail_on_remaining_text(self) -> NoReturn:
        if self.peek(r"\)"):
            self.fail("this bracket has no opening bracket; remove it.")
        name = self.peek(_NAME) or ""
        hint = "" if name in (*_OPERATORS, "abs") else _suggest_operator(name)
        self.fail(hint or f"go on with and, or, -> or until, or end the {self.language} here.")


def _suggest_operator(name: str) -> str:
    """Return a sentence that suggests an operator for a misspelt word; empty if none is similar."""
    sentence = suggest_name(name.lower(), _OPERATORS)
    return sentence if sentence.startswith("did") else ""


def _mark_position(text: str, position: int) -> str:
    """Return the text around a position in one line, with a caret below the position."""
    from rich.cells import cell_len

    begin, end = max(0, position - _SHOWN_BEFORE), position + _SHOWN_AFTER
    before, after = (
        escape_control_characters(re.sub(r"\s", " ", part)) for part in (text[begin:position], text[position:end])
    )
    before = f"{'…' if begin else ''}{before}"
    return f"    {before}{after}{'…' if end < len(text) else ''}\n    {' ' * cell_len(before)}^"


def _describe_character(character: str) -> str:
    shown = f"'{escape_control_characters(character)}'"
    return shown if character.isascii() else f"{shown} ({unicodedata.name(character, f'U+{ord(character):04X}')})"
