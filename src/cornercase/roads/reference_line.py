"""Reference lines of roads: the geometries of OpenDRIVE's plan view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError, suggestion
from cornercase._common.geometry import within_half_turn
from cornercase._common.ledger import local_name
from cornercase._common.numbers import number_of
from cornercase._common.places import at_line
from cornercase._common.recorded_xml import adapt
from cornercase._common.typing import FloatArray

# Change of heading in rad below which a spiral is treated as an arc, since Fresnel integrals lose digits.
_STRAIGHT: Final = 1e-7
# Half the step in m for numerical curvature.
_AROUND: Final = 0.01
# Spacing in m, and limits of the number of steps, of tables of curve parameters.
_TABULATED: Final = 0.25
_STEPS: Final = (64, 8192)
# Intervals per step, and Gauss-Legendre nodes per interval, to integrate the length.
_INTERVALS: Final = 2
_NODES: Final = 5
# Smallest derivative of the curve, to avoid division by zero.
_STILL: Final = 1e-9


@dataclass(frozen=True)
class Geometry:
    """One geometry of a reference line: start and length in m and rad, kind (name of its element) and numbers.

    `shape_parameters` are the curvature (arc), curvatures at both ends (spiral), coefficients (poly3), or largest
    parameter followed by coefficients (paramPoly3). The parameter of a ``paramPoly3`` is not proportional to the
    distance, which is measured along the curve. If the curve length differs from `length`, the curve is stretched to
    that. Beyond its ends it goes straight on.
    """

    s: float
    x: float
    y: float
    heading: float
    length: float
    kind: str
    numbers: tuple[float, ...] = ()

    def at(self, along: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return x, y and heading at distances from the start, shape (N,) each."""
        u, v, turn = self._local(along)
        cos, sin = np.cos(self.heading), np.sin(self.heading)
        return self.x + cos * u - sin * v, self.y + sin * u + cos * v, self.heading + turn

    def bend(self, along: FloatArray) -> FloatArray:
        """Return the curvature in 1/m, positive to the left, at distances from the start, shape (N,)."""
        if self.kind in ("line", "arc", "spiral"):
            first, last = (self.numbers or (0.0,))[0], (self.numbers or (0.0,))[-1]
            return first + along / self.length * (last - first)
        if self.kind == "paramPoly3":
            p, (_, *c) = self.parameter(along), self.numbers
            (du, ddu), (dv, ddv) = (
                (np.polyval(polynomial, p), np.polyval(np.polyder(polynomial), p))
                for polynomial in map(_derivative, (c[:4], c[4:]))
            )
            bend = (du * ddv - dv * ddu) / np.maximum(np.hypot(du, dv), _STILL) ** 3
            return np.where((along < 0.0) | (along > self.length), 0.0, bend)
        around = np.clip(np.stack([along - _AROUND, along + _AROUND]), 0.0, self.length)
        turn = np.diff([self._local(polynomial)[2] for polynomial in around], axis=0)[0]
        return np.asarray(within_half_turn(turn) / np.maximum(around[1] - around[0], _AROUND))

    def _local(self, along: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        if self.kind == "line":
            return along, np.zeros_like(along), np.zeros_like(along)
        if self.kind == "arc":
            return _arc(along, self.numbers[0])
        if self.kind == "spiral":
            start, end = self.numbers
            return _spiral(along, start, end, self.length)
        if self.kind == "poly3":
            return self._poly3(along)
        p, (_, *c) = self.parameter(along), self.numbers
        du, dv = np.polyval(_derivative(c[:4]), p), np.polyval(_derivative(c[4:]), p)
        turn, beyond = np.arctan2(dv, du), along - np.clip(along, 0.0, self.length)
        u, v = np.polyval(c[3::-1], p), np.polyval(c[:3:-1], p)
        return u + beyond * np.cos(turn), v + beyond * np.sin(turn), turn

    def parameter(self, along: FloatArray) -> FloatArray:
        """Return the parameter of a ``paramPoly3`` at distances from its start, (N,); constant beyond its ends."""
        value, slope = self.table
        step = self.length / (len(value) - 1)
        position = np.clip(along, 0.0, self.length) / step
        k = np.clip(position.astype(np.int64), 0, len(value) - 2)
        x = position - k
        low, high, rise = value[k], value[k + 1], value[k + 1] - value[k]
        bend_low, bend_high = step * slope[k] - rise, rise - step * slope[k + 1]
        return np.asarray((1.0 - x) * low + x * high + x * (1.0 - x) * ((1.0 - x) * bend_low + x * bend_high))

    @cached_property
    def table(self) -> tuple[FloatArray, FloatArray]:
        """Parameter of a ``paramPoly3`` at equal distances, and its derivative by distance in 1/m."""
        top, *c = self.numbers
        du, dv = _derivative(c[:4]), _derivative(c[4:])
        steps = int(np.clip(np.ceil(self.length / _TABULATED), *_STEPS))
        nodes, weights = np.polynomial.legendre.leggauss(_NODES)
        nodes, weights = 0.5 + 0.5 * nodes, 0.5 * weights

        def speed(p: FloatArray) -> FloatArray:
            return np.hypot(np.polyval(du, p), np.polyval(dv, p))

        def reach(p: FloatArray, q: FloatArray) -> FloatArray:
            return np.asarray((q - p) * (speed(p + (q - p) * nodes[:, None]) * weights[:, None]).sum(axis=0))

        grid = np.linspace(0.0, top, _INTERVALS * steps + 1)
        length = np.concatenate([[0.0], np.cumsum(reach(grid[:-1], grid[1:]))])
        goal = np.linspace(0.0, length[-1], steps + 1)
        value = np.interp(goal, length, grid)
        for _ in range(3):
            k = np.clip(np.searchsorted(grid, value, "right") - 1, 0, len(grid) - 2)
            gone = length[k] + reach(grid[k], value)
            value = np.clip(value + (goal - gone) / np.maximum(speed(value), _STILL), grid[k], grid[k + 1])
        value[[0, -1]] = 0.0, top
        rise = np.diff(value) * steps / self.length
        slope = length[-1] / self.length / np.maximum(speed(value), _STILL)
        # Limit slopes, so that the interpolation does not overshoot at cusps.
        steepest = 3.0 * np.minimum(np.append(rise, rise[-1]), np.append(rise[0], rise))
        return value, np.minimum(slope, steepest)

    def _poly3(self, along: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        # A fine table converts s, along the curve, to u, along the chord.
        u = np.linspace(0.0, self.length, 2001)
        slope = _derivative(self.numbers)
        speed = np.hypot(1.0, np.polyval(slope, u))
        s = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(u))])
        u = np.interp(along, s, u)
        return u, np.polyval(self.numbers[::-1], u), np.arctan(np.polyval(slope, u))


