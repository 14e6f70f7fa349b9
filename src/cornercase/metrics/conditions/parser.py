"""Reads conditions."""

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
    """Read a condition.

    Parameters
    ----------
    text : str

    Returns
    -------
    Collision, ReferenceCollides, ScoreBound or Connected

    Raises
    ------
    InputError
        It is none; the message names the place and what helps.
    """
    if len(text) > _LONGEST:
        raise InputError(f"The condition '{text[:60]}…' has {len(text)} characters; give {_LONGEST} at most.")
    words = Words(text, "condition")
    if words.ended:
        words.expected(_EXAMPLE)
    found = _either(words, 0)
    if not words.ended:
        words.refuse("give and, or, or the end of the condition.")
    return found


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
    word = words.next
    if words.take_if(_COLLISION):
        return Collision()
    if words.take_if(_REFERENCE):
        if not words.take_if(":"):
            words.expected("a colon and the name of a driver, as in reference:cc-human")
        return ReferenceCollides(_driver(words))
    if word.kind not in ("name", "number"):
        words.expected(_EXAMPLE)
    if word.kind == "name":
        base = word.text.partition(":")[0]
        if base in ("always", "eventually", "until"):
            words.refuse("a condition is of a whole run; give a formula to the metric stl instead.")
        # What is misspelt may be a word of conditions as well as a metric.
        if base != "abs" and base not in metric_names():
            if "." in base or base == "time":
                words.refuse(f"a condition takes scores of metrics, not '{base}'.")
            words.refuse(
                f"there is no '{word.text}'; {suggestion(base, [_COLLISION, 'reference:NAME', *metric_names()])}"
            )
    return _bound(words)


def _bound(words: Words) -> ScoreBound:
    place = words.next
    found = read_comparison(words)
    name, bound = found.left.name, found.right
    if found.left.absolute or not is_metric(name) or not isinstance(bound, Bound):
        words.refuse("compare the score of a metric with a number, as in ttc < 1.", place)
    return ScoreBound(name, found.relation, bound.value, found.text)


def _driver(words: Words) -> str:
    """Name of a driver: a registered one or ``package.module:Class``, either with options."""
    first = words.next
    if first.kind != "name":
        words.expected("the name of a driver, as in reference:cc-human")
    words.take()
    # A colon without options behind it, which would belong to the name, is that of a class of one's own.
    if not words.take_if(":"):
        return first.text
    second = words.next
    if second.kind != "name":
        words.expected("the name of a class, as in reference:package.module:Class")
    words.take()
    return f"{first.text}:{second.text}"
