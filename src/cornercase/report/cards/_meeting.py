"""First contact of the ego in a run or, without a contact, its closest approach to another entity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.metrics import Clearance
from cornercase.metrics._ending import find_outcome
from cornercase.metrics._other_entities import nearest_other
from cornercase.metrics._outcome import Fault
from cornercase.recordings import Recording


@dataclass(frozen=True)
class Meeting:
    """First contact of the ego with a measured entity, or the ego's closest approach if there is no contact.

    Measured entities are those that the metrics of the study measure the ego against. `other` is the entity that the
    ego meets. `instant` is an index of the recording, and `time` is in s. `gap` is the distance in m between the boxes
    (outlines) of both entities: 0 at a contact, NaN if both entities never exist at the same time. Speeds are in m/s
    along the heading; `relative_speed` is the magnitude of the relative velocity.

    `sides` are the touching sides of the ego's box and the other box, each None if unknown, and `point` is the point of
    contact in m, or None if unknown. Both are None if there is no contact. `crosses` is True if the paths cross, False
    if both go in the same direction in one lane, in adjacent lanes or on paths that overlap, and None otherwise.

    `further_contacts` are contacts of the ego with other measured entities, and `unmeasured_contacts` with unmeasured
    entities. Each contact is the name of an entity and the time in s of the first contact, sorted by time.
    """

    other: str
    collides: bool
    instant: int
    time: float
    gap: float
    speed: float
    other_speed: float
    relative_speed: float
    sides: tuple[str | None, str | None] | None
    point: tuple[float, float] | None
    crosses: bool | None
    further_contacts: tuple[tuple[str, float], ...] = ()
    unmeasured_contacts: tuple[tuple[str, float], ...] = ()

    @property
    def entities_hit(self) -> frozenset[str]:
        """Names of all entities that the ego touches, including entities that no metric measures the ego against."""
        further = {name for name, _ in self.further_contacts + self.unmeasured_contacts}
        return frozenset(further | {self.other} if self.collides else further)


def find_meeting(recording: Recording, ego: str, others: tuple[str, ...]) -> Meeting:
    """Find the first contact of the ego with one of `others`, or the ego's closest approach if there is no contact."""
    whole = recording.with_absent_entities((ego, *others))
    other = nearest_other(whole, ego, others)
    outcome = find_outcome(whole, ego, other, others=False)
    contacts = _first_contacts(whole, ego)
    further = tuple((name, time) for name, time in contacts if name in others and name != other)
    unmeasured = tuple((name, time) for name, time in contacts if name not in others)
    crosses = {"crossing": True, "lane": False}.get(outcome.encounter.relation)
    collision = whole.first_collision(ego, other)
    impact = next((impact for impact in outcome.impacts if impact.entity == other), None)
    i, j = whole.entity_index(ego), whole.entity_index(other)
    if collision is None or impact is None:
        gaps = Clearance().course(whole, ego, other)
        both = bool(np.isfinite(gaps).any())
        instant = int(np.nanargmin(gaps)) if both else 0
        return Meeting(
            other, False, instant, float(whole.time[instant]), float(gaps[instant]) if both else float("nan"),
            float(whole.speed[i, instant]), float(whole.speed[j, instant]), _relative_speed(whole, i, j, instant),
            None, None, crosses, further, unmeasured,
        )  # fmt: skip
    instant = int(np.argmin(np.abs(whole.time - collision.time)))
    fault: Fault | None = impact.fault
    return Meeting(
        other, True, instant, collision.time, 0.0,
        float(whole.speed[i, instant]), float(whole.speed[j, instant]), impact.speed,
        None if fault is None else fault.sides, None if fault is None else fault.point, crosses,
        further, unmeasured,
    )  # fmt: skip


def _first_contacts(recording: Recording, ego: str) -> list[tuple[str, float]]:
    """Return the name of each entity that the ego touches, and the time in s of the first contact; sorted by time."""
    times: dict[str, float] = {}
    for collision in sorted(recording.collisions, key=lambda collision: collision.time):
        if ego in collision.entities:
            (name,) = (name for name in collision.entities if name != ego)
            times.setdefault(name, collision.time)
    return list(times.items())


def _relative_speed(recording: Recording, i: int, j: int, instant: int) -> float:
    ego, other = (_velocity(recording, k, instant) for k in (i, j))
    return float(np.hypot(*(ego - other)))


def _velocity(recording: Recording, entity: int, instant: int) -> FloatArray:
    speed, heading = recording.speed[entity, instant], recording.heading[entity, instant]
    return np.array([speed * np.cos(heading), speed * np.sin(heading)])
