"""Reference lines of roads, which OpenDRIVE composes of geometries such as lines, arcs and spirals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError, suggest_name
from cornercase._common.geometry.boxes import wrap_angle
from cornercase._common.io.support_table import tag_without_namespace
from cornercase._common.io.tracked_xml import note_adaptation
from cornercase._common.text.element_locations import replace_line_number
from cornercase._common.text.parse_number import parse_number
from cornercase._common.typing import FloatArray

# Change of heading in rad below which a spiral is treated as an arc, since Fresnel integrals lose digits.
_MAX_ARC_DEVIATION: Final = 1e-7
# Half the step in m for numerical curvature.
_CURVATURE_HALF_STEP: Final = 0.01
# Spacing in m, and limits of the number of steps, of tables of curve parameters.
_TABLE_STEP: Final = 0.25
_TABLE_SIZE_LIMITS: Final = (64, 8192)
# Intervals per step, and Gauss-Legendre nodes per interval, to integrate the length.
_INTERVALS_PER_STEP: Final = 2
_NODES_PER_INTERVAL: Final = 5
# Smallest derivative of the curve, to avoid division by zero.
_MIN_DERIVATIVE: Final = 1e-9


@dataclass(frozen=True)
class ReferenceGeometry:
    """A geometry: one piece of a reference line. Lengths are in m, angles in rad.

    `s`, `x`, `y` and `heading` are those of its start. `kind` is the name of its element, such as ``"arc"``.
    `shape_parameters` are the curvature of an arc, the curvatures at both ends of a spiral, or the coefficients of a
    poly3. For a paramPoly3 they are the value of the curve parameter p at the end, followed by the coefficients.

    All methods take distances along the curve, to which the curve parameter of a paramPoly3 is not proportional. If
    the coefficients of a paramPoly3 give another length than `length`, distances are scaled to fit. Before its start
    and after its end, a paramPoly3 goes straight on.
    """

    s: float
    x: float
    y: float
    heading: float
    length: float
    kind: str
    shape_parameters: tuple[float, ...] = ()

    def pose_at(self, distance: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return x, y and heading at distances in m from the start, shape (N,) each."""
        u, v, turn = self._local_pose(distance)
        cos, sin = np.cos(self.heading), np.sin(self.heading)
        return self.x + cos * u - sin * v, self.y + sin * u + cos * v, self.heading + turn

    def curvature_at(self, distance: FloatArray) -> FloatArray:
        """Return the curvature in 1/m, positive to the left, at distances from the start, shape (N,)."""
        if self.kind in ("line", "arc", "spiral"):
            first, last = (self.shape_parameters or (0.0,))[0], (self.shape_parameters or (0.0,))[-1]
            return first + distance / self.length * (last - first)
        if self.kind == "paramPoly3":
            p, (_, *c) = self.curve_parameter(distance), self.shape_parameters
            (du, ddu), (dv, ddv) = (
                (np.polyval(polynomial, p), np.polyval(np.polyder(polynomial), p))
                for polynomial in map(_derivative_coefficients, (c[:4], c[4:]))
            )
            bend = (du * ddv - dv * ddu) / np.maximum(np.hypot(du, dv), _MIN_DERIVATIVE) ** 3
            return np.where((distance < 0.0) | (distance > self.length), 0.0, bend)
        around = np.clip(np.stack([distance - _CURVATURE_HALF_STEP, distance + _CURVATURE_HALF_STEP]), 0.0, self.length)
        turn = np.diff([self._local_pose(position)[2] for position in around], axis=0)[0]
        return np.asarray(wrap_angle(turn) / np.maximum(around[1] - around[0], _CURVATURE_HALF_STEP))

    def _local_pose(self, distance: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        if self.kind == "line":
            return distance, np.zeros_like(distance), np.zeros_like(distance)
        if self.kind == "arc":
            return _arc_pose(distance, self.shape_parameters[0])
        if self.kind == "spiral":
            start, end = self.shape_parameters
            return _spiral_pose(distance, start, end, self.length)
        if self.kind == "poly3":
            return self._poly3_pose(distance)
        p, (_, *c) = self.curve_parameter(distance), self.shape_parameters
        du, dv = np.polyval(_derivative_coefficients(c[:4]), p), np.polyval(_derivative_coefficients(c[4:]), p)
        turn, beyond = np.arctan2(dv, du), distance - np.clip(distance, 0.0, self.length)
        u, v = np.polyval(c[3::-1], p), np.polyval(c[:3:-1], p)
        return u + beyond * np.cos(turn), v + beyond * np.sin(turn), turn

    def curve_parameter(self, distance: FloatArray) -> FloatArray:
        """Return the curve parameter p of a ``paramPoly3`` at distances from its start, shape (N,).

        Distances before the start or after the end are clipped.
        """
        value, slope = self.parameter_table
        step = self.length / (len(value) - 1)
        position = np.clip(distance, 0.0, self.length) / step
        k = np.clip(position.astype(np.int64), 0, len(value) - 2)
        x = position - k
        low, high, rise = value[k], value[k + 1], value[k + 1] - value[k]
        bend_low, bend_high = step * slope[k] - rise, rise - step * slope[k + 1]
        return np.asarray((1.0 - x) * low + x * high + x * (1.0 - x) * ((1.0 - x) * bend_low + x * bend_high))

    @cached_property
    def parameter_table(self) -> tuple[FloatArray, FloatArray]:
        """Curve parameter p of a ``paramPoly3`` at evenly spaced distances, and its derivative by distance, in 1/m."""
        top, *c = self.shape_parameters
        du, dv = _derivative_coefficients(c[:4]), _derivative_coefficients(c[4:])
        steps = int(np.clip(np.ceil(self.length / _TABLE_STEP), *_TABLE_SIZE_LIMITS))
        nodes, weights = np.polynomial.legendre.leggauss(_NODES_PER_INTERVAL)
        nodes, weights = 0.5 + 0.5 * nodes, 0.5 * weights

        def derivative_norm(p: FloatArray) -> FloatArray:
            return np.hypot(np.polyval(du, p), np.polyval(dv, p))

        def arc_length(p: FloatArray, q: FloatArray) -> FloatArray:
            return np.asarray((q - p) * (derivative_norm(p + (q - p) * nodes[:, None]) * weights[:, None]).sum(axis=0))

        grid = np.linspace(0.0, top, _INTERVALS_PER_STEP * steps + 1)
        length = np.concatenate([[0.0], np.cumsum(arc_length(grid[:-1], grid[1:]))])
        goal = np.linspace(0.0, length[-1], steps + 1)
        value = np.interp(goal, length, grid)
        for _ in range(3):
            k = np.clip(np.searchsorted(grid, value, "right") - 1, 0, len(grid) - 2)
            covered = length[k] + arc_length(grid[k], value)
            value = np.clip(
                value + (goal - covered) / np.maximum(derivative_norm(value), _MIN_DERIVATIVE), grid[k], grid[k + 1]
            )
        value[[0, -1]] = 0.0, top
        rise = np.diff(value) * steps / self.length
        slope = length[-1] / self.length / np.maximum(derivative_norm(value), _MIN_DERIVATIVE)
        # Limit slopes, so that the interpolation does not overshoot at cusps.
        steepest = 3.0 * np.minimum(np.append(rise, rise[-1]), np.append(rise[0], rise))
        return value, np.minimum(slope, steepest)

    def _poly3_pose(self, distance: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        # A fine table converts s, along the curve, to u, along the chord.
        u = np.linspace(0.0, self.length, 2001)
        slope = _derivative_coefficients(self.shape_parameters)
        speed = np.hypot(1.0, np.polyval(slope, u))
        s = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(u))])
        u = np.interp(distance, s, u)
        return u, np.polyval(self.shape_parameters[::-1], u), np.arctan(np.polyval(slope, u))


