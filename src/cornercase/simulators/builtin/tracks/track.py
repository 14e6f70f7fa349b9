"""Lanes and trajectories that entities follow."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Final

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray, IntArray

FREE: Final = -1
"""Number of no track: the entity goes where its heading points."""

ALONG_LEGS, AT_CORNERS, AT_VERTICES = "legs", "corners", "vertices"
"""Where the heading turns along a trajectory: over whole legs, near corners, or at each vertex at once."""


@dataclass(frozen=True, eq=False)
class Pose:
    """A place for each scenario.

    Attributes
    ----------
    x, y, heading : ndarray of float64, shape (N,)
    road : ndarray of int64, shape (N,), optional
        Index of the road in the network.
    lane : ndarray of int64, shape (N,), optional
    s, offset : ndarray of float64, shape (N,), optional
        Along the road, and to the left of the lane's centre as seen along the road, in m.
    beyond : ndarray of bool, shape (N,), optional
        Where the file names a place beyond the end of its road, which is then that end.
    relative : str
        Where the file names it, if it does so relative to an entity, so that it is that end that is meant.
    """

    x: FloatArray
    y: FloatArray
    heading: FloatArray
    road: IntArray | None = None
    lane: IntArray | None = None
    s: FloatArray | None = None
    offset: FloatArray | None = None
    beyond: BoolArray | None = None
    relative: str = ""


def same_in_all(*arrays: FloatArray | None) -> bool:
    """Whether each array holds the same of all scenarios, to the last bit.

    Parameters
    ----------
    *arrays : ndarray of float64, shape (N, …), or None for what is not there

    Returns
    -------
    bool
    """
    whole = (one.view(np.int64) for one in arrays if one is not None)
    return all(bool((one == one[:1]).all()) for one in whole)


class Track(ABC):
    """A curve that an entity follows, by the distance along it.

    It may run otherwise in each scenario; R of the scenarios are asked for at once, by their `rows`.
    """

    @abstractmethod
    def at(self, distance: FloatArray, offset: FloatArray, rows: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return x, y and heading at distances along the track.

        Parameters
        ----------
        distance : ndarray of float64, shape (R,)
            m.
        offset : ndarray of float64, shape (R,)
            m to the left of the track.
        rows : ndarray of int64, shape (R,)
            Scenarios.

        Returns
        -------
        tuple of ndarray of float64, each (R,)
            m, m, rad.
        """

    @abstractmethod
    def nearest(self, x: FloatArray, y: FloatArray, rows: IntArray, after: FloatArray | None = None) -> FloatArray:
        """Distance along the track of its point nearest to (x, y), in m.

        Parameters
        ----------
        x, y : ndarray of float64, shape (R,)
            m.
        rows : ndarray of int64, shape (R,)
            Scenarios.
        after : ndarray of float64, shape (R,), optional
            Where a track passes a place more than once, the first time after this distance counts.

        Returns
        -------
        ndarray of float64, shape (R,)
        """

    @abstractmethod
    def curvature(self, distance: FloatArray, rows: IntArray) -> FloatArray:
        """Curvature in 1/m, positive to the left, at distances of shape (R,)."""


class Trajectory(Track):
    """A track that a scenario file draws, with or without times.

    Attributes
    ----------
    lengths : ndarray of float64, shape (N,)
        m; infinite for a closed one.
    version : int
        How often `adopt` has changed it.
    """

    lengths: FloatArray
    version: int

    @property
    @abstractmethod
    def time(self) -> FloatArray | None:
        """Times in s of its vertices, or of its start and its end, shape (N, V); None without a clock."""

    @abstractmethod
    def distance_at(self, time: FloatArray) -> FloatArray:
        """Distance along the trajectory in m, at times of its own clock, shape (N,)."""

    @abstractmethod
    def clock_at(self, distance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Time of its own clock in s, and speed in m/s, at distances along the trajectory, each (N,)."""

    @abstractmethod
    def oriented(self, distance: FloatArray, rows: IntArray) -> BoolArray:
        """Whether the file says which heading an entity has there, shape (R,)."""

    @abstractmethod
    def direction(self, distance: FloatArray, rows: IntArray) -> FloatArray:
        """Direction of the line itself in rad, whatever heading an entity has there, shape (R,)."""

    def adopt(self, other: Trajectory, rows: BoolArray) -> None:
        """Take over how another trajectory of the same kind runs in the scenarios of a mask, shape (N,)."""
        for name in self._arrays:
            mine = getattr(self, name)
            if mine is not None:
                mine[rows] = getattr(other, name)[rows]
        self.version += 1

    _arrays: tuple[str, ...]
    """Names of the attributes that hold how it runs in each scenario."""
