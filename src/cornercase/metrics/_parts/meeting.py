"""What several features need of a recording, computed once."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Final

import numpy as np

from cornercase._common.typing import FloatArray, IntArray
from cornercase.recordings import Recording

FAR: Final = 100.0
"""Distance in m that says that two entities never meet."""

_COARSE: Final = 64
"""Instants of each way that are looked at first."""

_METRES_PER_SECOND: Final = 0.1
"""What a second between both counts against the distance of their ways."""


class Meeting:
    """A recording, its ego and one other entity, with what several features need of them.

    Parameters
    ----------
    recording : Recording
    ego, other : str
        Names of two entities.

    Attributes
    ----------
    recording : Recording
    ego, other : str
    ego_row, other_row : int
        Rows of both in the recording.
    ego_center, other_center : ndarray of float64, shape (T, 2)
        Centres of the boxes in m, NaN where an entity does not exist.

    Raises
    ------
    InputError
        There is no entity of that name.
    """

    def __init__(self, recording: Recording, ego: str, other: str) -> None:
        self.recording, self.ego, self.other = recording, ego, other
        self.ego_row, self.other_row = recording.index(ego), recording.index(other)
        self.ego_center, self.other_center = recording.center(ego), recording.center(other)

    @property
    def duration(self) -> float:
        """Time from the first to the last instant in s."""
        time = self.recording.time
        return float(time[-1] - time[0]) if len(time) else 0.0

    @cached_property
    def ego_there(self) -> IntArray:
        """Instants at which the ego exists, shape (n,)."""
        return self._there(self.ego_row)

    @cached_property
    def other_there(self) -> IntArray:
        """Instants at which the other exists, shape (n,)."""
        return self._there(self.other_row)

    @cached_property
    def both_there(self) -> IntArray:
        """Instants at which both exist, shape (n,)."""
        return np.intersect1d(self.ego_there, self.other_there, assume_unique=True)

    def since_begin(self, instant: int) -> float:
        """How long after the recording began an instant is.

        Parameters
        ----------
        instant : int

        Returns
        -------
        float
            s.
        """
        time = self.recording.time
        return float(time[instant] - time[0])

    def _there(self, row: int) -> IntArray:
        one = self.recording
        there = np.isfinite(one.x[row]) & np.isfinite(one.y[row]) & np.isfinite(one.heading[row])
        return np.flatnonzero(there & np.isfinite(one.speed[row]))

    @cached_property
    def _ways(self) -> FloatArray:
        """How far the ego has driven until each instant at which it exists."""
        steps = np.diff(self.ego_center[self.ego_there], axis=0)
        return np.append(0.0, np.cumsum(np.hypot(steps[:, 0], steps[:, 1])))

    def way_until(self, instant: int | None) -> float:
        """How far the ego has driven.

        Parameters
        ----------
        instant : int or None
            One at which it exists; None for the end.

        Returns
        -------
        float
            m; 0 where it never exists.
        """
        if instant is None:
            return float(self._ways[-1])
        return float(self._ways[np.searchsorted(self.ego_there, instant)])

    @cached_property
    def nearest(self) -> tuple[int | None, float]:
        """First instant at which the boxes are nearest, and their gap in m; None and 100 m where they never meet."""
        both = self.both_there
        if not len(both):
            return None, FAR
        apart = self.other_center[both] - self.ego_center[both]
        distance = np.hypot(apart[:, 0], apart[:, 1])
        one, pair = self.recording, [self.ego_row, self.other_row]
        # A gap is at most as large as the centres are apart, and smaller by half of both diagonals at most.
        reach = 0.5 * np.hypot(one.length[pair], one.width[pair]).sum()
        some = both[distance <= distance.min() + reach]
        gaps = self._gaps(some)
        k = int(np.argmin(gaps))
        return int(some[k]), float(gaps[k])

    def _gaps(self, some: IntArray) -> FloatArray:
        """Gaps between the boxes at instants, as of `box_distance`, of two boxes in a tenth of its time."""
        one, apart = self.recording, self.other_center[some] - self.ego_center[some]
        headings = one.heading[self.ego_row, some], one.heading[self.other_row, some]
        sizes = [0.5 * np.array([one.length[row], one.width[row]]) for row in (self.ego_row, self.other_row)]
        turned = headings[1] - headings[0]
        ways = ((sizes[0], sizes[1], headings[0], turned, 1.0), (sizes[1], sizes[0], headings[1], -turned, -1.0))
        least, beyond = np.full(len(some), np.inf), np.full(len(some), -np.inf)
        for mine, others, heading, angle, sign in ways:
            cos, sin = sign * np.cos(heading), sign * np.sin(heading)
            ahead, left = cos * apart[:, 0] + sin * apart[:, 1], cos * apart[:, 1] - sin * apart[:, 0]
            along = np.stack([np.cos(angle), np.sin(angle)]) * others[0]
            across = np.stack([-np.sin(angle), np.cos(angle)]) * others[1]
            # Corners of the one box, seen from the middle of the other.
            corners = np.stack([along + across, along - across, -along + across, -along - across])
            corners += np.stack([ahead, left])
            outside = np.maximum(np.abs(corners) - mine[:, None], 0.0)
            least = np.minimum(least, np.hypot(outside[:, 0], outside[:, 1]).min(axis=0))
            reach = np.abs(along) + np.abs(across) + mine[:, None]
            beyond = np.maximum(beyond, (np.abs(np.stack([ahead, left])) - reach).max(axis=0))
        return np.where(beyond <= 0.0, 0.0, least)

    def other_from(self, instant: int) -> tuple[float, float, float]:
        """Where the other is, seen from the ego, and how fast.

        Parameters
        ----------
        instant : int
            One at which the ego exists.

        Returns
        -------
        ahead, left, speed : float
            m, m and m/s; 100 m ahead, standing, where the other does not exist then.
        """
        if instant not in self.other_there:
            return FAR, 0.0, 0.0
        heading = self.recording.heading[self.ego_row, instant]
        cos, sin = np.cos(heading), np.sin(heading)
        x, y = self.other_center[instant] - self.ego_center[instant]
        return float(cos * x + sin * y), float(cos * y - sin * x), float(self.recording.speed[self.other_row, instant])

    @cached_property
    def crossing(self) -> tuple[float, float]:
        """Distance of both ways where they come nearest in m, and how much later the ego is there in s."""
        mine, others = self.ego_there, self.other_there
        if not len(mine) or not len(others):
            return FAR, 0.0
        step, step_too = (math.ceil(len(some) / _COARSE) for some in (mine, others))
        i, j, _ = self._least(mine[::step], others[::step_too])
        near = slice(max(i * step - step, 0), i * step + step + 1)
        near_too = slice(max(j * step_too - step_too, 0), j * step_too + step_too + 1)
        i, j, distance = self._least(mine[near], others[near_too])
        time = self.recording.time
        return distance, float(time[mine[near][i]] - time[others[near_too][j]])

    def _least(self, mine: IntArray, others: IntArray) -> tuple[int, int, float]:
        """Indices among instants of both at which their ways come nearest, and their distance there."""
        a, b, time = self.ego_center[mine], self.other_center[others], self.recording.time
        distance = np.hypot(a[:, :1] - b[:, 0], a[:, 1:] - b[:, 1])
        late = np.abs(time[mine][:, None] - time[others])
        i, j = np.unravel_index(int(np.argmin(distance + _METRES_PER_SECOND * late)), distance.shape)
        return int(i), int(j), float(distance[i, j])
