"""Figures of single scenarios: where each entity goes, and how fast."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

import numpy as np
from matplotlib.figure import Figure

from cornercase._common.geometry import box_corners
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.metrics import Clearance
from cornercase.recordings import Recording
from cornercase.report.figures.style import COLOURS, GREY, wrap

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

MOST_EXAMPLES: Final = 6
"""So many scenarios fit into a figure."""

# Columns of panels by the number of scenarios.
_COLUMNS: Final = (1, 2, 3, 2, 3, 3)
# What is drawn from above: so many s before and after both are nearest, and so many m around.
_AROUND: Final = 4.0
_MARGIN: Final = 6.0
_REACH: Final = (12.0, 25.0)
# Two times are no closer than that, as a share of what is drawn around.
_LEGIBLE: Final = 0.08
# Two marks are no closer than that, in s.
_STEP: Final = 1.0


def draw_examples(recordings: Mapping[str, Recording], ego: str, other: str) -> Figure:
    """Draw scenarios from above, with marks in time, and the speeds below.

    Parameters
    ----------
    recordings : mapping of str to Recording
        By title.
    ego, other : str
        Names of the two entities.

    Returns
    -------
    Figure
        Two panels for each scenario.
    """
    columns = _COLUMNS[len(recordings) - 1]
    rows = -(-len(recordings) // columns)
    figure = Figure(figsize=(4.4 * columns, 6.2 * rows), layout="constrained")
    grid = figure.add_gridspec(2 * rows, columns, height_ratios=[2.0, 1.0] * rows)
    for k, (title, recording) in enumerate(recordings.items()):
        above = figure.add_subplot(grid[2 * (k // columns), k % columns])
        below = figure.add_subplot(grid[2 * (k // columns) + 1, k % columns])
        nearest = _nearest(recording, ego, other)
        _draw_ways(above, recording, ego, other, nearest)
        _draw_speeds(below, recording, ego, other, nearest)
        above.set_title(wrap(title), fontsize="medium")
    found: dict[str, Artist] = {str(line.get_label()): line for axis in figure.axes for line in axis.lines}
    labels = [label for label in found if not label.startswith("_")]
    handles = [found[label] for label in labels]
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    return figure


def _nearest(recording: Recording, ego: str, other: str) -> int | None:
    away = Clearance().course(recording, ego, other)
    return int(np.nanargmin(away)) if np.isfinite(away).any() else None


def _look(name: str, ego: str, other: str) -> tuple[str, str, float]:
    """Colour, line and width of an entity."""
    if name == ego:
        return COLOURS[0], "-", 2.0
    return (COLOURS[1], "--", 2.0) if name == other else (GREY, ":", 1.4)


def _draw_ways(axis: Axes, recording: Recording, ego: str, other: str, nearest: int | None) -> None:
    time = recording.time
    middle = time[nearest] if nearest is not None else 0.5 * (time[0] + time[-1])
    around = np.abs(time - middle) <= _AROUND
    marked = _marks(time, around)
    shown = []
    for i, name in enumerate(recording.names):
        colour, line, width = _look(name, ego, other)
        center = recording.center(name)
        axis.plot(*center.T, line, color=colour, linewidth=width)
        if name in (ego, other):
            shown.append(center[around])
            _draw_box(axis, recording, i, nearest if nearest is not None else int(np.flatnonzero(around)[0]), colour)
            axis.plot(*center[marked].T, "o", color=colour, markersize=3.5)
    places = np.concatenate(shown)
    places = places[np.isfinite(places).all(axis=1)]
    half = _REACH[1]
    if len(places):
        # As wide as high, so that a metre is as long across as along.
        half = float(np.clip(np.ptp(places, axis=0).max() / 2.0 + _MARGIN, *_REACH))
        x, y = (places.min(axis=0) + places.max(axis=0)) / 2.0
        if nearest is not None:
            both = np.array([recording.center(name)[nearest] for name in (ego, other)])
            x, y = both.mean(axis=0)
            # Who never come near each other are both to be seen all the same.
            half = max(half, float(np.ptp(both, axis=0).max()) / 2.0 + _MARGIN)
        axis.set_xlim(x - half, x + half)
        axis.set_ylim(y - half, y + half)
    for name in (ego, other):
        colour, _, _ = _look(name, ego, other)
        _write_times(axis, recording.center(name)[marked], time[marked], colour, name == ego, _LEGIBLE * half)
    axis.set_aspect("equal")
    axis.set_xlabel("x [m]")
    axis.set_ylabel("y [m]")
    axis.grid(alpha=0.3)


def _marks(time: FloatArray, around: BoolArray) -> IntArray:
    """Instants next to each full second."""
    seconds = np.arange(np.ceil(time[around][0]), time[around][-1] + 1e-9, _STEP)
    marked: IntArray = np.unique(np.abs(time[:, None] - seconds).argmin(axis=0))
    return marked


def _draw_box(axis: Axes, recording: Recording, i: int, at: int, colour: str) -> None:
    x, y = recording.center(recording.names[i])[at]
    if np.isfinite(x + y):
        size = (recording.length[i], recording.width[i])
        corners = box_corners(np.array(x), np.array(y), recording.heading[i, at], *size)
        axis.fill(*corners.T, facecolor=colour, edgecolor=colour, alpha=0.35, linewidth=1.0)


def _write_times(axis: Axes, places: FloatArray, times: FloatArray, colour: str, above: bool, least: float) -> None:
    """Write a time beside each mark that is not as near as `least` m to the last one that has one."""
    last = np.full(2, np.nan)
    for place, time in zip(places, times, strict=True):
        if np.isfinite(place).all() and not np.hypot(*(place - last)) < least:
            offset = (0, 6) if above else (6, -10)
            axis.annotate(
                f"{time:.0f}", place, xytext=offset, textcoords="offset points", color=colour, fontsize=7,
                clip_on=True, annotation_clip=True,
            )  # fmt: skip
            last = place


def _draw_speeds(axis: Axes, recording: Recording, ego: str, other: str, nearest: int | None) -> None:
    for i, name in enumerate(recording.names):
        colour, line, width = _look(name, ego, other)
        if name in (ego, other) or np.nan_to_num(recording.speed[i]).any():
            axis.plot(recording.time, recording.speed[i], line, color=colour, linewidth=width, label=name)
    if nearest is not None:
        axis.axvline(recording.time[nearest], color="black", linewidth=0.8, label="nearest")
    axis.set_ylim(bottom=min(0.0, float(np.nanmin(recording.speed))))
    axis.set_xlabel("time [s]")
    axis.set_ylabel("speed [m/s]")
    axis.grid(alpha=0.3)
