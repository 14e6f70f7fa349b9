"""Many concrete scenarios in a simulator, and a recording of each in a folder."""

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
# Scenarios that are given to each of the simulators side by side at once: what is gained by more is little, and
# recordings that are not written yet are held.
_AT_ONCE: Final = 100


@dataclass(frozen=True)
class SimulatedFolder:
    """What was made of many concrete scenarios.

    Attributes
    ----------
    folder : Path
    done : int
        Recordings of them in the folder.
    ran_before : int
        Recordings that were there before, and were not made again.
    failures : mapping of str to str
        Why the scenarios could not be run whose recordings are missing, by the name of the file.
    """

    folder: Path
    done: int
    ran_before: int
    failures: Mapping[str, str] = field(default_factory=dict)

    @property
    def failed(self) -> int:
        """Number of scenarios that could not be run."""
        return len(self.failures)

    @property
    def reasons(self) -> dict[str, int]:
        """How many scenarios failed for which reason, the most frequent first."""
        return {reason: len(members) for reason, members in group_reasons(self.failures.values()).items()}

    def __repr__(self) -> str:
        failed = f", {_counted(self.failed)} failed" if self.failed else ""
        return f"<SimulatedFolder: {self.done} recordings in {str(self.folder)!r}{failed}>"


def _counted(scenarios: int) -> str:
    return f"{scenarios} scenario{'s' if scenarios > 1 else ''}"


