"""Path along the lanes of several roads, sampled at equal distances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import MISSING, dataclass, fields, replace
from functools import cached_property
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from cornercase._common.numba.pointers import memory_address
from cornercase._common.typing import BoolArray, FloatArray, IntArray

SAMPLE_DISTANCE: Final = 0.1
MIN_PATH_LENGTH: Final = 1e-5
"""Length in m of the path of an almost empty lane; `join_paths` leaves it out if there is more."""
# Longer paths get a larger sample distance.
_MAX_SAMPLES: Final = 1_000_000
MIN_JUMP: Final = 0.005
"""Smallest gap in m that is a jump, at which the heading does not change."""
# Distance in m from a jump within which points do not determine the heading.
_JUMP_MARGIN: Final = 2.5 * SAMPLE_DISTANCE
# Tolerance in m for rounded coordinates.
_COORDINATE_TOLERANCE: Final = 1e-6
KINK_ANGLE: Final = 0.1
"""Smallest change of heading in rad between two samples that counts as a corner."""


@dataclass(frozen=True, eq=False)
class LanePath:
    """A path along lanes, sampled at equal distances: arrays of shape (P,) in m, rad and 1/m.

    `distance` is measured along the path. `road`, `lane` and `s` are the road coordinates of the samples, and `forward`
    is True where the path runs along the road's s. `goals_passed` is the number of goals (roads on the route) reached
    so far. `reference_distance` is measured along the reference lines of the roads, and `center_offset` is the offset
    of the path from these lines, positive to the left. `reference_curvature` is the curvature of the reference lines,
    positive to the left, at the distances `curvature_distance` along these lines; both have shape (K,). Between these
    distances the curvature is linear; it jumps where a distance is repeated.

    The path contains a requested lane, and may go on before and after this lane. `lane_s` has the s coordinates of the
    start and the end of the requested lane, and `lane_span` the distances of both along the path.
    `lane_reference_distance` is the distance of its start along the reference lines. `has_start` and `has_end` are
    False if lanes go on before the start or after the end of the path; lanes that end more than 0.3 m beside the start
    do not count. `jumps` are distances along the reference lines at which the path jumps sideways.
    """

    distance: FloatArray
    x: FloatArray
    y: FloatArray
    heading: FloatArray
    curvature: FloatArray
    s: FloatArray
    road: IntArray
    lane: IntArray
    forward: BoolArray
    goals_passed: IntArray
    reference_distance: FloatArray
    center_offset: FloatArray
    curvature_distance: FloatArray
    reference_curvature: FloatArray
    lane_s: tuple[float, float] = (0.0, 0.0)
    lane_span: tuple[float, float] = (0.0, 0.0)
    lane_reference_distance: float = 0.0
    has_end: bool = True
    has_start: bool = True
    jumps: tuple[float, ...] = ()

    @cached_property
    def cache(self) -> dict[str, Any]:
        """Values that other modules computed from the path, stored so that they are computed only once."""
        return {}

    @cached_property
    def arrays(self) -> tuple[npt.NDArray[Any], ...]:
        """The arrays of the path for compiled functions, shape (P,) or (K,), in the order of the attributes."""
        names = [field.name for field in fields(self) if field.default is MISSING]
        return tuple(np.ascontiguousarray(getattr(self, name)) for name in names)

    @cached_property
    def array_addresses(self) -> IntArray:
        """Memory addresses of `arrays`, shape (14,)."""
        return np.array([memory_address(array) for array in self.arrays])

    @cached_property
    def max_chord(self) -> float:
        """Largest distance between consecutive samples in m, always above 0."""
        return max(float(np.hypot(np.diff(self.x), np.diff(self.y)).max()), 1e-9)

    @classmethod
    def from_points(
        cls,
        x: FloatArray,
        y: FloatArray,
        s: FloatArray,
        road: IntArray,
        lane: IntArray,
        forward: BoolArray,
        goals_passed: IntArray,
        reference_distance: FloatArray,
        center_offset: FloatArray,
        curvature_distance: FloatArray,
        reference_curvature: FloatArray,
        is_after_jump: BoolArray | None = None,
        *,
        max_samples: int = _MAX_SAMPLES,
    ) -> LanePath:
        """Create a path through Q points that are close together.

        The arguments have the meaning of the attributes, but with one value for each point, shape (Q,). Only
        `curvature_distance` and `reference_curvature` have the shape (K,). `is_after_jump` is True at the first point
        after each sideways jump. The length of a jump does not count as distance along the path.
        """
        keep = np.concatenate([[True], np.hypot(np.diff(x), np.diff(y)) > 1e-6])
        is_after_jump = np.zeros(len(x), dtype=np.bool_) if is_after_jump is None else is_after_jump
        arrays = (x, y, s, road, lane, forward, goals_passed, reference_distance, center_offset, is_after_jump)
        x, y, s, road, lane, forward, goals_passed, reference_distance, center_offset, is_after_jump = (
            array[keep] for array in arrays
        )
        travelled = _distances_along_line(x, y, reference_distance, is_after_jump)
        # Points at the same distance along the line would have no direction.
        chords = _distances_along_line(x, y, reference_distance, np.zeros_like(is_after_jump))
        samples = min(int(np.ceil(travelled[-1] / SAMPLE_DISTANCE)) + 1, max_samples)
        distance = np.linspace(0.0, travelled[-1], max(3, samples))
        nearest = np.clip(np.searchsorted(travelled, distance, "right") - 1, 0, len(x) - 1)
        # On a bend, interpolate on the arc instead of the chord.
        gap, (across, bent) = np.append(np.diff(travelled), 1.0)[nearest], _heading_and_curvature(x, y, chords)
        across, bent = np.interp(distance, travelled, across), np.interp(distance, travelled, bent)
        bulge = _arc_offset_from_chord(bent, (distance - travelled[nearest]) / gap, gap)
        x = np.interp(distance, travelled, x) + bulge * np.sin(across)
        y = np.interp(distance, travelled, y) - bulge * np.cos(across)
        heading, curvature = _heading_and_curvature(x, y, distance)
        sign = np.where(forward[nearest], 1.0, -1.0)
        along_reference = np.interp(distance, travelled, reference_distance)
        return cls(
            distance,
            x,
            y,
            heading,
            curvature,
            s[nearest] + sign * (along_reference - reference_distance[nearest]),
            road[nearest],
            lane[nearest],
            forward[nearest],
            goals_passed[nearest],
            along_reference,
            np.interp(distance, travelled, center_offset),
            curvature_distance,
            reference_curvature,
        )

    def with_jump_headings(self, jumps: Sequence[float], heading: FloatArray) -> LanePath:
        """Return the path with corrected headings near sideways jumps.

        Near a jump, the computed heading is the direction of the jump. It is replaced by the heading of the lane, given
        for each sample in `heading`, shape (P,). `jumps` are distances along the reference lines in m.
        """
        if not jumps:
            return self
        is_near = np.any([np.abs(self.reference_distance - jump) <= _JUMP_MARGIN for jump in jumps], axis=0)
        headings = np.unwrap(np.where(is_near, heading, self.heading))
        curvature = np.where(is_near, np.gradient(headings, self.distance), self.curvature)
        return replace(self, heading=headings, curvature=curvature, jumps=tuple(jumps))

    def sample_index(self, distance: FloatArray) -> IntArray:
        """Return the index of the last sample before or at each distance in m, shape (N,); always a valid index."""
        return np.clip(np.searchsorted(self.distance, distance, "right") - 1, 0, self.x.size - 1)

    def distance_of_s(self, s: FloatArray) -> FloatArray:
        """Return the distance along the path for each s on the requested lane, in m, shape (N,).

        Positions beyond the lane are clipped to its ends.
        """
        low, high = sorted(self.lane_s)
        target = self.lane_reference_distance + np.abs(np.clip(s, low, high) - self.lane_s[0])
        # Between lanes that do not quite meet, the distance along the reference lines is constant.
        return np.clip(np.interp(target, self.reference_distance, self.distance), *self.lane_span)

    def advance_along_reference(self, distance: FloatArray, reference_step: FloatArray) -> FloatArray:
        """Return where points on the path are after steps along the reference lines: distances along the path, (N,).

        `distance` has the distances before the steps. All values are in m.
        """
        along = np.interp(distance, self.distance, self.reference_distance)
        return np.interp(along + reference_step, self.reference_distance, self.distance)


def _distances_along_line(
    x: FloatArray, y: FloatArray, reference_distance: FloatArray, is_after_jump: BoolArray
) -> FloatArray:
    """Return the distance of each point along a line, shape (Q,), in m; jumps do not count."""
    lengths = np.hypot(np.diff(x), np.diff(y))
    if is_after_jump.any():
        reference_steps = np.diff(reference_distance)
        regular = np.flatnonzero(~is_after_jump[1:] & (reference_steps > 0.0))
        rate = (
            np.interp(np.arange(len(reference_steps)), regular, lengths[regular] / reference_steps[regular])
            if regular.size
            else np.zeros(len(reference_steps))
        )
        lengths = np.where(is_after_jump[1:], np.minimum(lengths, rate * reference_steps), lengths)
    return np.concatenate([[0.0], np.cumsum(lengths)])


def find_first_after_jumps(reference_distance: FloatArray, jumps: Sequence[float], *, forward: bool) -> BoolArray:
    """Return a mask of the first point after each jump, shape (Q,); `jumps` are distances along the reference lines.

    `forward` says whether the points run along the road's s.
    """
    jumped = np.zeros(len(reference_distance), dtype=np.bool_)
    # At a jump itself, the geometry of larger s counts: the one after the jump only if the points run along s.
    tolerance = -_COORDINATE_TOLERANCE if forward else _COORDINATE_TOLERANCE
    behind = np.searchsorted(reference_distance, np.asarray(jumps) + tolerance)
    jumped[behind[behind < len(reference_distance)]] = True
    return jumped


def _heading_and_curvature(x: FloatArray, y: FloatArray, distance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return unwrapped heading and curvature of a line through points, shape (Q,) each."""
    heading = np.unwrap(np.arctan2(np.gradient(y, distance), np.gradient(x, distance)))
    return heading, np.gradient(heading, distance)


