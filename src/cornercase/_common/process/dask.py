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

from cornercase._common.errors import InputError
from cornercase._common.io.files import read_file
from cornercase._common.optional_packages import describe_install
from cornercase._common.platform import block_interrupts
from cornercase._common.process.parent_death import set_temporary_folder
from cornercase._common.process.reaper import Reaper
from cornercase._common.validation import check_int, check_str

if TYPE_CHECKING:
    from distributed import Client, Future, SpecCluster, WorkerPlugin

LOCAL_CLUSTER: Final = "local"
"""Name of a cluster that is started on this machine."""

WORKER_TIMEOUT: Final = 120.0
"""Time in s that a cluster may have no workers."""
# Seconds: timeout of a scheduler's answer, interval between checks.
_ANSWER_TIMEOUT, _POLL_INTERVAL = 20.0, 1.0
# Seconds to close a connection to a scheduler that may be unreachable.
_CLOSE_TIMEOUT: Final = 10.0
# Attempts to start a local cluster whose workers die.
_MAX_START_ATTEMPTS: Final = 5
# Reapers of clusters whose start was interrupted.
_INTERRUPTED_REAPERS: Final[list[Reaper]] = []
# Resources to close after the connection to a local cluster.
_LOCAL_RESOURCES: Final[WeakKeyDictionary[Any, ExitStack]] = WeakKeyDictionary()


def check_cluster(cluster: object) -> str | Client:
    """Return the argument `cluster` as address, file name or client; `InputError` for anything else."""
    # A client can exist only if Dask was imported.
    dask = sys.modules.get("distributed")
    if dask is not None and isinstance(cluster, dask.Client):
        client: Client = cluster
        return client
    return check_str("cluster", cluster)


def check_client(client: object) -> None:
    """Raise `InputError` unless the argument `client` is a `distributed.Client`."""
    if isinstance(check_cluster(client), str):
        raise InputError(f"`client` {client}: give a distributed.Client; {describe_install('cluster')}.")


def connect(cluster: str | Client, workers: int = 1, answer_timeout: float = _ANSWER_TIMEOUT) -> Client:
    """Connect to a Dask cluster: ``"local"`` (started here), an address, a scheduler file, or a client.

    `InputError` if Dask is missing, no scheduler answers within `answer_timeout` s, or `workers` are given for a
    cluster that is not local.
    """
    cluster = check_cluster(cluster)
    if workers > 1 and cluster != LOCAL_CLUSTER:
        raise InputError("`workers`: the cluster itself says how many workers it has; leave out `workers`.")
    if not isinstance(cluster, str):
        return cluster
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError(f"Dask is not installed; {describe_install('cluster')}.") from error
    is_file = Path(cluster).is_file()
    if cluster != LOCAL_CLUSTER and not is_file and ":" not in cluster:
        raise InputError(
            f"`cluster` {cluster}: is not a file, and no scheduler answers at this address; give 'local', an address"
            " such"
            " as tcp://host:8786, or the file that a scheduler wrote."
        )
    # cornercase reports what users have to know.
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    logging.getLogger("asyncio").addFilter(_is_not_lost_connection)
    if cluster == LOCAL_CLUSTER:
        return _start_local_cluster(workers)
    try:
        address = str(json.loads(read_file(cluster))["address"] if is_file else cluster)
        _check_certificates(cluster, address)
        _check_scheduler_answers(address, answer_timeout)
        return Client(address, timeout=answer_timeout)
    except InputError:
        raise
    # An answer of another program may be read as the length of a message.
    except (OSError, ValueError, TypeError, KeyError, RecursionError, MemoryError) as error:
        raise InputError(
            f"`cluster` {cluster}: no scheduler answers ({type(error).__name__}); give 'local', an address such"
            " as tcp://host:8786, or the file that a scheduler wrote."
        ) from error


def _check_certificates(cluster: str, address: str) -> None:
    from distributed.security import Security

    if address.startswith("tls://") and Security().get_connection_args("client")["ssl_context"] is None:
        raise InputError(
            f"`cluster` {cluster}: the scheduler requires a certificate; set the environment variables"
            " DASK_DISTRIBUTED__COMM__TLS__CA_FILE, …__TLS__CLIENT__CERT and …__TLS__CLIENT__KEY."
        )


