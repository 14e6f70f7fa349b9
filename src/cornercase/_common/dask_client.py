"""Connections with a Dask cluster."""

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
"""The cluster that is started on this machine."""

# s in which a scheduler has to answer, for which a cluster may be without workers, and between two looks at both.
_ANSWERS, _FIRST_WORKER, _LOOKS = 20.0, 120.0, 1.0
# s for which one says goodbye to a scheduler that may be cut off.
_CLOSES: Final = 10.0
# How often a local cluster is started whose workers are ended meanwhile.
_STARTS: Final = 5
# Those of clusters whose start was interrupted.
_UNENDED: Final[list[Guardian]] = []
# What has to be closed after the connection with a local cluster.
_HELD: Final[WeakKeyDictionary[Any, ExitStack]] = WeakKeyDictionary()


def cluster_argument(cluster: object) -> str | Client:
    """Take a cluster that was given as an argument.

    Parameters
    ----------
    cluster : object

    Returns
    -------
    str or distributed.Client

    Raises
    ------
    InputError
        It is neither.
    """
    # Who has a client has loaded Dask.
    dask = sys.modules.get("distributed")
    if dask is not None and isinstance(cluster, dask.Client):
        client: Client = cluster
        return client
    return text("cluster", cluster)


def require_client(client: object) -> None:
    """Refuse what is no connection with a Dask cluster.

    Parameters
    ----------
    client : object

    Raises
    ------
    InputError
        It is none.
    """
    if isinstance(cluster_argument(client), str):
        raise InputError(f"`client` {client}: give a distributed.Client, of pip install 'cornercase[cluster]'.")


def connect(cluster: str | Client, workers: int = 1) -> Client:
    """Connect with a Dask cluster.

    Parameters
    ----------
    cluster : str or distributed.Client
        ``"local"``, the address of a scheduler, the file that a scheduler wrote, or a connection that there is already.
    workers : int, default 1
        Processes of a local cluster; any other has its own.

    Returns
    -------
    distributed.Client
        To be left with `leave`, unless it is the one that was given.

    Raises
    ------
    InputError
        Dask is not installed, no scheduler answers, or `workers` are given for a cluster that has its own.
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
    there = Path(cluster).is_file()
    if cluster != LOCAL and not there and ":" not in cluster:
        raise InputError(
            f"`cluster` {cluster}: there is no such file, so no scheduler answers there; give 'local', an address such"
            " as tcp://host:8786, or the file that a scheduler wrote."
        )
    # What of it concerns a user is told by cornercase.
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    logging.getLogger("asyncio").addFilter(_concerns_others)
    if cluster == LOCAL:
        return _begin_here(workers)
    try:
        address = str(json.loads(read_file(cluster))["address"] if there else cluster)
        _require_certificates(cluster, address)
        _require_answer(address)
        return Client(address, timeout=_ANSWERS)
    except InputError:
        raise
    # Another program's answer is taken for the length of a message.
    except (OSError, ValueError, TypeError, KeyError, RecursionError, MemoryError) as error:
        raise InputError(
            f"`cluster` {cluster}: no scheduler answers there ({type(error).__name__}); give 'local', an address such"
            " as tcp://host:8786, or the file that a scheduler wrote."
        ) from error


def _require_certificates(cluster: str, address: str) -> None:
    from distributed.security import Security

    if address.startswith("tls://") and Security().get_connection_args("client")["ssl_context"] is None:
        raise InputError(
            f"`cluster` {cluster}: its scheduler asks for a certificate; name yours by the environment variables"
            " DASK_DISTRIBUTED__COMM__TLS__CA_FILE, …__TLS__CLIENT__CERT and …__TLS__CLIENT__KEY."
        )


def _require_answer(address: str) -> None:
    """Wait for the first words of a scheduler; a client would wait without end for those of another program."""
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
    """Whether a record of asyncio is of something else than a connection of Dask that was lost."""
    from distributed.comm.core import CommClosedError

    return not (record.exc_info and isinstance(record.exc_info[1], CommClosedError))


def _begin_here(workers: int) -> Client:
    """Start a cluster of processes on this machine, and connect with it."""
    import dask
    from distributed import Client

    # A worker that is being started anew as this time is over would be given up for good.
    dask.config.set({"distributed.deploy.lost-worker-timeout": "1 day"})
    guardian = Guardian()
    with ExitStack() as stack:
        stack.push(lambda kind, *_: _leave_guardian(guardian, kind))
        # Simulators may run in processes of their own, which daemons cannot have, nor may a worker that is started
        # again be one.
        own = {"distributed.worker.daemon": False, "temporary-directory": str(guardian.new_folder())}
        stack.enter_context(dask.config.set(own))
        with interrupts_kept():
            cluster = _started_cluster(workers, guardian)
            begun = stack.enter_context(ExitStack())
            begun.callback(cluster.close)
            client = Client(cluster)
            begun.callback(client.close)
        _register(client, _part_of_this_process())
        begun.pop_all()
        _HELD[client] = stack.pop_all()
    return client


def _leave_guardian(guardian: Guardian, kind: type[BaseException] | None) -> None:
    if kind is not None and not issubclass(kind, Exception):
        # Threads of Dask go on with what they had begun until this process ends, and so does the guardian.
        _UNENDED.append(guardian)
    else:
        guardian.close()


def _started_cluster(workers: int, guardian: Guardian) -> SpecCluster:
    from cornercase._common.local_cluster import start

    for tries in range(_STARTS):
        try:
            return start(workers, guardian)
        except KeyboardInterrupt:
            # What was being started fails now, one by one, which asyncio would tell.
            logging.getLogger("asyncio").setLevel(logging.CRITICAL)
            raise
        except RuntimeError as error:
            if tries + 1 == _STARTS:
                raise InputError(
                    f"`cluster` {LOCAL}: its workers end as they start ({error}); fix the cause, and run"
                    " the same command again."
                ) from error
    raise AssertionError


def _register(client: Client, plugin: WorkerPlugin) -> None:
    for tries in range(_STARTS):
        try:
            client.register_plugin(plugin)
            return
        except OSError as error:
            # Also where only a worker was ended while it was told.
            if tries + 1 == _STARTS or client.status != "running":
                raise disconnected(client) from error


def _part_of_this_process() -> WorkerPlugin:
    """What makes workers leave Ctrl-C to the process that ends them, and temporary files where it removes them."""
    from distributed import WorkerPlugin

    class PartOfAnotherProcess(WorkerPlugin):
        name = "cornercase"

        def setup(self, worker: Any) -> None:
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            keep_temporary_files_in(Path(worker.local_directory))

    return PartOfAnotherProcess()


def leave(client: Client) -> None:
    """Close a connection; a local cluster ends with it.

    Parameters
    ----------
    client : distributed.Client
    """
    local: Any = client.cluster
    with ExitStack() as stack:
        if local is not None:
            # What is interrupted while it ends Dask waits for in vain, for 10 s, when this process ends.
            stack.enter_context(interrupts_kept())
        # One that is lost has nothing to be closed.
        with suppress(OSError, TimeoutError):
            client.close(timeout=_CLOSES)
        if local is not None:
            local.close()
        if (held := _HELD.pop(client, None)) is not None:
            held.close()


@contextmanager
def connected(cluster: str | Client | None, workers: int = 1, *, else_none: bool = False) -> Iterator[Client | None]:
    """Be connected with a Dask cluster for as long as the block lasts.

    Parameters
    ----------
    cluster : str, distributed.Client or None
        As `connect` takes it; None for no cluster. A connection that is given stays open.
    workers : int, default 1
        Processes of a local cluster.
    else_none : bool, default False
        Whether there are no such processes without a cluster, so that saying how many is a mistake.

    Yields
    ------
    distributed.Client or None

    Raises
    ------
    InputError
        As by `connect`.
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
    """Say in messages which cluster it is.

    Parameters
    ----------
    client : distributed.Client

    Returns
    -------
    str
        ``"tcp://10.0.0.1:8786"``, or ``"local"``.
    """
    if client.cluster is not None:
        return LOCAL
    known: Any = client.scheduler
    return str(known.address) if known is not None else "of Dask"


