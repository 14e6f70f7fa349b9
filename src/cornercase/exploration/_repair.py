"""Repair a damaged study: lost scenarios are run again."""

from __future__ import annotations

import math
import os
import shutil
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from itertools import count, groupby, takewhile
from pathlib import Path
from typing import Any, Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.io.atomic import SQLITE_SUFFIXES
from cornercase._common.io.files import atomic_write
from cornercase._common.memory import DEFAULT_MEMORY, MemoryLimit, format_size, report_memory_need
from cornercase._common.platform import fsync_file, lock_folder
from cornercase._common.validation import check_int, check_path
from cornercase.drivers._resolve import DriverLike, may_be_named_in_file
from cornercase.exploration._asynchronous import AsynchronousExplorer
from cornercase.exploration._config import config_from_study, require_same_settings
from cornercase.exploration._explore import reference_simulators, simulator_from_config
from cornercase.exploration._explorer import ScenarioExplorer
from cornercase.exploration._proposals import AskTell, ProposalSource
from cornercase.scenario._file import ScenarioFile
from cornercase.study import ScenarioRecord, StudyFile, verify
from cornercase.study._import_recordings import IMPORTED_SIMULATOR
from cornercase.study._recovery.file_lock import DamagedFileLock
from cornercase.study._recovery.rebuild import RecoveredStudy, rebuild_study
from cornercase.study._scenario_file import find_explored_scenario

_DAMAGED_SUFFIX: Final = ".damaged"
# Memory needed, relative to the size of the file: all rows, and those of one table a second time.
_MEMORY_FACTOR: Final = 1.5


@dataclass(frozen=True)
class RepairResult:
    """Result of repairing a study.

    Attributes
    ----------
    study : Path
    damaged_file : Path or None
        New path of the damaged file; None if there was nothing to repair.
    rerun_ids : tuple of int
        Ids of the scenarios that were run again.
    lost_content : tuple of str
        Content that could not be recovered, as parts of a sentence.

    Examples
    --------
    >>> from cornercase.exploration import repair
    >>> result = repair("damaged.db")  # doctest: +SKIP
    >>> result.rerun_ids, result.lost_content, result.damaged_file.name  # doctest: +SKIP
    ((108,), (), 'damaged.db.damaged')
    """

    study: Path
    damaged_file: Path | None
    rerun_ids: tuple[int, ...]
    lost_content: tuple[str, ...]


