"""Simulations on the workers of a Dask cluster."""

from __future__ import annotations

import json
import logging
import uuid
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from cornercase._common.errors import InputError, SimulationError
from cornercase._common.files import read_file
from cornercase._common.version import __version__
from cornercase.scenario import ConcreteScenario, Scenario, ScenarioParcel
from cornercase.simulators.cluster_tasks import Job, close_job, hand_over, run_job
from cornercase.simulators.elsewhere import SimulatorElsewhere
from cornercase.simulators.outcomes import Outcome

if TYPE_CHECKING:
    from distributed import Client, Future

LOCAL: Final = "local"
# s in which a scheduler has to answer, in which a first worker has to be there, and between two looks at it.
_ANSWERS, _FIRST_WORKER, _LOOKS = 20.0, 120.0, 1.0
# If so many scenarios in a row cost their workers, the simulator is at fault, not they.
_MOST_LOST: Final = 5


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
    cluster : str
        ``"local"`` for processes on this machine, the address of a scheduler (``"tcp://10.0.0.1:8786"``), or the file
        that a scheduler wrote.
    workers : int, default 1
        Processes of a local cluster; any other has its own.
    timeout : float, optional
        s after which a scenario is given up.
    retries : int, default 1
        How often a scenario is run again after the simulator failed.

    Raises
    ------
    InputError
        The simulator cannot be made so, Dask is not installed, or there is no such cluster.
    """

    def __init__(
        self,
        name: str,
        options: dict[str, Any],
        cluster: str,
        workers: int = 1,
        timeout: float | None = None,
        retries: int = 1,
    ) -> None:
        super().__init__(name, options)
        self._batches = self._declared.takes_batches
        self._parcels: dict[str, tuple[ScenarioParcel, Future[Any]]] = {}
        self._address = cluster
        self._client = connect(cluster, workers)
        # It comes with Dask, and takes classes of a notebook along.
        import cloudpickle

        self._job = Job(uuid.uuid4().hex, __version__, name, cloudpickle.dumps(options), timeout, retries)
        self._lost = 0

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
        waiting = deque(tuple(range(k, min(k + size, len(concretes)))) for k in range(0, len(concretes), size))
        running: dict[Future[Any], tuple[int, ...]] = {}
        done: dict[int, Outcome] = {}
        given = 0
        try:
            while given < len(concretes):
                while waiting:
                    indices = waiting.popleft()
                    running[self._submit([concretes[k] for k in indices], resources)] = indices
                for future in self._ended(running):
                    self._take(future, running.pop(future), waiting, done)
                while given in done:
                    yield done.pop(given)
                    given += 1
        except (OSError, CancelledError) as error:
            raise self._disconnected() from error
        finally:
            if running and self._client.status == "running":
                self._client.cancel(list(running))

    def close(self) -> None:
        """End the simulators on the workers, and leave the cluster; a local one ends."""
        super().close()
        # A cluster that is lost has nothing to be closed.
        with suppress(OSError, CancelledError, TimeoutError):
            if self._client.status == "running":
                self._client.run(close_job, self._job.key, on_error="ignore")
        # A local cluster is one of its own, and ends with it.
        local = self._client.cluster
        with suppress(OSError, CancelledError, TimeoutError):
            self._client.close()
        if local is not None:
            local.close()

    def _slots(self) -> tuple[int, dict[str, float]]:
        """How many tasks may run at once, and what each takes of a worker's resources."""
        try:
            self._client.wait_for_workers(1, timeout=_FIRST_WORKER)
            workers = self._client.scheduler_info(n_workers=-1)["workers"].values()
        except TimeoutError as error:
            raise InputError(
                f"`cluster` {self._address}: has no workers; start some, and run the same command again to go on."
            ) from error
        kind = self.name.partition(":")[0]
        offered = [worker["resources"].get(kind, 0.0) for worker in workers]
        if any(offered):
            return max(1, int(sum(offered))), {kind: 1.0}
        return len(offered) if self._batches else sum(worker["nthreads"] for worker in workers), {}

    def _submit(self, concretes: Sequence[ConcreteScenario], resources: dict[str, float]) -> Future[Any]:
        groups = [(self._sent(one.scenario()), one.values) for one in concretes]
        parcels = dict.fromkeys(parcel for parcel, _ in groups)
        return self._client.submit(
            run_job,
            self._job,
            {parcel.key: parcel for parcel in parcels},
            [(parcel.key, dict(values)) for parcel, values in groups],
            key=f"cornercase-{uuid.uuid4().hex}",
            pure=False,
            resources=resources or None,
        )

    def _sent(self, scenario: Scenario) -> Future[Any]:
        """The parcel of a scenario as a result of the cluster, made again where the worker that holds it is lost."""
        known = scenario.fingerprint() + str(scenario.path)
        if known not in self._parcels:
            parcel = ScenarioParcel.of(scenario)
            future = self._client.submit(hand_over, parcel, key=f"cornercase-parcel-{uuid.uuid4().hex}", pure=False)
            self._parcels[known] = parcel, future
        return self._parcels[known][1]

    def _ended(self, running: dict[Future[Any], tuple[int, ...]]) -> list[Future[Any]]:
        """Wait for the tasks that have ended."""
        from distributed import wait

        while True:
            ended = [future for future in running if future.status != "pending"]
            if self._client.status != "running" or any(future.status in ("cancelled", "lost") for future in ended):
                raise self._disconnected()
            if ended:
                return ended
            try:
                wait(list(running), timeout=_LOOKS, return_when="FIRST_COMPLETED")
            except TimeoutError:
                continue

    def _disconnected(self) -> InputError:
        return InputError(
            f"`cluster` {self._address}: the connection to its scheduler is lost; run the same command again to go on."
        )

    def _take(
        self, future: Future[Any], indices: tuple[int, ...], waiting: deque[tuple[int, ...]], done: dict[int, Outcome]
    ) -> None:
        from distributed.scheduler import KilledWorker

        error = future.exception()
        if error is None:
            self._lost = 0
            done |= dict(zip(indices, future.result(), strict=True))
        elif isinstance(error, InputError):
            raise error
        elif not isinstance(error, KilledWorker):
            words = " ".join(f"{type(error).__name__}: {error}".split())[:300]
            raise InputError(
                f"`cluster` {self._address}: its workers cannot run '{self.name}' ({words}); install the same versions"
                " on each as here."
            ) from error
        elif len(indices) > 1:
            # What has happened to a batch says nothing of any one of its scenarios.
            waiting.extendleft((k,) for k in reversed(indices))
        else:
            self._lost += 1
            if self._lost >= _MOST_LOST:
                raise InputError(
                    f"`cluster` {self._address}: workers were lost in {self._lost} scenarios in a row; mend what ends"
                    " them, and run the same command again to go on."
                )
            done[indices[0]] = SimulationError("each worker that ran the scenario was lost")


