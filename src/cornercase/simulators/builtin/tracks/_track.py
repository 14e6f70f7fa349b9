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
"""Track number of an entity that follows no track, and moves along its heading."""


@dataclass(frozen=True, eq=False)
class Pose:
    """Position (m) and heading (rad) in each scenario, arrays (N,), with road coordinates if they are known.

    `road` is the index of the road in the network. `offset` is in m to the left of the lane's centre, seen along s.
    `is_beyond_road`: True if the position in the file is beyond the end of the road, so that it was moved to this end.
    `relative_location`: file and line of a position that is relative to an entity, else empty. The move of such a
    position gives a notice; the move of any other position is an error.
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
        """Return road index, lane number and s in m; the pose must have road coordinates."""
        assert self.road is not None
        assert self.lane is not None
        assert self.s is not None
        return self.road, self.lane, self.s


def is_uniform(*arrays: FloatArray | None) -> bool:
    """Return whether each array (N, …) has the same bits in all N scenarios; None is skipped."""
    bits = (array.view(np.int64) for array in arrays if array is not None)
    return all(bool((array == array[:1]).all()) for array in bits)


class TrackPoints(NamedTuple):
    """One point of a track in each of R scenarios; all attributes have shape (R,)."""

    x: FloatArray
    y: FloatArray
    heading: FloatArray  # rad
    direction: FloatArray  # rad; direction of the track, which may differ from the heading
    has_heading: BoolArray  # whether the file gives the heading at this point
    time: FloatArray  # s, counted like the times of the track; NaN without times
    speed: FloatArray  # m/s; NaN without times
    s: FloatArray  # m, on the road of the lane; NaN if the track is no lane


class Track(ABC):
    """A curve that an entity follows: poses as a function of the distance along the curve.

    A track may differ between scenarios. Methods take the indices of R scenarios as `rows`. Kernels do the evaluation.
    """

    _table: TrackTable | None = None

    @property
    def table(self) -> TrackTable:
        """Table for kernels that holds this track alone; each change of the track makes a new table."""
        if self._table is None:
            self._table = self._make_table()
        return self._table

    @abstractmethod
    def _make_table(self) -> TrackTable:
        """Create the table for kernels. It holds only addresses, so the track must keep the arrays alive."""

    def evaluate(self, distance: FloatArray, offset: FloatArray, rows: IntArray) -> TrackPoints:
        """Evaluate the track at distances along it and offsets to its left, in m, shape (R,) each."""
        result = evaluate_track(self.table, np.array(rows), np.array([distance, offset]))
        x, y, heading, direction, has_heading, time, speed, s = result
        return TrackPoints(x, y, heading, direction, has_heading > 0.0, time, speed, s)

    def pose_at(
        self, distance: FloatArray, offset: FloatArray, rows: IntArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return x, y (m) and heading (rad) at distances along the track and offsets to its left, in m."""
        return self.evaluate(distance, offset, rows)[:3]

    @abstractmethod
    def nearest_distance(
        self, x: FloatArray, y: FloatArray, rows: IntArray, after: FloatArray | None = None
    ) -> FloatArray:
        """Return the distance in m along the track at which it is nearest to (x, y), shape (R,).

        If a lane track passes the point several times, the first pass beyond the distance `after` - 1 m counts, or the
        first of all if there is none.
        """

    def project_moving_point(self, x: FloatArray, y: FloatArray, rows: IntArray, before: FloatArray) -> FloatArray:
        """Return the distance in m along the track of a moving point (x, y); it was `before` one time step earlier."""
        return self.nearest_distance(x, y, rows, before)


class Trajectory(Track):
    """A track that a scenario file defines, with or without times.

    `lengths` (N,) are in m, and infinite for closed trajectories. `version` counts the changes of the trajectory.
    """

    lengths: FloatArray
    version: int

    @property
    @abstractmethod
    def times(self) -> FloatArray | None:
        """Times in s of the vertices, or of the ends of segments, shape (N, V); None for a trajectory without times."""

    @abstractmethod
    def curvature_at(self, distance: FloatArray, rows: IntArray) -> FloatArray:
        """Return the curvature in 1/m at distances along the trajectory in m, shape (R,); positive to the left."""

    def copy_scenarios_from(self, other: Trajectory, rows: BoolArray) -> None:
        """Copy the values in the scenarios of a mask from another trajectory of the same type."""
        for name in self._scenario_arrays:
            own = getattr(self, name)
            if own is not None:
                own[rows] = getattr(other, name)[rows]
        self.version += 1
        self._table = None

    _scenario_arrays: tuple[str, ...]
    """Names of the arrays with a row for each scenario."""
