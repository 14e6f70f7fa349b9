"""Decisions of a driving function: for one scenario as `Control`, for many at once as `Controls`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Literal, Self

import numpy as np

from cornercase._common.errors import SimulationError
from cornercase._common.typing import FloatArray, IntArray
from cornercase._common.validation import repr_short

LANE_CHANGES: Final = {None: 0, "left": 1, "right": -1}
"""Number of lanes to the left, by request."""
# m; farther away, positions are too coarse to be simulated.
_FARTHEST: Final = 1e7
_UNITS: Final = {
    "acceleration": "in m/s²",
    "steering": "in rad",
    "throttle": "from 0 to 1",
    "brake": "from 0 to 1",
}


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Planned positions of the ego's reference point at given times, from now on.

    A scenario fails if the next position is too far away: more than 10 m plus twice the distance that the ego drives in
    a time step at its ``maxSpeed`` (100 m/s if there is none). Without a vehicle model, an ego whose next position is
    behind drives backwards: the heading stays, and the speed is negative. A pedestrian turns around instead.

    Attributes
    ----------
    time : ndarray of float64, shape (P,)
        Time since the start of the scenario in s, increasing.
    x, y : ndarray of float64, shape (P,)
        Position in m, in the axes of the map.
    heading, speed : ndarray of float64, shape (P,), optional
        Heading in rad and speed in m/s at the points. Without a vehicle model, the ego has exactly these values; by
        default they follow from its motion in each time step. With a vehicle model, headings have no effect, and the
        speeds guide the acceleration.

    Raises
    ------
    ValueError
        If there are fewer than two points, shapes differ, a number is not finite, a coordinate is above 10,000 km, or
        times do not increase.

    Examples
    --------
    >>> import cornercase as cc
    >>> import numpy as np
    >>> from cornercase.drivers import Trajectory
    >>> trajectory = Trajectory(np.array([0.0, 2.0, 4.0]), x=np.array([0.0, 40.0, 70.0]), y=np.array([0.0, 0.0, 3.5]))
    >>> cc.Control(trajectory=trajectory).trajectory.x
    array([ 0., 40., 70.])
    """

    time: FloatArray
    x: FloatArray
    y: FloatArray
    heading: FloatArray | None = None
    speed: FloatArray | None = None

    def __post_init__(self) -> None:
        given = [name for name in ("time", "x", "y", "heading", "speed") if getattr(self, name) is not None]
        for name in given:
            object.__setattr__(self, name, np.array(getattr(self, name), dtype=np.float64))
        columns: list[FloatArray] = [getattr(self, name) for name in given]
        if self.time.ndim != 1 or len(self.time) < 2 or any(column.shape != self.time.shape for column in columns):
            raise ValueError(f"a trajectory needs {', '.join(given)} of one shape (P,), with at least two points")
        if not np.isfinite(np.stack(columns)).all():
            raise ValueError("a trajectory needs finite numbers")
        if np.abs(np.stack((self.x, self.y))).max() > _FARTHEST:
            raise ValueError(f"a trajectory must stay within {_FARTHEST:g} m of the origin of the map")
        if not (np.diff(self.time) > 0.0).all():
            raise ValueError("the times of a trajectory must increase")


