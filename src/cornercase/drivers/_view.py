"""What a system under test sees of one scenario; computed for a whole batch when it is first asked for."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cornercase._common.geometry.boxes import wrap_angle
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.drivers._base import DrivenPath, Situation


@dataclass(frozen=True, slots=True)
class EgoState:
    """State of the ego's reference point.

    Attributes
    ----------
    x, y, heading : float
        Pose in m and rad, in the axes of the map.
    speed, acceleration : float
        In m/s and m/s².
    distance : float
        Distance along its path in m.
    offset : float
        Distance from its path in m, positive to the left.
    turn : float
        Heading relative to its path in rad, positive to the left.
    """

    x: float
    y: float
    heading: float
    speed: float
    acceleration: float
    distance: float
    offset: float
    turn: float


@dataclass(frozen=True, slots=True)
class ObjectView:
    """Another entity, as seen from the ego.

    Attributes
    ----------
    name, object_type : str
        Name, and vehicle category, ``"pedestrian"`` or ``"misc"``.
    x, y : float
        Centre of its box in m ahead, and to the left, of the ego's reference point.
    heading : float
        Heading relative to the ego's in rad.
    speed : float
        In m/s.
    length, width : float
        Box in m.
    gap : float
        Distance of the boxes along the ego's path in m: positive ahead, negative behind, 0 if they are next to each
        other. NaN if it is nowhere along the path.
    closing : float
        Speed in m/s at which the gap shrinks; negative if it grows.
    lateral : float
        Distance of its centre from the ego's path in m, positive to the left; NaN with the gap.
    in_path : bool
        Whether its box reaches into the strip that the ego's box sweeps along its path.
    """

    name: str
    object_type: str
    x: float
    y: float
    heading: float
    speed: float
    length: float
    width: float
    gap: float
    closing: float
    lateral: float
    in_path: bool


@dataclass(frozen=True, slots=True)
class PathPoint:
    """A point of the ego's path.

    Attributes
    ----------
    x, y : float
        Position in m ahead, and to the left, of the ego's reference point.
    heading : float
        Direction relative to the ego's heading in rad.
    curvature : float
        In 1/m, positive to the left.
    """

    x: float
    y: float
    heading: float
    curvature: float


class SharedView:
    """What is seen in all N scenarios of a batch, as arrays (N, A) over the A other entities."""

    def __init__(self, situation: Situation) -> None:
        self.situation = situation

    @cached_property
    def own_pose_on_path(self) -> FloatArray:
        """Distance along the path, offset from it, and direction of the path, (3, N)."""
        s = self.situation
        along, offset, direction, _ = _project_onto_path(s.path, s.distance, s.x[:, None], s.y[:, None])
        return np.stack((along[:, 0], offset[:, 0], direction[:, 0]))

    @cached_property
    def relative(self) -> FloatArray:
        """Centre of the boxes ahead and to the left, and heading, as seen from the ego, (3, N, A)."""
        s = self.situation
        center_x = s.others_x + s.others_center_x * np.cos(s.others_heading)
        center_y = s.others_y + s.others_center_x * np.sin(s.others_heading)
        dx, dy = center_x - s.x[:, None], center_y - s.y[:, None]
        cos, sin = np.cos(s.heading)[:, None], np.sin(s.heading)[:, None]
        turn = wrap_angle(s.others_heading - s.heading[:, None])
        return np.stack((dx * cos + dy * sin, dy * cos - dx * sin, turn))

    @cached_property
    def along_path(self) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
        """Gap, closing speed, lateral distance, and whether in the path, (N, A) each."""
        s = self.situation
        center_x = s.others_x + s.others_center_x * np.cos(s.others_heading)
        center_y = s.others_y + s.others_center_x * np.sin(s.others_heading)
        along, lateral, direction, is_within = _project_onto_path(s.path, s.distance, center_x, center_y)
        turn = s.others_heading - direction
        cos, sin = np.abs(np.cos(turn)), np.abs(np.sin(turn))
        half_length = 0.5 * (s.others_length * cos + s.others_width * sin)
        half_width = 0.5 * (s.others_length * sin + s.others_width * cos)
        ahead = along - (self.own_pose_on_path[0] + s.center_x)[:, None]
        gap = np.sign(ahead) * np.maximum(np.abs(ahead) - half_length - 0.5 * s.length, 0.0)
        closing = np.sign(ahead) * (s.speed[:, None] - s.others_speed * np.cos(turn))
        gap, lateral = np.where(is_within, gap, np.nan), np.where(is_within, lateral, np.nan)
        in_path = is_within & (np.abs(lateral) < half_width + 0.5 * s.width)
        return gap, closing, lateral, in_path


def _project_onto_path(
    path: DrivenPath, own_distance: FloatArray, x: FloatArray, y: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    # Its kernels take long to import.
    from cornercase.drivers._kernels.path_projection import project_onto_path

    return project_onto_path(path, own_distance, x, y)


class View:
    """What a system under test sees in one time step.

    Parameters
    ----------
    shared : SharedView
        What is seen in all scenarios of the batch.
    scenario : int
        Number of the scenario in it.

    Attributes
    ----------
    time : float
        Time since the start of the scenario in s.
    target_speed : float
        Speed in m/s that the scenario asks for; infinite or NaN if it asks for none.
    ego : EgoState
        The ego itself.
    objects : tuple of ObjectView
        All other entities that are sensed, the nearest first.
    leader : ObjectView or None
        The nearest of those ahead in the ego's path.
    signals : mapping of str to str
        State of each traffic signal by its name, as the scenario file writes it.
    """

    __slots__ = ("_n", "_objects", "_shared")

    def __init__(self, shared: SharedView, scenario: int) -> None:
        self._shared, self._n = shared, scenario
        self._objects: tuple[ObjectView, ...] | None = None

    @property
    def time(self) -> float:
        """Time since the start of the scenario in s."""
        return self._shared.situation.time

    @property
    def target_speed(self) -> float:
        """Speed in m/s that the scenario asks for."""
        return float(self._shared.situation.target_speed[self._n])

    @property
    def ego(self) -> EgoState:
        """The ego itself."""
        s, n = self._shared.situation, self._n
        along, offset, direction = self._shared.own_pose_on_path[:, n].tolist()
        heading = float(s.heading[n])
        turn = float(wrap_angle(np.float64(heading - direction)))
        return EgoState(
            float(s.x[n]), float(s.y[n]), heading, float(s.speed[n]), float(s.acceleration[n]), along, offset, turn
        )

    @property
    def objects(self) -> tuple[ObjectView, ...]:
        """All other entities that are sensed, the nearest first."""
        if self._objects is None:
            s, n, shared = self._shared.situation, self._n, self._shared
            x, y, heading = shared.relative[:, n]
            gap, closing, lateral, in_path = (values[n].tolist() for values in shared.along_path)
            nearest = np.argsort(np.hypot(x, y), kind="stable").tolist()
            x, y, heading, speed = x.tolist(), y.tolist(), heading.tolist(), s.others_speed[n].tolist()
            self._objects = tuple(
                ObjectView(
                    s.others_name[a],
                    s.others_object_type[a],
                    x[a],
                    y[a],
                    heading[a],
                    speed[a],
                    float(s.others_length[a]),
                    float(s.others_width[a]),
                    gap[a],
                    closing[a],
                    lateral[a],
                    in_path[a],
                )
                for a in nearest
                if not math.isnan(x[a])
            )
        return self._objects

    @property
    def leader(self) -> ObjectView | None:
        """The nearest of those ahead in the ego's path; None if there is none."""
        ahead = [other for other in self.objects if other.in_path and other.gap >= 0.0 and other.x > 0.0]
        return min(ahead, key=lambda other: other.gap, default=None)

    @property
    def signals(self) -> Mapping[str, str]:
        """State of each traffic signal by its name."""
        return {name: str(states[self._n]) for name, states in self._shared.situation.signals.items()}

    def path(self, ahead: float) -> PathPoint:
        """Return the point of the ego's path at a distance ahead.

        Parameters
        ----------
        ahead : float
            Distance along the path in m; beyond an end of the path, it is the end.

        Returns
        -------
        PathPoint
        """
        s, n = self._shared.situation, self._n
        at = self._shared.own_pose_on_path[0, n] + ahead
        columns = (s.path.distance, s.path.x, s.path.y, s.path.heading, s.path.curvature)
        stations, *samples = columns if s.path.distance.ndim == 1 else [column[n] for column in columns]
        px, py, direction, curvature = (float(np.interp(at, stations, values)) for values in samples)
        dx, dy, heading = px - float(s.x[n]), py - float(s.y[n]), float(s.heading[n])
        cos, sin = np.cos(heading), np.sin(heading)
        turn = float(wrap_angle(np.float64(direction - heading)))
        return PathPoint(float(dx * cos + dy * sin), float(dy * cos - dx * sin), turn, curvature)
