"""How two parties came together: from which direction, who was in whose way first, and who left its line."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from cornercase._common.geometry.boxes import wrap_angle
from cornercase.metrics.fault._party import Party, boxes_touch

if TYPE_CHECKING:
    from cornercase.roads._network import RoadNetwork

_LOOK_BACK: Final = 6.0
"""Time in s before the contact from which on the approach is considered."""

_STEP: Final = 0.1
_SPACING: Final = 0.5
_EXTENSION: Final = 20.0
"""Length in m by which a corridor goes straight on behind the contact."""

STRAIGHT: Final = np.radians(10.0)
"""Change of direction in rad below which an entity goes straight on."""

TURN: Final = np.radians(20.0)
"""Change of direction in rad from which an entity turns."""


@dataclass(frozen=True)
class ConflictApproach:
    """How two parties, the first and the second, approached each other.

    `angle` is the angle between their directions of motion at the contact, and `first_angle` that at the beginning, in
    rad from 0 to π. `turns` are the changes of direction of each in rad, positive to the left. `in_corridor` is the
    time before the contact in s since when each is without interruption in the corridor that the other has still to
    drive, and `always_in_corridor` says whether it was so from the beginning. `shifts` are the distances in m by which
    each left its first line, positive towards the side on which the other was; `along_road` says whether the line of
    both is that of the road, else it is straight.
    """

    angle: float
    first_angle: float
    turns: tuple[float, float]
    in_corridor: tuple[float, float]
    always_in_corridor: tuple[bool, bool]
    shifts: tuple[float, float]
    along_road: bool

    @property
    def turns_hide_lanes(self) -> bool:
        """Whether both turn the same way, and no road says which of them left its lane."""
        both_turn = min(map(abs, self.turns)) >= STRAIGHT and self.turns[0] * self.turns[1] > 0.0
        return both_turn and not self.along_road


def describe_approach(
    first: Party, second: Party, contact: float, network: RoadNetwork | None = None
) -> ConflictApproach:
    """Describe how two parties approached each other in the last 6 s before their contact."""
    begin = max(float(first.time[0]), float(second.time[0]), contact - _LOOK_BACK)
    pair = (first, second)
    starts = [party.direction_at(begin) for party in pair]
    ends = [party.direction_at(contact) for party in pair]
    by_road = None if network is None else _shifts_along_road(network, pair, contact, begin)
    times = [_time_in_corridor(party, other, contact, begin) for party, other in ((first, second), (second, first))]
    return ConflictApproach(
        angle=abs(float(wrap_angle(ends[1] - ends[0]))),
        first_angle=abs(float(wrap_angle(starts[1] - starts[0]))),
        turns=(float(wrap_angle(ends[0] - starts[0])), float(wrap_angle(ends[1] - starts[1]))),
        in_corridor=(times[0], times[1]),
        always_in_corridor=(times[0] >= contact - begin - _STEP, times[1] >= contact - begin - _STEP),
        shifts=by_road or (_shift(first, second, contact, begin), _shift(second, first, contact, begin)),
        along_road=by_road is not None,
    )


def _time_in_corridor(party: Party, other: Party, contact: float, begin: float) -> float:
    """Time in s before the contact since when a box is in the corridor that the other still has to drive."""
    instants = contact - _STEP * np.arange(1, max(int((contact - begin) / _STEP + 1e-6), 0) + 1)
    ends = np.interp(np.append(contact, instants), other.time, other.distance)
    path = np.arange(ends.min(), ends.max() + _EXTENSION, _SPACING)
    x, y, heading = party.poses_at(instants)
    overlaps = boxes_touch(party, (x[:, None], y[:, None], heading[:, None]), other, other.poses_along(path))
    overlaps &= path >= ends[1:, None] - _SPACING
    is_free = ~overlaps.any(axis=1)
    return _STEP * (int(is_free.argmax()) if is_free.any() else len(instants))


def _shifts_along_road(
    network: RoadNetwork, pair: tuple[Party, Party], contact: float, begin: float
) -> tuple[float, float] | None:
    """Distances in m by which both left their first lines along one road; None if they are not on one all the time.

    In a bend, whoever keeps its lane leaves a straight line.
    """
    times = np.array([begin, contact])
    x, y = (
        np.concatenate([np.interp(times, party.time, values) for party, values in zip(pair, lines, strict=True)])
        for lines in ([party.x for party in pair], [party.y for party in pair])
    )
    coordinates = network.locate(x, y)
    road = int(coordinates.road[0])
    if (
        (coordinates.lane == 0).any()
        or (coordinates.road != road).any()
        or network.roads[road].junction not in ("", "-1")
    ):
        return None
    road_x, road_y, heading = network.road_to_xy_heading(road, coordinates.s, np.zeros(4))
    aside = (y - road_y) * np.cos(heading) - (x - road_x) * np.sin(heading)
    towards = 1.0 if aside[2] >= aside[0] else -1.0
    return float(towards * (aside[1] - aside[0])), float(-towards * (aside[3] - aside[2]))


def _shift(party: Party, other: Party, contact: float, begin: float) -> float:
    """Distance in m by which a party left its first line, positive towards where the other is at the contact."""
    direction = party.direction_at(begin)
    sideways = np.array([-np.sin(direction), np.cos(direction)])
    positions = [
        np.array([np.interp(time, entity.time, entity.x), np.interp(time, entity.time, entity.y)])
        for entity, time in ((party, begin), (party, contact), (other, begin))
    ]
    side = float(sideways @ (positions[2] - positions[0]))
    shift = float(sideways @ (positions[1] - positions[0]))
    return shift if side >= 0.0 else -shift
