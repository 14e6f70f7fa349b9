"""What a system under test sees of one scenario; computed for a whole batch when it is first asked for."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from cornercase._common.geometry.boxes import wrap_angle
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.drivers._base import DrivenPath, Situation

if TYPE_CHECKING:
    from cornercase.drivers._surroundings import LaneView, Surroundings
    from cornercase.roads._network import RoadNetwork

FARTHEST_ON_TRAJECTORY: Final = 400.0
"""Distance in m ahead up to which the samples of a trajectory do not depend on the other scenarios and the duration."""


class EgoState(NamedTuple):
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

    Examples
    --------
    >>> import cornercase as cc
    >>> class KeepSpeed(cc.SystemUnderTest):
    ...     def step(self, view, dt):
    ...         return 2.0 * (20.0 - view.ego.speed)
    >>> recording = cc.simulate("examples/r157/deceleration.xosc", drivers={"Ego": KeepSpeed()}, duration=5.0)
    >>> round(float(recording.speed[recording.entity_index("Ego"), -1]), 3)
    20.0
    """

    x: float
    y: float
    heading: float
    speed: float
    acceleration: float
    distance: float
    offset: float
    turn: float


@dataclass(slots=True)
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
    lane : int or None
        Lane that its centre is on, counted from the ego's own: 1 for the next to the left. None if it is on no lane of
        the ego's road.

    Examples
    --------
    >>> import cornercase as cc
    >>> class GiveWay(cc.SystemUnderTest):
    ...     def step(self, view, dt):
    ...         near = [seen for seen in view.objects if seen.object_type == "pedestrian" and 0.0 < seen.x < 30.0]
    ...         return -6.0 if near else 0.0
    >>> scenario = "examples/x_intersection/x_intersection.xosc"
    >>> recording = cc.simulate(scenario, drivers={"Ego": GiveWay()}, duration=15.0)
    >>> float(recording.speed[recording.entity_index("Ego"), -1])
    0.0
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
    _shared: SharedView = field(repr=False, compare=False)
    _scenario: int = field(repr=False, compare=False)
    _other: int = field(repr=False, compare=False)

    @property
    def lane(self) -> int | None:
        """Lane that its centre is on, counted from the ego's own."""
        return self._shared.surroundings.lane_of(self._scenario, self._other)


class SignalView(NamedTuple):
    """A traffic light or a sign.

    Attributes
    ----------
    name : str
        Id of the signal in the road file.
    state : str
        As the scenario file writes it; empty if the scenario has not set it.
    signal_type : str
        Type in the road file; empty if it has none.
    gap : float
        Distance along the ego's path in m from the front of its box to the signal; negative once it is passed, NaN if
        it does not stand along the path.

    Examples
    --------
    >>> import cornercase as cc
    >>> class StopAtRed(cc.SystemUnderTest):
    ...     def step(self, view, dt):
    ...         red = [signal.gap for signal in view.signals.values() if signal.state == "red" and signal.gap > 0.0]
    ...         return -(view.ego.speed**2) / (2.0 * red[0]) if red and red[0] < 40.0 else 0.0
    """

    name: str
    state: str
    signal_type: str
    gap: float


class PathPoint(NamedTuple):
    """A point of the ego's path.

    Attributes
    ----------
    x, y : float
        Position in m ahead, and to the left, of the ego's reference point.
    heading : float
        Direction relative to the ego's heading in rad.
    curvature : float
        In 1/m, positive to the left.

    Examples
    --------
    >>> import cornercase as cc
    >>> class SlowInCurves(cc.SystemUnderTest):
    ...     def step(self, view, dt):
    ...         curvature = abs(view.path(ahead=20.0).curvature)
    ...         return -2.0 if curvature * view.ego.speed**2 > 2.0 else 0.0
    >>> recording = cc.simulate("examples/t_intersection/t_intersection.xosc", drivers={"Ego": SlowInCurves()})
    >>> speed = recording.speed[recording.entity_index("Ego")]
    >>> float(speed[0]), round(float(speed[-1]), 1)
    (10.0, 7.5)
    """

    x: float
    y: float
    heading: float
    curvature: float


