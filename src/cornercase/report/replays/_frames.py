"""Frames of a replay film: scenes from above, and below the scenes the course of the first metric over time."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

from cornercase._common.text.sanitize import escape_control_characters, shorten
from cornercase._common.typing import FloatArray
from cornercase.metrics import Metric
from cornercase.report.replays._interpolation import Motion, interpolate_motion
from cornercase.report.replays._replay_data import ReplayData, ReplayItem
from cornercase.report.replays._scene import EGO, GROUND, LABEL, LINE, OTHER, Scene

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

# Inches of a frame by number of scenarios; even numbers of pixels, as MP4 requires.
_FRAME_INCHES: Final = {1: (9.6, 7.2), 2: (14.4, 7.2)}
# Layout of scenes and course, as shares of the frame.
_SCENE_SPAN: Final = (0.35, 0.915)
_COURSE_SPAN: Final = (0.09, 0.25)
_LEFT_EDGE: Final = 0.075
_RIGHT_EDGE: Final = 0.985
_SCENE_GAP: Final = 0.06
# Ego and other are fully in view if their paths fit into this extent in m; otherwise only the last of these seconds
# before the most critical instant are shown.
_MAX_EXTENT: Final = 45.0
_SECONDS_BEFORE: Final = (20.0, 15.0, 10.0, 8.0, 6.0, 4.0, 3.0, 2.0, 1.0)
_SECONDS_AFTER: Final = 1.0
_VIEW_MARGIN: Final = 6.0
_MIN_VIEW: Final = 22.0
_MAX_TITLE_LENGTH: Final = 110

Frame = npt.NDArray[np.uint8]
"""Red, green and blue of each pixel, shape (height, width, 3)."""


class FrameRenderer:
    """Renderer of the frames of a replay film.

    A frame with one scenario is 9.6 by 7.2 inches at `dpi` pixels per inch; with two scenarios, 14.4 by 7.2 inches.
    """

    def __init__(self, data: ReplayData, *, dpi: int = 100) -> None:
        self._data = data
        self._figure = Figure(figsize=_FRAME_INCHES[len(data.items)], dpi=dpi, facecolor="white")
        self._canvas = FigureCanvasAgg(self._figure)
        positions = np.concatenate([self._visible_positions(item) for item in data.items])
        # All scenes show the same region.
        self._view_center: tuple[float, float] = tuple(((positions.min(axis=0) + positions.max(axis=0)) / 2.0).tolist())
        self._half_height = max(_MIN_VIEW, float(np.ptp(positions, axis=0).max()) + 2.0 * _VIEW_MARGIN) / 2.0
        with rc_context({"text.parse_math": False, "font.size": 10.0}):
            self._scenes = [self._create_scene(k, item) for k, item in enumerate(data.items)]
            self._course = self._draw_course(data.metrics[0])
            self._time_label = self._figure.text(
                _RIGHT_EDGE, 0.955, "", ha="right", fontsize=12, color=LABEL, animated=True
            )
        for text in self._figure.findobj(Text):
            text.set_parse_math(False)

    def _create_scene(self, index: int, item: ReplayItem) -> Scene:
        count = len(self._data.items)
        width = (_RIGHT_EDGE - _LEFT_EDGE - _SCENE_GAP * (count - 1)) / count
        left = _LEFT_EDGE + index * (width + _SCENE_GAP)
        axes = self._figure.add_axes((left, _SCENE_SPAN[0], width, _SCENE_SPAN[1] - _SCENE_SPAN[0]))
        (x, y), high, size = self._view_center, self._half_height, self._figure.get_size_inches()
        wide = high * width * size[0] / ((_SCENE_SPAN[1] - _SCENE_SPAN[0]) * size[1])
        axes.set_xlim(x - wide, x + wide)
        axes.set_ylim(y - high, y + high)
        axes.set_facecolor(GROUND)
        axes.set_xlabel("x [m]", labelpad=1.0)
        axes.set_ylabel("y [m]", labelpad=1.0)
        axes.tick_params(labelsize=8)
        # Coordinates may be those of a national grid.
        axes.ticklabel_format(useOffset=False, style="plain")
        facts = [f"scenario {item.row.id}", item.outcome, *(("critical",) if item.is_critical else ())]
        title = escape_control_characters(" · ".join(filter(None, facts)))
        axes.set_title(shorten(title, _MAX_TITLE_LENGTH // count), loc="left", fontsize=11, pad=5)
        return Scene(axes, item.recording, self._data, self._data.main_other(item))

    def _draw_course(self, metric: Metric) -> tuple[Axes, list[Artist]]:
        data = self._data
        axes = self._figure.add_axes(
            (_LEFT_EDGE, _COURSE_SPAN[0], _RIGHT_EDGE - _LEFT_EDGE, _COURSE_SPAN[1] - _COURSE_SPAN[0])
        )
        moving: list[Artist] = [axes.axvline(data.start_time, color=LABEL, linewidth=1.0, animated=True)]
        for item, colour, line in zip(data.items, (EGO, OTHER), ("-", "--"), strict=False):
            course = item.courses[metric.name]
            label = f"scenario {item.row.id}"
            axes.plot(item.recording.time, course, line, color=colour, linewidth=1.8, label=label)
            moving += axes.plot([], [], "o", color=colour, markersize=6, animated=True)
        if data.criterion is not None:
            axes.axhline(data.criterion.threshold, color="#b3261e", linestyle=":", linewidth=1.2, label="threshold")
        unit = f" [{metric.unit}]" if metric.unit else ""
        axes.set_xlim(data.start_time, max(data.end_time, data.start_time + 1e-3))
        axes.set_xlabel("time [s]", labelpad=1.0)
        axes.set_ylabel(shorten(escape_control_characters(f"{metric.name}{unit}"), 24))
        axes.tick_params(labelsize=8)
        axes.grid(color=LINE, linewidth=0.5, alpha=0.5)
        if len(axes.lines) > 1 + len(data.items):
            axes.legend(
                loc="lower right", bbox_to_anchor=(1.0, 0.97), ncols=3, frameon=False, fontsize=8, borderaxespad=0.0
            )
        return axes, moving

    def _visible_positions(self, item: ReplayItem) -> FloatArray:
        """Return all positions of ego and other entity, in m, that should be in view; shape (P, 2) for P positions."""
        recording, meta = item.recording, self._data.meta
        names = (meta.ego, self._data.main_other(item))
        paths = [recording.box_center(name) for name in names if name in recording.names]
        centers = np.stack(paths or [recording.box_center(name) for name in recording.names])
        middle = item.most_critical_time(self._data.metrics[0])
        positions = np.zeros((1, 2))
        for before in (np.inf, *_SECONDS_BEFORE):
            is_visible = recording.time >= middle - before
            is_visible &= recording.time <= middle + (_SECONDS_AFTER if np.isfinite(before) else np.inf)
            visible = centers[:, is_visible].reshape(-1, 2)
            visible = visible[np.isfinite(visible).all(axis=1)]
            if len(visible):
                positions = visible
                if float(np.ptp(visible, axis=0).max()) <= _MAX_EXTENT:
                    break
        return positions

    def render_frames(self, times: FloatArray) -> Iterator[Frame]:
        """Yield a frame for each time in s, as uint8 array of shape (height, width, 3)."""
        metric = self._data.metrics[0].name
        items = self._data.items
        motions = [
            interpolate_motion(item.recording, np.clip(times, item.recording.time[0], item.recording.time[-1]))
            for item in items
        ]
        values = [np.interp(times, item.recording.time, item.courses[metric]) for item in items]
        # Static parts are drawn once.
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", r"Glyph \d+ .* missing")
            self._canvas.draw()
        background = self._canvas.copy_from_bbox(self._figure.bbox)
        for k, time in enumerate(times.tolist()):
            with warnings.catch_warnings():
                # Characters missing in the font are drawn as boxes.
                warnings.filterwarnings("ignore", r"Glyph \d+ .* missing")
                self._draw_moving(background, k, time, motions, values)
            yield np.array(self._canvas.buffer_rgba())[..., :3]

    def _draw_moving(
        self, background: Any, index: int, time: float, motions: list[Motion], courses: list[FloatArray]
    ) -> None:
        self._canvas.restore_region(background)
        axes, (cursor, *dots) = self._course
        for scene, motion in zip(self._scenes, motions, strict=True):
            scene.draw_moving(motion, index, time)
        cursor.set(xdata=[time, time])
        for dot, value, item in zip(dots, courses, self._data.items, strict=True):
            dot.set(xdata=[min(time, float(item.recording.time[-1]))], ydata=[value[index]])
        for artist in (cursor, *dots):
            axes.draw_artist(artist)
        self._time_label.set_text(f"{time:.2f} s")
        self._figure.draw_artist(self._time_label)
