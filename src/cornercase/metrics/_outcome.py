"""Ending of a scenario for the ego as plain values."""

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
    """Whose fault a collision of the ego is.

    `who` is ``"undecided"`` if motion and roads do not show it. `sides` are those of the ego's and the other's box that
    are hit, and `point` is where they touch in m; None if that is unknown. `reasons` are sentences without full stop.
    """

    who: Culprit
    conflict: Conflict
    sides: tuple[Side | None, Side | None]
    point: tuple[float, float] | None
    reasons: tuple[str, ...]

    def describe(self, ego: str, other: str) -> str:
        """Say in a few words whose fault it is, as ``"C at fault"``."""
        subjects = {"ego": quote_name(ego), "other": quote_name(other), "both": "both"}
        return f"{subjects[self.who]} at fault" if self.who in subjects else "fault undecided"


@dataclass(frozen=True)
class Impact:
    """A collision of the ego; `time` in s, `speed` is the magnitude of the relative velocity at first contact in m/s.

    `manner` is ``"from behind"`` if the ego hits an entity ahead that moves in the same direction, ``"its rear"`` if
    such an entity hits the ego, ``"while it stands"`` if a standing ego is hit. `fault` is None in studies of early
    versions.
    """

    entity: str
    time: float
    speed: float
    manner: Manner
    fault: Fault | None = None

    @property
    def shown_manner(self) -> Manner:
        """The manner, but ``"otherwise"`` if two move alike and not the front of one hits the rear of the other."""
        sides = {"from behind": ("front", "rear"), "its rear": ("rear", "front")}.get(self.manner)
        if sides is None or self.fault is None or None in self.fault.sides or self.fault.sides == sides:
            return self.manner
        return "otherwise"


@dataclass(frozen=True)
class PathRelation:
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
        """Who is first where the paths cross, or ahead in a lane."""
        return self.encounter.first

    @property
    def collision(self) -> str | None:
        """The entity that the ego collides with first; if there is none, the others that collide."""
        if self.impacts:
            return self.impacts[0].entity
        return " and ".join(self.other_collisions[0].entities) if self.other_collisions else None

    @property
    def fault(self) -> Fault | None:
        """Whose fault the ego's first collision is; None without a collision, and in studies of early versions."""
        return self.impacts[0].fault if self.impacts else None

    @property
    def text(self) -> str:
        """The ending in words, as ``"Ego and Pedestrian collide"`` or ``"Pedestrian first"``."""
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