def read_geometry(
    element: etree._Element, location: str, default_start: float = 0.0, default_end: str | None = None
) -> ReferenceGeometry:
    """Read a ``geometry``; `location` names file and road.

    If the file gives no start, the geometry starts at `default_start` (in m). If the file gives no length, the geometry
    ends at `default_end` (text of the file in m).
    """
    s = read_finite_number(element, "s", location, default_start)
    x, y, heading = (read_finite_number(element, name, location, 0.0) for name in ("x", "y", "hdg"))
    length = read_finite_number(element, "length", location, _positive_difference(default_end, s))
    if length < 0:
        location = replace_line_number(location, element)
        raise InputError(f"{location}: a <geometry> has the length {length:g} m; it must be above 0.")
    if length == 0:
        note_adaptation(element, "<geometry> of 0 m", "is left out", "the length of a <geometry> is above 0")
    shape = next(iter(element.iterchildren("line", "arc", "spiral", "poly3", "paramPoly3")), None)
    if shape is None:
        location = replace_line_number(location, element)
        raise InputError(
            f"{location}: a <geometry> has no <line>, <arc>, <spiral>, <poly3> or <paramPoly3>; give it one."
        )
    kind = str(shape.tag)
    names = {"line": (), "arc": ("curvature",), "spiral": ("curvStart", "curvEnd"), "poly3": ("a", "b", "c", "d")}
    if kind != "paramPoly3":
        numbers = tuple(read_finite_number(shape, name, location, 0.0) for name in names[kind])
        return ReferenceGeometry(s, x, y, heading, length, kind, numbers)
    top = (
        length
        if read_enumeration(shape, "pRange", ("normalized", "arcLength"), "normalized", location) == "arcLength"
        else 1.0
    )
    coefficients = [read_finite_number(shape, f"{c}{axis}", location, 0.0) for axis in "UV" for c in "abcd"]
    return ReferenceGeometry(s, x, y, heading, length, kind, (top, *coefficients))


