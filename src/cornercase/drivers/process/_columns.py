"""Table of numbers about the traffic that an external driving program is sent in each step, column by column."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Final, Literal

import numpy as np

from cornercase._common.typing import FloatArray, IntArray
from cornercase.drivers._base import DrivenPath, Situation
from cornercase.drivers._view import SharedView

# Fields of a situation that have one value, or one row, per scenario.
_PER_SCENARIO: Final = (
    "distance", "x", "y", "heading", "speed", "acceleration", "target_speed", "others_x", "others_y", "others_heading",
    "others_speed", "active",
)  # fmt: skip


@dataclass(frozen=True)
class Column:
    """Column of the table of numbers that a driving program is sent in each step.

    `shape` is ``"M"`` if the column has a number for each of M scenarios, ``"M, A"`` if it has a number for each of A
    other entities in each scenario, and ``"M, K"`` if it has a number for each of K points of the path ahead.
    """

    name: str
    shape: Literal["M", "M, A", "M, K"]
    unit: str
    meaning: str
    compute: Callable[[SharedView], Any]


def _find_leader(shared: SharedView) -> IntArray:
    """Return the index of the leader (nearest entity ahead in the ego's path) among the others; -1 if there is none."""
    gap, _, _, in_path = shared.objects_along_path
    x, y, _ = shared.relative_poses
    if not gap.shape[1]:
        return np.full(len(gap), -1)
    is_ahead = in_path & (gap >= 0.0) & (x > 0.0)
    nearest_gap = np.where(is_ahead, gap, np.inf).min(axis=1, keepdims=True)
    is_nearest = is_ahead & (gap == nearest_gap)
    leader = np.where(is_nearest, np.hypot(x, y), np.inf).argmin(axis=1)
    return np.where(is_ahead.any(axis=1), leader, -1)


def _select_leader_values(values: FloatArray, shared: SharedView) -> FloatArray:
    leader = _find_leader(shared)
    if not values.shape[1]:
        return np.full(len(values), np.nan)
    return np.where(leader >= 0, values[np.arange(len(values)), leader], np.nan)


COLUMNS: Final = {
    column.name: column
    for column in (
        Column("x", "M", "m", "the ego's reference point, in the axes of the map", lambda v: v.situation.x),
        Column("y", "M", "m", "", lambda v: v.situation.y),
        Column("heading", "M", "rad", "the ego's heading, in the axes of the map", lambda v: v.situation.heading),
        Column("speed", "M", "m/s", "the ego's speed", lambda v: v.situation.speed),
        Column("acceleration", "M", "m/s²", "the ego's acceleration", lambda v: v.situation.acceleration),
        Column("target_speed", "M", "m/s", "the speed that the scenario asks for; infinite or NaN if it asks for none",
               lambda v: v.situation.target_speed),
        Column("distance", "M", "m", "the ego's distance along its path", lambda v: v.own_pose_on_path[0]),
        Column("offset", "M", "m", "the ego's distance from its path, positive to the left",
               lambda v: v.own_pose_on_path[1]),
        Column("turn", "M", "rad", "the ego's heading relative to its path, positive to the left",
               lambda v: v.turn),
        Column("leader", "M", "", "number of the nearest of those ahead in the ego's path; -1 if there is none",
               _find_leader),
        Column("leader_gap", "M", "m", "the leader's `other_gap`; NaN without a leader",
               lambda v: _select_leader_values(v.objects_along_path[0], v)),
        Column("leader_closing", "M", "m/s", "the leader's `other_closing`; NaN without a leader",
               lambda v: _select_leader_values(v.objects_along_path[1], v)),
        Column("other_x", "M, A", "m", "centre of the other's box, ahead of the ego's reference point; NaN while there"
               " is no such entity", lambda v: v.relative_poses[0]),
        Column("other_y", "M, A", "m", "centre of the other's box, to the left of the ego's reference point",
               lambda v: v.relative_poses[1]),
        Column("other_heading", "M, A", "rad", "the other's heading relative to the ego's",
               lambda v: v.relative_poses[2]),
        Column("other_speed", "M, A", "m/s", "the other's speed", lambda v: v.situation.others_speed),
        Column("other_gap", "M, A", "m", "distance of the boxes along the ego's path, negative behind; NaN if it is"
               " nowhere along the path", lambda v: v.objects_along_path[0]),
        Column("other_closing", "M, A", "m/s", "speed at which the gap shrinks", lambda v: v.objects_along_path[1]),
        Column("other_lateral", "M, A", "m", "distance of the box's centre from the ego's path, positive to the left",
               lambda v: v.objects_along_path[2]),
        Column("other_in_path", "M, A", "", "1 if its box reaches into the strip that the ego's box sweeps along its"
               " path, else 0", lambda v: v.objects_along_path[3]),
    )
}  # fmt: skip
"""Columns of the table by name."""
PATH_COLUMNS: Final = {
    "path_x": ("m", "point of the ego's path, ahead of the ego's reference point"),
    "path_y": ("m", "point of the ego's path, to the left of the ego's reference point"),
    "path_heading": ("rad", "direction of the path there, relative to the ego's heading"),
    "path_curvature": ("1/m", "curvature of the path there, positive to the left"),
}
"""Unit and meaning of the columns about the path, shape (M, K): M scenarios, K points that a program asks for."""


def select_rows(situation: Situation, rows: IntArray) -> Situation:
    """Return a situation reduced to the scenarios with the indices `rows`."""
    if len(rows) == len(situation.active):
        return situation
    path = situation.path
    if path.distance.ndim == 2:
        path = DrivenPath(**{item.name: getattr(path, item.name)[rows] for item in fields(path)})
    return replace(
        situation,
        path=path,
        signals={name: states[rows] for name, states in situation.signals.items()},
        **{name: getattr(situation, name)[rows] for name in _PER_SCENARIO},
    )


def compute_columns(situation: Situation, names: Sequence[str], ahead: FloatArray) -> dict[str, FloatArray]:
    """Return the columns with the given names, and if `ahead` is not empty, the columns about the path.

    `ahead` (K,) has the distances in m from the ego to the points of the path.
    """
    shared = SharedView(situation)
    columns = {name: COLUMNS[name].compute(shared) for name in names}
    if len(ahead):
        columns |= dict(zip(PATH_COLUMNS, shared.path_points(ahead), strict=True))
    return columns
