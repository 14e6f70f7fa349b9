"""How scenarios are run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cornercase._common.errors import InputError
from cornercase._common.process.dask import check_cluster
from cornercase._common.validation import check_float, check_int
from cornercase.simulators._run_options import DEFAULT_MAX_FAILURES, MAX_WORKERS

if TYPE_CHECKING:
    from distributed import Client


@dataclass(frozen=True, kw_only=True)
class Runs:
    """How scenarios are run: where, how often, and what happens if a simulator dies or hangs.

    Parameters
    ----------
    workers : int, default 1
        Number of simulators that run in parallel. The result does not depend on it.
    cluster : str or distributed.Client, optional
        Dask cluster to run on: ``"local"`` for `workers` local processes, the address of a scheduler, a scheduler file,
        or a client, which stays open.
    timeout : float, optional
        Time in s after which a scenario is cancelled.
    retries : int, default 1
        How often a scenario is run again after the simulator died or hung.
    max_failures : int, default 5
        Stop after this many consecutive scenarios in which the simulator died or hung; 0 for no limit.
    repeats : int, default 1
        How often each scenario is run; the median score counts.
    max_repeats : int, optional
        Upper limit of runs per scenario. A scenario gets `repeats` further runs as long as it is undecided on which
        side of the threshold it is. Default: each scenario is run `repeats` times.

    Raises
    ------
    InputError
        An argument has another type, or is out of range.

    Examples
    --------
    >>> from cornercase import Runs
    >>> Runs(workers=4, timeout=60.0)
    Runs(workers=4, timeout=60.0)
    """

    workers: int = 1
    cluster: str | Client | None = None
    timeout: float | None = None
    retries: int = 1
    max_failures: int = DEFAULT_MAX_FAILURES
    repeats: int = 1
    max_repeats: int | None = None

    def __post_init__(self) -> None:
        check_int("workers", self.workers, 1, MAX_WORKERS)
        if self.cluster is not None:
            check_cluster(self.cluster)
        if self.timeout is not None:
            check_float("timeout", self.timeout, above=0.0)
        for name, minimum in (("retries", 0), ("max_failures", 0), ("repeats", 1)):
            check_int(name, getattr(self, name), minimum)
        if self.max_repeats is not None:
            check_int("max_repeats", self.max_repeats, 1)

    def __repr__(self) -> str:
        changed = [f"{name}={value!r}" for name, value in vars(self).items() if value != getattr(Runs, name)]
        return f"Runs({', '.join(changed)})"


def single_run_settings(runs: Runs | None, user: str) -> dict[str, Any]:
    """Return the settings of `runs` by name for `user`, which runs each scenario once."""
    runs = Runs() if runs is None else runs
    if runs.repeats != 1 or runs.max_repeats not in (None, 1):
        raise InputError(f"`runs`: {user} runs each scenario once; leave out `repeats` and `max_repeats`.")
    return {name: value for name, value in vars(runs).items() if name not in ("repeats", "max_repeats")}
