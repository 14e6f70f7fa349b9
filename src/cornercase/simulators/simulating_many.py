"""Run many concrete scenarios, and write a recording of each into a folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Final

from cornercase._common import arguments
from cornercase._common.errors import InputError, SimulationError
from cornercase._common.files import portable_name, require_folder, require_other_file
from cornercase._common.interrupts import noted_interrupts
from cornercase._common.ledger import distinct, warn_of
from cornercase._common.parts import group_reasons
from cornercase._common.places import of_file
from cornercase._common.progress import ProgressBar
from cornercase.drivers import Driver, told_driver
from cornercase.scenario import FILE_COLUMN, ConcreteScenario, Scenario, Value, read_value_table
from cornercase.simulators.base import Simulator
from cornercase.simulators.notices import RunNotices
from cornercase.simulators.outcomes import failure_words, notices_of, outcomes_of, refusals_of, require_usable
from cornercase.simulators.recordings_folder import NOTES, TABLE, Planned, RecordingsFolder
from cornercase.simulators.starting import start_simulator
from cornercase.simulators.workers import MOST_FAILURES

if TYPE_CHECKING:
    from distributed import Client

_CSV: Final = ".csv"
# Scenarios per parallel simulator and batch. More gains little, and keeps unwritten recordings in memory.
_AT_ONCE: Final = 100


@dataclass(frozen=True)
class SimulatedFolder:
    """Result of running many concrete scenarios.

    Attributes
    ----------
    folder : Path
    done : int
        Number of their recordings in the folder.
    ran_before : int
        Number of recordings that existed before and were not made again.
    failures : mapping of str to str
        Why recordings are missing, by file name.
    """

    folder: Path
    done: int
    ran_before: int
    failures: Mapping[str, str] = field(default_factory=dict)

    @property
    def failed(self) -> int:
        """Number of scenarios that failed."""
        return len(self.failures)

    @property
    def reasons(self) -> dict[str, int]:
        """Number of failed scenarios by reason, the most frequent first."""
        return {reason: len(members) for reason, members in group_reasons(self.failures.values()).items()}

    def __repr__(self) -> str:
        failed = f", {_counted(self.failed)} failed" if self.failed else ""
        return f"<SimulatedFolder: {self.done} recordings in {str(self.folder)!r}{failed}>"


def _counted(scenarios: int) -> str:
    return f"{scenarios} scenario{'s' if scenarios > 1 else ''}"


# The parameters are the options of the command.
def simulate_many(
    scenarios: Path | str | Scenario | Sequence[Path | str | Scenario],
    folder: Path | str,
    *,
    table: Path | str | None = None,
    values: Mapping[str, Value] | None = None,
    time_step: float = 0.05,
    duration: float = 60.0,
    on_collision: str = "continue",
    drivers: Mapping[str, str | Driver] | None = None,
    simulator: str = "builtin",
    ego: str = "Ego",
    workers: int = 1,
    cluster: str | Client | None = None,
    timeout: float | None = None,
    retries: int = 1,
    max_failures: int = MOST_FAILURES,
    progress: bool = False,
) -> SimulatedFolder:
    """Run many concrete scenarios, and write a recording of each into a folder.

    Each recording is written as soon as its scenario has ended. If you call it again, it runs the missing ones. Two
    more files are written: ``simulation.json`` describes each recording, and ``parameters.csv`` has the values of all,
    so that `cornercase.study.import_recordings` can read the folder.

    Parameters
    ----------
    scenarios : path or Scenario, or a sequence of them
        OpenSCENARIO files: one with a table, or several without.
    folder : path
        Output folder. Without a table, each recording is named after its scenario.
    table : path, optional
        CSV file with one concrete scenario per line, and a column per parameter. A column ``file`` names the recordings
        (``NAME.csv``); without it they are named after the scenario, with a number.
    values : mapping of str to float or str, optional
        Parameter values in all scenarios.
    time_step : float, default 0.05
        In s.
    duration : float, default 60
        Maximum duration of a scenario in s.
    on_collision : {"continue", "stop"}, default "continue"
        Whether entities pass through each other, or the run ends.
    drivers : mapping of str to str or Driver, optional
        By entity.
    simulator : str, default "builtin"
        Registered name, with options after a colon.
    ego : str, default "Ego"
        Entity under test, for a simulator that needs to know it.
    workers : int, default 1
        Number of simulators that run in parallel.
    cluster : str or distributed.Client, optional
        Dask cluster to run on: ``"local"`` for `workers` local processes, the address of a scheduler, a scheduler file,
        or a client, which stays open.
    timeout : float, optional
        Time in s after which a scenario is cancelled.
    retries : int, default 1
        How often a scenario is run again after the simulator died or hung.
    max_failures : int, default 5
        Stop after this many consecutive scenarios in which the simulator died or hung; 0 for no limit.
    progress : bool, default False
        Show a progress bar.

    Returns
    -------
    SimulatedFolder

    Raises
    ------
    InputError
        An argument cannot be used, none of the scenarios can be run, or the folder contains recordings of other
        scenarios or with other settings.

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
    inputs = scenarios if isinstance(scenarios, Sequence) and not isinstance(scenarios, str) else [scenarios]
    scenario_files, failures = _readable(inputs)
    folder = require_folder("folder", folder)
    if folder.suffix.lower() == _CSV:
        raise InputError(f"`folder` {folder}: recordings are written into a folder; give a name without '{_CSV}'.")
    checked_values = arguments.numbers_or_texts("values", values)
    for scenario in scenario_files:
        scenario.require_parameters(list(checked_values))
    planned = (
        _of_files(scenario_files, checked_values)
        if table is None
        else _of_table(scenario_files, arguments.path("table", table), checked_values)
    )
    if table is not None:
        for name in (TABLE, NOTES):
            require_other_file(folder / name, table, "folder")
    options = {
        "time_step": time_step,
        "duration": duration,
        "on_collision": on_collision,
        "drivers": {entity: told_driver(driver) for entity, driver in (drivers or {}).items()},
    }
    started = start_simulator(
        simulator,
        options,
        ego=ego,
        workers=workers,
        timeout=timeout,
        retries=retries,
        cluster=cluster,
        max_failures=max_failures,
    )
    with started:
        if table is None:
            refused = refusals_of(started, [plan.concrete for plan in planned])
            failures |= {planned[k].file: of_file(planned[k].concrete.path, reason) for k, reason in refused.items()}
            planned = [plan for k, plan in enumerate(planned) if k not in refused]
            scenario_files = [
                scenario for scenario in scenario_files if any(plan.concrete.source is scenario for plan in planned)
            ]
        else:
            require_usable(started, scenario_files, [plan.concrete for plan in planned])
        output_folder = RecordingsFolder(folder, planned, {"simulator": simulator, **started.settings})
        warn_of(
            distinct(
                notice for scenario in scenario_files for notice in notices_of(simulator, scenario, checked_values)
            )
        )
        failures |= _run(
            started,
            output_folder,
            [plan for plan in planned if plan.file not in output_folder.there],
            len(planned),
            progress,
        )
    done = [plan.file for plan in planned if plan.file not in failures]
    if not done:
        first = next(iter(failures.values()))
        count = len({*failures, *(plan.file for plan in planned)})
        raise InputError(f"None of {_counted(count)} could be run; the first: {first}.")
    output_folder.write_table(done)
    return SimulatedFolder(folder, len(done), len(output_folder.there), failures)


