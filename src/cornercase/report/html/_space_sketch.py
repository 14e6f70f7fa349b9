"""Small drawing of all scenarios over two parameters, as SVG for print."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from html import escape
from typing import Final

import numpy as np
from markupsafe import Markup

from cornercase._common.text.sanitize import escape_control_characters, shorten
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.report.text._phrases import format_axis_label
from cornercase.scenario import Parameter

_WIDTH, _HEIGHT = 330, 250
_LEFT, _RIGHT, _TOP, _BOTTOM = 48, 10, 8, 40
# Of more scenarios, about this many are drawn, picked evenly; critical and kept scenarios are always drawn.
_MAX_POINTS: Final = 2000
_MAX_LABEL: Final = 40


def draw_space_sketch(
    values: FloatArray,
    parameters: Sequence[Parameter],
    indices: Sequence[int],
    critical: BoolArray,
    selected: BoolArray,
) -> Markup:
    """Draw scenarios over the parameters at the first two `indices`: grey dots, red crosses if critical, rings if kept.

    `values` has shape (n, d): d parameters of n scenarios, choices as indices. `critical` and `selected` have shape
    (n,).
    """
    axes = [parameters[k] for k in indices[:2]]
    across = _positions(values[:, indices[0]], axes[0], _LEFT, _WIDTH - _RIGHT)
    up = (
        _positions(values[:, indices[1]], axes[1], _HEIGHT - _BOTTOM, _TOP)
        if len(axes) > 1
        else np.full(len(values), (_TOP + _HEIGHT - _BOTTOM) / 2.0)
    )
    every = max(1, len(values) // _MAX_POINTS)
    drawn = (np.arange(len(values)) % every == 0) | critical | selected
    parts = list(_draw_axes(axes))
    for x, y, is_critical, is_selected in zip(across[drawn], up[drawn], critical[drawn], selected[drawn], strict=True):
        parts.append(
            f"<path class='critical' d='M{x - 2.2:.1f} {y - 2.2:.1f}l4.4 4.4m0 -4.4l-4.4 4.4'/>"
            if is_critical
            else f"<circle class='other' cx='{x:.1f}' cy='{y:.1f}' r='1.5'/>"
        )
        if is_selected:
            parts.append(f"<circle class='kept' cx='{x:.1f}' cy='{y:.1f}' r='4.6'/>")
    label = escape(" and ".join(escape_control_characters(axis.name) for axis in axes))
    return Markup(
        f"<svg viewBox='0 0 {_WIDTH} {_HEIGHT}' role='img' aria-label='Scenarios over {label}'>{''.join(parts)}</svg>"
    )


def _bounds(parameter: Parameter) -> tuple[float, float]:
    low, high = (0.0, len(parameter.choices) - 1.0) if parameter.choices else (parameter.low, parameter.high)
    return (low, high) if high > low else (low - 0.5, high + 0.5)


def _positions(values: FloatArray, parameter: Parameter, begin: float, end: float) -> FloatArray:
    low, high = _bounds(parameter)
    return begin + (values - low) / (high - low) * (end - begin)


def _draw_axes(axes: Sequence[Parameter]) -> Iterator[str]:
    right, bottom = _WIDTH - _RIGHT, _HEIGHT - _BOTTOM
    yield f"<path class='frame' d='M{_LEFT} {_TOP}V{bottom}H{right}'/>"
    for k, axis in enumerate(axes):
        for value, text in _ticks(axis):
            if k == 0:
                x = float(_positions(np.array([value]), axis, _LEFT, right)[0])
                yield f"<text x='{x:.1f}' y='{bottom + 13}' text-anchor='middle'>{text}</text>"
            else:
                y = float(_positions(np.array([value]), axis, bottom, _TOP)[0])
                yield f"<text x='{_LEFT - 5}' y='{y + 3:.1f}' text-anchor='end'>{text}</text>"
        name = escape(shorten(escape_control_characters(format_axis_label(axis)), _MAX_LABEL))
        if k == 0:
            yield f"<text x='{(_LEFT + right) / 2:.1f}' y='{bottom + 30}' text-anchor='middle'>{name}</text>"
        else:
            middle = (_TOP + bottom) / 2
            yield f"<text transform='translate(11 {middle:.1f}) rotate(-90)' text-anchor='middle'>{name}</text>"


def _ticks(parameter: Parameter) -> list[tuple[float, str]]:
    """Return the tick values of an axis with their labels; the labels are escaped."""
    if parameter.choices:
        # Long names would cover each other.
        names = [escape(shorten(escape_control_characters(name), 7)) for name in parameter.choices]
        return [(float(k), name) for k, name in enumerate(names)][:: max(1, math.ceil(len(names) / 5))]
    low, high = _bounds(parameter)
    step = 10.0 ** math.floor(math.log10((high - low) / 4.0))
    step *= next(factor for factor in (1.0, 2.0, 5.0, 10.0) if factor * step * 5.0 >= high - low)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [(k * step, f"{k * step:.6g}") for k in range(first, last + 1)]
