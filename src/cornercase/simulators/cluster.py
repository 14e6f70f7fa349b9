"""Simulations on the workers of a Dask cluster."""

from __future__ import annotations

import uuid
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final
from weakref import WeakSet

from cornercase._common.dask_client import connect, disconnected, ended, leave, name_cluster, take, workers_of
from cornercase._common.errors import InputError, LostError
from cornercase._common.version import __version__
from cornercase.scenario import ConcreteScenario, Scenario, ScenarioParcel
from cornercase.simulators.base import Simulator
from cornercase.simulators.cluster_tasks import Attempt, Job, Ran, close_job, forget, hand_over, run_job
from cornercase.simulators.elsewhere import SimulatorElsewhere
from cornercase.simulators.outcomes import Outcome
from cornercase.simulators.sending import packed_options
from cornercase.simulators.workers import MOST_FAILURES

if TYPE_CHECKING:
    from distributed import Client, Future

# How often Dask may give a scenario up before a worker has begun it.
_MOST_GIVEN_UP: Final = 5
# s that workers have to end their simulators; a scheduler that is cut off never answers.
_CLOSES: Final = 10.0


@dataclass(frozen=True)
class _Task:
    """Scenarios that are run together, what is known of their workers, and how often Dask gave them up."""

    indices: tuple[int, ...]
    attempt: Attempt
    given_up: int = 0


