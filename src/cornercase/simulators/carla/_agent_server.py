"""Server by which a driver of cornercase decides for the agent that drives the ego on CARLA."""

from __future__ import annotations

import json
import math
import secrets
import socket
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from threading import Thread
from typing import Any, Final, Self

import numpy as np

from cornercase._common.errors import InputError, PluginError, SimulationError
from cornercase._common.geometry.boxes import wrap_angle
from cornercase._common.text.element_locations import prefix_file
from cornercase.drivers import Controls, Driver, DrivingFunction, Situation, Start, View
from cornercase.drivers._attached_driver import AttachedDriver, DriverError
from cornercase.drivers._view import SharedView
from cornercase.scenario import ConcreteScenario
from cornercase.simulators.builtin._simulator import Builtin

AGENT_FILE: Final = Path(__file__).with_name("cornercase_agent.py")
CONFIG_FILE: Final = "cornercase_agent.json"
# Time in s in which a distance from the path fades away.
_FADING_TIME: Final = 0.5


class AgentServer:
    """Server that lets a driver of cornercase decide, in a thread of its own, how the ego moves in one run.

    `folder`: folder of the run, into which the agent's configuration is written. `failure`: error of the driver, if it
    has failed. The ego has the path and the target speed that it has at the start of the scenario in the builtin
    simulator.
    """

    def __init__(
        self,
        driver: Driver,
        concrete: ConcreteScenario,
        ego: str,
        time_step: float,
        folder: Path,
    ) -> None:
        self._start, self._first = _observe_initial_situation(concrete, ego, time_step)
        self._attached_driver, self._time_step, self._ego = AttachedDriver(driver, ego), time_step, ego
        self.failure: SimulationError | None = None
        self._begin_time: float | None = None
        self._situation = self._first
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._connection = self._listener
        # Another user of this machine could connect, too.
        self._token = secrets.token_hex(16)
        config = {
            "ego": ego,
            "names": [ego, *self._start.others],
            "port": self._listener.getsockname()[1],
            "token": self._token,
        }
        self.config_file = folder / CONFIG_FILE
        self.config_file.write_text(json.dumps(config), encoding="utf-8")
        self.config_file.chmod(0o600)
        self._thread = Thread(target=self._serve, daemon=True, name="driver of the ego on CARLA")

    @property
    def limit_notices(self) -> Mapping[str, str]:
        """Sentences without full stop, one for each limit that the driver exceeded, as in `AttachedDriver`."""
        return self._attached_driver.limit_notices

    def __enter__(self) -> Self:
        try:
            self._attached_driver.start(self._start)
        except DriverError as error:
            self._listener.close()
            raise error.error from error
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        # Ends `accept`, and the run of an agent that still asks.
        for end in (self._listener, self._connection):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._thread.join()
        self._attached_driver.release()

    def _serve(self) -> None:
        try:
            with suppress(OSError):
                self._connection, _ = self._listener.accept()
                with self._connection as connection, connection.makefile("rw", encoding="utf-8") as stream:
                    for line in stream:
                        question = json.loads(line)
                        if question.get("token") != self._token:
                            return
                        stream.write(json.dumps(self._decide_motion(question["time"], question["states"])) + "\n")
                        stream.flush()
        except DriverError as error:
            self.failure = error.error
        except SimulationError as error:
            self.failure = error
        except Exception as error:
            self.failure = PluginError(f"{self._attached_driver.display_name} could not decide: {error}")

    def _decide_motion(self, now: float, states: Mapping[str, list[float]]) -> dict[str, Any]:
        """Return the velocity and yaw rate that the driver decides for the ego at the time `now` in s.

        `states`: x, y, heading, speed, length and width of each entity.
        """
        if self._begin_time is None:
            self._begin_time = now
        self._situation = situation = self._make_situation(now - self._begin_time, states)
        # A driver may change the arrays that it is given.
        arrays: dict[str, Any] = {
            name: value.copy() for name, value in vars(situation).items() if isinstance(value, np.ndarray)
        }
        decision = self._attached_driver.step(replace(situation, **arrays))
        if 0 in decision.failures:
            raise decision.failures[0]
        motion, ego = decision.motion.state, View(SharedView(situation), 0)
        if not decision.motion.is_steered[0]:
            return self._compute_motion_along_path(ego, float(motion.speed[0]))
        heading = float(situation.heading[0])
        dx, dy = float(motion.x[0] - situation.x[0]), float(motion.y[0] - situation.y[0])
        cos, sin = math.cos(heading), math.sin(heading)
        turn = float(wrap_angle(motion.heading[0] - heading))
        return self._format_motion(heading, dx * cos + dy * sin, dy * cos - dx * sin, turn)

    def _make_situation(self, time: float, states: Mapping[str, list[float]]) -> Situation:
        first, last = self._first, self._situation
        if time == 0.0:
            # ScenarioRunner sets the initial speeds in this tick, too, and the agent places the ego.
            return first
        x, y, heading, _, length, width = states[self._ego]
        # The scenario's reference point is its `center_x` behind the centre of the box.
        x, y = x - first.center_x * math.cos(heading), y - first.center_x * math.sin(heading)
        speed = _measure_speed(last, time, x, y, heading)
        others = np.array([states.get(name, [np.nan] * 6) for name in self._start.others]).reshape(-1, 6)
        others_heading = others[:, 2]
        situation = replace(
            first,
            time=time,
            time_step=self._time_step,
            distance=last.distance,
            x=np.array([x]),
            y=np.array([y]),
            heading=np.array([heading]),
            speed=np.array([speed]),
            acceleration=np.array([speed - float(last.speed[0])]) / self._time_step,
            length=length,
            width=width,
            others_x=(others[:, 0] - first.others_center_x * np.cos(others_heading))[None],
            others_y=(others[:, 1] - first.others_center_x * np.sin(others_heading))[None],
            others_heading=others_heading[None],
            others_speed=others[None, :, 3],
            others_length=np.where(np.isnan(others[:, 4]), first.others_length, others[:, 4]),
            others_width=np.where(np.isnan(others[:, 5]), first.others_width, others[:, 5]),
            active=np.array([True]),
        )
        return replace(situation, distance=SharedView(situation).own_pose_on_path[0])

    def _compute_motion_along_path(self, view: View, speed: float) -> dict[str, Any]:
        """Return the velocity and yaw rate with which the ego follows its path, and gradually comes back to it."""
        ego, step = view.ego, self._time_step
        target, rest = view.path(speed * step), max(1.0 - step / _FADING_TIME, 0.0)
        turn = target.heading + rest * ego.turn
        x = target.x - rest * ego.offset * math.sin(target.heading)
        y = target.y + rest * ego.offset * math.cos(target.heading)
        return self._format_motion(ego.heading, x, y, turn)

    def _format_motion(self, heading: float, x: float, y: float, turn: float) -> dict[str, Any]:
        """Return the velocity of the box's centre and the yaw rate for the motion of one time step.

        The reference point moves by `x` and `y` in m, as seen from the ego, which turns by `turn` in rad.
        """
        center_x, step = self._start.body.center_x, self._time_step
        ahead = x + center_x * (math.cos(turn) - 1.0)
        left = y + center_x * math.sin(turn)
        cos, sin = math.cos(heading) / step, math.sin(heading) / step
        return {"velocity": [ahead * cos - left * sin, ahead * sin + left * cos], "yaw_rate": turn / step}


