"""Sentences on parameter ranges that contain all collisions, or all critical scenarios if nothing collides."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

from cornercase._common.typing import BoolArray, FloatArray
from cornercase.report._report_data import ReportData
from cornercase.report.text._phrases import append_unit, format_range
from cornercase.scenario import Parameter

# Fewer scenarios say nothing of a range.
_MIN_SCENARIOS: Final = 3
# A range counts as clearly narrower up to this share of the explored range.
_MAX_WIDTH: Final = 0.8
# Largest probability, over all parameters, that the scenarios lie in a range this narrow by chance.
_CHANCE: Final = 0.01


def describe_danger_ranges(data: ReportData) -> Iterator[str]:
    """Yield a sentence for each parameter that has all collisions in a range clearly narrower than the explored one.

    If nothing collides, the sentences are about the critical scenarios.
    """
    dangerous = data.collides
    what = "collisions"
    if not dangerous.any():
        dangerous, what = data.is_critical, "critical scenarios"
    if dangerous.sum() < _MIN_SCENARIOS or dangerous.all():
        return
    numeric = [(k, parameter) for k, parameter in enumerate(data.parameters) if not parameter.choices]
    for k, parameter in numeric:
        column = data.values[:, k]
        if _is_clearly_narrower(column, dangerous, parameter, _CHANCE / len(numeric)):
            low, high = float(column[dangerous].min()), float(column[dangerous].max())
            where = _format_narrow_range(low, high, parameter)
            subject = f"All {int(dangerous.sum())} {what} that were found"
            yield f"{subject} have {parameter.name} {where}, of {format_range(parameter)}."


def _is_clearly_narrower(column: FloatArray, dangerous: BoolArray, parameter: Parameter, chance: float) -> bool:
    width = parameter.high - parameter.low
    low, high = column[dangerous].min(), column[dangerous].max()
    if not width > 0.0 or high - low > _MAX_WIDTH * width:
        return False
    # The search does not fill the range evenly, so the scenarios that were run are counted, not the range.
    share, count = float(((column >= low) & (column <= high)).mean()), int(dangerous.sum())
    by_chance = count * share ** (count - 1) - (count - 1) * share**count
    return by_chance <= chance


def _format_narrow_range(low: float, high: float, parameter: Parameter) -> str:
    """Format a range in words, rounded outwards; a bound near the end of the explored range is left out."""
    width = parameter.high - parameter.low
    step = 10.0 ** (math.floor(math.log10(width)) - 2)
    lower, upper = (f"{bound:.6g}" for bound in (math.floor(low / step) * step, math.ceil(high / step) * step))
    at_top, at_bottom = high > parameter.high - 0.05 * width, low < parameter.low + 0.05 * width
    if at_top:
        return f"from {append_unit(lower, parameter.unit)} up"
    if at_bottom:
        return f"up to {append_unit(upper, parameter.unit)}"
    return f"from {lower} to {append_unit(upper, parameter.unit)}"
