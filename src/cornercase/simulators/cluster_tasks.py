"""What the workers of a cluster do: they keep simulators and scenario files, and run scenarios."""

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
    """What runs the scenarios of one exploration or suite.

    Attributes
    ----------
    key : str
        Different for each.
    version : str
        Of the cornercase that asks.
    simulator : str
    options : bytes
        What to make it with, pickled: a driver of one's own may not be known where this passes by.
    timeout : float or None
        s for each scenario.
    retries : int
    max_failures : int
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
    """What is counted of scenarios that are run together.

    Attributes
    ----------
    name : str
        Different for each.
    lives : int
        How many workers may begin them; where all of these were lost, no other one does.
    """

    name: str
    lives: int


@dataclass(frozen=True)
class Ran:
    """What came of scenarios.

    Attributes
    ----------
    outcomes : list of Recording or SimulationError
        One for each, in order.
    noticed : list of str
        Sentences for whoever runs them, as `Simulator.notice` takes them.
    """

    outcomes: list[Outcome]
    noticed: list[str]


class _Site:
    """Simulators and files of one job in this process, each simulator used by one thread at a time."""

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
        # One in this process has all of its cores to itself.
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
                "`cluster`: its workers may not start processes; set DASK_DISTRIBUTED__WORKER__DAEMON=False where they"
                " are started."
            )
        return WorkerSimulator(job.simulator, options, 1, job.timeout, job.retries, job.max_failures)

    def unpacked(self, key: str, parcel: ScenarioParcel) -> tuple[Scenario, Path]:
        from distributed import get_worker

        with self._change:
            if key not in self._scenarios:
                # Of the worker, since Dask removes its folder when it could not do so itself.
                place = get_worker().local_directory
                folder = TemporaryDirectory(prefix="cornercase-", dir=place, ignore_cleanup_errors=True)
                self._scenarios[key] = parcel.unpack(Path(folder.name))
                self._folders[key] = folder
            return self._scenarios[key], Path(self._folders[key].name)

    def close(self) -> None:
        for one in self._made:
            one.close()
        for folder in self._folders.values():
            folder.cleanup()


_SITES: Final[dict[str, _Site]] = {}
_LOCK: Final = Lock()


def hand_over(parcel: ScenarioParcel) -> ScenarioParcel:
    """Be the task that gives a parcel.

    Parameters
    ----------
    parcel : ScenarioParcel

    Returns
    -------
    ScenarioParcel
    """
    return parcel


def run_job(
    job: Job,
    attempt: Attempt,
    parcels: Mapping[str, ScenarioParcel],
    scenarios: Sequence[tuple[str, Mapping[str, Value]]],
) -> Ran | None:
    """Run scenarios in this process, or in one that it keeps.

    Parameters
    ----------
    job : Job
    attempt : Attempt
    parcels : mapping of str to ScenarioParcel
    scenarios : sequence of (str, mapping of str to float or str)
        The parcel of each, and its values.

    Returns
    -------
    Ran or None
        None where too many workers were lost with them.

    Raises
    ------
    InputError
        This process has another version of cornercase, or none of the scenarios can be run.
    """
    if job.version != __version__:
        raise InputError(
            f"`cluster`: a worker has cornercase {__version__}, and this is {job.version}; install the same on each."
        )
    with _LOCK:
        site = _SITES[job.key] if job.key in _SITES else _SITES.setdefault(job.key, _Site(job))
    here = {key: site.unpacked(key, parcel) for key, parcel in parcels.items()}
    concretes = [ConcreteScenario(here[key][0].path, values, here[key][0]) for key, values in scenarios]
    places = {str(here[key][1]): parcel.folder for key, parcel in parcels.items()}
    with _begun(attempt) as may_run:
        if not may_run:
            return None
        try:
            with site.simulator() as simulator:
                noticed = list[str]()
                simulator.on_notice = noticed.append
                found = list(outcomes_as_given(simulator, concretes))
        except InputError as error:
            raise InputError(_with_own_paths(str(error), places)) from None
    outcomes = [
        type(one)(_with_own_paths(str(one), places)) if isinstance(one, SimulationError) else one for one in found
    ]
    return Ran(outcomes, noticed)


@contextmanager
def _begun(attempt: Attempt) -> Iterator[bool]:
    """Note at the scheduler that an attempt begins, for as long as it lasts, and say whether it may.

    A worker that is lost leaves its note, so that the next one knows; `forget` takes them away. Dask itself counts lost
    workers for each task too (``allowed-failures``), but with one bound for the whole cluster, and also those that had
    not begun it.
    """
    from distributed import Event, get_client

    client = get_client()
    for life in range(attempt.lives):
        note = Event(f"{attempt.name}-{life}", client)
        if not note.is_set():
            break
    else:
        yield False
        return
    note.set()
    try:
        yield True
    finally:
        note.clear()


def _with_own_paths(words: str, places: Mapping[str, str]) -> str:
    """Name files as they are called where the scenarios come from."""
    for here, there in places.items():
        words = words.replace(here, there)
    return words


def forget(attempt: Attempt, client: Client) -> None:
    """Take away what lost workers have left of an attempt.

    Parameters
    ----------
    attempt : Attempt
    client : distributed.Client
    """
    from distributed import Event

    for life in range(attempt.lives):
        Event(f"{attempt.name}-{life}", client).clear()


def close_job(key: str) -> None:
    """End what was kept for a job.

    Parameters
    ----------
    key : str
        Its key.
    """
    with _LOCK:
        site = _SITES.pop(key, None)
    if site is not None:
        site.close()