class SharedView:
    """What the driven entity sees in the N scenarios of a batch; each quantity is computed on first use."""

    def __init__(self, situation: Situation, network: RoadNetwork | None = None) -> None:
        self.situation, self._network = situation, network

    @cached_property
    def _seen(self) -> tuple[FloatArray, FloatArray, IntArray]:
        """Own pose on the path (N, 3), what is seen of A others (N, A, 8), and the leaders (N,), as `look` has them."""
        # Its kernels take long to import.
        from cornercase.drivers._kernels.look import N_COLUMNS, look

        s = self.situation
        shape = s.others_x.shape
        own, objects, leader = np.empty((shape[0], 3)), np.empty((*shape, N_COLUMNS)), np.empty(shape[0], np.int64)
        boxes = np.stack((s.others_length, s.others_width, s.others_center_x))
        ego = (s.distance, s.x, s.y, s.heading, s.speed)
        others = (s.others_x, s.others_y, s.others_heading, s.others_speed)
        arrays = (np.ascontiguousarray(array, dtype=np.float64) for array in (*ego, *others))
        look(*s.path.rows, (s.length, s.width, s.center_x), *arrays, boxes, s.active, own, objects, leader)
        return own, objects, leader

    @property
    def own_pose_on_path(self) -> FloatArray:
        """Distance along the path, offset from it, and direction of the path, (3, N)."""
        return self._seen[0].T

    @property
    def relative(self) -> FloatArray:
        """Centre of the boxes ahead and to the left, and heading, as seen from the ego, (3, N, A)."""
        return self._seen[1][..., :3].transpose(2, 0, 1)

    @property
    def along_path(self) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
        """Gap, closing speed, lateral distance, and whether in the path, (N, A) each."""
        from cornercase.drivers._kernels.look import CLOSING, GAP, IN_PATH, LATERAL

        objects = self._seen[1]
        return objects[..., GAP], objects[..., CLOSING], objects[..., LATERAL], objects[..., IN_PATH] == 1.0

    @property
    def time(self) -> float:
        """Time in s without the rounding errors of sums of time steps: 0.15, not 0.15000000000000002."""
        return round(self.situation.time, 9)

    @property
    def turn(self) -> FloatArray:
        """Heading of the ego relative to its path, (N,)."""
        return np.asarray(wrap_angle(self.situation.heading - self.own_pose_on_path[2]))

    def path_points(self, ahead: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Points of the path at K distances ahead, as seen from the ego: x, y, heading, curvature, (N, K) each."""
        s = self.situation
        at = self.own_pose_on_path[0][:, None] + _limit_ahead(s.path, ahead)
        columns = (s.path.x, s.path.y, s.path.heading, s.path.curvature)
        if s.path.distance.ndim == 1:
            x, y, direction, curvature = (np.interp(at, s.path.distance, values) for values in columns)
        else:
            x, y, direction, curvature = (
                np.stack([np.interp(*row) for row in zip(at, s.path.distance, values, strict=True)])
                for values in columns
            )
        dx, dy, heading = x - s.x[:, None], y - s.y[:, None], s.heading[:, None]
        cos, sin = np.cos(heading), np.sin(heading)
        return dx * cos + dy * sin, dy * cos - dx * sin, np.asarray(wrap_angle(direction - heading)), curvature

    @cached_property
    def own_poses(self) -> list[list[float]]:
        """Distance along the path, offset from it, and direction of the path, by scenario."""
        poses: list[list[float]] = self.own_pose_on_path.T.tolist()
        return poses

    @property
    def leader(self) -> IntArray:
        """Index of the leader, (N,); -1 for none."""
        return self._seen[2]

    @cached_property
    def leaders(self) -> list[int]:
        """Index of the leader by scenario; -1 for none."""
        leaders: list[int] = self.leader.tolist()
        return leaders

    @cached_property
    def ego_states(self) -> list[list[float]]:
        """x, y, heading, speed and acceleration of the ego by scenario."""
        s = self.situation
        states: list[list[float]] = np.stack((s.x, s.y, s.heading, s.speed, s.acceleration), axis=1).tolist()
        return states

    @cached_property
    def _boxes(self) -> list[list[float]]:
        s = self.situation
        boxes: list[list[float]] = np.stack((s.others_length, s.others_width), axis=1).tolist()
        return boxes

    def object(self, scenario: int, other: int) -> ObjectView:
        """Return one of the others as seen from the ego."""
        s = self.situation
        x, y, turn, gap, closing, lateral, in_path, _ = self._seen[1][scenario, other].tolist()
        speed = float(s.others_speed[scenario, other])
        length, width = self._boxes[other]
        return ObjectView(
            s.others_name[other], s.others_object_type[other], x, y, turn, speed, length, width, gap, closing, lateral,
            in_path == 1.0, self, scenario, other,
        )  # fmt: skip

    def objects_by_distance(self, scenario: int) -> list[int]:
        """Indices of the others that exist, the nearest first."""
        x, y = self._seen[1][scenario, :, :2].T.tolist()
        squared = [dx * dx + dy * dy for dx, dy in zip(x, y, strict=True)]
        return sorted((a for a, value in enumerate(squared) if value == value), key=squared.__getitem__)

    @cached_property
    def surroundings(self) -> Surroundings:
        """Lanes, limits and signals."""
        from cornercase.drivers._surroundings import Surroundings

        return Surroundings(self.situation, self._network, *self._seen[:2])


class View:
    """What a system under test sees in one time step.

    Everything is computed when it is first asked for. Numbers that sensors stand in front of, those of objects, are as
    sensed; the road, the ego itself and the signals are as they are.

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
    lanes : tuple of LaneView
        The lanes of the ego's road where it is, from left to right; none if it is on no lane.
    lane : LaneView or None
        The ego's own lane.
    speed_limit : float
        Limit in m/s of the ego's own lane, else of its road; infinite without limit, NaN if the road file has none.
    signals : mapping of str to SignalView
        By name: the signals that the scenario sets, and those of the road along the ego's path, the next ahead first.

    Examples
    --------
    >>> import cornercase as cc
    >>> class Aeb(cc.SystemUnderTest):
    ...     def step(self, view, dt):
    ...         leader = view.leader
    ...         if leader is not None and leader.gap < 5.0 + 2.0 * leader.closing:
    ...             return -8.0
    ...         return min(1.0, view.target_speed - view.ego.speed)
    >>> cc.simulate("examples/r157/deceleration.xosc", drivers={"Ego": Aeb()})
    <Recording of Ego (car), Other (car), 35.05 s in 702 instants, no collision>
    """

    __slots__ = ("_n", "_objects", "_shared")

    def __init__(self, shared: SharedView, scenario: int) -> None:
        self._shared, self._n = shared, scenario
        self._objects: tuple[ObjectView, ...] | None = None

    @property
    def time(self) -> float:
        """Time since the start of the scenario in s."""
        return self._shared.time

    @property
    def target_speed(self) -> float:
        """Speed in m/s that the scenario asks for."""
        return float(self._shared.situation.target_speed[self._n])

    @property
    def ego(self) -> EgoState:
        """The ego itself."""
        x, y, heading, speed, acceleration = self._shared.ego_states[self._n]
        along, offset, direction = self._shared.own_poses[self._n]
        turn = (heading - direction + math.pi) % (2.0 * math.pi) - math.pi
        return EgoState(x, y, heading, speed, acceleration, along, offset, turn)

    @property
    def objects(self) -> tuple[ObjectView, ...]:
        """All other entities that are sensed, the nearest first."""
        if self._objects is None:
            order = self._shared.objects_by_distance(self._n)
            self._objects = tuple(self._shared.object(self._n, other) for other in order)
        return self._objects

    @property
    def leader(self) -> ObjectView | None:
        """The nearest of those ahead in the ego's path; None if there is none."""
        other = self._shared.leaders[self._n]
        return None if other < 0 else self._shared.object(self._n, other)

    @property
    def lanes(self) -> tuple[LaneView, ...]:
        """The lanes of the ego's road where it is, from left to right."""
        return self._shared.surroundings.lanes(self._n)

    @property
    def lane(self) -> LaneView | None:
        """The ego's own lane; None if it is on none."""
        return next((lane for lane in self.lanes if lane.number == 0), None)

    @property
    def speed_limit(self) -> float:
        """Limit of the ego's own lane in m/s."""
        return self._shared.surroundings.speed_limit(self._n)

    @property
    def signals(self) -> Mapping[str, SignalView]:
        """The signals that the scenario sets, and those along the ego's path, by name."""
        s = self._shared.situation
        front = s.center_x + 0.5 * s.length
        states = {name: str(values[self._n]) for name, values in s.signals.items()}
        placed: dict[str, tuple[str, float]] = {}
        for name, signal_type, distance in self._shared.surroundings.signals(self._n):
            # If the path passes it twice: the first that is not passed yet.
            if name not in placed or placed[name][1] < 0.0:
                placed[name] = signal_type, distance - front
        views = [
            SignalView(name, states.get(name, ""), *placed.get(name, ("", math.nan)))
            for name in dict.fromkeys((*placed, *states))
        ]
        return {view.name: view for view in sorted(views, key=_order_of_signal)}

    def path(self, ahead: float) -> PathPoint:
        """Return the point of the ego's path at a distance ahead.

        Parameters
        ----------
        ahead : float
            Distance along the path in m; beyond an end of the path, it is the end. On a trajectory of the scenario it
            is at most 400 m.

        Returns
        -------
        PathPoint
        """
        s, n = self._shared.situation, self._n
        at = self._shared.own_poses[n][0] + float(_limit_ahead(s.path, ahead))
        columns = (s.path.distance, s.path.x, s.path.y, s.path.heading, s.path.curvature)
        stations, *samples = columns if s.path.distance.ndim == 1 else [column[n] for column in columns]
        px, py, direction, curvature = (float(np.interp(at, stations, values)) for values in samples)
        dx, dy, heading = px - float(s.x[n]), py - float(s.y[n]), float(s.heading[n])
        cos, sin = math.cos(heading), math.sin(heading)
        turn = (direction - heading + math.pi) % (2.0 * math.pi) - math.pi
        return PathPoint(dx * cos + dy * sin, dy * cos - dx * sin, turn, curvature)


def _limit_ahead(path: DrivenPath, ahead: FloatArray | float) -> FloatArray | float:
    """Return distances ahead on a path: on a trajectory, only those up to which it is sampled in any batch."""
    return ahead if path.distance.ndim == 1 else np.minimum(ahead, FARTHEST_ON_TRAJECTORY)


def _order_of_signal(signal: SignalView) -> tuple[bool, bool, float]:
    """Those ahead first, then those that are passed, then those that do not stand along the path."""
    return math.isnan(signal.gap), signal.gap < 0.0, abs(signal.gap)