def read_geometry(element: etree._Element, where: str, begin: float = 0.0, end: str | None = None) -> Geometry:
    """Read a ``geometry``; `location` names file and road.

    The defaults are used if its start in m, or its end as written in the file, is not given.
    """
    s = read_number(element, "s", where, begin)
    x, y, heading = (read_number(element, name, where, 0.0) for name in ("x", "y", "hdg"))
    length = read_number(element, "length", where, _difference(end, s))
    if length < 0:
        where = at_line(where, element)
        raise InputError(f"{where}: a <geometry> has the length {length:g} m; it must be above 0.")
    if length == 0:
        adapt(element, "<geometry> of 0 m", "is left out", "the length of a <geometry> is above 0")
    shape = next(iter(element.iterchildren("line", "arc", "spiral", "poly3", "paramPoly3")), None)
    if shape is None:
        where = at_line(where, element)
        raise InputError(f"{where}: a <geometry> is not a line, arc, spiral, poly3 or paramPoly3.")
    kind = str(shape.tag)
    names = {"line": (), "arc": ("curvature",), "spiral": ("curvStart", "curvEnd"), "poly3": ("a", "b", "c", "d")}
    if kind != "paramPoly3":
        numbers = tuple(read_number(shape, name, where, 0.0) for name in names[kind])
        return Geometry(s, x, y, heading, length, kind, numbers)
    top = length if read_word(shape, "pRange", ("normalized", "arcLength"), "normalized", where) == "arcLength" else 1.0
    coefficients = [read_number(shape, f"{c}{axis}", where, 0.0) for axis in "UV" for c in "abcd"]
    return Geometry(s, x, y, heading, length, kind, (top, *coefficients))