def repair(
    study: Path | str,
    *,
    scenario: Path | str | ScenarioFile | None = None,
    simulator: str | None = None,
    drivers: Mapping[str, DriverLike] | None = None,
    workers: int = 1,
    memory: str | float = DEFAULT_MEMORY,
) -> RepairResult:
    """Repair a damaged study: lost scenarios are run again.

    Intact content stays. Scenarios that lost content are run again with the study's simulator and settings. If their
    parameters are lost, the optimizer proposes the scenarios again. If the number of scenarios is lost, the exploration
    continues up to its budget. The damaged file stays under another name. The study is locked for other writers until
    it is replaced.

    Parameters
    ----------
    study : path
    scenario : path or ScenarioFile, optional
        The explored file. By default it is searched for at its stored path, next to the study and in the current
        folder, and recognized by its fingerprint.
    simulator : str, optional
        By default the simulator of the study. The study's options of the simulator are only used if each is a number,
        true or false.
    drivers : mapping of str to str, SystemUnderTest or Driver, optional
        Your own drivers by name of the entity, if the study was explored with your own drivers; presets are taken from
        the study.
    workers : int, default 1
        Number of simulators that run in parallel.
    memory : str or float, default "4 GB"
        Memory limit of the process, as text or in bytes.

    Returns
    -------
    RepairResult

    Raises
    ------
    InputError
        The study cannot be repaired, a file or driver is missing, another process writes to the study or has changed it
        meanwhile, or more memory is needed; the study is left unchanged.

    See Also
    --------
    cornercase.study.verify : Lists the damage.

    Examples
    --------
    >>> from cornercase.exploration import repair
    >>> repair("damaged.db").rerun_ids  # doctest: +SKIP
    (108,)
    """
    file = check_path("study", study)
    # Replace the target of a symbolic link, not the link.
    file = file.resolve()
    workers = check_int("workers", workers, minimum=1)
    limit = MemoryLimit.from_value(memory)
    with _reword_file_errors(file), lock_folder(file.parent):
        _undo_keep_damaged_file(file)
    if verify(file).is_sound:
        return RepairResult(file, None, (), ())

    with (
        _reword_file_errors(file),
        ExitStack() as exit_stack,
        _restore_name_on_error(file),
        DamagedFileLock(file) as held,
    ):
        size = file.stat().st_size
        need = _MEMORY_FACTOR * size
        limit.check_fits(need, f"the contents of a study of {format_size(size)}", "give more")
        report_memory_need("The contents of the study", need)
        with atomic_write(file) as temporary, _hide_temporary_name_in_errors(temporary, file):
            temporary.unlink()
            remains = rebuild_study(file, temporary)
            lost = list(remains.lost)
            held.lock()
            lost += _restore_digests(file, temporary, scenario)
            if remains.to_rerun or not remains.is_count_known:
                _require_repeatable_search(file, remains)
                _rerun_lost_scenarios(file, temporary, remains, scenario, simulator, drivers or {}, workers)
            if not remains.is_count_known:
                lost.append(f"how many scenarios it had; its search went on to its budget of {remains.meta.budget}")
            lost += _describe_changed_tables(temporary, remains)
            # Flush now: nothing slow may come between `require_unchanged` and the replacement.
            fsync_file(temporary)
            # Another repair would undo this one halfway.
            exit_stack.enter_context(lock_folder(file.parent))
            held.require_unchanged()
            held.release_before_rename()
            damaged_copy = _keep_damaged_file(file)
            held.set_path(damaged_copy)
    return RepairResult(file, damaged_copy, remains.to_rerun, tuple(lost))


@contextmanager
def _reword_file_errors(file: Path) -> Iterator[None]:
    """Convert file system and SQLite errors to one-sentence `InputError`."""
    try:
        yield
    except (OSError, sqlite3.Error) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise InputError(
            f"{file}: cannot be repaired ({reason}); make room, or copy the file to another disk."
        ) from error


@contextmanager
def _hide_temporary_name_in_errors(temporary: Path, file: Path) -> Iterator[None]:
    """Replace the name of the temporary file in errors by the name of the user's file."""
    try:
        yield
    except InputError as error:
        text = str(error).replace(str(temporary), str(file))
        raise error if text == str(error) else InputError(text) from error


@contextmanager
def _restore_name_on_error(file: Path) -> Iterator[None]:
    """Remove the second name of the damaged file if replacing the study fails."""
    try:
        yield
    except BaseException:
        with suppress(OSError):
            _undo_keep_damaged_file(file)
        raise


def _keep_damaged_file(file: Path) -> Path:
    """Give the damaged file a second name, and return that name; the file keeps its original name, too."""
    damaged_copy = _unused_damaged_name(file)
    try:
        os.link(file, damaged_copy)
    except OSError:
        # Not all file systems have hard links.
        with atomic_write(damaged_copy) as copy:
            shutil.copyfile(file, copy)
    for ending in SQLITE_SUFFIXES:
        companion = file.with_name(file.name + ending)
        if companion.exists():
            os.replace(companion, damaged_copy.with_name(damaged_copy.name + ending))
    return damaged_copy


def _undo_keep_damaged_file(file: Path) -> None:
    """Remove the second name of a damaged file if a failed or killed repair left the file with two names."""
    for damaged_copy in takewhile(Path.exists, _damaged_file_names(file)):
        if not damaged_copy.samefile(file):
            continue
        for ending in SQLITE_SUFFIXES:
            companion, original = damaged_copy.with_name(damaged_copy.name + ending), file.with_name(file.name + ending)
            if original.exists() and original.stat().st_size:
                # Another process has written to the study since.
                companion.unlink(missing_ok=True)
            elif companion.exists():
                os.replace(companion, original)
        damaged_copy.unlink()


