"""One scene of a replay film: the road and the entities on it, seen from above."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Polygon
from matplotlib.patheffects import withStroke

from cornercase._common.text.sanitize import escape_control_characters, shorten
from cornercase.recordings import Recording
from cornercase.report.replays._interpolation import Motion, contact_point, hidden_area, is_visible
from cornercase.report.replays._replay_data import ReplayData

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

# The colours of the report page in its light theme.
GROUND: Final = "#e9ebe4"
EGO: Final = "#005a94"
OTHER: Final = "#b84a00"
LABEL: Final = "#23272b"
LINE: Final = "#8e949b"
_AREAS: Final = {"verge": "#d5dccb", "walk": "#dedad2", "road": "#c9ccd1"}
_NEUTRAL: Final = "#4a4f55"
_COLLISION: Final = "#b3261e"
_SHADOW: Final = (0.08, 0.09, 0.12, 0.24)
_MAX_NAME_LENGTH: Final = 24
# Smallest radius of a pedestrian, as a share of the view's height.
_MIN_RADIUS: Final = 0.009


class Scene:
    """Drawing of the road and the moving entities of a recording on matplotlib axes.

    The limits of the axes must be set before. The scene shows whether the ego sees the entity `other`.
    """

    def __init__(self, axes: Axes, recording: Recording, data: ReplayData, other: str) -> None:
        self._axes, self._recording = axes, recording
        names = recording.names
        self._ego = names.index(data.meta.ego) if data.meta.ego in names else -1
        self._other = names.index(other) if other in names else -1
        self._others = {names.index(name) for name in data.meta.others if name in names}
        self._view_height = float(np.ptp(axes.get_ylim()))
        if data.road is not None:
            self._draw_road(data)
        self._paths = [recording.box_center(name) for name in names]
        for entity, path in enumerate(self._paths):
            axes.plot(*path.T, ":", color=self._entity_colour(entity), linewidth=1.0, alpha=0.55)
        self._collisions = [
            (hit.time, contact_point(recording, hit.time, *map(recording.entity_index, hit.entities)))
            for hit in recording.collisions
        ]
        halo = [withStroke(linewidth=3.0, foreground="white")]
        self._label = axes.text(0.0, 0.0, "", ha="center", fontsize=9, clip_on=True, animated=True, path_effects=halo)

    def _draw_road(self, data: ReplayData) -> None:
        assert data.road is not None
        for order, (kind, colour) in enumerate(_AREAS.items()):
            areas = [points for area_kind, points in data.road.areas if area_kind == kind]
            # All outlines lie below all areas, so that only the outline of the union is visible.
            self._axes.add_collection(
                PolyCollection(areas, facecolors="none", edgecolors=LINE, linewidths=1.8, zorder=0.1 + order),
                autolim=False,
            )
            self._axes.add_collection(
                PolyCollection(areas, facecolors=colour, edgecolors=colour, linewidths=0.5, zorder=0.2 + order),
                autolim=False,
            )
        for kind, points in data.road.lines:
            dashes: Any = (0, (4, 4)) if kind == "lane" else "-"
            self._axes.add_line(Line2D(*points.T, color="white", linewidth=1.0, linestyle=dashes, zorder=3.0))

    def _entity_colour(self, entity: int) -> str:
        return EGO if entity == self._ego else OTHER if entity in self._others else _NEUTRAL

    def draw_moving(self, motion: Motion, time_index: int, time: float) -> None:
        """Draw the parts that move; `time`, in s, is the time at `time_index` of `motion`."""
        existing = motion.existing_entities(time_index)
        if self._ego in existing:
            for other in existing:
                hidden = (
                    hidden_area(motion, self._ego, other, time_index) if other not in (self._ego, self._other) else None
                )
                if hidden is not None:
                    self._draw_in_this_frame_only(Polygon(hidden, facecolor=_SHADOW, edgecolor="none"))
        for entity in existing:
            past = self._paths[entity][self._recording.time <= time + 1e-6]
            line: Any = "--" if entity in self._others else "-"
            self._draw_in_this_frame_only(
                Line2D(*past.T, color=self._entity_colour(entity), linewidth=1.6, linestyle=line)
            )
        if self._ego in existing and self._other in existing:
            seen = is_visible(motion, self._ego, self._other, time_index)
            target = [motion.x[self._other, time_index], motion.y[self._other, time_index]]
            sight_line = np.stack([motion.eye_position(self._ego, time_index), target])
            self._draw_in_this_frame_only(
                Line2D(*sight_line.T, color=EGO, linewidth=1.3, linestyle="-" if seen else (0, (1, 3)))
            )
        for entity in existing:
            self._draw_entity(motion, entity, time_index)
        for hit_time, point in self._collisions:
            if time >= hit_time - 1e-6:
                self._draw_in_this_frame_only(
                    Line2D(*point[:, None], marker=(8, 1, 0), markersize=18, color=_COLLISION, markeredgecolor="white")
                )
                self._draw_text(
                    f"collision at {hit_time:.2f} s", point[0], point[1] + 0.035 * self._view_height, _COLLISION
                )
        for entity in existing:
            self._draw_label(motion, entity, time_index)

    def _draw_entity(self, motion: Motion, entity: int, time_index: int) -> None:
        colour, heading = self._entity_colour(entity), motion.heading[entity, time_index]
        x, y = motion.x[entity, time_index], motion.y[entity, time_index]
        ahead = np.array([np.cos(heading), np.sin(heading)])
        left = np.array([-ahead[1], ahead[0]])
        center = np.array([x, y])
        if self._recording.object_types[entity] == "pedestrian":
            radius = max(0.5 * motion.length[entity], 0.5 * motion.width[entity], _MIN_RADIUS * self._view_height)
            self._draw_in_this_frame_only(Circle((x, y), radius, facecolor=colour, edgecolor="white", linewidth=1.0))
            tip, base = center + 1.8 * radius * ahead, center + 1.05 * radius * ahead
            self._draw_in_this_frame_only(
                Polygon([tip, base + 0.6 * radius * left, base - 0.6 * radius * left], color=colour)
            )
            return
        self._draw_in_this_frame_only(
            Polygon(motion.corners(entity, time_index), facecolor=colour, edgecolor="white", linewidth=1.0)
        )
        long, wide = 0.5 * motion.length[entity] * ahead, 0.5 * motion.width[entity] * left
        nose = [center + 0.92 * long, center + 0.45 * long + 0.75 * wide, center + 0.45 * long - 0.75 * wide]
        self._draw_in_this_frame_only(Polygon(nose, facecolor="white", edgecolor="none", alpha=0.85))

    def _draw_label(self, motion: Motion, entity: int, time_index: int) -> None:
        speed = motion.speed[entity, time_index]
        name = shorten(escape_control_characters(self._recording.names[entity]), _MAX_NAME_LENGTH)
        is_neutral = entity != self._ego and entity not in self._others
        text = name if is_neutral and not abs(speed) > 0.05 else f"{name} {speed:.1f} m/s"
        # The upper one of ego and other has its label above, the lower one below.
        height = {
            entity: motion.y[entity, time_index] if entity in motion.existing_entities(time_index) else -np.inf
            for entity in (self._ego, self._other)
        }
        lower = self._other if height[self._ego] >= height[self._other] else self._ego
        offset = float(np.ptp(motion.corners(entity, time_index)[:, 1])) / 2.0 + 0.02 * self._view_height
        y = motion.y[entity, time_index] + (-offset if entity == lower else offset)
        self._draw_text(
            text, motion.x[entity, time_index], y, self._entity_colour(entity), "top" if entity == lower else "bottom"
        )

    def _draw_text(self, text: str, x: float, y: float, colour: str, align: str = "bottom") -> None:
        self._label.set(text=text, position=(x, y), color=colour, va=align)
        self._axes.draw_artist(self._label)

    def _draw_in_this_frame_only(self, artist: Artist) -> None:
        """Draw an artist, and remove it from the axes at once so that the next frame does not show it."""
        self._axes.add_artist(artist)
        self._axes.draw_artist(artist)
        artist.remove()
