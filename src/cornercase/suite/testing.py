"""From a reduced set to verdicts."""

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
from cornercase.suite.junit import JUNIT, write_junit
from cornercase.suite.origin import find_differences, find_origin
from cornercase.suite.reading import read_suite
from cornercase.suite.requirement import Requirement
from cornercase.suite.requirement_files import read_requirements
from cornercase.suite.result import ScenarioResult, SuiteResult
from cornercase.suite.running import run_suite, sort_out
from cornercase.suite.summary import HEADING, write_summary
from cornercase.suite.verdict import Verdict, worst_state
from cornercase.suite.verdicts import judge_row

if TYPE_CHECKING:
    from distributed import Client

_PLAIN: Final[dict[str, Any]] = {"time_step": 0.05, "duration": 60.0, "on_collision": "continue"}
_BUILTIN: Final = "builtin"
_RAN: Final = "runs"


# Its parameters are the options of the command.
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
    """Run the scenarios of a suite again, judge them, and compare them with those that they were kept from.

    Each scenario is stored the moment it has ended. The same call again goes on where it stopped; with other
    requirements it judges what has run.

    Parameters
    ----------
    suite : path
        Folder of a reduced set or its manifest, or any folder of concrete scenarios.
    study : path
        Study to write or continue.
    require : sequence of str
        What each scenario has to fulfil, as `cornercase.suite.Requirement.parse` reads it.
    requirements : path, optional
        TOML or YAML file with more of them.
    require_from_file : bool, default False
        Take the criteria of ScenarioRunner that the scenarios ask for as requirements, where a recording can tell; a
        notice names the others.
    ego : str, optional
        Name of the entity under test; by default that of the manifest.
    other : str or sequence of str, optional
        Whom it is measured against; of several the one counts to whom it is most critical, and ``"*"`` stands for all
        others in the files. By default as in the manifest.
    metrics : sequence of str
        Criticality metrics that are stored; by default those of the manifest, without one those that the requirements
        speak of, or else the clearance.
    simulator : str, optional
        By default that of the manifest; without one the builtin simulator.
    workers : int, default 1
        Simulators side by side.
    cluster : str or distributed.Client, optional
        Dask cluster to run on: ``"local"`` for `workers` processes here, the address of a scheduler, the file that a
        scheduler wrote, or a connection, which stays open.
    timeout : float, optional
        Time in s after which a scenario is given up.
    retries : int, default 1
        How often a scenario is run again after the simulator died or hung.
    max_failures : int, default 5
        Scenarios in a row in which the simulator dies or hangs, after which nothing more is run; 0 for no limit.
    time_step, duration : float, optional
        s; by default those of the manifest, without one 0.05 s and 60 s.
    on_collision : {"continue", "stop"}, optional
        What a collision does to the run; by default as in the manifest, without one it goes on.
    drivers : mapping of str to str or Driver, optional
        Who drives, by entity: a preset or ``package.module:Class``, either with options after a colon, or a driver. By
        default what the files say.
    against : path, optional
        Study with earlier recordings: the one that was reduced, or another run of the suite. By default the former,
        where it lies beside the manifest or in the folder above.
    junit : path, optional
        JUnit file to write. One that is there is removed before anything is run; anything else is refused.
    summary : path, optional
        File with a table in Markdown to write, in place of one that is there, as with `junit`.
    mutants : int, optional
        Run the scenarios with so many mutants of the ego's driver besides, in the builtin simulator: how many of them
        fail a requirement, or collide where there is none, in a scenario in which the driver does not? They are not
        stored, but run again each time.
    seed : int, default 0
        The same seed gives the same mutants, as `cornercase.drivers.mutants_of` draws them.
    progress : bool, default False
        Show how far it is on standard error.

    Returns
    -------
    SuiteResult

    Raises
    ------
    InputError
        Something cannot be used, a file of the manifest is gone or has changed, none of the scenarios can be run, or
        the study is of something else.

    Warns
    -----
    NoticeWarning
        Something in the files has no effect in the simulator.
    """
    path = path_argument("study", study)
    known = _required(require, requirements)
    contents = read_suite(suite)
    if flag("require_from_file", require_from_file):
        known = _distinct([*known, *required_by_files(contents)])
    found, why_not = find_origin(contents, None if against is None else path_argument("against", against))
    given_file = None if requirements is None else path_argument("requirements", requirements)
    read = [*contents.files, *(one for one in (found, given_file) if one is not None)]
    for one in read:
        require_other_file(path, one)
    outputs = _outputs(junit, summary, path, read)
    contents, who = _entities(contents, ego, other, known, drivers or {})
    workers = whole_number("workers", workers, 1, MOST_WORKERS)
    options = {name: contents.settings.get(name, plain) for name, plain in _PLAIN.items()}
    given = {"time_step": time_step, "duration": duration, "on_collision": on_collision}
    options |= {name: value for name, value in given.items() if value is not None}
    name = _simulator(contents, simulator)
    options["drivers"] = _drivers(contents, drivers)
    if mutants is not None:
        # Looked at before anything is run.
        require_builtin(name)
        drawn = draw_mutants(contents, who[0], options["drivers"], known, mutants, seed)
    asked = dict.fromkeys(one.reference for one in known if one.reference)
    with connected(cluster, workers) as client:
        start: Callable[..., Simulator] = partial(start_simulator, name, ego=who[0], timeout=timeout, retries=retries)
        start = partial(start, max_failures=max_failures)
        start = partial(start, workers=workers) if client is None else partial(start, cluster=client)
        with start(options) as started, ExitStack() as stack:
            contents = sort_out(contents, started)
            references = {one: stack.enter_context(_with_reference(start, options, who[0], one)) for one in asked}
            meta = _meta(contents, who, _metrics(contents, metrics, known), known, name, started.settings, path)
            side_by_side = workers if client is None else None
            before = run_suite(contents, meta, started, path, side_by_side, flag("progress", progress))
            if references:
                with Study.open(path, readonly=False) as opened:
                    ask_references(contents, opened, known, references)
        with Study.open(path, readonly=True) as opened:
            result = replace(_result(contents, opened, known, found, why_not), ran_before=before)
        for write, place in outputs:
            write(result, place)
        if mutants is not None:
            exposure = expose_suite(contents, who, drawn, known, options, client=client, progress=progress)
            result = replace(result, exposure=exposure)
    return result


