"""Charts of a comparison page: old against new scores, and changes of criticality in the parameter space."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.metrics import Metric
from cornercase.scenario import Parameter
from cornercase.suite import Comparison, ScenarioPair

CHART_WIDTH: Final = 440
CHART_HEIGHT: Final = 330
_LEFT, _RIGHT, _TOP, _BOTTOM = 62, 14, 12, 46
_MAX_TICKS: Final = 5
# Unchanged points are thinned out to about this number.
_MAX_UNCHANGED_POINTS: Final = 3000


@dataclass(frozen=True)
class Chart:
    """Scatter chart of a comparison page; coordinates are in pixels."""

    title: str
    caption: str
    across: str  # label of the horizontal axis
    up: str  # label of the vertical axis
    ticks_across: tuple[tuple[float, str], ...]  # position and text of each tick
    ticks_up: tuple[tuple[float, str], ...]
    points: tuple[tuple[float, float, str, str, tuple[int, int]], ...]  # x, y, CSS class, text, ids in both studies
    diagonal: tuple[float, float, float, float] | None  # x and y of its begin, x and y of its end
    legend: tuple[tuple[str, str], ...]  # CSS class and its meaning

    @property
    def frame(self) -> dict[str, float]:
        """Size of the chart and edges of the area inside the axes, in pixels."""
        right, bottom = CHART_WIDTH - _RIGHT, CHART_HEIGHT - _BOTTOM
        return {
            "width": CHART_WIDTH,
            "height": CHART_HEIGHT,
            "left": _LEFT,
            "right": right,
            "top": _TOP,
            "bottom": bottom,
        }


def draw_charts(comparison: Comparison, parameters: Sequence[Parameter]) -> Iterator[Chart]:
    """Yield a chart of old against new scores for each metric with changed scores, and a chart of the parameter space.

    The chart of the parameter space shows the first two numeric parameters. This chart is left out if the study has
    fewer than two numeric parameters, or if no scenario differs by more than rounding or failed in one study only.
    """
    ran = [pair for pair in comparison.pairs if pair.both_ran]
    for score in comparison.scores:
        if score.moved:
            yield _score_chart(ran, score.metric, comparison.metrics[score.metric])
    axes = [parameter for parameter in parameters if not parameter.choices][:2]
    if len(axes) == 2 and any(pair.run in ("otherwise", "not in one") for pair in comparison.pairs):
        yield _space_chart(comparison.pairs, axes)


def _score_chart(pairs: Sequence[ScenarioPair], name: str, metric: Metric) -> Chart:
    scores = np.array([pair.scores[name] for pair in pairs])
    low, high = float(scores.min()), float(scores.max())
    low, high = (low, high) if high > low else (low - 0.5, high + 0.5)
    oriented = np.asarray(metric.to_minimize(scores))
    classes = np.where(oriented[:, 1] < oriented[:, 0], "new", np.where(oriented[:, 1] > oriented[:, 0], "old", "both"))
    unit = "" if metric.unit == "1" else f" [{metric.unit}]"
    points = np.stack([_x_pixels(scores[:, 0], low, high), _y_pixels(scores[:, 1], low, high)], axis=1)
    texts = [
        f"{pair.ids[0]}, {pair.ids[1]}: {before:.4g} → {after:.4g}"
        for pair, (before, after) in zip(pairs, scores, strict=True)
    ]
    ends = np.array([low, high])
    corner = [*_x_pixels(ends, low, high).tolist(), *_y_pixels(ends, low, high).tolist()]
    return Chart(
        title=f"{name}, scenario by scenario",
        caption="Score of the old version (horizontal) and of the new one (vertical). On the line they are equal.",
        across=f"old {name}{unit}",
        up=f"new {name}{unit}",
        ticks_across=_ticks(low, high, is_horizontal=True),
        ticks_up=_ticks(low, high, is_horizontal=False),
        points=_thin_unchanged(points, classes.tolist(), texts, pairs),
        diagonal=(corner[0], corner[2], corner[1], corner[3]),
        legend=(("new", "more critical now"), ("old", "less critical now"), ("both", "as before")),
    )


def _space_chart(pairs: Sequence[ScenarioPair], axes: Sequence[Parameter]) -> Chart:
    values = np.array([[parameter.extract_number(pair.values) for parameter in axes] for pair in pairs])
    has_threshold = any(pair.is_critical is not None for pair in pairs)
    classes, texts = [], []
    for pair in pairs:
        before, after = pair.is_critical if has_threshold and pair.is_critical is not None else pair.collides
        point_class = (
            "new" if after and not before else "old" if before and not after else "always" if after else "both"
        )
        if point_class == "both" and pair.run in ("otherwise", "not in one"):
            point_class = "moved"
        classes.append(point_class)
        ends = [outcome or error or "" for outcome, error in zip(pair.outcomes, pair.errors, strict=True)]
        texts.append(f"{pair.ids[0]}, {pair.ids[1]}: {ends[0]} → {ends[1]}")
    event = "critical" if has_threshold else "a collision"
    first, second = axes
    return Chart(
        title="Where in the space",
        caption=f"Each scenario that both versions ran, by {first.name} and {second.name}.",
        across=_axis_label(first),
        up=_axis_label(second),
        ticks_across=_ticks(first.low, first.high, is_horizontal=True),
        ticks_up=_ticks(second.low, second.high, is_horizontal=False),
        points=_thin_unchanged(
            np.stack(
                [_x_pixels(values[:, 0], first.low, first.high), _y_pixels(values[:, 1], second.low, second.high)],
                axis=1,
            ),
            classes,
            texts,
            pairs,
        ),
        diagonal=None,
        legend=(
            ("new", f"{event} only now"),
            ("old", f"{event} no longer"),
            ("always", f"{event} with both"),
            ("moved", "went otherwise"),
            ("both", "as before"),
        ),
    )


def _axis_label(parameter: Parameter) -> str:
    return f"{parameter.name} [{parameter.unit}]" if parameter.unit and parameter.unit != "1" else parameter.name


def _x_pixels(values: FloatArray, low: float, high: float) -> FloatArray:
    return np.round(_LEFT + (values - low) / ((high - low) or 1.0) * (CHART_WIDTH - _LEFT - _RIGHT), 1)


def _y_pixels(values: FloatArray, low: float, high: float) -> FloatArray:
    return np.round(
        CHART_HEIGHT - _BOTTOM - (values - low) / ((high - low) or 1.0) * (CHART_HEIGHT - _TOP - _BOTTOM), 1
    )


def _ticks(low: float, high: float, *, is_horizontal: bool) -> tuple[tuple[float, str], ...]:
    """Return the ticks of an axis from `low` to `high`: positions in pixels and numbers as text.

    The step between two numbers is 1, 2 or 5 times a power of ten.
    """
    if not high > low:
        return ()
    min_step = (high - low) / _MAX_TICKS
    power = 10.0 ** math.floor(math.log10(min_step))
    step = next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= min_step * (1.0 - 1e-9))
    numbers = step * np.arange(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)
    positions = (_x_pixels if is_horizontal else _y_pixels)(numbers, low, high)
    return tuple(
        (position, f"{number + 0.0:.4g}") for position, number in zip(positions.tolist(), numbers.tolist(), strict=True)
    )


def _thin_unchanged(
    points: FloatArray, classes: Sequence[str], texts: Sequence[str], pairs: Sequence[ScenarioPair]
) -> tuple[tuple[Any, ...], ...]:
    """Return points of a chart, without some of the unchanged points if there are too many of them.

    Each point consists of x and y in pixels, CSS class, text, and ids of the scenario. Changed points come last, so
    that they are drawn on top.
    """
    unchanged = [k for k, point_class in enumerate(classes) if point_class == "both"]
    changed = [k for k, point_class in enumerate(classes) if point_class != "both"]
    stride = max(1, math.ceil(len(unchanged) / _MAX_UNCHANGED_POINTS))
    order = [*unchanged[::stride], *changed]
    return tuple((*points[k].tolist(), classes[k], texts[k], pairs[k].ids) for k in order)
