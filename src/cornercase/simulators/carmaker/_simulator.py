"""IPG CarMaker as a simulator, controlled by IPG's Python module or by the command port of a running CarMaker."""

from __future__ import annotations

import re
import socket
from collections.abc import Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from pathlib import Path
from typing import Final, Literal

from lxml import etree

from cornercase._common.errors import InputError, SimulationError, SimulatorError, suggest_name
from cornercase._common.validation import check_str
from cornercase.drivers._resolve import DriverLike
from cornercase.recordings import Recording
from cornercase.recordings._box_contacts import cut_after
from cornercase.recordings._from_samples import EntityBox
from cornercase.recordings.formats._erg import read_erg
from cornercase.scenario import ConcreteScenario, Value
from cornercase.scenario._file import ScenarioFile
from cornercase.simulators._base import Availability, Simulator
from cornercase.simulators._server_addresses import worker_address
from cornercase.simulators._server_process import ServerProcess
from cornercase.simulators.carmaker._cmapi_client import CmapiClient, is_cmapi_installed
from cornercase.simulators.carmaker._entity_boxes import describe_box_problems, find_entity_boxes
from cornercase.simulators.carmaker._licences import Licence
from cornercase.simulators.carmaker._tcl_run import START_TIMEOUT, TclClient, TclTestRun
from cornercase.simulators.carmaker._testrun_files import TestRunFiles, read_testrun_files

_DEFAULT_PORT: Final = 16660
# Time limit in s to connect to a CarMaker on this machine.
_CONNECT_TIMEOUT: Final = 0.2
# Part of the name of a TestRun that stands for the name of the scenario file.
_SCENARIO: Final = "{scenario}"
_TCL_CHARACTERS: Final = '"$[]{}\\;\r\n'
# Elements of a scenario file that CarMaker has no use for, so that a value there does nothing.
_UNREAD_ELEMENTS: Final = ("Storyboard", "RoadNetwork", "Performance", "Axles", "Properties", "ObjectController")
# A parameter in a value or expression of OpenSCENARIO.
_REFERENCE: Final = re.compile(r"\$([A-Za-z_]\w*)")
_MISSING_MESSAGE: Final = (
    f"IPG's Python module cmapi is not installed here, and no CarMaker listens on port {_DEFAULT_PORT}; install the"
    f" module from CarMaker's folder, or start CarMaker with -cmdport {_DEFAULT_PORT}. One on another machine or port"
    " is named by options."
)


def _is_port_open(host: str = "127.0.0.1", port: int = _DEFAULT_PORT) -> bool:
    try:
        socket.create_connection((host, port), _CONNECT_TIMEOUT).close()
    except OSError:
        return False
    return True


