"""Mutation testing: run scenarios of a study or suite with mutants (faulty variants) of the ego's driver."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.process.dask import open_connection
from cornercase._common.process.signals import collect_interrupts
from cornercase._common.progress import ProgressBar
from cornercase._common.typing import BoolArray
from cornercase._common.validation import check_bool, check_int, check_str_sequence
from cornercase.drivers import Driver, Mutant, generate_mutants
from cornercase.drivers._mutants import is_user_class_name, mutable_driver_name
from cornercase.drivers._resolve import check_drivers, driver_by_name, resolve_driver
from cornercase.drivers._serialization import format_driver, remove_driver_spec, serialize_driver
from cornercase.recordings import Recording
from cornercase.reduction import KillMatrix
from cornercase.scenario import ConcreteScenario
from cornercase.scenario._file import ScenarioFile
from cornercase.simulators import Simulator
from cornercase.simulators._create import create_simulator
from cornercase.simulators._results import run_scenarios
from cornercase.study import StudyFile
from cornercase.study._scenario_file import find_explored_scenario
from cornercase.study._study_file import open_study
from cornercase.suite._judge import judge
from cornercase.suite._requirement import Requirement
from cornercase.suite._suite_contents import DEFAULT_SETTINGS, SuiteContents

if TYPE_CHECKING:
    from distributed import Client

MAX_CANDIDATES: Final = 2000
"""Largest number of scenarios of a study that are run with mutants."""

DEFAULT_REQUIREMENT: Final = "no collision"
"""Requirement that a killed mutant violates by default."""

_BUILTIN: Final = "builtin"


def analyze_mutants(
    study: StudyFile | Path | str,
    mutants: int,
    *,
    require: Sequence[str] = (),
    seed: int = 0,
    scenario: Path | str | ScenarioFile | None = None,
    drivers: Mapping[str, str | Driver] | None = None,
    workers: int = 1,
    cluster: str | Client | None = None,
    progress: bool = False,
) -> KillMatrix:
    """Find which scenarios of a study kill which mutants of the ego's driver.

    A mutant is a variant of the driver with a fault. A scenario kills a mutant if the mutant violates a requirement and
    the original driver violates none. If the study has more than 2,000 scenarios, 2,000 at equal intervals are run.

    Parameters
    ----------
    study : Study, StudyFile or path
        Study that was explored with the builtin simulator. The ego's driver has to be one of cornercase's drivers, or a
        class, FMU or program of yours that has `mutations`.
    mutants : int
        Number of mutants that `cornercase.reduce` selects scenarios by. As many further mutants are run, to evaluate
        the selection.
    require : sequence of str
        Requirements, as texts for `cornercase.suite.Requirement.parse`; by default ``"no collision"``. A mutant is
        killed if it violates at least one requirement.
    seed : int, default 0
        The same seed gives the same mutants; see `cornercase.drivers.generate_mutants`.
    scenario : path or ScenarioFile, optional
        Scenario file that was explored; by default it is searched at the path stored in the study, beside the study and
        in the current folder.
    drivers : mapping of str to str or Driver, optional
        The drivers that the study was explored with. Give those that are your own code: cornercase loads no code that a
        study names.
    workers : int, default 1
        Number of processes of a local cluster.
    cluster : str or distributed.Client, optional
        Dask cluster to run the mutants on: ``"local"`` for `workers` processes here, the address of a scheduler, the
        scheduler file, or a client, which stays open.
    progress : bool, default False
        Show progress on standard error.

    Returns
    -------
    KillMatrix
        The kills by scenario and mutant, for the argument `kill_matrix` of `cornercase.reduce`.

    Raises
    ------
    InputError
        The ego has no driver that can be mutated, the study was not run with the builtin simulator, or an argument is
        invalid.

    Examples
    --------
    >>> from cornercase.suite import analyze_mutants
    >>> matrix = analyze_mutants("study.db", 20, require=["no collision"])  # doctest: +SKIP
    >>> print(matrix.summary_text)  # doctest: +SKIP
    9 of 20 mutants of normal are exposed, 45% (23% to 68% with 95 % confidence)
    """
    n_mutants = check_int("mutants", mutants, 1)
    parsed = _parse_requirements(check_str_sequence("require", require))
    _require_no_reference(parsed)
    for item in parsed:
        if item.pattern:
            raise InputError(
                f"`require` {item}: applies to some files or clusters only; give requirements for all scenarios."
            )
    with open_study(study) as opened:
        logical = find_explored_scenario(opened, scenario, search_stored_path=True)
        meta = opened.meta
        require_builtin_simulator(meta.simulator)
        if logical is None or meta.suite:
            raise InputError(f"{opened.path}: was not explored from a logical scenario, so mutants cannot be run.")
        rows = opened.finished_rows()
        if len(rows) > MAX_CANDIDATES:
            indices = np.linspace(0, len(rows) - 1, MAX_CANDIDATES).round().astype(int)
            rows = [rows[i] for i in indices.tolist()]
        concretes = [ConcreteScenario(logical.path, dict(row.values), logical, meta.seed) for row in rows]
        ids, settings, entities = [row.id for row in rows], dict(meta.settings), (meta.ego, meta.others)
        _require_fixed_driver(meta.ego, concretes)
    assigned: dict[str, Any] = {**settings.get("drivers", {}), **_check_own_drivers(drivers, settings)}
    driver = find_ego_driver(entities[0], assigned, [logical])
    mutants_ = generate_mutants(driver, 2 * n_mutants, seed)
    options: dict[str, Any] = {name: settings[name] for name in DEFAULT_SETTINGS if name in settings}
    options["drivers"] = {name: item for name, item in assigned.items() if name != entities[0]}
    for name, item in options["drivers"].items():
        if isinstance(item, Mapping):
            raise InputError(
                f"Mutants cannot be run: the study names the driver {format_driver(item)} for {name}, but code that a"
                " study names is not run; name the driver with `drivers`."
            )
    with open_connection(cluster, workers, workers_need_cluster=True) as client:
        failed, killed = run_mutants(
            concretes, entities, (driver, mutants_), [parsed] * len(rows), options, client=client, progress=progress
        )
    choosing, judging = slice(0, n_mutants), slice(n_mutants, None)

    def build_kill_matrix(mutant_slice: slice, held_out: KillMatrix | None) -> KillMatrix:
        required = tuple(requirement.text for requirement in parsed)
        return KillMatrix(
            driver, required, tuple(ids), failed, mutants_[mutant_slice], killed[:, mutant_slice], held_out
        )

    return build_kill_matrix(choosing, build_kill_matrix(judging, None))


def _check_own_drivers(
    drivers: Mapping[str, str | Driver] | None, settings: Mapping[str, Any]
) -> dict[str, str | Driver]:
    """Create the drivers that the user names; raise `InputError` if the study was explored with other drivers."""
    created = {entity: resolve_driver(driver) for entity, driver in check_drivers(drivers).items()}
    stored = settings.get("drivers", {})
    for entity, driver in created.items():
        if serialize_driver(driver) != stored.get(entity):
            raise InputError(
                f"`drivers` {entity}: the study was explored with {format_driver(stored.get(entity))}, not with"
                f" {format_driver(serialize_driver(driver))}; name the same driver."
            )
    return created


def draw_mutants(
    suite: SuiteContents,
    ego: str,
    drivers: Mapping[str, Any],
    requirements: Sequence[Requirement],
    count: int,
    seed: int,
) -> tuple[str, tuple[Mutant, ...]]:
    """Return the ego's driver in a suite, and `count` mutants of this driver.

    `drivers`, by entity, override the drivers in the scenario files.
    """
    _require_no_reference(requirements)
    _require_fixed_driver(ego, [scenario.concrete_scenario for scenario in suite.runnable_scenarios])
    driver = find_ego_driver(ego, drivers, [scenario.scenario for scenario in suite.runnable_scenarios])
    return driver, generate_mutants(driver, check_int("mutants", count, 1), seed)


def analyze_suite_mutants(
    suite: SuiteContents,
    entities: tuple[str, Sequence[str]],
    driver_and_mutants: tuple[str, tuple[Mutant, ...]],
    requirements: Sequence[Requirement],
    options: Mapping[str, Any],
    *,
    client: Client | None = None,
    progress: bool = False,
) -> KillMatrix:
    """Find which scenarios of a suite kill which mutants of the ego's driver.

    Scenario ids are positions in the suite, from 1 on. Without requirements, a collision kills a mutant.
    """
    parsed = list(requirements) or _parse_requirements(())
    failed, killed = run_mutants(
        [scenario.concrete_scenario for scenario in suite.runnable_scenarios],
        entities,
        driver_and_mutants,
        [
            [requirement for requirement in parsed if requirement.applies_to(scenario.file_name, scenario.cluster_name)]
            for scenario in suite.runnable_scenarios
        ],
        options,
        client=client,
        progress=progress,
    )
    ids = tuple(k for k, scenario in enumerate(suite.scenarios, start=1) if not scenario.error)
    return KillMatrix(
        driver_and_mutants[0],
        tuple(requirement.text for requirement in parsed),
        ids,
        failed,
        driver_and_mutants[1],
        killed,
    )


def require_builtin_simulator(simulator: str) -> None:
    """Raise `InputError` unless the simulator is the builtin one; other simulators cannot run cornercase's drivers."""
    if simulator.partition(":")[0] != _BUILTIN:
        raise InputError(f"Mutants need the builtin simulator, not '{simulator}'.")


