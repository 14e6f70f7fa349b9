"""CARLA, through its ScenarioRunner."""

from __future__ import annotations

import hashlib
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Final, Literal

from cornercase._common.errors import InputError, SimulationError, SimulatorError, suggestion
from cornercase._common.ledger import Notice, merged
from cornercase.drivers import Driver
from cornercase.recordings import Recording, read_carla_log
from cornercase.scenario import ConcreteScenario, Scenario, Value
from cornercase.simulators.base import Availability, Simulator, checked_seed, checked_settings
from cornercase.simulators.carla.dialect import BEHAVIORS, Agents
from cornercase.simulators.carla.openscenario_1_0 import Run, carla_map, concrete_tree, write_1_0
from cornercase.simulators.carla.runner import ScenarioRunner, scenario_runner_folder
from cornercase.simulators.carla.server import Server
from cornercase.simulators.carla.table import Status, findings
from cornercase.simulators.carla.tracker import Tracker
from cornercase.simulators.hosts import address

_MISSING: Final = (
    "CARLA's client is not installed; pip install 'cornercase[carla]' with Python 3.11 or 3.12, on Linux or Windows on"
    " x86-64."
)
# A server uses its port and the next two.
_PORTS_EACH: Final = 4
# Road file of a run, in a folder that is not on Python's path.
_ROAD: Final = "road/road.xodr"
# Statuses that cause a notice, and what is done instead.
_INSTEAD: Final = {
    Status.WITHOUT_EFFECT: "",
    Status.APPROXIMATE: "; an entity that reacts to an agent does that, any other one moves along a trajectory",
    Status.SAMPLED: "; the entity moves along a trajectory of the builtin simulator",
}
# Categories for which ScenarioRunner would choose any vehicle.
_UNKNOWN: Final = ("semitrailer", "trailer", "train", "tram")
# The server is considered lost after this many times `patience` without a frame.
_SILENCE: Final = 3


