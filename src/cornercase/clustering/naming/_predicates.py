"""Predicates: short statements about scenarios, each with the scenarios for which it is true."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cornercase._common.text.sanitize import quote_name
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.clustering.naming._feature_phrases import FEATURE_PHRASES
from cornercase.metrics._outcome import Impact, Outcome, PathRelation
from cornercase.scenario import Parameter, ParameterSpace, Value

# Bounds of impact speeds in m/s, of gaps in s, of decelerations in m/s², of turns in rad and of shifts in m.
_LOW_SPEED, _HIGH_SPEED = 5.0, 10.0
_SMALL_GAP, _LARGE_GAP = 1.5, 3.0
_NO_BRAKING, _SOFT_BRAKING, _HARD_BRAKING = 0.5, 3.0, 5.0
_TURN_ANGLE, _STRAIGHT_ANGLE, _LATERAL_SHIFT = math.pi / 4, math.pi / 9, 1.5

# Smallest bound of a feature in a name, in m, s, m/s or m/s²; smaller values are too small to see.
_SMALLEST_BOUND: Final = 0.1
FAULT: Final = "fault"
"""Value of `Predicate.quantity` for predicates that say who is at fault for a collision."""

# Digits that a bound may have in a name.
_BOUND_DIGITS: Final = (1, 2, 3)


@dataclass(frozen=True, eq=False)
class Predicate:
    """Short statement about scenarios, and the mask of the n scenarios for which it holds, shape (n,).

    The name of a cluster has at most one predicate of each `quantity`. For a fitted bound, `quantity` is the bounded
    quantity and the side of the bound. For a statement about who is at fault, `quantity` is `FAULT`. For all other
    statements, `quantity` is empty, and a name may have several of them.
    """

    text: str
    holds: BoolArray
    quantity: str = ""


@dataclass(frozen=True, eq=False)
class NamingFacts:
    """Facts about n scenarios from which names of clusters are made.

    `features` maps each feature to an array of shape (n,). `values` are the parameter values of each scenario.
    """

    outcomes: Sequence[Outcome]
    features: Mapping[str, FloatArray]
    space: ParameterSpace
    values: Sequence[Mapping[str, Value]]

    @classmethod
    def from_scenarios(
        cls,
        outcomes: Sequence[Outcome],
        features: Sequence[Mapping[str, float]],
        space: ParameterSpace,
        values: Sequence[Mapping[str, Value]],
    ) -> NamingFacts:
        """Collect the facts. `features` maps names of features to values, for each scenario."""
        columns = {name: np.array([row[name] for row in features], dtype=np.float64) for name in features[0]}
        return cls(outcomes, columns, space, values)


def describe_ending(outcome: Outcome) -> tuple[str, ...]:
    """Describe how a scenario ended for the ego: several true statements, the most specific first."""
    still = ("stands all the time",) if outcome.exists and not outcome.moves else ()
    return still + (_describe_impact(outcome.impacts[0]) if outcome.impacts else _describe_encounter(outcome))


def _describe_impact(impact: Impact) -> tuple[str, ...]:
    name = quote_name(impact.entity)
    specific = {
        "from behind": (f"runs into the rear of {name}",),
        "its rear": (f"is hit from behind by {name}",),
        "while it stands": (f"is hit by {name} while it stands",),
        "otherwise": (),
    }
    return (*specific[impact.shown_manner], f"collides with {name}")


def _describe_encounter(outcome: Outcome) -> tuple[str, ...]:
    encounter, name = outcome.encounter, quote_name(outcome.encounter.entity)
    if encounter.relation == "absent":
        return (f"is there without {name}" if outcome.exists else "is never there", f"does not meet {name}")
    if encounter.first is None:
        return (f"does not meet {name}",)
    if encounter.relation == "lane":
        if encounter.first == encounter.ahead:
            return (f"stays ahead of {name}" if encounter.first == outcome.ego else f"stays behind {name}",)
        return (f"overtakes {name}" if encounter.first == outcome.ego else f"is overtaken by {name}",)
    if encounter.first == outcome.ego:
        return (
            (f"passes while {name} waits", f"passes before {name}")
            if math.isnan(encounter.gap)
            else (f"passes before {name}",)
        )
    texts = []
    if outcome.waits:
        texts.append(f"stops for {name}")
    if outcome.yields:
        texts.append(f"yields to {name}")
    if not math.isnan(encounter.enters):
        texts.append(f"passes after {name}")
    return (*texts, f"comes after {name}")


def predicates_with_fixed_bounds(facts: NamingFacts) -> list[Predicate]:
    """Return predicates with fixed bounds on impact speed, gap, braking, stops, turns and other entities."""
    traits, outcomes = facts.features, facts.outcomes
    hit, gap, braking = traits["impact speed"], traits["gap"], traits["braking"]
    turn, shift, aside = traits["turn"], traits["shift"], traits["aside"]
    crosses = np.array([outcome.encounter.relation == "crossing" for outcome in outcomes])
    other = quote_name(outcomes[0].encounter.entity)
    straight = np.abs(turn) < _STRAIGHT_ANGLE
    stops, moves = (np.array([getattr(outcome, name) for outcome in outcomes]) for name in ("stops", "moves"))
    clauses = [
        Predicate("at low speed", hit < _LOW_SPEED),
        Predicate("at medium speed", (hit >= _LOW_SPEED) & (hit < _HIGH_SPEED)),
        Predicate("at high speed", hit >= _HIGH_SPEED),
        *_predicates_of_fault(outcomes),
        Predicate("closely", (gap >= 0.0) & (gap < _SMALL_GAP)),
        Predicate("clear", gap >= _LARGE_GAP),
        Predicate("after a stop", stops),
        Predicate("without a stop", moves & ~stops),
        Predicate("brakes hard", braking >= _HARD_BRAKING),
        Predicate("brakes softly", (braking >= _NO_BRAKING) & (braking < _SOFT_BRAKING)),
        Predicate("without braking", moves & (braking < _NO_BRAKING)),
        Predicate("moves to the left", straight & (shift > _LATERAL_SHIFT)),
        Predicate("moves to the right", straight & (shift < -_LATERAL_SHIFT)),
        Predicate("goes straight on", moves & straight & (np.abs(shift) <= _LATERAL_SHIFT)),
        Predicate("turns left", turn >= _TURN_ANGLE),
        Predicate("turns right", turn <= -_TURN_ANGLE),
        Predicate(f"{other} from the left", crosses & (aside > _LATERAL_SHIFT)),
        Predicate(f"{other} from the right", crosses & (aside < -_LATERAL_SHIFT)),
    ]
    texts_by_scenario = [tuple(_describe_other_entities(outcome)) for outcome in outcomes]
    texts = dict.fromkeys(text for scenario_texts in texts_by_scenario for text in scenario_texts)
    return clauses + [
        Predicate(text, np.array([text in scenario_texts for scenario_texts in texts_by_scenario])) for text in texts
    ]


def _predicates_of_fault(outcomes: Sequence[Outcome]) -> list[Predicate]:
    """Return predicates that say who is at fault for the ego's first collision."""
    texts = [
        outcome.fault.describe(outcome.ego, outcome.impacts[0].entity)
        if outcome.fault is not None and outcome.fault.who != "undecided"
        else ""
        for outcome in outcomes
    ]
    return [Predicate(text, np.array([own == text for own in texts]), FAULT) for text in sorted(set(texts) - {""})]


