"""Sketches of a run from above, as SVG for print: road, paths and outlines of entities.

The outlines are drawn at the start, and at the meeting: the first contact of the ego, or else its closest approach.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from html import escape
from typing import Final

import numpy as np
from markupsafe import Markup

from cornercase._common.geometry.boxes import box_corners
from cornercase._common.text.sanitize import escape_control_characters, shorten
from cornercase._common.typing import FloatArray
from cornercase.recordings import Recording
from cornercase.report.cards._meeting import Meeting
from cornercase.roads._outline import Region, RoadOutline

# Units of a drawing per mm of paper.
_PER_MM: Final = 5.0
# Strip below a drawing for scale and axes, and space around what is shown, for names; in units of a drawing.
_STRIP: Final = 30.0
_PADDING: Final = 24.0
# Margin around the boxes that are shown, in m.
_MARGIN: Final = 4.0
# Smallest part of the road that a sketch shows, and what the sketch of the meeting shows, in m.
_MIN_WIDTH: Final = 20.0
_MEETING_RADIUS: Final = 9.0
_MAX_PATH_POINTS: Final = 150
_MAX_NAME: Final = 18
_BAR_LENGTHS: Final = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0)


@dataclass(frozen=True)
class View:
    """Projection of a part of the plane, in m, to drawing coordinates.

    `scale` is in drawing units per m; `width` and `height` are in drawing units. If `turned`, x goes down and y to the
    right, so that roads along y fill a wide drawing.
    """

    center: tuple[float, float]
    scale: float
    width: float
    height: float
    turned: bool

    @classmethod
    def fit(cls, region: Region, width: float, height: float, turned: bool, padding: float = 0.0) -> View:
        """Return the view that fits a region, in m, into a drawing.

        `width`, `height` and `padding` are in drawing units; `height` includes the strip with the scale bar below.
        """
        height -= _STRIP
        x_min, y_min, x_max, y_max = region
        across, up = max(x_max - x_min, 1.0), max(y_max - y_min, 1.0)
        across, up = (up, across) if turned else (across, up)
        scale = min((width - 2.0 * padding) / max(across, _MIN_WIDTH), (height - 2.0 * padding) / up)
        return cls(((x_min + x_max) / 2.0, (y_min + y_max) / 2.0), scale, width, height, turned)

    def project(self, points: FloatArray) -> FloatArray:
        """Return the drawing coordinates of points given in m, shape (n, 2)."""
        dx, dy = (points - np.array(self.center)).T * self.scale
        right, up = (dy, -dx) if self.turned else (dx, dy)
        return np.stack([self.width / 2.0 + right, self.height / 2.0 - up], axis=1)


def draw_paths_to_meeting(
    recording: Recording, ego: str, meeting: Meeting, road: RoadOutline | None, width_mm: float, height_mm: float
) -> Markup:
    """Draw the paths of all entities from above, with their outlines at the start and at the ego's meeting."""
    region = _find_region_of_paths(recording, ego, meeting)
    size = width_mm * _PER_MM, height_mm * _PER_MM
    # The view with the larger scale; the first if both scales are equal.
    view = max((View.fit(region, *size, turned, _PADDING) for turned in (False, True)), key=lambda view: view.scale)
    parts = [*_draw_road(view, road)]
    for name in _drawing_order(recording, ego, meeting):
        parts += _draw_path(view, recording, name, meeting, _css_class(name, ego, meeting))
    for name in _drawing_order(recording, ego, meeting):
        parts += _draw_boxes(view, recording, name, meeting, _css_class(name, ego, meeting))
    parts += _draw_labels(view, recording, ego, meeting)
    label = f"Paths of {ego} and {meeting.other} from above, with both at the start and at {meeting.time:.2f} s"
    return _wrap_in_svg(view, [*parts, *_draw_contact_point(view, meeting), *_draw_scale(view)], label)


