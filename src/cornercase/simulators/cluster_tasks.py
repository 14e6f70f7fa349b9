"""Code that runs on the workers of a cluster: holds simulators and scenario files, and runs scenarios."""

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
from cornercase._common.texts import in_one_line
from cornercase._common.version import __version__
from cornercase.scenario import ConcreteScenario, Scenario, ScenarioParcel, Value
from cornercase.simulators.base import Simulator
from cornercase.simulators.outcomes import Outcome, outcomes_as_given
from cornercase.simulators.registry import SIMULATORS
from cornercase.simulators.worker_process import unpickled_options
from cornercase.simulators.workers import MOST_FAILURES, WorkerSimulator

if TYPE_CHECKING:
    from distributed import Client


@dataclass(frozen=True)
class Job:
    """Simulator and settings of one exploration or suite; `version` is that of the sender, `timeout` in s.

    `options` are pickled, since the scheduler may not know the user's driver classes.
    """

    key: str
    version: str
    simulator: str
    options: bytes
    timeout: float | None
    retries: int
    max_failures: int = MOST_FAILURES


@dataclass(frozen=True)
class Attempt:
    """Identifies scenarios that run together; at most `lives` workers may start them before they are given up."""

    name: str
    lives: int


@dataclass(frozen=True)
class Ran:
    """Results of scenarios in order, and sentences for the user."""

    outcomes: list[Outcome]
    noticed: list[str]


class _Site:
    """Simulators and files of one job in this process; each simulator is used by one thread at a time."""

    def __init__(self, job: Job) -> None:
        self._job = job
        try:
            self._options = unpickled_options(job.options)
        except Exception as error:
            raise InputError(
                f"`cluster`: a worker cannot load a driver of your own ({in_one_line(error)}); install its module on"
                " each worker, or start the workers in its folder."
            ) from error
        self._free: list[int] = []
        self._made: list[Simulator] = []
        self._change = Condition()
        declared = SIMULATORS.class_of(job.simulator)
        self._numbered = "worker" in declared.needs
        # An in-process simulator uses all cores of this process.
        self._here = declared.in_process and job.timeout is None
        self._folders: dict[str, TemporaryDirectory[str]] = {}
        self._scenarios: dict[str, Scenario] = {}

    @contextmanager
    def simulator(self) -> Iterator[Simulator]:
        with self._change:
            while self._here and self._made and not self._free:
                self._change.wait()
            if not self._free:
                self._made.append(self._new(len(self._made)))
                heapq.heappush(self._free, len(self._made) - 1)
            number = heapq.heappop(self._free)
        try:
            yield self._made[number]
        finally:
            with self._change:
                heapq.heappush(self._free, number)
                self._change.notify()

    def _new(self, number: int) -> Simulator:
        job = self._job
        options = self._options | ({"worker": number} if self._numbered else {})
        if self._here:
            return SIMULATORS.create(job.simulator, **options)
        if current_process().daemon:
            raise InputError(
                "`cluster`: its workers may not start processes; set DASK_DISTRIBUTED__WORKER__DAEMON=False when you"
                " start them."
            )
        return WorkerSimulator(job.simulator, options, 1, job.timeout, job.retries, job.max_failures)

    def unpacked(self, key: str, parcel: ScenarioParcel) -> tuple[Scenario, Path]:
        from distributed import get_worker

        with self._change:
            if key not in self._scenarios:
                # In the worker's folder, which Dask removes if this process cannot.
                worker_folder = get_worker().local_directory
                folder = TemporaryDirectory(prefix="cornercase-", dir=worker_folder, ignore_cleanup_errors=True)
                self._scenarios[key] = parcel.unpack(Path(folder.name))
                self._folders[key] = folder
            return self._scenarios[key], Path(self._folders[key].name)

    def close(self) -> None:
        for simulator in self._made:
            simulator.close()
        for folder in self._folders.values():
            folder.cleanup()


_SITES: Final[dict[str, _Site]] = {}
_LOCK: Final = Lock()


def hand_over(parcel: ScenarioParcel) -> ScenarioParcel:
    """Return the bundle: a task that puts it on the cluster."""
    return parcel


def run_job(
    job: Job,
    attempt: Attempt,
    parcels: Mapping[str, ScenarioParcel],
    scenarios: Sequence[tuple[str, Mapping[str, Value]]],
) -> Ran | None:
    """Run scenarios, given as bundle key and values, in this process or a child process that it keeps.

    Returns None if too many workers were lost with them. Raises `InputError` for another version of cornercase, or if
    no scenario can be run.
    """
    if job.version != __version__:
        raise InputError(
            f"`cluster`: a worker has cornercase {__version__}, this machine has {job.version}; install the same."
        )
    with _LOCK:
        site = _SITES[job.key] if job.key in _SITES else _SITES.setdefault(job.key, _Site(job))
    unpacked = {key: site.unpacked(key, parcel) for key, parcel in parcels.items()}
    concretes = [ConcreteScenario(unpacked[key][0].path, values, unpacked[key][0]) for key, values in scenarios]
    sender_folders = {str(unpacked[key][1]): parcel.folder for key, parcel in parcels.items()}
    with _begun(attempt) as may_run:
        if not may_run:
            return None
        try:
            with site.simulator() as simulator:
                noticed = list[str]()
                simulator.on_notice = noticed.append
                results = list(outcomes_as_given(simulator, concretes))
        except InputError as error:
            raise InputError(_with_own_paths(str(error), sender_folders)) from None
    outcomes = [
        type(result)(_with_own_paths(str(result), sender_folders)) if isinstance(result, SimulationError) else result
        for result in results
    ]
    return Ran(outcomes, noticed)


@contextmanager
def _begun(attempt: Attempt) -> Iterator[bool]:
    """Mark an attempt as started at the scheduler while it runs; yield whether it may start.

    The mark of a lost worker stays, so the next one knows; `forget_attempt` removes them. Dask also counts lost workers
    per task (``allowed-failures``), but with one limit for the whole cluster, and including those that had not started
    it.
    """
    from distributed import Event, get_client

    client = get_client()
    for life in range(attempt.lives):
        mark = Event(f"{attempt.name}-{life}", client)
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


def _with_own_paths(words: str, places: Mapping[str, str]) -> str:
    """Replace local folders in a text by the folders of the sender."""
    for own_folder, sender_folder in places.items():
        words = words.replace(own_folder, sender_folder)
    return words


def forget(attempt: Attempt, client: Client) -> None:
    """Remove the marks that lost workers have left of an attempt."""
    from distributed import Event

    for life in range(attempt.lives):
        Event(f"{attempt.name}-{life}", client).clear()


def close_job(key: str) -> None:
    """Close the simulators and remove the files of a job."""
    with _LOCK:
        site = _SITES.pop(key, None)
    if site is not None:
        site.close()
