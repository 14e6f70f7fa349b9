"""What can be said of scenarios in a few words, and of which of them it is true."""

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

# Least bound of a trait in a name, in m, s, m/s or m/s²: nobody sees less.
_LEAST: Final = 0.1
# Digits that a bound may have in a name.
_DIGITS: Final = (1, 2, 3)


@dataclass(frozen=True, eq=False)
class Clause:
    """Something that is true of some scenarios.

    Attributes
    ----------
    text : str
        In words.
    holds : ndarray of bool, shape (n,)
        Of which scenarios it is true.
    of : str
        What a bound is of, and on which side; empty for what has none. Of two with the same, one is enough.
    """

    text: str
    holds: BoolArray
    of: str = ""


@dataclass(frozen=True, eq=False)
class Account:
    """What is known of n scenarios that names of their kinds can be made of.

    Attributes
    ----------
    outcomes : sequence of Outcome, length n
    traits : mapping of str to ndarray of float64, shape (n,)
        As in `cornercase.clustering.traits.measure_traits`.
    space : ParameterSpace
    values : sequence of mapping of str to float or str, length n
        Parameters.
    """

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
        """Put together what is known of each scenario.

        Parameters
        ----------
        outcomes : sequence of Outcome, length n
            How it ended.
        traits : sequence of mapping of str to float, length n
            How it went.
        space : ParameterSpace
            Of the parameters.
        values : sequence of mapping of str to float or str, length n
            Parameters.

        Returns
        -------
        Account
            Of all of them.
        """
        columns = {name: np.array([one[name] for one in traits], dtype=np.float64) for name in traits[0]}
        return cls(outcomes, columns, space, values)


def endings(outcome: Outcome) -> tuple[str, ...]:
    """Say how a scenario ended for the ego.

    Parameters
    ----------
    outcome : Outcome
        How it ended.

    Returns
    -------
    tuple of str
        Predicates of the ego, all of them true; from the one that says most to the one that says least.
    """
    still = ("stands all the time",) if outcome.exists and not outcome.moves else ()
    return still + (_of_impact(outcome.impacts[0]) if outcome.impacts else _of_encounter(outcome))


def _of_impact(impact: Impact) -> tuple[str, ...]:
    who = quoted_name(impact.entity)
    most = {
        "from behind": (f"runs into the rear of {who}",),
        "its rear": (f"is hit from behind by {who}",),
        "while it stands": (f"is hit by {who} while it stands",),
        "otherwise": (),
    }
    return (*most[impact.manner], f"collides with {who}")


def _of_encounter(outcome: Outcome) -> tuple[str, ...]:
    met, who = outcome.encounter, quoted_name(outcome.encounter.entity)
    if met.relation == "absent":
        return (f"is there without {who}" if outcome.exists else "is never there", f"does not meet {who}")
    if met.first is None:
        return (f"does not meet {who}",)
    if met.relation == "lane":
        if met.first == met.ahead:
            return (f"stays ahead of {who}" if met.first == outcome.ego else f"stays behind {who}",)
        return (f"overtakes {who}" if met.first == outcome.ego else f"is overtaken by {who}",)
    if met.first == outcome.ego:
        return (
            (f"passes while {who} waits", f"passes before {who}") if math.isnan(met.gap) else (f"passes before {who}",)
        )
    said = []
    if outcome.waits:
        said.append(f"stops for {who}")
    if outcome.yields:
        said.append(f"yields to {who}")
    if not math.isnan(met.enters):
        said.append(f"passes after {who}")
    return (*said, f"comes after {who}")


