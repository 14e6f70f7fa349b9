"""Mutants of the ego's driver in the scenarios of a study or a suite."""

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
"""Of more scenarios of a study, so many are run with mutants."""

NO_COLLISION: Final = "no collision"
"""What a mutant has to fail where nothing else is said."""

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
    """Find which scenarios of a study expose which mutants of the ego's driver.

    Of more than 2,000 scenarios, 2,000 are run with the mutants: the first, the last, and every so many between.

    Parameters
    ----------
    study : Study or path
        Explored with the builtin simulator and a driver of cornercase at the ego's wheel.
    mutants : int
        How many mutants choose; as many others judge what they chose.
    require : sequence of str
        What a mutant has to fail one of, as `cornercase.suite.Requirement.parse` reads it; by default
        ``"no collision"``.
    seed : int, default 0
        The same seed gives the same mutants, as `cornercase.drivers.mutants_of` draws them.
    scenario : path or Scenario, optional
        File that was explored; by default it is looked for where the study names it, beside the study and in the
        current folder.
    workers : int, default 1
        Processes of a local cluster.
    cluster : str or distributed.Client, optional
        Dask cluster to run the mutants on: ``"local"`` for `workers` processes here, the address of a scheduler, the
        file that a scheduler wrote, or a connection, which stays open.
    progress : bool, default False
        Show how far it is on standard error.

    Returns
    -------
    Exposure
        To be handed to `cornercase.reduce`.

    Raises
    ------
    InputError
        The ego has no driver that could have mutants, the study was not run by the builtin simulator, or an argument
        cannot be used.
    """
    count = whole_number("mutants", mutants, 1)
    known = _requirements(texts("require", require))
    _require_no_reference(known)
    for one in known:
        if one.pattern:
            raise InputError(
                f"`require` {one}: is for some files or kinds of a suite; say what holds in all scenarios."
            )
    with open_study(study) as opened:
        explored = explored_scenario(opened, scenario, where_named=True)
        meta = opened.meta
        require_builtin(meta.simulator)
        if explored is None or meta.suite:
            raise InputError(f"{opened.path}: holds no scenarios of a logical scenario; mutants choose among those.")
        rows = opened.done()
        if len(rows) > MOST_CANDIDATES:
            places = np.linspace(0, len(rows) - 1, MOST_CANDIDATES).round().astype(int)
            rows = [rows[i] for i in places.tolist()]
        concretes = [ConcreteScenario(explored.path, dict(row.values), explored) for row in rows]
        ids, settings, who = [row.id for row in rows], dict(meta.settings), (meta.ego, meta.others)
    drivers: dict[str, Any] = dict(settings.get("drivers", {}))
    driver = driver_of_ego(who[0], drivers, [explored])
    drawn = mutants_of(driver, 2 * count, seed)
    options: dict[str, Any] = {name: settings[name] for name in _OPTIONS if name in settings}
    options["drivers"] = {name: one for name, one in drivers.items() if name != who[0]}
    for name, one in options["drivers"].items():
        if not isinstance(one, str):
            raise InputError(
                f"Mutants cannot be run: {driver_text(one)} drove {name}, and a study is no reason to run code."
            )
    with connected(cluster, workers, else_none=True) as client:
        failed, exposed = run_mutants(
            concretes, who, (driver, drawn), [known] * len(rows), options, client=client, progress=progress
        )
    choosing, judging = slice(0, count), slice(count, None)

    def part(which: slice, held_out: Exposure | None) -> Exposure:
        required = tuple(one.text for one in known)
        return Exposure(driver, required, tuple(ids), failed, drawn[which], exposed[:, which], held_out)

    return part(choosing, part(judging, None))


def draw_mutants(
    suite: SuiteContents,
    ego: str,
    drivers: Mapping[str, Any],
    requirements: Sequence[Requirement],
    count: int,
    seed: int,
) -> tuple[str, tuple[Mutant, ...]]:
    """Draw mutants of the driver of the ego in a suite.

    Parameters
    ----------
    suite : SuiteContents
    ego : str
    drivers : mapping of str to str or Driver
        Who drives, by entity, where it is not as the files say.
    requirements : sequence of Requirement
        What mutants are to be judged by.
    count, seed : int
        As `cornercase.drivers.mutants_of` takes them.

    Returns
    -------
    driver : str
    mutants : tuple of Mutant

    Raises
    ------
    InputError
        The ego has no driver that could have mutants, or not the same in all files, or a requirement asks a reference.
    """
    _require_no_reference(requirements)
    driver = driver_of_ego(ego, drivers, [one.scenario for one in suite.usable])
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
    """Find which scenarios of a suite expose which mutants of the ego's driver.

    Parameters
    ----------
    suite : SuiteContents
    who : tuple of str and sequence of str
        Names of the ego and the others.
    drivers : tuple of str and tuple of Mutant
        The ego's, and its mutants.
    requirements : sequence of Requirement
        Without any, no collision.
    options : mapping of str to object
        Of the builtin simulator: ``time_step`` and ``duration`` in s, ``on_collision``, ``drivers``.
    client : distributed.Client, optional
        Dask cluster to run on.
    progress : bool, default False
        Show how far it is on standard error.

    Returns
    -------
    Exposure
        By number of the scenario in the suite, from 1 on.
    """
    known = list(requirements) or _requirements(())
    failed, exposed = run_mutants(
        [one.concrete for one in suite.usable],
        who,
        drivers,
        [[each for each in known if each.concerns(one.file, one.kind)] for one in suite.usable],
        options,
        client=client,
        progress=progress,
    )
    ids = tuple(k for k, one in enumerate(suite.scenarios, start=1) if not one.wrong)
    return Exposure(drivers[0], tuple(one.text for one in known), ids, failed, drivers[1], exposed)


