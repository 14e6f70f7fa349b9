"""Reject roads with impossible geometry."""

from __future__ import annotations

from itertools import pairwise
from typing import Final

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.io.tracked_xml import find_untracked, note_adaptation
from cornercase.roads._lane import CubicPolynomial
from cornercase.roads._reference_line import ReferenceGeometry
from cornercase.roads._road import Road

# Gaps in m between geometries that are reported and refused.
_MAX_UNREPORTED_GAP: Final = 0.1
_MAX_GAP: Final = 2.0
# Largest distances in m: from the origin, and of a lane from its road.
_MAX_COORDINATE: Final = 1e8
_MAX_LANE_OFFSET: Final = 1e4
# Largest curvature in 1/m of a bend of more than a full turn.
_MAX_CURVATURE: Final = 10.0
# Largest ratio of curve length and given length, and its inverse.
_MAX_LENGTH_RATIO: Final = 2.0


def require_drivable_road(road: Road, element: etree._Element, location: str) -> None:
    """Raise `InputError` if the geometry of a road is impossible.

    The reference line must have no large gaps and no extreme curvature. The curve of a paramPoly3 must be about as
    long as its attribute ``length`` says. The road must not be extremely far from the origin, and its lanes must not be
    extremely far from its reference line.
    """
    ends = [*(geometry.s for geometry in road.geometries[1:]), road.length]
    for geometry, end in zip(road.geometries, ends, strict=True):
        _require_valid_geometry(geometry, end, location)
    for before, following in pairwise(road.geometries):
        x, y, _ = before.pose_at(np.array([following.s - before.s]))
        distance = float(np.hypot(x[0] - following.x, y[0] - following.y))
        if distance > _MAX_GAP:
            raise InputError(
                f"{location}: the <geometry> at s = {following.s:g} m begins {distance:.3g} m away"
                " from the end of the one before; make them meet."
            )
        if distance > _MAX_UNREPORTED_GAP:
            reason = f"begins up to {_MAX_GAP:g} m away from the end of the one before; entities jump across"
            note_adaptation(
                _find_geometry_element(element, following.s),
                "<geometry>",
                reason,
                "each <geometry> begins where the one before ends",
            )
    _require_bounded_cubics(road.lane_offsets, road.length, f"{location}: its <laneOffset>")
    for (start, lanes), end in zip(road.sections, road.section_bounds[1:].tolist(), strict=True):
        for number, lane in lanes.items():
            tag, curve = ("border", lane.borders) if lane.borders else ("width", lane.widths)
            _require_bounded_cubics(curve, end - start, f"{location}: <{tag}> of the lane {number} at s = {start:g} m")


def _find_geometry_element(road: etree._Element, s: float) -> etree._Element:
    """Return the <geometry> that starts at s; the <road> itself if there is none."""
    for geometry in find_untracked(road, "planView", "geometry"):
        if float(geometry.attrib.get("s") or "nan") == s:
            return geometry
    return road


def _require_valid_geometry(geometry: ReferenceGeometry, end: float, location: str) -> None:
    location = f"{location}: the <geometry> at s = {geometry.s:g} m"
    if geometry.kind in ("line", "arc", "spiral"):
        # Its length bounds its distance from the start.
        farthest = max(abs(geometry.x), abs(geometry.y)) + max(geometry.length, end - geometry.s)
        if not (farthest < _MAX_COORDINATE and np.isfinite(geometry.heading)):
            raise InputError(
                f"{location} lies more than {_MAX_COORDINATE / 1000:g} km from the origin; move it nearer."
            )
        bend = max(map(abs, geometry.shape_parameters), default=0.0)
        if bend > _MAX_CURVATURE and not _mean_bend(geometry) * geometry.length <= 2.0 * np.pi:
            raise InputError(
                f"{location} turns by more than a full circle, and has a curvature of {bend:g} 1/m; in such a turn,"
                f" at most {_MAX_CURVATURE:g} 1/m are allowed; correct its curvature or length."
            )
        return
    # The last geometry is continued to the end of the road.
    along = np.append(np.linspace(0.0, geometry.length, 101), end - geometry.s)
    with np.errstate(all="ignore"):
        x, y, heading = geometry.pose_at(along)
        length = float(np.hypot(np.diff(x[:-1]), np.diff(y[:-1])).sum())
    if not (np.isfinite(heading).all() and max(np.abs(x).max(), np.abs(y).max()) < _MAX_COORDINATE):
        raise InputError(f"{location} lies more than {_MAX_COORDINATE / 1000:g} km from the origin; move it nearer.")
    if geometry.kind == "paramPoly3" and not 1 / _MAX_LENGTH_RATIO <= length / geometry.length <= _MAX_LENGTH_RATIO:
        raise InputError(
            f"{location} has a <paramPoly3> whose curve is {length:.3g} m long, but its attribute length is"
            f" {geometry.length:g} m; correct its coefficients, its pRange, or its length."
        )


def _mean_bend(geometry: ReferenceGeometry) -> float:
    """Return the mean of the absolute curvature of an arc or a spiral, in 1/m; NaN if it is too large for a float."""
    first, last = geometry.shape_parameters[0], geometry.shape_parameters[-1]
    total = abs(first) + abs(last)
    return 0.5 * total if first * last >= 0.0 else 0.5 * (first * first + last * last) / total


def _require_bounded_cubics(cubics: tuple[CubicPolynomial, ...], length: float, subject: str) -> None:
    """Raise `InputError` if a cubic may exceed 10 km in absolute value between its start and its end.

    A cubic ends where the next one starts; the last one ends at `length`, in m.
    """
    ends = [*(start for start, *_ in cubics), length][1:]
    for (start, *coefficients), end in zip(cubics, ends, strict=False):
        reach = max(min(end, length) - max(start, 0.0), 0.0)
        largest = sum(abs(coefficient) * reach**power for power, coefficient in enumerate(coefficients))
        if reach > 0.0 and not largest <= _MAX_LANE_OFFSET:
            raise InputError(f"{subject} reaches {largest:.3g} m; at most {_MAX_LANE_OFFSET:g} m are allowed.")