def _check_scheduler_answers(address: str, timeout: float) -> None:
    """Raise an error unless a Dask scheduler answers at the address within `timeout` s.

    Without an answer, this is an `OSError`; an answer of another program raises other errors. `connect` turns all of
    them into `InputError`. If another program listens at the address, a client would wait forever.
    """
    from distributed.comm.core import connect as greet
    from distributed.security import Security
    from distributed.utils import LoopRunner, sync

    async def connect_and_close() -> None:
        line = await greet(address, timeout=timeout, **Security().get_connection_args("client"))
        line.abort()

    runner = LoopRunner()
    runner.start()
    try:
        sync(runner.loop, connect_and_close, callback_timeout=timeout)
    finally:
        runner.stop()


def _is_not_lost_connection(record: logging.LogRecord) -> bool:
    """Return False for asyncio's log records about lost Dask connections, so that a logging filter drops them."""
    from distributed.comm.core import CommClosedError

    return not (record.exc_info and isinstance(record.exc_info[1], CommClosedError))


def _start_local_cluster(workers: int) -> Client:
    """Start a cluster of processes on this machine, and connect to it."""
    import dask
    from distributed import Client

    # A worker that is being restarted when this time is over would be given up for good.
    dask.config.set({"distributed.deploy.lost-worker-timeout": "1 day"})
    reaper = Reaper()
    with ExitStack() as stack:
        stack.push(lambda kind, *_: _close_reaper(reaper, kind))
        # Simulators may have child processes, which daemons cannot have; a worker may be restarted, so it is no daemon.
        settings = {"distributed.worker.daemon": False, "temporary-directory": str(reaper.make_temporary_folder())}
        stack.enter_context(dask.config.set(settings))
        with block_interrupts():
            cluster = _start_cluster_with_retries(workers, reaper)
            connection = stack.enter_context(ExitStack())
            connection.callback(cluster.close)
            client = Client(cluster)
            connection.callback(client.close)
        _register_plugin(client, _child_process_plugin())
        connection.pop_all()
        _LOCAL_RESOURCES[client] = stack.pop_all()
    return client


def _close_reaper(reaper: Reaper, exception_type: type[BaseException] | None) -> None:
    if exception_type is not None and not issubclass(exception_type, Exception):
        # Dask's threads continue until this process ends, and so does the reaper.
        _INTERRUPTED_REAPERS.append(reaper)
    else:
        reaper.close()


def _start_cluster_with_retries(workers: int, reaper: Reaper) -> SpecCluster:
    from cornercase._common.process.local_cluster import start_local_cluster

    for attempt in range(_MAX_START_ATTEMPTS):
        try:
            return start_local_cluster(workers, reaper)
        except KeyboardInterrupt:
            # asyncio would log that each pending start fails.
            logging.getLogger("asyncio").setLevel(logging.CRITICAL)
            raise
        except RuntimeError as error:
            if attempt + 1 == _MAX_START_ATTEMPTS:
                raise InputError(
                    f"`cluster` {LOCAL_CLUSTER}: the workers die while they start ({error}); fix the cause, and run"
                    " the same command again."
                ) from error
    raise AssertionError


def _register_plugin(client: Client, plugin: WorkerPlugin) -> None:
    for attempt in range(_MAX_START_ATTEMPTS):
        try:
            client.register_plugin(plugin)
            return
        except OSError as error:
            # Also raised if only a worker was killed meanwhile.
            if attempt + 1 == _MAX_START_ATTEMPTS or client.status != "running":
                raise scheduler_gone_error(client) from error


def _child_process_plugin() -> WorkerPlugin:
    """Return a Dask plugin that makes workers ignore Ctrl-C and use a temporary folder that the parent removes."""
    from distributed import WorkerPlugin

    class ChildProcessPlugin(WorkerPlugin):
        name = "cornercase"

        def setup(self, worker: Any) -> None:
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            set_temporary_folder(Path(worker.local_directory))

    return ChildProcessPlugin()


def disconnect(client: Client) -> None:
    """Close a client; if it belongs to a local cluster, close the cluster, too."""
    local_cluster: Any = client.cluster
    with ExitStack() as stack:
        if local_cluster is not None:
            # If an interrupt stops the shutdown, Dask waits for it in vain, for 10 s, when this process ends.
            stack.enter_context(block_interrupts())
        # A lost connection needs no closing.
        with suppress(OSError, TimeoutError):
            client.close(timeout=_CLOSE_TIMEOUT)
        if local_cluster is not None:
            local_cluster.close()
        if (resources := _LOCAL_RESOURCES.pop(client, None)) is not None:
            resources.close()


