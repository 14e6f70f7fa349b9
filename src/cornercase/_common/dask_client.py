"""Connect to a Dask cluster, wait for its workers, and fetch results of its tasks."""

from __future__ import annotations

import json
import logging
import signal
import sys
import time
from collections.abc import Collection, Iterator
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from weakref import WeakKeyDictionary

from cornercase._common.arguments import text
from cornercase._common.errors import InputError
from cornercase._common.files import read_file
from cornercase._common.guardian import Guardian
from cornercase._common.lifeline import keep_temporary_files_in
from cornercase._common.platform import interrupts_kept

if TYPE_CHECKING:
    from distributed import Client, Future, SpecCluster, WorkerPlugin

LOCAL: Final = "local"
"""Name of a cluster that is started on this machine."""

# Seconds: timeout of a scheduler's answer, time that a cluster may have no workers, interval between checks.
_ANSWERS, _FIRST_WORKER, _LOOKS = 20.0, 120.0, 1.0
# Seconds to close a connection to a scheduler that may be unreachable.
_CLOSES: Final = 10.0
# Attempts to start a local cluster whose workers die.
_STARTS: Final = 5
# Reapers of clusters whose start was interrupted.
_UNENDED: Final[list[Guardian]] = []
# What to close after the connection to a local cluster.
_HELD: Final[WeakKeyDictionary[Any, ExitStack]] = WeakKeyDictionary()


def cluster_argument(cluster: object) -> str | Client:
    """Return the argument `cluster` as address, file name or client; `InputError` for anything else."""
    # A client can exist only if Dask was imported.
    dask = sys.modules.get("distributed")
    if dask is not None and isinstance(cluster, dask.Client):
        client: Client = cluster
        return client
    return text("cluster", cluster)


def require_client(client: object) -> None:
    """Raise `InputError` unless the argument is a `distributed.Client`."""
    if isinstance(cluster_argument(client), str):
        raise InputError(f"`client` {client}: give a distributed.Client, of pip install 'cornercase[cluster]'.")


def connect(cluster: str | Client, workers: int = 1) -> Client:
    """Connect to a Dask cluster: ``"local"`` (started here), an address, a scheduler file, or a client.

    `InputError` if Dask is missing, no scheduler answers, or `workers` are given for a cluster that is not local.
    """
    cluster = cluster_argument(cluster)
    if workers > 1 and cluster != LOCAL:
        raise InputError("`workers`: the cluster has its own; leave it out.")
    if not isinstance(cluster, str):
        return cluster
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError("Dask is not installed; it comes with pip install 'cornercase[cluster]'.") from error
    is_file = Path(cluster).is_file()
    if cluster != LOCAL and not is_file and ":" not in cluster:
        raise InputError(
            f"`cluster` {cluster}: is no file, and no scheduler answers there; give 'local', an address such"
            " as tcp://host:8786, or the file that a scheduler wrote."
        )
    # cornercase reports what users have to know.
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    logging.getLogger("asyncio").addFilter(_concerns_others)
    if cluster == LOCAL:
        return _begin_here(workers)
    try:
        address = str(json.loads(read_file(cluster))["address"] if is_file else cluster)
        _require_certificates(cluster, address)
        _require_answer(address)
        return Client(address, timeout=_ANSWERS)
    except InputError:
        raise
    # An answer of another program may be read as the length of a message.
    except (OSError, ValueError, TypeError, KeyError, RecursionError, MemoryError) as error:
        raise InputError(
            f"`cluster` {cluster}: no scheduler answers there ({type(error).__name__}); give 'local', an address such"
            " as tcp://host:8786, or the file that a scheduler wrote."
        ) from error


def _require_certificates(cluster: str, address: str) -> None:
    from distributed.security import Security

    if address.startswith("tls://") and Security().get_connection_args("client")["ssl_context"] is None:
        raise InputError(
            f"`cluster` {cluster}: its scheduler requires a certificate; set the environment variables"
            " DASK_DISTRIBUTED__COMM__TLS__CA_FILE, …__TLS__CLIENT__CERT and …__TLS__CLIENT__KEY."
        )


