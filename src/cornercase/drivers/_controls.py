"""What a driving function decides: for one scenario as `Control`, for a batch as `Controls`."""

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
    """Where the reference point of the ego is to be, from now on.

    A scenario fails if this is farther away than the ego gets in a time step: 10 m, and twice the way at its
    ``maxSpeed``, or at 100 m/s without one. Without a vehicle model, an ego that is to be behind where it is drives
    backwards: it keeps its heading, and its speed is negative. A pedestrian turns around.

    Attributes
    ----------
    time : ndarray of float64, shape (P,)
        Time since the start of the scenario in s, increasing.
    x, y : ndarray of float64, shape (P,)
        Position in m, in the axes of the map.
    heading, speed : ndarray of float64, shape (P,), optional
        Heading in rad and speed in m/s that the ego has where it follows exactly, without a vehicle model. By default
        they are those of its motion in a time step. With a vehicle model the speeds say how it accelerates.

    Raises
    ------
    ValueError
        If there are fewer than two points, shapes differ, a number is not finite, or times do not increase.

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
            raise ValueError(f"a trajectory stays within {_FARTHEST:g} m of the origin of the map")
        if not (np.diff(self.time) > 0.0).all():
            raise ValueError("the times of a trajectory must increase")


@dataclass(frozen=True)
class Control:
    """What a system under test decides in one time step, for one scenario.

    Give one of: an acceleration; throttle and brake; a trajectory. A steering angle may be given with an acceleration
    or with throttle and brake; without one, the ego follows its path. A request for a lane change may be given with an
    acceleration; the ego then changes to that lane while it keeps the acceleration.

    Without a vehicle model the ego follows its path, a trajectory or a lane change exactly, and the model
    ``kinematic`` does what it is steered. With one, and once the ego was steered, a tracker steers where the function
    does not. The ego's path is that of the lane in which its reference point is, if traffic runs its way there; off the
    road it is the last one.

    Attributes
    ----------
    acceleration : float, optional
        Along the ego's heading, in m/s².
    steering : float, optional
        Angle of the front wheels in rad, positive to the left.
    throttle, brake : float, optional
        Pedals from 0 to 1.
    trajectory : Trajectory, optional
        Where the ego is to be from now on; it is followed until another control is given. Before its first time the ego
        goes straight to its first point. After its last it keeps its heading, and brakes with 3 m/s² to a stop.
    lane_change : {"left", "right"}, optional
        Change to the neighbouring lane. Only the step in which a request begins counts: the change goes on by itself,
        and requests during a change are ignored. It takes 4 s, and longer below 5 m/s; it ends if the scenario moves
        the ego to another place. A request for a lane that is not there, or not for the ego's direction, is ignored
        with a notice.

    Raises
    ------
    ValueError
        If the combination is not one of these, or a number is not finite or out of range.

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
            raise ValueError(f"a trajectory says all of the motion; leave out {' and '.join(names)}")
        if self.acceleration is not None and pedals:
            raise ValueError(
                f"acceleration and {pedals[0]} exclude each other; give acceleration, or throttle and brake"
            )
        if self.acceleration is None and not pedals and self.trajectory is None:
            if turns:
                raise ValueError(
                    f"{turns[0]} needs to know how fast; give acceleration, or throttle and brake, with it"
                )
            raise ValueError(
                "a control has to decide something; give acceleration, throttle and brake, or a trajectory"
            )
        if len(turns) == 2:
            raise ValueError("a lane change steers by itself; leave out steering or lane_change")

    @classmethod
    def from_returned(cls, returned: object) -> Self:
        """Return what a function returned as a control.

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
            It is something else, or not finite.
        """
        if isinstance(returned, cls):
            return returned
        if isinstance(returned, int | float | np.floating | np.integer) and not isinstance(returned, bool):
            return cls(acceleration=float(returned))
        raise ValueError(f"{repr_short(returned)} is neither a Control nor an acceleration in m/s²; return one of them")


@dataclass(frozen=True, eq=False)
class Controls:
    """What a driving function decides in one time step, for the N scenarios of a batch.

    Attributes
    ----------
    acceleration, steering, throttle, brake : ndarray of float64, shape (N,)
        As in `Control`; NaN where not given.
    lane_change : ndarray of int64, shape (N,)
        Lanes to the left by which to change; 0 for none.
    trajectories : mapping of int to Trajectory
        By scenario.
    failures : mapping of int to SimulationError
        By scenario; these scenarios end.

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
        """Return controls that decide nothing yet, to be filled.

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
        """Return controls that accelerate along the path.

        Parameters
        ----------
        acceleration : ndarray of float64, shape (N,)
            In m/s².

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
        """Return the controls of a batch from one per scenario.

        Parameters
        ----------
        controls : sequence of Control or float, length N
            A number is an acceleration in m/s². None where there is none.
        failures : mapping of int to SimulationError
            By scenario.

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
