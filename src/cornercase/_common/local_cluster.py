"""A Dask cluster on this machine, to which nobody else can connect."""

from __future__ import annotations

import logging
from typing import Any, Final

from distributed import Nanny, Scheduler, SpecCluster, Worker
from distributed.security import Security
from distributed.worker_memory import parse_memory_limit

from cornercase._common.current_folder import kept_from_children
from cornercase._common.errors import InputError
from cornercase._common.guardian import Guardian

_HOST: Final = "127.0.0.1"


class _WithoutPages:
    """Has none of the pages that Dask otherwise serves to everybody on the machine, not even an empty one."""

    def start_http_server(self, *_: object, **__: object) -> None:
        pass


class LocalScheduler(_WithoutPages, Scheduler):
    """Gives tasks to the workers of a local cluster."""


class LocalWorker(_WithoutPages, Worker):
    """Runs tasks of a local cluster."""


def start(workers: int, guardian: Guardian) -> SpecCluster:
    """Start a scheduler in this process, and workers in others.

    They, and the client of this process, accept only each other: by a certificate that is made here, and known to
    nobody else.

    Parameters
    ----------
    workers : int
    guardian : Guardian
        Ends the workers with this process.

    Returns
    -------
    distributed.SpecCluster

    Raises
    ------
    InputError
        The package is missing that makes certificates.
    RuntimeError
        A worker was ended as it started.
    """

    class GuardedNanny(Nanny):
        """Starts a worker, and another one where it was ended, which are ended with this process."""

        async def instantiate(self) -> Any:
            with guardian.watch_all(), kept_from_children():
                return await super().instantiate()

    try:
        security = Security.temporary()
    except ImportError as error:
        raise InputError(
            "`cluster` local: needs the package cryptography; it comes with pip install 'cornercase[cluster]'."
        ) from error
    common = {"host": _HOST, "protocol": "tls://", "security": security}
    memory = parse_memory_limit("auto", 1, workers, logger=logging.getLogger(__name__))
    worker = {
        "cls": GuardedNanny,
        "options": {
            **common,
            "worker_class": LocalWorker,
            "nthreads": 1,
            "memory_limit": memory,
            "silence_logs": logging.CRITICAL,
        },
    }
    return SpecCluster(
        workers=dict.fromkeys(range(workers), worker),
        # Only a free port is none that somebody else may want.
        scheduler={"cls": LocalScheduler, "options": {**common, "port": 0, "dashboard": False}},
        worker=worker,
        security=security,
        silence_logs=logging.CRITICAL,
    )