def _with_reference(start: Callable[..., Simulator], options: dict[str, Any], ego: str, reference: str) -> Simulator:
    try:
        return start(options | {"drivers": {**options["drivers"], ego: told_driver(reference)}})
    except InputError as error:
        raise InputError(f"`require` no collision unless {reference} collides: {error}") from error


def _outputs(
    junit: Path | str | None, summary: Path | str | None, study: Path, read: Sequence[Path]
) -> list[tuple[Callable[[SuiteResult, Path], None], Path]]:
    """What is to be written besides the study, once nothing of another run stands there."""
    found: list[tuple[Callable[[SuiteResult, Path], None], Path]] = []
    outputs = (("junit", junit, write_junit, JUNIT), ("summary", summary, write_summary, HEADING))
    for name, given, write, begin in outputs:
        if given is not None:
            place = path_argument(name, given)
            for one in read:
                require_other_file(place, one, name)
            # Not after an hour of simulations.
            require_place(name, place)
            require_apart(place, study, name)
            _require_own(name, place, begin)
            if any(place.resolve() == other.resolve() for _, other in found):
                raise InputError(f"`{name}` {place}: is the JUnit file, too; choose another name.")
            found.append((write, place))
    for _, place in found:
        # What is there is of another run, and would be taken for one of this where nothing can be run.
        place.unlink(missing_ok=True)
    return found


def _require_own(name: str, place: Path, begin: bytes) -> None:
    """Refuse to write over a file that no earlier run wrote, as that may be somebody's only copy of what is in it."""
    if place.exists():
        with place.open("rb") as file:
            content = file.read(len(begin))
        if content and content != begin:
            raise InputError(f"`{name}` {place}: holds something else already; choose another name, or remove it.")


def _required(require: Sequence[str], requirements: Path | str | None) -> list[Requirement]:
    known = [Requirement.parse(one) for one in texts("require", require)]
    if requirements is not None:
        known += read_requirements(path_argument("requirements", requirements))
    return _distinct(known)


def _distinct(requirements: Sequence[Requirement]) -> list[Requirement]:
    """Requirements, of which what stands twice counts once."""
    return list({one.text: one for one in requirements}.values())


