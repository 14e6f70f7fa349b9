"""CARLA, by its ScenarioRunner."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final, Literal

from cornercase.drivers import Driver
from cornercase.errors import InputError, SimulationError, SimulatorError, suggestion
from cornercase.readers.carla_log import read_carla_log
from cornercase.recording import Recording
from cornercase.scenario.logical import ConcreteScenario
from cornercase.scenario.openscenario import Scenario
from cornercase.scenario.scenario_runner import write_scenario_runner
from cornercase.simulators.base import Availability
from cornercase.simulators.builtin import checked_seed, checked_settings
from cornercase.simulators.carla.dialect import BEHAVIORS, DRIVER, adapt
from cornercase.simulators.carla.tracker import Tracker
from cornercase.simulators.hosts import address

RUNNER: Final = "SCENARIO_RUNNER_ROOT"
PYTHON: Final = "CORNERCASE_CARLA_PYTHON"
ROOT: Final = "CARLA_ROOT"
_MISSING: Final = "CARLA's client is not installed; pip install 'cornercase[carla]' with a Python of 3.10 to 3.12."
_NO_RUNNER: Final = (
    "ScenarioRunner is not known; get it from github.com/carla-simulator/scenario_runner and set SCENARIO_RUNNER_ROOT"
    " to its folder."
)
# A server takes its port and the two after it.
_PORTS_EACH: Final = 4
_ENDING, _LOADING, _POLL = 2.0, 120.0, 0.02
# What it says when a scenario has ended, whatever came out; its exit code does not tell.
_ENDED: Final = ("All scenario tests were passed", "Not all scenario tests were successful")
_ERROR: Final = re.compile(r"^\w*(Error|Exception)\b")
# Categories for which ScenarioRunner would take any vehicle.
_UNKNOWN: Final = ("semitrailer", "trailer", "train", "tram")
# How many times its patience with an answer.
_SILENCE: Final = 3
_MESH: Final = {"vertex_distance": 2.0, "wall_height": 1.0, "additional_width": 0.6}


class CarlaSimulator:
    """Runs concrete scenarios on a CARLA that is there for nothing else, by ScenarioRunner in synchronous mode.

    Each is written as OpenSCENARIO 1.0 and run by a ScenarioRunner of its own, in its own environment. A second client
    notes how the entities move. An entity with the driver ``cautious``, ``normal`` or ``aggressive`` is driven by
    CARLA's behaviour agent of that temper, along the route that it is assigned at first; all others by ScenarioRunner.
    CARLA does not give the same twice; run each scenario several times.

    Parameters
    ----------
    time_step : float, default 0.05
        s between frames.
    duration : float, default 60
        s after which a scenario ends at the latest.
    on_collision : {"continue", "stop"}, default "continue"
        Whether the first collision of two entities ends the run. Collisions are those of CARLA's sensors.
    drivers : mapping of str to str, optional
        Behaviour agent by entity.
    ego : str, default "Ego"
        Which entity becomes ScenarioRunner's ego vehicle.
    hosts : str, default "localhost"
        Where CARLA listens, as of `cornercase.simulators.hosts.address`.
    port : int, default 2000
        Of the first worker; each further one on a host takes the port 4 above.
    worker : int, default 0
        Which worker this is.
    scenario_runner, python, carla_root : str, optional
        Folder of ScenarioRunner, Python of its environment, and folder of CARLA, in which ``PythonAPI/carla/agents``
        lies; by default those of the environment variables ``SCENARIO_RUNNER_ROOT``, ``CORNERCASE_CARLA_PYTHON`` (else
        the Python that runs this) and ``CARLA_ROOT``.
    agent, agent_config : str, optional
        File of an agent of yours in ScenarioRunner's manner (``AutonomousAgent``), which drives the ego; and its
        configuration.
    record : {"client", "recorder"}, default "client"
        Whether motion is noted by the second client or read from CARLA's recorder file, which the server writes and has
        to be seen from here.
    folder : str, optional
        Where each scenario's files are kept, and the recorder's; by default they are thrown away.
    seed : int, default 0
        Of CARLA's traffic manager.
    undriven : bool, default False
        Whether a scenario may run that asks for another driver of cornercase; the storyboard alone moves that entity.
    patience : float, default 20
        s to wait for an answer of the server.

    Raises
    ------
    InputError
        CARLA's client is not installed, ScenarioRunner is not known, or an option is out of range.
    """

    name = "carla"
    told = ("worker", "ego")

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
        patience: float = 20.0,
    ) -> None:
        settings = checked_settings(time_step, duration, on_collision, None)
        if find_spec("carla") is None:
            raise InputError(_MISSING)
        for entity, driver in (drivers or {}).items():
            if driver not in BEHAVIORS:
                raise InputError(
                    f"--driver {entity}: CARLA has no drivers of cornercase; {suggestion(str(driver), BEHAVIORS)}"
                )
        if record not in ("client", "recorder"):
            raise InputError(f"record={record}: {suggestion(str(record), ('client', 'recorder'))}")
        if not patience > 0.0:
            raise InputError(f"patience={patience:g}: give a time above 0 s.")
        self._time_step, self._duration, self._stops = time_step, duration, on_collision == "stop"
        self._drivers = {entity: str(driver) for entity, driver in (drivers or {}).items()}
        self._ego, self._record, self._seed, self._undriven = ego, record, seed, bool(undriven)
        self._host, self._port = address(hosts, port, worker, _PORTS_EACH)
        self._traffic_port, self._patience = 8000 + worker, patience
        self._runner = _runner(scenario_runner)
        self._python = python or os.environ.get(PYTHON, "") or sys.executable
        self._carla_root, self._folder = carla_root or os.environ.get(ROOT, ""), folder
        self._agent = None if not agent else _file(agent, "agent")
        self._agent_config = None if not agent_config else _file(agent_config, "agent_config")
        self._client: Any = None
        self.settings: dict[str, object] = settings | {
            "drivers": self._drivers,
            "ego": ego,
            "record": record,
            "seed": checked_seed(seed, "CARLA's traffic manager"),
            "carla": version("carla"),
            # What drives is part of what came out.
            "agent": _fingerprint(self._agent),
            "agent_config": _fingerprint(self._agent_config),
        }

    @classmethod
    def availability(cls) -> Availability:
        """Say what it takes; whether a server listens is known when it is asked."""
        try:
            found, missing = version("carla"), ""
        except PackageNotFoundError:
            found, missing = "", _MISSING
        if not missing:
            try:
                _runner("")
            except InputError as error:
                missing = str(error)
        return Availability(
            found,
            missing,
            (
                "pedestrians", "vehicle dynamics", "behaviour agents", "agents of your own",
                "collisions go on or end the run", "not deterministic", "needs a running CARLA",
            ),
        )  # fmt: skip

    def run(self, concretes: Sequence[ConcreteScenario]) -> Iterator[Recording | SimulationError]:
        """Give one recording or one error per concrete scenario, in order.

        Raises
        ------
        InputError
            No server answers, it is of another version than the client, or the scenario file cannot be used.
        """
        for concrete in concretes:
            scenario = Scenario.read(concrete.path)
            behaviors = self._behaviors(scenario)
            try:
                yield self._run(scenario, concrete, behaviors)
            except SimulationError as error:
                if isinstance(error, SimulatorError):
                    self._client = None
                yield error
            except RuntimeError as error:
                # CARLA's client says so when the server is gone, or does not answer in time.
                self._client = None
                yield SimulatorError(f"CARLA on {self._host}:{self._port}: {error}")

    def require_means(self, scenario: Scenario) -> None:
        """Refuse a scenario with entities or drivers that CARLA does not have."""
        self._behaviors(scenario)

    def _behaviors(self, scenario: Scenario) -> dict[str, str]:
        """Behaviour agent of each entity that has one."""
        scenario.require_entity(self._ego, "ego")
        for entity in self._drivers:
            scenario.require_entity(entity, "driven entity")
        found = {}
        for element in scenario.root.iterfind("Entities/ScenarioObject"):
            name = element.get("name", "")
            vehicle = element.find("Vehicle")
            if vehicle is not None and vehicle.get("vehicleCategory") in _UNKNOWN:
                raise InputError(
                    f"{scenario.path}: '{name}' is a {vehicle.get('vehicleCategory')}, which CARLA does not have."
                )
            driver = self._drivers.get(name, scenario.drivers.get(name, ""))
            if driver in BEHAVIORS:
                found[name] = driver
            elif driver and not self._undriven and not (name == self._ego and self._agent):
                raise InputError(
                    f"{scenario.path}: '{name}' asks for the driver '{driver}', which CARLA does not have; --simulator"
                    " carla:undriven=true leaves it to the storyboard alone."
                )
        return found

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
        file = folder / "cornercase.xosc"
        write_scenario_runner(
            scenario, concrete.values, file, ego=self._ego,
            adapt=partial(
                adapt, source=scenario.path, ego=self._ego, behaviors=behaviors, agent=self._agent,
                config=self._agent_config,
            ),
        )  # fmt: skip
        shutil.copyfile(DRIVER, folder / DRIVER.name)
        client = self._connected()
        self._prepare(client, scenario, folder)
        with (
            Tracker(client, scenario.entities, self._ego, self._time_step) as tracker,
            open(folder / "scenario_runner.log", "wb") as log,
        ):
            process = subprocess.Popen(
                self._command(file), cwd=folder, env=self._environment(folder), stdin=subprocess.DEVNULL,
                stdout=log, stderr=subprocess.STDOUT,
            )  # fmt: skip
            try:
                stopped = self._watch(process, tracker)
            finally:
                _end(process)
                self._calm(client)
            said = (folder / "scenario_runner.log").read_text(encoding="utf-8", errors="replace")
            if tracker.missing or not (stopped or any(words in said for words in _ENDED)):
                words = _last_words(said)
                # What the server did not answer it may answer the next time.
                kind = SimulatorError if "time-out of" in words else SimulationError
                raise kind(f"ScenarioRunner did not run it to the end: {words}")
            if self._record == "client":
                return tracker.recording(file, self._duration, self._stops)
        return self._of_recorder(folder / "cornercase.log")

    def _connected(self) -> Any:
        if self._client is None:
            import carla

            client = carla.Client(self._host, self._port)
            client.set_timeout(self._patience)
            try:
                ours, theirs = client.get_client_version(), client.get_server_version()
            except RuntimeError as error:
                raise InputError(
                    f"No CARLA answers on {self._host}:{self._port} ({error}); start CarlaUE4.sh"
                    f" -carla-rpc-port={self._port}."
                ) from error
            if ours != theirs:
                raise InputError(
                    f"CARLA on {self._host}:{self._port} is of version {theirs}, the client here of {ours}; pip install"
                    f" carla=={theirs}."
                )
            self._client = client
        return self._client

    def _prepare(self, client: Any, scenario: Scenario, folder: Path) -> None:
        """Load the scenario's map where another one is there, and clear away what an earlier run has left."""
        import carla

        world, road = client.get_world(), scenario.road_file()
        if road is not None and road.suffix == ".xodr":
            text = (folder / road.name).read_text(encoding="utf-8")
            text = text[text.find("<OpenDRIVE") :]
            there = world.get_map().to_opendrive()
            if there[there.find("<OpenDRIVE") :] != text:
                # As ScenarioRunner would make it, which so has not to do it again for each scenario.
                mesh = carla.OpendriveGenerationParameters(**_MESH, smooth_junctions=True, enable_mesh_visibility=True)
                client.set_timeout(_LOADING)
                world = client.generate_opendrive_world(text, mesh)
        elif road is not None and world.get_map().name.rpartition("/")[2] != road.name:
            client.set_timeout(_LOADING)
            world = client.load_world(road.name)
        client.set_timeout(self._patience)
        self._calm(client)
        for actor in world.get_actors():
            if actor.type_id.startswith(("vehicle.", "walker.", "sensor.", "controller.")):
                actor.destroy()

    def _calm(self, client: Any) -> None:
        """Let the server run by itself again, which would wait for ticks of a ScenarioRunner that is no more."""
        world = client.get_world()
        settings = world.get_settings()
        if settings.synchronous_mode:
            settings.synchronous_mode, settings.fixed_delta_seconds = False, None
            world.apply_settings(settings)

    def _command(self, file: Path) -> list[str]:
        options = {
            "--host": self._host, "--port": self._port, "--timeout": self._patience,
            "--frameRate": repr(1.0 / self._time_step), "--openscenario": file,
            "--trafficManagerPort": self._traffic_port, "--trafficManagerSeed": self._seed,
        }  # fmt: skip
        if self._record == "recorder":
            # Relative to SCENARIO_RUNNER_ROOT.
            options["--record"] = "."
        flat = [str(part) for pair in options.items() for part in pair]
        return [self._python, str(self._runner / "scenario_runner.py"), "--sync", *flat]

    def _environment(self, folder: Path) -> dict[str, str]:
        roots = [self._runner, folder]
        if self._carla_root:
            roots.append(Path(self._carla_root) / "PythonAPI" / "carla")
        known = os.environ.get("PYTHONPATH", "")
        return os.environ | {
            "PYTHONPATH": os.pathsep.join([*map(str, roots), *filter(None, [known])]),
            RUNNER: str(folder),
            "PYTHONUNBUFFERED": "1",
        }

    def _watch(self, process: subprocess.Popen[bytes], tracker: Tracker) -> bool:
        """Wait until the run has ended or who asked for it is gone; True where it has to be ended."""
        parent, frames, heard = os.getppid(), 0, time.monotonic()
        while process.poll() is None and os.getppid() == parent:
            tracker.look()
            if tracker.ended:
                with suppress(subprocess.TimeoutExpired):
                    process.wait(_ENDING)
                return False
            if tracker.frames > frames:
                frames, heard = tracker.frames, time.monotonic()
            elif time.monotonic() - heard > _SILENCE * self._patience:
                # ScenarioRunner may hang on a server that is gone.
                raise SimulatorError(f"no frame came from CARLA for {_SILENCE * self._patience:g} s")
            if (self._stops and tracker.collided) or tracker.elapsed > self._duration:
                return True
            # The sensors of collisions should be there before the first step.
            time.sleep(_POLL if not tracker.missing else _POLL / 10)
        return False

    def _of_recorder(self, path: Path) -> Recording:
        client = self._connected()
        client.stop_recorder()
        # An answer to this comes when the file is whole.
        client.get_world().get_settings()
        if not path.is_file():
            raise SimulationError(
                f"CARLA left no recording {path}; the server has to see that folder, give one by carla:folder="
            )
        try:
            whole = read_carla_log(path)
        except InputError as error:
            raise SimulationError(str(error)) from error
        end = self._duration
        if self._stops and whole.collisions:
            end = min(end, whole.collisions[0].time)
        kept = int((whole.time <= end + 1e-9).sum())
        return replace(
            whole,
            time=whole.time[:kept],
            **{name: getattr(whole, name)[:, :kept] for name in ("x", "y", "heading", "speed", "acceleration")},
            collisions=tuple(one for one in whole.collisions if one.time <= end),
        )