def _arc_pose(distance: FloatArray, curvature: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    turn = curvature * distance
    # sinc is accurate for small curvatures.
    chord = distance * np.sinc(0.5 * turn / np.pi)
    return chord * np.cos(0.5 * turn), chord * np.sin(0.5 * turn), turn


def _spiral_pose(
    distance: FloatArray, start: float, end: float, length: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    rate = (end - start) / length
    if is_nearly_arc(start, end, length):
        return _arc_pose(distance, 0.5 * (start + end))
    # Imported here: it takes a quarter of a second, and few roads need it.
    from scipy.special import fresnel

    sign, scale = np.sign(rate), np.sqrt(np.pi / abs(rate))
    offset = start / rate
    phase = -0.5 * start * offset
    s0, c0 = fresnel(offset / scale)
    s1, c1 = fresnel((offset + distance) / scale)
    c, s = scale * (c1 - c0), scale * sign * (s1 - s0)
    cos, sin = np.cos(phase), np.sin(phase)
    return cos * c - sin * s, sin * c + cos * s, start * distance + 0.5 * rate * distance**2


def is_nearly_arc(start_curvature: float, end_curvature: float, length: float) -> bool:
    """Return whether a spiral is treated as an arc, since its curvature is nearly constant."""
    return abs((end_curvature - start_curvature) / length) * length**2 < _MAX_ARC_DEVIATION


def read_enumeration(
    element: etree._Element, attribute: str, allowed: Sequence[str], default: str, location: str
) -> str:
    """Read an attribute with a fixed set of allowed values, ignoring case."""
    text = element.get(attribute)
    if not text:
        return default
    if (match := match_enumeration(element, attribute, allowed)) is None:
        tag, line = tag_without_namespace(element), element.sourceline
        raise InputError(
            f"{location}: {attribute} '{text}' of <{tag}> in line {line} cannot be used; {suggest_name(text, allowed)}"
        )
    return match


def match_enumeration(element: etree._Element, attribute: str, allowed: Sequence[str]) -> str | None:
    """Return the allowed value that an attribute matches, ignoring case and spaces; None if it matches none."""
    text, tag = element.get(attribute, ""), tag_without_namespace(element)
    match = next((word for word in allowed if word.lower() == text.strip().lower()), None)
    if match is not None and match != text:
        note_adaptation(
            element,
            f"{attribute} of <{tag}>",
            f"is '{text}', and is read as '{match}'",
            f"{attribute} of <{tag}> is '{match}'",
        )
    return match


def _positive_difference(end: str | None, start: float) -> float | None:
    """Return `end` (text of a file) minus `start`; None if the difference is not above 0, or `end` is not a number."""
    try:
        return max(parse_number(end or "") - start, 0.0) or None
    except ValueError:
        return None


def record_wrong_order(elements: Sequence[etree._Element], starts: Sequence[float]) -> None:
    """Record a violation of the standard on each element that starts before its predecessor in the file.

    `starts` has the start of each element in m.
    """
    for element, start, previous in zip(elements[1:], starts[1:], starts[:-1], strict=True):
        if start < previous:
            tag = tag_without_namespace(element)
            note_adaptation(
                element,
                f"order of <{tag}>",
                "they are sorted by where they begin",
                f"each <{tag}> begins after the one before",
            )


def _derivative_coefficients(coefficients: tuple[float, ...] | list[float]) -> list[float]:
    return [i * c for i, c in enumerate(coefficients)][:0:-1]


def read_finite_number(element: etree._Element, attribute: str, location: str, default: float | None = None) -> float:
    """Read a finite number from an attribute; `location` names file and road.

    If the attribute is missing, return `default` and record a violation of the standard on the element. If `default` is
    None, raise `InputError` instead.
    """
    text = element.get(attribute)
    if default is not None and not (text or "").strip():
        tag = tag_without_namespace(element)
        note_adaptation(
            element,
            f"{attribute} of <{tag}>",
            f"is missing, and is read as {default:g}",
            f"<{tag}> has a number {attribute}",
        )
        return default
    if text is None:
        raise InputError(
            f"{replace_line_number(location, element)}: <{tag_without_namespace(element)}> has no {attribute};"
            " give it one."
        )
    try:
        number = parse_number(text)
    except ValueError:
        number = float("nan")
    if not np.isfinite(number):
        location = replace_line_number(location, element)
        raise InputError(
            f"{location}: {attribute} of <{tag_without_namespace(element)}> is '{text}', not a finite number."
        )
    return number
