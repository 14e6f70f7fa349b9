"""Options of all functions that run scenarios: simulator, settings and drivers, workers and failures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Final, TypedDict

from cornercase._common.option import collect_options, option

if TYPE_CHECKING:
    from distributed import Client

    from cornercase.drivers._resolve import DriverLike
    from cornercase.simulators._base import Simulator

DEFAULT_MAX_FAILURES: Final = 5
"""Default number of consecutive failures after which the simulator, not the scenarios, is considered at fault."""
MAX_WORKERS: Final = 1024
"""Maximum number of worker processes: more than any machine has cores, and few enough to be started."""

_simulation = partial(option, panel="Simulation")
_runs = partial(option, panel="Runs")


# fmt: off
@dataclass(frozen=True, kw_only=True)
class SimulationOptions:
    """Options that determine the recording of a scenario."""

    simulator: str | Simulator = _simulation(
        "builtin", "Simulator that runs the scenarios; options after a colon.", metavar="NAME",
        docs="Such as ``cornercase.simulators.Esmini(seed=3)``, or ``\"esmini:seed=3\"``. An object is not run"
        " itself: one like it is made in each process.", stored=lambda meta: meta.simulator)
    time_step: float = _simulation(0.05, "Time step in s.", metavar="S", above=0.0, stored="simulator")
    duration: float = _simulation(
        60.0, "Longest duration of a scenario in s.", metavar="S", above=0.0, stored="simulator")
    on_collision: str = _simulation(
        "continue", "What a collision does to the run.", metavar="stop|continue", choices=("continue", "stop"),
        stored="simulator")
    drivers: Mapping[str, DriverLike] = _simulation(
        dict, "Driver of an entity: normal, normal:horizon=4, or a class of your own, package.module:Class:option=3.",
        docs="By entity: a preset or ``package.module:Class``, both with options after a colon, or a driver object.",
        flag="--driver", metavar="ENTITY=NAME", stored=lambda meta: meta.drivers)


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """Options that determine where scenarios run, and what happens if a simulator crashes or hangs."""

    workers: int = _runs(
        1, "Number of simulators that run in parallel.", metavar="N", minimum=1, maximum=MAX_WORKERS,
        docs="Number of simulators that run in parallel, each in a process. Simulators that run one scenario at a time"
        " gain from it; ``builtin`` runs all scenarios of a round at once, and only gets slower for short searches.")
    cluster: str | Client | None = _runs(
        None, "Run on a Dask cluster: address or file of its scheduler; local starts --workers on this machine.",
        docs='Dask cluster to run on: ``"local"`` for `workers` local processes, the address of a scheduler, a'
        " scheduler file, or a client, which stays open.", metavar="ADDRESS|local", in_file=False)
    timeout: float | None = _runs(None, "Give up a scenario after this time in s.", metavar="S", above=0.0)
    retries: int = _runs(
        1, "How often to run a scenario again if the simulator died or hung, or a worker was lost.", metavar="N",
        minimum=0)
    max_failures: int = _runs(
        DEFAULT_MAX_FAILURES, "End after N scenarios in a row in which the simulator died or hung, or if the first N"
        " all fail; 0 for no limit.", metavar="N", minimum=0,
        docs="Stop after this many consecutive scenarios in which the simulator died or hung; 0 for no limit. An"
        " exception of a driver, the simulator or a metric fails its scenario only, unless that many scenarios have"
        " failed before any gave a result.")
# fmt: on


class RunKeywords(TypedDict, total=False):
    """The fields of `RunOptions`, as keyword arguments."""

    workers: int
    cluster: str | Client | None
    timeout: float | None
    retries: int
    max_failures: int


class SimulationKeywords(RunKeywords, total=False):
    """The fields of `SimulationOptions` and `RunOptions`, as keyword arguments."""

    simulator: str | Simulator
    time_step: float
    duration: float
    on_collision: str
    drivers: Mapping[str, DriverLike] | None


RUN_OPTIONS: Final = collect_options(RunOptions)
SIMULATION_OPTIONS: Final = collect_options(SimulationOptions, RunOptions)