def connect(cluster: str, workers: int = 1) -> Client:
    """Connect with a Dask cluster.

    Parameters
    ----------
    cluster : str
        ``"local"``, the address of a scheduler, or the file that a scheduler wrote.
    workers : int, default 1
        Processes of a local cluster.

    Returns
    -------
    distributed.Client
        To be closed; its `cluster` is None unless it is local.

    Raises
    ------
    InputError
        Dask is not installed, or no scheduler answers.
    """
    try:
        import dask
        from distributed import Client, LocalCluster
    except ImportError as error:
        raise InputError("Dask is not installed; it comes with pip install 'cornercase[cluster]'.") from error
    # What of it concerns a user is told by cornercase.
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        if cluster == LOCAL:
            # Simulators may run in processes of their own, which daemons cannot have; and a scenario that costs two
            # workers is at fault.
            with dask.config.set({"distributed.worker.daemon": False, "distributed.scheduler.allowed-failures": 1}):
                local = LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    processes=True,
                    # Only a free port is none that somebody else may want.
                    dashboard_address="127.0.0.1:0",
                    silence_logs=logging.CRITICAL,
                )
                return Client(local)
        address = json.loads(read_file(cluster))["address"] if Path(cluster).is_file() else cluster
        return Client(str(address), timeout=_ANSWERS)
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise InputError(
            f"`cluster` {cluster}: no scheduler answers there ({type(error).__name__}); give 'local', an address such"
            " as tcp://host:8786, or the file that a scheduler wrote."
        ) from error