def _require_answer(address: str) -> None:
    """Wait for the scheduler's handshake; a client would wait forever if another program listens there."""
    from distributed.comm.core import connect as greet
    from distributed.security import Security
    from distributed.utils import LoopRunner, sync

    async def greeted() -> None:
        line = await greet(address, timeout=_ANSWERS, **Security().get_connection_args("client"))
        line.abort()

    runner = LoopRunner()
    runner.start()
    try:
        sync(runner.loop, greeted, callback_timeout=_ANSWERS)
    finally:
        runner.stop()


def _concerns_others(record: logging.LogRecord) -> bool:
    """Logging filter: drop asyncio's records about lost Dask connections."""
    from distributed.comm.core import CommClosedError

    return not (record.exc_info and isinstance(record.exc_info[1], CommClosedError))


def _begin_here(workers: int) -> Client:
    """Start a cluster of processes on this machine, and connect to it."""
    import dask
    from distributed import Client

    # A worker that is being restarted when this time is over would be given up for good.
    dask.config.set({"distributed.deploy.lost-worker-timeout": "1 day"})
    guardian = Guardian()
    with ExitStack() as stack:
        stack.push(lambda kind, *_: _leave_guardian(guardian, kind))
        # Simulators may have child processes, which daemons cannot have; a worker may be restarted, so it is no daemon.
        settings = {"distributed.worker.daemon": False, "temporary-directory": str(guardian.new_folder())}
        stack.enter_context(dask.config.set(settings))
        with interrupts_kept():
            cluster = _started_cluster(workers, guardian)
            connection = stack.enter_context(ExitStack())
            connection.callback(cluster.close)
            client = Client(cluster)
            connection.callback(client.close)
        _register(client, _part_of_this_process())
        connection.pop_all()
        _HELD[client] = stack.pop_all()
    return client


def _leave_guardian(guardian: Guardian, kind: type[BaseException] | None) -> None:
    if kind is not None and not issubclass(kind, Exception):
        # Dask's threads continue until this process ends, and so does the reaper.
        _UNENDED.append(guardian)
    else:
        guardian.close()


def _started_cluster(workers: int, guardian: Guardian) -> SpecCluster:
    from cornercase._common.local_cluster import start

    for attempt in range(_STARTS):
        try:
            return start(workers, guardian)
        except KeyboardInterrupt:
            # asyncio would log that each pending start fails.
            logging.getLogger("asyncio").setLevel(logging.CRITICAL)
            raise
        except RuntimeError as error:
            if attempt + 1 == _STARTS:
                raise InputError(
                    f"`cluster` {LOCAL}: its workers die while they start ({error}); fix the cause, and run"
                    " the same command again."
                ) from error
    raise AssertionError


def _register(client: Client, plugin: WorkerPlugin) -> None:
    for attempt in range(_STARTS):
        try:
            client.register_plugin(plugin)
            return
        except OSError as error:
            # Also raised if only a worker was killed meanwhile.
            if attempt + 1 == _STARTS or client.status != "running":
                raise disconnected(client) from error


def _part_of_this_process() -> WorkerPlugin:
    """Plugin: workers ignore Ctrl-C, and put temporary files into a folder that the parent removes."""
    from distributed import WorkerPlugin

    class PartOfAnotherProcess(WorkerPlugin):
        name = "cornercase"

        def setup(self, worker: Any) -> None:
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            keep_temporary_files_in(Path(worker.local_directory))

    return PartOfAnotherProcess()


