"""Rules that find whose fault a collision is: one rule per kind of conflict, each from a published definition."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from cornercase._common.text.sanitize import quote_name
from cornercase.drivers._competent_driver import min_avoidable_time_to_collision
from cornercase.metrics._outcome import Conflict, Culprit, Fault
from cornercase.metrics.fault._approach import STRAIGHT, TURN, ConflictApproach, describe_approach
from cornercase.metrics.fault._avoidability import (
    REACTION_TIME,
    AvoidanceChance,
    can_brake,
    find_chance,
    find_latest_braking,
)
from cornercase.metrics.fault._contact import Contact, find_contact
from cornercase.metrics.fault._party import STANDING_SPEED, Party, iter_obstacles
from cornercase.metrics.fault._right_of_way import find_who_yields, is_on_wrong_side, roads_of
from cornercase.recordings import Collision, Recording
from cornercase.roads._network import RoadNetwork

_SAME_DIRECTION: Final = np.pi / 4.0
_ONCOMING: Final = 3.0 * np.pi / 4.0
_LEFT_LINE: Final = 0.3
"""Shift in m from which an entity has left its line; in the model of UN Regulation 157, drivers wander by 0.375 m."""

_AT_ONCE: Final = 0.25
"""Difference in s below which two parties count as coming into each other's path at the same time."""

_RECENTLY: Final = 5.0
"""Time in s after starting from standing in which a party has to look out (Vienna Convention, Article 14).

A party that has stood in the other's path for longer is an obstacle, even if it had to yield.
"""


@dataclass(frozen=True)
class _Ruling:
    """Result of a rule: the parties at fault, the kind of conflict, and the reason.

    `guilty` has 0 for the first party and 1 for the second; it is empty if the fault is undecided. ``{0}`` and ``{1}``
    in `reason` stand for the names of the parties.
    """

    guilty: tuple[int, ...]
    conflict: Conflict
    reason: str


def find_fault(recording: Recording, ego: str, collision: Collision) -> Fault:
    """Find whose fault a collision of the ego is, as far as the motion shows it.

    Both parties are judged by the same rules. The first rule that applies says who is at fault:

    1. *Standing*: the party that moves into a standing party. The standing party is at fault if it stopped in the
       other's path within the last 1.15 s, too late for the other to brake, and could have waited (Vienna Convention on
       Road Traffic 1968, Article 13: ability to stop). It is also at fault if it had to yield as in rule 5, and has
       stood in the other's path for at most 5 s.
    2. *Reversing*: the party that backs into the other, or into the other's path (Article 14).
    3. *Rear end*, in about the same direction: the party that drives into the rear of the other (safe distance:
       definition 1 of Shalev-Shwartz et al. 2017; Article 13). The party ahead is at fault if it cut in with a time to
       collision of at most Δv / (2 · 6 m/s²) + 0.35 s (UN Regulation No. 157, 5.2.5.2).
    4. *Lane change*: of two that move in the same direction and touch at a side, the party that left its line (Article
       14). The line follows the road if both are on one road, otherwise it is straight.
    5. *Right of way*: the party that has to yield at a junction according to the road file. Its priorities decide
       first, then its signs. Without both, the party has to yield that sees the other come from the right (Article 18).
       The reason says whether the other could still have braked.
    6. *Turning*: of two that came towards each other, the party that turns across the path of the other (Article 16).
    7. *Oncoming*: the party on the wrong side of the road according to the road file, else the party that left its line
       (Article 10 to 12).
    8. *Crossing*, *pedestrian*: one party came into the path of the other first. The second party is at fault if a
       careful and competent driver in its place would have avoided the first party (UN Regulation No. 157, Annex 4,
       Appendix 3; see `find_chance`). Otherwise the second party had too little time, and the first party is at fault
       if it could have acted: if that driver in its place would have avoided the second party, or if it has just
       started from standing or is on foot (Article 14 and 20).

    The fault is undecided if no rule says who is at fault. For example, both come at the same time, neither left its
    line, or the motion or the contact is unknown. The result stays the same if ego and other are swapped, or if the
    scene is turned or mirrored.
    """
    (other,) = (name for name in collision.entities if name != ego)
    contact = find_contact(recording, (ego, other), collision.time)
    if isinstance(contact, str):
        return Fault("undecided", "unknown", (None, None), None, (contact,))
    parties = tuple(Party.from_recording(recording, name, contact.time) for name in (ego, other))
    if any(len(party.time) < 2 for party in parties):
        return Fault("undecided", "unknown", contact.sides, contact.point, ("their motion before is unknown",))
    obstacles = list(iter_obstacles(recording, (ego, other), contact.time))
    case = _CollisionCase(parties[0], parties[1], contact, obstacles, roads_of(recording))
    ruling = case.apply_rules()
    who: Culprit = (
        "undecided" if not ruling.guilty else "both" if len(ruling.guilty) == 2 else ("ego", "other")[ruling.guilty[0]]
    )
    names = (quote_name(ego), quote_name(other))
    return Fault(who, ruling.conflict, contact.sides, contact.point, (ruling.reason.format(*names),))


