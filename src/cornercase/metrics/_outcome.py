"""Plain values that describe how a scenario ended for the ego."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from cornercase._common.text.sanitize import quote_name
from cornercase.recordings import Collision

Relation = Literal["crossing", "lane", "apart", "absent"]
Manner = Literal["from behind", "its rear", "while it stands", "otherwise"]
Side = Literal["front", "rear", "left", "right"]
Culprit = Literal["ego", "other", "both", "undecided"]
Conflict = Literal[
    "standing", "reversing", "rear end", "lane change", "turning", "oncoming", "crossing", "pedestrian", "unknown"
]


@dataclass(frozen=True)
class Fault:
    """Verdict on whose fault a collision of the ego is.

    `who` is ``"undecided"`` if motion and roads do not show it. `sides` are the sides of the ego's box and of the
    other's box that are hit. `point` is the point in m at which the boxes touch. Sides and point are None if they are
    unknown. `reasons` are sentences without full stop.
    """

    who: Culprit
    conflict: Conflict
    sides: tuple[Side | None, Side | None]
    point: tuple[float, float] | None
    reasons: tuple[str, ...]

    def describe(self, ego: str, other: str) -> str:
        """Describe in a few words whose fault the collision is: ``"Ego at fault"``, ``"fault undecided"``."""
        subjects = {"ego": quote_name(ego), "other": quote_name(other), "both": "both"}
        return f"{subjects[self.who]} at fault" if self.who in subjects else "fault undecided"


@dataclass(frozen=True)
class Impact:
    """Collision of the ego with `entity`, at `time` in s.

    `speed` is the magnitude of the relative velocity at first contact in m/s. `manner` is ``"from behind"`` if the ego
    hits an entity ahead that moves in the same direction. It is ``"its rear"`` if an entity behind that moves in the
    same direction hits the ego, and ``"while it stands"`` if the ego stands. `fault` is None in studies of early
    versions.
    """

    entity: str
    time: float
    speed: float
    manner: Manner
    fault: Fault | None = None

    @property
    def shown_manner(self) -> Manner:
        """The manner as it is shown.

        For two entities that move in the same direction, this is ``"otherwise"`` unless the front of one hits the rear
        of the other.
        """
        sides = {"from behind": ("front", "rear"), "its rear": ("rear", "front")}.get(self.manner)
        if sides is None or self.fault is None or None in self.fault.sides or self.fault.sides == sides:
            return self.manner
        return "otherwise"


@dataclass(frozen=True)
class PathRelation:
    """Relation of the paths of the ego and another entity; times in s.

    `relation` is one of these:

    - ``"lane"``: both move in the same direction at the beginning and at the end, in one lane or in adjacent lanes.
    - ``"crossing"``: the areas that both boxes sweep overlap, or would overlap if both went straight on for 20 m after
      the end.
    - ``"apart"``: neither of the two.
    - ``"absent"``: an entity never exists.

    `first` is the entity that enters the overlap first. In a lane, `first` is ahead at the end, and `ahead` is ahead at
    the beginning. `enters` is when the ego enters the overlap, `leaves` is when the other entity leaves the overlap;
    NaN if this did not happen, and in a lane. `gap` is the time from the first entity leaving to the second entity
    entering. It is negative if both were in the overlap at once, and NaN if only one entity came.
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
    """Ending of a scenario for the ego.

    `encounter` is the relation to the main other entity of the study, `others` are the relations to further entities
    that moved, not extrapolated after the end. `impacts` are the ego's collisions by time, `other_collisions` are
    collisions without the ego. `exists` and `moves` say whether the ego ever does. `stops` says whether the ego comes
    to stand after it moved.

    `waits` and `yields` can be True only if the other entity is first on a crossing. The ego waits if it stands before
    it enters and before the other entity has left. It yields if it waits, or if it slows down by a fifth and speeds up
    again by a quarter before it enters.
    """

    ego: str
    encounter: PathRelation
    others: tuple[PathRelation, ...]
    impacts: tuple[Impact, ...]
    other_collisions: tuple[Collision, ...]
    exists: bool
    moves: bool
    stops: bool
    waits: bool
    yields: bool

    @property
    def first(self) -> str | None:
        """Entity that is first where the paths cross, or ahead in a lane; None if the paths do not meet."""
        return self.encounter.first

    @property
    def collision(self) -> str | None:
        """Name of the entity that the ego collides with first; None if nothing collides.

        If only other entities collide, these are their names, joined by "and".
        """
        if self.impacts:
            return self.impacts[0].entity
        return " and ".join(self.other_collisions[0].entities) if self.other_collisions else None

    @property
    def fault(self) -> Fault | None:
        """Verdict on the ego's first collision; None without a collision, and in studies of early versions."""
        return self.impacts[0].fault if self.impacts else None

    @property
    def text(self) -> str:
        """Ending in words, as ``"Ego and Pedestrian collide"`` or ``"Pedestrian first"``."""
        encounter, ego, other = self.encounter, quote_name(self.ego), quote_name(self.encounter.entity)
        if self.impacts:
            return f"{ego} and {quote_name(self.impacts[0].entity)} collide"
        if encounter.relation == "absent":
            return f"{other if self.exists else ego} is never there"
        if encounter.first is None:
            return "ways do not cross"
        first, second = (ego, other) if encounter.first == self.ego else (other, ego)
        if encounter.relation == "crossing":
            return f"only {first} crosses" if math.isnan(encounter.gap) else f"{first} first"
        return f"{first} ahead" if encounter.first == encounter.ahead else f"{first} overtakes {second}"