def _unused_damaged_name(file: Path) -> Path:
    return next(name for name in _damaged_file_names(file) if not name.exists())


def _damaged_file_names(file: Path) -> Iterator[Path]:
    """Yield names for damaged files, in the order in which they are tried."""
    yield file.with_name(file.name + _DAMAGED_SUFFIX)
    yield from (file.with_name(f"{file.name}{_DAMAGED_SUFFIX}-{number}") for number in count(2))


def _require_repeatable_search(file: Path, recovered: RecoveredStudy) -> None:
    meta, again = recovered.meta, len(recovered.to_rerun)
    if (
        meta.simulator == IMPORTED_SIMULATOR
        or meta.optimizer == "none"
        or meta.optimizer.startswith("importance-sampling:")
    ):
        command = "import" if meta.simulator == IMPORTED_SIMULATOR else "test" if meta.suite else "estimate"
        problem = f"{again} of its scenarios are damaged" if again else "the number of its scenarios is lost"
        raise InputError(
            f"{file}: {problem}, and its scenarios were not proposed by a search that can be repeated; run"
            f" `{command}` again, with another file name."
        )
    if meta.asynchronous and not all(recovered.rounds.values()):
        raise InputError(
            f"{file}: the list of its scenarios is lost, and a search without rounds cannot be repeated; run"
            " `explore` again with another study."
        )


def _describe_changed_tables(repaired_file: Path, recovered: RecoveredStudy) -> list[str]:
    """Describe tables whose row count or checksum differs from the stored one."""
    with StudyFile.open(repaired_file) as opened:
        totals = opened.checksum_totals()
    skipped = ("notes", "outcomes", "analyses", "arrays")
    different = [
        name
        for name, total in recovered.checksum_totals.items()
        if name not in skipped and totals.get(name, (0, 0)) != total
    ]
    return [f"its table {name} is not what it was" for name in sorted(different)]


def _restore_digests(file: Path, repaired_file: Path, scenario: Path | str | ScenarioFile | None) -> list[str]:
    """Compute lost digests again; return in words the collisions whose fault was decided without their road."""
    with StudyFile.open(repaired_file, readonly=False) as opened:
        ego, road_source, problem = opened.meta.ego, None, ""
        collided = [
            str(row.id)
            for row in opened.writer.rows_without_digest()
            if any(ego in collision.entities for collision in opened.recording(row.id).collisions)
        ]
        if collided and opened.meta.suite:
            problem = "a repair does not look for the files of a suite; run `test` again, with another file name"
        elif collided:
            try:
                road_source = find_explored_scenario(opened, scenario, search_stored_path=True)
            except InputError as error:
                if scenario is not None:
                    raise
                problem = str(error).removeprefix(f"{opened.path}: ").replace(str(opened.path), str(file)).rstrip(".")
        opened.writer.save_missing_digests(road_source)
    if not problem:
        return []
    scenarios = f"scenario{'s' if len(collided) > 1 else ''} {', '.join(collided)}"
    return [f"who is at fault in {scenarios}, as far as the road says so, since {problem}"]


def _rerun_lost_scenarios(
    file: Path,
    repaired_file: Path,
    recovered: RecoveredStudy,
    scenario: Path | str | ScenarioFile | None,
    simulator: str | None,
    drivers: Mapping[str, DriverLike],
    workers: int,
) -> None:
    with StudyFile.open(repaired_file, readonly=False) as opened:
        config = replace(config_from_study(opened, file, scenario, simulator, drivers), workers=workers)
        condition = config.make_condition()
        for name in () if condition is None else condition.reference_drivers:
            if not may_be_named_in_file(name):
                raise InputError(
                    f"{file}: its critical condition uses the driver '{name}', but for safety no code that a study"
                    " names is run; to run the lost scenarios again, repeat the command that explored the study."
                )
        objective = config.make_objective()
        optimizer = config.start_optimizer(objective)
        with simulator_from_config(config) as running, reference_simulators(config) as references:
            require_same_settings(file, opened.meta, running)
            explorer_class = (
                _RepairExplorer if recovered.is_count_known or not config.asynchronous else AsynchronousExplorer
            )
            explorer = explorer_class(config, running, optimizer, opened, objective, references)
            if isinstance(explorer, _RepairExplorer):
                explorer.restore_rounds(recovered.rounds, recovered.is_count_known)
            else:
                explorer.run()


