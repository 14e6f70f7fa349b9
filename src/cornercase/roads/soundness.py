"""Reject roads with inconsistent geometry."""

from __future__ import annotations

from itertools import pairwise
from typing import Final

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.recorded_xml import adapt, unrecorded
from cornercase.roads.lane import Polynomial
from cornercase.roads.reference_line import Geometry
from cornercase.roads.road import Road

# Gaps in m between geometries that are reported and refused.
_MEETING: Final = 0.1
_APART: Final = 2.0
# Largest distances in m: from the origin, and of a lane from its road.
_FARTHEST: Final = 1e8
_WIDEST: Final = 1e4
# Largest curvature in 1/m of a bend of more than a full turn.
_TIGHTEST: Final = 10.0
# Largest ratio of curve length and given length, and its inverse.
_STRETCHED: Final = 2.0


def require_sound(road: Road, element: etree._Element, where: str) -> None:
    """Raise `InputError` if a road cannot be driven.

    That is so if its reference line has gaps, winds up or is much longer than its length, or if it or its lanes are
    extremely far away.
    """
    ends = [*(geometry_.s for geometry_ in road.geometries[1:]), road.length]
    for geometry, end in zip(road.geometries, ends, strict=True):
        _require_shape(geometry, end, where)
    for geometry_, following in pairwise(road.geometries):
        x, y, _ = geometry_.at(np.array([following.s - geometry_.s]))
        distance = float(np.hypot(x[0] - following.x, y[0] - following.y))
        if distance > _APART:
            raise InputError(
                f"{where}: the <geometry> at s = {following.s:g} m begins {distance:.3g} m away from the end of the one"
                " before; make them meet."
            )
        if distance > _MEETING:
            reason = f"begins up to {_APART:g} m away from the end of the one before; entities jump across"
            adapt(
                _geometry_at(element, following.s),
                "<geometry>",
                reason,
                "each <geometry> begins where the one before ends",
            )
    _require_near(road.offsets, road.length, f"{where}: its <laneOffset>")
    for (start, lanes), end in zip(road.sections, road.seams[1:].tolist(), strict=True):
        for number, lane in lanes.items():
            tag, curve = ("border", lane.borders) if lane.borders else ("width", lane.widths)
            _require_near(curve, end - start, f"{where}: <{tag}> of the lane {number} at s = {start:g} m")


def _geometry_at(road: etree._Element, s: float) -> etree._Element:
    """Return the <geometry> that starts at s; the road if there is none."""
    for geometry in unrecorded(road, "planView", "geometry"):
        if float(geometry.attrib.get("s") or "nan") == s:
            return geometry
    return road


def _require_shape(geometry: Geometry, end: float, where: str) -> None:
    where = f"{where}: the <geometry> at s = {geometry.s:g} m"
    if geometry.kind in ("line", "arc", "spiral"):
        # Its length bounds its distance from the start.
        farthest = max(abs(geometry.x), abs(geometry.y)) + max(geometry.length, end - geometry.s)
        if not (farthest < _FARTHEST and np.isfinite(geometry.heading)):
            raise InputError(f"{where} lies more than {_FARTHEST / 1000:g} km from the origin; move it nearer.")
        bend = max(map(abs, geometry.numbers), default=0.0)
        if bend > _TIGHTEST and bend * geometry.length > 2.0 * np.pi:
            raise InputError(f"{where} has a curvature of {bend:g} 1/m; at most {_TIGHTEST:g} 1/m are read.")
        return
    # The last geometry is continued to the end of the road.
    along = np.append(np.linspace(0.0, geometry.length, 101), end - geometry.s)
    with np.errstate(all="ignore"):
        x, y, heading = geometry.at(along)
        length = float(np.hypot(np.diff(x[:-1]), np.diff(y[:-1])).sum())
    if not (np.isfinite(heading).all() and max(np.abs(x).max(), np.abs(y).max()) < _FARTHEST):
        raise InputError(f"{where} lies more than {_FARTHEST / 1000:g} km from the origin; move it nearer.")
    if geometry.kind == "paramPoly3" and not 1 / _STRETCHED <= length / geometry.length <= _STRETCHED:
        raise InputError(
            f"{where} is a <paramPoly3> that is {length:.3g} m long, but its length says {geometry.length:g} m; correct"
            " its coefficients, or its pRange."
        )


def _require_near(cubics: tuple[Polynomial, ...], length: float, what: str) -> None:
    """Refuse cubics that get too large between their starts."""
    ends = [*(start for start, *_ in cubics), length][1:]
    for (start, *coefficients), end in zip(cubics, ends, strict=False):
        reach = max(min(end, length) - max(start, 0.0), 0.0)
        largest = sum(abs(of) * reach**power for power, of in enumerate(coefficients))
        if reach > 0.0 and not largest <= _WIDEST:
            raise InputError(f"{what} reaches {largest:.3g} m out; at most {_WIDEST:g} m are read.")
