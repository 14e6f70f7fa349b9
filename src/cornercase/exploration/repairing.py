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

from cornercase._common.arguments import path, whole_number
from cornercase._common.errors import InputError
from cornercase._common.files import written_whole
from cornercase._common.memory import DEFAULT_MEMORY, MemoryLimit, size_in_words, state_need
from cornercase._common.pending_files import OF_SQLITE
from cornercase._common.platform import alone_in, force_file
from cornercase.drivers import Driver
from cornercase.exploration.asynchronous import AsynchronousExplorer
from cornercase.exploration.configuration import configuration_of, require_same_runs
from cornercase.exploration.explorer import ScenarioExplorer
from cornercase.exploration.exploring import configured_simulator, started_references
from cornercase.exploration.proposing import Proposer, Search
from cornercase.optimizers import create_optimizer
from cornercase.scenario import Scenario
from cornercase.study import IMPORTED, HeldFile, Remains, Row, Study, rebuild, verify

_DAMAGED: Final = ".damaged"
# Memory needed, relative to the size of the file: all rows, and those of one table a second time.
_COPIES: Final = 1.5


@dataclass(frozen=True)
class Repaired:
    """Result of repairing a study.

    Attributes
    ----------
    study : Path
    damaged : Path or None
        Where the damaged file is now; None if there was nothing to repair.
    again : tuple of int
        Ids of the scenarios that were run again.
    lost : tuple of str
        What could not be recovered, as parts of a sentence.
    """

    study: Path
    damaged: Path | None
    again: tuple[int, ...]
    lost: tuple[str, ...]


def repair(
    study: Path | str,
    *,
    scenario: Path | str | Scenario | None = None,
    simulator: str | None = None,
    drivers: Mapping[str, str | Driver] | None = None,
    workers: int = 1,
    memory: str | float = DEFAULT_MEMORY,
) -> Repaired:
    """Repair a damaged study.

    Intact content is kept. Scenarios that lost content are run again with the study's simulator and settings. If their
    parameters are lost, the optimizer proposes them again. If their number is lost, the exploration continues up to its
    budget. The damaged file is kept under another name. The study is locked for other writers until it is replaced.

    Parameters
    ----------
    study : path
    scenario : path or Scenario, optional
        The explored file. By default it is searched for at its stored path, next to the study and in the current
        folder, and recognized by its fingerprint.
    simulator : str, optional
        Default: that of the study, without options.
    drivers : mapping of str to str or Driver, optional
        Your own drivers by entity, if the study has such; presets are taken from the study.
    workers : int, default 1
        Number of simulators that run in parallel.
    memory : str or float, default "4 GB"
        Memory limit of the process, as text or in bytes.

    Returns
    -------
    Repaired

    Raises
    ------
    InputError
        The study cannot be repaired, something needed is missing, another process writes to it, it changed meanwhile,
        or more memory is needed; the study is left unchanged.

    See Also
    --------
    cornercase.study.verify : Lists the damage.
    """
    file = path("study", study)
    # Replace the target of a symbolic link, not the link.
    file = file.resolve()
    workers = whole_number("workers", workers, least=1)
    limit = MemoryLimit.of(memory)
    with _said(file), alone_in(file.parent):
        _take_back(file)
    if verify(file).sound:
        return Repaired(file, None, (), ())

    with _said(file), ExitStack() as exit_stack, _undone(file), HeldFile(file) as held:
        size = file.stat().st_size
        need = _COPIES * size
        limit.require(need, f"the contents of a study of {size_in_words(size)}", "give more")
        state_need("The contents of the study", need)
        with written_whole(file) as temporary, _named(temporary, file):
            temporary.unlink()
            remains = rebuild(file, temporary)
            lost = list(remains.lost)
            held.lock()
            if remains.again or not remains.counted:
                _require_runnable(file, remains)
                _run_again(file, temporary, remains, scenario, simulator, drivers or {}, workers)
            if not remains.counted:
                lost.append(f"how many scenarios it had; its search went on to its budget of {remains.meta.budget}")
            lost += _still_other(temporary, remains)
            # Flush now: nothing slow may come between `require_same` and the replacement.
            force_file(temporary)
            # Another repair would undo this one halfway.
            exit_stack.enter_context(alone_in(file.parent))
            held.require_same()
            held.release_to_rename()
            damaged_copy = _keep(file)
            held.moved(damaged_copy)
    return Repaired(file, damaged_copy, remains.again, tuple(lost))


