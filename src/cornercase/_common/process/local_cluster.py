"""A Dask cluster on this machine that no other user can connect to."""

from __future__ import annotations

import logging
from typing import Any, Final

from distributed import Nanny, Scheduler, SpecCluster, Worker
from distributed.security import Security
from distributed.worker_memory import parse_memory_limit

from cornercase._common.current_folder import isolate_children
from cornercase._common.errors import InputError
from cornercase._common.optional_packages import describe_install
from cornercase._common.process.reaper import Reaper

_HOST: Final = "127.0.0.1"


class _NoWebPages:
    """Mixin for Dask's servers that turns off their web pages."""

    def start_http_server(self, *_: object, **__: object) -> None:
        pass


class LocalScheduler(_NoWebPages, Scheduler):
    """Scheduler of a local cluster."""


class LocalWorker(_NoWebPages, Worker):
    """Worker of a local cluster."""


def start_local_cluster(n_workers: int, reaper: Reaper) -> SpecCluster:
    """Start a local cluster: the scheduler in this process, and each worker in a child process.

    Scheduler, workers and client accept only connections with a temporary certificate of this cluster. `reaper` ends
    the workers when this process ends. RuntimeError if a worker dies while it starts.
    """

    class ReapedNanny(Nanny):
        """Dask object that starts its worker again if it dies; `reaper` ends the worker together with this process."""

        async def instantiate(self) -> Any:
            with reaper.watch_new_processes(), isolate_children():
                return await super().instantiate()

    try:
        security = Security.temporary()
    except ImportError as error:
        raise InputError(
            f"`cluster` local: needs the package cryptography, of the extra 'cluster'; {describe_install('cluster')}."
        ) from error
    shared_options = {"host": _HOST, "protocol": "tls://", "security": security}
    memory_limit = parse_memory_limit("auto", 1, n_workers, logger=logging.getLogger(__name__))
    worker = {
        "cls": ReapedNanny,
        "options": {
            **shared_options,
            "worker_class": LocalWorker,
            "nthreads": 1,
            "memory_limit": memory_limit,
            "silence_logs": logging.CRITICAL,
        },
    }
    return SpecCluster(
        workers=dict.fromkeys(range(n_workers), worker),
        # Port 0: any free port.
        scheduler={"cls": LocalScheduler, "options": {**shared_options, "port": 0, "dashboard": False}},
        worker=worker,
        security=security,
        silence_logs=logging.CRITICAL,
    )