class CarMaker(Simulator):
    """Simulator that runs a TestRun of CarMaker, with a named value for each parameter.

    If IPG's Python module ``cmapi`` can be imported, it starts CarMaker; otherwise a running CarMaker has to listen on
    its command port.

    The scenario file only defines parameters, entities (``Ego`` and the traffic objects ``T00``, ``T01``, …) and their
    boxes. The TestRun defines what happens; its file uses the named values. Motion is read from the result file.
    Collisions are those that the ego's collision sensor reports, and overlaps of boxes.

    Parameters
    ----------
    time_step : float, default 0.05
        Not used: CarMaker stores its results at its own rate.
    duration : float, default 60
        Longest simulated time of a TestRun in s. It only sets the time limit of a run (see `speedup`); CarMaker does
        not end the TestRun after this simulated time.
    on_collision : {"continue", "stop"}, default "continue"
        Whether a recording ends with its first collision. CarMaker itself goes on, unless the TestRun ends it.
    drivers : mapping, optional
        Must be empty: the TestRun defines CarMaker's driver.
    testrun : str
        Name of the TestRun in the project's ``Data/TestRun``. In this name, ``{scenario}`` stands for the name of the
        scenario file without its ending.
    project : str
        Folder of the CarMaker project with the result files. Several folders are separated by ``+``, and assigned to
        the workers in turn. With ``cmapi`` each worker needs a folder of its own.
    hosts : str, default "localhost"
        Host on which ``CM.exe -cmdport`` runs, as ``host`` or ``host:port``; an IPv6 address as ``::1`` or
        ``[::1]:port``. Several hosts are separated by ``+``, and assigned to the workers in turn.
    port : int, default 16660
        Port of the first worker. Each further worker on the same host uses the next port, so that each worker has its
        own CarMaker.
    worker : int, default 0
        Number of this worker process, from 0 on.
    via : {"auto", "cmapi", "port"}, default "auto"
        How CarMaker is controlled: by IPG's Python module or by the command port. ``auto`` uses the module if it can be
        imported.
    speedup : float, default 1
        Minimum factor by which CarMaker runs faster than real time. The time limit of a run follows from it: `duration`
        divided by `speedup`, and a minute more.
    licences : int, default 0
        Maximum number of CarMakers that run at a time on this host, in all workers and searches of this user; 0 for no
        limit.
    start : str, optional
        Command that starts a CarMaker with a command port; ``{port}`` in the command stands for the port. CarMaker is
        started again after a crash, a hang or a fatal error. By default a CarMaker must run already.

    Raises
    ------
    InputError
        An option is missing or out of range.

    Examples
    --------
    >>> import cornercase as cc
    >>> simulator = cc.simulators.CarMaker(testrun="{scenario}", project="CM_Project")  # doctest: +SKIP
    >>> study = cc.Study.create("study.db", problem, simulator)  # doctest: +SKIP
    """

    name = "carmaker"
    requires = ("worker",)
    parameter_passing = "name"
    runs_storyboard = False

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
        licences: int = 0,
        start: str = "",
    ) -> None:
        _check_drivers_and_licences(drivers, licences)
        check_str("on_collision", on_collision, ("continue", "stop"))
        projects = project.split("+")
        _check_testrun(testrun, projects)
        _check_interface(via, duration, speedup)
        self._testrun, self._project = testrun, Path(projects[worker % len(projects)])
        # The first worker of a project leaves the names of results as they are.
        self._suffix = f"_worker{worker}" if worker >= len(projects) else ""
        self._host, self._port = worker_address(hosts, port, worker)
        self._timeout = duration / speedup + START_TIMEOUT
        self._licence, self._stop_on_collision = Licence(licences), on_collision == "stop"
        self._uses_api = is_cmapi_installed() if via == "auto" else via == "cmapi"
        if self._uses_api and worker >= len(projects):
            raise InputError(
                "`workers`: with cmapi each worker needs its own CarMaker project, and the number of projects given is"
                f" {len(projects)}; give more as project=A+B, or use carmaker:via=port."
            )
        if start and self._uses_api:
            raise InputError(f"start={start}: cmapi starts CarMaker by itself; add via=port, or leave out start.")
        self._server = (
            ServerProcess("CarMaker", start, self._host, self._port, self._is_server_ready, start_timeout=START_TIMEOUT)
            if start
            else None
        )
        self._api: CmapiClient | None = None
        self._n_starts = 0
        self._tcl_client: TclClient | None = None
        self._last_scenario: ScenarioFile | None = None
        self._checked_path: Path | None = None
        self._testrun_files: dict[str, TestRunFiles | None] = {}
        self.settings: dict[str, object] = {
            "testrun": testrun, "duration": duration, "on_collision": on_collision,
        }  # fmt: skip

    @classmethod
    def availability(cls) -> Availability:
        """Return whether IPG's module is installed or a CarMaker listens on the default port."""
        return Availability(
            "",
            "" if is_cmapi_installed() or _is_port_open() else _MISSING_MESSAGE,
            (
                "vehicle dynamics", "traffic objects", "collisions go on or end the recording",
                "needs IPG's cmapi, or a running CarMaker (-cmdport)",
            ),
        )  # fmt: skip

    def run(self, concretes: Sequence[ConcreteScenario]) -> Iterator[Recording | SimulationError]:
        """Run scenarios.

        Also raises `InputError` if CarMaker does not listen or has no licence, or if `check_supported` refuses the
        scenario.
        """
        for concrete in concretes:
            scenario = self._last_scenario = concrete.load_file(self._last_scenario)
            self.check_supported(scenario)
            testrun = self._testrun_name(scenario)
            files = self._read_testrun(testrun)
            if files is not None:
                _require_named_values_used(concrete.values.keys() - set(scenario.parameters), files, "the search")
            boxes = find_entity_boxes(scenario, concrete.values, files)
            self._licence.acquire()
            try:
                outcome = self._run_scenario(testrun, concrete.values, scenario.entities, boxes)
            finally:
                self._give_back_licence()
            yield outcome

    def _run_scenario(
        self, testrun: str, values: Mapping[str, Value], entities: Sequence[str], boxes: Mapping[str, EntityBox]
    ) -> Recording | SimulationError:
        try:
            path = self._run_testrun(testrun, values, _output_quantities(entities))
            return _read_recording(path, boxes, self._stop_on_collision)
        except SimulationError as error:
            if isinstance(error, SimulatorError):
                # It may hang, or have lost its state (FailSafe): the next scenario starts it again.
                self._disconnect()
                if self._server is not None:
                    self._server.stop()
            return error

    def _run_testrun(self, testrun: str, values: Mapping[str, Value], quantities: Sequence[str]) -> Path:
        if self._uses_api:
            return self._provide_api_client(testrun).run_testrun(testrun, values, quantities)
        if self._server is not None and self._server.start_if_needed():
            self._disconnect()
        if self._tcl_client is None:
            self._tcl_client = TclClient(self._host, self._port)
        try:
            run = TclTestRun(self._tcl_client, self._project, self._timeout, quantities, suffix=self._suffix)
            return run.run_testrun(testrun, values)
        except SimulationError:
            # After an error, the answer to an old command may still arrive on this connection.
            self._disconnect()
            raise

    def _provide_api_client(self, testrun: str) -> CmapiClient:
        if self._api is None:
            try:
                self._api = CmapiClient(self._project, testrun, self._timeout)
            except InputError as error:
                if self._n_starts:
                    raise SimulatorError(f"CarMaker did not start again: {str(error).removesuffix('.')}") from error
                raise
            self._n_starts += 1
        return self._api

    def _give_back_licence(self) -> None:
        """Give the licence back, unless a CarMaker that this simulator has started still runs.

        If another worker waits for a licence, this simulator first ends its CarMaker.
        """
        if self._licence.is_awaited():
            self._disconnect()
            if self._server is not None:
                self._server.stop()
        if self._api is None and (self._server is None or not self._server.is_running):
            self._licence.release()

    def _is_server_ready(self) -> bool:
        return _is_port_open(self._host, self._port)

    def _disconnect(self) -> None:
        if self._api is not None:
            self._api.close()
            self._api = None
        if self._tcl_client is not None:
            self._tcl_client.close()
            self._tcl_client = None

    def close(self) -> None:
        """End the CarMaker that this simulator has started, or disconnect from a CarMaker that ran before."""
        self._disconnect()
        if self._server is not None:
            self._server.stop()
        self._licence.release()

    def check_supported(self, scenario: ScenarioFile) -> None:
        """Refuse a scenario with entities that CarMaker does not have, or parameters that its TestRun does not use."""
        for name in scenario.entities:
            if not re.fullmatch(r"Ego|T\d{2,}", name):
                raise InputError(
                    f"{scenario.path}: '{name}' is not an entity of CarMaker; name the ego and the TestRun's traffic"
                    " objects Ego, T00, T01, …, as in its result files."
                )
        # Once per file.
        if self._checked_path == scenario.path:
            return
        self._checked_path = scenario.path
        testrun = self._testrun_name(scenario)
        files = self._read_testrun(testrun)
        if files is None:
            self.notify(
                [
                    f"{self._project / 'Data' / 'TestRun' / testrun}: does not exist, so cornercase cannot check"
                    f" whether the TestRun uses {', '.join(scenario.parameters) or 'named values'}"
                ]
            )
        else:
            # Parameters that other parts of the scenario file use, such as boxes, need not be in the TestRun.
            _require_named_values_used(
                set(scenario.parameters) - _find_used_parameters(scenario), files, str(scenario.path)
            )
            if files.trailer:
                self.notify(
                    [
                        f"{files.path}: has the trailer {files.trailer}, which is in no recording; a collision of it"
                        " counts only if the ego's collision sensor sees it"
                    ]
                )
        self.notify(describe_box_problems(scenario, files))

    def _testrun_name(self, scenario: ScenarioFile) -> str:
        name = self._testrun.replace(_SCENARIO, scenario.path.stem)
        # Somebody else may have named the file.
        _require_plain_name(name)
        return name

    def _read_testrun(self, testrun: str) -> TestRunFiles | None:
        if testrun not in self._testrun_files:
            self._testrun_files[testrun] = read_testrun_files(self._project, testrun)
        return self._testrun_files[testrun]


