"""How a scenario ends for the ego: who is first, who collides, and whether the ego stops."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from cornercase._common.geometry import within_half_turn
from cornercase._common.texts import quoted_name
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.clustering.crossing import Way, find_crossing
from cornercase.recordings import Collision, Recording

STANDING: Final = 0.1
"""Speed in m/s below which an entity stands."""

Relation = Literal["crossing", "lane", "apart", "absent"]
Manner = Literal["from behind", "its rear", "while it stands", "otherwise"]

# Entities go the same way where their headings differ by less, and are in one lane or in two beside each other where
# their centres are no farther apart across.
_ALIKE: Final = math.pi / 4
_ACROSS: Final = 5.0
# Share of its speed that an entity keeps at most where it slows down for another.
_SLOWED: Final = 0.8


@dataclass(frozen=True)
class Impact:
    """A collision of the ego.

    Attributes
    ----------
    entity : str
        Whom it touches.
    time : float
        s.
    speed : float
        Size of the difference of both velocities in m/s, at the first instant of contact.
    manner : {"from behind", "its rear", "while it stands", "otherwise"}
        ``"from behind"`` where the ego runs into one that goes the same way ahead of it, ``"its rear"`` where such a
        one runs into the ego, ``"while it stands"`` where a standing ego is hit.
    """

    entity: str
    time: float
    speed: float
    manner: Manner


@dataclass(frozen=True)
class Encounter:
    """How the ego's way and that of another entity meet.

    Attributes
    ----------
    entity : str
        The other one.
    relation : {"crossing", "lane", "apart", "absent"}
        ``"lane"`` where both go the same way at the beginning and at the end, in one lane or beside each other;
        ``"crossing"`` where the areas overlap that their boxes sweep, or would when both went straight on for 20 m
        after the end; ``"absent"`` where one of them never exists.
    first : str or None
        Who is in the overlap first; in a lane, who is ahead at the end.
    ahead : str or None
        Who is ahead at the beginning, in a lane.
    enters, leaves : float
        When the ego enters the overlap, and when the other leaves it, in s; NaN where that did not happen, and in a
        lane.
    gap : float
        Time in s from the first leaving to the second entering, negative where both were in it at once; NaN where
        only one came.
    """

    entity: str
    relation: Relation
    first: str | None = None
    ahead: str | None = None
    enters: float = math.nan
    leaves: float = math.nan
    gap: float = math.nan


@dataclass(frozen=True)
class Outcome:
    """How a scenario ended for the ego.

    Attributes
    ----------
    ego : str
        Its name.
    encounter : Encounter
        With the other entity of the study.
    others : tuple of Encounter
        With all further entities that moved; for these nothing is carried on after the end.
    impacts : tuple of Impact
        Collisions of the ego, in order of time.
    elsewhere : tuple of Collision
        Collisions of others.
    exists, moves, stops : bool
        Whether the ego ever exists, whether it moves at all, and whether it comes to stand after it moved.
    waits, yields : bool
        Where the other is first on a crossing: whether the ego stands before it enters and before the other has left;
        whether it does or at least slows down there by a fifth, and speeds up again by a quarter before it enters.
    """

    ego: str
    encounter: Encounter
    others: tuple[Encounter, ...]
    impacts: tuple[Impact, ...]
    elsewhere: tuple[Collision, ...]
    exists: bool
    moves: bool
    stops: bool
    waits: bool
    yields: bool

    @property
    def first(self) -> str | None:
        """Who is first where the ways cross, or ahead in a lane."""
        return self.encounter.first

    @property
    def collision(self) -> str | None:
        """Whom the ego collides with first; where it does not, which others do."""
        if self.impacts:
            return self.impacts[0].entity
        return " and ".join(self.elsewhere[0].entities) if self.elsewhere else None

    @property
    def text(self) -> str:
        """In words, as ``"Ego and Pedestrian collide"`` or ``"Pedestrian first"``."""
        met, ego, other = self.encounter, quoted_name(self.ego), quoted_name(self.encounter.entity)
        if self.impacts:
            return f"{ego} and {quoted_name(self.impacts[0].entity)} collide"
        if met.relation == "absent":
            return f"{other if self.exists else ego} is never there"
        if met.first is None:
            return "ways do not cross"
        first, second = (ego, other) if met.first == self.ego else (other, ego)
        if met.relation == "crossing":
            return f"only {first} crosses" if math.isnan(met.gap) else f"{first} first"
        return f"{first} ahead" if met.first == met.ahead else f"{first} overtakes {second}"


def find_outcome(recording: Recording, ego: str, other: str, *, others: bool = True) -> Outcome:
    """Find how a scenario ended for the ego.

    Parameters
    ----------
    recording : Recording
        What came out of the scenario.
    ego, other : str
        Names of the two entities.
    others : bool, default True
        Look at encounters with further entities too, which takes as long again for each. Without, there are none in
        the outcome; how it ended is the same.

    Returns
    -------
    Outcome
        Who was first, who collided, and whether the ego stopped.

    Raises
    ------
    InputError
        There is no such entity.
    """
    here = there(recording, ego)
    way = Way.of(recording, ego, here)
    met = _meet(recording, way, ego, other, foresees=True)
    further = [name for name in recording.names if name not in (ego, other)] if others else []
    moving = [name for name in further if _fastest(recording, name) >= STANDING]
    speed = np.nan_to_num(np.abs(recording.speed[recording.index(ego)]))
    went = np.maximum.accumulate(speed) >= STANDING
    waits, yields = _gives_way(recording.time, speed, went, ego, met)
    return Outcome(
        ego=ego,
        encounter=met,
        others=tuple(_meet(recording, way, ego, name) for name in moving),
        impacts=tuple(_impact(recording, ego, one) for one in recording.collisions if ego in one.entities),
        elsewhere=tuple(one for one in recording.collisions if ego not in one.entities),
        exists=bool(here.any()),
        moves=bool(went.any()),
        stops=bool((went & here & (speed < STANDING)).any()),
        waits=waits,
        yields=yields,
    )


def tell_outcome(recording: Recording, ego: str, other: str) -> str:
    """Tell how a scenario ended for the ego: who collided, else who was first where the ways cross.

    Parameters
    ----------
    recording : Recording
        What came out of the scenario.
    ego, other : str
        Names of the two entities.

    Returns
    -------
    str
        ``"Ego and Pedestrian collide"``, ``"Ego first"``, ``"Pedestrian first"``, ``"only Pedestrian crosses"`` where
        the ego did not come to the place until the end, ``"Pedestrian ahead"`` or ``"Ego overtakes Pedestrian"`` in a
        lane, ``"ways do not cross"``, or ``"Pedestrian is never there"``.
    """
    return find_outcome(recording, ego, other, others=False).text


def there(recording: Recording, name: str) -> BoolArray:
    """When an entity exists.

    Parameters
    ----------
    recording : Recording
        Any recording.
    name : str
        Of the entity.

    Returns
    -------
    ndarray of bool, shape (T,)
        Mask of the instants.
    """
    i = recording.index(name)
    # A sum is finite where all of its parts are.
    known: BoolArray = np.isfinite(recording.x[i] + recording.y[i] + recording.heading[i] + recording.speed[i])
    return known


def _fastest(recording: Recording, name: str) -> float:
    return float(np.nan_to_num(np.abs(recording.speed[recording.index(name)])).max(initial=0.0))


def _meet(recording: Recording, ego: Way, name: str, other: str, foresees: bool = False) -> Encounter:
    together = _go_together(recording, name, other)
    if together is None:
        exist = there(recording, name).any() and there(recording, other).any()
        return Encounter(other, "apart" if exist else "absent")
    same_way, beside, in_lane = together
    if same_way and beside:
        return in_lane
    way = Way.of(recording, other, there(recording, other))
    found = find_crossing(ego, way)
    if same_way:
        # A lane that bends takes one who is far ahead to the side.
        return in_lane if found else Encounter(other, "apart")
    if found is None:
        return _carried_on(recording, ego, way, name, other) if foresees else Encounter(other, "apart")
    if found.enters < found.other_enters:
        first, gap = name, found.other_enters - found.leaves
    else:
        first, gap = other, found.enters - found.other_leaves
    return Encounter(other, "crossing", first=first, enters=found.enters, leaves=found.other_leaves, gap=gap)


def _carried_on(recording: Recording, ego: Way, way: Way, name: str, other: str) -> Encounter:
    """Who alone came to where both ways would cross, if they went straight on after the end."""
    # One that stands all the time is on no way that it could carry on.
    if min(_fastest(recording, name), _fastest(recording, other)) < STANDING:
        return Encounter(other, "apart")
    found = find_crossing(ego.carried_on(), way.carried_on())
    if found is None or min(found.enters, found.other_enters) > ego.end:
        return Encounter(other, "apart")
    if found.enters < found.other_enters:
        return Encounter(other, "crossing", first=name, enters=found.enters)
    return Encounter(other, "crossing", first=other, leaves=min(found.other_leaves, ego.end))


def _go_together(recording: Recording, ego: str, other: str) -> tuple[bool, bool, Encounter] | None:
    """Whether both go the same way, whether in one lane or beside each other, and what they are to each other then."""
    both = np.flatnonzero(there(recording, ego) & there(recording, other))
    if not len(both):
        return None
    at = both[[0, -1]]
    headings = recording.heading[:, at]
    turned = np.abs(within_half_turn(headings[recording.index(other)] - headings[recording.index(ego)]))
    along, across = _seen_from(recording, ego, other, at)
    begins, ends = (other if away > 0.0 else ego for away in along.tolist())
    in_lane = Encounter(other, "lane", first=ends, ahead=begins)
    return bool((turned < _ALIKE).all()), bool((np.abs(across) <= _ACROSS).all()), in_lane


def _seen_from(recording: Recording, ego: str, other: str, at: IntArray) -> tuple[FloatArray, FloatArray]:
    """How far the other's centre is ahead of the ego's and to its left at some instants in m, (k,) each."""
    i, j = recording.index(ego), recording.index(other)
    heading = recording.heading[:, at]
    cos, sin, ahead = np.cos(heading), np.sin(heading), recording.center_x[:, None]
    x, y = recording.x[:, at] + ahead * cos, recording.y[:, at] + ahead * sin
    x, y = x[j] - x[i], y[j] - y[i]
    return cos[i] * x + sin[i] * y, cos[i] * y - sin[i] * x


def _gives_way(time: FloatArray, speed: FloatArray, went: BoolArray, ego: str, met: Encounter) -> tuple[bool, bool]:
    if met.relation != "crossing" or met.first == ego:
        return False, False
    until = time[-1] if math.isnan(met.enters) else met.enters
    before = np.flatnonzero(went & (time <= min(until, met.leaves)))
    if not len(before):
        return False, False
    slowest = before[speed[before].argmin()]
    if speed[slowest] < STANDING:
        return True, True
    slows = speed[slowest] <= _SLOWED * speed[: slowest + 1].max()
    again = math.isnan(met.enters) or speed[slowest] <= _SLOWED * np.interp(met.enters, time, speed)
    return False, bool(slows and again)


def _impact(recording: Recording, ego: str, collision: Collision) -> Impact:
    (entity,) = (name for name in collision.entities if name != ego)
    at = int(np.abs(recording.time - collision.time).argmin())
    i, j = recording.index(ego), recording.index(entity)
    velocities = [
        recording.speed[k, at] * np.array([np.cos(recording.heading[k, at]), np.sin(recording.heading[k, at])])
        for k in (i, j)
    ]
    manner: Manner = "otherwise"
    if abs(recording.speed[i, at]) < STANDING:
        manner = "while it stands"
    elif abs(within_half_turn(recording.heading[j, at] - recording.heading[i, at])) < _ALIKE:
        along, _ = _seen_from(recording, ego, entity, np.array([at]))
        manner = "from behind" if along[0] > 0.0 else "its rear"
    return Impact(entity, collision.time, float(np.hypot(*(velocities[1] - velocities[0]))), manner)
