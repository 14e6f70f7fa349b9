"""Figures of single scenarios: paths from above, and speeds over time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

import numpy as np
from matplotlib.figure import Figure

from cornercase._common.geometry.boxes import box_corners
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.metrics import Clearance
from cornercase.recordings import Recording
from cornercase.report.figures._style import COLOURS, GREY, wrap_name

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

MAX_EXAMPLES: Final = 6
"""Most scenarios that fit into a figure."""

# Columns of panels by the number of scenarios.
_COLUMNS_BY_COUNT: Final = (1, 2, 3, 2, 3, 3)
# View from above: seconds before and after the closest approach, margin in m, and limits of the half width in m.
_SECONDS_AROUND: Final = 4.0
_VIEW_MARGIN: Final = 6.0
_VIEW_HALF_WIDTHS: Final = (12.0, 25.0)
# Smallest distance between two time labels, as a share of the half width.
_MIN_LABEL_DISTANCE: Final = 0.08
# Interval between marks in s.
_MARK_INTERVAL: Final = 1.0


def draw_example_scenarios(recordings: Mapping[str, Recording], ego: str, other: str) -> Figure:
    """Draw two panels for each scenario: its paths from above with time marks, and below its speeds over time.

    `recordings` maps titles to recordings.
    """
    columns = _COLUMNS_BY_COUNT[len(recordings) - 1]
    rows = -(-len(recordings) // columns)
    figure = Figure(figsize=(4.4 * columns, 6.2 * rows), layout="constrained")
    grid = figure.add_gridspec(2 * rows, columns, height_ratios=[2.0, 1.0] * rows)
    for k, (title, recording) in enumerate(recordings.items()):
        above = figure.add_subplot(grid[2 * (k // columns), k % columns])
        below = figure.add_subplot(grid[2 * (k // columns) + 1, k % columns])
        nearest = _index_of_closest_approach(recording, ego, other)
        _draw_paths(above, recording, ego, other, nearest)
        _draw_speeds(below, recording, ego, other, nearest)
        above.set_title(wrap_name(title), fontsize="medium")
    line_by_label: dict[str, Artist] = {str(line.get_label()): line for axis in figure.axes for line in axis.lines}
    labels = [label for label in line_by_label if not label.startswith("_")]
    handles = [line_by_label[label] for label in labels]
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    return figure


def _index_of_closest_approach(recording: Recording, ego: str, other: str) -> int | None:
    clearance = Clearance().course(recording, ego, other)
    return int(np.nanargmin(clearance)) if np.isfinite(clearance).any() else None


def _line_style(name: str, ego: str, other: str) -> tuple[str, str, float]:
    """Return colour, line style and line width for an entity."""
    if name == ego:
        return COLOURS[0], "-", 2.0
    return (COLOURS[1], "--", 2.0) if name == other else (GREY, ":", 1.4)


def _draw_paths(axis: Axes, recording: Recording, ego: str, other: str, closest_index: int | None) -> None:
    time = recording.time
    middle = time[closest_index] if closest_index is not None else 0.5 * (time[0] + time[-1])
    around = np.abs(time - middle) <= _SECONDS_AROUND
    marked = _indices_of_full_seconds(time, around)
    visible = []
    for i, name in enumerate(recording.names):
        colour, line, width = _line_style(name, ego, other)
        center = recording.box_center(name)
        axis.plot(*center.T, line, color=colour, linewidth=width)
        if name in (ego, other):
            visible.append(center[around])
            _draw_box(
                axis,
                recording,
                i,
                closest_index if closest_index is not None else int(np.flatnonzero(around)[0]),
                colour,
            )
            axis.plot(*center[marked].T, "o", color=colour, markersize=3.5)
    points = np.concatenate(visible)
    points = points[np.isfinite(points).all(axis=1)]
    half = _VIEW_HALF_WIDTHS[1]
    if len(points):
        # Square, so that both axes have the same scale.
        half = float(np.clip(np.ptp(points, axis=0).max() / 2.0 + _VIEW_MARGIN, *_VIEW_HALF_WIDTHS))
        x, y = (points.min(axis=0) + points.max(axis=0)) / 2.0
        if closest_index is not None:
            closest = np.array([recording.box_center(name)[closest_index] for name in (ego, other)])
            x, y = closest.mean(axis=0)
            # Show both even if they never come close.
            half = max(half, float(np.ptp(closest, axis=0).max()) / 2.0 + _VIEW_MARGIN)
        axis.set_xlim(x - half, x + half)
        axis.set_ylim(y - half, y + half)
    for name in (ego, other):
        colour, _, _ = _line_style(name, ego, other)
        _label_times(
            axis, recording.box_center(name)[marked], time[marked], colour, name == ego, _MIN_LABEL_DISTANCE * half
        )
    axis.set_aspect("equal")
    axis.set_xlabel("x [m]")
    axis.set_ylabel("y [m]")
    axis.grid(alpha=0.3)


def _indices_of_full_seconds(time: FloatArray, is_shown: BoolArray) -> IntArray:
    """Return the indices of the instants nearest to the full seconds within the time that is shown."""
    seconds = np.arange(np.ceil(time[is_shown][0]), time[is_shown][-1] + 1e-9, _MARK_INTERVAL)
    marked: IntArray = np.unique(np.abs(time[:, None] - seconds).argmin(axis=0))
    return marked


def _draw_box(axis: Axes, recording: Recording, entity: int, instant: int, colour: str) -> None:
    x, y = recording.box_center(recording.names[entity])[instant]
    if np.isfinite(x + y):
        size = (recording.length[entity], recording.width[entity])
        corners = box_corners(np.array(x), np.array(y), recording.heading[entity, instant], *size)
        axis.fill(*corners.T, facecolor=colour, edgecolor=colour, alpha=0.35, linewidth=1.0)


def _label_times(
    axis: Axes, points: FloatArray, times: FloatArray, colour: str, is_above: bool, min_distance: float
) -> None:
    """Write times beside marks; marks closer than `min_distance`, in m, to the last labelled mark get no label."""
    last = np.full(2, np.nan)
    for point, time in zip(points, times, strict=True):
        if np.isfinite(point).all() and not np.hypot(*(point - last)) < min_distance:
            offset = (0, 6) if is_above else (6, -10)
            axis.annotate(
                f"{time:.0f}", point, xytext=offset, textcoords="offset points", color=colour, fontsize=7,
                clip_on=True, annotation_clip=True,
            )  # fmt: skip
            last = point


def _draw_speeds(axis: Axes, recording: Recording, ego: str, other: str, closest_index: int | None) -> None:
    for i, name in enumerate(recording.names):
        colour, line, width = _line_style(name, ego, other)
        if name in (ego, other) or np.nan_to_num(recording.speed[i]).any():
            axis.plot(recording.time, recording.speed[i], line, color=colour, linewidth=width, label=name)
    if closest_index is not None:
        axis.axvline(recording.time[closest_index], color="black", linewidth=0.8, label="nearest")
    axis.set_ylim(bottom=min(0.0, float(np.nanmin(recording.speed))))
    axis.set_xlabel("time [s]")
    axis.set_ylabel("speed [m/s]")
    axis.grid(alpha=0.3)