def _runner(given: str) -> Path:
    text = given or os.environ.get(RUNNER, "")
    if not text:
        raise InputError(_NO_RUNNER)
    folder = Path(text)
    if not (folder / "scenario_runner.py").is_file():
        raise InputError(f"{folder}: holds no scenario_runner.py; {RUNNER} has to be the folder of ScenarioRunner.")
    return folder.resolve()


def _file(text: str, option: str) -> Path:
    path = Path(text)
    if not path.is_file():
        raise InputError(f"{option}={text}: there is no such file.")
    return path.resolve()


def _fingerprint(path: Path | None) -> str | None:
    return None if path is None else f"{path.name} {hashlib.sha256(path.read_bytes()).hexdigest()[:16]}"


def _end(process: subprocess.Popen[bytes]) -> None:
    """Let ScenarioRunner clear up, or make it end."""
    if process.poll() is None:
        process.terminate()
        with suppress(subprocess.TimeoutExpired):
            process.wait(_ENDING)
    if process.poll() is None:
        process.kill()
        process.wait()


def _last_words(said: str) -> str:
    """What ScenarioRunner said last of an error, or of anything."""
    lines = [line.strip() for line in said.splitlines() if line.strip()]
    errors = [line for line in lines if _ERROR.match(line)]
    return (errors or lines or ["it said nothing"])[-1][:300]
