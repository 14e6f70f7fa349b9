"""Parser of conditions."""

from __future__ import annotations

from typing import Final

from cornercase._common.errors import InputError, suggestion
from cornercase.metrics.conditions.terms import Collision, Connected, Part, ReferenceCollides, ScoreBound
from cornercase.metrics.formulas.parser import read_comparison
from cornercase.metrics.formulas.signals import is_metric, metric_names
from cornercase.metrics.formulas.terms import Bound
from cornercase.metrics.formulas.words import Words

_COLLISION: Final = "collision"
_REFERENCE: Final = "reference"
_LONGEST: Final = 1000
_DEEPEST: Final = 50
_EXAMPLE: Final = "'collision', 'reference:NAME', or a bound such as 'ttc < 1'"


def parse(text: str) -> Part:
    """Parse a condition. InputError names the position of the fault and what to write there."""
    if len(text) > _LONGEST:
        raise InputError(f"The condition '{text[:60]}…' has {len(text)} characters; give {_LONGEST} at most.")
    lexer = Words(text, "condition")
    if lexer.ended:
        lexer.expected(_EXAMPLE)
    condition = _either(lexer, 0)
    if not lexer.ended:
        lexer.refuse("give and, or, or the end of the condition.")
    return condition


def _either(words: Words, depth: int) -> Part:
    parts = [_both(words, depth)]
    while words.take_if("or"):
        parts.append(_both(words, depth))
    return Connected("or", tuple(parts)) if len(parts) > 1 else parts[0]


def _both(words: Words, depth: int) -> Part:
    parts = [_one(words, depth)]
    while words.take_if("and"):
        parts.append(_one(words, depth))
    return Connected("and", tuple(parts)) if len(parts) > 1 else parts[0]


def _one(words: Words, depth: int) -> Part:
    if depth > _DEEPEST:
        words.refuse(f"brackets and not are nested more than {_DEEPEST} deep.")
    if words.take_if("not"):
        return Connected("not", (_one(words, depth + 1),))
    if not words.take_if("("):
        return _fact(words)
    inner = _either(words, depth + 1)
    if not words.take_if(")"):
        words.expected("a closing bracket ')'")
    return inner


def _fact(words: Words) -> Part:
    token = words.next
    if words.take_if(_COLLISION):
        return Collision()
    if words.take_if(_REFERENCE):
        if not words.take_if(":"):
            words.expected("a colon and the name of a driver, as in reference:cc-human")
        return ReferenceCollides(_driver(words))
    if token.kind not in ("name", "number"):
        words.expected(_EXAMPLE)
    if token.kind == "name":
        base = token.text.partition(":")[0]
        if base in ("always", "eventually", "until"):
            words.refuse("a condition applies to a whole run; give a formula to the metric stl instead.")
        # Suggest the keywords of conditions as well as metrics.
        if base != "abs" and base not in metric_names():
            if "." in base or base == "time":
                words.refuse(f"a condition takes scores of metrics, not '{base}'.")
            words.refuse(
                f"there is no '{token.text}'; {suggestion(base, [_COLLISION, 'reference:NAME', *metric_names()])}"
            )
    return _bound(words)


def _bound(words: Words) -> ScoreBound:
    start = words.next
    comparison = read_comparison(words)
    name, bound = comparison.left.name, comparison.right
    if comparison.left.absolute or not is_metric(name) or not isinstance(bound, Bound):
        words.refuse("compare the score of a metric with a number, as in ttc < 1.", start)
    return ScoreBound(name, comparison.relation, bound.value, comparison.text)


def _driver(words: Words) -> str:
    """Parse the name of a driver: a registered one or ``package.module:Class``, either with options."""
    first = words.next
    if first.kind != "name":
        words.expected("the name of a driver, as in reference:cc-human")
    words.take()
    # A colon followed by options is part of the name's token, so this one separates module and class.
    if not words.take_if(":"):
        return first.text
    second = words.next
    if second.kind != "name":
        words.expected("the name of a class, as in reference:package.module:Class")
    words.take()
    return f"{first.text}:{second.text}"