def find_ego_driver(ego: str, drivers: Mapping[str, Any], scenarios: Sequence[ScenarioFile]) -> str:
    """Return the name of the ego's driver; `drivers`, by entity, override the drivers in the scenario files."""
    if ego in drivers:
        return mutable_driver_name(drivers[ego])
    drivers_in_files = {scenario.drivers.get(ego) for scenario in scenarios}
    if drivers_in_files == {None}:
        raise InputError(f"Mutants need a driver of {ego}; name one with `drivers`.")
    if len(drivers_in_files) > 1:
        text = ", ".join(sorted(name or "nobody" for name in drivers_in_files))
        raise InputError(
            f"Mutants need one driver of {ego}, but the files name several ({text}); choose one with `drivers`."
        )
    (driver,) = drivers_in_files
    assert driver is not None
    return mutable_driver_name(driver)


def run_mutants(
    scenarios: Sequence[ConcreteScenario],
    entities: tuple[str, Sequence[str]],
    driver_and_mutants: tuple[str, Sequence[Mutant]],
    requirements: Sequence[Sequence[Requirement]],
    options: Mapping[str, Any],
    *,
    client: Client | None = None,
    progress: bool = False,
) -> tuple[BoolArray, BoolArray]:
    """Run n scenarios with the ego's driver and with its m mutants.

    `requirements` has the requirements on each scenario. Two masks are returned. The first, shape (n,), marks scenarios
    that are unusable: the original driver violates a requirement, or its run failed. The second, shape (n, m), marks
    usable scenarios in which a mutant violates a requirement.
    """
    original, mutants = driver_and_mutants
    names = [original, *(mutant.driver for mutant in mutants)]
    failed = np.zeros((len(names), len(scenarios)), dtype=np.bool_)
    broken = np.zeros_like(failed)
    bar = ProgressBar(len(names), "mutants", "drivers", enabled=check_bool("progress", progress))
    try:
        with collect_interrupts() as raise_interrupt:
            for k, name in enumerate(names):
                driver: str | Driver = driver_by_name(name) if is_user_class_name(name) else name
                if client is None and isinstance(driver, Driver):
                    # As an object, a class of the user needs no new process for each mutant.
                    driver = remove_driver_spec(driver)
                assigned: dict[str, str | Driver] = {**options["drivers"], entities[0]: driver}
                with create_simulator(_BUILTIN, {**options, "drivers": assigned}, cluster=client) as simulator:
                    for i, verdict in enumerate(_iter_violations(simulator, scenarios, entities, requirements)):
                        broken[k, i], failed[k, i] = verdict is None, verdict is True
                raise_interrupt()
                bar.update(k + 1, "")
    finally:
        bar.stop()
    unusable = failed[0] | broken[0]
    return unusable, (failed[1:] & ~unusable).T