def _arc_offset_from_chord(curvature: FloatArray, fraction: FloatArray, chord_length: FloatArray | float) -> FloatArray:
    """Return how far an arc is to the right of its chord in m, at a `fraction` of the chord; 0 at sharp corners."""
    return np.where(
        np.abs(curvature) * chord_length < KINK_ANGLE,
        0.5 * curvature * fraction * (1.0 - fraction) * chord_length**2,
        0.0,
    )


def join_paths(pieces: Sequence[LanePath], requested: int = 0) -> LanePath:
    """Join consecutive paths to one path; `requested` is the index of the piece along the requested lane."""
    offsets = np.cumsum([0.0, *(piece.reference_distance[-1] for piece in pieces[:-1])])
    requested_piece = pieces[requested]
    pieces = [
        replace(
            piece,
            reference_distance=offset + piece.reference_distance,
            curvature_distance=offset + piece.curvature_distance,
        )
        for offset, piece in zip(offsets, pieces, strict=True)
    ]
    # Pieces of minimal length have no direction of their own.
    indices = [k for k, piece in enumerate(pieces) if piece.distance[-1] > 2.0 * MIN_PATH_LENGTH] or [requested]
    names = (
        "x",
        "y",
        "s",
        "road",
        "lane",
        "forward",
        "goals_passed",
        "reference_distance",
        "center_offset",
        "curvature_distance",
        "reference_curvature",
    )
    arrays: list[Any] = [np.concatenate([getattr(pieces[k], name) for k in indices]) for name in names]
    jumps = [float(offsets[k]) + jump for k in indices for jump in pieces[k].jumps]
    jumped = np.concatenate(
        [
            find_first_after_jumps(
                pieces[k].reference_distance - offsets[k], pieces[k].jumps, forward=bool(pieces[k].forward[0])
            )
            for k in indices
        ]
    )
    # Count small gaps between pieces, too.
    travelled = _distances_along_line(arrays[0], arrays[1], arrays[7], jumped)
    begin = sum(len(pieces[k].x) for k in indices if k < requested)
    end = begin + len(requested_piece.x) - 1 if requested in indices else begin
    span = travelled[np.minimum([begin, end], len(travelled) - 1)].tolist()
    path = LanePath.from_points(*[*arrays, jumped])
    # Gaps between pieces must not change the heading.
    seams = np.cumsum([len(pieces[k].x) for k in indices])[:-1]
    separate = np.hypot(np.diff(arrays[0]), np.diff(arrays[1]))[seams - 1] > MIN_JUMP
    jumps += arrays[7][seams[separate]].tolist()
    headings = np.unwrap(np.concatenate([pieces[k].heading for k in indices]))
    path = path.with_jump_headings(jumps, np.interp(path.distance, travelled, headings))
    return replace(
        path,
        lane_s=requested_piece.lane_s,
        lane_span=(span[0], span[1]),
        lane_reference_distance=float(offsets[requested]),
    )
