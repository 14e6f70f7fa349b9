"""The line that an entity drives along, through lanes of several roads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import MISSING, dataclass, fields, replace
from functools import cached_property
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from cornercase._common.addresses import address_of
from cornercase._common.typing import BoolArray, FloatArray, IntArray

STEP: Final = 0.1
SHORTEST: Final = 1e-5
"""m; a lane that is not longer than rounding is drawn so long. A path leaves it out where anything else is."""
# A path that would need more samples has them further apart.
_MOST_SAMPLES: Final = 1_000_000
APART: Final = 0.005
"""m; where pieces of a line lie further apart, it jumps: nobody turns there."""
# m along the reference lines, on both sides of a jump, in which points do not tell the heading.
_AROUND_JUMP: Final = 2.5 * STEP
KINK: Final = 0.1
"""rad; a line that turns by more from one point to the next has a corner there."""


@dataclass(frozen=True, eq=False)
class LanePath:
    """A line sampled at equal distances.

    Attributes
    ----------
    distance, x, y : ndarray of float64, shape (P,)
        m; the distance starts at 0.
    heading : ndarray of float64, shape (P,)
        rad, unwrapped.
    curvature : ndarray of float64, shape (P,)
        1/m, positive to the left.
    s : ndarray of float64, shape (P,)
        Coordinate on the road of each sample, in m.
    road, lane : ndarray of int64, shape (P,)
        Index of the road, and lane.
    along : ndarray of bool, shape (P,)
        Whether the path runs along the road's s.
    passed : ndarray of int64, shape (P,)
        How many of the roads that it was asked to pass lie behind.
    reference : ndarray of float64, shape (P,)
        Way along the reference lines of the roads, in m.
    center : ndarray of float64, shape (P,)
        How far the path lies to the left of the reference line, as it runs, in m.
    bend_at, bend : ndarray of float64, shape (K,)
        Ways along the reference lines in m, and their curvature there in 1/m, positive to the left: linear in between,
        and with a jump where a way comes twice.
    lane_s, lane_span : tuple of (float, float)
        Coordinates s, and distances along the path, at which the lane that it was asked for begins and ends, in m.
    lane_way : float
        Way along the reference lines to where that lane begins, in m.
    ends, begins : bool
        Whether nothing follows after its end, and nothing lies before its begin; else it is cut there.
    jumps : tuple of float
        Ways along the reference lines at which it jumps aside, in m.
    """

    distance: FloatArray
    x: FloatArray
    y: FloatArray
    heading: FloatArray
    curvature: FloatArray
    s: FloatArray
    road: IntArray
    lane: IntArray
    along: BoolArray
    passed: IntArray
    reference: FloatArray
    center: FloatArray
    bend_at: FloatArray
    bend: FloatArray
    lane_s: tuple[float, float] = (0.0, 0.0)
    lane_span: tuple[float, float] = (0.0, 0.0)
    lane_way: float = 0.0
    ends: bool = True
    begins: bool = True
    jumps: tuple[float, ...] = ()

    @cached_property
    def columns(self) -> tuple[npt.NDArray[Any], ...]:
        """Its arrays, each of shape (P,) or (K,), in the order of its attributes, as kernels take them."""
        names = [field.name for field in fields(self) if field.default is MISSING]
        return tuple(np.ascontiguousarray(getattr(self, name)) for name in names)

    @cached_property
    def addresses(self) -> IntArray:
        """Where its `columns` lie, shape (14,)."""
        return np.array([address_of(array) for array in self.columns])

    @cached_property
    def chord(self) -> float:
        """Largest gap between two samples that follow each other, in m, and a little above 0."""
        return max(float(np.hypot(np.diff(self.x), np.diff(self.y)).max()), 1e-9)

    @classmethod
    def of_points(
        cls,
        x: FloatArray,
        y: FloatArray,
        s: FloatArray,
        road: IntArray,
        lane: IntArray,
        along: BoolArray,
        passed: IntArray,
        reference: FloatArray,
        center: FloatArray,
        bend_at: FloatArray,
        bend: FloatArray,
        jumped: BoolArray | None = None,
    ) -> LanePath:
        """Make a path through points that are close together.

        Parameters
        ----------
        x, y, s : ndarray of float64, shape (Q,)
            m; `s` on the road of each point.
        road, lane : ndarray of int64, shape (Q,)
        along : ndarray of bool, shape (Q,)
            Whether the path runs along the road's s.
        passed : ndarray of int64, shape (Q,)
            How many of the roads that it was asked to pass lie behind.
        reference : ndarray of float64, shape (Q,)
            Way along the reference lines, in m.
        center : ndarray of float64, shape (Q,)
            How far they lie to the left of the reference line, in m.
        bend_at, bend : ndarray of float64, shape (K,)
            Ways along the reference lines in m, and their curvature there in 1/m.
        jumped : ndarray of bool, shape (Q,), optional
            Whether the line jumps aside between the point before and this one; the jump itself has no length.

        Returns
        -------
        LanePath
        """
        keep = np.concatenate([[True], np.hypot(np.diff(x), np.diff(y)) > 1e-6])
        jumped = np.zeros(len(x), dtype=np.bool_) if jumped is None else jumped
        arrays = (x, y, s, road, lane, along, passed, reference, center, jumped)
        x, y, s, road, lane, along, passed, reference, center, jumped = (array[keep] for array in arrays)
        travelled = _travelled(x, y, reference, jumped)
        # Between two points at the same place along the line there is no direction.
        chords = _travelled(x, y, reference, np.zeros_like(jumped))
        samples = min(int(np.ceil(travelled[-1] / STEP)) + 1, _MOST_SAMPLES)
        distance = np.linspace(0.0, travelled[-1], max(3, samples))
        nearest = np.clip(np.searchsorted(travelled, distance, "right") - 1, 0, len(x) - 1)
        # On a bend a place between two points lies beside their chord.
        gap, (across, bent) = np.append(np.diff(travelled), 1.0)[nearest], _course(x, y, chords)
        across, bent = np.interp(distance, travelled, across), np.interp(distance, travelled, bent)
        beside = _beside_chord(bent, (distance - travelled[nearest]) / gap, gap)
        x = np.interp(distance, travelled, x) + beside * np.sin(across)
        y = np.interp(distance, travelled, y) - beside * np.cos(across)
        heading, curvature = _course(x, y, distance)
        sign = np.where(along[nearest], 1.0, -1.0)
        way = np.interp(distance, travelled, reference)
        return cls(
            distance,
            x,
            y,
            heading,
            curvature,
            s[nearest] + sign * (way - reference[nearest]),
            road[nearest],
            lane[nearest],
            along[nearest],
            passed[nearest],
            way,
            np.interp(distance, travelled, center),
            bend_at,
            bend,
        )

    def across_jumps(self, jumps: Sequence[float], heading: FloatArray) -> LanePath:
        """Return the path with the heading that it has beside its jumps, where points tell that of the jump.

        Parameters
        ----------
        jumps : sequence of float
            Ways along the reference lines, in m.
        heading : ndarray of float64, shape (P,)
            rad at each sample, as the lanes have it.

        Returns
        -------
        LanePath
        """
        if not jumps:
            return self
        near = np.any([np.abs(self.reference - jump) <= _AROUND_JUMP for jump in jumps], axis=0)
        mended = np.unwrap(np.where(near, heading, self.heading))
        curvature = np.where(near, np.gradient(mended, self.distance), self.curvature)
        return replace(self, heading=mended, curvature=curvature, jumps=tuple(jumps))

    def sample_at(self, distance: FloatArray) -> IntArray:
        """Find the last sample that does not lie beyond each distance.

        Parameters
        ----------
        distance : ndarray of float64, shape (N,)
            m along the path; beyond its ends it is clamped.

        Returns
        -------
        ndarray of int64, shape (N,)
            Indices of samples.
        """
        return np.clip(np.searchsorted(self.distance, distance, "right") - 1, 0, self.x.size - 1)

    def s_at(self, distance: FloatArray) -> FloatArray:
        """Coordinate s on the road of the sample before each place.

        Parameters
        ----------
        distance : ndarray of float64, shape (N,)
            m along the path.

        Returns
        -------
        ndarray of float64, shape (N,)
            m.
        """
        sample = self.sample_at(distance)
        beyond = np.interp(distance, self.distance, self.reference) - self.reference[sample]
        return np.asarray(self.s[sample] + np.where(self.along[sample], beyond, -beyond))

    def distance_at(self, s: FloatArray) -> FloatArray:
        """Find places on the lane that the path was asked for.

        Parameters
        ----------
        s : ndarray of float64, shape (N,)
            Coordinates on its road, in m; what lies beyond the lane is put at its ends.

        Returns
        -------
        ndarray of float64, shape (N,)
            m along the path.
        """
        low, high = sorted(self.lane_s)
        way = self.lane_way + np.abs(np.clip(s, low, high) - self.lane_s[0])
        # Where lanes do not quite meet, no way along the reference lines leads from one to the other.
        return np.clip(np.interp(way, self.reference, self.distance), *self.lane_span)

    def ahead(self, distance: FloatArray, way: FloatArray) -> FloatArray:
        """Find places that lie further along the reference lines.

        Parameters
        ----------
        distance : ndarray of float64, shape (N,)
            m along the path.
        way : ndarray of float64, shape (N,)
            m along the reference lines; negative against the path.

        Returns
        -------
        ndarray of float64, shape (N,)
            m along the path, within its ends.
        """
        along = np.interp(distance, self.distance, self.reference)
        return np.interp(along + way, self.reference, self.distance)

    def at(self, distance: FloatArray, offset: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Find places on the path or beside it.

        Parameters
        ----------
        distance : ndarray of float64, shape (N,)
            m along the path; beyond its ends it is clamped.
        offset : ndarray of float64, shape (N,)
            m to the left.

        Returns
        -------
        x, y : ndarray of float64, shape (N,)
            m.
        heading : ndarray of float64, shape (N,)
            rad.
        curvature : ndarray of float64, shape (N,)
            1/m, of the path itself.
        """
        step = self.distance[1]
        place = np.clip(distance, 0.0, self.distance[-1]) / step
        k = np.minimum(place.astype(np.int64), len(self.distance) - 2)
        part = place - k
        heading = self.heading[k] + part * (self.heading[k + 1] - self.heading[k])
        x = self.x[k] + part * (self.x[k + 1] - self.x[k])
        y = self.y[k] + part * (self.y[k + 1] - self.y[k])
        curvature = self.curvature[k] + part * (self.curvature[k + 1] - self.curvature[k])
        offset = offset - _beside_chord(curvature, part, step)
        return x - offset * np.sin(heading), y + offset * np.cos(heading), heading, curvature