def _readable(scenarios: Sequence[Path | str | Scenario]) -> tuple[list[Scenario], dict[str, str]]:
    """Read scenario files; also return why recordings of unreadable ones are missing, unless none can be read."""
    readable, errors = list[Scenario](), dict[Path, InputError]()
    for item in scenarios:
        try:
            readable.append(item if isinstance(item, Scenario) else Scenario.read(item))
        except InputError as error:
            path = Path(item.path if isinstance(item, Scenario) else item)
            if not path.is_file():
                # Probably a typing error.
                raise
            errors[path] = error
    if errors and not readable:
        raise next(iter(errors.values()))
    return readable, {_recording_of(path): of_file(path, failure_words(path, error)) for path, error in errors.items()}


def _recording_of(path: Path) -> str:
    return portable_name(path.stem) + _CSV


def _of_files(scenarios: Sequence[Scenario], given: Mapping[str, Value]) -> list[Planned]:
    """Plan recordings that are named after their scenarios."""
    if not scenarios:
        raise InputError("`scenario`: name at least one OpenSCENARIO file.")
    scenario_by_name: dict[str, Scenario] = {}
    for scenario in scenarios:
        other = scenario_by_name.setdefault(portable_name(scenario.path.stem).casefold(), scenario)
        if other is not scenario:
            raise InputError(f"{scenario.path}: has the same recording name as {other.path}; rename one.")
    return [
        Planned(_recording_of(scenario.path), ConcreteScenario(scenario.path, given, scenario))
        for scenario in scenarios
    ]


