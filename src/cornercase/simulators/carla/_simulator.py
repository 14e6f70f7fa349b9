"""CARLA as a simulator, run by its ScenarioRunner."""

from __future__ import annotations

import hashlib
import shutil
import socket
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Final, Literal

import numpy as np

from cornercase._common.errors import InputError, SimulationError, SimulatorError, suggest_name
from cornercase._common.io.support_table import Notice, merge_notices
from cornercase.drivers import Driver
from cornercase.drivers._resolve import DriverLike, check_drivers, driver_by_name
from cornercase.drivers._serialization import serialize_driver
from cornercase.recordings import Recording
from cornercase.recordings.formats._carla_log import read_carla_log
from cornercase.scenario import ConcreteScenario, Value
from cornercase.scenario._file import ScenarioFile
from cornercase.simulators._base import Availability, Simulator, check_seed, check_settings
from cornercase.simulators._server_addresses import worker_address
from cornercase.simulators.carla._agent_server import AGENT_FILE, AgentServer
from cornercase.simulators.carla._carla_process import make_carla_process
from cornercase.simulators.carla._client_process import find_client_version
from cornercase.simulators.carla._controller_assignment import BEHAVIORS, DrivingAgents
from cornercase.simulators.carla._openscenario_1_0 import (
    GROUND_NOTE,
    ConversionOptions,
    carla_map_name,
    make_concrete_tree,
)
from cornercase.simulators.carla._overridden_parameters import describe_overridden_parameters
from cornercase.simulators.carla._road_conversion import road_text_for_carla
from cornercase.simulators.carla._run_scenario_file import write_run_scenario
from cornercase.simulators.carla._runner_environment import RunnerEnvironment
from cornercase.simulators.carla._runner_process import RunnerProcess
from cornercase.simulators.carla._scenario_runner import RunLimits, SilenceError, run_scenario_runner
from cornercase.simulators.carla._server import CarlaServer
from cornercase.simulators.carla._server_lock import ServerLock
from cornercase.simulators.carla._support_table import HandlingStatus, find_unsupported
from cornercase.simulators.carla._tracker import EntityTracker

# A server uses its port and the next two.
_PORTS_PER_SERVER: Final = 4
# Road file of a run, in a folder that is not on Python's path.
_ROAD_FILE: Final = "road/road.xodr"
# Statuses that cause a notice, and what is done instead.
_REPLACEMENT_BY_STATUS: Final = {
    HandlingStatus.WITHOUT_EFFECT: "",
    HandlingStatus.APPROXIMATE: "; an entity that reacts to an agent does that, any other one moves along a trajectory",
    HandlingStatus.SAMPLED: "; the entity moves along a trajectory of the builtin simulator",
}
# Example of a file for the option `agent`, by which agents are checked.
EXAMPLE_AGENT_FILE: Final = Path(__file__).with_name("cornercase_example_agent.py")
# Categories for which ScenarioRunner would choose any vehicle.
_UNSUPPORTED_CATEGORIES: Final = ("semitrailer", "trailer", "train", "tram")
_RIGHT_HAND_VERSIONS: Final = ("0.9.13", "0.9.15")
# The server is considered lost after this many times `patience` without a frame.
_SILENCE_FACTOR: Final = 3


