"""Simulator that runs scenarios on the workers of a Dask cluster."""

from __future__ import annotations

import uuid
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final
from weakref import WeakSet

from cornercase._common.errors import InputError, RunLostError
from cornercase._common.process.dask import (
    WORKER_TIMEOUT,
    connect,
    describe_cluster,
    disconnect,
    pop_result,
    scheduler_gone_error,
    wait_for_any_task,
    wait_for_workers,
)
from cornercase._common.version import __version__
from cornercase.scenario import ConcreteScenario
from cornercase.scenario._bundle import ScenarioBundle
from cornercase.scenario._file import ScenarioFile
from cornercase.simulators._base import Simulator
from cornercase.simulators._option_pickling import pickle_simulator
from cornercase.simulators._remote import RemoteSimulator
from cornercase.simulators._results import Outcome
from cornercase.simulators._run_options import DEFAULT_MAX_FAILURES
from cornercase.simulators.dask._worker import (
    BatchResult,
    SimulatorSetup,
    TaskId,
    close_job,
    forget_task,
    return_bundle,
    run_scenarios_of_job,
)

if TYPE_CHECKING:
    from distributed import Client, Future

# How often Dask may lose a task before a worker has started it.
_MAX_TASK_LOSSES: Final = 5
# Time limit in s to close the simulators on the workers; a scheduler that is cut off never answers.
_CLOSE_TIMEOUT: Final = 10.0


@dataclass(frozen=True)
class _ClusterTask:
    """Scenarios of one Dask task, identifier of the task, and how often workers were lost before it started."""

    indices: tuple[int, ...]
    task_id: TaskId
    n_lost: int = 0


