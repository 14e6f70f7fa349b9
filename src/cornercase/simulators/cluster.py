"""Run scenarios on the workers of a Dask cluster."""

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

# How often Dask may lose a task before a worker has started it.
_MOST_GIVEN_UP: Final = 5
# Time limit in s to close the simulators on the workers; a scheduler that is cut off never answers.
_CLOSES: Final = 10.0


@dataclass(frozen=True)
class _Task:
    """Scenarios of one Dask task, their attempt, and how often Dask lost the task before it started."""

    indices: tuple[int, ...]
    attempt: Attempt
    given_up: int = 0


class ClusterSimulator(SimulatorElsewhere):
    """Runs concrete scenarios on the workers of a Dask cluster.

    Each worker creates the simulator once, like `create_simulator` on a single machine. The content of the scenario
    files is sent, not their paths. If workers offer a resource with the simulator's name (``--resources "carla=1"``),
    only they get scenarios, and no more at a time than they offer. Results do not depend on the number of workers.

    `cluster` is ``"local"`` for `workers` processes on this machine, a scheduler's address (``"tcp://10.0.0.1:8786"``)
    or file, or a client that stays open. `timeout` is in s per scenario. A scenario is run `retries` times more if its
    worker was lost; `max_failures` consecutive losses end the run (0: no limit). Raises `InputError` if the simulator
    cannot be created, Dask is not installed, or there is no such cluster.
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
        # A dependency of Dask; it also pickles classes that are defined in a notebook.
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
        # Resource that restricts scenarios to some workers.
        self._bound: str | None = None
        # Futures that other threads wait for.
        self._given: WeakSet[Future[Any]] = WeakSet()

    def require_means(self, scenario: Scenario) -> None:
        """Refuse a scenario that the simulator does not support or whose files cannot be sent."""
        super().require_means(scenario)
        ScenarioParcel.of(scenario)

    def run(self, concretes: Sequence[ConcreteScenario]) -> Iterator[Outcome]:
        """Run scenarios, as `Simulator.run`; `InputError` also if the workers cannot run it or the cluster is lost."""
        if not concretes:
            return
        slots, resources = self._slots()
        size = -(-len(concretes) // slots) if self._batches else 1
        indices = range(len(concretes))
        waiting = deque(self._task(tuple(indices[k : k + size])) for k in indices[::size])
        running: dict[Future[Any], _Task] = {}
        done: dict[int, Outcome] = {}
        n_yielded = 0
        try:
            while n_yielded < len(concretes):
                while waiting:
                    task = waiting.popleft()
                    running[self._submit(task, concretes, resources)] = task
                for future in ended(self._client, list(running), next(iter(resources), None)):
                    self._take(future, running.pop(future), waiting, done)
                while n_yielded in done:
                    yield done.pop(n_yielded)
                    n_yielded += 1
        except (OSError, CancelledError) as error:
            raise disconnected(self._client) from error
        finally:
            if running and self._client.status == "running":
                self._client.cancel(list(running))

    def beside(self) -> Sequence[Simulator]:
        """Return this simulator once per slot of the current workers; `InputError` if there are none."""
        return [self] * self._slots()[0]

    def give_up(self) -> None:
        """Cancel what other threads wait for; started tasks are not awaited."""
        # RuntimeError: another thread adds a future meanwhile; the caller repeats the call.
        with suppress(OSError, CancelledError, TimeoutError, RuntimeError):
            if self._client.status == "running":
                self._client.cancel(list(self._given))

    def close(self) -> None:
        """Close the simulators on the workers, and disconnect; a local cluster ends."""
        super().close()
        # A lost cluster has nothing to close.
        with suppress(OSError, CancelledError, TimeoutError):
            if self._client.status == "running":
                client: Any = self._client
                client.sync(client._run, close_job, self._job.key, on_error="ignore", callback_timeout=_CLOSES)
        if self._owned:
            leave(self._client)

    def _slots(self) -> tuple[int, dict[str, float]]:
        """Number of tasks that may run at once, and the worker resources that each takes."""
        resource = self.name.partition(":")[0]
        workers = workers_of(self._client, self._bound)
        if offered := sum(int(worker["resources"].get(resource, 0.0)) for worker in workers):
            # Remembered even if all these workers are lost: others may lack what the resource stands for.
            self._bound = resource
            return offered, {resource: 1.0}
        return len(workers) if self._batches else sum(worker["nthreads"] for worker in workers), {}

    def _task(self, indices: tuple[int, ...]) -> _Task:
        # After losing a worker, a batch is split into single scenarios with one life less each.
        lives = self._retries + 1 if len(indices) == 1 else 1
        return _Task(indices, Attempt(f"cornercase-{uuid.uuid4().hex}", lives))

    def _submit(self, task: _Task, concretes: Sequence[ConcreteScenario], resources: dict[str, float]) -> Future[Any]:
        groups = [
            (self._sent(concrete.scenario()), concrete.values) for concrete in (concretes[k] for k in task.indices)
        ]
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
        """Future of a scenario's bundle on the cluster; sent again if its worker was lost."""
        key = scenario.fingerprint() + str(scenario.path)
        if key not in self._parcels or self._parcels[key][1].status not in ("pending", "finished"):
            parcel = ScenarioParcel.of(scenario)
            future = self._client.submit(hand_over, parcel, key=f"cornercase-parcel-{uuid.uuid4().hex}", pure=False)
            self._parcels[key] = parcel, future
        return self._parcels[key][1]

    def _take(self, future: Future[Any], task: _Task, waiting: deque[_Task], done: dict[int, Outcome]) -> None:
        from distributed.scheduler import KilledWorker

        ran, error = take(self._client, future)
        if error is None:
            self._settle(ran, task, waiting, done)
        elif isinstance(error, InputError):
            raise error
        elif not isinstance(error, KilledWorker):
            text = " ".join(f"{type(error).__name__}: {error}".split())[:300]
            raise InputError(
                f"`cluster` {name_cluster(self._client)}: its workers cannot run '{self.name}' ({text}); install the"
                " same versions on each as here."
            ) from error
        elif task.given_up + 1 < _MOST_GIVEN_UP:
            # Dask also counts workers that were lost before they started the task; the attempt stays the same.
            waiting.appendleft(replace(task, given_up=task.given_up + 1))
        else:
            raise self._broken("its workers end before they start a scenario")

    def _settle(self, found: Ran | None, task: _Task, waiting: deque[_Task], done: dict[int, Outcome]) -> None:
        if found is not None:
            self._lost = 0
            self.notice(found.noticed)
            done |= dict(zip(task.indices, found.outcomes, strict=True))
            return
        forget(task.attempt, self._client)
        if len(task.indices) > 1:
            # It is unknown which scenario of the batch is at fault.
            tasks = [self._task((k,)) for k in reversed(task.indices)]
            lives = max(1, self._retries)
            waiting.extendleft(replace(single, attempt=replace(single.attempt, lives=lives)) for single in tasks)
        else:
            self._lost += 1
            if 0 < self._max_failures <= self._lost:
                raise self._broken(f"workers were lost in {self._lost} scenarios in a row (`max_failures`)")
            count_text = "one worker was" if self._retries == 0 else f"{self._retries + 1} workers were"
            done[task.indices[0]] = LostError(f"{count_text} lost while running the scenario")

    def _broken(self, what: str) -> InputError:
        return InputError(
            f"`cluster` {name_cluster(self._client)}: {what}; fix the cause, and run the same command again to resume."
        )
