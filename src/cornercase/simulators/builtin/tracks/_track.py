"""Base classes of lanes and trajectories that entities follow."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.simulators.builtin.track_kernels._track_dispatch import evaluate_track
from cornercase.simulators.builtin.track_kernels._track_layout import TrackTable

NO_TRACK: Final = -1
"""Track number of an entity that follows none, and moves along its heading."""


@dataclass(frozen=True, eq=False)
class Pose:
    """Position and heading in each scenario, arrays (N,), with road coordinates if they are known.

    `road` is the index of the road in the network, `offset` in m to the left of the lane's centre seen along s.
    `is_beyond_road`: whether the file's position is beyond the end of its road, and moved there. `relative_location`:
    file and line of a position relative to an entity, for which that end is what is meant.
    """

    x: FloatArray
    y: FloatArray
    heading: FloatArray
    road: IntArray | None = None
    lane: IntArray | None = None
    s: FloatArray | None = None
    offset: FloatArray | None = None
    is_beyond_road: BoolArray | None = None
    relative_location: str = ""

    def road_coordinates(self) -> tuple[IntArray, IntArray, FloatArray]:
        """Return road, lane and s, which the pose must have."""
        assert self.road is not None
        assert self.lane is not None
        assert self.s is not None
        return self.road, self.lane, self.s


def is_uniform(*arrays: FloatArray | None) -> bool:
    """Return whether each array, shape (N, …), is bitwise the same in all scenarios; None is skipped."""
    bits = (array.view(np.int64) for array in arrays if array is not None)
    return all(bool((array == array[:1]).all()) for array in bits)


class TrackPoints(NamedTuple):
    """One point of a track in each of R scenarios; every attribute has shape (R,)."""

    x: FloatArray
    y: FloatArray
    heading: FloatArray  # rad
    direction: FloatArray  # rad, of the line, whatever the entity's heading is
    has_heading: BoolArray  # whether the file gives the heading there
    time: FloatArray  # s, on the track's own clock; NaN without times
    speed: FloatArray  # m/s; NaN without times
    s: FloatArray  # m, on the road of the lane; NaN beside lanes


class Track(ABC):
    """A curve that an entity follows, as a function of the distance along it; kernels evaluate it.

    A track may differ between scenarios. Methods take R scenarios, the `rows`.
    """

    _table: TrackTable | None = None

    @property
    def table(self) -> TrackTable:
        """Return a table for kernels with this track alone; a new object after each change of the track."""
        if self._table is None:
            self._table = self._make_table()
        return self._table

    @abstractmethod
    def _make_table(self) -> TrackTable:
        """Create the table for kernels; the track keeps the arrays in it alive."""

    def evaluate(self, distance: FloatArray, offset: FloatArray, rows: IntArray) -> TrackPoints:
        """Evaluate the track at distances and left offsets in m, each (R,)."""
        result = evaluate_track(self.table, np.array(rows), np.array([distance, offset]))
        x, y, heading, direction, has_heading, time, speed, s = result
        return TrackPoints(x, y, heading, direction, has_heading > 0.0, time, speed, s)

    def pose_at(
        self, distance: FloatArray, offset: FloatArray, rows: IntArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return x, y (m) and heading (rad) at distances and left offsets in m, shape (R,) each."""
        return self.evaluate(distance, offset, rows)[:3]

    @abstractmethod
    def nearest_distance(
        self, x: FloatArray, y: FloatArray, rows: IntArray, after: FloatArray | None = None
    ) -> FloatArray:
        """Return the distance in m along the track of its point nearest to (x, y), at the first pass beyond `after`."""

    def nearby_distance(self, x: FloatArray, y: FloatArray, rows: IntArray, before: FloatArray) -> FloatArray:
        """Return the distance in m along the track of what moves along it and was at `before`, shape (R,)."""
        return self.nearest_distance(x, y, rows, before)


class Trajectory(Track):
    """A track that a scenario file defines, with or without times.

    `lengths` (N,) are in m, and infinite for closed trajectories. `version` is the number of calls of `copy_rows_from`.
    """

    lengths: FloatArray
    version: int

    @property
    @abstractmethod
    def times(self) -> FloatArray | None:
        """Return the times of the vertices, or of start and end, in s, shape (N, V); None without times."""

    @abstractmethod
    def curvature_at(self, distance: FloatArray, rows: IntArray) -> FloatArray:
        """Return the curvature in 1/m, positive to the left, at distances in m, shape (R,)."""

    def copy_rows_from(self, other: Trajectory, rows: BoolArray) -> None:
        """Copy the scenarios of a mask from another trajectory of the same type."""
        for name in self._scenario_arrays:
            own = getattr(self, name)
            if own is not None:
                own[rows] = getattr(other, name)[rows]
        self.version += 1
        self._table = None

    _scenario_arrays: tuple[str, ...]
    """Names of the arrays with a row for each scenario."""
