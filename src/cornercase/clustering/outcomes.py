"""Ending of a scenario for the ego: who is first, who collides, and whether the ego stops."""

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

# Largest heading difference of entities that move in the same direction, and largest lateral distance of centres, in m,
# of entities in one lane or in adjacent ones.
_ALIKE: Final = math.pi / 4
_ACROSS: Final = 5.0
# Largest share of its speed that an entity keeps when it slows down for another.
_SLOWED: Final = 0.8


@dataclass(frozen=True)
class Impact:
    """A collision of the ego; `time` in s, `speed` is the magnitude of the relative velocity at first contact in m/s.

    `manner` is ``"from behind"`` if the ego hits an entity ahead that moves in the same direction, ``"its rear"`` if
    such an entity hits the ego, ``"while it stands"`` if a standing ego is hit.
    """

    entity: str
    time: float
    speed: float
    manner: Manner


@dataclass(frozen=True)
class Encounter:
    """How the paths of the ego and another entity meet; times in s.

    `relation` is ``"lane"`` if both move in the same direction at the beginning and at the end, in one lane or in
    adjacent ones; ``"crossing"`` if the areas swept by their boxes overlap, or would if both went straight on for 20 m
    after the end; ``"absent"`` if one of them never exists. `first` enters the overlap first; in a lane it is ahead at
    the end, and `ahead` at the beginning. `enters` is when the ego enters the overlap, `leaves` when the other leaves
    it; NaN if that did not happen, and in a lane. `gap` is the time from the first leaving to the second entering,
    negative if both were in it at once; NaN if only one came.
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

    `encounter` is with the main other entity of the study, `others` are with further entities that moved, not
    extrapolated after the end. `impacts` are the ego's collisions by time, `other_collisions` those that do not involve
    it. `stops`: it comes to stand after it moved. If the other is first on a crossing, `waits`: the ego stands before
    it enters and before the other has left; `yields`: it does, or slows down by a fifth and speeds up again by a
    quarter before it enters.
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
        """Who is first where the paths cross, or ahead in a lane."""
        return self.encounter.first

    @property
    def collision(self) -> str | None:
        """With whom the ego collides first; if it does not, which others collide."""
        if self.impacts:
            return self.impacts[0].entity
        return " and ".join(self.elsewhere[0].entities) if self.elsewhere else None

    @property
    def text(self) -> str:
        """The ending in words, as ``"Ego and Pedestrian collide"`` or ``"Pedestrian first"``."""
        encounter, ego, other = self.encounter, quoted_name(self.ego), quoted_name(self.encounter.entity)
        if self.impacts:
            return f"{ego} and {quoted_name(self.impacts[0].entity)} collide"
        if encounter.relation == "absent":
            return f"{other if self.exists else ego} is never there"
        if encounter.first is None:
            return "ways do not cross"
        first, second = (ego, other) if encounter.first == self.ego else (other, ego)
        if encounter.relation == "crossing":
            return f"only {first} crosses" if math.isnan(encounter.gap) else f"{first} first"
        return f"{first} ahead" if encounter.first == encounter.ahead else f"{first} overtakes {second}"


def find_outcome(recording: Recording, ego: str, other: str, *, others: bool = True) -> Outcome:
    """Determine how a recorded scenario ended for the ego.

    `others=False` skips encounters with further entities, each of which takes as long again.
    """
    exists = there(recording, ego)
    path = Way.of(recording, ego, exists)
    encounter = _meet(recording, path, ego, other, foresees=True)
    other_names = [name for name in recording.names if name not in (ego, other)] if others else []
    moving = [name for name in other_names if _fastest(recording, name) >= STANDING]
    speed = np.nan_to_num(np.abs(recording.speed[recording.index(ego)]))
    has_moved = np.maximum.accumulate(speed) >= STANDING
    waits, yields = _gives_way(recording.time, speed, has_moved, ego, encounter)
    return Outcome(
        ego=ego,
        encounter=encounter,
        others=tuple(_meet(recording, path, ego, name) for name in moving),
        impacts=tuple(
            _impact(recording, ego, collision) for collision in recording.collisions if ego in collision.entities
        ),
        elsewhere=tuple(collision for collision in recording.collisions if ego not in collision.entities),
        exists=bool(exists.any()),
        moves=bool(has_moved.any()),
        stops=bool((has_moved & exists & (speed < STANDING)).any()),
        waits=waits,
        yields=yields,
    )


def tell_outcome(recording: Recording, ego: str, other: str) -> str:
    """Return the ending as text: who collided, else who was first where the paths cross.

    ``"Ego and Pedestrian collide"``, ``"Ego first"``, ``"Pedestrian first"``, ``"only Pedestrian crosses"`` (the ego
    had not arrived at the end), ``"Pedestrian ahead"`` or ``"Ego overtakes Pedestrian"`` in a lane, ``"ways do not
    cross"``, or ``"Pedestrian is never there"``.
    """
    return find_outcome(recording, ego, other, others=False).text


def there(recording: Recording, name: str) -> BoolArray:
    """Mask of the instants at which an entity exists, shape (T,)."""
    i = recording.index(name)
    # A sum is finite if all its terms are.
    exists: BoolArray = np.isfinite(recording.x[i] + recording.y[i] + recording.heading[i] + recording.speed[i])
    return exists


def _fastest(recording: Recording, name: str) -> float:
    return float(np.nan_to_num(np.abs(recording.speed[recording.index(name)])).max(initial=0.0))


def _meet(recording: Recording, ego: Way, name: str, other: str, foresees: bool = False) -> Encounter:
    same_direction = _go_together(recording, name, other)
    if same_direction is None:
        both_exist = there(recording, name).any() and there(recording, other).any()
        return Encounter(other, "apart" if both_exist else "absent")
    is_same_direction, is_adjacent, lane_encounter = same_direction
    if is_same_direction and is_adjacent:
        return lane_encounter
    other_path = Way.of(recording, other, there(recording, other))
    crossing = find_crossing(ego, other_path)
    if is_same_direction:
        # On a bend, an entity far ahead is off to the side.
        return lane_encounter if crossing else Encounter(other, "apart")
    if crossing is None:
        return _carried_on(recording, ego, other_path, name, other) if foresees else Encounter(other, "apart")
    if crossing.enters < crossing.other_enters:
        first, gap = name, crossing.other_enters - crossing.leaves
    else:
        first, gap = other, crossing.enters - crossing.other_leaves
    return Encounter(other, "crossing", first=first, enters=crossing.enters, leaves=crossing.other_leaves, gap=gap)


def _carried_on(recording: Recording, ego: Way, way: Way, name: str, other: str) -> Encounter:
    """Who alone reached the point where both paths would cross if they went straight on after the end."""
    # An entity that never moves has no path to extrapolate.
    if min(_fastest(recording, name), _fastest(recording, other)) < STANDING:
        return Encounter(other, "apart")
    crossing = find_crossing(ego.carried_on(), way.carried_on())
    if crossing is None or min(crossing.enters, crossing.other_enters) > ego.end:
        return Encounter(other, "apart")
    if crossing.enters < crossing.other_enters:
        return Encounter(other, "crossing", first=name, enters=crossing.enters)
    return Encounter(other, "crossing", first=other, leaves=min(crossing.other_leaves, ego.end))


def _go_together(recording: Recording, ego: str, other: str) -> tuple[bool, bool, Encounter] | None:
    """Whether both move in the same direction, whether in one lane or adjacent ones, and their encounter if so."""
    shared = np.flatnonzero(there(recording, ego) & there(recording, other))
    if not len(shared):
        return None
    ends_of_shared = shared[[0, -1]]
    headings = recording.heading[:, ends_of_shared]
    heading_difference = np.abs(within_half_turn(headings[recording.index(other)] - headings[recording.index(ego)]))
    along, across = _seen_from(recording, ego, other, ends_of_shared)
    first_ahead, last_ahead = (other if offset > 0.0 else ego for offset in along.tolist())
    encounter = Encounter(other, "lane", first=last_ahead, ahead=first_ahead)
    return bool((heading_difference < _ALIKE).all()), bool((np.abs(across) <= _ACROSS).all()), encounter


def _seen_from(recording: Recording, ego: str, other: str, at: IntArray) -> tuple[FloatArray, FloatArray]:
    """Distance of the other's centre ahead of the ego's and to its left at some instants, in m, shape (k,) each."""
    i, j = recording.index(ego), recording.index(other)
    heading = recording.heading[:, at]
    cos, sin, center_offset = np.cos(heading), np.sin(heading), recording.center_x[:, None]
    x, y = recording.x[:, at] + center_offset * cos, recording.y[:, at] + center_offset * sin
    x, y = x[j] - x[i], y[j] - y[i]
    return cos[i] * x + sin[i] * y, cos[i] * y - sin[i] * x


def _gives_way(time: FloatArray, speed: FloatArray, went: BoolArray, ego: str, met: Encounter) -> tuple[bool, bool]:
    if met.relation != "crossing" or met.first == ego:
        return False, False
    deadline = time[-1] if math.isnan(met.enters) else met.enters
    before = np.flatnonzero(went & (time <= min(deadline, met.leaves)))
    if not len(before):
        return False, False
    slowest = before[speed[before].argmin()]
    if speed[slowest] < STANDING:
        return True, True
    slows_down = speed[slowest] <= _SLOWED * speed[: slowest + 1].max()
    speeds_up = math.isnan(met.enters) or speed[slowest] <= _SLOWED * np.interp(met.enters, time, speed)
    return False, bool(slows_down and speeds_up)


def _impact(recording: Recording, ego: str, collision: Collision) -> Impact:
    (entity,) = (name for name in collision.entities if name != ego)
    instant = int(np.abs(recording.time - collision.time).argmin())
    i, j = recording.index(ego), recording.index(entity)
    velocities = [
        recording.speed[k, instant]
        * np.array([np.cos(recording.heading[k, instant]), np.sin(recording.heading[k, instant])])
        for k in (i, j)
    ]
    manner: Manner = "otherwise"
    if abs(recording.speed[i, instant]) < STANDING:
        manner = "while it stands"
    elif abs(within_half_turn(recording.heading[j, instant] - recording.heading[i, instant])) < _ALIKE:
        along, _ = _seen_from(recording, ego, entity, np.array([instant]))
        manner = "from behind" if along[0] > 0.0 else "its rear"
    return Impact(entity, collision.time, float(np.hypot(*(velocities[1] - velocities[0]))), manner)