def _arc(along: FloatArray, curvature: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    turn = curvature * along
    # sinc is accurate for small curvatures.
    chord = along * np.sinc(0.5 * turn / np.pi)
    return chord * np.cos(0.5 * turn), chord * np.sin(0.5 * turn), turn


def _spiral(along: FloatArray, start: float, end: float, length: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    rate = (end - start) / length
    if turns_evenly(start, end, length):
        return _arc(along, 0.5 * (start + end))
    # Imported here: it takes a quarter of a second, and few roads need it.
    from scipy.special import fresnel

    sign, scale = np.sign(rate), np.sqrt(np.pi / abs(rate))
    offset = start / rate
    phase = -0.5 * start * offset
    s0, c0 = fresnel(offset / scale)
    s1, c1 = fresnel((offset + along) / scale)
    c, s = scale * (c1 - c0), scale * sign * (s1 - s0)
    cos, sin = np.cos(phase), np.sin(phase)
    return cos * c - sin * s, sin * c + cos * s, start * along + 0.5 * rate * along**2


def turns_evenly(start: float, end: float, length: float) -> bool:
    """Whether the curvature of a spiral is so constant that it is treated as an arc."""
    return abs((end - start) / length) * length**2 < _STRAIGHT


def read_word(element: etree._Element, name: str, words: Sequence[str], missing: str, where: str) -> str:
    """Read an attribute that is one of a few words, ignoring case."""
    text = element.get(name)
    if not text:
        return missing
    if (match := same_word(element, name, words)) is None:
        tag, line = local_name(element), element.sourceline
        raise InputError(
            f"{where}: {name} '{text}' of <{tag}> in line {line} cannot be used; {suggestion(text, words)}"
        )
    return match


def same_word(element: etree._Element, name: str, words: Sequence[str]) -> str | None:
    """Return which of some words an attribute is, ignoring case and spaces; None if none."""
    text, tag = element.get(name, ""), local_name(element)
    match = next((word for word in words if word.lower() == text.strip().lower()), None)
    if match is not None and match != text:
        adapt(
            element, f"{name} of <{tag}>", f"is '{text}', and is read as '{match}'", f"{name} of <{tag}> is '{match}'"
        )
    return match


def _difference(end: str | None, start: float) -> float | None:
    """Return the distance from a start to an end given as text; None if it is not positive."""
    try:
        return max(number_of(end or "") - start, 0.0) or None
    except ValueError:
        return None


def note_disorder(elements: Sequence[etree._Element], starts: Sequence[float]) -> None:
    """Record which elements start before their predecessor in the file; `starts` in m."""
    for element, start, previous in zip(elements[1:], starts[1:], starts[:-1], strict=True):
        if start < previous:
            tag = local_name(element)
            adapt(
                element,
                f"order of <{tag}>",
                "they are sorted by where they begin",
                f"each <{tag}> begins after the one before",
            )


def _derivative(coefficients: tuple[float, ...] | list[float]) -> list[float]:
    return [i * c for i, c in enumerate(coefficients)][:0:-1]


def read_number(element: etree._Element, name: str, where: str, missing: float | None = None) -> float:
    """Read a finite number; the use of `default` is recorded. `location` names file and road."""
    text = element.get(name)
    if missing is not None and not (text or "").strip():
        tag = local_name(element)
        adapt(element, f"{name} of <{tag}>", f"is missing, and is read as {missing:g}", f"<{tag}> has a number {name}")
        return missing
    if text is None:
        raise InputError(f"{at_line(where, element)}: <{local_name(element)}> has no {name}; give it one.")
    try:
        number = number_of(text)
    except ValueError:
        number = float("nan")
    if not np.isfinite(number):
        where = at_line(where, element)
        raise InputError(f"{where}: {name} of <{local_name(element)}> is '{text}', not a finite number.")
    return number
