"""Cross-sections along a path on lanes: the lanes beside the path, and the signals along the path."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.roads._lane_path import LanePath
from cornercase.roads._network import RoadNetwork
from cornercase.roads._road import Road

NO_LANE: Final = -1
"""Column of a point that is on no lane."""


@dataclass(frozen=True, eq=False)
class CrossSections:
    """The lanes at the P samples of a path, in L columns from left to right, as seen along the path.

    The path follows the lanes in the column `own`. The center lane 0 has no column. Arrays of shape (P, L): `left` and
    `right` are the offsets of a lane's edges from the path in m, positive to the left, NaN where there is no lane.
    `lane_type` is an index in `types`. `is_along` is True if traffic on the lane drives in the direction of the path.
    `speed_limit` is in m/s, NaN if unknown. `signals` has the name, type and distance along the path in m of each
    signal that concerns traffic on the path.
    """

    path: LanePath
    own: int
    left: FloatArray
    right: FloatArray
    lane_type: IntArray
    is_along: BoolArray
    speed_limit: FloatArray
    types: tuple[str, ...]
    signals: tuple[tuple[str, str, float], ...]
    _stretch: IntArray

    @classmethod
    def along(cls, network: RoadNetwork, path: LanePath) -> CrossSections:
        """Return the cross-sections along a path on a network; computed once for each path."""
        if "cross-sections" not in path.cache:
            path.cache["cross-sections"] = cls._compute(network, path)
        sections: CrossSections = path.cache["cross-sections"]
        return sections

    @classmethod
    def _compute(cls, network: RoadNetwork, path: LanePath) -> CrossSections:
        stretches = list(_iter_stretches(network, path))
        numbers = [0, *(number for *_, columns in stretches for number in columns.values())]
        to_left, to_right = max(numbers), -min(numbers)
        shape = len(path.distance), to_left + to_right + 1
        left, right, limit = (np.full(shape, np.nan) for _ in range(3))
        lane_type, is_along = np.zeros(shape, dtype=np.int64), np.zeros(shape, dtype=np.bool_)
        types = dict[str, int]()
        for rows, road, section, columns in stretches:
            s, lane, forward = path.s[rows], int(path.lane[rows.start]), bool(path.forward[rows.start])
            center, sign = road.lane_center(section, lane, s), 1.0 if forward else -1.0
            for number, to_the_left in columns.items():
                column = to_left - to_the_left
                edges = [sign * (edge - center) for edge in road.lane_edge_offsets(section, number, s)]
                left[rows, column], right[rows, column] = np.maximum(*edges), np.minimum(*edges)
                lane_type[rows, column] = types.setdefault(road.sections[section][1][number].lane_type, len(types))
                is_along[rows, column] = road.is_traffic_forward(number, s) == forward
                limit[rows, column] = road.speed_limit(section, number, s)
        return cls(
            path,
            to_left,
            left,
            right,
            lane_type,
            is_along,
            limit,
            tuple(types),
            tuple(_find_signals(network, path)),
            np.repeat(range(len(stretches)), [rows.stop - rows.start for rows, *_ in stretches]),
        )

    def edges_at(self, distance: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
        """Return the index of the last sample up to each distance along the path, and the edges of all lanes.

        Between two samples on different lanes or lane sections, the nearer sample counts instead of the last one.
        `distance` is in m, and can have any shape. The left and right edges of the lanes at this distance are offsets
        from the path in m, in arrays whose last axis is the lane.
        """
        stations = self.path.distance
        k = np.clip(np.searchsorted(stations, distance, "right") - 1, 0, len(stations) - 2)
        share = np.clip((distance - stations[k]) / (stations[k + 1] - stations[k]), 0.0, 1.0)
        share = np.where(self._stretch[k] == self._stretch[k + 1], share, np.round(share))[..., None]
        left, right = (
            np.where(share == 1.0, edge[k + 1], edge[k] + share * (edge[k + 1] - edge[k]))
            for edge in (self.left, self.right)
        )
        return k + (share[..., 0] == 1.0), left, right

    def lane_column_at(self, distance: FloatArray, offset: FloatArray) -> IntArray:
        """Return the column of the lane that contains each point; `NO_LANE` for a point on no lane.

        A point on the common edge of two lanes belongs to the left lane. Points are given by `distance` along the path
        and `offset` from the path, positive to the left; both are in m.
        """
        _, left, right = self.edges_at(distance)
        holds = (right <= offset[..., None]) & (offset[..., None] <= left) & (right < left)
        return np.where(holds.any(axis=-1), holds.argmax(axis=-1), NO_LANE)


def _iter_stretches(network: RoadNetwork, path: LanePath) -> Iterator[tuple[slice, Road, int, dict[int, int]]]:
    """Yield each stretch of a path on one lane: slice of the samples, road, lane section, and positions of lanes.

    A position says how many lanes a lane of the section is to the left of the path's lane, negative to the right. The
    positions are given by lane number.
    """
    section = np.zeros(len(path.road), dtype=np.int64)
    for r in np.unique(path.road):
        rows = path.road == r
        section[rows] = network.roads[r].section_at(path.s[rows])
    for rows in _iter_constant_runs(path.road, section, path.lane, path.forward):
        road, k, lane = network.roads[path.road[rows.start]], int(section[rows.start]), int(path.lane[rows.start])
        sign = 1 if path.forward[rows.start] else -1
        yield rows, road, k, {n: sign * (_lane_position(n) - _lane_position(lane)) for n in road.sections[k][1]}


def _iter_constant_runs(*values: npt.NDArray[Any]) -> Iterator[slice]:
    """Yield slices of consecutive samples in which no value changes."""
    changes = np.any([value[1:] != value[:-1] for value in values], axis=0)
    ends = [*(np.flatnonzero(changes) + 1).tolist(), len(values[0])]
    yield from (slice(start, end) for start, end in zip([0, *ends[:-1]], ends, strict=True))


def _lane_position(lane: int) -> int:
    """Return the position of a lane among all lanes, in which the lanes 1 and -1 are neighbours."""
    return lane - 1 if lane > 0 else lane


def _find_signals(network: RoadNetwork, path: LanePath) -> Iterator[tuple[str, str, float]]:
    """Yield name, type and distance along a path of each signal that concerns its traffic, in the order of the path."""
    types = {signal.name: signal.signal_type for road in network.roads for signal in road.signals if signal.signal_type}
    # Roads begin and end between samples.
    margin = 1.5 * float(path.distance[1] - path.distance[0])
    for rows in _iter_constant_runs(path.road, path.forward):
        forward, s = bool(path.forward[rows.start]), path.s[rows]
        signals = network.roads[path.road[rows.start]].signals
        for signal in signals if forward else reversed(signals):
            if s.min() - margin <= signal.s <= s.max() + margin:
                k = int(np.abs(s - signal.s).argmin())
                beyond = signal.s - s[k] if forward else s[k] - signal.s
                if signal.concerns(int(path.lane[rows][k]), forward):
                    yield signal.name, types.get(signal.name, ""), float(path.distance[rows][k] + beyond)
