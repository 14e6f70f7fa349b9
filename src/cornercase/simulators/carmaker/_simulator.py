"""IPG CarMaker, through IPG's Python module or the command port of a running CarMaker."""

from __future__ import annotations

import re
import socket
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final, Literal

from cornercase._common.errors import InputError, SimulationError, suggest_name
from cornercase.drivers._resolve import DriverLike
from cornercase.recordings import Recording
from cornercase.recordings._from_samples import EntityBox
from cornercase.recordings.formats._erg import read_erg
from cornercase.scenario import ConcreteScenario, Value
from cornercase.scenario._file import ScenarioFile
from cornercase.simulators._base import Availability, Simulator
from cornercase.simulators._server_addresses import worker_address
from cornercase.simulators.carmaker._cmapi_client import CmapiClient, is_cmapi_installed
from cornercase.simulators.carmaker._entity_boxes import read_entity_boxes, warn_about_missing_boxes
from cornercase.simulators.carmaker._tcl_run import START_TIMEOUT, TclClient, TclTestRun

_DEFAULT_PORT: Final = 16660
# Time limit in s to connect to a CarMaker on this machine.
_CONNECT_TIMEOUT: Final = 0.2
_MISSING_MESSAGE: Final = (
    f"IPG's Python module cmapi is not installed here, and no CarMaker listens on port {_DEFAULT_PORT}; install the"
    f" module from CarMaker's folder, or start CarMaker with -cmdport {_DEFAULT_PORT}. One on another machine or port"
    " is named by options."
)


def _is_port_open() -> bool:
    try:
        socket.create_connection(("127.0.0.1", _DEFAULT_PORT), _CONNECT_TIMEOUT).close()
    except OSError:
        return False
    return True


