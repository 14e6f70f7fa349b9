"""Rules that end an exploration."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

from cornercase._common.errors import InputError
from cornercase._common.validation import check_float, check_int, repr_short
from cornercase.evidence._critical_set_estimate import DEFAULT_CONFIDENCE, MIN_REGION_FRACTION, CriticalSet

_CRITERION_PATTERN = re.compile(r"(?P<what>[a-z-]+)(?:\((?P<argument>[^()]*)\))?<(?P<below>.+)")

_LIMIT_PATTERN = re.compile(r"(?P<name>max_seconds|patience)=(?P<value>.+)")

_SIZED_QUANTITIES = ("overlooked", "unvisited")
_QUANTITIES = ("missed", "interval", "audited-missed", *_SIZED_QUANTITIES)


class StopRule:
    """Rule that says when an exploration ends; the functions of `cornercase.stop` make rules.

    The `repr` of a rule is an expression that makes the rule again. The `str` of a rule is a text that is accepted in
    place of the rule. Rules are compared by value. Several rules are given as a sequence. A rule of `seconds` or
    `no_improvement` ends the exploration alone; all other rules of the sequence must hold at the same time.

    Rules of your own classes are not accepted. To end an exploration by another rule, call `explore` in a loop with a
    growing `budget`, and end the loop yourself.

    Examples
    --------
    >>> from cornercase import stop
    >>> str(stop.missed(0.05)), stop.overlooked(0.05, size=0.02), stop.seconds(60) == stop.seconds(60.0)
    ('missed<0.05', overlooked(0.05, size=0.02), True)
    """


@dataclass(frozen=True, repr=False)
class StopCriterion(StopRule):
    """Stop rule that holds when a quantity of a `CriticalSet`, such as ``"missed"``, is below `bound`.

    `size`, for ``"overlooked"`` and ``"unvisited"``, is the size of the regions considered, as a fraction of the space.
    `confidence`, for ``"missed"``, is the probability that less than `bound` is missed. Raises `InputError` unless all
    numbers are above 0 and at most 1.
    """

    quantity: str
    bound: float
    size: float = MIN_REGION_FRACTION
    confidence: float = DEFAULT_CONFIDENCE

    def __post_init__(self) -> None:
        for name in ("bound", "size", "confidence"):
            object.__setattr__(self, name, _check_fraction(getattr(self, name), f"`{name}`:"))

    @classmethod
    def parse(cls, text: str) -> StopCriterion:
        """Parse a criterion such as ``missed<0.01``, ``missed(0.7)<0.01`` or ``overlooked(0.02)<0.05``."""
        match = _CRITERION_PATTERN.fullmatch(text.replace(" ", ""))
        if match is None or match["what"] not in _QUANTITIES:
            raise InputError(
                f"`stop_when` {text}: write it as missed<0.01, missed(0.7)<0.01, interval<0.05, overlooked(0.01)<0.05,"
                " unvisited(0.01)<0.05, audited-missed<0.1, max_seconds=60 or patience=5, in quotes."
            )
        named, argument = f"`stop_when` {text}:", {}
        if match["argument"] is not None:
            if match["what"] not in ("missed", *_SIZED_QUANTITIES):
                raise InputError(
                    f"{named} '{match['what']}' takes no number in brackets; only missed(PROBABILITY), overlooked(SIZE)"
                    " and unvisited(SIZE) take one."
                )
            name = "confidence" if match["what"] == "missed" else "size"
            argument = {name: _check_fraction(match["argument"], named)}
        return cls(match["what"], _check_fraction(match["below"], named), **argument)

    def __str__(self) -> str:
        argument = f"({self.size})" if self.quantity in _SIZED_QUANTITIES else ""
        if self.confidence != DEFAULT_CONFIDENCE:
            argument = f"({self.confidence})"
        return f"{self.quantity}{argument}<{self.bound}"

    def __repr__(self) -> str:
        argument = "" if self.size == MIN_REGION_FRACTION else f", size={self.size}"
        if self.confidence != DEFAULT_CONFIDENCE:
            argument = f", confidence={self.confidence}"
        return f"{self.quantity.replace('-', '_')}({self.bound}{argument})"

    def evaluate(self, critical_set: CriticalSet) -> float:
        """Return the value of the quantity, from 0 to 1; 1 if the value is unknown."""
        if self.quantity == "missed":
            return critical_set.missed_upper_bound(self.confidence)
        if self.quantity == "audited-missed":
            return critical_set.audited_missed_upper_bound
        if self.quantity == "interval":
            return (
                1.0
                if critical_set.interval_unavailable
                else critical_set.critical_fraction.high - critical_set.critical_fraction.low
            )
        return (
            critical_set.p_overlooked_region(self.size)
            if self.quantity == "overlooked"
            else critical_set.unexplored_fraction(self.size)
        )

    def describe_value(self, value: float) -> str:
        """Describe a value of the quantity, as in ``"the critical share is known within 3.00%"``."""
        if self.quantity == "missed":
            probability = (
                "" if self.confidence == DEFAULT_CONFIDENCE else f"with a probability of {self.confidence:g}, "
            )
            return f"{probability}at most {value:.2%} of the critical set is missed"
        if self.quantity == "audited-missed":
            return f"according to the audits, at most {value:.2%} of the critical set is missed"
        if self.quantity == "interval":
            return f"the critical share is known within {value:.2%}"
        if self.quantity == "unvisited":
            return f"in {value:.2%} of the space, no scenario was run within a region of {self.size:.2%}"
        return f"with a probability of {value:.2%} a critical region of {self.size:.2%} or more was overlooked"


@dataclass(frozen=True, repr=False)
class TimeLimit(StopRule):
    """Stop rule by which no new round of scenarios starts after an exploration has run for `seconds` s."""

    seconds: float

    def __str__(self) -> str:
        return f"max_seconds={repr(self.seconds).removesuffix('.0')}"

    def __repr__(self) -> str:
        return f"seconds({repr(self.seconds).removesuffix('.0')})"


@dataclass(frozen=True, repr=False)
class NoImprovement(StopRule):
    """Stop rule that ends an exploration after `rounds` rounds in a row without an improvement.

    An improvement is a score at least as critical as the best so far. The least critical score (cap) is an improvement
    only the first time. In an exploration without rounds, `batch` scenarios count as a round.
    """

    rounds: int

    def __str__(self) -> str:
        return f"patience={self.rounds}"

    def __repr__(self) -> str:
        return f"no_improvement(rounds={self.rounds})"


def missed(bound: float, confidence: float = DEFAULT_CONFIDENCE) -> StopRule:
    """Stop when less than `bound` of the critical set (all critical scenarios of the space) is missed.

    Parameters
    ----------
    bound : float
        Above 0, up to 1. The bound is compared with an upper limit of the missed fraction of the critical set. This
        limit includes the chance that one more critical region exists at which no score hints.
    confidence : float, default 0.95
        Probability that no more than the upper limit is missed, above 0 and up to 1. With a lower value, a search ends
        earlier, and more often too early.

    Returns
    -------
    StopRule

    Raises
    ------
    InputError
        `bound` or `confidence` is not above 0 and up to 1.

    Examples
    --------
    >>> from cornercase import stop
    >>> stop.missed(0.05)
    missed(0.05)
    >>> str(stop.missed(0.05, confidence=0.7))
    'missed(0.7)<0.05'
    """
    return StopCriterion("missed", bound, confidence=confidence)


def interval(bound: float) -> StopRule:
    """Stop when the critical fraction of the space is known accurately enough.

    Parameters
    ----------
    bound : float
        Above 0, up to 1. The bound is compared with the width of the 90 % interval of the critical fraction.

    Returns
    -------
    StopRule

    Raises
    ------
    InputError
        `bound` is not above 0 and up to 1.

    Examples
    --------
    >>> import cornercase as cc
    >>> rule = cc.stop.interval(0.1)
    >>> rule
    interval(0.1)
    >>> study.explore(stop=rule, budget=1000)  # doctest: +SKIP
    """
    return StopCriterion("interval", bound)


def overlooked(bound: float, size: float = MIN_REGION_FRACTION) -> StopRule:
    """Stop when it is improbable that a critical region contains no scenario that was run.

    Parameters
    ----------
    bound : float
        Above 0, up to 1. The bound is compared with the probability that such a region exists.
    size : float, default 0.01
        Smallest region that counts, as a fraction of the space.

    Returns
    -------
    StopRule

    Raises
    ------
    InputError
        `bound` or `size` is not above 0 and up to 1.

    Examples
    --------
    >>> import cornercase as cc
    >>> rule = cc.stop.overlooked(0.05)
    >>> rule
    overlooked(0.05)
    >>> study.explore(stop=rule, budget=1000)  # doctest: +SKIP
    """
    return StopCriterion("overlooked", bound, size)


def unvisited(bound: float, size: float = MIN_REGION_FRACTION) -> StopRule:
    """Stop when scenarios were run near almost every point of the space.

    Parameters
    ----------
    bound : float
        Above 0, up to 1. The bound is compared with the fraction of points in whose surroundings no scenario was run.
    size : float, default 0.01
        Size of the surroundings of a point, as a fraction of the space.

    Returns
    -------
    StopRule

    Raises
    ------
    InputError
        `bound` or `size` is not above 0 and up to 1.

    Examples
    --------
    >>> import cornercase as cc
    >>> rule = cc.stop.unvisited(0.02)
    >>> rule
    unvisited(0.02)
    >>> study.explore(stop=rule, budget=1000)  # doctest: +SKIP
    """
    return StopCriterion("unvisited", bound, size)


def audited_missed(bound: float) -> StopRule:
    """Stop when audits (scenarios drawn at random as a check) show that little of the critical set is missed.

    Parameters
    ----------
    bound : float
        Above 0, up to 1. The bound is compared with an upper limit of the missed fraction of the critical set. This
        limit is computed from audits, so the exploration needs audits.

    Returns
    -------
    StopRule

    Raises
    ------
    InputError
        `bound` is not above 0 and up to 1.

    Examples
    --------
    >>> import cornercase as cc
    >>> rule = cc.stop.audited_missed(0.1)
    >>> rule
    audited_missed(0.1)
    >>> study.explore(stop=rule, budget=1000, audit=0.1)  # doctest: +SKIP
    """
    return StopCriterion("audited-missed", bound)


def seconds(limit: float) -> StopRule:
    """Stop after a time; the round that is running ends first.

    Parameters
    ----------
    limit : float
        Time in s.

    Returns
    -------
    StopRule

    Raises
    ------
    InputError
        `limit` is negative or not finite.

    Examples
    --------
    >>> import cornercase as cc
    >>> rule = cc.stop.seconds(600.0)
    >>> rule
    seconds(600)
    >>> study.explore(stop=rule, budget=1000)  # doctest: +SKIP
    """
    return TimeLimit(check_float("seconds", limit, minimum=0.0))


def no_improvement(rounds: int) -> StopRule:
    """Stop after several rounds in a row in which no score is at least as critical as the best score so far.

    Parameters
    ----------
    rounds : int
        Number of rounds in a row. In an exploration without rounds, `batch` scenarios count as a round.

    Returns
    -------
    StopRule

    Raises
    ------
    InputError
        `rounds` is below 1.

    Examples
    --------
    >>> import cornercase as cc
    >>> rule = cc.stop.no_improvement(20)
    >>> rule
    no_improvement(rounds=20)
    >>> study.explore(stop=rule, budget=1000)  # doctest: +SKIP
    """
    return NoImprovement(check_int("rounds", rounds, 1))


def resolve_stop_rules(rules: object) -> tuple[list[StopCriterion], float | None, int | None]:
    """Split rules into criteria that must all hold, a time limit in s, and a number of rounds without improvement.

    A rule may be given as text. Of several time limits, the smallest counts; likewise of several numbers of rounds. A
    limit or number that no rule sets is None. Raises `InputError` for a value that is not a rule.
    """
    given_rules = rules if isinstance(rules, Sequence) and not isinstance(rules, str) else [rules]
    resolved = [_parse_rule(rule) if isinstance(rule, str) else rule for rule in given_rules]
    for rule in resolved:
        if not isinstance(rule, StopCriterion | TimeLimit | NoImprovement):
            raise InputError(
                f"`stop_when` {repr_short(rule)}: give a rule of cornercase.stop, such as stop.missed(0.05), or its"
                " text; rules of your own are not possible, so call `explore` in a loop with a growing `budget`, and"
                " end the loop yourself."
            )
    time_limit = min((rule.seconds for rule in resolved if isinstance(rule, TimeLimit)), default=None)
    rounds = min((rule.rounds for rule in resolved if isinstance(rule, NoImprovement)), default=None)
    return [rule for rule in resolved if isinstance(rule, StopCriterion)], time_limit, rounds


def _parse_rule(text: str) -> StopRule:
    """Parse a stop rule given as text, such as ``missed<0.01``, ``max_seconds=60`` or ``patience=5``."""
    match = _LIMIT_PATTERN.fullmatch(text.replace(" ", ""))
    if match is None:
        return StopCriterion.parse(text)
    try:
        number = float(match["value"])
    except ValueError:
        raise InputError(f"`stop_when` {text}: '{match['value']}' has to be a number.") from None
    if match["name"] == "max_seconds":
        return TimeLimit(check_float("max_seconds", number, minimum=0.0))
    return NoImprovement(check_int("patience", int(number) if number.is_integer() else number, 1))


def _check_fraction(value: object, name: str) -> float:
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        number = inf
    if not 0.0 < number <= 1.0:
        shown = f"'{value}'" if isinstance(value, str) else repr_short(value)
        raise InputError(f"{name} {shown} has to be a number above 0 and up to 1.")
    return number