class Carla(Simulator):
    """Simulator that runs concrete scenarios on a CARLA server by ScenarioRunner, in synchronous mode.

    Nothing else may use the server. Each scenario is written as OpenSCENARIO 1.0 and run by a ScenarioRunner process of
    its own, in the Python environment of ScenarioRunner. A client of CARLA in the same environment records the motion
    of all entities. CARLA's behaviour agents drive entities with the driver ``cautious``, ``normal`` or ``aggressive``
    along their initial route; ScenarioRunner moves all other entities. CARLA is not deterministic, so run each scenario
    several times.

    Parameters
    ----------
    time_step : float, default 0.05
        Time between frames in s.
    duration : float, default 60
        Maximum duration of a scenario in s.
    on_collision : {"continue", "stop"}, default "continue"
        Whether the first collision of two entities ends the run. CARLA's sensors detect collisions.
    drivers : mapping of str to str or Driver, optional
        Behaviour agent of CARLA, by entity. The ego can have any other driver, too, for example one of your own.
    ego : str, default "Ego"
        Entity that becomes ScenarioRunner's ego vehicle.
    hosts : str, default "localhost"
        Host on which CARLA listens, as ``host`` or ``host:port``; an IPv6 address as ``::1`` or ``[::1]:port``. The
        workers use several hosts, separated by ``+``, in turn.
    port : int, default 2000
        Port of the first worker. Each further worker on the same host uses a port that is higher by 4.
    worker : int, default 0
        Number of this worker process, from 0 on.
    scenario_runner, python, carla_root : str, optional
        Folder of ScenarioRunner, Python of its environment, and folder of CARLA, which contains
        ``PythonAPI/carla/agents``. Default: the environment variables ``SCENARIO_RUNNER_ROOT``,
        ``CORNERCASE_CARLA_PYTHON`` (else the current Python) and ``CARLA_ROOT``.
    agent, agent_config : str, optional
        File of your own agent for ScenarioRunner (``AutonomousAgent``), which drives the ego, and its configuration
        file.
    external_ego : bool, default False
        Whether another program, such as Autoware with CARLA's ROS bridge, creates and drives the ego: a vehicle whose
        role name is the value of `ego`. ScenarioRunner waits for this vehicle and moves it to its initial position.
    record : {"client", "recorder"}, default "client"
        Whether motion is recorded by the client or read from the file of CARLA's recorder. The server writes this file,
        which must be accessible on this machine.
    folder : str, optional
        Folder in which the files of each scenario and of CARLA's recorder are kept; by default they are deleted.
    seed : int, default 0
        Seed of CARLA's traffic manager.
    undriven : bool, default False
        Whether a scenario may run in which an entity has a driver that CARLA does not support. If an agent drives
        another entity, or the file names a driver for the ego, the storyboard alone then moves this entity. Otherwise
        the entity moves along a trajectory of the builtin simulator, in which its driver drives it.
    open_loop : bool, default False
        Whether an entity that should react to an agent-driven entity may move along a trajectory of the builtin
        simulator instead, if ScenarioRunner cannot move it by the storyboard.
    any_version : bool, default False
        Whether CARLA, its client and ScenarioRunner may have different versions.
    patience : float, default 20
        Time in s to wait for an answer of the server.
    start : str, optional
        Command that starts a CARLA server for this worker; ``{port}`` in the command stands for the port. The server is
        started again after a crash, a hang or a lost frame. By default a server must run already.
    restart_after : int, default 0
        Number of scenarios after which a server started by `start` is started again; 0 for never.
    rendering : bool, optional
        Whether the server draws pictures, which cameras need. By default it draws them only with ``agent`` or
        ``external_ego``.

    Raises
    ------
    InputError
        An option is out of range. `run` raises it if CARLA's client or ScenarioRunner is not found.

    Examples
    --------
    >>> import cornercase as cc
    >>> simulator = cc.simulators.Carla(hosts="gpu-machine:2000")
    >>> study = cc.Study.create("study.db", problem, simulator)  # doctest: +SKIP
    """

    name = "carla"
    requires = ("worker", "ego")
    parameter_passing = "file"
    has_own_boxes = True

    def __init__(
        self,
        *,
        time_step: float = 0.05,
        duration: float = 60.0,
        on_collision: str = "continue",
        drivers: Mapping[str, DriverLike] | None = None,
        ego: str = "Ego",
        hosts: str = "localhost",
        port: int = 2000,
        worker: int = 0,
        scenario_runner: str = "",
        python: str = "",
        carla_root: str = "",
        agent: str = "",
        agent_config: str = "",
        external_ego: bool = False,
        record: Literal["client", "recorder"] = "client",
        folder: str = "",
        seed: int = 0,
        undriven: bool = False,
        open_loop: bool = False,
        any_version: bool = False,
        patience: float = 20.0,
        start: str = "",
        restart_after: int = 0,
        rendering: bool | None = None,
    ) -> None:
        self._common_settings = check_settings(time_step, duration, on_collision, None)
        self._drivers, self._attached = _split_drivers(drivers, ego)
        if record not in ("client", "recorder"):
            raise InputError(f"record={record}: {suggest_name(str(record), ('client', 'recorder'))}")
        if not patience > 0.0:
            raise InputError(f"patience={patience:g}: give a time above 0 s.")
        self._time_step, self._duration, self._stop_on_collision = time_step, duration, on_collision == "stop"
        self._ego, self._record, self._seed = ego, record, check_seed(seed, "CARLA's traffic manager")
        self._undriven, self._open_loop = bool(undriven), bool(open_loop)
        if not (isinstance(restart_after, int) and restart_after >= 0):
            raise InputError(f"restart_after={restart_after}: give a number of scenarios from 1 on, or 0 for never.")
        self._server = CarlaServer(
            *worker_address(hosts, port, worker, _PORTS_PER_SERVER),
            patience,
            any_version=bool(any_version),
            renders=bool(agent or external_ego) if rendering is None else bool(rendering),
        )
        self._lock = ServerLock(self._server.host, self._server.port)
        self._process = (
            make_carla_process(start, self._server.host, self._server.port, restart_after) if start else None
        )
        self._runner_folders = scenario_runner, python, carla_root
        self._runner: RunnerProcess | None = None
        self._folder = folder
        self._last_scenario: ScenarioFile | None = None
        has_driver = self._attached is not None or ego in self._drivers
        if has_driver and agent:
            raise InputError(
                f"`drivers` {ego}: the agent {agent} already drives the ego; leave out this driver or the agent."
            )
        self._external_ego = bool(external_ego)
        if self._external_ego and (agent or has_driver):
            raise InputError(f"external_ego: {ego} already has an agent or a driver; leave out that or external_ego.")
        self._agent = None if not agent else _existing_file(agent, "agent")
        self._agent_config = None if not agent_config else _existing_file(agent_config, "agent_config")

    @cached_property
    def _environment(self) -> RunnerEnvironment:
        return RunnerEnvironment.find(*self._runner_folders)

    @cached_property
    def settings(self) -> dict[str, object]:  # type: ignore[override]
        """Settings that recordings depend on; `InputError` if CARLA's client or ScenarioRunner is missing."""
        return self._common_settings | {
            "drivers": self._drivers
            | ({} if self._attached is None else {self._ego: serialize_driver(self._attached)}),
            "ego": self._ego,
            "record": self._record,
            "seed": self._seed,
            "carla": find_client_version(self._environment),
            # Recordings also depend on the agent.
            "external_ego": self._external_ego,
            "agent": _file_fingerprint(self._agent),
            "agent_config": _file_fingerprint(self._agent_config),
        }

    @classmethod
    def notices(cls, scenario: ScenarioFile, values: Mapping[str, Value] | None = None) -> tuple[Notice, ...]:
        """List content of a scenario that is left out, changed or replaced by a trajectory for ScenarioRunner."""
        root = make_concrete_tree(scenario, values or {})
        ignored = (
            Notice(
                (finding.description,),
                finding.row.note + _REPLACEMENT_BY_STATUS[finding.row.status],
                scenario.path,
                (),
                affects_result=finding.row.matters,
            )
            for finding in find_unsupported(root)
            if finding.row.status in _REPLACEMENT_BY_STATUS
        )
        return merge_notices((*scenario.left_handed_axes_notices(), *ignored))

    @classmethod
    def availability(cls) -> Availability:
        """Return whether CARLA's client and ScenarioRunner are installed; does not check whether a server runs."""
        client_version, missing = "", ""
        try:
            client_version = find_client_version(RunnerEnvironment.find("", "", ""))
        except InputError as error:
            missing = str(error)
        return Availability(
            client_version,
            missing,
            (
                "pedestrians", "vehicle dynamics", "behaviour agents", "agents of your own",
                "collisions go on or end the run", "not deterministic", "needs a running CARLA",
            ),
        )  # fmt: skip

    def component_versions(self) -> Mapping[str, str]:
        """Return the versions of CARLA's client and ScenarioRunner, and the Python and CARLA folder in use."""
        environment = self._environment
        return {
            "CARLA's client": find_client_version(environment),
            "ScenarioRunner": environment.version,
            "ScenarioRunner's Python": environment.python,
            "CARLA_ROOT": environment.carla_root,
        }

    @classmethod
    def own_agents(cls) -> Mapping[str, Mapping[str, object]]:
        """Return, by a description of the agent, the simulator options with which this agent drives the ego.

        The agents are CARLA's behaviour agents and an example of a user's agent.
        """
        behaviors = {f"CARLA's behaviour agent '{name}'": {"drivers": {"Ego": name}} for name in BEHAVIORS}
        return {**behaviors, "an AutonomousAgent in a file": {"agent": str(EXAMPLE_AGENT_FILE)}}

    def run(self, concretes: Sequence[ConcreteScenario]) -> Iterator[Recording | SimulationError]:
        """Run scenarios.

        Also raises `InputError` if no server answers, if the server has another version than the client, or if another
        worker uses the server.
        """
        for concrete in concretes:
            scenario = self._last_scenario = concrete.load_file(self._last_scenario)
            behaviors = self._behavior_agents(scenario)
            self._lock.acquire()
            try:
                if self._process is not None and self._process.start_if_needed():
                    self._server.disconnect()
                yield self._run_scenario(scenario, concrete, behaviors)
            except SimulationError as error:
                if isinstance(error, SimulatorError):
                    self._stop_server()
                yield error

    def _stop_server(self) -> None:
        """End the client, and the server if it was started here, so that the next scenario starts both again."""
        self._server.disconnect()
        if self._process is not None:
            self._process.stop()

    def close(self) -> None:
        """End ScenarioRunner and CARLA's client, and the server if it was started here."""
        if self._runner is not None:
            self._runner.close()
        self._server.disconnect()
        if self._process is not None:
            self._process.stop()
        self._lock.release()

    def check_supported(self, scenario: ScenarioFile) -> None:
        """Refuse a scenario with entities or drivers that CARLA does not have; notify of parameters without effect."""
        driven = {*self._behavior_agents(scenario)}
        if self._agent or self._attached or self._external_ego:
            driven.add(self._ego)
        ego = {self._ego}
        self.notify(
            describe_overridden_parameters(
                scenario,
                driven,
                externally=ego if self._external_ego else (),
                obeying=ego if self._attached is not None else (),
            )
        )

    def _behavior_agents(self, scenario: ScenarioFile) -> dict[str, str]:
        scenario.require_entity(self._ego, "ego")
        for entity in self._drivers:
            scenario.require_entity(entity, "driven entity")
        behaviors: dict[str, str] = {}
        for element in scenario.root.iterfind("Entities/ScenarioObject"):
            name = element.get("name", "")
            vehicle = element.find("Vehicle")
            if vehicle is not None and vehicle.get("vehicleCategory") in _UNSUPPORTED_CATEGORIES:
                raise InputError(
                    f"{scenario.path}: '{name}' is a {vehicle.get('vehicleCategory')}, which CARLA does not have;"
                    " use another category."
                )
            driver = self._drivers.get(name, scenario.drivers.get(name, ""))
            is_driven = name == self._ego and bool(self._agent or self._attached or self._external_ego)
            if driver in BEHAVIORS and not is_driven:
                behaviors[name] = driver
            elif driver and not self._undriven and not is_driven:
                raise InputError(
                    f"{scenario.path}: '{name}' has the driver '{driver}', which CARLA does not support; with"
                    f" `simulator` carla:undriven=true {name} moves by the storyboard, or along a trajectory of the"
                    " builtin simulator."
                )
        return behaviors

    def _run_scenario(
        self, scenario: ScenarioFile, concrete: ConcreteScenario, behaviors: Mapping[str, str]
    ) -> Recording:
        folder = self._make_folder()
        try:
            if self._attached is None:
                agents = DrivingAgents(behaviors, self._agent, self._agent_config, external=self._external_ego)
                return self._run_in_folder(folder, scenario, concrete, agents)
            located = replace(concrete, file=scenario)
            with AgentServer(self._attached, located, self._ego, self._time_step, folder) as server:
                agents = DrivingAgents(behaviors, AGENT_FILE, server.config_file)
                try:
                    recording = self._run_in_folder(folder, scenario, concrete, agents)
                except SimulationError as error:
                    # ScenarioRunner fails too if the driver does.
                    raise server.failure or error from error
                finally:
                    self.notify(server.limit_notices.values())
                if server.failure is not None:
                    raise server.failure
                return recording
        finally:
            if not self._folder:
                shutil.rmtree(folder, ignore_errors=True)

    def _make_folder(self) -> Path:
        """Make a folder for the files of a run."""
        if not self._folder:
            return Path(tempfile.mkdtemp(prefix="cornercase-"))
        try:
            Path(self._folder).mkdir(parents=True, exist_ok=True)
            return Path(tempfile.mkdtemp(prefix="cornercase-", dir=self._folder))
        except OSError as error:
            raise InputError(
                f"folder={self._folder}: cannot be written ({error.strerror}); choose another folder."
            ) from error

    def _run_in_folder(
        self, folder: Path, scenario: ScenarioFile, concrete: ConcreteScenario, agents: DrivingAgents
    ) -> Recording:
        file, drivers = folder / "cornercase.xosc", folder / "drivers"
        notes = write_run_scenario(
            scenario, concrete.values, file, ego=self._ego,
            options=ConversionOptions(
                agents, self._time_step, self._duration, open_loop=self._open_loop, road_file=_ROAD_FILE,
                controllers=drivers.name, is_run=True,
                knows_left_hand_traffic=self._environment.version not in _RIGHT_HAND_VERSIONS,
            ),
            version=self._environment.version,
        )  # fmt: skip
        drivers.mkdir(exist_ok=True)
        server, road = self._server, scenario.road_path_for(concrete.values)
        town = carla_map_name(scenario, concrete.values)
        self.notify(note.removesuffix(".") for note in notes if GROUND_NOTE in note)
        text = ""
        if road is not None and not town:
            text = road_text_for_carla(scenario.get_root(road))
            (folder / _ROAD_FILE).write_text(text, encoding="utf-8")
        external = self._ego if self._external_ego else ""
        if self._runner is None:
            self._runner = RunnerProcess(self._environment)
        server.connect(self._environment, has_answered=self._process is not None)
        server.prepare(town, text, keep=external)
        log = folder / "cornercase.log"
        with EntityTracker(server, scenario.entities, self._ego, self._time_step, external=external) as tracker:
            try:
                run_scenario_runner(
                    self._runner, file, drivers, self._scenario_runner_options(), tracker,
                    RunLimits(
                        self._duration, self._stop_on_collision, _SILENCE_FACTOR * server.patience,
                        _removes_entity(scenario, self._ego), self._describe_server_end,
                    ),
                    time_step=self._time_step,
                    before_start=(lambda: server.start_recorder(log)) if self._record == "recorder" else lambda: None,
                )  # fmt: skip
            except BaseException as error:
                self._leave_synchronous_mode_safely()
                if isinstance(error, SilenceError) and server.is_connected:
                    raise self._explain_silence(error, tracker) from error
                raise
            server.leave_synchronous_mode()
            recording = tracker.make_recording(file, self._duration, self._stop_on_collision)
        self.notify(
            f"{name} vanished from CARLA in a run, although no action of the scenario removes it"
            for k, name in enumerate(recording.names)
            if not np.isfinite(recording.x[k, -1]) and not _removes_entity(scenario, name)
        )
        return recording if self._record == "client" else self._read_recorder_file(log, recording)

    def _leave_synchronous_mode_safely(self) -> None:
        """Leave synchronous mode after a failure; errors are ignored, since the failure itself is raised."""
        try:
            if self._describe_server_end():
                # Each further call would wait for its answer.
                self._server.disconnect()
            self._server.leave_synchronous_mode()
        except SimulatorError:
            self._server.disconnect()

    def _explain_silence(self, error: SilenceError, tracker: EntityTracker) -> SimulationError:
        """Return an error that says why no frame has come although the server answers."""
        if self._external_ego and self._ego in tracker.missing:
            return SimulationError(
                f"external_ego: no program has made a vehicle with the role name '{self._ego}', for which"
                " ScenarioRunner waits; start that program first"
            )
        reason = f"{error}, although it answers, because ScenarioRunner requested no frame"
        if self._agent is None:
            return SimulatorError(reason)
        name = self._agent.name
        return SimulationError(f"{reason}: the agent {name} hangs, or needs a larger `simulator` carla:patience=")

    def _describe_server_end(self) -> str:
        return "" if self._process is None else self._process.describe_end()

    def _scenario_runner_options(self) -> list[object]:
        server = self._server
        return [
            "--host", server.host, "--port", server.port, "--timeout", server.patience,
            "--trafficManagerPort", _find_free_port(), "--trafficManagerSeed", self._seed,
            *(["--waitForEgo"] if self._external_ego else []),
        ]  # fmt: skip

    def _read_recorder_file(self, path: Path, seen: Recording) -> Recording:
        """Return the recording from the file of CARLA's recorder.

        The file begins one frame later than `seen`, the recording of the client, so the first frame is taken from
        `seen`.
        """
        self._server.stop_recorder()
        if not path.is_file():
            raise SimulationError(
                f"CARLA wrote no recording {path}; choose a folder that the server can write to, with carla:folder="
            )
        try:
            logged = read_carla_log(path)
        except InputError as error:
            raise SimulationError(str(error)) from error
        count = min(len(seen.time) - 1, len(logged.time))
        order = [seen.names.index(name) for name in logged.names]
        return replace(
            logged,
            time=seen.time[: count + 1],
            **{
                name: np.concatenate([getattr(seen, name)[order, :1], getattr(logged, name)[:, :count]], axis=1)
                for name in ("x", "y", "heading", "speed", "acceleration")
            },
            collisions=seen.collisions,
        )