class _CollisionCase:
    """A collision of two parties, 0 and 1, and the rules that find who is at fault."""

    def __init__(
        self, first: Party, second: Party, contact: Contact, obstacles: Sequence[Party], roads: RoadNetwork | None
    ) -> None:
        self.parties, self.contact, self._obstacles, self._roads = (first, second), contact, obstacles, roads
        self._chances: dict[int, AvoidanceChance] = {}
        self.speeds = [party.speed_at(contact.time) for party in self.parties]

    @cached_property
    def approach(self) -> ConflictApproach:
        return describe_approach(*self.parties, self.contact.time, self._roads)

    def chance(self, k: int) -> AvoidanceChance:
        """Return the chance that party `k` had to avoid the other party."""
        if k not in self._chances:
            self._chances[k] = find_chance(*self._pair(k), self.contact.time, self._obstacles)
        return self._chances[k]

    def _pair(self, k: int) -> tuple[Party, Party]:
        return self.parties[k], self.parties[1 - k]

    @cached_property
    def _yielding_party(self) -> int | None:
        """The party (0 or 1) that has to yield according to the road file.

        None if the road file does not say who has to yield, or if a party is on foot.
        """
        if self._roads is None or any(party.is_pedestrian for party in self.parties):
            return None
        return find_who_yields(self._roads, self.parties, self.contact.time)

    def apply_rules(self) -> _Ruling:
        """Apply the rules in their order, and return the result of the first rule that applies."""
        approach, is_on_foot = self.approach, any(party.is_pedestrian for party in self.parties)
        stands = [abs(speed) < STANDING_SPEED for speed in self.speeds]
        if all(stands):
            return _Ruling((), "standing", "both stand")
        if any(stands):
            return self._rule_standing(stands.index(True))
        if backing := tuple(k for k in (0, 1) if self.speeds[k] < 0.0 and self.contact.sides[k] == "rear"):
            names = " and ".join(f"{{{k}}}" for k in backing)
            return _Ruling(backing, "reversing", f"{names} {'back' if len(backing) > 1 else 'backs'} into the other")
        is_same = approach.angle < _SAME_DIRECTION
        if is_same and (approach.first_angle < _SAME_DIRECTION or is_on_foot):
            if rear_end := self._rule_rear_end():
                return rear_end
            if not is_on_foot:
                return self._rule_lane_change()
        if ruling := None if is_on_foot else self._rule_right_of_way():
            return ruling
        if approach.first_angle > _ONCOMING and not is_on_foot:
            turned = [abs(turn) for turn in approach.turns]
            for k in (0, 1):
                if turned[k] >= TURN and turned[1 - k] < STRAIGHT:
                    return _Ruling(
                        (k,), "turning", f"{{{k}}} turns across the path of {{{1 - k}}}, which comes towards it"
                    )
        if approach.angle > _ONCOMING and not is_on_foot:
            return self._rule_oncoming()
        return self._rule_crossing("pedestrian" if is_on_foot else "crossing")

    def _rule_standing(self, standing: int) -> _Ruling:
        moving = 1 - standing
        stopped = self._time_standing(standing)
        # A party that has stood for long enough could be seen standing.
        is_late = stopped is not None and stopped < REACTION_TIME and not self.parties[moving].is_pedestrian
        # A party that follows another has to keep a distance in which it can stop.
        is_late &= not self.approach.always_in_corridor[standing]
        if not is_late or self.chance(moving).could_avoid or not self.chance(standing).could_avoid:
            since = "all the time" if stopped is None else f"for {stopped:.1f} s"
            blocks = stopped is not None and stopped <= _RECENTLY and not self.approach.always_in_corridor[standing]
            if blocks and self._yielding_party == standing:
                return _Ruling(
                    (standing,), "standing",
                    f"{{{standing}}} has to yield to {{{moving}}} at the junction, and has stood in its way {since}",
                )  # fmt: skip
            return _Ruling((moving,), "standing", f"{{{standing}}} has stood {since} when {{{moving}}} moves into it")
        return _Ruling(
            (standing,), "standing",
            f"{{{standing}}} stops in the way of {{{moving}}} {self._describe_lateness(moving)}",
        )  # fmt: skip

    def _time_standing(self, k: int) -> float | None:
        """Return for how long in s before the contact a party has stood; None if it stood all the time."""
        party = self.parties[k]
        moving = np.flatnonzero(np.abs(party.speed) >= STANDING_SPEED)
        return self.contact.time - float(party.time[moving[-1]]) if len(moving) else None

    def _rule_rear_end(self) -> _Ruling | None:
        """Decide who is at fault if one party drives into the rear of the other; None if no party does."""
        for behind, ahead in ((0, 1), (1, 0)):
            if self.contact.sides[behind] == "front" and self.contact.sides[ahead] == "rear":
                late = self._cut_in_ttc_and_limit(behind, ahead)
                if late is None:
                    return _Ruling((behind,), "rear end", f"{{{behind}}} drives into the rear of {{{ahead}}}")
                ttc, least = late
                if ttc > least:
                    return _Ruling(
                        (behind,), "rear end",
                        f"{{{behind}}} drives into the rear of {{{ahead}}}, which cut in with a time to collision of"
                        f" {ttc:.2f} s, above {least:.2f} s",
                    )  # fmt: skip
                return _Ruling(
                    (ahead,), "rear end",
                    f"{{{ahead}}} cuts in with a time to collision of {ttc:.2f} s, not above {least:.2f} s",
                )  # fmt: skip
        return None

    def _cut_in_ttc_and_limit(self, behind: int, ahead: int) -> tuple[float, float] | None:
        """Return the time to collision in s when the party ahead cut in, and the limit in s that it had to exceed.

        None if the party ahead did not cut in, or if the gap was not shrinking when it cut in.
        """
        approach = self.approach
        if approach.always_in_corridor[ahead] or abs(approach.shifts[ahead]) < _LEFT_LINE:
            return None
        time = self.contact.time - approach.in_corridor[ahead]
        rear, front = self.parties[behind], self.parties[ahead]
        closing = abs(rear.speed_at(time)) - abs(front.speed_at(time))
        if closing <= 0.0:
            return None
        at = np.array([time])
        direction = rear.direction_at(time)
        along = np.array([np.cos(direction), np.sin(direction)])
        gap = float(
            (front.corners(front.poses_at(at))[0] @ along).min() - (rear.corners(rear.poses_at(at))[0] @ along).max()
        )
        return max(gap, 0.0) / closing, min_avoidable_time_to_collision(closing)

    def _rule_lane_change(self) -> _Ruling:
        shifts = self.approach.shifts
        drifting = [k for k in (0, 1) if shifts[k] >= _LEFT_LINE]
        if self.approach.is_lane_change_ambiguous:
            return _Ruling((), "lane change", "both turn, and the motion does not show who left its lane")
        if len(drifting) == 1:
            (k,) = drifting
            return _Ruling((k,), "lane change", f"{{{k}}} moves {shifts[k]:.1f} m sideways into {{{1 - k}}}")
        if drifting:
            return _Ruling((0, 1), "lane change", "{0} and {1} move sideways into each other")
        return _Ruling((), "lane change", "neither moves sideways")

    def _rule_right_of_way(self) -> _Ruling | None:
        """Decide that the party that has to yield is at fault.

        A party that reverses has to yield if the other does not reverse. Otherwise the road file decides; None if the
        road file does not say who has to yield.
        """
        reversing = [speed <= -STANDING_SPEED for speed in self.speeds]
        if reversing.count(True) == 1:
            k = reversing.index(True)
            conflict: Conflict = "reversing"
            reason = f"{{{k}}} backs into the way of {{{1 - k}}}"
        else:
            if self._yielding_party is None:
                return None
            k, conflict = self._yielding_party, "crossing"
            reason = f"{{{k}}} has to yield to {{{1 - k}}} at the junction"
        noticed = self.approach.in_corridor[k]
        if noticed > REACTION_TIME and can_brake(*self._pair(1 - k), self.contact.time - noticed):
            reason += f"; {{{1 - k}}} could still have avoided it {noticed:.1f} s before"
        return _Ruling((k,), conflict, reason)

    def _rule_oncoming(self) -> _Ruling:
        shifts = self.approach.shifts
        if self._roads is not None:
            wrong = [is_on_wrong_side(self._roads, party, self.contact.time) for party in self.parties]
            if wrong.count(True) == 1:
                return _Ruling(
                    (wrong.index(True),), "oncoming", f"{{{wrong.index(True)}}} is on the wrong side of the road"
                )
        # Parties that were in each other's path from the beginning did not leave a line to come there.
        left = [k for k in (0, 1) if abs(shifts[k]) >= _LEFT_LINE]
        if all(self.approach.always_in_corridor) or not left:
            return _Ruling((), "oncoming", "they come towards each other, and neither leaves its line")
        if len(left) == 1:
            (k,) = left
            return _Ruling((k,), "oncoming", f"{{{k}}} leaves its line by {abs(shifts[k]):.1f} m, towards {{{1 - k}}}")
        if self.approach.is_lane_change_ambiguous:
            return _Ruling((), "oncoming", "both turn, and the motion does not show who left its lane")
        return _Ruling((0, 1), "oncoming", "{0} and {1} leave their lines, towards each other")

    def _rule_crossing(self, conflict: Conflict) -> _Ruling:
        times = self.approach.in_corridor
        on_foot = [party.is_pedestrian for party in self.parties]
        if abs(times[0] - times[1]) < _AT_ONCE and not any(on_foot):
            return _Ruling(
                (), conflict, "both come into each other's way at the same time, and nothing says who is first"
            )
        first = 0 if times[0] > times[1] else 1
        if abs(times[0] - times[1]) < _AT_ONCE:
            first = on_foot.index(True)
        second = 1 - first
        if self.chance(second).could_avoid:
            return _Ruling(
                (second,), conflict, f"{{{second}}} could have avoided {{{first}}}, {self._describe_chance(second)}"
            )
        if not self.chance(second).is_whole:
            return _Ruling((), conflict, "the recording begins too late to show who could have acted")
        lateness = f"{{{first}}} comes into the way of {{{second}}} {self._describe_lateness(second)}"
        if self.chance(first).could_avoid or on_foot[first] or self._has_just_moved_off(first):
            return _Ruling((first,), conflict, lateness)
        return _Ruling((), conflict, f"{lateness}, and could not have avoided it either")

    def _has_just_moved_off(self, k: int) -> bool:
        """Return whether a party stood within the last 5 s, out of the path of the other, and could have waited."""
        party = self.parties[k]
        standing = party.time[np.abs(party.speed) < STANDING_SPEED]
        since = self.contact.time - float(standing[-1]) if len(standing) else np.inf
        return self.approach.in_corridor[k] <= since <= _RECENTLY

    def _describe_chance(self, k: int) -> str:
        latest = find_latest_braking(*self._pair(k), self.contact.time)
        text = f"which was foreseeable {self.chance(k).foreseeable:.1f} s before"
        return text if latest is None else f"{text}, by braking until {latest:.1f} s before"

    def _describe_lateness(self, k: int) -> str:
        return f"too late for it to brake, foreseeable {self.chance(k).foreseeable:.1f} s before they touch"