# Its parameters are the options of the command.
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

    Each recording is written the moment its scenario has ended. The same call again makes those that are missing. The
    folder gets two more files: ``simulation.json`` says what each recording is of, and ``parameters.csv`` has the
    values of all, so that `cornercase.study.import_recordings` can read the folder.

    Parameters
    ----------
    scenarios : path or Scenario, or a sequence of them
        OpenSCENARIO files: one with a table, or several without.
    folder : path
        Where to write. Without a table, each recording is called like its scenario.
    table : path, optional
        CSV with one concrete scenario a line, and a column for each parameter that is given. A column ``file`` names
        the recordings (``NAME.csv``); without it they are called like the scenario, with a number.
    values : mapping of str to float or str, optional
        Values of parameters in all scenarios.
    time_step : float, default 0.05
        s.
    duration : float, default 60
        s after which a scenario ends at the latest.
    on_collision : {"continue", "stop"}, default "continue"
        Whether entities pass through each other, or the run ends.
    drivers : mapping of str to str or Driver, optional
        Who drives which entity.
    simulator : str, default "builtin"
        What runs them: a registered name, with options behind a colon if need be.
    ego : str, default "Ego"
        Entity under test, for a simulator that needs to know it.
    workers : int, default 1
        Simulators side by side.
    cluster : str or distributed.Client, optional
        Dask cluster to run on: ``"local"`` for `workers` processes here, the address of a scheduler, the file that a
        scheduler wrote, or a connection, which stays open.
    timeout : float, optional
        s after which a scenario is given up.
    retries : int, default 1
        How often a scenario is run again after the simulator died or hung.
    max_failures : int, default 5
        Scenarios in a row in which the simulator dies or hangs, after which nothing more is run; 0 for no limit.
    progress : bool, default False
        Show a bar.

    Returns
    -------
    SimulatedFolder

    Raises
    ------
    InputError
        Something cannot be used, none of the scenarios can be run, or the folder holds recordings of other scenarios
        or with other settings.

    Warns
    -----
    NoticeWarning
        Something in the files has no effect in the simulator.

    See Also
    --------
    simulate : Runs one, and gives its recording.
    """
    many = scenarios if isinstance(scenarios, Sequence) and not isinstance(scenarios, str) else [scenarios]
    read, failures = _readable(many)
    folder = require_folder("folder", folder)
    if folder.suffix.lower() == _CSV:
        raise InputError(f"`folder` {folder}: many recordings go into a folder; name one without '{_CSV}'.")
    given = arguments.numbers_or_texts("values", values)
    for one in read:
        one.require_parameters(list(given))
    planned = _of_files(read, given) if table is None else _of_table(read, arguments.path("table", table), given)
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
            refused = refusals_of(started, [one.concrete for one in planned])
            failures |= {planned[k].file: of_file(planned[k].concrete.path, why) for k, why in refused.items()}
            planned = [one for k, one in enumerate(planned) if k not in refused]
            read = [one for one in read if any(each.concrete.source is one for each in planned)]
        else:
            require_usable(started, read, [one.concrete for one in planned])
        whole = RecordingsFolder(folder, planned, {"simulator": simulator, **started.settings})
        warn_of(distinct(notice for one in read for notice in notices_of(simulator, one, given)))
        failures |= _run(
            started, whole, [one for one in planned if one.file not in whole.there], len(planned), progress
        )
    done = [one.file for one in planned if one.file not in failures]
    if not done:
        first = next(iter(failures.values()))
        count = len({*failures, *(one.file for one in planned)})
        raise InputError(f"None of {_counted(count)} could be run; the first: {first}.")
    whole.write_table(done)
    return SimulatedFolder(folder, len(done), len(whole.there), failures)


def _readable(scenarios: Sequence[Path | str | Scenario]) -> tuple[list[Scenario], dict[str, str]]:
    """Read scenario files, and tell why which recordings cannot be made, where some of several cannot be read."""
    read, wrong = list[Scenario](), dict[Path, InputError]()
    for one in scenarios:
        try:
            read.append(one if isinstance(one, Scenario) else Scenario.read(one))
        except InputError as error:
            path = Path(one.path if isinstance(one, Scenario) else one)
            if not path.is_file():
                # A name that was typed wrong is no scenario.
                raise
            wrong[path] = error
    if wrong and not read:
        raise next(iter(wrong.values()))
    return read, {_recording_of(path): of_file(path, failure_words(path, error)) for path, error in wrong.items()}


def _recording_of(path: Path) -> str:
    return portable_name(path.stem) + _CSV


def _of_files(scenarios: Sequence[Scenario], given: Mapping[str, Value]) -> list[Planned]:
    """Recordings that are called like their scenarios."""
    if not scenarios:
        raise InputError("`scenario`: name at least one OpenSCENARIO file.")
    called: dict[str, Scenario] = {}
    for one in scenarios:
        other = called.setdefault(portable_name(one.path.stem).casefold(), one)
        if other is not one:
            raise InputError(f"{one.path}: its recording would be called like that of {other.path}; rename one.")
    return [Planned(_recording_of(one.path), ConcreteScenario(one.path, given, one)) for one in scenarios]


def _of_table(scenarios: Sequence[Scenario], table: Path, given: Mapping[str, Value]) -> list[Planned]:
    """Recordings of one scenario with the values of a table."""
    if len(scenarios) != 1:
        raise InputError(f"`table` {table}: is of one scenario, not of {len(scenarios)}; give one.")
    (scenario,) = scenarios
    planned, lines = [], dict[str, int]()
    for number, row in enumerate(read_value_table(table, scenario), 1):
        if both := sorted({*given} & {*row.values}):
            raise InputError(f"`values` {both[0]}: is a column of {table} too; leave one of the two.")
        # The number has as many digits in a longer table, so that recordings keep their names.
        file = row.file or f"{portable_name(scenario.path.stem)}-{number:05d}{_CSV}"
        if portable_name(file) != file or not file.lower().endswith(_CSV) or file.lower() == TABLE:
            raise InputError(
                f"{table}, line {row.line}: '{file}' in the column {FILE_COLUMN} cannot be a recording; name a file"
                f" without a folder that ends in {_CSV} and is not {TABLE}."
            )
        earlier = lines.setdefault(file.casefold(), row.line)
        if earlier != row.line:
            raise InputError(f"{table}, line {row.line}: names {file}, as line {earlier} does.")
        planned.append(Planned(file, ConcreteScenario(scenario.path, {**given, **row.values}, scenario)))
    return planned


def _run(
    simulator: Simulator, folder: RecordingsFolder, missing: Sequence[Planned], total: int, progress: bool
) -> dict[str, str]:
    """Run what is missing, and tell why which recordings could not be made."""
    failures: dict[str, str] = {}
    noted, said = False, RunNotices(simulator)
    done = total - len(missing)
    bar = ProgressBar(total, "simulating", "scenarios") if progress else None
    try:
        with noted_interrupts() as check:
            while missing:
                at_once = _AT_ONCE * max(1, len(simulator.beside()))
                chosen, missing = missing[:at_once], missing[at_once:]
                outcomes = outcomes_of(simulator, [one.concrete for one in chosen])
                for one, outcome in zip(chosen, outcomes, strict=True):
                    check()
                    if isinstance(outcome, SimulationError):
                        failures[one.file] = of_file(one.concrete.path, str(outcome))
                    else:
                        if not noted:
                            folder.note()
                            noted = True
                        outcome.to_csv(folder.place(one.file))
                        said.look(outcome, one.concrete.scenario)
                    done += 1
                    if bar is not None:
                        bar.update(done, "")
    finally:
        if bar is not None:
            bar.stop()
        said.warn()
    return failures