class ClusterSimulator(RemoteSimulator):
    """Simulator on a Dask cluster: each worker has its own instance and copies of the scenario files.

    If workers offer a resource with the simulator's name (``--resources "carla=1"``), only these workers get scenarios,
    at most as many at a time as the amount of the resource. `cluster` is ``"local"`` for `workers` processes on this
    machine, a scheduler's address or file, or a client that stays open. If a worker is lost, its scenario is run again,
    up to `retries` times; the scenarios of a batch are run again one by one, at least once. The run ends after
    `max_failures` consecutive scenarios that lost their workers (0: no limit), and when the cluster has had no workers
    for `worker_timeout` s.
    """

    def __init__(
        self,
        name: str | type[Simulator],
        options: dict[str, Any],
        cluster: str | Client,
        workers: int = 1,
        timeout: float | None = None,
        retries: int = 1,
        max_failures: int = DEFAULT_MAX_FAILURES,
        worker_timeout: float = WORKER_TIMEOUT,
    ) -> None:
        super().__init__(name, options)
        self._max_failures, self._worker_timeout = max_failures, worker_timeout
        self._batched = self.simulator_class.batched
        self._sent_bundles: dict[str, tuple[ScenarioBundle, Future[Any]]] = {}
        self._client = connect(cluster, workers)
        self._owns_client = self._client is not cluster
        self._job = SimulatorSetup(
            uuid.uuid4().hex,
            __version__,
            self.name,
            pickle_simulator(name, options),
            timeout,
            retries,
            max_failures,
        )
        self._retries, self._n_consecutive_losses = retries, 0
        # Resource that restricts scenarios to some workers.
        self._required_resource: str | None = None
        # Futures that other threads wait for.
        self._submitted_futures: WeakSet[Future[Any]] = WeakSet()

    def check_supported(self, scenario: ScenarioFile) -> None:
        """Raise `InputError` if the simulator does not support a scenario, or the scenario's files cannot be sent."""
        super().check_supported(scenario)
        ScenarioBundle.from_file(scenario)

    def run(self, concretes: Sequence[ConcreteScenario]) -> Iterator[Outcome]:
        """Run scenarios like `Simulator.run`; also raise `InputError` if the cluster is lost or unusable."""
        if not concretes:
            return
        slots, resources = self._count_slots()
        size = -(-len(concretes) // slots) if self._batched else 1
        indices = range(len(concretes))
        waiting = deque(self._make_task(tuple(indices[k : k + size])) for k in indices[::size])
        running: dict[Future[Any], _ClusterTask] = {}
        done: dict[int, Outcome] = {}
        n_yielded = 0
        try:
            while n_yielded < len(concretes):
                while waiting:
                    task = waiting.popleft()
                    running[self._submit_task(task, concretes, resources)] = task
                resource = next(iter(resources), None)
                for future in wait_for_any_task(self._client, list(running), resource, self._worker_timeout):
                    self._collect_result(future, running.pop(future), waiting, done)
                while n_yielded in done:
                    yield done.pop(n_yielded)
                    n_yielded += 1
        except (OSError, CancelledError) as error:
            raise scheduler_gone_error(self._client) from error
        finally:
            if running and self._client.status == "running":
                self._client.cancel(list(running))

    def parallel_instances(self) -> Sequence[Simulator]:
        """Return this simulator once for each unit of the resource that workers offer; `InputError` if no worker comes.

        If no resource is used: once for each thread of a worker, or once for each worker if the simulator runs batches.
        """
        return [self] * self._count_slots()[0]

    def cancel(self) -> None:
        """Cancel the tasks for which other threads wait; tasks that run already continue, but give no result."""
        # RuntimeError: another thread adds a future meanwhile; the caller repeats the call.
        with suppress(OSError, CancelledError, TimeoutError, RuntimeError):
            if self._client.status == "running":
                self._client.cancel(list(self._submitted_futures))

    def close(self) -> None:
        """Close the simulators on the workers, and disconnect from the cluster; a local cluster is ended."""
        super().close()
        # A lost cluster has nothing to close.
        with suppress(OSError, CancelledError, TimeoutError):
            if self._client.status == "running":
                client: Any = self._client
                client.sync(client._run, close_job, self._job.key, on_error="ignore", callback_timeout=_CLOSE_TIMEOUT)
        if self._owns_client:
            disconnect(self._client)

    def _count_slots(self) -> tuple[int, dict[str, float]]:
        """Return the number of tasks that can run at a time, and the worker resources that each task requires."""
        resource = self.name.partition(":")[0]
        workers = wait_for_workers(self._client, self._required_resource, self._worker_timeout)
        if offered := sum(int(worker["resources"].get(resource, 0.0)) for worker in workers):
            # Remembered even if all these workers are lost: others may lack what the resource stands for.
            self._required_resource = resource
            return offered, {resource: 1.0}
        return len(workers) if self._batched else sum(worker["nthreads"] for worker in workers), {}

    def _make_task(self, indices: tuple[int, ...]) -> _ClusterTask:
        # After losing a worker, a batch is split into single scenarios with one life less each.
        lives = self._retries + 1 if len(indices) == 1 else 1
        return _ClusterTask(indices, TaskId(f"cornercase-{uuid.uuid4().hex}", lives))

    def _submit_task(
        self, task: _ClusterTask, concretes: Sequence[ConcreteScenario], resources: dict[str, float]
    ) -> Future[Any]:
        chosen = [concretes[k] for k in task.indices]
        sent = [self._send_bundle(concrete.load_file()) for concrete in chosen]
        future = self._client.submit(
            run_scenarios_of_job,
            self._job,
            task.task_id,
            {bundle.key: bundle for bundle in sent},
            [(bundle.key, dict(concrete.values), concrete.seed) for bundle, concrete in zip(sent, chosen, strict=True)],
            key=f"{task.task_id.name}-{task.n_lost}",
            pure=False,
            resources=resources or None,
        )
        self._submitted_futures.add(future)
        return future

    def _send_bundle(self, scenario: ScenarioFile) -> Future[Any]:
        """Return a Dask future of the bundle (all files) of a scenario, and send the bundle if the cluster lacks it.

        A bundle is sent only once, unless the worker that stored it was lost.
        """
        key = scenario.fingerprint() + str(scenario.path)
        if key not in self._sent_bundles or self._sent_bundles[key][1].status not in ("pending", "finished"):
            bundle = ScenarioBundle.from_file(scenario)
            future = self._client.submit(return_bundle, bundle, key=f"cornercase-parcel-{uuid.uuid4().hex}", pure=False)
            self._sent_bundles[key] = bundle, future
        return self._sent_bundles[key][1]

    def _collect_result(
        self, future: Future[Any], task: _ClusterTask, waiting: deque[_ClusterTask], done: dict[int, Outcome]
    ) -> None:
        from distributed.scheduler import KilledWorker

        result, error = pop_result(self._client, future)
        if error is None:
            self._record_or_retry(result, task, waiting, done)
        elif isinstance(error, InputError):
            raise error
        elif not isinstance(error, KilledWorker):
            text = " ".join(f"{type(error).__name__}: {error}".split())[:300]
            raise InputError(
                f"`cluster` {describe_cluster(self._client)}: its workers cannot run '{self.name}' ({text}); install"
                " the same versions of all packages on each worker as on this machine."
            ) from error
        elif task.n_lost + 1 < _MAX_TASK_LOSSES:
            # Dask also counts workers that were lost before they started the task; the identifier stays the same.
            waiting.appendleft(replace(task, n_lost=task.n_lost + 1))
        else:
            raise self._cluster_error("its workers end before they start a scenario")

    def _record_or_retry(
        self, result: BatchResult | None, task: _ClusterTask, waiting: deque[_ClusterTask], done: dict[int, Outcome]
    ) -> None:
        if result is not None:
            self._n_consecutive_losses = 0
            self.notify(result.notices)
            done |= dict(zip(task.indices, result.outcomes, strict=True))
            return
        forget_task(task.task_id, self._client)
        if len(task.indices) > 1:
            # It is unknown which scenario of the batch is at fault.
            tasks = [self._make_task((k,)) for k in reversed(task.indices)]
            lives = max(1, self._retries)
            waiting.extendleft(replace(single, task_id=replace(single.task_id, lives=lives)) for single in tasks)
        else:
            self._n_consecutive_losses += 1
            if 0 < self._max_failures <= self._n_consecutive_losses:
                raise self._cluster_error(
                    f"workers were lost in {self._n_consecutive_losses} scenarios in a row (`max_failures`)"
                )
            count_text = "one worker was" if self._retries == 0 else f"{self._retries + 1} workers were"
            done[task.indices[0]] = RunLostError(f"{count_text} lost while running the scenario")

    def _cluster_error(self, problem: str) -> InputError:
        return InputError(
            f"`cluster` {describe_cluster(self._client)}: {problem}; fix the cause, and run the"
            f" same command again to resume."
        )
