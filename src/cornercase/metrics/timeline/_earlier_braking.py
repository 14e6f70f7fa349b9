"""Whether the ego would have avoided a collision if it had braked differently, such as earlier.

Nothing is simulated: the ego stays on its path, and the other entity moves as recorded. After the recorded contact, the
other entity goes straight on at constant speed. A collision counts as avoided only if the boxes do not touch until 5 s
after the recorded contact. So the other entity must not run into an ego that stands, either.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.metrics.fault._avoidability import REACTION_TIME, can_stop, full_braking_speeds
from cornercase.metrics.fault._party import Party, boxes_touch
from cornercase.metrics.timeline._find_events import ANTICIPATION, BRAKING, EncounterEvents, find_events
from cornercase.recordings import Recording

EARLIER: Final = (0.3, 0.5, 1.0)
"""Times in s by which braking is moved forward.

By more than 1 s, it would often begin before anybody could have known of the danger.
"""

_AFTER: Final = 5.0
"""Time in s after the recorded contact in which no contact may happen, so that the collision is avoided.

A car crosses a junction within this time.
"""

_STEP: Final = 0.05

_SPEED_GAIN: Final = 0.5
"""Gain in m/s above the lowest speed from which the ego counts as driving on after braking.

It is larger than effects of rounding or of a controller.
"""

_TOLERANCE: Final = 1e-9

Reply = Literal["none", "brakes", "drives on"]


@dataclass(frozen=True)
class EgoReaction:
    """Reaction of the ego to a collision with another entity, and what else would have avoided the collision.

    `reply` is ``"none"`` if the ego did not begin to brake, or to brake harder, in sight of the other entity within the
    10 s before the contact. It is ``"brakes"`` if the ego braked or stood until the contact, and ``"drives on"`` if it
    braked and sped up again before the contact. `reaction` is the time in s from the instant at which the collision
    became foreseeable to the begin of braking. It is negative if the ego braked earlier, by up to 0.5 s. It is None if
    `reply` is ``"none"``, if the ego braked too early to react to this collision, or if the collision never was
    foreseeable. `seen_too_late` is True if the ego could not stand before the contact even by full braking at the
    instant at which the collision became foreseeable, or if the collision never was foreseeable.

    `avoided_by` has one value for each time in `EARLIER`: whether the collision is avoided if the ego begins the same
    braking earlier by this time, and then stops and waits. But the ego does not brake before it could see the other
    entity. `avoided_by` is None if `reply` is ``"none"``. `avoided` says whether another alternative avoids the
    collision. If `reply` is ``"none"``, the alternative is to brake fully 1.15 s after the collision became
    foreseeable, like the careful driver of UN Regulation No. 157; None if it never was foreseeable. If the ego drove
    on, the alternative is to stop and wait. If `reply` is ``"brakes"``, `avoided` is None.
    """

    events: EncounterEvents
    reply: Reply
    reaction: float | None
    seen_too_late: bool
    avoided_by: tuple[bool, ...] | None
    avoided: bool | None


def find_ego_reaction(recording: Recording, ego: str, other: str, contact: float) -> EgoReaction | None:
    """Find how the ego reacted to a collision at the time `contact` in s, and what else would have avoided it.

    None if the motion of one of the entities is unknown.
    """
    party, partner = (Party.from_recording(recording, name, contact) for name in (ego, other))
    if min(len(party.time), len(partner.time)) < 2:
        return None
    events = find_events(recording, ego, other, contact)
    encounter = _Encounter(party, partner, contact)
    begin = float(encounter.ego.time[0])
    sees = None if events.sees is None else max(events.sees, begin)
    too_late = events.foresees is None or not can_stop(party, partner, max(events.foresees, begin))
    if sees is None or events.brakes is None or events.brakes < begin:
        avoided = None if events.foresees is None else encounter.is_avoided_by_full_braking(events.foresees)
        return EgoReaction(events, "none", None, too_late, None, avoided)
    reaction = None
    if events.foresees is not None and events.brakes >= events.foresees - ANTICIPATION - _TOLERANCE:
        reaction = events.brakes - events.foresees
    # The acceleration of an instant may be that of the time step before it.
    first = max(int(np.searchsorted(encounter.ego.time, events.brakes - _TOLERANCE)) - 1, 0)
    times, speeds = encounter.ego.time[first:], encounter.speeds[first:]
    lowest = int(speeds.argmin())
    drives_on = bool(speeds[-1] > speeds[lowest] + _SPEED_GAIN)
    if drives_on:
        times, speeds = times[: lowest + 1], speeds[: lowest + 1]
    avoided_by = tuple(encounter.is_avoided_by_braking(times, speeds, earlier, sees) for earlier in EARLIER)
    waits = encounter.is_avoided_by_braking(times, speeds, 0.0, sees) if drives_on else None
    return EgoReaction(events, "drives on" if drives_on else "brakes", reaction, too_late, avoided_by, waits)


@dataclass(frozen=True, eq=False)
class _Encounter:
    """Motion of the ego and of the other entity until they touch at the time `contact` in s."""

    ego: Party
    other: Party
    contact: float

    @property
    def speeds(self) -> FloatArray:
        """Speed of the ego in m/s, shape (T,)."""
        return np.abs(self.ego.speed)

    def is_avoided_by_full_braking(self, foresees: float) -> bool:
        """Return whether the careful driver of UN Regulation No. 157 avoids the contact.

        `foresees` is the time in s at which the danger becomes foreseeable.
        """
        start = max(foresees, float(self.ego.time[0]))
        elapsed, speeds = full_braking_speeds(abs(self.ego.speed_at(start)), REACTION_TIME)
        return not self._touches(start, start + elapsed, speeds)

    def is_avoided_by_braking(self, times: FloatArray, speeds: FloatArray, earlier: float, earliest: float) -> bool:
        """Return whether the ego avoids the contact if it brakes as recorded, but earlier, and then stops and waits.

        `times` in s and `speeds` in m/s are the recorded braking. It is moved forward by `earlier` in s, but begins no
        earlier than the time `earliest` in s. Afterwards, the ego keeps its hardest deceleration until it stands. The
        ego is never faster than recorded.
        """
        start = min(max(float(times[0]) - earlier, earliest), float(times[0]))
        deceleration = _hardest_deceleration(times, speeds)
        moved_times = times - (float(times[0]) - start)
        moved = np.maximum(speeds + abs(self.ego.speed_at(start)) - speeds[0], 0.0)
        after = np.arange(_STEP, self.contact + _AFTER + 1.0 - moved_times[-1], _STEP)
        braking_times = np.append(moved_times, moved_times[-1] + after)
        braking = np.append(moved, np.maximum(moved[-1] - deceleration * after, 0.0))
        as_recorded = np.interp(braking_times, self.ego.time, self.speeds)
        is_recorded = braking_times <= float(times[-1]) + _TOLERANCE
        return not self._touches(start, braking_times, np.where(is_recorded, np.minimum(braking, as_recorded), braking))

    def _touches(self, start: float, times: FloatArray, speeds: FloatArray) -> bool:
        """Return whether the boxes touch until 5 s after the recorded contact, if the ego drives with these speeds.

        From the time `start` in s on, the ego has the `speeds` in m/s at the `times` in s.
        """
        moments = np.arange(start, self.contact + _AFTER + _TOLERANCE, _STEP)
        driven_speeds = np.interp(moments, times, speeds)
        driven = np.append(0.0, np.cumsum(0.5 * (driven_speeds[1:] + driven_speeds[:-1]) * _STEP))
        poses = self.ego.poses_along(float(np.interp(start, self.ego.time, self.ego.distance)) + driven)
        return bool(boxes_touch(self.ego, poses, self.other, self.other.poses_at(moments)).any())


def _hardest_deceleration(times: FloatArray, speeds: FloatArray) -> float:
    """Return the hardest deceleration in m/s², but at least the deceleration from which the ego counts as braking."""
    return max(BRAKING, *(-np.diff(speeds) / np.diff(times)).tolist()) if len(times) > 1 else BRAKING