def _of_table(scenarios: Sequence[Scenario], table: Path, given: Mapping[str, Value]) -> list[Planned]:
    """Plan recordings of one scenario with the values of a table."""
    if len(scenarios) != 1:
        raise InputError(f"`table` {table}: requires one scenario, not {len(scenarios)}.")
    (scenario,) = scenarios
    planned, lines = [], dict[str, int]()
    for number, row in enumerate(read_value_table(table, scenario), 1):
        if duplicates := sorted({*given} & {*row.values}):
            raise InputError(f"`values` {duplicates[0]}: is also a column of {table}; remove one of the two.")
        # A fixed number of digits, so that recordings keep their names if the table grows.
        file = row.file or f"{portable_name(scenario.path.stem)}-{number:05d}{_CSV}"
        if portable_name(file) != file or not file.lower().endswith(_CSV) or file.lower() == TABLE:
            raise InputError(
                f"{table}, line {row.line}: '{file}' in the column {FILE_COLUMN} cannot be a recording; give a file"
                f" name without folder that ends in {_CSV} and is not {TABLE}."
            )
        earlier = lines.setdefault(file.casefold(), row.line)
        if earlier != row.line:
            raise InputError(f"{table}, line {row.line}: repeats the file name {file} of line {earlier}.")
        planned.append(Planned(file, ConcreteScenario(scenario.path, {**given, **row.values}, scenario)))
    return planned


def _run(
    simulator: Simulator, folder: RecordingsFolder, missing: Sequence[Planned], total: int, progress: bool
) -> dict[str, str]:
    """Run the missing scenarios; return why recordings could not be made."""
    failures: dict[str, str] = {}
    notes_written, notices = False, RunNotices(simulator)
    done = total - len(missing)
    bar = ProgressBar(total, "simulating", "scenarios") if progress else None
    try:
        with noted_interrupts() as check:
            while missing:
                batch_size = _AT_ONCE * max(1, len(simulator.beside()))
                batch, missing = missing[:batch_size], missing[batch_size:]
                outcomes = outcomes_of(simulator, [planned.concrete for planned in batch])
                for planned, outcome in zip(batch, outcomes, strict=True):
                    check()
                    if isinstance(outcome, SimulationError):
                        failures[planned.file] = of_file(planned.concrete.path, str(outcome))
                    else:
                        if not notes_written:
                            folder.note()
                            notes_written = True
                        outcome.to_csv(folder.place(planned.file))
                        notices.look(outcome, planned.concrete.scenario)
                    done += 1
                    if bar is not None:
                        bar.update(done, "")
    finally:
        if bar is not None:
            bar.stop()
        notices.warn()
    return failures