def _iter_violations(
    simulator: Simulator,
    scenarios: Sequence[ConcreteScenario],
    entities: tuple[str, Sequence[str]],
    requirements: Sequence[Sequence[Requirement]],
) -> Iterator[bool | None]:
    """Yield for each scenario whether it violates a requirement; None if the run failed."""
    for applicable, outcome in zip(requirements, run_scenarios(simulator, scenarios), strict=True):
        if not isinstance(outcome, Recording):
            yield None
        else:
            yield any(judge(requirement, outcome, *entities).state == "failed" for requirement in applicable)


def _require_fixed_driver(ego: str, concretes: Sequence[ConcreteScenario]) -> None:
    """Raise `InputError` if scenarios have a parameter of the ego's driver: its value would replace the mutant's."""
    for concrete in concretes:
        if others := {*concrete.values} - {*concrete.without_driver_parameters(ego).values}:
            raise InputError(
                f"Mutants need the same driver of {ego} in all scenarios, but {min(others)} is a parameter of the"
                " scenarios; leave out the mutants."
            )


def _require_no_reference(requirements: Sequence[Requirement]) -> None:
    for requirement in requirements:
        if requirement.expression.reference_drivers:
            raise InputError(
                f"`require` {requirement}: mutants cannot be judged with a reference driver; leave out this requirement"
                " or the mutants."
            )


def _parse_requirements(texts: Sequence[str]) -> list[Requirement]:
    return [Requirement.parse(text) for text in dict.fromkeys(texts or (DEFAULT_REQUIREMENT,))]