def workers_of(client: Client, resource: str | None = None) -> list[dict[str, Any]]:
    """Wait until a cluster has workers, and tell of them.

    Parameters
    ----------
    client : distributed.Client
    resource : str, optional
        Only workers that offer it.

    Returns
    -------
    list of dict
        At least one, as `distributed.Client.scheduler_info` tells of them: ``"nthreads"``, ``"resources"``, and more.

    Raises
    ------
    InputError
        There are none for two minutes, or the scheduler is lost.
    """
    since = time.monotonic()
    while time.monotonic() - since <= _FIRST_WORKER:
        try:
            with suppress(TimeoutError):
                client.wait_for_workers(1, timeout=_FIRST_WORKER)
            # One that has come may be lost before it is told of.
            if found := _offering(client, resource):
                return found
        except OSError as error:
            raise disconnected(client) from error
        time.sleep(_LOOKS)
    raise _without_workers(client, resource)


def _offering(client: Client, resource: str | None) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = list(client.scheduler_info(n_workers=-1)["workers"].values())
    return [one for one in found if resource is None or one["resources"].get(resource, 0.0) >= 1.0]


def ended(client: Client, running: Collection[Future[Any]], resource: str | None = None) -> list[Future[Any]]:
    """Wait for the first tasks that have ended.

    Parameters
    ----------
    client : distributed.Client
    running : collection of distributed.Future
        At least one.
    resource : str, optional
        What of a worker each of them takes.

    Returns
    -------
    list of distributed.Future
        At least one, with a result or an error.

    Raises
    ------
    InputError
        The scheduler is lost, or there are no workers for two minutes.
    """
    from distributed import wait

    since = time.monotonic()
    while True:
        # What was lost after it had ended is run again by Dask.
        found = [one for one in running if one.status not in ("pending", "lost")]
        if client.status != "running" or any(one.status == "cancelled" for one in found):
            raise disconnected(client)
        if found:
            return found
        try:
            wait(list(running), timeout=_LOOKS, return_when="FIRST_COMPLETED")
        except TimeoutError:
            if _offering(client, resource):
                since = time.monotonic()
            elif time.monotonic() - since > _FIRST_WORKER:
                raise _without_workers(client, resource) from None


def take(client: Client, future: Future[Any]) -> tuple[Any, Exception | None]:
    """Take what came of a task, and let go of it.

    Dask runs a task again whose result was on a lost worker, for as long as somebody asks for it.

    Parameters
    ----------
    client : distributed.Client
    future : distributed.Future
        One that has ended.

    Returns
    -------
    result : object
        None where there is an error.
    error : Exception or None
        Raised by the task, or `distributed.scheduler.KilledWorker`.

    Raises
    ------
    InputError
        The scheduler is lost.
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
    """Say that a scheduler is gone.

    Parameters
    ----------
    client : distributed.Client

    Returns
    -------
    InputError
        To be raised.
    """
    return InputError(
        f"`cluster` {name_cluster(client)}: the connection to its scheduler is lost; run the same command again to go"
        " on."
    )
