"""Base classes of lanes and trajectories that entities follow."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Final

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray, IntArray

NO_TRACK: Final = -1
"""Track number of an entity that follows none, and moves along its heading."""

ALONG_SEGMENTS, AT_CORNERS, AT_VERTICES = "legs", "corners", "vertices"
"""Where the heading changes along a trajectory: over whole segments, near corners, or at each vertex at once."""


@dataclass(frozen=True, eq=False)
class Pose:
    """A position and heading for each scenario, arrays (N,), with road coordinates if known."""

    x: FloatArray
    y: FloatArray
    heading: FloatArray
    road: IntArray | None = None  # index of the road in the network
    lane: IntArray | None = None
    s: FloatArray | None = None
    offset: FloatArray | None = None  # m, to the left of the lane's centre seen along s
    is_beyond_road: BoolArray | None = (
        None  # whether the file's position is beyond the end of its road, and moved there
    )
    relative_location: str = (
        ""  # file and line of a position relative to an entity, for which that end is what is meant
    )

    def road_coordinates(self) -> tuple[IntArray, IntArray, FloatArray]:
        """Road, lane and s, which the pose must have."""
        assert self.road is not None
        assert self.lane is not None
        assert self.s is not None
        return self.road, self.lane, self.s


def is_uniform(*arrays: FloatArray | None) -> bool:
    """Whether each array, shape (N, …), is bitwise the same in all scenarios; None is skipped."""
    bits = (array.view(np.int64) for array in arrays if array is not None)
    return all(bool((array == array[:1]).all()) for array in bits)


class Track(ABC):
    """A curve that an entity follows, by distance along it.

    It may differ between scenarios; methods take R scenarios, the `rows`.
    """

    @abstractmethod
    def pose_at(
        self, distance: FloatArray, offset: FloatArray, rows: IntArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """x, y (m) and heading (rad) at distances and left offsets in m, each (R,)."""

    @abstractmethod
    def nearest_distance(
        self, x: FloatArray, y: FloatArray, rows: IntArray, after: FloatArray | None = None
    ) -> FloatArray:
        """Distance along the track, in m, of its point nearest to (x, y).

        If it passes the point more than once, the first time after the distance `after` counts.
        """

    @abstractmethod
    def curvature_at(self, distance: FloatArray, rows: IntArray) -> FloatArray:
        """Curvature in 1/m, positive to the left, at distances of shape (R,)."""


class Trajectory(Track):
    """A track that a scenario file defines, with or without times.

    `lengths`, shape (N,), in m, is inf for closed ones. `version` counts the changes by `copy_rows_from`.
    """

    lengths: FloatArray
    version: int

    @property
    @abstractmethod
    def times(self) -> FloatArray | None:
        """Times in s of its vertices, or of start and end, shape (N, V); None without times."""

    @abstractmethod
    def distance_at_time(self, time: FloatArray) -> FloatArray:
        """Distance along the trajectory in m at its own times, shape (N,)."""

    @abstractmethod
    def time_and_speed_at(self, distance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Its own time in s and speed in m/s at distances along it, each (N,)."""

    @abstractmethod
    def has_heading_at(self, distance: FloatArray, rows: IntArray) -> BoolArray:
        """Whether the file gives the heading at a distance, shape (R,)."""

    @abstractmethod
    def direction_at(self, distance: FloatArray, rows: IntArray) -> FloatArray:
        """Direction of the line in rad, whatever the entity's heading is, shape (R,)."""

    def copy_rows_from(self, other: Trajectory, rows: BoolArray) -> None:
        """Copy another trajectory of the same kind in the scenarios of a mask, shape (N,)."""
        for name in self._scenario_arrays:
            own = getattr(self, name)
            if own is not None:
                own[rows] = getattr(other, name)[rows]
        self.version += 1

    _scenario_arrays: tuple[str, ...]
    """Names of the arrays with a row for each scenario."""
