"""Parser of conditions."""

from __future__ import annotations

from typing import Final

from cornercase._common.errors import InputError, suggest_name
from cornercase.metrics.formulas._ast import Constant
from cornercase.metrics.formulas._condition_ast import (
    Collision,
    Condition,
    LogicalOperation,
    ReferenceCollides,
    ScoreComparison,
)
from cornercase.metrics.formulas._formula_parser import parse_comparison
from cornercase.metrics.formulas._lexer import Lexer
from cornercase.metrics.formulas._signals import is_metric_signal, signal_metric_names

_COLLISION: Final = "collision"
_REFERENCE: Final = "reference"
_MAX_LENGTH: Final = 1000
_MAX_DEPTH: Final = 50
_EXAMPLE: Final = "'collision', 'reference:NAME', or a bound such as 'ttc < 1'"


def parse_condition(text: str) -> Condition:
    """Parse a condition. InputError names the position of the fault and what to write there."""
    if len(text) > _MAX_LENGTH:
        raise InputError(f"The condition '{text[:60]}…' has {len(text)} characters; give {_MAX_LENGTH} at most.")
    lexer = Lexer(text, "condition")
    if lexer.is_at_end:
        lexer.raise_expected(_EXAMPLE)
    condition = _parse_or(lexer, 0)
    if not lexer.is_at_end:
        lexer.raise_error("give and, or, or the end of the condition.")
    return condition


def _parse_or(lexer: Lexer, depth: int) -> Condition:
    parts = [_parse_and(lexer, depth)]
    while lexer.read_if("or"):
        parts.append(_parse_and(lexer, depth))
    return LogicalOperation("or", tuple(parts)) if len(parts) > 1 else parts[0]


def _parse_and(lexer: Lexer, depth: int) -> Condition:
    parts = [_parse_not_or_brackets(lexer, depth)]
    while lexer.read_if("and"):
        parts.append(_parse_not_or_brackets(lexer, depth))
    return LogicalOperation("and", tuple(parts)) if len(parts) > 1 else parts[0]


def _parse_not_or_brackets(lexer: Lexer, depth: int) -> Condition:
    if depth > _MAX_DEPTH:
        lexer.raise_error(f"brackets and not are nested more than {_MAX_DEPTH} deep.")
    if lexer.read_if("not"):
        return LogicalOperation("not", (_parse_not_or_brackets(lexer, depth + 1),))
    if not lexer.read_if("("):
        return _parse_statement(lexer)
    inner = _parse_or(lexer, depth + 1)
    if not lexer.read_if(")"):
        lexer.raise_expected("a closing bracket ')'")
    return inner


def _parse_statement(lexer: Lexer) -> Condition:
    token = lexer.next_token
    if lexer.read_if(_COLLISION):
        return Collision()
    if lexer.read_if(_REFERENCE):
        if not lexer.read_if(":"):
            lexer.raise_expected("a colon and the name of a driver, as in reference:cc-human")
        return ReferenceCollides(_parse_driver_name(lexer))
    if token.kind not in ("name", "number"):
        lexer.raise_expected(_EXAMPLE)
    if token.kind == "name":
        base = token.text.partition(":")[0]
        if base in ("always", "eventually", "until"):
            lexer.raise_error("a condition applies to a whole run; give a formula to the metric stl instead.")
        # Suggest the keywords of conditions as well as metrics.
        if base != "abs" and base not in signal_metric_names():
            if "." in base or base == "time":
                lexer.raise_error(f"a condition takes scores of metrics, not '{base}'.")
            lexer.raise_error(
                f"there is no '{token.text}';"
                f" {suggest_name(base, [_COLLISION, 'reference:NAME', *signal_metric_names()])}"
            )
    return _parse_score_comparison(lexer)


def _parse_score_comparison(lexer: Lexer) -> ScoreComparison:
    start = lexer.next_token
    comparison = parse_comparison(lexer)
    name, bound = comparison.left.name, comparison.right
    if comparison.left.absolute or not is_metric_signal(name) or not isinstance(bound, Constant):
        lexer.raise_error("compare the score of a metric with a number, as in ttc < 1.", start)
    return ScoreComparison(name, comparison.relation, bound.value, comparison.text)


def _parse_driver_name(lexer: Lexer) -> str:
    """Parse the name of a driver: a registered one or ``package.module:Class``, either with options."""
    first = lexer.next_token
    if first.kind != "name":
        lexer.raise_expected("the name of a driver, as in reference:cc-human")
    lexer.read_token()
    # A colon followed by options is part of the name's token, so this one separates module and class.
    if not lexer.read_if(":"):
        return first.text
    second = lexer.next_token
    if second.kind != "name":
        lexer.raise_expected("the name of a class, as in reference:package.module:Class")
    lexer.read_token()
    return f"{first.text}:{second.text}"
