"""What other braking would have changed: the ego on its own path, while the other moves as recorded.

Nothing is simulated. After the contact, the other goes straight on at its speed. Any contact counts that would happen
up to 5 s after the recorded one, also one with an ego that stands.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.metrics.fault._party import Party, boxes_touch
from cornercase.metrics.fault._reaction import REACTION_TIME, can_stop, full_braking_speeds
from cornercase.metrics.timeline._find_events import ANTICIPATION, BRAKING, EncounterEvents, find_events
from cornercase.recordings import Recording

EARLIER: Final = (0.3, 0.5, 1.0)
"""Times in s by which the braking is moved; from 1 s on it would often begin before anybody could have known."""

_AFTER: Final = 5.0
"""Time in s after the recorded contact until which there must be none: a car crosses a junction within that."""

_STEP: Final = 0.05

_SPEED_GAIN: Final = 0.5
"""Gain of speed in m/s above its lowest one from which the ego drives on: above what rounding or a controller does."""

_TOLERANCE: Final = 1e-9

Reply = Literal["none", "brakes", "drives on"]


@dataclass(frozen=True)
class CollisionReply:
    """What the ego did about a collision, and what else it could have done.

    `reply` is ``"none"`` if it did not brake, ``"brakes"`` if it braked or stood until the contact, ``"drives on"`` if
    it braked and sped up again before. `reaction` is the time in s from a foreseeable collision to braking, negative
    if it braked up to 0.5 s before; None if it did not brake because of it, as far as that is known. `seen_too_late`:
    not even full braking at once, since it could see the collision coming, lets the ego stand before they touch.

    `avoided_by` tells for each time of `EARLIER` whether there is no contact if the same braking begins that much
    earlier, but not before the ego could see the other, and if the ego then stops and waits; None without braking.
    `avoided` tells it of another alternative, None if it does not apply: without braking, to brake fully 1.15 s after
    the collision was foreseeable, as the careful driver of UN Regulation No. 157; and to stop and wait instead of
    driving on.
    """

    events: EncounterEvents
    reply: Reply
    reaction: float | None
    seen_too_late: bool
    avoided_by: tuple[bool, ...] | None
    avoided: bool | None


def find_reply(recording: Recording, ego: str, other: str, contact: float) -> CollisionReply | None:
    """Find what the ego did about a collision at a time in s; None if the motion of one of them is unknown."""
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
        return CollisionReply(events, "none", None, too_late, None, avoided)
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
    return CollisionReply(events, "drives on" if drives_on else "brakes", reaction, too_late, avoided_by, waits)


@dataclass(frozen=True, eq=False)
class _Encounter:
    """Motion of the ego and the other before they touch."""

    ego: Party
    other: Party
    contact: float

    @property
    def speeds(self) -> FloatArray:
        """Speed of the ego in m/s, shape (T,)."""
        return np.abs(self.ego.speed)

    def is_avoided_by_full_braking(self, foresees: float) -> bool:
        """Whether the careful driver of UN Regulation No. 157 avoids the contact, from a foreseeable danger on."""
        start = max(foresees, float(self.ego.time[0]))
        elapsed, speeds = full_braking_speeds(abs(self.ego.speed_at(start)), REACTION_TIME)
        return not self._touches(start, start + elapsed, speeds)

    def is_avoided_by_braking(self, times: FloatArray, speeds: FloatArray, earlier: float, earliest: float) -> bool:
        """Whether the same braking avoids the contact if it begins earlier by a time in s, and the ego stops and waits.

        `times` in s and `speeds` in m/s are those of the braking. It is held on the deceleration that was its hardest.
        The ego is at no time faster than it was.
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
        """Whether they touch until 5 s after the contact, if the ego drives with these speeds from a time in s on."""
        moments = np.arange(start, self.contact + _AFTER + _TOLERANCE, _STEP)
        driven_speeds = np.interp(moments, times, speeds)
        driven = np.append(0.0, np.cumsum(0.5 * (driven_speeds[1:] + driven_speeds[:-1]) * _STEP))
        poses = self.ego.poses_along(float(np.interp(start, self.ego.time, self.ego.distance)) + driven)
        return bool(boxes_touch(self.ego, poses, self.other, self.other.poses_at(moments)).any())


def _hardest_deceleration(times: FloatArray, speeds: FloatArray) -> float:
    """Hardest deceleration in m/s², at least that of braking."""
    return max(BRAKING, *(-np.diff(speeds) / np.diff(times)).tolist()) if len(times) > 1 else BRAKING
