"""Post-encroachment time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import label
from scipy.optimize import brentq

from cornercase.errors import InputError
from cornercase.geometry import box_corners, separation, sweep_axes
from cornercase.metrics.base import boxes, worst
from cornercase.recording import Recording
from cornercase.typing import BoolArray, FloatArray, IntArray

_STILL = 1e-9
"""Largest move of a corner in m between two instants of an entity that stands."""

_ARC = 0.005
"""How far in m turning may move a corner in one step: by so much a hull may reach over a curved edge."""

_TOUCH = 1e-9
"""Times in s that are the same but for rounding."""

_PAIRS_AT_ONCE = 4_000


class Pet:
    """Time between one entity leaving the conflict area and the other entering it, as it was recorded.

    ``t_in(second) - t_out(first)`` in s. The conflict area is where the areas overlap that the two bounding
    boxes sweep in the whole recording, on tracks of any shape; each connected stretch of the tracks on which
    the boxes would meet, were it not for the time, has an area of its own, and the smallest value counts. An
    entity is in the area while its box touches it. Between two instants the corners go straight and the speed
    changes evenly.

    The value is known afterwards only and belongs to the recording as a whole: the course has it at all
    instants.

    Not defined (NaN throughout) without a conflict area, when the second enters before the first has left (so
    in each collision), and when the first never leaves. An entity that stands outside of the other's swept
    area gives no conflict, one that stands inside does not leave. A recording that ends before the second
    enters has no conflict area. Never negative unless `signed`. Cap: 10 s.

    Parameters
    ----------
    area : tuple of five float, optional
        Rectangle to take for the conflict area, such as the shared part of two lanes: x and y of its centre
        in m, heading in rad, length and width in m.
    signed : bool, default False
        Where both were in the area at once, give the (negative) time by which the second came too early
        instead of NaN; an entity that has not left counts as leaving when its recording ends. So collisions
        become the most critical recordings, as an optimizer needs it; otherwise they score the cap.

    Notes
    -----
    Source: B. L. Allen, B. T. Shin, P. J. Cooper, "Analysis of traffic conflicts and collisions",
    Transportation Research Record 667 (1978).
    """

    name = "pet"
    unit = "s"
    lower_is_critical = True
    cap = 10.0
    source = "Allen, Shin and Cooper 1978, areas swept by the boxes"

    def __init__(self, area: tuple[float, float, float, float, float] | None = None, signed: bool = False) -> None:
        if area is not None and (len(area) != 5 or not np.isfinite(area).all() or min(area[3:]) <= 0.0):
            raise InputError(f"pet cannot take {area} for its area; give x, y, heading, length > 0, width > 0.")
        self.area = area
        self.signed = signed

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        """Post-encroachment time, the same at each instant.

        Parameters
        ----------
        recording : Recording
        ego, other : str
            Names of two entities; their order does not matter.

        Returns
        -------
        ndarray of float64, shape (T,)
            s; NaN throughout where not defined.

        Raises
        ------
        InputError
            There is no entity of that name.
        """
        a, b = _Sweep.of(recording, ego), _Sweep.of(recording, other)
        if self.area is None:
            stays = _stays(a, b)
        else:
            area = _Sweep.of_area(*self.area)
            stays = [(one, two) for one, _ in _stays(a, area) for two, _ in _stays(b, area)]
        values = [value for one, two in stays for value in self._gaps(one, two)]
        return np.full(len(recording.time), min(values, default=np.nan))

    def score(self, course: FloatArray) -> float:
        """Post-encroachment time of the recording in s, the cap if it is not defined or beyond it."""
        return worst(self, course)

    def _gaps(self, one: _Stay, two: _Stay) -> list[float]:
        gaps = [
            second.enters - first.leaves
            for first, second in ((one, two), (two, one))
            if first.left and second.enters >= first.leaves - _TOUCH
        ]
        if gaps or not self.signed:
            return [max(gap, 0.0) for gap in gaps]
        return [max(one.enters - two.leaves, two.enters - one.leaves)]


@dataclass(frozen=True)
class _Stay:
    """One visit to a conflict area: from and to in s, and whether it ended."""

    enters: float
    leaves: float
    left: bool


class _Sweep:
    """Area that a box sweeps, as n hulls of the box before and after a step; a span of standing is one step.

    ``center`` (n, 2, 2), ``heading``, ``time`` and ``speed`` (n, 2) are those before and after each step,
    ``corners`` (n, 8, 2) and ``axes`` (n, 8, 2) those of the hulls.
    """

    def __init__(
        self,
        center: FloatArray,
        heading: FloatArray,
        time: FloatArray,
        speed: FloatArray,
        size: tuple[float, float],
    ) -> None:
        self.center, self.heading, self.time, self.speed, self.size = center, heading, time, speed, size
        poses = box_corners(center[..., 0], center[..., 1], heading, *size)
        self.corners = poses.reshape(-1, 8, 2)
        self.axes = sweep_axes(poses[:, 0], poses[:, 1])

    @classmethod
    def of(cls, recording: Recording, name: str) -> _Sweep:
        i = recording.index(name)
        steps = np.stack(_steps(boxes(recording, name)), -1)
        heading = recording.heading[i][steps]
        turn = np.remainder(heading[:, 1] - heading[:, 0] + np.pi, 2.0 * np.pi) - np.pi
        heading[:, 1] = heading[:, 0] + turn
        speed = np.nan_to_num(np.abs(recording.speed[i][steps]))
        size = (float(recording.length[i]), float(recording.width[i]))
        return cls(recording.center(name)[steps], heading, recording.time[steps], speed, size)

    @classmethod
    def of_area(cls, x: float, y: float, heading: float, length: float, width: float) -> _Sweep:
        nothing = np.zeros((1, 2))
        center = np.full((1, 2, 2), (x, y))
        return cls(center, nothing + heading, nothing, nothing, (length, width))

    def divided(self, steps: IntArray) -> _Sweep:
        """Return some of the steps, those that turn in parts, so that the hulls keep to the curve."""
        turn = self.heading[steps, 1] - self.heading[steps, 0]
        parts = np.maximum(np.ceil(0.5 * np.hypot(*self.size) * np.abs(turn) / _ARC), 1.0).astype(np.int64)
        which = np.repeat(np.arange(len(steps)), parts)
        part = np.arange(len(which)) - np.repeat(parts.cumsum() - parts, parts)
        share = (part[:, None] + np.array([0.0, 1.0])) / parts[which, None]
        step = steps[which]
        way = self.center[step, 1] - self.center[step, 0]
        time, speed = _interpolate(self.time[step, None], self.speed[step, None], share)
        return _Sweep(
            self.center[step, :1] + share[..., None] * way[:, None],
            self.heading[step, :1] + share * turn[which, None],
            time,
            speed,
            self.size,
        )

    def backwards(self) -> _Sweep:
        """Return the same way, driven from its end to its beginning."""
        return _Sweep(
            self.center[::-1, ::-1],
            self.heading[::-1, ::-1],
            self.time[::-1, ::-1],
            self.speed[::-1, ::-1],
            self.size,
        )


def _meeting(a: _Sweep, b: _Sweep) -> BoolArray:
    """Which step of `a` meets which of `b`, (n, m)."""
    meets = np.zeros((len(a.corners), len(b.corners)), dtype=np.bool_)
    middle_a, reach_a = _circle(a)
    middle_b, reach_b = _circle(b)
    apart = np.hypot(*(middle_b[None, :, k] - middle_a[:, None, k] for k in (0, 1)))
    i, j = np.nonzero(apart <= reach_a[:, None] + reach_b)
    for k in range(0, len(i), _PAIRS_AT_ONCE):
        some_i, some_j = i[k : k + _PAIRS_AT_ONCE], j[k : k + _PAIRS_AT_ONCE]
        gap = separation(a.corners[some_i], a.axes[some_i], b.corners[some_j], b.axes[some_j])
        meets[some_i, some_j] = gap <= 0.0
    return meets


def _circle(sweep: _Sweep) -> tuple[FloatArray, FloatArray]:
    middle = sweep.corners.mean(1)
    away = sweep.corners - middle[:, None]
    return middle, np.hypot(away[..., 0], away[..., 1]).max(1, initial=0.0)


def _stays(a: _Sweep, b: _Sweep) -> list[tuple[_Stay, _Stay]]:
    """Visits of `a` to what `b` sweeps and of `b` to what `a` sweeps, for each connected stretch of both."""
    labels, count = label(_meeting(a, b), structure=np.ones((3, 3)))
    stretches: list[BoolArray] = [labels == k for k in range(1, count + 1)]
    pairs = [(_stay(a, b, meets), _stay(b, a, meets.T)) for meets in stretches]
    return [(one, two) for one, two in pairs if one is not None and two is not None]


def _stay(sweep: _Sweep, area: _Sweep, meets: BoolArray) -> _Stay | None:
    """When the box that makes `sweep` touches the steps of `area` that it meets."""
    steps = np.flatnonzero(meets.any(1))
    entry = _first_touch(sweep, steps, area, meets, backwards=False)
    exit_ = _first_touch(sweep, steps[::-1], area, meets, backwards=True)
    if entry is None or exit_ is None:
        return None
    return _Stay(entry, exit_, exit_ < sweep.time[-1, 1] - _TOUCH)


def _first_touch(sweep: _Sweep, steps: IntArray, area: _Sweep, meets: BoolArray, backwards: bool) -> float | None:
    """Time of the first touch in the given order of steps; None where only hulls of curved steps met."""
    for step in steps:
        fine, around = sweep.divided(np.array([step])), area.divided(np.flatnonzero(meets[step]))
        fine = fine.backwards() if backwards else fine
        hits = _meeting(fine, around)
        touched = np.flatnonzero(hits.any(1))
        if len(touched):
            part = touched[0]
            share = _share(fine.corners[part], around.corners[hits[part]], around.axes[hits[part]])
            return float(_interpolate(fine.time[part], fine.speed[part], np.array(share))[0])
    return None


def _share(corners: FloatArray, obstacles: FloatArray, axes: FloatArray) -> float:
    """Share of the way of a step at which the box first touches one of some convex shapes."""
    start, way = corners[:4], corners[4:] - corners[:4]

    def gap(share: float) -> float:
        reached = start + share * way
        hull = np.concatenate([start, reached])
        return float(separation(hull, sweep_axes(start, reached), obstacles, axes).min())

    if gap(0.0) <= 0.0:
        return 0.0
    return float(brentq(gap, 0.0, 1.0, xtol=1e-13)) if gap(1.0) <= 0.0 else 1.0


def _interpolate(time: FloatArray, speed: FloatArray, share: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Time and speed (...) after a share of the way of a step (..., 2), the speed changing evenly in time."""
    before, after = speed[..., 0], speed[..., 1]
    way = 0.5 * (before + after) * share
    reached = np.sqrt(np.maximum(before**2 + 2.0 * (after - before) * way, 0.0))
    paced = before + reached > 0.0
    lapse = np.where(paced, 2.0 * way / np.where(paced, before + reached, 1.0), share)
    return time[..., 0] + lapse * (time[..., 1] - time[..., 0]), reached


def _steps(box: FloatArray) -> tuple[IntArray, IntArray]:
    """First and last instant of each move and of each span of standing, (n,) each."""
    exists = np.isfinite(box).all((1, 2))
    before, after = np.append(False, exists[:-1]), np.append(exists[1:], False)
    start = np.flatnonzero(exists & (after | ~before))
    end = np.where(after[start], start + 1, start)
    still = (np.abs(box[end] - box[start]) <= _STILL).all((1, 2))
    goes_on = still[1:] & still[:-1] & (start[1:] == end[:-1])
    return start[np.append(True, ~goes_on)[: len(start)]], end[np.append(~goes_on, True)[: len(end)]]
