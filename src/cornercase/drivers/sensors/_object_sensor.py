"""Sensors that measure objects: radar, camera and lidar differ in their defaults only."""

from __future__ import annotations

from typing import Any, ClassVar, Final, Literal

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase._common.validation import check_bool, check_float, check_int
from cornercase.drivers._base import Situation
from cornercase.drivers._driving_function import Start
from cornercase.drivers.sensors._sensor import SensedObjects, Sensor

# False objects that a sensor may see at the same time; a further one replaces the oldest.
_MAX_FALSE_OBJECTS: Final = 4
# Cycles for which random numbers are drawn at once.
_CYCLES_AHEAD: Final = 16
# Fraction of a cycle or step that may come from rounding.
_ROUNDING: Final = 1e-6
# Limits of options; others are 0 or more.
_LIMITS: Final[dict[str, dict[str, float]]] = {
    "fov": {"above": 0.0, "maximum": 360.0},
    "range": {"above": 0.0},
    "latency": {"minimum": 0.0, "maximum": 60.0},
    "y": {},
    "yaw": {},
    "miss": {"minimum": 0.0, "maximum": 1.0},
}
# Number of missed cycles of an object that was never detected: more than any real number.
_NEVER: Final = 1 << 30


class ObjectSensor(Sensor):
    """Sensor that measures position, heading and speed of objects in its field of view, in range and not hidden.

    The sensor measures in cycles. An object is detected if one of five points of its box (centre and corners) is in
    sight, unless the sensor misses the object at random. An object is known after `birth` cycles in a row with a
    detection, and forgotten after `death` cycles in a row without a detection. Between measurements, the sensor assumes
    that a known object keeps its measured speed and heading. The driver is given what was known `latency` s earlier.

    Parameters
    ----------
    fov : float, default 360
        Full angle of the field of view in degrees, up to 360.
    range : float, default 100
        Largest distance in m at which objects are seen.
    x : float, optional
        Position ahead of the ego's reference point in m; by default the centre of the ego's box (`Radar`: its front;
        `Camera`: behind the windscreen).
    y : float, default 0
        Position to the left of the ego's reference point in m.
    yaw : float, default 0
        Direction relative to the ego's heading in degrees, positive to the left.
    period : float, default 0.05
        Duration of a cycle in s; the sensor measures in the first time step of each cycle.
    latency : float, default 0
        Time in s until the driver is given a measurement, rounded up to time steps.
    birth, death : int, default 1
        Cycles in a row with a detection until an object is known, and without a detection until it is forgotten.
    miss : float, default 0
        Probability that an object in sight is not detected in a cycle.
    false_rate : float, default 0
        Rate of false objects in 1/s.
    noise : float, default 0
        Standard deviation of each coordinate of a measured position in m.
    speed_noise : float, default 0
        Standard deviation of a measured speed in m/s.
    occlusion : bool, default True
        Whether objects hide other objects behind them.

    Raises
    ------
    InputError
        An option is out of range.

    Examples
    --------
    >>> from cornercase.drivers import DRIVERS, EquippedDriver, Radar
    >>> str(EquippedDriver(DRIVERS.create("normal"), [Radar(range=80, noise=0.3)]))
    'normal + radar:range=80,noise=0.3'
    """

    random_options = frozenset({"miss", "false_rate", "noise", "speed_noise"})
    # Default position, as a fraction of half of the box's length ahead of its centre.
    _default_position: ClassVar[float] = 0.0

    def __init__(
        self,
        *,
        fov: float = 360.0,
        range: float = 100.0,  # noqa: A002
        x: float | None = None,
        y: float = 0.0,
        yaw: float = 0.0,
        period: float = 0.05,
        latency: float = 0.0,
        birth: int = 1,
        death: int = 1,
        miss: float = 0.0,
        false_rate: float = 0.0,
        noise: float = 0.0,
        speed_noise: float = 0.0,
        occlusion: bool = True,
    ) -> None:
        numbers = {
            "fov": fov,
            "range": range,
            "y": y,
            "yaw": yaw,
            "period": period,
            "latency": latency,
            "birth": check_int("birth", birth, 1),
            "death": check_int("death", death, 1),
            "miss": miss,
            "false_rate": false_rate,
            "noise": noise,
            "speed_noise": speed_noise,
        }
        self._given: dict[str, float | None] = {
            name: check_float(name, value, **_LIMITS.get(name, {"minimum": 0.0})) for name, value in numbers.items()
        }
        self._given["x"] = None if x is None else check_float("x", x)
        self._occlusion = check_bool("occlusion", occlusion)
        self.is_random = any(self._given[name] for name in self.random_options)

    def start(self, start: Start, label: str) -> None:
        """Reset all state for a batch.

        Parameters
        ----------
        start : Start
            Description of the batch.
        label : str
            Name of the sensor, with which its random numbers are seeded.
        """
        self._time_step = start.time_step
        self._option = {name: self._option_values(start, name) for name in self._given}
        self._delay = np.ceil(self._option["latency"] / start.time_step - _ROUNDING).astype(np.int64)
        varied = {name for name in self.random_options if self._given[name] or name in start.parameters}
        n, n_others = start.scenarios, len(start.others)
        self.false_objects = _MAX_FALSE_OBJECTS if "false_rate" in varied else 0
        self._misses = _RandomNumberBuffer(start, f"{label}: miss", "random", (n_others,)) if "miss" in varied else None
        has_noise = not varied.isdisjoint({"noise", "speed_noise"})
        self._noise = (
            _RandomNumberBuffer(start, f"{label}: noise", "standard_normal", (3, n_others)) if has_noise else None
        )
        self._false = _RandomNumberBuffer(start, f"{label}: false", "random", (4,)) if self.false_objects else None
        self._n_false = np.zeros(n, dtype=np.int64)
        shape = n, n_others + self.false_objects
        # Last step and cycle; by object, the last measurement and the cycles in a row with and without a detection.
        self._step, self._cycle = np.full(n, -2), np.full(n, -1)
        self._motion, self._measured_at = np.full((4, *shape), np.nan), np.full(shape, np.nan)
        self._n_hits, self._n_missed = np.zeros(shape, dtype=np.int64), np.full(shape, _NEVER)
        self._known = np.zeros(shape, dtype=np.bool_)
        # Ring buffer of what was known in the last steps, for the latency, and the number of each step.
        length = int(self._delay.max(initial=0)) + 1
        self._history, self._history_step = np.full((length, 5, *shape), np.nan), np.full((length, n), -1)

    def _option_values(self, start: Start, name: str) -> FloatArray:
        """Return the value of an option in each of N scenarios, shape (N,)."""
        value = self._given[name]
        if value is None:
            value = start.body.center_x + 0.5 * self._default_position * start.body.length
        return np.asarray(start.parameters.get(name, np.full(start.scenarios, value)), dtype=np.float64)

    def perceive(self, situation: Situation) -> SensedObjects:
        """Measure if a new cycle begins, and return the objects that the driver is given after the latency.

        Parameters
        ----------
        situation : Situation
            True situation.

        Returns
        -------
        SensedObjects
        """
        active, step = situation.active, round(situation.time / self._time_step)
        self._forget(active & (self._step != step - 1))
        self._step[active] = step
        period = self._option["period"]
        long = period > self._time_step
        cycle = np.where(long, np.floor(situation.time / np.where(long, period, 1.0) + _ROUNDING), step)
        due = np.flatnonzero(active & (cycle > self._cycle))
        if len(due):
            self._cycle[due] = cycle[due]
            self._measure(situation, due)
        slot, rows = step % len(self._history), np.flatnonzero(active)
        self._history[slot][:, rows] = self._predict(situation.time, rows)
        self._history_step[slot, rows] = step
        wanted = (step - self._delay) % len(self._history)
        scenarios = np.arange(len(active))
        delayed = self._history[wanted, :, scenarios]
        delayed[self._history_step[wanted, scenarios] != step - self._delay] = np.nan
        return SensedObjects(*delayed.transpose(1, 0, 2))

    def _forget(self, rows: BoolArray) -> None:
        """Forget all objects in the scenarios of the mask `rows`."""
        self._cycle[rows] = -1
        self._n_hits[rows], self._n_missed[rows], self._known[rows] = 0, _NEVER, False
        self._history_step[:, rows] = -1

    def _measure(self, situation: Situation, rows: IntArray) -> None:
        """Measure the objects in the scenarios `rows`, and update which objects are known."""
        s, shape = situation, (len(rows), self._known.shape[1])
        n_others = s.others_x.shape[1]
        detected, motion = np.zeros(shape, dtype=np.bool_), np.full((4, *shape), np.nan)
        x, y = self._option["x"][rows], self._option["y"][rows]
        cos, sin = np.cos(s.heading[rows]), np.sin(s.heading[rows])
        heading = s.heading[rows] + np.deg2rad(self._option["yaw"][rows])
        pose = np.stack((s.x[rows] + x * cos - y * sin, s.y[rows] + x * sin + y * cos, heading), axis=1)
        detected[:, :n_others] = self._find_in_sight(s, rows, pose)
        motion[:, :, :n_others] = np.stack((s.others_x, s.others_y, s.others_heading, s.others_speed))[:, rows]
        if self._misses is not None:
            detected[:, :n_others] &= self._misses.take(rows) >= self._option["miss"][rows, None]
        if self._noise is not None:
            deviation = np.stack([self._option[name][rows] for name in ("noise", "noise", "speed_noise")], axis=1)
            motion[[0, 1, 3], :, :n_others] += (deviation[:, :, None] * self._noise.take(rows)).transpose(1, 0, 2)
        new_false = np.zeros(shape, dtype=np.bool_)
        if self._false is not None:
            appears, columns, false = self._draw_false_objects(self._false.take(rows), s, rows, pose)
            new_false[appears, n_others + columns] = True
            motion[:, appears, n_others + columns] = false
        detected |= new_false
        self._n_hits[rows] = np.where(detected, self._n_hits[rows] + 1, 0)
        self._n_missed[rows] = np.where(detected, 0, np.minimum(self._n_missed[rows] + 1, _NEVER))
        birth, death = (self._option[name][rows, None] for name in ("birth", "death"))
        is_born = (self._n_hits[rows] >= birth) | new_false
        self._known[rows] = is_born | (self._known[rows] & (self._n_missed[rows] < death))
        self._motion[:, rows] = np.where(detected, motion, self._motion[:, rows])
        self._measured_at[rows] = np.where(detected, s.time, self._measured_at[rows])

    def _find_in_sight(self, situation: Situation, rows: IntArray, pose: FloatArray) -> BoolArray:
        """Return which of A objects are in sight in the R scenarios `rows`, shape (R, A).

        `pose` (R, 3) is the pose of the sensor.
        """
        # Its kernels take long to import.
        from cornercase.drivers._kernels.visibility import find_visible_others

        s, at_pose = situation, np.zeros(3)
        others = np.stack((s.others_x, s.others_y, s.others_heading), axis=1)[rows]
        boxes = np.stack((s.others_length, s.others_width, s.others_center_x))
        fov, sight_range = np.deg2rad(self._option["fov"][rows]), self._option["range"][rows]
        # Objects that are checked one at a time do not hide each other.
        groups = [slice(None)] if self._occlusion else [slice(a, a + 1) for a in np.arange(others.shape[2])]
        seen = [
            find_visible_others(
                pose, at_pose, others[:, :, group], boxes[:, group], field_of_view=fov, sight_range=sight_range
            )
            for group in groups
        ]
        return np.concatenate(seen, axis=1) if seen else np.zeros((len(rows), 0), dtype=np.bool_)

    def _draw_false_objects(
        self, draws: FloatArray, situation: Situation, rows: IntArray, pose: FloatArray
    ) -> tuple[IntArray, IntArray, FloatArray]:
        """Draw new false objects by the random numbers `draws`: at most one per cycle and scenario in `rows`.

        A false object appears anywhere in the field of view. It has the ego's heading, and is not faster than the ego.
        Returns for each new object: the index of its scenario in `rows`, (n,); its number among the false objects of
        the scenario, (n,); and its x, y, heading and speed, (4, n).
        """
        interval = np.maximum(self._option["period"], self._time_step)
        chance = -np.expm1(-self._option["false_rate"] * interval)[rows]
        appears = np.flatnonzero(draws[:, 0] < chance)
        chosen, (_, angle, distance, speed) = rows[appears], draws[appears].T
        columns = self._n_false[chosen] % self.false_objects
        self._n_false[chosen] += 1
        direction = pose[appears, 2] + np.deg2rad(self._option["fov"][chosen]) * (angle - 0.5)
        # Uniform over the area.
        away = self._option["range"][chosen] * np.sqrt(distance)
        x, y = pose[appears, 0] + away * np.cos(direction), pose[appears, 1] + away * np.sin(direction)
        return appears, columns, np.stack((x, y, situation.heading[chosen], speed * situation.speed[chosen]))

    def _predict(self, time: float, rows: IntArray) -> FloatArray:
        """Extrapolate known objects to `time`: return x, y, heading, speed and time of measurement in R scenarios.

        The shape is (5, R, A + F) for A other entities and F false objects; NaN for objects that are not known.
        """
        (x, y, heading, speed), measured_at = self._motion[:, rows], self._measured_at[rows]
        driven = speed * (time - measured_at)
        state = np.stack((x + driven * np.cos(heading), y + driven * np.sin(heading), heading, speed, measured_at))
        return np.where(self._known[rows], state, np.nan)


