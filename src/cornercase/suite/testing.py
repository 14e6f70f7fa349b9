"""Run a suite and judge its scenarios."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from cornercase._common.arguments import by_name, flag, shown, text, texts, whole_number
from cornercase._common.arguments import path as path_argument
from cornercase._common.dask_client import connected
from cornercase._common.errors import InputError
from cornercase._common.files import require_apart, require_other_file, require_place
from cornercase._common.texts import plain_text, without_folders
from cornercase.drivers import Driver, is_driver, told_driver
from cornercase.metrics import EVERYBODY, METRICS, condition_of, name_others
from cornercase.simulators import MOST_FAILURES, MOST_WORKERS, Simulator, failure_words, start_simulator
from cornercase.study import Study, StudyMeta, stored_path
from cornercase.suite.asking import ask_references
from cornercase.suite.contents import SuiteContents
from cornercase.suite.criteria import required_by_files
from cornercase.suite.exposing import draw_mutants, expose_suite, require_builtin
from cornercase.suite.judging import judge_row
from cornercase.suite.junit import JUNIT, write_junit
from cornercase.suite.origin import find_differences, find_origin
from cornercase.suite.reading import read_suite
from cornercase.suite.requirement import Requirement
from cornercase.suite.requirement_files import read_requirements
from cornercase.suite.result import ScenarioResult, SuiteResult
from cornercase.suite.running import run_suite, sort_out
from cornercase.suite.summary import HEADING, write_summary
from cornercase.suite.verdict import Verdict, worst_state

if TYPE_CHECKING:
    from distributed import Client

_PLAIN: Final[dict[str, Any]] = {"time_step": 0.05, "duration": 60.0, "on_collision": "continue"}
_BUILTIN: Final = "builtin"
_RAN: Final = "runs"


# The parameters are the options of the command.
def test(
    suite: Path | str,
    study: Path | str,
    *,
    require: Sequence[str] = (),
    requirements: Path | str | None = None,
    require_from_file: bool = False,
    ego: str | None = None,
    other: str | Sequence[str] | None = None,
    metrics: Sequence[str] = (),
    simulator: str | None = None,
    workers: int = 1,
    cluster: str | Client | None = None,
    timeout: float | None = None,
    retries: int = 1,
    max_failures: int = MOST_FAILURES,
    time_step: float | None = None,
    duration: float | None = None,
    on_collision: str | None = None,
    drivers: Mapping[str, str | Driver] | None = None,
    against: Path | str | None = None,
    junit: Path | str | None = None,
    summary: Path | str | None = None,
    mutants: int | None = None,
    seed: int = 0,
    progress: bool = False,
) -> SuiteResult:
    """Run the scenarios of a suite again, judge them, and compare them with those that they were selected from.

    Each scenario is stored when it has ended. The same call again resumes an interrupted run; with other requirements
    it judges what has run.

    Parameters
    ----------
    suite : path
        Folder of a reduced set or its manifest, or any folder of concrete scenarios.
    study : path
        Study to create or continue.
    require : sequence of str
        Requirements on each scenario, as `cornercase.suite.Requirement.parse` reads them.
    requirements : path, optional
        TOML or YAML file with further requirements.
    require_from_file : bool, default False
        Use the criteria for ScenarioRunner in the files as requirements, if a recording can answer them; a notice names
        the others.
    ego : str, optional
        Name of the entity under test; by default that of the manifest.
    other : str or sequence of str, optional
        Entity that the ego is measured against. With several, the most critical one counts; ``"*"`` stands for all
        others in the files. By default that of the manifest.
    metrics : sequence of str
        Criticality metrics to store; by default those of the manifest, without one those in the requirements, or else
        ``clearance``.
    simulator : str, optional
        By default that of the manifest; without one the builtin simulator.
    workers : int, default 1
        Number of parallel simulators.
    cluster : str or distributed.Client, optional
        Dask cluster to run on: ``"local"`` for `workers` processes here, the address of a scheduler, the scheduler
        file, or a client, which stays open.
    timeout : float, optional
        Time in s after which a scenario is stopped.
    retries : int, default 1
        How often a scenario is run again after the simulator crashed or hung.
    max_failures : int, default 5
        Number of consecutive scenarios in which the simulator crashes or hangs, after which the run stops; 0 for no
        limit.
    time_step, duration : float, optional
        s; by default those of the manifest, without one 0.05 s and 60 s.
    on_collision : {"continue", "stop"}, optional
        Effect of a collision on the run; by default as in the manifest, without one ``"continue"``.
    drivers : mapping of str to str or Driver, optional
        Drivers by entity: a preset or ``package.module:Class``, either with options after a colon, or an instance. By
        default those in the files.
    against : path, optional
        Study with earlier recordings: the one that was reduced, or another run of the suite. By default the former, if
        it is beside the manifest or in the folder above.
    junit : path, optional
        JUnit file to write. An existing one is removed before anything is run; any other file is refused.
    summary : path, optional
        Markdown file with a table to write, replacing an existing one like `junit`.
    mutants : int, optional
        Also run the scenarios with this number of mutants of the ego's driver in the builtin simulator, and count those
        that are killed: they violate a requirement, or collide if there is none, in a scenario in which the driver does
        not. They are not stored, but run again each time.
    seed : int, default 0
        The same seed gives the same mutants; see `cornercase.drivers.mutants_of`.
    progress : bool, default False
        Show progress on standard error.

    Returns
    -------
    SuiteResult

    Raises
    ------
    InputError
        An argument or file cannot be used, a file of the manifest is missing or has changed, no scenario can be run, or
        the study is of something else.

    Warns
    -----
    NoticeWarning
        Something in the files has no effect in the simulator.
    """
    path = path_argument("study", study)
    parsed = _required(require, requirements)
    contents = read_suite(suite)
    if flag("require_from_file", require_from_file):
        parsed = _distinct([*parsed, *required_by_files(contents)])
    source, why = find_origin(contents, None if against is None else path_argument("against", against))
    requirements_file = None if requirements is None else path_argument("requirements", requirements)
    read = [*contents.files, *(item for item in (source, requirements_file) if item is not None)]
    for item in read:
        require_other_file(path, item)
    outputs = _outputs(junit, summary, path, read)
    contents, entities = _entities(contents, ego, other, parsed, drivers or {})
    workers = whole_number("workers", workers, 1, MOST_WORKERS)
    options = {name: contents.settings.get(name, default) for name, default in _PLAIN.items()}
    overrides = {"time_step": time_step, "duration": duration, "on_collision": on_collision}
    options |= {name: value for name, value in overrides.items() if value is not None}
    name = _simulator(contents, simulator)
    options["drivers"] = _drivers(contents, drivers)
    if mutants is not None:
        # Check before anything is run.
        require_builtin(name)
        driver_and_mutants = draw_mutants(contents, entities[0], options["drivers"], parsed, mutants, seed)
    reference_names = dict.fromkeys(item.reference for item in parsed if item.reference)
    with connected(cluster, workers) as client:
        start: Callable[..., Simulator] = partial(
            start_simulator, name, ego=entities[0], timeout=timeout, retries=retries
        )
        start = partial(start, max_failures=max_failures)
        start = partial(start, workers=workers) if client is None else partial(start, cluster=client)
        with start(options) as started, ExitStack() as stack:
            contents = sort_out(contents, started)
            references = {
                item: stack.enter_context(_with_reference(start, options, entities[0], item))
                for item in reference_names
            }
            meta = _meta(contents, entities, _metrics(contents, metrics, parsed), parsed, name, started.settings, path)
            n_parallel = workers if client is None else None
            n_before = run_suite(contents, meta, started, path, n_parallel, flag("progress", progress))
            if references:
                with Study.open(path, readonly=False) as opened:
                    ask_references(contents, opened, parsed, references)
        with Study.open(path, readonly=True) as opened:
            result = replace(_result(contents, opened, parsed, source, why), ran_before=n_before)
        for write, target in outputs:
            write(result, target)
        if mutants is not None:
            kills = expose_suite(
                contents, entities, driver_and_mutants, parsed, options, client=client, progress=progress
            )
            result = replace(result, exposure=kills)
    return result


def _with_reference(start: Callable[..., Simulator], options: dict[str, Any], ego: str, reference: str) -> Simulator:
    try:
        return start(options | {"drivers": {**options["drivers"], ego: told_driver(reference)}})
    except InputError as error:
        raise InputError(f"`require` no collision unless {reference} collides: {error}") from error


def _outputs(
    junit: Path | str | None, summary: Path | str | None, study: Path, read: Sequence[Path]
) -> list[tuple[Callable[[SuiteResult, Path], None], Path]]:
    """Writers and paths of the outputs besides the study, after removing those of an earlier run."""
    targets: list[tuple[Callable[[SuiteResult, Path], None], Path]] = []
    outputs = (("junit", junit, write_junit, JUNIT), ("summary", summary, write_summary, HEADING))
    for name, target, write, first_bytes in outputs:
        if target is not None:
            file = path_argument(name, target)
            for source in read:
                require_other_file(file, source, name)
            # Check before hours of simulations.
            require_place(name, file)
            require_apart(file, study, name)
            _require_own(name, file, first_bytes)
            if any(file.resolve() == other.resolve() for _, other in targets):
                raise InputError(f"`{name}` {file}: is the JUnit file too; choose another name.")
            targets.append((write, file))
    for _, file in targets:
        # Remove outputs of earlier runs, which would remain if no scenario can be run.
        file.unlink(missing_ok=True)
    return targets


def _require_own(name: str, place: Path, begin: bytes) -> None:
    """Raise `InputError` if the file is not from an earlier run, as it may be the only copy of something."""
    if place.exists():
        with place.open("rb") as file:
            content = file.read(len(begin))
        if content and content != begin:
            raise InputError(f"`{name}` {place}: exists and has other content; choose another name, or remove it.")


def _required(require: Sequence[str], requirements: Path | str | None) -> list[Requirement]:
    parsed = [Requirement.parse(item) for item in texts("require", require)]
    if requirements is not None:
        parsed += read_requirements(path_argument("requirements", requirements))
    return _distinct(parsed)


def _distinct(requirements: Sequence[Requirement]) -> list[Requirement]:
    """Requirements without duplicates."""
    return list({requirement.text: requirement for requirement in requirements}.values())


def _entities(
    suite: SuiteContents,
    ego: str | None,
    other: str | Sequence[str] | None,
    requirements: Sequence[Requirement],
    drivers: Mapping[str, object],
) -> tuple[SuiteContents, tuple[str, tuple[str, ...]]]:
    """Resolve the names of the ego and the others; mark files that lack an entity, unless all do."""
    for role, given, own in (("ego", ego, suite.ego), ("other", other, suite.other)):
        if given is None and not own:
            raise InputError(f"`{role}`: {suite.place} does not define it; name an entity.")
    ego_name = suite.ego if ego is None else text("ego", ego)
    suite = _only_with(suite, {})
    names = dict.fromkeys(name for item in suite.usable for name in item.scenario.entities)
    others = name_others(suite.other if other is None else other, ego_name, list(names))
    roles = {ego_name: "ego"} | dict.fromkeys(others, "other")
    if other is not None and EVERYBODY in texts("other", other):
        # Not every file needs to have all of them.
        roles = {ego_name: "ego"}
    roles |= {item.entity: "entity to avoid" for item in requirements if item.entity}
    roles |= dict.fromkeys(by_name("drivers", drivers), "driven entity")
    suite = _only_with(suite, roles)
    for required in requirements:
        if required.entity == ego_name:
            raise InputError(f"`require` {required}: is the ego itself; name another entity.")
        if not any(required.concerns(item.file, item.kind) for item in suite.scenarios):
            raise InputError(f"`require` {required}: {_none_concerned(suite, required)}.")
    return suite, (ego_name, others)


def _only_with(suite: SuiteContents, asked: Mapping[str, str]) -> SuiteContents:
    """Mark the scenarios that lack an entity (name to role); raises `InputError` if all do."""
    lacking: dict[str, InputError] = {}
    for scenario in suite.usable:
        try:
            _ = scenario.scenario.entities
            for name, role in asked.items():
                scenario.scenario.require_entity(name, role)
        except InputError as error:
            lacking[scenario.file] = error
    if lacking and len(lacking) == len(suite.usable):
        raise next(iter(lacking.values()))
    scenarios = tuple(
        replace(scenario, wrong=failure_words(scenario.scenario.path, lacking[scenario.file]))
        if scenario.file in lacking
        else scenario
        for scenario in suite.scenarios
    )
    return replace(suite, scenarios=scenarios)


def _none_concerned(suite: SuiteContents, required: Requirement) -> str:
    if not required.by_kind:
        return f"no file of {suite.place} has such a name"
    kinds = dict.fromkeys(scenario.kind for scenario in suite.scenarios if scenario.kind)
    if not kinds:
        return f"{suite.place} does not name the clusters of its scenarios"
    return f"no scenario of {suite.place} belongs to such a cluster; there are {'; '.join(kinds)}"


def _metrics(suite: SuiteContents, given: Sequence[str], requirements: Sequence[Requirement]) -> tuple[str, ...]:
    # A condition would need further runs with reference drivers.
    names = list(texts("metrics", given)) or [name for name in suite.metrics if not condition_of([name])]
    formula_metrics = [
        name for requirement in requirements if requirement.formula is not None for name in requirement.formula.metrics
    ]
    instances = [METRICS.create(name) for name in dict.fromkeys(names or formula_metrics or ["clearance"])]
    # Check before the study is created.
    for metric in [*instances, *map(METRICS.create, formula_metrics)]:
        metric.require()
    for requirement in requirements:
        if requirement.formula is not None:
            requirement.formula.require()
    return tuple(metric.name for metric in instances)


def _simulator(suite: SuiteContents, given: str | None) -> str:
    if given is not None:
        return text("simulator", given)
    name, colon, _ = suite.simulator.partition(":")
    # Options may name files and programs; the manifest may come from anywhere.
    if colon:
        raise InputError(
            f"`simulator`: {suite.place} names '{suite.simulator[:100]}', with options; specify the simulator yourself."
        )
    return name or _BUILTIN


def _drivers(suite: SuiteContents, given: Mapping[str, str | Driver] | None) -> dict[str, str | Driver]:
    drivers: dict[str, str | Driver] = {}
    for entity, driver in by_name("drivers", given or {}).items():
        if (isinstance(driver, str) and driver) or is_driver(driver):
            drivers[entity] = told_driver(driver)
        else:
            raise InputError(f"`drivers` {entity}={shown(driver)}: give the name of a driver, or an instance.")
    for entity, command in suite.lost_drivers.items():
        if entity not in drivers:
            name = plain_text(command) or "an object that Python code made"
            raise InputError(
                f"`drivers`: {name} drove {entity} when {suite.place} was made, and code named in a file is not run;"
                f" give a driver, as {entity}={plain_text(command) or 'normal'}."
            )
    return drivers


def _meta(
    suite: SuiteContents,
    who: tuple[str, tuple[str, ...]],
    metrics: tuple[str, ...],
    requirements: Sequence[Requirement],
    simulator: str,
    settings: Mapping[str, object],
    study: Path,
) -> StudyMeta:
    kinds = tuple(item.kind for item in suite.scenarios)
    # The threshold belongs to the first metric.
    critical = suite.critical if suite.metrics[:1] == metrics[:1] else METRICS.create(metrics[0]).critical
    return StudyMeta(
        scenario=stored_path(suite.folder, study),
        fingerprint=suite.usable[0].scenario.fingerprint(),
        space=suite.space,
        ego=who[0],
        other=who[1][0] if len(who[1]) == 1 else who[1],
        metrics=metrics,
        optimizer="none",
        simulator=without_folders(simulator),
        settings=settings,
        critical=critical,
        budget=len(suite.scenarios),
        batch=len(suite.scenarios),
        files=tuple(item.file for item in suite.scenarios),
        kinds=kinds if any(kinds) else (),
        requirements=tuple(item.text for item in requirements),
        suite=suite.digest,
        origin=suite.fingerprint,
    )


def _result(
    suite: SuiteContents, study: Study, requirements: list[Requirement], origin: Path | None, why_not: str
) -> SuiteResult:
    differences = {} if origin is None else find_differences(suite, origin, study)
    against = {name: study.against(name) for name in study.meta.metrics if len(study.meta.others) > 1}
    scenarios = []
    for row, scenario in zip(study.rows(), suite.scenarios, strict=True):
        verdicts = judge_row(study, row, requirements)
        failed = row.state == "failed"
        duration = None
        if not failed:
            time = study.recording(row.id).time
            duration = float(time[-1] - time[0])
        if not requirements:
            verdicts = [_ran(row.error if failed else None, duration)]
        scenarios.append(
            ScenarioResult(
                id=row.id,
                file=scenario.file,
                state="error" if failed else worst_state(verdicts),
                values=dict(row.values),
                scores=study.scores_of(row.id),
                duration=duration,
                verdicts=tuple(verdicts),
                kind=scenario.kind,
                role=scenario.role,
                why=scenario.why,
                origin=scenario.origin,
                difference=differences.get(row.id),
                others={
                    name: entity for name, entities in against.items() if (entity := entities.get(row.id)) is not None
                },
            )
        )
    return SuiteResult(
        study=study.path,
        suite=suite.place,
        simulator=study.meta.simulator,
        requirements=study.meta.requirements,
        scenarios=tuple(scenarios),
        against=origin,
        why_not_compared=why_not,
    )


def _ran(error: str | None, duration: float | None) -> Verdict:
    if duration is None:
        return Verdict("inconclusive", _RAN, f"it failed: {error}")
    return Verdict("passed", _RAN, f"it ran for {duration:.6g} s", value=duration)
