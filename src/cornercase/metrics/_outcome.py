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

    `who` says who is at fault: ``"ego"``, ``"other"``, ``"both"``, or ``"undecided"`` if motion and roads do not show
    this. `sides` are the sides on which the ego's box and the other's box are hit. `point` is the point in m at which
    the boxes touch. Unknown sides and an unknown point are None. `reasons` are sentences without full stop.
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

    `speed` is the magnitude of the relative velocity at first contact in m/s. `fault` is None in studies of early
    versions. `manner` is one of these:

    - ``"while it stands"``: the ego stands.
    - ``"from behind"``: the centre of the other entity is ahead of the ego's, and their headings differ by less than
      45°.
    - ``"its rear"``: the centre of the other entity is not ahead of the ego's, and their headings differ by less than
      45°.
    - ``"otherwise"``: none of these.
    """

    entity: str
    time: float
    speed: float
    manner: Manner
    fault: Fault | None = None

    @property
    def shown_manner(self) -> Manner:
        """Manner of the collision that reports show.

        For ``"from behind"`` and ``"its rear"``, if both are known not to touch front to rear, this is ``"otherwise"``.
        """
        sides = {"from behind": ("front", "rear"), "its rear": ("rear", "front")}.get(self.manner)
        if sides is None or self.fault is None or None in self.fault.sides or self.fault.sides == sides:
            return self.manner
        return "otherwise"


@dataclass(frozen=True)
class PathRelation:
    """Relation of the paths of the ego and another entity; times in s.

    `relation` is one of these:

    - ``"lane"``: both head in the same direction at the beginning and at the end, in one lane or in adjacent lanes, or
      on paths that overlap.
    - ``"crossing"``: the directions differ, and the areas that both boxes sweep overlap. This includes areas that would
      overlap if both went straight on for 20 m after the end, if one entity reached the overlap before the end.
    - ``"apart"``: neither ``"lane"`` nor ``"crossing"``.
    - ``"absent"``: at least one of the two entities never exists.

    On a crossing, `first` is the entity that enters the overlap first. `enters` is when the ego enters the overlap, and
    `leaves` is when the other entity leaves it, or the last instant if the other entity stays in the overlap. A time is
    NaN if the entity never enters. `gap` is the time from the instant at which the first entity leaves until the second
    entity enters: negative if both were in the overlap at once, NaN if only one entity entered.

    In a lane, `ahead` is the entity ahead at the beginning, `first` is the entity ahead at the end, and times are NaN.
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

    `encounter` is the relation between the ego's path and the path of the main other entity of the study. `others` are
    the relations to further entities that moved; their paths are not extrapolated after the end. `impacts` are the
    ego's collisions in order of time, `other_collisions` are collisions without the ego. `exists` says whether the ego
    ever exists, `moves` whether it ever moves, and `stops` whether it stands after it moved.

    `waits` and `yields` can be True only if the other entity is first on a crossing. The ego waits if it stops before
    it enters the crossing and before the other entity has left. The ego yields if it waits, or if it slows down by a
    fifth and then speeds up by a quarter before it enters, or slows down by a fifth and never enters.
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
        """Name of the entity that the ego collides with first; None if no entities collide.

        If only other entities collide, the names of the first two that collide, joined by "and".
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
