"""What a system under test sees of its scenario; computed for all scenarios at once, on first use."""

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
        Speed in m/s and acceleration in m/s².
    distance : float
        Distance along the ego's path in m.
    offset : float
        Distance from the path in m, positive to the left.
    turn : float
        Heading relative to the path in rad, positive to the left.

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
        Name, and category: a vehicle category such as ``"car"``, ``"pedestrian"`` or ``"misc"``.
    x, y : float
        Centre of the object's box in m ahead, and to the left, of the ego's reference point.
    heading : float
        Heading relative to the ego's heading in rad.
    speed : float
        Speed in m/s.
    length, width : float
        Size of the object's box in m.
    gap : float
        Distance between the boxes along the ego's path in m: positive for an object ahead, negative for one behind, 0
        if the boxes are next to each other. NaN if the object is nowhere along the path.
    closing : float
        Speed in m/s at which the gap shrinks; negative if it grows.
    lateral : float
        Distance of the object's centre from the ego's path in m, positive to the left; NaN if the gap is NaN.
    in_path : bool
        True if the object's box reaches into the strip that the ego's box sweeps along the path.
    lane : int or None
        Number of the lane that the object's centre is on: 0 for the ego's own lane, 1 for the next to the left. None if
        the object is on no lane of the ego's road.

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
        """Number of the lane that the object's centre is on, counted from the ego's own lane to the left."""
        return self._shared.surroundings.lane_of(self._scenario, self._other)


