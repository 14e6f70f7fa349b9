"""Roads whose shape contradicts itself, and of which no line to drive along can be made."""

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

# m; pieces of a reference line that lie further apart than this do not meet, and those beyond the second are no line.
_MEETING: Final = 0.1
_APART: Final = 2.0
# m; nothing lies further out than this from the origin, and no lane from its road.
_FARTHEST: Final = 1e8
_WIDEST: Final = 1e4
# 1/m; a bend that is tighter than this and goes round more than once is none that one drives.
_TIGHTEST: Final = 10.0
# A cubic may be so many times as long as its geometry says, or as short.
_STRETCHED: Final = 2.0


def require_sound(road: Road, element: etree._Element, where: str) -> None:
    """Refuse a road that cannot be what its file says.

    Parameters
    ----------
    road : Road
    element : lxml element
        Where its file has it.
    where : str
        File and road, for messages.

    Raises
    ------
    InputError
        Its reference line has a hole, winds up or is much longer than its length, its lanes lie
        kilometres beside it, or it lies beyond all maps.
    """
    ends = [*(one.s for one in road.geometries[1:]), road.length]
    for geometry, end in zip(road.geometries, ends, strict=True):
        _require_shape(geometry, end, where)
    for one, other in pairwise(road.geometries):
        x, y, _ = one.at(np.array([other.s - one.s]))
        apart = float(np.hypot(x[0] - other.x, y[0] - other.y))
        if apart > _APART:
            raise InputError(
                f"{where}: the <geometry> at s = {other.s:g} m begins {apart:.3g} m away from the end of the one"
                " before; make them meet."
            )
        if apart > _MEETING:
            why = f"begins up to {_APART:g} m away from the end of the one before, and entities get there at once"
            adapt(_geometry_at(element, other.s), "<geometry>", why, "each <geometry> begins where the one before ends")
    _require_near(road.offsets, road.length, f"{where}: its <laneOffset>")
    for (start, lanes), end in zip(road.sections, road.seams[1:].tolist(), strict=True):
        for number, lane in lanes.items():
            tag, curve = ("border", lane.borders) if lane.borders else ("width", lane.widths)
            _require_near(curve, end - start, f"{where}: <{tag}> of the lane {number} at s = {start:g} m")


def _geometry_at(road: etree._Element, s: float) -> etree._Element:
    """The <geometry> of a road that begins at s, in m; the road itself where it does not say so."""
    for one in unrecorded(road, "planView", "geometry"):
        if float(one.attrib.get("s") or "nan") == s:
            return one
    return road


def _require_shape(geometry: Geometry, end: float, where: str) -> None:
    where = f"{where}: the <geometry> at s = {geometry.s:g} m"
    if geometry.kind in ("line", "arc", "spiral"):
        # It lies nowhere further away than it is long.
        most = max(abs(geometry.x), abs(geometry.y)) + max(geometry.length, end - geometry.s)
        if not (most < _FARTHEST and np.isfinite(geometry.heading)):
            raise InputError(f"{where} lies more than {_FARTHEST / 1000:g} km from the origin; move it nearer.")
        bend = max(map(abs, geometry.numbers), default=0.0)
        if bend > _TIGHTEST and bend * geometry.length > 2.0 * np.pi:
            raise InputError(f"{where} has a curvature of {bend:g} 1/m; at most {_TIGHTEST:g} 1/m are read.")
        return
    # A road goes on in the shape of its last geometry.
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
    """Refuse cubics that reach too far out between their starts."""
    ends = [*(start for start, *_ in cubics), length][1:]
    for (start, *coefficients), end in zip(cubics, ends, strict=False):
        reach = max(min(end, length) - max(start, 0.0), 0.0)
        most = sum(abs(of) * reach**power for power, of in enumerate(coefficients))
        if reach > 0.0 and not most <= _WIDEST:
            raise InputError(f"{what} reaches {most:.3g} m out; at most {_WIDEST:g} m are read.")