def _describe_other_entities(outcome: Outcome) -> Iterator[str]:
    for encounter in outcome.others:
        if encounter.first is not None:
            words = ("ahead of", "behind") if encounter.relation == "lane" else ("before", "after")
            yield f"{words[encounter.first != outcome.ego]} {quote_name(encounter.entity)}"
    for collision in outcome.other_collisions:
        yield f"{' and '.join(map(quote_name, collision.entities))} collide"
    # If ego and other collide, the ending does not say who was first.
    main: PathRelation = outcome.encounter
    if outcome.impacts and main.relation == "crossing":
        yield f"{quote_name(str(main.first))} first"


def predicates_with_fitted_bounds(
    facts: NamingFacts, is_member: BoolArray, min_members: int, is_rival: BoolArray
) -> list[tuple[int, Predicate]]:
    """Return pairs (rank, predicate) of predicates that separate the members of a cluster from rivals.

    Rivals are scenarios of other clusters for which the name of the cluster is also true. A predicate bounds a feature
    (rank 1), or selects a part of a parameter's range or one of its choices (rank 2). Bounds hold for at least
    `min_members` of the members.
    """
    other = quote_name(facts.outcomes[0].encounter.entity)
    clauses = [
        (1, clause)
        for name, texts in FEATURE_PHRASES.items()
        for clause in _fit_bounds(facts.features[name], texts, other, is_member, min_members, is_rival, _SMALLEST_BOUND)
    ]
    for parameter in facts.space.parameters:
        column_values = [parameter.extract_value(row) for row in facts.values]
        if parameter.choices:
            choices = np.array([str(value) for value in column_values])
            clauses += [
                (2, Predicate(_describe_choice(parameter, choice), choices == choice)) for choice in parameter.choices
            ]
        elif parameter.size != 1:
            unit = parameter.unit.replace("{", "{{").replace("}", "}}")
            texts = (f"{{other}} < {{}} {unit}".rstrip(), f"{{other}} > {{}} {unit}".rstrip())
            column = np.array(column_values, dtype=np.float64)
            clauses += [
                (2, clause)
                for clause in _fit_bounds(column, texts, quote_name(parameter.name), is_member, min_members, is_rival)
            ]
    return clauses