class SignalView(NamedTuple):
    """A traffic light or a sign.

    Attributes
    ----------
    name : str
        Id of the signal in the road file.
    state : str
        State as the scenario file writes it; empty if the scenario has not set a state.
    signal_type : str
        Type in the road file; empty if there is none.
    gap : float
        Distance along the ego's path in m from the front of the ego's box to the signal; negative once the ego has
        passed the signal, NaN if the signal does not stand along the path.

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
        Curvature in 1/m, positive to the left.

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
    """What the egos of N scenarios see of the traffic, as arrays; each quantity is computed on first use."""

    def __init__(self, situation: Situation, network: RoadNetwork | None = None) -> None:
        self.situation, self._network = situation, network

    @cached_property
    def _seen(self) -> tuple[FloatArray, FloatArray, IntArray]:
        """Pose of the ego on its path (N, 3), A others as seen from the ego (N, A, 8), and index of the leader (N,)."""
        # Its kernels take long to import.
        from cornercase.drivers._kernels.ego_view import N_COLUMNS, look

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
        """Distance along the path and offset to its left in m, and direction of the path in rad, (3, N)."""
        return self._seen[0].T

    @property
    def relative_poses(self) -> FloatArray:
        """A others relative to the ego: centre of the box ahead and to the left in m, and heading in rad, (3, N, A)."""
        return self._seen[1][..., :3].transpose(2, 0, 1)

    @property
    def objects_along_path(self) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
        """A others along the ego's path: gap, closing speed, lateral distance, and True if in the path, (N, A) each."""
        from cornercase.drivers._kernels.ego_view import CLOSING, GAP, IN_PATH, LATERAL

        objects = self._seen[1]
        return objects[..., GAP], objects[..., CLOSING], objects[..., LATERAL], objects[..., IN_PATH] == 1.0

    @property
    def time(self) -> float:
        """Time in s without the rounding errors of sums of time steps: 0.15, not 0.15000000000000002."""
        return round(self.situation.time, 9)

    @property
    def turn(self) -> FloatArray:
        """Heading of the ego relative to its path in rad, (N,)."""
        return np.asarray(wrap_angle(self.situation.heading - self.own_pose_on_path[2]))

    def path_points(self, ahead: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return the points of the path at the K distances `ahead` in m, measured along the path from the ego.

        The results are x, y and heading relative to the ego, and the curvature of the path, each of shape (N, K).
        """
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
    def own_path_coordinates(self) -> list[list[float]]:
        """Values of `own_pose_on_path` as one list per scenario."""
        poses: list[list[float]] = self.own_pose_on_path.T.tolist()
        return poses

    @property
    def leader(self) -> IntArray:
        """Index of the nearest entity ahead in the ego's path, (N,); -1 for none."""
        return self._seen[2]

    @cached_property
    def leaders(self) -> list[int]:
        """Values of `leader` as a list over the scenarios."""
        leaders: list[int] = self.leader.tolist()
        return leaders

    @cached_property
    def ego_states(self) -> list[list[float]]:
        """List of x, y, heading, speed and acceleration of the ego, for each scenario."""
        s = self.situation
        states: list[list[float]] = np.stack((s.x, s.y, s.heading, s.speed, s.acceleration), axis=1).tolist()
        return states

    @cached_property
    def _boxes(self) -> list[list[float]]:
        s = self.situation
        boxes: list[list[float]] = np.stack((s.others_length, s.others_width), axis=1).tolist()
        return boxes

    def object(self, scenario: int, other: int) -> ObjectView:
        """Return the other entity with index `other`, as seen from the ego of the scenario with index `scenario`."""
        s = self.situation
        x, y, turn, gap, closing, lateral, in_path, _ = self._seen[1][scenario, other].tolist()
        speed = float(s.others_speed[scenario, other])
        length, width = self._boxes[other]
        return ObjectView(
            s.others_name[other], s.others_object_type[other], x, y, turn, speed, length, width, gap, closing, lateral,
            in_path == 1.0, self, scenario, other,
        )  # fmt: skip

    def objects_by_distance(self, scenario: int) -> list[int]:
        """Return the indices of the other entities that exist in a scenario, the nearest first."""
        x, y = self._seen[1][scenario, :, :2].T.tolist()
        squared = [dx * dx + dy * dy for dx, dy in zip(x, y, strict=True)]
        return sorted((a for a, value in enumerate(squared) if value == value), key=squared.__getitem__)

    @cached_property
    def surroundings(self) -> Surroundings:
        """Lanes, speed limits and signals around the egos."""
        from cornercase.drivers._surroundings import Surroundings

        return Surroundings(self.situation, self._network, *self._seen[:2])


class View:
    """What a system under test sees of its traffic situation in one time step.

    Everything is computed on first use. If the driver has sensors, objects are as the sensors measure them; the road,
    the ego itself and the signals are always the true ones.

    Parameters
    ----------
    shared : SharedView
        View of all scenarios that are simulated together.
    scenario : int
        Index of the scenario.

    Attributes
    ----------
    time : float
        Time since the start of the scenario in s.
    target_speed : float
        Speed in m/s that the scenario asks for; infinite or NaN if the scenario asks for none.
    ego : EgoState
        The ego itself.
    objects : tuple of ObjectView
        All other entities that are sensed, the nearest first.
    leader : ObjectView or None
        The nearest object ahead in the ego's path.
    lanes : tuple of LaneView
        The lanes of the ego's road at its position, from left to right; none if the ego is on no lane.
    lane : LaneView or None
        The ego's own lane.
    speed_limit : float
        Speed limit in m/s of the ego's own lane, or of the road if the lane has none; infinite if the road file says
        that speed is not limited, NaN if it says nothing.
    signals : mapping of str to SignalView
        Signals that the scenario sets, and signals of the road along the ego's path, by name; the next ahead comes
        first.

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
        along, offset, direction = self._shared.own_path_coordinates[self._n]
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
        """The nearest object ahead in the ego's path; None if there is none."""
        other = self._shared.leaders[self._n]
        return None if other < 0 else self._shared.object(self._n, other)

    @property
    def lanes(self) -> tuple[LaneView, ...]:
        """The lanes of the ego's road at its position, from left to right."""
        return self._shared.surroundings.lanes(self._n)

    @property
    def lane(self) -> LaneView | None:
        """The ego's own lane; None if the ego is on no lane."""
        return next((lane for lane in self.lanes if lane.number == 0), None)

    @property
    def speed_limit(self) -> float:
        """Speed limit of the ego's own lane in m/s."""
        return self._shared.surroundings.speed_limit(self._n)

    @property
    def signals(self) -> Mapping[str, SignalView]:
        """Signals that the scenario sets, and signals along the ego's path, by name."""
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
        return {view.name: view for view in sorted(views, key=_signal_sort_key)}

    def path(self, ahead: float) -> PathPoint:
        """Return the point of the ego's path at a distance ahead.

        Parameters
        ----------
        ahead : float
            Distance along the path in m; beyond an end of the path, the end is returned. If the scenario file gives
            the ego a trajectory, a distance above 400 m counts as 400 m.

        Returns
        -------
        PathPoint
        """
        s, n = self._shared.situation, self._n
        at = self._shared.own_path_coordinates[n][0] + float(_limit_ahead(s.path, ahead))
        columns = (s.path.distance, s.path.x, s.path.y, s.path.heading, s.path.curvature)
        stations, *samples = columns if s.path.distance.ndim == 1 else [column[n] for column in columns]
        px, py, direction, curvature = (float(np.interp(at, stations, values)) for values in samples)
        dx, dy, heading = px - float(s.x[n]), py - float(s.y[n]), float(s.heading[n])
        cos, sin = math.cos(heading), math.sin(heading)
        turn = (direction - heading + math.pi) % (2.0 * math.pi) - math.pi
        return PathPoint(dx * cos + dy * sin, dy * cos - dx * sin, turn, curvature)


def _limit_ahead(path: DrivenPath, ahead: FloatArray | float) -> FloatArray | float:
    """Return distances ahead in m, limited to 400 m if the path is a trajectory of the scenario file."""
    return ahead if path.distance.ndim == 1 else np.minimum(ahead, FARTHEST_ON_TRAJECTORY)


def _signal_sort_key(signal: SignalView) -> tuple[bool, bool, float]:
    """Return a sort key: signals ahead come first, then passed signals, then signals that are not along the path."""
    return math.isnan(signal.gap), signal.gap < 0.0, abs(signal.gap)