def _split_drivers(drivers: Mapping[str, DriverLike] | None, ego: str) -> tuple[dict[str, str], Driver | None]:
    """Split drivers into CARLA's behaviour agents, by entity, and the driver of the ego, if it has another one.

    Raises `InputError` if an entity other than the ego has a driver that is no behaviour agent.
    """
    behaviors, attached = {}, None
    for entity, driver in check_drivers(drivers).items():
        if isinstance(driver, str) and driver in BEHAVIORS:
            behaviors[entity] = driver
        elif entity != ego:
            raise InputError(
                f"`drivers` {entity}: CARLA has no such behaviour agent; {suggest_name(str(driver), BEHAVIORS)} Drivers"
                f" that are no behaviour agents can drive the ego ({ego}) only."
            )
        else:
            attached = driver_by_name(driver) if isinstance(driver, str) else driver
    return behaviors, attached


def _removes_entity(scenario: ScenarioFile, name: str) -> bool:
    """Return whether an action of a scenario removes, or may remove, an entity; a parameter may name any entity."""
    return any(
        action.get("entityRef") == name or action.get("entityRef", "").startswith("$")
        for action in scenario.root.iter("EntityAction")
        if action.find("DeleteEntityAction") is not None
    )


def _find_free_port() -> int:
    """Return a free port of this machine for CARLA's traffic manager, which the client opens.

    With a fixed port, two ScenarioRunners on one machine would disturb each other. After a traffic manager was killed,
    the server would also believe that it still runs on this port.
    """
    with socket.socket() as free:
        free.bind(("", 0))
        return int(free.getsockname()[1])


def _existing_file(text: str, option: str) -> Path:
    path = Path(text)
    if not path.is_file():
        raise InputError(f"{option}={text}: there is no such file.")
    return path.resolve()


def _file_fingerprint(path: Path | None) -> str | None:
    return None if path is None else f"{path.name} {hashlib.sha256(path.read_bytes()).hexdigest()[:16]}"