def _check_drivers_and_licences(drivers: Mapping[str, DriverLike] | None, licences: int) -> None:
    if drivers:
        raise InputError(
            f"`drivers` {', '.join(drivers)}: no driver of cornercase drives in CarMaker; the TestRun has its own."
        )
    if not (isinstance(licences, int) and licences >= 0):
        raise InputError(f"licences={licences}: give a number of CarMakers from 1 on, or 0 for any number.")


def _check_testrun(testrun: str, projects: Sequence[str]) -> None:
    if not testrun or not projects[0]:
        raise InputError("CarMaker needs a TestRun: `simulator` carmaker:testrun=NAME,project=FOLDER.")
    for folder in projects:
        if not Path(folder).is_dir():
            raise InputError(
                f"{folder}: there is no such folder; give the folder of the CarMaker project as project=DIR."
            )
    _require_plain_name(testrun.replace(_SCENARIO, ""))


def _require_plain_name(testrun: str) -> None:
    """Refuse the name of a TestRun if it has characters that CarMaker would execute as Tcl."""
    if any(sign in testrun for sign in _TCL_CHARACTERS):
        raise InputError(
            f"The name of the TestRun '{testrun}' contains a special character of Tcl; rename the TestRun."
        )


def _check_interface(via: str, duration: float, speedup: float) -> None:
    if via not in ("auto", "cmapi", "port"):
        raise InputError(f"via={via}: {suggest_name(via, ('auto', 'cmapi', 'port'))}")
    if via == "cmapi" and not is_cmapi_installed():
        raise InputError(
            "IPG's Python module cmapi cannot be imported; add the folder Python/python3.X of CarMaker's"
            " installation (9 or later) to PYTHONPATH, or use carmaker:via=port."
        )
    if not (0.0 < duration < float("inf") and 0.0 < speedup < float("inf")):
        raise InputError(
            f"A duration of {duration:g} s at a speed-up of {speedup:g} is not possible; both must be above 0."
        )