class Radar(ObjectSensor):
    """Radar at the ego's front: an `ObjectSensor` with other defaults, which are listed below.

    Parameters
    ----------
    fov : float, default 60
        Full angle of the field of view in degrees.
    range : float, default 160
        Largest distance in m at which objects are seen.
    period : float, default 0.07
        Duration of a cycle in s.
    latency : float, default 0.1
        Time in s until the driver is given a measurement.
    birth, death : int, default 3 and 5
        Cycles in a row with a detection until an object is known, and without a detection until it is forgotten.
    **options
        Other options of `ObjectSensor`.

    Examples
    --------
    >>> import cornercase as cc
    >>> from cornercase.drivers import DRIVERS, EquippedDriver, Radar
    >>> driver = EquippedDriver(DRIVERS.create("normal"), sensors=[Radar(latency=0.2)])
    >>> cc.simulate("examples/r157/deceleration.xosc", drivers={"Ego": driver})
    <Recording of Ego (car), Other (car), 35.05 s in 702 instants, no collision>
    """

    name = "radar"
    _default_position = 1.0

    def __init__(
        self,
        *,
        fov: float = 60.0,
        range: float = 160.0,  # noqa: A002
        period: float = 0.07,
        latency: float = 0.1,
        birth: int = 3,
        death: int = 5,
        **options: Any,
    ) -> None:
        super().__init__(fov=fov, range=range, period=period, latency=latency, birth=birth, death=death, **options)


