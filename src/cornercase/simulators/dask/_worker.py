"""Code that runs on the workers of a Dask cluster: it stores simulators and scenario files, and runs scenarios."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import current_process
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Condition, Lock
from typing import TYPE_CHECKING, Final

from cornercase._common.errors import InputError, SimulationError
from cornercase._common.text.sanitize import format_exception
from cornercase._common.version import __version__
from cornercase.scenario import ConcreteScenario, Value
from cornercase.scenario._bundle import ScenarioBundle
from cornercase.scenario._file import ScenarioFile
from cornercase.simulators._base import Simulator
from cornercase.simulators._option_pickling import unpickle_simulator
from cornercase.simulators._registry import SIMULATORS
from cornercase.simulators._results import Outcome, run_scenarios_as_given
from cornercase.simulators._run_options import DEFAULT_MAX_FAILURES
from cornercase.simulators.pool._simulator import WorkerSimulator

if TYPE_CHECKING:
    from distributed import Client


@dataclass(frozen=True)
class SimulatorSetup:
    """A simulator and its settings for one exploration or suite (a job), as sent to the workers.

    `version` is cornercase's version at the sender. `timeout` is in s. `options` are bytes from `pickle_simulator`: the
    Dask scheduler also receives them, and could not unpickle objects of the user's own classes.
    """

    key: str
    version: str
    simulator: str
    options: bytes
    timeout: float | None
    retries: int
    max_failures: int = DEFAULT_MAX_FAILURES


@dataclass(frozen=True)
class TaskId:
    """Identifier of a task of scenarios; the task is given up when it has cost `lives` workers."""

    name: str
    lives: int


@dataclass(frozen=True)
class BatchResult:
    """Results of the scenarios of one task, in order, and notices for the user."""

    outcomes: list[Outcome]
    notices: list[str]


class _JobState:
    """Simulators and scenario files of a job in this worker process; only one thread at a time uses a simulator."""

    def __init__(self, job: SimulatorSetup) -> None:
        self._job = job
        try:
            self._simulator, self._options = unpickle_simulator(job.options)
        except Exception as error:
            raise InputError(
                f"`cluster`: a worker cannot load a driver of your own ({format_exception(error)}); install its module"
                " on each worker, or start the workers in its folder."
            ) from error
        self._free_numbers: list[int] = []
        self._simulators: list[Simulator] = []
        self._condition = Condition()
        declared = SIMULATORS.get_class(self._simulator)
        self._wants_worker_number = "worker" in declared.requires
        # An in-process simulator uses all cores of this process.
        self._runs_in_process = declared.in_process and job.timeout is None
        self._folders: dict[str, TemporaryDirectory[str]] = {}
        self._scenarios: dict[str, ScenarioFile] = {}

    @contextmanager
    def borrow_simulator(self) -> Iterator[Simulator]:
        with self._condition:
            while self._runs_in_process and self._simulators and not self._free_numbers:
                self._condition.wait()
            if not self._free_numbers:
                self._simulators.append(self._create_simulator(len(self._simulators)))
                heapq.heappush(self._free_numbers, len(self._simulators) - 1)
            number = heapq.heappop(self._free_numbers)
        try:
            yield self._simulators[number]
        finally:
            with self._condition:
                heapq.heappush(self._free_numbers, number)
                self._condition.notify()

    def _create_simulator(self, number: int) -> Simulator:
        job = self._job
        options = self._options | ({"worker": number} if self._wants_worker_number else {})
        if self._runs_in_process:
            return SIMULATORS.create(self._simulator, **options)
        if current_process().daemon:
            raise InputError(
                "`cluster`: the workers cannot start the processes in which simulators run; set"
                " DASK_DISTRIBUTED__WORKER__DAEMON=False when you start the workers."
            )
        return WorkerSimulator(self._simulator, options, 1, job.timeout, job.retries, job.max_failures)

    def unpack_scenario(self, key: str, bundle: ScenarioBundle) -> tuple[ScenarioFile, Path]:
        from distributed import get_worker

        with self._condition:
            if key not in self._scenarios:
                # In the worker's folder, which Dask removes if this process cannot.
                worker_folder = get_worker().local_directory
                folder = TemporaryDirectory(prefix="cornercase-", dir=worker_folder, ignore_cleanup_errors=True)
                self._scenarios[key] = bundle.unpack(Path(folder.name))
                self._folders[key] = folder
            return self._scenarios[key], Path(self._folders[key].name)

    def close(self) -> None:
        for simulator in self._simulators:
            simulator.close()
        for folder in self._folders.values():
            folder.cleanup()


_JOB_STATES: Final[dict[str, _JobState]] = {}
_LOCK: Final = Lock()


def return_bundle(bundle: ScenarioBundle) -> ScenarioBundle:
    """Return a bundle of scenario files unchanged; as a Dask task, this stores the bundle on the cluster."""
    return bundle


def run_scenarios_of_job(
    job: SimulatorSetup,
    task_id: TaskId,
    bundles: Mapping[str, ScenarioBundle],
    scenarios: Sequence[tuple[str, Mapping[str, Value], int]],
) -> BatchResult | None:
    """Run scenarios (bundle key, values, seed) of a job on this worker.

    Return None without running them if too many workers were lost while they ran the same task.
    """
    if job.version != __version__:
        raise InputError(
            f"`cluster`: a worker has cornercase {__version__}, this machine has {job.version}; install"
            " the same version on both."
        )
    with _LOCK:
        job_state = _JOB_STATES[job.key] if job.key in _JOB_STATES else _JOB_STATES.setdefault(job.key, _JobState(job))
    unpacked = {key: job_state.unpack_scenario(key, bundle) for key, bundle in bundles.items()}
    concretes = [
        ConcreteScenario(unpacked[key][0].path, values, unpacked[key][0], seed) for key, values, seed in scenarios
    ]
    sender_folders = {str(unpacked[key][1]): bundle.common_folder for key, bundle in bundles.items()}
    with _mark_started(task_id) as may_run:
        if not may_run:
            return None
        try:
            with job_state.borrow_simulator() as simulator:
                noticed = list[str]()
                simulator.on_notice = noticed.append
                results = list(run_scenarios_as_given(simulator, concretes))
        except InputError as error:
            raise InputError(_restore_sender_paths(str(error), sender_folders)) from None
    outcomes = [
        type(result)(_restore_sender_paths(str(result), sender_folders))
        if isinstance(result, SimulationError)
        else result
        for result in results
    ]
    return BatchResult(outcomes, noticed)


@contextmanager
def _mark_started(task_id: TaskId) -> Iterator[bool]:
    """Mark a task as started while it runs; yield whether it may start.

    The mark is stored at the Dask scheduler. If a worker is lost, its mark remains, so that lost workers can be
    counted; `forget_task` removes the mark. Dask's own limit (``allowed-failures``) is not enough: the limit is the
    same for the whole cluster, and also counts workers that were lost before they started the task.
    """
    from distributed import Event, get_client

    client = get_client()
    for life in range(task_id.lives):
        mark = Event(f"{task_id.name}-{life}", client)
        if not mark.is_set():
            break
    else:
        yield False
        return
    mark.set()
    try:
        yield True
    finally:
        mark.clear()


def _restore_sender_paths(text: str, sender_folders: Mapping[str, str]) -> str:
    """Replace folders of this worker in a text by the corresponding folders of the sender."""
    for own_folder, sender_folder in sender_folders.items():
        text = text.replace(own_folder, sender_folder)
    return text


def forget_task(task_id: TaskId, client: Client) -> None:
    """Remove the marks of a task, stored at the Dask scheduler, that count the workers lost while they ran the task."""
    from distributed import Event

    for life in range(task_id.lives):
        Event(f"{task_id.name}-{life}", client).clear()


def close_job(key: str) -> None:
    """Close the simulators of a job on this worker, and remove the job's files."""
    with _LOCK:
        job_state = _JOB_STATES.pop(key, None)
    if job_state is not None:
        job_state.close()