class ClusterSimulator(SimulatorElsewhere):
    """Runs concrete scenarios on the workers of a Dask cluster.

    Each worker makes the simulator once, as `start_simulator` does on one machine. The content of the scenario's files
    is sent, not their paths. Where workers offer a resource that is called like the simulator (``--resources
    "carla=1"``), only they get scenarios, and never more at a time than they offer. Results are the same for any
    number of workers.

    Parameters
    ----------
    name : str
        Registered simulator.
    options : dict
        What to make it with; has to be picklable.
    cluster : str or distributed.Client
        ``"local"`` for processes on this machine, the address of a scheduler (``"tcp://10.0.0.1:8786"``), the file
        that a scheduler wrote, or a connection that stays open.
    workers : int, default 1
        Processes of a local cluster; any other has its own.
    timeout : float, optional
        s after which a scenario is given up.
    retries : int, default 1
        How often a scenario is run again after the simulator failed, or after its worker was lost.
    max_failures : int, default 5
        Scenarios in a row that cost their workers, after which the simulator is not tried any more; 0 for no limit.

    Raises
    ------
    InputError
        The simulator cannot be made so, Dask is not installed, or there is no such cluster.
    """

    def __init__(
        self,
        name: str,
        options: dict[str, Any],
        cluster: str | Client,
        workers: int = 1,
        timeout: float | None = None,
        retries: int = 1,
        max_failures: int = MOST_FAILURES,
    ) -> None:
        super().__init__(name, options)
        self._max_failures = max_failures
        self._batches = self.declared.takes_batches
        self._parcels: dict[str, tuple[ScenarioParcel, Future[Any]]] = {}
        self._client = connect(cluster, workers)
        self._owned = self._client is not cluster
        # It comes with Dask, and takes classes of a notebook along.
        import cloudpickle

        self._job = Job(
            uuid.uuid4().hex,
            __version__,
            name,
            packed_options(options, cloudpickle.dumps),
            timeout,
            retries,
            max_failures,
        )
        self._retries, self._lost = retries, 0
        # The resource that its workers offer.
        self._bound: str | None = None
        # What other threads wait for.
        self._given: WeakSet[Future[Any]] = WeakSet()

    def require_means(self, scenario: Scenario) -> None:
        """Let the simulator refuse a scenario that it cannot run, and refuse one that cannot be sent.

        Parameters
        ----------
        scenario : Scenario

        Raises
        ------
        InputError
            It lacks what the scenario asks for, or its files are not beside each other.
        """
        super().require_means(scenario)
        ScenarioParcel.of(scenario)

    def run(self, concretes: Sequence[ConcreteScenario]) -> Iterator[Outcome]:
        """Run scenarios.

        Parameters
        ----------
        concretes : sequence of ConcreteScenario

        Yields
        ------
        Recording or SimulationError
            One for each scenario, in order.

        Raises
        ------
        InputError
            The scenario file cannot be used, the workers cannot run the simulator, or the cluster is lost.
        """
        if not concretes:
            return
        slots, resources = self._slots()
        size = -(-len(concretes) // slots) if self._batches else 1
        every = range(len(concretes))
        waiting = deque(self._task(tuple(every[k : k + size])) for k in every[::size])
        running: dict[Future[Any], _Task] = {}
        done: dict[int, Outcome] = {}
        given = 0
        try:
            while given < len(concretes):
                while waiting:
                    task = waiting.popleft()
                    running[self._submit(task, concretes, resources)] = task
                for future in ended(self._client, list(running), next(iter(resources), None)):
                    self._take(future, running.pop(future), waiting, done)
                while given in done:
                    yield done.pop(given)
                    given += 1
        except (OSError, CancelledError) as error:
            raise disconnected(self._client) from error
        finally:
            if running and self._client.status == "running":
                self._client.cancel(list(running))

    def beside(self) -> Sequence[Simulator]:
        """Give this simulator as often as the workers that are there now can run a scenario.

        Returns
        -------
        sequence of ClusterSimulator

        Raises
        ------
        InputError
            There are no workers.
        """
        return [self] * self._slots()[0]

    def give_up(self) -> None:
        """End all waiting in other threads; what workers have begun is not waited for."""
        # Another thread may add to them meanwhile; it is asked for again.
        with suppress(OSError, CancelledError, TimeoutError, RuntimeError):
            if self._client.status == "running":
                self._client.cancel(list(self._given))

    def close(self) -> None:
        """End the simulators on the workers, and leave the cluster; a local one ends."""
        super().close()
        # A cluster that is lost has nothing to be closed.
        with suppress(OSError, CancelledError, TimeoutError):
            if self._client.status == "running":
                client: Any = self._client
                client.sync(client._run, close_job, self._job.key, on_error="ignore", callback_timeout=_CLOSES)
        if self._owned:
            leave(self._client)

    def _slots(self) -> tuple[int, dict[str, float]]:
        """How many tasks may run at once, and what each takes of a worker's resources."""
        kind = self.name.partition(":")[0]
        workers = workers_of(self._client, self._bound)
        if offered := sum(int(worker["resources"].get(kind, 0.0)) for worker in workers):
            # Also after all who offer it were lost: others may lack what it stands for.
            self._bound = kind
            return offered, {kind: 1.0}
        return len(workers) if self._batches else sum(worker["nthreads"] for worker in workers), {}

    def _task(self, indices: tuple[int, ...]) -> _Task:
        # A batch that has cost one worker is run one by one, and each of its scenarios has one life less.
        lives = self._retries + 1 if len(indices) == 1 else 1
        return _Task(indices, Attempt(f"cornercase-{uuid.uuid4().hex}", lives))

    def _submit(self, task: _Task, concretes: Sequence[ConcreteScenario], resources: dict[str, float]) -> Future[Any]:
        groups = [(self._sent(one.scenario()), one.values) for one in (concretes[k] for k in task.indices)]
        parcels = dict.fromkeys(parcel for parcel, _ in groups)
        future = self._client.submit(
            run_job,
            self._job,
            task.attempt,
            {parcel.key: parcel for parcel in parcels},
            [(parcel.key, dict(values)) for parcel, values in groups],
            key=f"{task.attempt.name}-{task.given_up}",
            pure=False,
            resources=resources or None,
        )
        self._given.add(future)
        return future

    def _sent(self, scenario: Scenario) -> Future[Any]:
        """The parcel of a scenario as a result of the cluster, made again where the worker that holds it is lost."""
        known = scenario.fingerprint() + str(scenario.path)
        if known not in self._parcels or self._parcels[known][1].status not in ("pending", "finished"):
            parcel = ScenarioParcel.of(scenario)
            future = self._client.submit(hand_over, parcel, key=f"cornercase-parcel-{uuid.uuid4().hex}", pure=False)
            self._parcels[known] = parcel, future
        return self._parcels[known][1]

    def _take(self, future: Future[Any], task: _Task, waiting: deque[_Task], done: dict[int, Outcome]) -> None:
        from distributed.scheduler import KilledWorker

        found, error = take(self._client, future)
        if error is None:
            self._settle(found, task, waiting, done)
        elif isinstance(error, InputError):
            raise error
        elif not isinstance(error, KilledWorker):
            words = " ".join(f"{type(error).__name__}: {error}".split())[:300]
            raise InputError(
                f"`cluster` {name_cluster(self._client)}: its workers cannot run '{self.name}' ({words}); install the"
                " same versions on each as here."
            ) from error
        elif task.given_up + 1 < _MOST_GIVEN_UP:
            # Dask counts workers too that were lost before they began; what is known of the attempt goes on to hold.
            waiting.appendleft(replace(task, given_up=task.given_up + 1))
        else:
            raise self._broken("its workers end before they have begun a scenario")

    def _settle(self, found: Ran | None, task: _Task, waiting: deque[_Task], done: dict[int, Outcome]) -> None:
        if found is not None:
            self._lost = 0
            self.notice(found.noticed)
            done |= dict(zip(task.indices, found.outcomes, strict=True))
            return
        forget(task.attempt, self._client)
        if len(task.indices) > 1:
            # What has happened to a batch says nothing of any one of its scenarios.
            ones = [self._task((k,)) for k in reversed(task.indices)]
            fewer = max(1, self._retries)
            waiting.extendleft(replace(one, attempt=replace(one.attempt, lives=fewer)) for one in ones)
        else:
            self._lost += 1
            if 0 < self._max_failures <= self._lost:
                raise self._broken(f"workers were lost in {self._lost} scenarios in a row (`max_failures`)")
            each = "one worker was" if self._retries == 0 else f"{self._retries + 1} workers were"
            done[task.indices[0]] = LostError(f"{each} lost while running the scenario")

    def _broken(self, what: str) -> InputError:
        return InputError(
            f"`cluster` {name_cluster(self._client)}: {what}; fix the cause, and run the same command again to go on."
        )