class CarlaSimulator(Simulator):
    """Runs concrete scenarios by ScenarioRunner in synchronous mode, on a CARLA server that nothing else uses.

    Each scenario is written as OpenSCENARIO 1.0 and run by its own ScenarioRunner process, in ScenarioRunner's
    environment. A second client records the motion of all entities. CARLA's behaviour agents drive entities with the
    driver ``cautious``, ``normal`` or ``aggressive`` along their initial route; ScenarioRunner moves all others. CARLA
    is not deterministic, so run each scenario several times.

    Parameters
    ----------
    time_step : float, default 0.05
        Time between frames in s.
    duration : float, default 60
        Maximum duration of a scenario in s.
    on_collision : {"continue", "stop"}, default "continue"
        Whether the first collision of two entities ends the run. CARLA's sensors detect collisions.
    drivers : mapping of str to str, optional
        Behaviour agent by entity.
    ego : str, default "Ego"
        Entity that becomes ScenarioRunner's ego vehicle.
    hosts : str, default "localhost"
        Where CARLA listens: ``host`` or ``host:port``, several separated by ``+``, used in turn.
    port : int, default 2000
        Port of the first worker; each further one on a host uses the port 4 above.
    worker : int, default 0
        Number of this worker.
    scenario_runner, python, carla_root : str, optional
        Folder of ScenarioRunner, Python of its environment, and folder of CARLA, which contains
        ``PythonAPI/carla/agents``. Default: the environment variables ``SCENARIO_RUNNER_ROOT``,
        ``CORNERCASE_CARLA_PYTHON`` (else the current Python) and ``CARLA_ROOT``.
    agent, agent_config : str, optional
        File of your own agent for ScenarioRunner (``AutonomousAgent``), which drives the ego, and its configuration.
    record : {"client", "recorder"}, default "client"
        Whether motion is recorded by the second client or read from the file of CARLA's recorder, which the server
        writes and which must be accessible here.
    folder : str, optional
        Where the files of each scenario and of the recorder are kept; by default they are deleted.
    seed : int, default 0
        Seed of CARLA's traffic manager.
    undriven : bool, default False
        Whether a scenario with another driver of cornercase may run; the storyboard alone moves that entity.
    open_loop : bool, default False
        Whether an entity that ScenarioRunner cannot move by the storyboard may move along a trajectory of the builtin
        simulator, although it should react to an entity that an agent drives.
    patience : float, default 20
        Time in s to wait for an answer of the server.

    Raises
    ------
    InputError
        CARLA's client is not installed, ScenarioRunner is not found or too old, or an option is out of range.
    """

    name = "carla"
    needs = ("worker", "ego")
    values_by = "file"

    def __init__(
        self,
        *,
        time_step: float = 0.05,
        duration: float = 60.0,
        on_collision: str = "continue",
        drivers: Mapping[str, str | Driver] | None = None,
        ego: str = "Ego",
        hosts: str = "localhost",
        port: int = 2000,
        worker: int = 0,
        scenario_runner: str = "",
        python: str = "",
        carla_root: str = "",
        agent: str = "",
        agent_config: str = "",
        record: Literal["client", "recorder"] = "client",
        folder: str = "",
        seed: int = 0,
        undriven: bool = False,
        open_loop: bool = False,
        patience: float = 20.0,
    ) -> None:
        settings = checked_settings(time_step, duration, on_collision, None)
        if find_spec("carla") is None:
            raise InputError(_MISSING)
        for entity, driver in (drivers or {}).items():
            if driver not in BEHAVIORS:
                raise InputError(
                    f"`drivers` {entity}: CARLA does not have this driver; {suggestion(str(driver), BEHAVIORS)}"
                )
        if record not in ("client", "recorder"):
            raise InputError(f"record={record}: {suggestion(str(record), ('client', 'recorder'))}")
        if not patience > 0.0:
            raise InputError(f"patience={patience:g}: give a time above 0 s.")
        self._time_step, self._duration, self._stops = time_step, duration, on_collision == "stop"
        self._drivers = {entity: str(driver) for entity, driver in (drivers or {}).items()}
        self._ego, self._record, self._seed, self._undriven = ego, record, seed, bool(undriven)
        self._open_loop = bool(open_loop)
        self._server = Server(*address(hosts, port, worker, _PORTS_EACH), patience)
        self._runner = ScenarioRunner(scenario_runner, python, carla_root)
        self._traffic_port, self._folder = 8000 + worker, folder
        self._read: Scenario | None = None
        self._agent = None if not agent else _file(agent, "agent")
        self._agent_config = None if not agent_config else _file(agent_config, "agent_config")
        self.settings: dict[str, object] = settings | {
            "drivers": self._drivers,
            "ego": ego,
            "record": record,
            "seed": checked_seed(seed, "CARLA's traffic manager"),
            "carla": version("carla"),
            # Recordings also depend on the agent.
            "agent": _fingerprint(self._agent),
            "agent_config": _fingerprint(self._agent_config),
        }

    @classmethod
    def notices(cls, scenario: Scenario, values: Mapping[str, Value] | None = None) -> tuple[Notice, ...]:
        """List content that is left out, changed or replaced by a trajectory for ScenarioRunner."""
        root = concrete_tree(scenario, values or {})
        ignored = (
            Notice(
                (finding.what,),
                finding.row.note + _INSTEAD[finding.row.status],
                scenario.path,
                (),
                matters=finding.row.matters,
            )
            for finding in findings(root)
            if finding.row.status in _INSTEAD
        )
        return merged((*scenario.axes_notices(), *ignored))

    @classmethod
    def availability(cls) -> Availability:
        """Return whether client and ScenarioRunner are installed; the server is checked when it is needed."""
        try:
            client_version, missing = version("carla"), ""
        except PackageNotFoundError:
            client_version, missing = "", _MISSING
        if not missing:
            try:
                scenario_runner_folder("")
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

    def run(self, concretes: Sequence[ConcreteScenario]) -> Iterator[Recording | SimulationError]:
        """Run scenarios; `InputError` also if no server answers or its version differs from the client's."""
        for concrete in concretes:
            scenario = self._read = concrete.scenario(self._read)
            behaviors = self._behaviors(scenario)
            try:
                yield self._run(scenario, concrete, behaviors)
            except SimulationError as error:
                if isinstance(error, SimulatorError):
                    self._server.forget()
                yield error
            except RuntimeError as error:
                # CARLA's client raises RuntimeError if the server is gone or does not answer in time.
                self._server.forget()
                yield SimulatorError(f"CARLA on {self._server.host}:{self._server.port}: {error}")

    def require_means(self, scenario: Scenario) -> None:
        """Refuse a scenario with entities or drivers that CARLA does not have."""
        self._behaviors(scenario)

    def _behaviors(self, scenario: Scenario) -> dict[str, str]:
        """Behaviour agents by entity."""
        scenario.require_entity(self._ego, "ego")
        for entity in self._drivers:
            scenario.require_entity(entity, "driven entity")
        behaviors = {}
        for element in scenario.root.iterfind("Entities/ScenarioObject"):
            name = element.get("name", "")
            vehicle = element.find("Vehicle")
            if vehicle is not None and vehicle.get("vehicleCategory") in _UNKNOWN:
                raise InputError(
                    f"{scenario.path}: '{name}' is a {vehicle.get('vehicleCategory')}, which CARLA does not have;"
                    " use another category."
                )
            driver = self._drivers.get(name, scenario.drivers.get(name, ""))
            if driver in BEHAVIORS:
                behaviors[name] = driver
            elif driver and not self._undriven and not (name == self._ego and self._agent):
                raise InputError(
                    f"{scenario.path}: '{name}' has the driver '{driver}', which CARLA does not support; `simulator`"
                    " carla:undriven=true runs it with the storyboard only."
                )
        return behaviors

    def _run(self, scenario: Scenario, concrete: ConcreteScenario, behaviors: Mapping[str, str]) -> Recording:
        if self._folder:
            Path(self._folder).mkdir(parents=True, exist_ok=True)
        folder = Path(tempfile.mkdtemp(prefix="cornercase-", dir=self._folder or None))
        try:
            return self._run_in(folder, scenario, concrete, behaviors)
        finally:
            if not self._folder:
                shutil.rmtree(folder, ignore_errors=True)

    def _run_in(
        self, folder: Path, scenario: Scenario, concrete: ConcreteScenario, behaviors: Mapping[str, str]
    ) -> Recording:
        file, drivers = folder / "cornercase.xosc", folder / "drivers"
        write_1_0(
            scenario, concrete.values, file, ego=self._ego,
            run=Run(
                Agents(behaviors, self._agent, self._agent_config), self._time_step, self._duration,
                open_loop=self._open_loop, road_file=_ROAD, controllers=drivers.name,
            ),
        )  # fmt: skip
        drivers.mkdir(exist_ok=True)
        server, road = self._server, scenario.road_file(concrete.values)
        town = carla_map(scenario, concrete.values)
        server.prepare(town or (None if road is None else folder / _ROAD))
        with Tracker(server.client(), scenario.entities, self._ego, self._time_step) as tracker:
            try:
                self._runner.run(
                    file, drivers, self._options(), tracker, duration=self._duration, until_collision=self._stops,
                    silence=_SILENCE * server.patience,
                )  # fmt: skip
            finally:
                server.calm()
            if self._record == "client":
                return tracker.recording(file, self._duration, self._stops)
        return self._of_recorder(folder / "cornercase.log")

    def _options(self) -> dict[str, object]:
        server = self._server
        options: dict[str, object] = {
            "--host": server.host, "--port": server.port, "--timeout": server.patience,
            "--frameRate": repr(1.0 / self._time_step), "--trafficManagerPort": self._traffic_port,
            "--trafficManagerSeed": self._seed,
        }  # fmt: skip
        # Relative to the folder of the run.
        return options | ({"--record": "."} if self._record == "recorder" else {})

    def _of_recorder(self, path: Path) -> Recording:
        self._server.end_recording()
        if not path.is_file():
            raise SimulationError(
                f"CARLA wrote no recording {path}; the server needs access to that folder; set it with carla:folder="
            )
        try:
            recording = read_carla_log(path)
        except InputError as error:
            raise SimulationError(str(error)) from error
        end = self._duration
        if self._stops and recording.collisions:
            end = min(end, recording.collisions[0].time)
        count = int((recording.time <= end + 1e-9).sum())
        return replace(
            recording,
            time=recording.time[:count],
            **{name: getattr(recording, name)[:, :count] for name in ("x", "y", "heading", "speed", "acceleration")},
            collisions=tuple(collision for collision in recording.collisions if collision.time <= end),
        )


def _file(text: str, option: str) -> Path:
    path = Path(text)
    if not path.is_file():
        raise InputError(f"{option}={text}: there is no such file.")
    return path.resolve()


def _fingerprint(path: Path | None) -> str | None:
    return None if path is None else f"{path.name} {hashlib.sha256(path.read_bytes()).hexdigest()[:16]}"