@contextmanager
def _said(file: Path) -> Iterator[None]:
    """Turn file system and SQLite errors into one sentence."""
    try:
        yield
    except (OSError, sqlite3.Error) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise InputError(f"{file}: cannot be repaired ({reason}); make room, or copy it elsewhere.") from error


@contextmanager
def _named(made: Path, file: Path) -> Iterator[None]:
    """Replace the name of the temporary file in errors by the user's."""
    try:
        yield
    except InputError as error:
        text = str(error).replace(str(made), str(file))
        raise error if text == str(error) else InputError(text) from error


@contextmanager
def _undone(file: Path) -> Iterator[None]:
    """Remove the second name of the damaged file if the study is not replaced after all."""
    try:
        yield
    except BaseException:
        with suppress(OSError):
            _take_back(file)
        raise


def _keep(file: Path) -> Path:
    """Give the damaged file a second name, so that its own name always exists."""
    damaged_copy = _free_name(file)
    try:
        os.link(file, damaged_copy)
    except OSError:
        # Not all file systems have hard links.
        with written_whole(damaged_copy) as copy:
            shutil.copyfile(file, copy)
    for ending in OF_SQLITE:
        companion = file.with_name(file.name + ending)
        if companion.exists():
            os.replace(companion, damaged_copy.with_name(damaged_copy.name + ending))
    return damaged_copy


def _take_back(file: Path) -> None:
    """Undo `_keep_damaged_file` if a killed repair left the damaged file with two names."""
    for damaged_copy in takewhile(Path.exists, _names(file)):
        if not damaged_copy.samefile(file):
            continue
        for ending in OF_SQLITE:
            companion, original = damaged_copy.with_name(damaged_copy.name + ending), file.with_name(file.name + ending)
            if original.exists() and original.stat().st_size:
                # Another process has written to the study since.
                companion.unlink(missing_ok=True)
            elif companion.exists():
                os.replace(companion, original)
        damaged_copy.unlink()


def _free_name(file: Path) -> Path:
    return next(name for name in _names(file) if not name.exists())


def _names(file: Path) -> Iterator[Path]:
    """Names for damaged files, in order."""
    yield file.with_name(file.name + _DAMAGED)
    yield from (file.with_name(f"{file.name}{_DAMAGED}-{number}") for number in count(2))


def _require_runnable(file: Path, remains: Remains) -> None:
    meta, again = remains.meta, len(remains.again)
    if meta.simulator == IMPORTED or meta.optimizer == "none" or meta.optimizer.startswith("importance-sampling:"):
        command = "import" if meta.simulator == IMPORTED else "test" if meta.suite else "estimate"
        problem = f"{again} of its scenarios are damaged" if again else "the number of its scenarios is lost"
        raise InputError(
            f"{file}: {problem}, and no search can propose them again; run `{command}` again, with another file name."
        )
    if meta.asynchronous and not all(remains.rounds.values()):
        raise InputError(
            f"{file}: the list of its scenarios is lost, and a search without rounds cannot be repeated; run"
            " `explore` again with another study."
        )


def _still_other(made: Path, remains: Remains) -> list[str]:
    """Name tables that differ from their stored row counts and checksums."""
    with Study.open(made) as opened:
        totals = opened.tallies()
    skipped = ("notes", "outcomes", "analyses", "arrays")
    different = [
        name for name, total in remains.tallies.items() if name not in skipped and totals.get(name, (0, 0)) != total
    ]
    return [f"its table {name} is not what it was" for name in sorted(different)]