def require_builtin(simulator: str) -> None:
    """Refuse a simulator that has no drivers of cornercase.

    Parameters
    ----------
    simulator : str
        Its name.

    Raises
    ------
    InputError
        It is not the builtin one.
    """
    if simulator.partition(":")[0] != _BUILTIN:
        raise InputError(f"Mutants drive in the builtin simulator only, not in '{simulator}'.")


def driver_of_ego(ego: str, drivers: Mapping[str, Any], scenarios: Sequence[Scenario]) -> str:
    """Find out who drives the ego.

    Parameters
    ----------
    ego : str
    drivers : mapping of str to str, Driver or mapping
        Who drives, by entity, where it is not as the files say; a mapping holds a driver's settings.
    scenarios : sequence of Scenario
        Files.

    Returns
    -------
    str
        Name of a driver that can have mutants.

    Raises
    ------
    InputError
        There is none, not one alone, or it cannot have mutants.
    """
    if ego in drivers:
        return name_driver(drivers[ego])
    found = {one.drivers.get(ego) for one in scenarios}
    if found == {None}:
        raise InputError(f"Mutants need a driver of {ego}; name one with `drivers`.")
    if len(found) > 1:
        names = ", ".join(sorted(one or "nobody" for one in found))
        raise InputError(
            f"Mutants need one driver of {ego}, and files name several ({names}); name one with `drivers`."
        )
    (driver,) = found
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
    """Run scenarios with a driver at the ego's wheel, and with mutants of it.

    Parameters
    ----------
    concretes : sequence of ConcreteScenario, length n
    who : tuple of str and sequence of str
        Names of the ego and the others.
    drivers : tuple of str and sequence of Mutant, length m
        Name of the original, and its mutants.
    requirements : sequence of sequence of Requirement, length n
        Those of each scenario.
    options : mapping of str to object
        Of the builtin simulator; with the drivers of all others.
    client : distributed.Client, optional
        Dask cluster to run on.
    progress : bool, default False
        Show how far it is on standard error.

    Returns
    -------
    failed : ndarray of bool, shape (n,)
        Where the original fails a requirement, or could not be run.
    exposed : ndarray of bool, shape (n, m)
        Where it fails none, and the mutant fails one.
    """
    original, mutants = drivers
    names = [original, *(one.driver for one in mutants)]
    failed = np.zeros((len(names), len(concretes)), dtype=np.bool_)
    broken = np.zeros_like(failed)
    bar = ProgressBar(len(names), "mutants", "drivers") if flag("progress", progress) else None
    try:
        with noted_interrupts() as check:
            for k, name in enumerate(names):
                at_wheel: dict[str, str | Driver] = {**options["drivers"], who[0]: name}
                with start_simulator(_BUILTIN, {**options, "drivers": at_wheel}, cluster=client) as simulator:
                    for i, verdict in enumerate(_failures(simulator, concretes, who, requirements)):
                        broken[k, i], failed[k, i] = verdict is None, verdict is True
                check()
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
    """Whether each scenario fails a requirement; None where it could not be run."""
    for mine, outcome in zip(requirements, outcomes_of(simulator, concretes), strict=True):
        if not isinstance(outcome, Recording):
            yield None
        else:
            yield any(judge(one, outcome, *who).state == "failed" for one in mine)


def _require_no_reference(requirements: Sequence[Requirement]) -> None:
    for one in requirements:
        if one.reference:
            raise InputError(
                f"`require` {one}: mutants are not judged by a reference driver; leave it out, or the mutants."
            )


def _requirements(given: Sequence[str]) -> list[Requirement]:
    return [Requirement.parse(one) for one in dict.fromkeys(given or (NO_COLLISION,))]
