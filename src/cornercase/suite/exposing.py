"""Mutation testing: run scenarios of a study or suite with mutants of the ego's driver."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from cornercase._common.arguments import flag, texts, whole_number
from cornercase._common.dask_client import connected
from cornercase._common.errors import InputError
from cornercase._common.interrupts import noted_interrupts
from cornercase._common.progress import ProgressBar
from cornercase._common.typing import BoolArray
from cornercase.drivers import Driver, Mutant, driver_text, mutants_of, name_driver
from cornercase.recordings import Recording
from cornercase.reduction import Exposure
from cornercase.scenario import ConcreteScenario, Scenario
from cornercase.simulators import Simulator, outcomes_of, start_simulator
from cornercase.study import Study, explored_scenario, open_study
from cornercase.suite.contents import SuiteContents
from cornercase.suite.judging import judge
from cornercase.suite.requirement import Requirement

if TYPE_CHECKING:
    from distributed import Client

MOST_CANDIDATES: Final = 2000
"""Largest number of scenarios of a study that are run with mutants."""

NO_COLLISION: Final = "no collision"
"""Requirement that a killed mutant violates by default."""

_BUILTIN: Final = "builtin"
_OPTIONS: Final = ("time_step", "duration", "on_collision")


def find_exposure(
    study: Study | Path | str,
    mutants: int,
    *,
    require: Sequence[str] = (),
    seed: int = 0,
    scenario: Path | str | Scenario | None = None,
    workers: int = 1,
    cluster: str | Client | None = None,
    progress: bool = False,
) -> Exposure:
    """Find which scenarios of a study kill which mutants of the ego's driver.

    If there are more than 2,000 scenarios, 2,000 of them are run with the mutants, at equal intervals.

    Parameters
    ----------
    study : Study or path
        Explored with the builtin simulator and a driver of cornercase in the ego.
    mutants : int
        Number of mutants for the selection; as many others evaluate it.
    require : sequence of str
        Requirements, at least one of which a killed mutant violates, as `cornercase.suite.Requirement.parse` reads
        them; by default ``"no collision"``.
    seed : int, default 0
        The same seed gives the same mutants; see `cornercase.drivers.mutants_of`.
    scenario : path or Scenario, optional
        File that was explored; by default it is looked for at the path stored in the study, beside the study and in the
        current folder.
    workers : int, default 1
        Processes of a local cluster.
    cluster : str or distributed.Client, optional
        Dask cluster to run the mutants on: ``"local"`` for `workers` processes here, the address of a scheduler, the
        scheduler file, or a client, which stays open.
    progress : bool, default False
        Show progress on standard error.

    Returns
    -------
    KillMatrix
        For `cornercase.reduce`.

    Raises
    ------
    InputError
        The ego has no driver that can be mutated, the study was not run with the builtin simulator, or an argument is
        invalid.
    """
    n_mutants = whole_number("mutants", mutants, 1)
    parsed = _requirements(texts("require", require))
    _require_no_reference(parsed)
    for item in parsed:
        if item.pattern:
            raise InputError(
                f"`require` {item}: applies to some files or clusters only; give requirements for all scenarios."
            )
    with open_study(study) as opened:
        logical = explored_scenario(opened, scenario, where_named=True)
        meta = opened.meta
        require_builtin(meta.simulator)
        if logical is None or meta.suite:
            raise InputError(f"{opened.path}: was not explored from a logical scenario, so mutants cannot be run.")
        rows = opened.done()
        if len(rows) > MOST_CANDIDATES:
            indices = np.linspace(0, len(rows) - 1, MOST_CANDIDATES).round().astype(int)
            rows = [rows[i] for i in indices.tolist()]
        concretes = [ConcreteScenario(logical.path, dict(row.values), logical) for row in rows]
        ids, settings, entities = [row.id for row in rows], dict(meta.settings), (meta.ego, meta.others)
    drivers: dict[str, Any] = dict(settings.get("drivers", {}))
    driver = driver_of_ego(entities[0], drivers, [logical])
    mutants_ = mutants_of(driver, 2 * n_mutants, seed)
    options: dict[str, Any] = {name: settings[name] for name in _OPTIONS if name in settings}
    options["drivers"] = {name: item for name, item in drivers.items() if name != entities[0]}
    for name, item in options["drivers"].items():
        if not isinstance(item, str):
            raise InputError(
                f"Mutants cannot be run: {driver_text(item)} drove {name}, and code from a study is not run."
            )
    with connected(cluster, workers, else_none=True) as client:
        failed, killed = run_mutants(
            concretes, entities, (driver, mutants_), [parsed] * len(rows), options, client=client, progress=progress
        )
    choosing, judging = slice(0, n_mutants), slice(n_mutants, None)

    def part(which: slice, held_out: Exposure | None) -> Exposure:
        required = tuple(requirement.text for requirement in parsed)
        return Exposure(driver, required, tuple(ids), failed, mutants_[which], killed[:, which], held_out)

    return part(choosing, part(judging, None))


def draw_mutants(
    suite: SuiteContents,
    ego: str,
    drivers: Mapping[str, Any],
    requirements: Sequence[Requirement],
    count: int,
    seed: int,
) -> tuple[str, tuple[Mutant, ...]]:
    """Draw mutants of the ego's driver in a suite; `drivers` override those in the files, by entity.

    Returns the name of the driver and its mutants. Raises `InputError` if the ego has no driver that can be mutated, or
    not the same in all files, or if a requirement needs a reference driver.
    """
    _require_no_reference(requirements)
    driver = driver_of_ego(ego, drivers, [scenario.scenario for scenario in suite.usable])
    return driver, mutants_of(driver, whole_number("mutants", count, 1), seed)


def expose_suite(
    suite: SuiteContents,
    who: tuple[str, Sequence[str]],
    drivers: tuple[str, tuple[Mutant, ...]],
    requirements: Sequence[Requirement],
    options: Mapping[str, Any],
    *,
    client: Client | None = None,
    progress: bool = False,
) -> Exposure:
    """Find which scenarios of a suite kill which mutants of the ego's driver.

    `who` are the names of the ego and the others, `drivers` the ego's driver and its mutants; `options` are those of
    the builtin simulator. Without requirements it is ``"no collision"``. Ids are numbers of scenarios in the suite,
    from 1 on.
    """
    parsed = list(requirements) or _requirements(())
    failed, killed = run_mutants(
        [scenario.concrete for scenario in suite.usable],
        who,
        drivers,
        [
            [requirement for requirement in parsed if requirement.concerns(scenario.file, scenario.kind)]
            for scenario in suite.usable
        ],
        options,
        client=client,
        progress=progress,
    )
    ids = tuple(k for k, scenario in enumerate(suite.scenarios, start=1) if not scenario.wrong)
    return Exposure(drivers[0], tuple(scenario.text for scenario in parsed), ids, failed, drivers[1], killed)


def require_builtin(simulator: str) -> None:
    """Raise `InputError` unless it is the builtin simulator: others do not run drivers of cornercase."""
    if simulator.partition(":")[0] != _BUILTIN:
        raise InputError(f"Mutants need the builtin simulator, not '{simulator}'.")


def driver_of_ego(ego: str, drivers: Mapping[str, Any], scenarios: Sequence[Scenario]) -> str:
    """Name of the ego's driver, which can be mutated; `drivers` override those in the files, by entity.

    Raises `InputError` if there is none, if the files have different ones, or if it cannot be mutated.
    """
    if ego in drivers:
        return name_driver(drivers[ego])
    drivers_in_files = {scenario.drivers.get(ego) for scenario in scenarios}
    if drivers_in_files == {None}:
        raise InputError(f"Mutants need a driver of {ego}; name one with `drivers`.")
    if len(drivers_in_files) > 1:
        text = ", ".join(sorted(scenario or "nobody" for scenario in drivers_in_files))
        raise InputError(
            f"Mutants need one driver of {ego}, but the files name several ({text}); choose one with `drivers`."
        )
    (driver,) = drivers_in_files
    assert driver is not None
    return name_driver(driver)


def run_mutants(
    concretes: Sequence[ConcreteScenario],
    who: tuple[str, Sequence[str]],
    drivers: tuple[str, Sequence[Mutant]],
    requirements: Sequence[Sequence[Requirement]],
    options: Mapping[str, Any],
    *,
    client: Client | None = None,
    progress: bool = False,
) -> tuple[BoolArray, BoolArray]:
    """Run n scenarios with the ego's driver and with its m mutants.

    `requirements` are those of each scenario. Returns a mask (n,) of scenarios in which the original violates a
    requirement or could not run, and a mask (n, m) of those in which it does not and the mutant violates one.
    """
    original, mutants = drivers
    names = [original, *(mutant.driver for mutant in mutants)]
    failed = np.zeros((len(names), len(concretes)), dtype=np.bool_)
    broken = np.zeros_like(failed)
    bar = ProgressBar(len(names), "mutants", "drivers") if flag("progress", progress) else None
    try:
        with noted_interrupts() as raise_interrupt:
            for k, name in enumerate(names):
                assigned: dict[str, str | Driver] = {**options["drivers"], who[0]: name}
                with start_simulator(_BUILTIN, {**options, "drivers": assigned}, cluster=client) as simulator:
                    for i, verdict in enumerate(_failures(simulator, concretes, who, requirements)):
                        broken[k, i], failed[k, i] = verdict is None, verdict is True
                raise_interrupt()
                if bar is not None:
                    bar.update(k + 1, "")
    finally:
        if bar is not None:
            bar.stop()
    unusable = failed[0] | broken[0]
    return unusable, (failed[1:] & ~unusable).T


def _failures(
    simulator: Simulator,
    concretes: Sequence[ConcreteScenario],
    who: tuple[str, Sequence[str]],
    requirements: Sequence[Sequence[Requirement]],
) -> Iterator[bool | None]:
    """Yield whether each scenario violates a requirement; None if it could not be run."""
    for applicable, outcome in zip(requirements, outcomes_of(simulator, concretes), strict=True):
        if not isinstance(outcome, Recording):
            yield None
        else:
            yield any(judge(requirement, outcome, *who).state == "failed" for requirement in applicable)


def _require_no_reference(requirements: Sequence[Requirement]) -> None:
    for requirement in requirements:
        if requirement.reference:
            raise InputError(
                f"`require` {requirement}: mutants cannot be judged with a reference driver; leave out this requirement"
                " or the mutants."
            )


def _requirements(given: Sequence[str]) -> list[Requirement]:
    return [Requirement.parse(text) for text in dict.fromkeys(given or (NO_COLLISION,))]