def _describe_choice(parameter: Parameter, choice: str) -> str:
    """Describe which choice a parameter has, as in "weather is rain".

    If a choice sets several parameters together, only the first parameter with a different value in each choice is
    described.
    """
    names, parts = parameter.name.split(", "), [choice_parts.split(", ") for choice_parts in parameter.choices]
    if len(names) > 1 and all(len(choice_parts) == len(names) for choice_parts in parts):
        for name, part, column in zip(names, choice.split(", "), zip(*parts, strict=True), strict=True):
            if len(set(column)) == len(column):
                return f"{quote_name(name)} is {quote_name(part)}"
    return f"{quote_name(parameter.name)} is {quote_name(choice)}"


def _fit_bounds(
    values: FloatArray,
    texts: tuple[str, str],
    quantity: str,
    is_member: BoolArray,
    min_members: int,
    is_rival: BoolArray,
    smallest_bound: float = -math.inf,
) -> Iterator[Predicate]:
    """Yield predicates that bound a quantity from above or below, between the members and the rivals of a cluster.

    Rivals are scenarios of other clusters for which the name of the cluster is also true. A bound holds for all members
    with a finite value, or for at least `min_members` of them, more only if their values are equal.
    """
    for sign, text in ((-1.0, texts[0]), (1.0, texts[1])):
        signed = sign * values
        own = np.sort(signed[is_member & np.isfinite(values)])
        for left_out in sorted({0, len(own) - min_members} if len(own) >= min_members else ()):
            lowest = own[left_out]
            below = signed[(is_member | is_rival) & (signed < lowest)]
            if below.size and (bound := _shortest_number_between(float(below.max()), float(lowest))) is not None:
                # Adding 0.0 turns -0.0 into 0.0.
                number = sign * float(bound) + 0.0
                if number >= smallest_bound:
                    yield Predicate(
                        text.format(f"{number:g}", other=quantity),
                        signed > float(bound),
                        f"{quantity}: {text}",
                    )


def _shortest_number_between(low: float, high: float) -> str | None:
    """Return the shortest number in [low, high) as text; None if it needs more than three digits or an exponent.

    Numbers need an exponent below 0.0001 and from 1,000,000 on.
    """
    for digits in _BOUND_DIGITS:
        text = f"{float(f'{(low + high) / 2.0:.{digits}g}'):g}"
        if low <= float(text) < high and "e" not in text:
            return text
    return None