class Camera(ObjectSensor):
    """Camera behind the ego's windscreen: an `ObjectSensor` with other defaults, which are listed below.

    Parameters
    ----------
    fov : float, default 100
        Full angle of the field of view in degrees.
    range : float, default 100
        Largest distance in m at which objects are seen.
    period : float, default 0.05
        Duration of a cycle in s.
    latency : float, default 0.15
        Time in s until the driver is given a measurement.
    birth, death : int, default 3 and 5
        Cycles in a row with a detection until an object is known, and without a detection until it is forgotten.
    **options
        Other options of `ObjectSensor`.

    Examples
    --------
    >>> import cornercase as cc
    >>> from cornercase.drivers import DRIVERS, EquippedDriver, Camera
    >>> driver = EquippedDriver(DRIVERS.create("normal"), sensors=[Camera()])
    >>> cc.simulate("examples/r157/deceleration.xosc", drivers={"Ego": driver})
    <Recording of Ego (car), Other (car), 35.05 s in 702 instants, no collision>
    """

    name = "camera"
    _default_position = 0.5

    def __init__(
        self,
        *,
        fov: float = 100.0,
        range: float = 100.0,  # noqa: A002
        period: float = 0.05,
        latency: float = 0.15,
        birth: int = 3,
        death: int = 5,
        **options: Any,
    ) -> None:
        super().__init__(fov=fov, range=range, period=period, latency=latency, birth=birth, death=death, **options)