class _RepairExplorer(ScenarioExplorer):
    """Explorer that runs pending scenarios of a damaged study; the optimizer proposes lost scenarios again."""

    def restore_rounds(self, rounds: Mapping[int, int], is_count_known: bool) -> None:
        """Restore the study round by round.

        `rounds` maps the id of each scenario to its round, or to 0 if the round is unknown. If `is_count_known` is
        False, the number of scenarios is lost, and the search continues up to its budget.
        """
        self._is_count_known = is_count_known
        if not is_count_known:
            rounds = dict.fromkeys(range(1, self._config.budget + 1), 0) | dict(rounds)
        elif all(rounds.values()):
            # All rounds are known, so the optimizer is not needed.
            self._simulate_rows([row for row in self._study.rows() if row.state == "pending"], None)
            return
        self._ask_tell = AskTell(self._optimizer, self._study, self._objective)
        self._proposal_source = ProposalSource(self._ask_tell, self._study)
        minimized = self._objective.minimized_scores(self._study)
        scores: dict[int, Any] = dict(zip((row.id for row in self._study.finished_rows()), minimized, strict=True))
        batch, done = self._config.batch, 0
        for number, members in groupby(_fill_unknown_rounds(rounds, batch).items(), key=lambda item: item[1]):
            ids = [scenario for scenario, _ in members]
            rows_by_id = {row.id: row for row in self._study.rows_of_round(number)}
            if missing := [scenario for scenario in ids if scenario not in rows_by_id]:
                rows_by_id |= self._propose_missing(number, ids, missing, done, rows_by_id)
            rows = [rows_by_id[scenario] for scenario in ids if scenario in rows_by_id]
            if not rows:
                return
            scores |= self._simulate_rows([row for row in rows if row.state == "pending"], None)
            self._tell_round(rows, scores)
            done += len(rows)

    def _propose_missing(
        self,
        round_number: int,
        ids: Sequence[int],
        missing: Sequence[int],
        n_done: int,
        rows_by_id: Mapping[int, ScenarioRecord],
    ) -> dict[int, ScenarioRecord]:
        points = self._proposal_source.propose(n_done, len(ids))
        if not self._is_count_known:
            # The search may have fewer proposals.
            ids = ids[: len(points)]
            missing = [scenario for scenario in missing if scenario in ids]
        same = len(points) == len(ids) and all(
            np.array_equal(points[k], rows_by_id[scenario].point)
            for k, scenario in enumerate(ids)
            if scenario in rows_by_id
        )
        if not same:
            raise InputError(
                f"{self._study.path}: its search does not propose the same scenarios again, for example because of"
                " another version of cornercase; run `explore` again with another study."
            )
        indices = [ids.index(scenario) for scenario in missing]
        rows = self._study.writer.add_pending(
            round_number, points[indices], self._space.values(points[indices]), missing
        )
        return {row.id: row for row in rows}


def _fill_unknown_rounds(rounds: Mapping[int, int], batch: int) -> dict[int, int]:
    """Fill in unknown rounds: a scenario gets the round of the previous scenario, or the next if that round is full."""
    next_round, last = {}, math.inf
    for scenario in sorted(rounds, reverse=True):
        next_round[scenario] = last = rounds[scenario] or last
    filled: dict[int, int] = {}
    current, count = 1, 0
    for scenario in sorted(rounds):
        round_number = rounds[scenario] or int(min(current if count < batch else current + 1, next_round[scenario]))
        current, count = round_number, count + 1 if round_number == current else 1
        filled[scenario] = round_number
    return filled