def _run_again(
    file: Path,
    made: Path,
    remains: Remains,
    scenario: Path | str | Scenario | None,
    simulator: str | None,
    drivers: Mapping[str, str | Driver],
    workers: int,
) -> None:
    with Study.open(made, readonly=False) as opened:
        config = replace(configuration_of(opened, file, scenario, simulator, drivers), workers=workers)
        objective = config.objective()
        optimizer = create_optimizer(
            config.optimizer,
            config.logical.space,
            config.seed,
            threshold=config.threshold(objective),
            budget=config.budget,
        )
        with configured_simulator(config) as running, started_references(config) as references:
            require_same_runs(file, opened.meta, running)
            explorer_class = _Repairer if remains.counted or not config.asynchronous else AsynchronousExplorer
            explorer = explorer_class(config, running, optimizer, opened, objective, references)
            if isinstance(explorer, _Repairer):
                explorer.repair(remains.rounds, remains.counted)
            else:
                explorer.run()


class _Repairer(ScenarioExplorer):
    """Runs the pending scenarios of a study, and asks its optimizer for lost ones."""

    def repair(self, rounds: Mapping[int, int], counted: bool) -> None:
        """Restore the study round by round.

        `rounds` maps scenario ids to rounds, 0 if unknown. If not `counted`, the number of scenarios is lost and the
        search continues up to its budget.
        """
        self._counted = counted
        if not counted:
            rounds = dict.fromkeys(range(1, self._configuration.budget + 1), 0) | dict(rounds)
        elif all(rounds.values()):
            # All rounds are known, so the optimizer is not needed.
            self._simulate([row for row in self._study.rows() if row.state == "pending"], None)
            return
        self._search = Search(self._optimizer, self._study.meta.asynchronous)
        self._proposer = Proposer(self._search, self._study)
        minimized = self._objective.oriented_of(self._study)
        scores: dict[int, Any] = dict(zip((row.id for row in self._study.done()), minimized, strict=True))
        batch, done = self._configuration.batch, 0
        for number, members in groupby(_filled(rounds, batch).items(), key=lambda item: item[1]):
            ids = [scenario for scenario, _ in members]
            rows_by_id = {row.id: row for row in self._study.rows_of(number)}
            if missing := [scenario for scenario in ids if scenario not in rows_by_id]:
                rows_by_id |= self._proposed_again(number, ids, missing, done, rows_by_id)
            rows = [rows_by_id[scenario] for scenario in ids if scenario in rows_by_id]
            if not rows:
                return
            scores |= self._simulate([row for row in rows if row.state == "pending"], None)
            self._tell(rows, scores)
            done += len(rows)

    def _proposed_again(
        self, number: int, ids: Sequence[int], missing: Sequence[int], done: int, there: Mapping[int, Row]
    ) -> dict[int, Row]:
        points = self._proposer.propose(done, len(ids))
        if not self._counted:
            # The search may have fewer proposals.
            ids = ids[: len(points)]
            missing = [scenario for scenario in missing if scenario in ids]
        same = len(points) == len(ids) and all(
            np.array_equal(points[k], there[scenario].point) for k, scenario in enumerate(ids) if scenario in there
        )
        if not same:
            raise InputError(
                f"{self._study.path}: its search does not propose the same scenarios again, for example because of"
                " another version of cornercase; run `explore` again with another study."
            )
        indices = [ids.index(scenario) for scenario in missing]
        rows = self._study.writer.propose(number, points[indices], self._space.values(points[indices]), missing)
        return {row.id: row for row in rows}


def _filled(rounds: Mapping[int, int], batch: int) -> dict[int, int]:
    """Fill in unknown rounds: that of the scenario before, until the round is full."""
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
