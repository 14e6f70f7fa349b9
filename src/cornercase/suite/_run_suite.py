"""Run a suite and judge its scenarios."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final, Unpack

from cornercase._common.errors import InputError
from cornercase._common.io.files import check_output_differs_from_source, check_output_is_not_study, check_writable_file
from cornercase._common.option import check_options, document_options
from cornercase._common.process.dask import open_connection
from cornercase._common.text.sanitize import escape_control_characters, remove_folders
from cornercase._common.validation import check_bool, check_mapping, check_str, check_str_sequence
from cornercase._common.validation import check_path as path_argument
from cornercase.drivers import Driver
from cornercase.drivers._resolve import DriverLike, check_drivers, refuse_program_driver, resolve_driver
from cornercase.drivers._serialization import require_storable_drivers
from cornercase.exploration._explore_options import OPTIONS
from cornercase.metrics import METRICS, Expression, Metric
from cornercase.metrics._critical_if import find_critical_if_condition
from cornercase.metrics._expression import format_as_formula
from cornercase.metrics._other_entities import ALL_OTHERS, resolve_others
from cornercase.metrics._own_metrics import resolve_metrics
from cornercase.simulators import Simulator
from cornercase.simulators._create import create_simulator
from cornercase.simulators._results import describe_file_error
from cornercase.simulators._run_notices import find_driver_in_files
from cornercase.simulators._run_options import RUN_OPTIONS, RunKeywords
from cornercase.study import StudyFile, StudyMeta
from cornercase.study._meta import metric_fields
from cornercase.study._stored_paths import format_stored_path
from cornercase.suite._baseline import compare_with_baseline, find_baseline_study, find_changed_driver
from cornercase.suite._driver_values import assign_driver_values
from cornercase.suite._judge import judge_scenario
from cornercase.suite._junit import JUNIT_START, write_junit
from cornercase.suite._markdown import SUMMARY_START, write_markdown_summary
from cornercase.suite._mutation_analysis import analyze_suite_mutants, draw_mutants, require_builtin_simulator
from cornercase.suite._read_suite import read_suite
from cornercase.suite._requirement import Requirement
from cornercase.suite._requirement_files import read_requirements, requirements_from_runner_criteria
from cornercase.suite._run_scenarios import mark_unsupported, run_pending_scenarios, run_reference_drivers
from cornercase.suite._suite_contents import DEFAULT_SETTINGS, SuiteContents
from cornercase.suite._suite_result import ScenarioResult, SuiteResult
from cornercase.suite._verdict import Verdict, worst_state

_RAN_REQUIREMENT: Final = "runs"
# Bytes of an earlier output that show who wrote it.
_MAX_START_BYTES: Final = 500


class SuiteKeywords(RunKeywords, total=False):
    """Keyword arguments of `run_suite`: settings that replace those of the suite, and options such as `workers`."""

    ego: str | None
    other: str | Sequence[str] | None
    metrics: Metric | str | Sequence[Metric | str]
    simulator: str | None
    time_step: float | None
    duration: float | None
    on_collision: str | None
    drivers: Mapping[str, DriverLike] | None


SUITE_OPTIONS: Final = {name: OPTIONS[name] for name in SuiteKeywords.__annotations__}
for _name in ("ego", "other", "metrics", "simulator", *DEFAULT_SETTINGS):
    SUITE_OPTIONS[_name] = OPTIONS[_name].with_default_of("as in the manifest")


@document_options(SUITE_OPTIONS)
def run_suite(
    suite: Path | str,
    study: Path | str,
    *,
    require: Sequence[str | Expression | Requirement] = (),
    requirements: Path | str | None = None,
    require_from_file: bool = False,
    against: Path | str | None = None,
    junit: Path | str | None = None,
    summary: Path | str | None = None,
    mutants: int | None = None,
    seed: int = 0,
    progress: bool = False,
    **options: Unpack[SuiteKeywords],
) -> SuiteResult:
    """Run the scenarios of a suite again, judge them, and compare them with the earlier recordings.

    Each scenario is stored as soon as it has ended. The same call again resumes an interrupted run. The same call with
    other requirements judges the stored recordings, unless these name a metric of the ego alone that the run did not
    measure.

    Parameters
    ----------
    suite : path
        Folder of a reduced set or its manifest, or any folder of concrete scenarios.
    study : path
        Study to create or continue.
    require : sequence of str, Expression or Requirement
        Requirements on each scenario, as `cornercase.suite.Requirement.parse` reads them.
    requirements : path, optional
        TOML or YAML file with further requirements.
    require_from_file : bool, default False
        Make requirements from the criteria for CARLA's ScenarioRunner that the scenario files contain. A notice names
        criteria that a recording cannot decide.
    against : path, optional
        Study with earlier recordings: the study that was reduced, or an earlier run of the suite. By default the study
        that was reduced, if it is beside the manifest or in the folder above.
    junit : path, optional
        JUnit file to write. A JUnit file of an earlier run is removed before anything is run; any other file at this
        path raises `InputError`.
    summary : path, optional
        Markdown file to write. A file of an earlier run is removed before anything is run; any other file at this path
        raises `InputError`.
    mutants : int, optional
        Number of mutants (faulty variants) of the ego's driver. The builtin simulator runs the scenarios with each
        mutant, to count how many mutants are killed. A scenario kills a mutant if the mutant violates a requirement and
        the original driver violates none. If there are no requirements, ``"no collision"`` is required. Runs of mutants
        are not stored.
    seed : int, default 0
        The same seed gives the same mutants; see `cornercase.drivers.generate_mutants`.
    progress : bool, default False
        Show progress on standard error.
    **options
        Any of the parameters below. They replace settings of the manifest, or say how the scenarios are run. Without a
        manifest, the metrics are those that the requirements contain, or else ``clearance``, and the simulator is the
        builtin one with its default settings.

    Returns
    -------
    SuiteResult

    Other Parameters
    ----------------
    OPTIONS

    Raises
    ------
    InputError
        An argument or file cannot be used, a file that the manifest lists is missing or has changed, no scenario can be
        run, or the study belongs to another suite or other settings.

    Warns
    -----
    NoticeWarning
        Something in the files has no effect in the simulator.

    Examples
    --------
    >>> import cornercase as cc
    >>> result = cc.run_suite("reduced", "run.db", require=["no collision"], junit="run.xml")  # doctest: +SKIP
    >>> result.table()  # doctest: +SKIP
    """
    given = check_options("run_suite", SUITE_OPTIONS, options)
    path = path_argument("study", study)
    parsed = _parse_requirements(require, requirements)
    contents = read_suite(suite)
    if check_bool("require_from_file", require_from_file):
        parsed = _remove_duplicates([*parsed, *requirements_from_runner_criteria(contents)])
    source, why = find_baseline_study(contents, None if against is None else path_argument("against", against))
    requirements_file = None if requirements is None else path_argument("requirements", requirements)
    read = [*contents.files, *(item for item in (source, requirements_file) if item is not None)]
    for item in read:
        check_output_differs_from_source(path, item)
    outputs = _prepare_outputs(junit, summary, path, read)
    contents, entities = _resolve_entities(contents, given["ego"], given["other"], parsed, given["drivers"])
    settings = {
        name: contents.settings.get(name, default) if given[name] is None else given[name]
        for name, default in DEFAULT_SETTINGS.items()
    }
    name = _choose_simulator(contents, given["simulator"])
    settings["drivers"] = _resolve_drivers(contents, given["drivers"])
    contents = assign_driver_values(contents, name, settings["drivers"])
    if mutants is not None:
        # Check before anything is run.
        require_builtin_simulator(str(name))
        driver_and_mutants = draw_mutants(contents, entities[0], settings["drivers"], parsed, mutants, seed)
    reference_names = dict.fromkeys(name for item in parsed for name in item.expression.reference_drivers)
    runs = {name: given[name] for name in RUN_OPTIONS}
    with open_connection(runs["cluster"], runs["workers"]) as client:
        if client is not None:
            runs |= {"cluster": client, "workers": 1}
        start: Callable[..., Simulator] = partial(create_simulator, name, ego=entities[0], **runs)
        with start(settings) as started, ExitStack() as stack:
            contents = mark_unsupported(contents, started)
            references = {
                item: stack.enter_context(_create_reference_simulator(start, settings, entities[0], item))
                for item in reference_names
            }
            metrics = _choose_metrics(contents, given["metrics"] or _read_metrics(path, contents), parsed)
            meta = _build_meta(contents, entities, metrics, parsed, str(name), started.settings, path)
            driver_in_file = find_driver_in_files(
                started, (item.scenario for item in contents.runnable_scenarios), meta.ego
            )
            meta = replace(meta, driver_in_file=driver_in_file)
            n_parallel = runs["workers"] if client is None else None
            n_before = run_pending_scenarios(
                contents, meta, metrics, started, path, n_parallel, check_bool("progress", progress)
            )
            if references:
                with StudyFile.open(path, readonly=False) as opened:
                    run_reference_drivers(contents, opened, parsed, references)
        with StudyFile.open(path, readonly=True) as opened:
            result = replace(_build_result(contents, opened, parsed, source, why), n_ran_before=n_before)
        for write, target in outputs:
            write(result, target)
        if mutants is not None:
            kills = analyze_suite_mutants(
                contents, entities, driver_and_mutants, parsed, settings, client=client, progress=progress
            )
            result = replace(result, kill_matrix=kills)
    return result


def _create_reference_simulator(
    factory: Callable[..., Simulator], options: dict[str, Any], ego: str, reference: str
) -> Simulator:
    try:
        refuse_program_driver(reference)
        return factory(options | {"drivers": {**options["drivers"], ego: resolve_driver(reference)}})
    except InputError as error:
        raise InputError(f"`require` names the reference driver {reference}: {error}") from error


def _prepare_outputs(
    junit: Path | str | None, summary: Path | str | None, study: Path, inputs: Sequence[Path]
) -> list[tuple[Callable[[SuiteResult, Path], None], Path]]:
    """Return writer and path of the JUnit and Markdown files, if requested; files of an earlier run are removed."""
    targets: list[tuple[Callable[[SuiteResult, Path], None], Path]] = []
    outputs = (("junit", junit, write_junit, JUNIT_START), ("summary", summary, write_markdown_summary, SUMMARY_START))
    for name, target, write, start in outputs:
        if target is None:
            continue
        file = path_argument(name, target)
        for source in inputs:
            check_output_differs_from_source(file, source, name)
        # Check before hours of simulations.
        check_writable_file(name, file)
        check_output_is_not_study(file, study, name)
        _require_own_output(name, file, start)
        if any(file.resolve() == other.resolve() for _, other in targets):
            raise InputError(f"`{name}` {file}: is the JUnit file too; choose another name.")
        targets.append((write, file))
    for _, file in targets:
        # Remove outputs of earlier runs, which would remain if no scenario can be run.
        file.unlink(missing_ok=True)
    return targets


def _require_own_output(name: str, path: Path, start: re.Pattern[bytes]) -> None:
    """Raise `InputError` if a file exists that no earlier run wrote, so that no other content is overwritten."""
    if path.exists():
        with path.open("rb") as file:
            content = file.read(_MAX_START_BYTES)
        if content and not start.match(content):
            raise InputError(
                f"`{name}` {path}: exists and is not from an earlier run; choose another name, or remove the file."
            )


def _parse_requirements(
    require: Sequence[str | Expression | Requirement], requirements: Path | str | None
) -> list[Requirement]:
    if isinstance(require, list | tuple):
        require = [format_as_formula(item) if isinstance(item, Expression) else item for item in require]
        require = [item.text if isinstance(item, Requirement) else item for item in require]
    parsed = [Requirement.parse(item) for item in check_str_sequence("require", require)]
    if requirements is not None:
        parsed += read_requirements(path_argument("requirements", requirements))
    return _remove_duplicates(parsed)


def _remove_duplicates(requirements: Sequence[Requirement]) -> list[Requirement]:
    return list({requirement.text: requirement for requirement in requirements}.values())


def _resolve_entities(
    suite: SuiteContents,
    ego: str | None,
    other: str | Sequence[str] | None,
    requirements: Sequence[Requirement],
    drivers: Mapping[str, object],
) -> tuple[SuiteContents, tuple[str, tuple[str, ...]]]:
    """Return the suite with an error on each scenario that lacks an entity, and the names of the ego and the others."""
    for role, given, own in (("ego", ego, suite.ego), ("other", other, suite.other)):
        if given is None and not own:
            raise InputError(f"`{role}`: {suite.path} does not say which entity this is; name an entity.")
    ego_name = suite.ego if ego is None else check_str("ego", ego)
    suite = _mark_lacking_entity(suite, {})
    names = dict.fromkeys(name for item in suite.runnable_scenarios for name in item.scenario.entities)
    others = resolve_others(suite.other if other is None else other, ego_name, list(names))
    roles = {ego_name: "ego"} | dict.fromkeys(others, "other")
    if other is not None and ALL_OTHERS in check_str_sequence("other", other):
        # Not every file needs to have all of them.
        roles = {ego_name: "ego"}
    roles |= {name: "entity to avoid" for item in requirements for name in item.expression.entities}
    roles |= dict.fromkeys(check_mapping("drivers", drivers), "driven entity")
    suite = _mark_lacking_entity(suite, roles)
    for required in requirements:
        if ego_name in required.expression.entities:
            raise InputError(f"`require` {required}: names the ego itself; name another entity.")
        if not any(required.applies_to(item.file_name, item.cluster_name) for item in suite.scenarios):
            raise InputError(f"`require` {required}: {_describe_no_match(suite, required)}.")
    return suite, (ego_name, others)


def _mark_lacking_entity(suite: SuiteContents, role_by_entity: Mapping[str, str]) -> SuiteContents:
    """Return the suite with an error on each scenario that lacks an entity; raise `InputError` if all scenarios do.

    `role_by_entity` maps the name of each required entity to its role, for messages.
    """
    lacking: dict[str, InputError] = {}
    for scenario in suite.runnable_scenarios:
        try:
            _ = scenario.scenario.entities
            for name, role in role_by_entity.items():
                scenario.scenario.require_entity(name, role)
        except InputError as error:
            lacking[scenario.file_name] = error
    if lacking and len(lacking) == len(suite.runnable_scenarios):
        raise next(iter(lacking.values()))
    scenarios = tuple(
        replace(scenario, error=describe_file_error(scenario.scenario.path, lacking[scenario.file_name]))
        if scenario.file_name in lacking
        else scenario
        for scenario in suite.scenarios
    )
    return replace(suite, scenarios=scenarios)


def _describe_no_match(suite: SuiteContents, requirement: Requirement) -> str:
    if not requirement.is_for_clusters:
        return f"no file of {suite.path} has such a name"
    kinds = dict.fromkeys(scenario.cluster_name for scenario in suite.scenarios if scenario.cluster_name)
    if not kinds:
        return f"{suite.path} does not name the clusters of its scenarios"
    return f"no scenario of {suite.path} belongs to such a cluster; the clusters are {'; '.join(kinds)}"


def _read_metrics(path: Path, suite: SuiteContents) -> tuple[str, ...]:
    """Return the metrics of a study with an earlier run of the suite; empty without one, or if it cannot be used."""
    if not path.is_file():
        return ()
    with suppress(InputError), StudyFile.open(path, readonly=True) as study:
        is_known = all(name.partition(":")[0] in METRICS for name in study.meta.metrics)
        if is_known and study.meta.suite == suite.content_hash and any(row.state != "pending" for row in study.rows()):
            return study.meta.metrics
    return ()


def _choose_metrics(
    suite: SuiteContents, requested: Metric | str | Sequence[Metric | str], requirements: Sequence[Requirement]
) -> list[Metric]:
    # A condition would need further runs with reference drivers.
    names = [name for name in suite.metrics if not find_critical_if_condition([name])]
    unknown = [name for name in names if name.partition(":")[0] not in METRICS]
    if unknown and not requested:
        raise InputError(
            f"`metrics`: {suite.path} names the metric '{unknown[0][:100]}', which cornercase does not have; code that"
            " a file names is not run, so give all metrics again, and your own metric as an object."
        )
    required = [name for requirement in requirements for name in requirement.expression.metrics]
    instances = resolve_metrics(requested or names or required or "clearance")
    needed = [METRICS.create(name) for name in dict.fromkeys(required)]
    # Check before the study is created.
    for metric in [*instances, *needed]:
        metric.check_installed()
    # Stored recordings have no roads, so metrics of the ego alone are measured during the run.
    names = [metric.name for metric in instances]
    return [*instances, *(metric for metric in needed if metric.ego_only and metric.name not in names)]


def _choose_simulator(suite: SuiteContents, requested: str | Simulator | None) -> str | Simulator:
    if requested is not None:
        return requested if isinstance(requested, Simulator) else check_str("simulator", requested)
    name, colon, _ = suite.simulator.partition(":")
    # Options may name files and programs; the manifest may come from anywhere.
    if colon:
        raise InputError(
            f"`simulator`: {suite.path} names '{suite.simulator[:100]}', and these options could run programs; give"
            " `simulator` yourself."
        )
    return name or "builtin"


def _resolve_drivers(suite: SuiteContents, requested: Mapping[str, DriverLike] | None) -> dict[str, str | Driver]:
    drivers = {entity: resolve_driver(driver) for entity, driver in check_drivers(requested).items()}
    require_storable_drivers(drivers)
    for entity, command in suite.custom_drivers.items():
        if entity not in drivers:
            name = escape_control_characters(command)
            raise InputError(
                f"`drivers`: {suite.path} names the driver {name or 'an object that Python code made'} for {entity},"
                f" but code named in a file is not run; give the driver, as in {{{entity!r}: {name or 'normal'!r}}}."
            )
    return drivers


def _build_meta(
    suite: SuiteContents,
    entities: tuple[str, tuple[str, ...]],
    metrics: Sequence[Metric],
    requirements: Sequence[Requirement],
    simulator: str,
    settings: Mapping[str, object],
    study: Path,
) -> StudyMeta:
    kinds = tuple(item.cluster_name for item in suite.scenarios)
    # The threshold belongs to the first metric.
    critical = suite.critical if suite.metrics[:1] == (metrics[0].name,) else metrics[0].default_threshold
    return StudyMeta(
        scenario=format_stored_path(suite.folder, study),
        fingerprint=suite.runnable_scenarios[0].scenario.fingerprint(),
        space=suite.space,
        ego=entities[0],
        other=entities[1][0] if len(entities[1]) == 1 else entities[1],
        **metric_fields(metrics),
        optimizer="none",
        simulator=remove_folders(simulator),
        settings=settings,
        critical=critical,
        budget=len(suite.scenarios),
        batch=len(suite.scenarios),
        files=tuple(item.file_name for item in suite.scenarios),
        kinds=kinds if any(kinds) else (),
        requirements=tuple(item.text for item in requirements),
        suite=suite.content_hash,
        origin=suite.fingerprint,
    )


def _build_result(
    suite: SuiteContents,
    study: StudyFile,
    requirements: list[Requirement],
    baseline: Path | None,
    no_baseline_reason: str,
) -> SuiteResult:
    differences = {} if baseline is None else compare_with_baseline(suite, baseline, study)
    changed_driver = None if baseline is None else find_changed_driver(baseline, study)
    against = {name: study.score_sources(name) for name in study.meta.metrics if len(study.meta.others) > 1}
    scenarios = []
    for row, scenario in zip(study.rows(), suite.scenarios, strict=True):
        verdicts = judge_scenario(study, row, requirements)
        failed = row.state == "failed"
        duration = None
        ran = Verdict("inconclusive", _RAN_REQUIREMENT, f"it failed: {row.error}")
        if not failed:
            recording = study.recording(row.id)
            duration = float(recording.time[-1] - recording.time[0])
            collision = next((hit for hit in recording.collisions if study.meta.ego in hit.entities), None)
            hit = "" if collision is None else f", with a collision at {collision.time:.6g} s"
            ran = Verdict("passed", _RAN_REQUIREMENT, f"it ran for {duration:.6g} s{hit}", value=duration)
        if not requirements:
            verdicts = [ran]
        scenarios.append(
            ScenarioResult(
                id=row.id,
                file=scenario.file_name,
                state="error" if failed else worst_state(verdicts),
                values=dict(row.values),
                scores=study.scenario_scores(row.id),
                duration=duration,
                verdicts=tuple(verdicts),
                kind=scenario.cluster_name,
                role=scenario.role,
                why=scenario.selection_reason,
                origin=scenario.source_id,
                difference=differences.get(row.id),
                others={
                    name: entity for name, entities in against.items() if (entity := entities.get(row.id)) is not None
                },
            )
        )
    return SuiteResult(
        study=study.path,
        suite=suite.path,
        simulator=study.meta.simulator,
        requirements=study.meta.requirements,
        scenarios=tuple(scenarios),
        against=baseline,
        changed_driver=changed_driver,
        no_comparison_reason=no_baseline_reason,
    )