def draw_meeting_closeup(
    recording: Recording, ego: str, meeting: Meeting, road: RoadOutline | None, width_mm: float, height_mm: float
) -> Markup:
    """Draw a close-up of the boxes at the contact, or at the closest approach if there is no contact."""
    centers = [recording.box_center(name)[meeting.instant] for name in (ego, meeting.other)]
    centers = [center for center in centers if np.isfinite(center).all()]
    reach = _MEETING_RADIUS
    if len(centers) == 2:
        reach = max(reach, 0.5 * float(np.hypot(*(centers[1] - centers[0]))) + _MEETING_RADIUS / 2.0)
    x, y = np.mean(centers, axis=0) if centers else (0.0, 0.0)
    region = (x - reach, y - reach, x + reach, y + reach)
    view = View.fit(region, width_mm * _PER_MM, height_mm * _PER_MM, False)
    parts = [*_draw_road(view, road)]
    for name in _drawing_order(recording, ego, meeting):
        parts += _draw_path(view, recording, name, meeting, _css_class(name, ego, meeting))
        parts += _draw_boxes(view, recording, name, meeting, _css_class(name, ego, meeting), start=False)
    what = "contact" if meeting.collides else "closest approach"
    label = f"{ego} and {meeting.other} at the {what}, {meeting.time:.2f} s"
    return _wrap_in_svg(view, [*parts, *_draw_contact_point(view, meeting), *_draw_scale(view)], label)


def _find_region_of_paths(recording: Recording, ego: str, meeting: Meeting) -> Region:
    corners = [_corners(recording, name)[: meeting.instant + 1] for name in (ego, meeting.other)]
    points = np.concatenate([part.reshape(-1, 2) for part in corners])
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        return (-_MIN_WIDTH, -_MIN_WIDTH, _MIN_WIDTH, _MIN_WIDTH)
    (x_min, y_min), (x_max, y_max) = points.min(axis=0) - _MARGIN, points.max(axis=0) + _MARGIN
    return float(x_min), float(y_min), float(x_max), float(y_max)


def _drawing_order(recording: Recording, ego: str, meeting: Meeting) -> list[str]:
    further = [name for name in recording.names if name not in (ego, meeting.other)]
    return [*further, *(name for name in (meeting.other, ego) if name in recording.names)]


def _css_class(name: str, ego: str, meeting: Meeting) -> str:
    return "ego" if name == ego else "other" if name == meeting.other else "further"


def _draw_road(view: View, road: RoadOutline | None) -> Iterator[str]:
    if road is None:
        return
    for kind, points in road.areas:
        if _is_in_view(view, points):
            yield f"<path class='{kind}' d='{_format_svg_path(view.project(points))}Z'/>"
    for kind, points in road.lines:
        if _is_in_view(view, points):
            yield f"<path class='{kind}' d='{_format_svg_path(view.project(points))}'/>"


def _is_in_view(view: View, points: FloatArray) -> bool:
    projected = view.project(points)
    low, high = projected.min(axis=0), projected.max(axis=0)
    return bool((high >= 0.0).all() and low[0] <= view.width and low[1] <= view.height)


def _draw_path(view: View, recording: Recording, name: str, meeting: Meeting, role: str) -> Iterator[str]:
    centers = recording.box_center(name)
    parts = ((centers[: meeting.instant + 1], ""), (centers[meeting.instant :], " after"))
    for points, after in parts:
        points = points[np.isfinite(points).all(axis=1)]
        if len(points) > 1 and np.ptp(points, axis=0).max() > 0.1:
            shown = points[np.unique(np.linspace(0, len(points) - 1, min(len(points), _MAX_PATH_POINTS)).astype(int))]
            yield f"<path class='way {role}{after}' d='{_format_svg_path(view.project(shown))}'/>"


def _draw_boxes(
    view: View, recording: Recording, name: str, meeting: Meeting, role: str, *, start: bool = True
) -> Iterator[str]:
    corners = _corners(recording, name)
    first = _first_instant(corners)
    if first is None:
        return
    if start and first <= meeting.instant:
        yield f"<path class='box {role} start' d='{_format_svg_path(view.project(corners[first]))}Z'/>"
        yield _draw_heading_arrow(view, recording, name, first, role)
    if np.isfinite(corners[meeting.instant]).all():
        yield f"<path class='box {role}' d='{_format_svg_path(view.project(corners[meeting.instant]))}Z'/>"
        if not start:
            yield _draw_heading_arrow(view, recording, name, meeting.instant, role)


def _corners(recording: Recording, name: str) -> FloatArray:
    """Return the corners of an entity's box at all T instants in m, shape (T, 4, 2); NaN while it does not exist."""
    k, center = recording.entity_index(name), recording.box_center(name)
    return box_corners(center[:, 0], center[:, 1], recording.heading[k], recording.length[k], recording.width[k])


def _first_instant(corners: FloatArray) -> int | None:
    present = np.flatnonzero(np.isfinite(corners).all(axis=(1, 2)))
    return int(present[0]) if len(present) else None