class CarMaker(Simulator):
    """Runs a TestRun of CarMaker, with a named value for each parameter.

    If IPG's Python module ``cmapi`` can be imported, it starts CarMaker; otherwise a running CarMaker has to listen on
    its command port.

    The scenario file only defines parameters, entities (``Ego`` and the traffic objects ``T00``, ``T01``, …) and their
    boxes. The TestRun defines what happens; its file uses the named values. Motion is read from the result file.

    Parameters
    ----------
    time_step : float, default 0.05
        Not used: CarMaker stores its results at its own rate.
    duration : float, default 60
        Maximum simulated time in s.
    on_collision : {"continue"}, default "continue"
        In CarMaker a collision does not end a run, unless the TestRun says so.
    drivers : mapping, optional
        Must be empty: the TestRun defines CarMaker's driver.
    testrun : str
        Name of the TestRun in the project's ``Data/TestRun``.
    project : str
        Folder of the CarMaker project with the result files; several, separated by ``+``, are used by the workers in
        turn. With ``cmapi`` each worker needs its own.
    hosts : str, default "localhost"
        Where ``CM.exe -cmdport`` runs: ``host`` or ``host:port``, several separated by ``+``, used in turn.
    port : int, default 16660
        Port of the first worker; the next one on a host uses the next port, so that each has its own CarMaker.
    worker : int, default 0
        Number of this worker.
    via : {"auto", "cmapi", "port"}, default "auto"
        How CarMaker is controlled.
    speedup : float, default 1
        Minimum factor by which CarMaker runs faster than real time; it determines the time-outs.

    Raises
    ------
    InputError
        An option is missing or out of range.
    """

    name = "carmaker"
    requires = ("worker",)
    parameter_passing = "name"

    def __init__(
        self,
        *,
        time_step: float = 0.05,
        duration: float = 60.0,
        on_collision: str = "continue",
        drivers: Mapping[str, DriverLike] | None = None,
        testrun: str = "",
        project: str = "",
        hosts: str = "localhost",
        port: int = _DEFAULT_PORT,
        worker: int = 0,
        via: Literal["auto", "cmapi", "port"] = "auto",
        speedup: float = 1.0,
    ) -> None:
        if drivers:
            raise InputError(
                f"`drivers` {', '.join(drivers)}: no driver of cornercase drives in CarMaker; the TestRun has its own."
            )
        if on_collision != "continue":
            raise InputError("`on_collision` stop: in CarMaker a collision ends a run only if the TestRun says so.")
        if not testrun or not project:
            raise InputError("CarMaker needs a TestRun: `simulator` carmaker:testrun=NAME,project=FOLDER.")
        projects = project.split("+")
        for folder in projects:
            if not Path(folder).is_dir():
                raise InputError(
                    f"{folder}: there is no such folder; give that of the CarMaker project as project=DIR."
                )
        if via not in ("auto", "cmapi", "port"):
            raise InputError(f"via={via}: {suggest_name(str(via), ('auto', 'cmapi', 'port'))}")
        if via == "cmapi" and not is_cmapi_installed():
            raise InputError(
                "IPG's Python module cmapi cannot be imported; add the folder Python/python3.X of CarMaker's"
                " installation to PYTHONPATH, or use carmaker:via=port."
            )
        if any(sign in testrun for sign in '"$[]{}\\;\r\n'):
            raise InputError(f"The name of the TestRun '{testrun}' contains a special character of Tcl.")
        if not (0.0 < duration < float("inf") and 0.0 < speedup < float("inf")):
            raise InputError(
                f"A duration of {duration:g} s at a speed-up of {speedup:g} is not possible; both must be above 0."
            )
        self._testrun, self._project = testrun, Path(projects[worker % len(projects)])
        self._host, self._port = worker_address(hosts, port, worker)
        self._timeout = duration / speedup + START_TIMEOUT
        self._uses_api = is_cmapi_installed() if via == "auto" else via == "cmapi"
        if self._uses_api and worker >= len(projects):
            raise InputError(
                f"`workers`: with cmapi each worker needs its own CarMaker project, and there are {len(projects)}; give"
                " more as project=A+B, or use carmaker:via=port."
            )
        self._api: CmapiClient | None = None
        self._tcl_client: TclClient | None = None
        self._last_scenario: ScenarioFile | None = None
        self._warned_path: Path | None = None
        self.settings: dict[str, object] = {"testrun": testrun, "duration": duration}

    @classmethod
    def availability(cls) -> Availability:
        """Return whether IPG's module is installed or a CarMaker listens on the default port."""
        return Availability(
            "",
            "" if is_cmapi_installed() or _is_port_open() else _MISSING_MESSAGE,
            (
                "vehicle dynamics", "traffic objects", "collisions go on",
                "needs IPG's cmapi, or a running CarMaker (-cmdport)",
            ),
        )  # fmt: skip

    def run(self, concretes: Sequence[ConcreteScenario]) -> Iterator[Recording | SimulationError]:
        """Run scenarios; also raises `InputError` if CarMaker does not listen, has no licence or lacks an entity."""
        for concrete in concretes:
            self._last_scenario = concrete.load_file(self._last_scenario)
            self.check_supported(self._last_scenario)
            bodies = read_entity_boxes(self._last_scenario, concrete.values)
            if self._uses_api:
                yield self._run_with_api(concrete.values, bodies)
                continue
            if self._tcl_client is None:
                self._tcl_client = TclClient(self._host, self._port)
            try:
                port_run = TclTestRun(self._tcl_client, self._project, self._timeout)
                yield _read_recording(port_run.run_testrun(self._testrun, concrete.values), bodies)
            except SimulationError as error:
                # After an error, the answer to an old command may still arrive on this connection.
                self._tcl_client.close()
                self._tcl_client = None
                yield error

    def close(self) -> None:
        """End the CarMaker that was started here, or disconnect from a running one."""
        if self._api is not None:
            self._api.close()
            self._api = None
        if self._tcl_client is not None:
            self._tcl_client.close()
            self._tcl_client = None

    def check_supported(self, scenario: ScenarioFile) -> None:
        """Refuse a scenario with entities that CarMaker does not have."""
        for name in scenario.entities:
            if not re.fullmatch(r"Ego|T\d{2,}", name):
                raise InputError(
                    f"{scenario.path}: '{name}' is not an entity of CarMaker; name the ego and the TestRun's traffic"
                    " objects Ego, T00, T01, …, as in its result files."
                )
        # Once per file.
        if self._warned_path != scenario.path:
            self._warned_path = scenario.path
            warn_about_missing_boxes(scenario)

    def _run_with_api(
        self, values: Mapping[str, Value], bodies: Mapping[str, EntityBox]
    ) -> Recording | SimulationError:
        if self._api is None:
            self._api = CmapiClient(self._project, self._testrun, self._timeout)
        try:
            return _read_recording(self._api.run_testrun(values), bodies)
        except SimulationError as error:
            return error


def _read_recording(path: Path, boxes: Mapping[str, EntityBox]) -> Recording:
    try:
        return read_erg(path, boxes)
    except InputError as error:
        raise SimulationError(str(error)) from error