@dataclass(frozen=True)
class Control:
    """Decision of a system under test for one time step of one scenario.

    Give an acceleration, or throttle and brake, or a trajectory. With an acceleration or pedals, you may also give a
    steering angle or request a lane change. Without either, the ego follows its path.

    Without a vehicle model, the ego follows its path, a trajectory or a lane change exactly; if the function gives a
    steering angle, the vehicle model ``kinematic`` moves the ego. A controller steers along the path while the function
    does not steer, in two cases: always with a vehicle model that steers, and otherwise after the first steering angle
    or trajectory. The ego's path is the lane that its reference point is in, if traffic in this lane runs in the ego's
    direction; off the road, the ego keeps its last path.

    Attributes
    ----------
    acceleration : float, optional
        Acceleration along the ego's heading in m/s².
    steering : float, optional
        Angle of the front wheels in rad, positive to the left.
    throttle, brake : float, optional
        Pedals from 0 to 1.
    trajectory : Trajectory, optional
        Planned positions of the ego, followed until another control is given. Before the first time of the trajectory,
        the ego goes straight to the first point. After the last time, the ego keeps its heading, and brakes with 3 m/s²
        to a stop.
    lane_change : {"left", "right"}, optional
        Side of the neighbouring lane to change to. Only the first step of a request counts: the change goes on by
        itself, and requests during a change are ignored. A change takes 4 s, and longer below 5 m/s. The change ends
        early if the scenario moves the ego to another position. If there is no lane for the ego's direction on this
        side, the request is ignored with a notice.

    Raises
    ------
    ValueError
        If the combination of values is not allowed, or a number is not finite or out of range.

    Examples
    --------
    >>> import cornercase as cc
    >>> cc.Control(acceleration=-3.0).acceleration
    -3.0
    """

    acceleration: float | None = None
    steering: float | None = None
    throttle: float | None = None
    brake: float | None = None
    trajectory: Trajectory | None = None
    lane_change: Literal["left", "right"] | None = None

    def __post_init__(self) -> None:
        for name, unit in _UNITS.items():
            value = getattr(self, name)
            if value is not None:
                try:
                    number = float(value)
                except (TypeError, ValueError):
                    raise ValueError(f"{name} is {repr_short(value)}; give a number {unit}") from None
                object.__setattr__(self, name, number)
                if not math.isfinite(number):
                    raise ValueError(f"{name} is {value}, which is not a finite number; give one {unit}")
        for name in ("throttle", "brake"):
            value = getattr(self, name)
            if value is not None and not 0.0 <= value <= 1.0:
                raise ValueError(f"{name} is {value:g}; give a number {_UNITS[name]}")
        if not (self.lane_change is None or self.lane_change in ("left", "right")):
            raise ValueError(f"lane_change is {repr_short(self.lane_change)}; give 'left', 'right' or None")
        if not isinstance(self.trajectory, Trajectory | None):
            raise ValueError(f"trajectory is {repr_short(self.trajectory)}; give a Trajectory with time, x and y")
        self._check_combination()

    def _check_combination(self) -> None:
        pedals = [name for name in ("throttle", "brake") if getattr(self, name) is not None]
        turns = [name for name in ("steering", "lane_change") if getattr(self, name) is not None]
        if self.trajectory is not None and (self.acceleration is not None or pedals or turns):
            names = [*(["acceleration"] if self.acceleration is not None else []), *pedals, *turns]
            raise ValueError(f"a trajectory already sets the whole motion; leave out {' and '.join(names)}")
        if self.acceleration is not None and pedals:
            raise ValueError(
                f"acceleration and {pedals[0]} exclude each other; give acceleration, or throttle and brake"
            )
        if self.acceleration is None and not pedals and self.trajectory is None:
            if turns:
                raise ValueError(
                    f"{turns[0]} alone does not set the speed; also give acceleration, or throttle and brake"
                )
            raise ValueError(
                "a control has to decide something; give acceleration, throttle and brake, or a trajectory"
            )
        if len(turns) == 2:
            raise ValueError("a lane change steers by itself; leave out steering or lane_change")

    @classmethod
    def from_returned(cls, returned: object) -> Self:
        """Convert the result of a user's step function to a `Control`.

        Parameters
        ----------
        returned : object
            A control, or a number, which is an acceleration in m/s².

        Returns
        -------
        Control

        Raises
        ------
        ValueError
            If `returned` is something else, or not finite.
        """
        if isinstance(returned, cls):
            return returned
        if isinstance(returned, int | float | np.floating | np.integer) and not isinstance(returned, bool):
            return cls(acceleration=float(returned))
        raise ValueError(f"{repr_short(returned)} is neither a Control nor an acceleration in m/s²; return one of them")


@dataclass(frozen=True, eq=False)
class Controls:
    """Decisions of a driving function for one time step, in N scenarios at once.

    Attributes
    ----------
    acceleration, steering, throttle, brake : ndarray of float64, shape (N,)
        As in `Control`; NaN in scenarios without this value.
    lane_change : ndarray of int64, shape (N,)
        Number of lanes to change to the left: 1 for left, -1 for right, 0 for no change.
    trajectories : mapping of int to Trajectory
        Trajectory to follow, by index of the scenario.
    failures : mapping of int to SimulationError
        Error by index of the scenario; these scenarios end.

    Examples
    --------
    >>> import numpy as np
    >>> from cornercase.drivers import Controls
    >>> controls = Controls.from_acceleration(np.array([0.0, -6.0]))
    >>> controls.lane_change[1] = 1
    >>> controls.acceleration, controls.steering, controls.lane_change
    (array([ 0., -6.]), array([nan, nan]), array([0, 1]))
    """

    acceleration: FloatArray
    steering: FloatArray
    throttle: FloatArray
    brake: FloatArray
    lane_change: IntArray
    trajectories: Mapping[int, Trajectory] = field(default_factory=dict)
    failures: Mapping[int, SimulationError] = field(default_factory=dict)

    @classmethod
    def empty(cls, scenarios: int) -> Controls:
        """Return controls without any decision, to be filled in.

        Parameters
        ----------
        scenarios : int
            Number N of scenarios.

        Returns
        -------
        Controls
        """
        acceleration, steering, throttle, brake = np.full((4, scenarios), np.nan)
        return cls(acceleration, steering, throttle, brake, np.zeros(scenarios, dtype=np.int64))

    @classmethod
    def from_acceleration(cls, acceleration: FloatArray) -> Controls:
        """Return controls that only set the acceleration along the path.

        Parameters
        ----------
        acceleration : ndarray of float64, shape (N,)
            Acceleration in m/s².

        Returns
        -------
        Controls
        """
        controls = cls.empty(len(acceleration))
        controls.acceleration[:] = acceleration
        return controls

    @classmethod
    def from_scalar(
        cls, controls: Sequence[Control | float | None], failures: Mapping[int, SimulationError]
    ) -> Controls:
        """Combine the controls of N single scenarios into one `Controls`.

        Parameters
        ----------
        controls : sequence of Control or float, length N
            Control of each scenario; a number is an acceleration in m/s², and None is no decision.
        failures : mapping of int to SimulationError
            Errors by index of the scenario.

        Returns
        -------
        Controls
        """
        batch = cls.empty(len(controls))
        trajectories: dict[int, Trajectory] = {}
        for n, control in enumerate(controls):
            if control is None:
                continue
            if isinstance(control, float):
                batch.acceleration[n] = control
                continue
            for name in _UNITS:
                value: Any = getattr(control, name)
                if value is not None:
                    getattr(batch, name)[n] = value
            batch.lane_change[n] = LANE_CHANGES[control.lane_change]
            if control.trajectory is not None:
                trajectories[n] = control.trajectory
        return cls(
            batch.acceleration, batch.steering, batch.throttle, batch.brake, batch.lane_change, trajectories, failures
        )