def _measure_speed(last: Situation, time: float, x: float, y: float, heading: float) -> float:
    """Return the speed in m/s along the arc from the last pose to the present pose.

    CARLA's own speed is that of a point that also moves sideways in turns.
    """
    step = time - last.time
    if step <= 0.0:
        return float(last.speed[0])
    before = float(last.heading[0])
    half = 0.5 * float(wrap_angle(heading - before))
    chord = (x - float(last.x[0])) * math.cos(before + half) + (y - float(last.y[0])) * math.sin(before + half)
    return chord / float(np.sinc(half / math.pi)) / step


class _SituationRecorder(DrivingFunction):
    """Driver that stores what a driver is given at the start of a scenario."""

    given: tuple[Start, Situation] | None = None

    def prepare(self, start: Start) -> None:
        """Store what is known before the first step."""
        self._start = start

    def decide(self, situation: Situation) -> Controls:
        """Store the first situation; return controls with which the ego keeps its speed."""
        if self.given is None:
            self.given = self._start, situation
        return Controls.from_acceleration(np.zeros(len(situation.active)))


def _observe_initial_situation(concrete: ConcreteScenario, ego: str, time_step: float) -> tuple[Start, Situation]:
    """Return what the ego's driver is given at the start of a scenario in the builtin simulator.

    Raises an error if the run fails, or if no driver could decide since the ego moves along no lane or path. The error
    is a `SimulationError` if the scenario works with the values of its file, so that only the values of `concrete` are
    at fault; otherwise an `InputError`.
    """
    try:
        return _simulate_initial_situation(concrete, ego, time_step)
    except InputError as error:
        with suppress(InputError):
            if concrete.values:
                _simulate_initial_situation(replace(concrete, values={}), ego, time_step)
                raise SimulationError(str(error).removesuffix(".")) from error
        raise


def _simulate_initial_situation(concrete: ConcreteScenario, ego: str, time_step: float) -> tuple[Start, Situation]:
    probe = _SituationRecorder()
    simulator = Builtin(time_step=time_step, duration=2.0 * time_step, drivers={ego: probe})
    (result,) = simulator.run([concrete])
    if isinstance(result, SimulationError):
        raise InputError(prefix_file(concrete.path, f"{result}."))
    if probe.given is None:
        raise InputError(
            f"{concrete.path}: '{ego}' does not move along a lane or a path at the start, so no driver can decide."
        )
    return probe.given