def _travelled(x: FloatArray, y: FloatArray, reference: FloatArray, jumped: BoolArray) -> FloatArray:
    """Distances of points along the line through them, in which jumps have no length, each (Q,) in m."""
    lengths = np.hypot(np.diff(x), np.diff(y))
    if jumped.any():
        ways = np.diff(reference)
        known = np.flatnonzero(~jumped[1:] & (ways > 0.0))
        rate = (
            np.interp(np.arange(len(ways)), known, lengths[known] / ways[known]) if known.size else np.zeros(len(ways))
        )
        lengths = np.where(jumped[1:], np.minimum(lengths, rate * ways), lengths)
    return np.concatenate([[0.0], np.cumsum(lengths)])


def jumped_at(reference: FloatArray, jumps: Sequence[float]) -> BoolArray:
    """Whether points along a line are the first behind a jump, by their ways along the reference lines, (Q,)."""
    jumped = np.zeros(len(reference), dtype=np.bool_)
    behind = np.searchsorted(reference, np.asarray(jumps))
    jumped[behind[behind < len(reference)]] = True
    return jumped


def _course(x: FloatArray, y: FloatArray, distance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Heading, unwrapped, and curvature of a line through points at distances along it, each (Q,)."""
    heading = np.unwrap(np.arctan2(np.gradient(y, distance), np.gradient(x, distance)))
    return heading, np.gradient(heading, distance)


def _beside_chord(curvature: FloatArray, part: FloatArray, gap: FloatArray | float) -> FloatArray:
    """How far to the right of a chord of length `gap` its arc lies, at parts of it, in m; a kink has no arc."""
    return np.where(np.abs(curvature) * gap < KINK, 0.5 * curvature * part * (1.0 - part) * gap**2, 0.0)


def join(pieces: Sequence[LanePath], asked: int = 0) -> LanePath:
    """Path along several pieces, each of which starts where the one before ends; `asked` is the piece asked for."""
    before = np.cumsum([0.0, *(piece.reference[-1] for piece in pieces[:-1])])
    own = pieces[asked]
    pieces = [
        replace(piece, reference=way + piece.reference, bend_at=way + piece.bend_at)
        for way, piece in zip(before, pieces, strict=True)
    ]
    # What is only drawn longer than it is has no direction of its own.
    kept = [k for k, piece in enumerate(pieces) if piece.distance[-1] > 2.0 * SHORTEST] or [asked]
    names = ("x", "y", "s", "road", "lane", "along", "passed", "reference", "center", "bend_at", "bend")
    arrays: list[Any] = [np.concatenate([getattr(pieces[k], name) for k in kept]) for name in names]
    jumps = [float(before[k]) + jump for k in kept for jump in pieces[k].jumps]
    jumped = jumped_at(arrays[7], jumps)
    # Where pieces do not quite meet, the way between them counts too.
    travelled = _travelled(arrays[0], arrays[1], arrays[7], jumped)
    begin = sum(len(pieces[k].x) for k in kept if k < asked)
    end = begin + len(own.x) - 1 if asked in kept else begin
    span = travelled[np.minimum([begin, end], len(travelled) - 1)].tolist()
    path = LanePath.of_points(*[*arrays, jumped])
    # Nobody turns on the way from one road to the next.
    seams = np.cumsum([len(pieces[k].x) for k in kept])[:-1]
    apart = np.hypot(np.diff(arrays[0]), np.diff(arrays[1]))[seams - 1] > APART
    jumps += arrays[7][seams[apart]].tolist()
    headings = np.unwrap(np.concatenate([pieces[k].heading for k in kept]))
    path = path.across_jumps(jumps, np.interp(path.distance, travelled, headings))
    return replace(path, lane_s=own.lane_s, lane_span=(span[0], span[1]), lane_way=float(before[asked]))