class Lidar(ObjectSensor):
    """Lidar on the ego's roof: an `ObjectSensor` with other defaults, which are listed below.

    Parameters
    ----------
    range : float, default 120
        Largest distance in m at which objects are seen.
    period : float, default 0.1
        Duration of a cycle in s.
    latency : float, default 0.1
        Time in s until the driver is given a measurement.
    birth, death : int, default 2 and 3
        Cycles in a row with a detection until an object is known, and without a detection until it is forgotten.
    **options
        Other options of `ObjectSensor`.

    Examples
    --------
    >>> import cornercase as cc
    >>> from cornercase.drivers import DRIVERS, EquippedDriver, Lidar
    >>> driver = EquippedDriver(DRIVERS.create("normal"), sensors=[Lidar()])
    >>> cc.simulate("examples/r157/deceleration.xosc", drivers={"Ego": driver})
    <Recording of Ego (car), Other (car), 35.05 s in 702 instants, no collision>
    """

    name = "lidar"

    def __init__(
        self,
        *,
        range: float = 120.0,  # noqa: A002
        period: float = 0.1,
        latency: float = 0.1,
        birth: int = 2,
        death: int = 3,
        **options: Any,
    ) -> None:
        super().__init__(range=range, period=period, latency=latency, birth=birth, death=death, **options)


class _RandomNumberBuffer:
    """Random numbers for N scenarios: an array of `shape` for each cycle of a sensor, drawn several cycles ahead.

    Each scenario has its own generator, so that its numbers do not depend on the batch.
    """

    def __init__(
        self, start: Start, purpose: str, kind: Literal["random", "standard_normal"], shape: tuple[int, ...]
    ) -> None:
        self._sources = [getattr(start.generator(n, purpose), kind) for n in range(start.scenarios)]
        self._ahead = np.empty((start.scenarios, _CYCLES_AHEAD, *shape))
        self._next = np.full(start.scenarios, _CYCLES_AHEAD)

    def take(self, rows: IntArray) -> FloatArray:
        """Return the random numbers of the next cycle for the R scenarios `rows`, shape (R, ...)."""
        for n in rows[self._next[rows] == _CYCLES_AHEAD].tolist():
            self._ahead[n] = self._sources[n](self._ahead.shape[1:])
            self._next[n] = 0
        taken = self._ahead[rows, self._next[rows]]
        self._next[rows] += 1
        return np.asarray(taken)
