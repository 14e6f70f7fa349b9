"""Create a simulator from its name or an object, in this process or in worker processes."""

from __future__ import annotations

from collections.abc import Mapping
from multiprocessing import current_process
from typing import TYPE_CHECKING, Any

from cornercase._common.configurable import given_options
from cornercase._common.validation import check_float, check_int, check_str
from cornercase.drivers._serialization import user_driver_spec
from cornercase.simulators._base import Simulator, require_settings
from cornercase.simulators._common_options import select_declared_options
from cornercase.simulators._registry import SIMULATORS
from cornercase.simulators._run_options import DEFAULT_MAX_FAILURES, MAX_WORKERS
from cornercase.simulators.dask._simulator import ClusterSimulator
from cornercase.simulators.pool._simulator import WorkerSimulator

if TYPE_CHECKING:
    from distributed import Client


def create_simulator(
    simulator: str | Simulator,
    options: Mapping[str, Any] | None = None,
    *,
    ego: str = "Ego",
    workers: int = 1,
    timeout: float | None = None,
    retries: int = 1,
    cluster: str | Client | None = None,
    max_failures: int = DEFAULT_MAX_FAILURES,
) -> Simulator:
    """Create a simulator from a name or an object, in this process, in worker processes or on a Dask cluster.

    In worker processes, a crash or hang costs only the scenario at fault. A simulator with `in_process` runs in this
    process, unless there are several workers, a time-out, or a user's driver given by name. A user's driver given as an
    object runs in this process too, since the object may not be picklable.
    """
    timeout = None if timeout is None else check_float("timeout", timeout, above=0.0)
    workers = check_int("workers", workers, 1, MAX_WORKERS)
    retries, max_failures = check_int("retries", retries), check_int("max_failures", max_failures)
    if isinstance(simulator, str):
        check_str("simulator", simulator)
    simulator_class = SIMULATORS.get_class(simulator)
    accepted = select_declared_options(str(simulator), simulator_class, options or {}) | (
        {"ego": ego} if "ego" in simulator_class.requires else {}
    )
    name: str | type[Simulator] = simulator if isinstance(simulator, str) else simulator_class
    if not isinstance(simulator, str):
        accepted = given_options(simulator) | accepted
    if cluster is not None:
        return ClusterSimulator(name, accepted, cluster, workers, timeout, retries, max_failures)
    if (
        simulator_class.in_process
        and workers == 1
        and timeout is None
        and (current_process().daemon or not _has_user_driver(accepted))
    ):
        created = SIMULATORS.create(name, **accepted)
        require_settings(created)
        return created
    return WorkerSimulator(name, accepted, workers, timeout, retries, max_failures)


def _has_user_driver(options: Mapping[str, Any]) -> bool:
    """Return whether an entity has a driver of the user's own, chosen by name."""
    return any(user_driver_spec(driver) is not None for driver in (options.get("drivers") or {}).values())