def leave(client: Client) -> None:
    """Close a connection, with a local cluster if it has one."""
    local_cluster: Any = client.cluster
    with ExitStack() as stack:
        if local_cluster is not None:
            # If an interrupt stops the shutdown, Dask waits for it in vain, for 10 s, when this process ends.
            stack.enter_context(interrupts_kept())
        # A lost connection needs no closing.
        with suppress(OSError, TimeoutError):
            client.close(timeout=_CLOSES)
        if local_cluster is not None:
            local_cluster.close()
        if (resources := _HELD.pop(client, None)) is not None:
            resources.close()


@contextmanager
def connected(cluster: str | Client | None, workers: int = 1, *, else_none: bool = False) -> Iterator[Client | None]:
    """Connect to a Dask cluster for the block, or yield None without `cluster`. A client that is given stays open.

    With `workers_need_cluster`, more than one worker without a cluster is an `InputError`.
    """
    if cluster is None:
        if else_none and workers > 1:
            raise InputError("`workers`: needs a local cluster; give `cluster` 'local' too.")
        yield None
        return
    client = connect(cluster, workers)
    try:
        yield client
    finally:
        if client is not cluster:
            leave(client)


def name_cluster(client: Client) -> str:
    """Name of the cluster in messages: its address, or ``"local"``."""
    if client.cluster is not None:
        return LOCAL
    scheduler: Any = client.scheduler
    return str(scheduler.address) if scheduler is not None else "of Dask"


def workers_of(client: Client, resource: str | None = None) -> list[dict[str, Any]]:
    """Wait up to two minutes for workers that offer `resource`; return their entries in `Client.scheduler_info`."""
    start = time.monotonic()
    while time.monotonic() - start <= _FIRST_WORKER:
        try:
            with suppress(TimeoutError):
                client.wait_for_workers(1, timeout=_FIRST_WORKER)
            # A worker may be lost again before it is listed.
            if workers := _offering(client, resource):
                return workers
        except OSError as error:
            raise disconnected(client) from error
        time.sleep(_LOOKS)
    raise _without_workers(client, resource)


def _offering(client: Client, resource: str | None) -> list[dict[str, Any]]:
    workers: list[dict[str, Any]] = list(client.scheduler_info(n_workers=-1)["workers"].values())
    return [worker for worker in workers if resource is None or worker["resources"].get(resource, 0.0) >= 1.0]


def ended(client: Client, running: Collection[Future[Any]], resource: str | None = None) -> list[Future[Any]]:
    """Wait until at least one task has ended, and return those that have; `InputError` without workers or scheduler."""
    from distributed import wait

    last_seen = time.monotonic()
    while True:
        # Dask reruns tasks whose finished result was lost.
        finished = [future for future in running if future.status not in ("pending", "lost")]
        if client.status != "running" or any(future.status == "cancelled" for future in finished):
            raise disconnected(client)
        if finished:
            return finished
        try:
            wait(list(running), timeout=_LOOKS, return_when="FIRST_COMPLETED")
        except TimeoutError:
            if _offering(client, resource):
                last_seen = time.monotonic()
            elif time.monotonic() - last_seen > _FIRST_WORKER:
                raise _without_workers(client, resource) from None


def take(client: Client, future: Future[Any]) -> tuple[Any, Exception | None]:
    """Return result and exception of a finished task (one is None), and release it.

    Dask would otherwise rerun a task whose result was on a worker that died.
    """
    try:
        return future.result(), None
    except CancelledError as error:
        raise disconnected(client) from error
    except Exception as error:
        if client.status != "running":
            raise disconnected(client) from error
        return None, error
    finally:
        future.release()


def _without_workers(client: Client, resource: str | None) -> InputError:
    which = "" if resource is None else f" that offer {resource}"
    return InputError(
        f"`cluster` {name_cluster(client)}: has no workers{which}; start some, and run the same command again to go on."
    )


def disconnected(client: Client) -> InputError:
    """The error that the connection to the scheduler is lost."""
    return InputError(
        f"`cluster` {name_cluster(client)}: the connection to its scheduler is lost; run the same command again to go"
        " on."
    )
