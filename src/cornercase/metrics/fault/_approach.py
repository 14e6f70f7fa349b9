"""Description of how the two parties to a collision approached each other.

The description says from which directions the parties came, who was in whose path, and who left its line of travel.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from cornercase._common.geometry.boxes import wrap_angle
from cornercase.metrics.fault._party import Party, boxes_touch

if TYPE_CHECKING:
    from cornercase.roads._network import RoadNetwork

_LOOK_BACK: Final = 6.0
"""Length in s of the time before the contact that is considered."""

_STEP: Final = 0.1
_SPACING: Final = 0.5
_EXTENSION: Final = 20.0
"""Length in m by which a corridor (area that a box will sweep) goes straight on after the contact."""

STRAIGHT: Final = np.radians(10.0)
"""Change of direction in rad below which an entity goes straight on."""

TURN: Final = np.radians(20.0)
"""Change of direction in rad from which an entity turns."""


@dataclass(frozen=True)
class ConflictApproach:
    """Description of how the two parties to a collision approached each other; pairs of values are in their order.

    `angle` is the angle between the directions of motion at the contact, `first_angle` the angle at the beginning, in
    rad from 0 to π. `turns` are the changes of direction in rad, positive to the left. The corridor of a party is the
    area that its box will sweep from an instant on. `in_corridor` is the time in s before the contact during which each
    party was in the corridor of the other without interruption. `always_in_corridor` says whether this was so from the
    beginning. `shifts` are the distances in m by which each party left its first line of travel, positive towards the
    side on which the other party was at the beginning. The first line follows the road if `along_road` is True,
    otherwise it is straight.
    """

    angle: float
    first_angle: float
    turns: tuple[float, float]
    in_corridor: tuple[float, float]
    always_in_corridor: tuple[bool, bool]
    shifts: tuple[float, float]
    along_road: bool

    @property
    def is_lane_change_ambiguous(self) -> bool:
        """True if both parties turn to the same side, by 10° or more, and no road shows which party left its lane."""
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
    by_road = None if network is None else _lateral_shifts_on_road(network, pair, contact, begin)
    times = [_time_in_corridor(party, other, contact, begin) for party, other in ((first, second), (second, first))]
    return ConflictApproach(
        angle=abs(float(wrap_angle(ends[1] - ends[0]))),
        first_angle=abs(float(wrap_angle(starts[1] - starts[0]))),
        turns=(float(wrap_angle(ends[0] - starts[0])), float(wrap_angle(ends[1] - starts[1]))),
        in_corridor=(times[0], times[1]),
        always_in_corridor=(times[0] >= contact - begin - _STEP, times[1] >= contact - begin - _STEP),
        shifts=by_road
        or (_lateral_shift(first, second, contact, begin), _lateral_shift(second, first, contact, begin)),
        along_road=by_road is not None,
    )


def _time_in_corridor(party: Party, other: Party, contact: float, begin: float) -> float:
    """Return the time in s before the contact during which a party was always in the corridor of the other party.

    The corridor is the area that the box of the other party will sweep from each instant on.
    """
    instants = contact - _STEP * np.arange(1, max(int((contact - begin) / _STEP + 1e-6), 0) + 1)
    ends = np.interp(np.append(contact, instants), other.time, other.distance)
    path = np.arange(ends.min(), ends.max() + _EXTENSION, _SPACING)
    x, y, heading = party.poses_at(instants)
    overlaps = boxes_touch(party, (x[:, None], y[:, None], heading[:, None]), other, other.poses_along(path))
    overlaps &= path >= ends[1:, None] - _SPACING
    is_free = ~overlaps.any(axis=1)
    return _STEP * (int(is_free.argmax()) if is_free.any() else len(instants))


def _lateral_shifts_on_road(
    network: RoadNetwork, pair: tuple[Party, Party], contact: float, begin: float
) -> tuple[float, float] | None:
    """Return the distances in m by which both parties left their first lines, measured along one road.

    The road is used because a party that keeps its lane in a bend leaves a straight line. None unless both parties are
    in lanes of the same road, outside of junctions, at the beginning and at the contact.
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


def _lateral_shift(party: Party, other: Party, contact: float, begin: float) -> float:
    """Return the distance in m from a party at the contact to the straight line on which it moved at the beginning.

    The distance is positive towards the side on which the other party was at the beginning.
    """
    direction = party.direction_at(begin)
    sideways = np.array([-np.sin(direction), np.cos(direction)])
    positions = [
        np.array([np.interp(time, entity.time, entity.x), np.interp(time, entity.time, entity.y)])
        for entity, time in ((party, begin), (party, contact), (other, begin))
    ]
    side = float(sideways @ (positions[2] - positions[0]))
    shift = float(sideways @ (positions[1] - positions[0]))
    return shift if side >= 0.0 else -shift