def _draw_heading_arrow(view: View, recording: Recording, name: str, instant: int, role: str) -> str:
    """Return an arrow from the front of a box in the direction of its heading."""
    k = recording.entity_index(name)
    heading = float(recording.heading[k, instant])
    ahead = np.array([math.cos(heading), math.sin(heading)])
    front = recording.box_center(name)[instant] + 0.5 * recording.length[k] * ahead
    tail = view.project(front[None])[0]
    unit = view.project((front + ahead)[None])[0] - tail
    unit /= np.hypot(*unit)
    side = np.array([-unit[1], unit[0]])
    tip, left, right = tail + 14.0 * unit, tail + 7.0 * unit + 4.0 * side, tail + 7.0 * unit - 4.0 * side
    shaft = f"M{tail[0]:.1f} {tail[1]:.1f}L{tip[0]:.1f} {tip[1]:.1f}"
    return f"<path class='arrow {role}' d='{shaft}{_format_svg_path(np.stack([left, tip, right]))}'/>"


def _draw_labels(view: View, recording: Recording, ego: str, meeting: Meeting) -> Iterator[str]:
    """Yield labels with the names at the start boxes of ego and other: above the upper box, below the lower box."""
    boxes = {}
    for name in (ego, meeting.other):
        if name in recording.names and (first := _first_instant(_corners(recording, name))) is not None:
            boxes[name] = view.project(_corners(recording, name)[first])
    for name, corners in boxes.items():
        rival = [other for key, other in boxes.items() if key != name]
        above = not rival or corners[:, 1].mean() <= rival[0][:, 1].mean()
        y = corners[:, 1].min() - 8.0 if above else corners[:, 1].max() + 18.0
        text = escape(shorten(escape_control_characters(name), _MAX_NAME))
        x = float(np.clip(corners[:, 0].mean(), 8.0, view.width - 8.0))
        anchor = "start" if x < 60.0 else "end" if x > view.width - 60.0 else "middle"
        y = float(np.clip(y, 16.0, view.height - 8.0))
        css_class = _css_class(name, ego, meeting)
        yield f"<text class='{css_class}' x='{x:.1f}' y='{y:.1f}' text-anchor='{anchor}'>{text}</text>"


def _draw_contact_point(view: View, meeting: Meeting) -> Iterator[str]:
    if meeting.point is not None:
        x, y = view.project(np.array([meeting.point]))[0]
        yield f"<path class='point' d='M{x - 7:.1f} {y - 7:.1f}l14 14m0 -14l-14 14'/>"


def _draw_scale(view: View) -> Iterator[str]:
    """Yield the strip below the drawing: a scale bar with a round length in m, and arrows along the x- and y-axis."""
    fitting = [length for length in _BAR_LENGTHS if length * view.scale <= 0.3 * view.width]
    meters = max(fitting, default=_BAR_LENGTHS[0])
    length, y = meters * view.scale, view.height + 19.0
    yield f"<rect class='plate' x='0' y='{view.height:g}' width='{view.width:g}' height='{_STRIP:g}'/>"
    yield f"<path class='bar' d='M10 {y - 6:.1f}v6h{length:.1f}v-6'/>"
    yield f"<text x='{16 + length:.1f}' y='{y:.1f}'>{meters:g} m</text>"
    # x goes down and y to the right in a turned view.
    x, arms = view.width - 42.0, (((20, 0), "y", (28, 4)), ((0, 14), "x", (-10, 15)))
    y = view.height + 8.0
    if not view.turned:
        y, arms = view.height + 23.0, (((20, 0), "x", (28, 4)), ((0, -14), "y", (-10, -6)))
    for (dx, dy), name, (tx, ty) in arms:
        yield f"<path class='bar' d='M{x:.1f} {y:.1f}l{dx} {dy}'/>"
        yield f"<text x='{x + tx:.1f}' y='{y + ty:.1f}' text-anchor='middle'>{name}</text>"


def _format_svg_path(points: FloatArray) -> str:
    return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in points)


def _wrap_in_svg(view: View, parts: list[str], label: str) -> Markup:
    clean = escape(escape_control_characters(label))
    box = f"viewBox='0 0 {view.width:g} {view.height + _STRIP:g}'"
    return Markup(f"<svg {box} role='img' aria-label='{clean}'>{''.join(parts)}</svg>")