def _find_used_parameters(scenario: ScenarioFile) -> set[str]:
    """Return the names of the parameters that a scenario file uses in elements that are read for CarMaker.

    For instance, boxes are read, but not the storyboard.
    """
    names, elements = set[str](), [scenario.root]
    while elements:
        element = elements.pop()
        names.update(name for value in element.attrib.values() for name in _REFERENCE.findall(str(value)))
        elements += [child for child in element.iterchildren(etree.Element) if child.tag not in _UNREAD_ELEMENTS]
    return names


def _require_named_values_used(names: AbstractSet[str], files: TestRunFiles, owner: str) -> None:
    """Refuse named values that a TestRun does not use, since CarMaker would accept them silently.

    `owner` says in the message where the named values come from.
    """
    unused = sorted(names - files.named_values)
    if unused:
        written = f" (of CarMaker {files.version})" if files.version else ""
        raise InputError(
            f"{files.path}{written}: this TestRun does not use the named value {', '.join(unused)} of {owner}; write"
            f" ${unused[0]}=0 where the TestRun shall use the value (0 is the default value, change it as you like),"
            " or leave the parameter out."
        )


def _output_quantities(entities: Sequence[str]) -> list[str]:
    """Return the quantities that a result file must contain for the entities.

    CarMaker ignores quantities that its version does not have.
    """
    of_traffic = ("tx", "ty", "rz", "LongVel", "v_0.x", "v_0.y")
    return [
        *("Time", "Car.tx", "Car.ty", "Car.Yaw", "Car.v", "Sensor.Collision.Vhcl.Fr1.Count"),
        *(f"Traffic.{name}.{quantity}" for name in entities if name != "Ego" for quantity in of_traffic),
    ]


def _read_recording(path: Path, boxes: Mapping[str, EntityBox], stop_on_collision: bool) -> Recording:
    try:
        recording = read_erg(path, boxes)
    except InputError as error:
        raise SimulationError(str(error)) from error
    if stop_on_collision and recording.collisions:
        return cut_after(recording, recording.collisions[0].time)
    return recording