def fixed_clauses(account: Account) -> list[Clause]:
    """Say what has bounds of its own, whatever the other scenarios are.

    Parameters
    ----------
    account : Account
        What is known of the scenarios.

    Returns
    -------
    list of Clause
        How fast the ego hits, how large the gap is, whether and how hard it brakes, where it turns, and who else is
        before it.
    """
    traits, outcomes = account.traits, account.outcomes
    hit, gap, braking = traits["impact speed"], traits["gap"], traits["braking"]
    turn, shift, aside = traits["turn"], traits["shift"], traits["aside"]
    crosses = np.array([one.encounter.relation == "crossing" for one in outcomes])
    other = quoted_name(outcomes[0].encounter.entity)
    straight = np.abs(turn) < _STRAIGHT
    stops, moves = (np.array([getattr(one, name) for one in outcomes]) for name in ("stops", "moves"))
    found = [
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
    said = [tuple(_of_others(one)) for one in outcomes]
    texts = dict.fromkeys(text for each in said for text in each)
    return found + [Clause(text, np.array([text in each for each in said])) for text in texts]


def _of_others(outcome: Outcome) -> Iterator[str]:
    for one in outcome.others:
        if one.first is not None:
            words = ("ahead of", "behind") if one.relation == "lane" else ("before", "after")
            yield f"{words[one.first != outcome.ego]} {quoted_name(one.entity)}"
    for collision in outcome.elsewhere:
        yield f"{' and '.join(map(quoted_name, collision.entities))} collide"
    # Of those that collide it is not said yet.
    met: Encounter = outcome.encounter
    if outcome.impacts and met.relation == "crossing":
        yield f"{quoted_name(str(met.first))} first"


def bounded_clauses(account: Account, wanted: BoolArray, needed: int, rivals: BoolArray) -> list[tuple[int, Clause]]:
    """Say what sets some scenarios apart from others: more or less of a trait, a part of a parameter's range.

    Parameters
    ----------
    account : Account
        What is known of the scenarios.
    wanted : ndarray of bool, shape (n,)
        Of these it shall be true.
    needed : int
        Of so many of them at least.
    rivals : ndarray of bool, shape (n,)
        From these it shall set them apart.

    Returns
    -------
    list of (int, Clause)
        Traits with 1, parameters with 2.
    """
    other = quoted_name(account.outcomes[0].encounter.entity)
    found = [
        (1, clause)
        for name, texts in TRAITS.items()
        for clause in _bounds(account.traits[name], texts, other, wanted, needed, rivals, _LEAST)
    ]
    for one in account.space.parameters:
        read = [one.read(each) for each in account.values]
        if one.choices:
            chosen = np.array([str(value) for value in read])
            found += [(2, Clause(_choice(one, choice), chosen == choice)) for choice in one.choices]
        elif one.size != 1:
            unit = one.unit.replace("{", "{{").replace("}", "}}")
            texts = (f"{{other}} < {{}} {unit}".rstrip(), f"{{other}} > {{}} {unit}".rstrip())
            column = np.array(read, dtype=np.float64)
            found += [(2, clause) for clause in _bounds(column, texts, quoted_name(one.name), wanted, needed, rivals)]
    return found


def _choice(parameter: Parameter, choice: str) -> str:
    """Name a choice; of values that go together the first that tells it from all others."""
    names, parts = parameter.name.split(", "), [one.split(", ") for one in parameter.choices]
    if len(names) > 1 and all(len(one) == len(names) for one in parts):
        for name, mine, others in zip(names, choice.split(", "), zip(*parts, strict=True), strict=True):
            if len(set(others)) == len(others):
                return f"{quoted_name(name)} is {quoted_name(mine)}"
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
    """Clauses with a bound from above or below that holds for all wanted ones, or for as few as are needed."""
    for sign, text in ((-1.0, texts[0]), (1.0, texts[1])):
        signed = sign * values
        mine = np.sort(signed[wanted & np.isfinite(values)])
        for left_out in sorted({0, len(mine) - needed} if len(mine) >= needed else ()):
            lowest = mine[left_out]
            below = signed[(wanted | rivals) & (signed < lowest)]
            if below.size and (bound := _round(float(below.max()), float(lowest))) is not None:
                # Zero has no sign.
                number = sign * float(bound) + 0.0
                if number >= least:
                    yield Clause(
                        text.format(f"{number:.{_DIGITS[-1]}g}", other=of), signed > float(bound), f"{of}: {text}"
                    )


def _round(low: float, high: float) -> str | None:
    """Write the shortest number between two; None where it would be long."""
    for digits in _DIGITS:
        text = f"{(low + high) / 2.0:.{digits}g}"
        if low <= float(text) < high and "e" not in text:
            return text
    return None