def _entities(
    suite: SuiteContents,
    ego: str | None,
    other: str | Sequence[str] | None,
    requirements: Sequence[Requirement],
    drivers: Mapping[str, object],
) -> tuple[SuiteContents, tuple[str, tuple[str, ...]]]:
    """Names of the ego and of the others; of files that lack one that is named, but not all do, say that they do."""
    for role, given, own in (("ego", ego, suite.ego), ("other", other, suite.other)):
        if given is None and not own:
            raise InputError(f"`{role}`: {suite.place} does not say it; name an entity.")
    tested = suite.ego if ego is None else text("ego", ego)
    suite = _only_with(suite, {})
    known = dict.fromkeys(name for one in suite.usable for name in one.scenario.entities)
    others = name_others(suite.other if other is None else other, tested, list(known))
    asked = {tested: "ego"} | dict.fromkeys(others, "other")
    if other is not None and EVERYBODY in texts("other", other):
        # They need not all be in each file.
        asked = {tested: "ego"}
    asked |= {one.entity: "one that must not be touched" for one in requirements if one.entity}
    asked |= dict.fromkeys(by_name("drivers", drivers), "driven entity")
    suite = _only_with(suite, asked)
    for required in requirements:
        if required.entity == tested:
            raise InputError(f"`require` {required}: is the ego itself; name another entity.")
        if not any(required.concerns(one.file, one.kind) for one in suite.scenarios):
            raise InputError(f"`require` {required}: {_none_concerned(suite, required)}.")
    return suite, (tested, others)


def _only_with(suite: SuiteContents, asked: Mapping[str, str]) -> SuiteContents:
    """Say of the scenarios of a suite which lack an entity, by its role; if all do, the first is refused."""
    lacking: dict[str, InputError] = {}
    for one in suite.usable:
        try:
            _ = one.scenario.entities
            for name, role in asked.items():
                one.scenario.require_entity(name, role)
        except InputError as error:
            lacking[one.file] = error
    if lacking and len(lacking) == len(suite.usable):
        raise next(iter(lacking.values()))
    scenarios = tuple(
        replace(one, wrong=failure_words(one.scenario.path, lacking[one.file])) if one.file in lacking else one
        for one in suite.scenarios
    )
    return replace(suite, scenarios=scenarios)


def _none_concerned(suite: SuiteContents, required: Requirement) -> str:
    if not required.by_kind:
        return f"none of the files of {suite.place} is called so"
    kinds = dict.fromkeys(one.kind for one in suite.scenarios if one.kind)
    if not kinds:
        return f"{suite.place} does not say of what kinds its scenarios are"
    return f"none of the scenarios of {suite.place} is of such a kind; there are {'; '.join(kinds)}"


def _metrics(suite: SuiteContents, given: Sequence[str], requirements: Sequence[Requirement]) -> tuple[str, ...]:
    # A condition needs runs of references beside those of the suite.
    names = list(texts("metrics", given)) or [name for name in suite.metrics if not condition_of([name])]
    asked = [name for one in requirements if one.formula is not None for name in one.formula.metrics]
    made = [METRICS.create(name) for name in dict.fromkeys(names or asked or ["clearance"])]
    # Asked before there is a study.
    for metric in [*made, *map(METRICS.create, asked)]:
        metric.require()
    for one in requirements:
        if one.formula is not None:
            one.formula.require()
    return tuple(metric.name for metric in made)


def _simulator(suite: SuiteContents, given: str | None) -> str:
    if given is not None:
        return text("simulator", given)
    name, colon, _ = suite.simulator.partition(":")
    # Options may name files and programs, and a manifest may come from anywhere.
    if colon:
        raise InputError(
            f"`simulator`: {suite.place} names '{suite.simulator[:100]}', with options; give the simulator yourself."
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
            who = plain_text(command) or "an object that Python code made"
            raise InputError(
                f"`drivers`: {who} drove {entity} when {suite.place} was made, and a file is no reason to run code;"
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
    kinds = tuple(one.kind for one in suite.scenarios)
    # The threshold is one of the first metric.
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
        files=tuple(one.file for one in suite.scenarios),
        kinds=kinds if any(kinds) else (),
        requirements=tuple(one.text for one in requirements),
        suite=suite.digest,
        origin=suite.fingerprint,
    )


def _result(
    suite: SuiteContents, study: Study, requirements: list[Requirement], origin: Path | None, why_not: str
) -> SuiteResult:
    differences = {} if origin is None else find_differences(suite, origin, study)
    against = {name: study.against(name) for name in study.meta.metrics if len(study.meta.others) > 1}
    scenarios = []
    for row, one in zip(study.rows(), suite.scenarios, strict=True):
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
                file=one.file,
                state="error" if failed else worst_state(verdicts),
                values=dict(row.values),
                scores=study.scores_of(row.id),
                duration=duration,
                verdicts=tuple(verdicts),
                kind=one.kind,
                role=one.role,
                why=one.why,
                origin=one.origin,
                difference=differences.get(row.id),
                others={name: whom for name, of in against.items() if (whom := of.get(row.id)) is not None},
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
        return Verdict("inconclusive", _RAN, f"it could not be run: {error}")
    return Verdict("passed", _RAN, f"it ran for {duration:.6g} s", value=duration)
