"""Runs of many concrete scenarios, with a recording of each in a folder."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Unpack

from cornercase._common import validation
from cornercase._common.errors import InputError, SimulationError
from cornercase._common.io.files import check_output_differs_from_source, check_output_folder, make_portable_file_name
from cornercase._common.io.support_table import deduplicate_notices, warn_notices
from cornercase._common.option import check_options, document_options
from cornercase._common.plugin_errors import group_failure_messages
from cornercase._common.process.signals import collect_interrupts
from cornercase._common.progress import ProgressBar
from cornercase._common.text.element_locations import prefix_file
from cornercase.drivers._resolve import resolve_driver
from cornercase.scenario import ConcreteScenario, Value
from cornercase.scenario._file import ScenarioFile
from cornercase.scenario._value_table import FILE_COLUMN, read_value_table
from cornercase.simulators._base import COMMON_OPTIONS, Simulator
from cornercase.simulators._common_options import split_common_options
from cornercase.simulators._create import create_simulator
from cornercase.simulators._driver_parameters import check_driver_parameters
from cornercase.simulators._output_folder import NOTES_FILE, TABLE_FILE, PlannedRecording, RecordingsFolder
from cornercase.simulators._results import (
    check_simulator_accepts,
    describe_file_error,
    find_refusals,
    list_ignored_content,
    run_scenarios,
)
from cornercase.simulators._run_notices import RunNotices
from cornercase.simulators._run_options import SIMULATION_OPTIONS, SimulationKeywords

_CSV_SUFFIX: Final = ".csv"
# Scenarios per parallel simulator and batch. More gains little, and keeps unwritten recordings in memory.
_BATCH_SIZE: Final = 100


@dataclass(frozen=True)
class SimulatedFolder:
    """Result of running many concrete scenarios.

    Attributes
    ----------
    folder : Path
        Folder of the recordings.
    done : int
        Number of scenarios whose recording is in the folder, including recordings that existed before.
    n_existing : int
        Number of recordings that existed before and were not made again.
    failures : mapping of str to str
        Reasons why recordings are missing, by file name.

    Examples
    --------
    >>> import cornercase as cc
    >>> simulated = cc.simulate_many("examples/x_intersection/x_intersection.xosc", "runs", duration=1.0)
    >>> simulated.done, simulated.failed, (simulated.folder / "x_intersection.csv").exists()
    (1, 0, True)
    """

    folder: Path
    done: int
    n_existing: int
    failures: Mapping[str, str] = field(default_factory=dict)

    @property
    def failed(self) -> int:
        """Number of scenarios that failed."""
        return len(self.failures)

    @property
    def failure_counts(self) -> dict[str, int]:
        """Number of failed scenarios by reason, the most frequent first."""
        return {reason: len(members) for reason, members in group_failure_messages(self.failures.values()).items()}

    def __repr__(self) -> str:
        failed = f", {_format_scenario_count(self.failed)} failed" if self.failed else ""
        return f"<SimulatedFolder: {self.done} recordings in {str(self.folder)!r}{failed}>"


def _format_scenario_count(count: int) -> str:
    return f"{count} scenario{'s' if count > 1 else ''}"


@document_options(SIMULATION_OPTIONS)
def simulate_many(
    scenarios: Path | str | ScenarioFile | Sequence[Path | str | ScenarioFile],
    folder: Path | str,
    *,
    table: Path | str | None = None,
    values: Mapping[str, Value] | None = None,
    ego: str = "Ego",
    seed: int = 0,
    progress: bool = False,
    **options: Unpack[SimulationKeywords],
) -> SimulatedFolder:
    """Run many concrete scenarios, and write a recording of each into a folder.

    Each recording is written as soon as its scenario has ended. A second call only runs scenarios without a
    recording. Two more files are written: ``simulation.json`` describes each recording, and ``parameters.csv`` has the
    parameter values of each recording of this call, and of earlier calls with the same parameters, so that
    `cornercase.study.import_recordings` can read them.

    Parameters
    ----------
    scenarios : path or ScenarioFile, or a sequence of them
        OpenSCENARIO files: a single file if there is a table, otherwise one or several files.
    folder : path
        Output folder. Without a table, each recording is named after its scenario.
    table : path, optional
        CSV file with one concrete scenario per line, and a column per parameter. A column ``file`` names the recordings
        (``NAME.csv``); without this column, recordings are named after the scenario, with a number.
    values : mapping of str to float or str, optional
        Parameter values in all scenarios.
    ego : str, default "Ego"
        Entity under test, for a simulator that needs to know it.
    seed : int, default 0
        Seed of the random numbers of sensors and systems under test.
    progress : bool, default False
        Show a progress bar.
    **options
        How the scenarios are run: any of the parameters below.

    Returns
    -------
    SimulatedFolder

    Other Parameters
    ----------------
    OPTIONS

    Raises
    ------
    InputError
        An argument cannot be used, none of the scenarios can be run, the folder contains recordings with other
        settings, or a recording in the folder has the name of a new one but is of another scenario.

    Warns
    -----
    NoticeWarning
        Something in the files has no effect in the simulator.

    See Also
    --------
    simulate : Runs one scenario and returns its recording.

    Examples
    --------
    >>> from pathlib import Path
    >>> import cornercase
    >>> _ = Path("values.csv").write_text("ego_start" + chr(10) + "40")
    >>> scenario = "examples/x_intersection/x_intersection.xosc"
    >>> cornercase.simulate_many(scenario, "recordings", table="values.csv", duration=2.0)
    <SimulatedFolder: 1 recordings in 'recordings'>
    """
    checked = check_options("simulate_many", SIMULATION_OPTIONS, options)
    inputs = scenarios if isinstance(scenarios, Sequence) and not isinstance(scenarios, str) else [scenarios]
    scenario_files, unreadable = _read_scenario_files(inputs)
    failures = {_recording_file_name(path): reason for path, reason in unreadable.items()}
    folder = check_output_folder("folder", folder)
    if folder.suffix.lower() == _CSV_SUFFIX:
        raise InputError(
            f"`folder` {folder}: recordings are written into a folder; give a name without '{_CSV_SUFFIX}'."
        )
    checked_values = validation.check_parameter_values("values", values)
    for scenario in scenario_files:
        scenario.require_declared(list(checked_values))
    seed = validation.check_int("seed", seed, 0)
    planned = (
        _plan_from_files(scenario_files, unreadable, checked_values, seed)
        if table is None
        else _plan_from_table(scenario_files, validation.check_path("table", table), checked_values, seed)
    )
    if table is not None:
        for name in (TABLE_FILE, NOTES_FILE):
            check_output_differs_from_source(folder / name, table, "folder")
    simulator, settings = split_common_options(
        checked.pop("simulator"), {name: checked.pop(name) for name in COMMON_OPTIONS}
    )
    settings["drivers"] = {entity: resolve_driver(driver) for entity, driver in settings["drivers"].items()}
    for scenario in scenario_files:
        values_of_file = [plan.concrete_scenario.values for plan in planned if plan.concrete_scenario.file is scenario]
        check_driver_parameters(simulator, scenario, settings["drivers"], values_of_file)
    with create_simulator(simulator, settings, ego=ego, **checked) as started:
        if table is None:
            refused = find_refusals(started, [plan.concrete_scenario for plan in planned])
            failures |= {
                planned[k].file: prefix_file(planned[k].concrete_scenario.path, reason) for k, reason in refused.items()
            }
            planned = [plan for k, plan in enumerate(planned) if k not in refused]
            scenario_files = [
                scenario
                for scenario in scenario_files
                if any(plan.concrete_scenario.file is scenario for plan in planned)
            ]
        else:
            check_simulator_accepts(started, scenario_files, [plan.concrete_scenario for plan in planned])
        output_folder = RecordingsFolder(
            folder,
            planned,
            {"simulator": str(simulator), **started.settings, **({"seed": seed} if seed else {})},
        )
        warn_notices(
            deduplicate_notices(
                notice
                for scenario in scenario_files
                for notice in list_ignored_content(started, scenario, checked_values)
            )
        )
        failures |= _run_missing(
            started,
            output_folder,
            [plan for plan in planned if plan.file not in output_folder.existing_files],
            len(planned),
            progress,
        )
    done = [plan.file for plan in planned if plan.file not in failures]
    if not done:
        first = next(iter(failures.values()))
        count = len({*failures, *(plan.file for plan in planned)})
        raise InputError(f"None of {_format_scenario_count(count)} could be run; the first: {first}.")
    output_folder.write_table(done)
    return SimulatedFolder(folder, len(done), len(output_folder.existing_files), failures)


def _read_scenario_files(scenarios: Sequence[Path | str | ScenarioFile]) -> tuple[list[ScenarioFile], dict[Path, str]]:
    """Read scenario files; also return why some cannot be read, by path. Raises if none can be read."""
    readable, errors = list[ScenarioFile](), dict[Path, InputError]()
    for item in scenarios:
        try:
            readable.append(item if isinstance(item, ScenarioFile) else ScenarioFile.read(item))
        except InputError as error:
            path = Path(item.path if isinstance(item, ScenarioFile) else item)
            if not path.is_file():
                # Probably a typing error.
                raise
            errors[path] = error
    if errors and not readable:
        raise next(iter(errors.values()))
    return readable, {path: prefix_file(path, describe_file_error(path, error)) for path, error in errors.items()}


def _recording_file_name(path: Path) -> str:
    return make_portable_file_name(path.stem) + _CSV_SUFFIX


def _plan_from_files(
    scenarios: Sequence[ScenarioFile], unreadable: Collection[Path], values: Mapping[str, Value], seed: int
) -> list[PlannedRecording]:
    """Plan one recording per scenario file, named after the file; unreadable files take a name, too."""
    if not scenarios:
        raise InputError("`scenarios`: name at least one OpenSCENARIO file.")
    first_by_name: dict[str, tuple[object, Path]] = {}
    for source, path in (
        *((scenario, scenario.path) for scenario in scenarios),
        *((path, path) for path in unreadable),
    ):
        first, first_path = first_by_name.setdefault(_recording_file_name(path).casefold(), (source, path))
        if first is not source:
            raise InputError(f"{path}: has the same recording name as {first_path}; rename one.")
    return [
        PlannedRecording(_recording_file_name(scenario.path), ConcreteScenario(scenario.path, values, scenario, seed))
        for scenario in scenarios
    ]


def _plan_from_table(
    scenarios: Sequence[ScenarioFile], table: Path, values: Mapping[str, Value], seed: int
) -> list[PlannedRecording]:
    """Plan one recording per line of a table, all of the same scenario."""
    if len(scenarios) != 1:
        raise InputError(f"`table` {table}: requires one scenario, not {len(scenarios)}.")
    (scenario,) = scenarios
    planned, lines = [], dict[str, int]()
    for number, row in enumerate(read_value_table(table, scenario), 1):
        if duplicates := sorted({*values} & {*row.values}):
            raise InputError(f"`values` {duplicates[0]}: is also a column of {table}; remove one of the two.")
        # A fixed number of digits, so that recordings keep their names if the table grows.
        file = row.recording_name or f"{make_portable_file_name(scenario.path.stem)}-{number:05d}{_CSV_SUFFIX}"
        if (
            make_portable_file_name(file) != file
            or not file.lower().endswith(_CSV_SUFFIX)
            or file.lower() == TABLE_FILE
        ):
            raise InputError(
                f"{table}, line {row.line}: '{file}' in the column {FILE_COLUMN} cannot be a recording; give a file"
                f" name without folder that ends in {_CSV_SUFFIX} and is not {TABLE_FILE}."
            )
        earlier = lines.setdefault(file.casefold(), row.line)
        if earlier != row.line:
            raise InputError(f"{table}, line {row.line}: repeats the file name {file} of line {earlier}.")
        concrete = ConcreteScenario(scenario.path, {**values, **row.values}, scenario, seed)
        planned.append(PlannedRecording(file, concrete))
    return planned


def _run_missing(
    simulator: Simulator, folder: RecordingsFolder, missing: Sequence[PlannedRecording], total: int, progress: bool
) -> dict[str, str]:
    """Run the scenarios without a recording; return why recordings could not be made, by file name."""
    failures: dict[str, str] = {}
    notes_written, notices = False, RunNotices(simulator)
    done = total - len(missing)
    bar = ProgressBar(total, "simulating", "scenarios", enabled=progress)
    try:
        with collect_interrupts() as check:
            while missing:
                batch_size = _BATCH_SIZE * max(1, len(simulator.parallel_instances()))
                batch, missing = missing[:batch_size], missing[batch_size:]
                outcomes = run_scenarios(simulator, [planned.concrete_scenario for planned in batch])
                for planned, outcome in zip(batch, outcomes, strict=True):
                    check()
                    if isinstance(outcome, SimulationError):
                        failures[planned.file] = prefix_file(planned.concrete_scenario.path, str(outcome))
                    else:
                        if not notes_written:
                            folder.write_notes()
                            notes_written = True
                        outcome.to_csv(folder.path_of(planned.file))
                        notices.add_run(outcome, planned.concrete_scenario.load_file, planned.file)
                    done += 1
                    bar.update(done, "")
    finally:
        bar.stop()
        notices.issue_warnings()
    return failures
