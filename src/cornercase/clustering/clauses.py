"""Short predicates about scenarios, and the scenarios they hold for."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cornercase._common.texts import quoted_name
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.clustering.outcomes import Encounter, Impact, Outcome
from cornercase.clustering.traits import TRAITS
from cornercase.scenario import Parameter, ParameterSpace, Value

# Bounds of impact speeds in m/s, of gaps in s, of decelerations in m/s², of turns in rad and of shifts in m.
_LOW_SPEED, _HIGH_SPEED = 5.0, 10.0
_CLOSE, _CLEAR = 1.5, 3.0
_UNBRAKED, _SOFT, _HARD = 0.5, 3.0, 5.0
_TURNED, _STRAIGHT, _ASIDE = math.pi / 4, math.pi / 9, 1.5

# Smallest bound of a feature in a name, in m, s, m/s or m/s²: smaller ones are not visible.
_LEAST: Final = 0.1
# Digits that a bound may have in a name.
_DIGITS: Final = (1, 2, 3)


@dataclass(frozen=True, eq=False)
class Clause:
    """A predicate and the scenarios it holds for, shape (n,).

    `quantity` says which quantity a bound limits, and on which side; it is empty for predicates without a bound. A name
    needs only one predicate of each.
    """

    text: str
    holds: BoolArray
    of: str = ""


@dataclass(frozen=True, eq=False)
class Account:
    """Everything about n scenarios from which names of clusters are made; traits have shape (n,) each."""

    outcomes: Sequence[Outcome]
    traits: Mapping[str, FloatArray]
    space: ParameterSpace
    values: Sequence[Mapping[str, Value]]

    @classmethod
    def of(
        cls,
        outcomes: Sequence[Outcome],
        traits: Sequence[Mapping[str, float]],
        space: ParameterSpace,
        values: Sequence[Mapping[str, Value]],
    ) -> Account:
        """Collect features per scenario into one column per feature."""
        columns = {name: np.array([row[name] for row in traits], dtype=np.float64) for name in traits[0]}
        return cls(outcomes, columns, space, values)


def endings(outcome: Outcome) -> tuple[str, ...]:
    """Describe how a scenario ended for the ego: predicates that are all true, the most specific first."""
    still = ("stands all the time",) if outcome.exists and not outcome.moves else ()
    return still + (_of_impact(outcome.impacts[0]) if outcome.impacts else _of_encounter(outcome))


def _of_impact(impact: Impact) -> tuple[str, ...]:
    name = quoted_name(impact.entity)
    specific = {
        "from behind": (f"runs into the rear of {name}",),
        "its rear": (f"is hit from behind by {name}",),
        "while it stands": (f"is hit by {name} while it stands",),
        "otherwise": (),
    }
    return (*specific[impact.manner], f"collides with {name}")


def _of_encounter(outcome: Outcome) -> tuple[str, ...]:
    encounter, name = outcome.encounter, quoted_name(outcome.encounter.entity)
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


def fixed_clauses(account: Account) -> list[Clause]:
    """Return predicates with fixed bounds: impact speed, gap, braking, stops, turns, other entities."""
    traits, outcomes = account.traits, account.outcomes
    hit, gap, braking = traits["impact speed"], traits["gap"], traits["braking"]
    turn, shift, aside = traits["turn"], traits["shift"], traits["aside"]
    crosses = np.array([outcome.encounter.relation == "crossing" for outcome in outcomes])
    other = quoted_name(outcomes[0].encounter.entity)
    straight = np.abs(turn) < _STRAIGHT
    stops, moves = (np.array([getattr(outcome, name) for outcome in outcomes]) for name in ("stops", "moves"))
    clauses = [
        Clause("at low speed", hit < _LOW_SPEED),
        Clause("at medium speed", (hit >= _LOW_SPEED) & (hit < _HIGH_SPEED)),
        Clause("at high speed", hit >= _HIGH_SPEED),
        Clause("closely", (gap >= 0.0) & (gap < _CLOSE)),
        Clause("clear", gap >= _CLEAR),
        Clause("after a stop", stops),
        Clause("without a stop", moves & ~stops),
        Clause("brakes hard", braking >= _HARD),
        Clause("brakes softly", (braking >= _UNBRAKED) & (braking < _SOFT)),
        Clause("without braking", moves & (braking < _UNBRAKED)),
        Clause("moves to the left", straight & (shift > _ASIDE)),
        Clause("moves to the right", straight & (shift < -_ASIDE)),
        Clause("goes straight on", moves & straight & (np.abs(shift) <= _ASIDE)),
        Clause("turns left", turn >= _TURNED),
        Clause("turns right", turn <= -_TURNED),
        Clause(f"{other} from the left", crosses & (aside > _ASIDE)),
        Clause(f"{other} from the right", crosses & (aside < -_ASIDE)),
    ]
    texts_by_scenario = [tuple(_of_others(outcome)) for outcome in outcomes]
    texts = dict.fromkeys(text for scenario_texts in texts_by_scenario for text in scenario_texts)
    return clauses + [
        Clause(text, np.array([text in scenario_texts for scenario_texts in texts_by_scenario])) for text in texts
    ]


def _of_others(outcome: Outcome) -> Iterator[str]:
    for encounter in outcome.others:
        if encounter.first is not None:
            words = ("ahead of", "behind") if encounter.relation == "lane" else ("before", "after")
            yield f"{words[encounter.first != outcome.ego]} {quoted_name(encounter.entity)}"
    for collision in outcome.elsewhere:
        yield f"{' and '.join(map(quoted_name, collision.entities))} collide"
    # If ego and other collide, the ending does not say who was first.
    main: Encounter = outcome.encounter
    if outcome.impacts and main.relation == "crossing":
        yield f"{quoted_name(str(main.first))} first"


def bounded_clauses(account: Account, wanted: BoolArray, needed: int, rivals: BoolArray) -> list[tuple[int, Clause]]:
    """Return predicates that separate members from rivals, with rank 1 for features, 2 for parameters.

    Each holds for at least `min_members` of the members: more or less of a feature, or part of a parameter's range.
    """
    other = quoted_name(account.outcomes[0].encounter.entity)
    clauses = [
        (1, clause)
        for name, texts in TRAITS.items()
        for clause in _bounds(account.traits[name], texts, other, wanted, needed, rivals, _LEAST)
    ]
    for parameter in account.space.parameters:
        column_values = [parameter.read(row) for row in account.values]
        if parameter.choices:
            choices = np.array([str(value) for value in column_values])
            clauses += [(2, Clause(_choice(parameter, choice), choices == choice)) for choice in parameter.choices]
        elif parameter.size != 1:
            unit = parameter.unit.replace("{", "{{").replace("}", "}}")
            texts = (f"{{other}} < {{}} {unit}".rstrip(), f"{{other}} > {{}} {unit}".rstrip())
            column = np.array(column_values, dtype=np.float64)
            clauses += [
                (2, clause) for clause in _bounds(column, texts, quoted_name(parameter.name), wanted, needed, rivals)
            ]
    return clauses


def _choice(parameter: Parameter, choice: str) -> str:
    """Describe a choice; of values that belong together, the first one that identifies it."""
    names, parts = parameter.name.split(", "), [choice_parts.split(", ") for choice_parts in parameter.choices]
    if len(names) > 1 and all(len(choice_parts) == len(names) for choice_parts in parts):
        for name, part, column in zip(names, choice.split(", "), zip(*parts, strict=True), strict=True):
            if len(set(column)) == len(column):
                return f"{quoted_name(name)} is {quoted_name(part)}"
    return f"{quoted_name(parameter.name)} is {quoted_name(choice)}"


def _bounds(
    values: FloatArray,
    texts: tuple[str, str],
    of: str,
    wanted: BoolArray,
    needed: int,
    rivals: BoolArray,
    least: float = -math.inf,
) -> Iterator[Clause]:
    """Yield upper and lower bounds that hold for all members, or for just `min_members` of them."""
    for sign, text in ((-1.0, texts[0]), (1.0, texts[1])):
        signed = sign * values
        own = np.sort(signed[wanted & np.isfinite(values)])
        for left_out in sorted({0, len(own) - needed} if len(own) >= needed else ()):
            lowest = own[left_out]
            below = signed[(wanted | rivals) & (signed < lowest)]
            if below.size and (bound := _round(float(below.max()), float(lowest))) is not None:
                # Adding 0.0 turns -0.0 into 0.0.
                number = sign * float(bound) + 0.0
                if number >= least:
                    yield Clause(
                        text.format(f"{number:.{_DIGITS[-1]}g}", other=of), signed > float(bound), f"{of}: {text}"
                    )


def _round(low: float, high: float) -> str | None:
    """Write the shortest number in [low, high); None if it needs more than three digits."""
    for digits in _DIGITS:
        text = f"{(low + high) / 2.0:.{digits}g}"
        if low <= float(text) < high and "e" not in text:
            return text
    return None