@contextmanager
def open_connection(
    cluster: str | Client | None, workers: int = 1, *, workers_need_cluster: bool = False
) -> Iterator[Client | None]:
    """Connect to a Dask cluster during the block and yield the client; yield None if `cluster` is None.

    If `cluster` is a client, it stays open. With `workers_need_cluster`, more than one worker without a cluster is an
    `InputError`.
    """
    workers = check_int("workers", workers, 1)
    if cluster is None:
        if workers_need_cluster and workers > 1:
            raise InputError("`workers`: needs a local cluster; give `cluster` 'local' too.")
        yield None
        return
    client = connect(cluster, workers)
    try:
        yield client
    finally:
        if client is not cluster:
            disconnect(client)


def describe_cluster(client: Client) -> str:
    """Return the name of the cluster for messages: its address, or ``"local"``."""
    if client.cluster is not None:
        return LOCAL_CLUSTER
    scheduler: Any = client.scheduler
    return str(scheduler.address) if scheduler is not None else "of Dask"


def wait_for_workers(
    client: Client, resource: str | None = None, timeout: float = WORKER_TIMEOUT
) -> list[dict[str, Any]]:
    """Wait up to `timeout` s for workers, and return their entries in `Client.scheduler_info`.

    If `resource` is given, only workers that offer this resource count.
    """
    start = time.monotonic()
    while time.monotonic() - start <= timeout:
        try:
            with suppress(TimeoutError):
                client.wait_for_workers(1, timeout=timeout)
            # A worker may be lost again before it is listed.
            if workers := _workers_with_resource(client, resource):
                return workers
        except OSError as error:
            raise scheduler_gone_error(client) from error
        time.sleep(_POLL_INTERVAL)
    raise _no_workers_error(client, resource)


def _workers_with_resource(client: Client, resource: str | None) -> list[dict[str, Any]]:
    workers: list[dict[str, Any]] = list(client.scheduler_info(n_workers=-1)["workers"].values())
    return [worker for worker in workers if resource is None or worker["resources"].get(resource, 0.0) >= 1.0]


def wait_for_any_task(
    client: Client, futures: Collection[Future[Any]], resource: str | None = None, timeout: float = WORKER_TIMEOUT
) -> list[Future[Any]]:
    """Wait until at least one task has ended, and return all ended tasks.

    `InputError` if there are no workers for `timeout` s, or if the scheduler is lost. If `resource` is given, only
    workers that offer this resource count.
    """
    from distributed import wait

    last_seen = time.monotonic()
    while True:
        # Dask reruns tasks whose finished result was lost.
        finished = [future for future in futures if future.status not in ("pending", "lost")]
        if client.status != "running" or any(future.status == "cancelled" for future in finished):
            raise scheduler_gone_error(client)
        if finished:
            return finished
        try:
            wait(list(futures), timeout=_POLL_INTERVAL, return_when="FIRST_COMPLETED")
        except TimeoutError:
            if _workers_with_resource(client, resource):
                last_seen = time.monotonic()
            elif time.monotonic() - last_seen > timeout:
                raise _no_workers_error(client, resource) from None


def pop_result(client: Client, future: Future[Any]) -> tuple[Any, Exception | None]:
    """Return the result and the exception of a finished task (one of the two is None), and release the task.

    A task that is not released would be run again if the worker that holds its result died.
    """
    try:
        return future.result(), None
    except CancelledError as error:
        raise scheduler_gone_error(client) from error
    except Exception as error:
        if client.status != "running":
            raise scheduler_gone_error(client) from error
        return None, error
    finally:
        future.release()


def _no_workers_error(client: Client, resource: str | None) -> InputError:
    which = "" if resource is None else f" that offer {resource}"
    return InputError(
        f"`cluster` {describe_cluster(client)}: has no workers{which}; start some, and run the same"
        f" command again to go on."
    )


def scheduler_gone_error(client: Client) -> InputError:
    """Return the `InputError` that says that the connection to the scheduler is lost."""
    return InputError(
        f"`cluster` {describe_cluster(client)}: the connection to its scheduler is lost; run the"
        f" same command again to go"
        " on."
    )
