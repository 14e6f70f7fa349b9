"""A damaged study brought back: what is lost of it is run again."""

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
from cornercase.exploration.again import configuration_of, require_same_runs
from cornercase.exploration.asynchronous import AsynchronousExplorer
from cornercase.exploration.explorer import ScenarioExplorer
from cornercase.exploration.exploring import configured_simulator, started_references
from cornercase.exploration.proposing import Proposer, Search
from cornercase.optimizers import create_optimizer
from cornercase.scenario import Scenario
from cornercase.study import IMPORTED, HeldFile, Remains, Row, Study, rebuild, verify

_DAMAGED: Final = ".damaged"
# Its rows, and those of a table that is read once more.
_COPIES: Final = 1.5


@dataclass(frozen=True)
class Repaired:
    """What became of a damaged study.

    Attributes
    ----------
    study : Path
    damaged : Path or None
        Where the damaged file is now; None where nothing was to be mended.
    again : tuple of int
        Scenarios that were run again.
    lost : tuple of str
        What could not be brought back, in words.
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
    """Bring back a damaged study.

    What is as it was written is kept. Scenarios of which something is lost are run again, with the simulator and the
    settings of the study; where it is lost which they were, its search is asked for them again, and where it is lost
    how many, it goes on until its budget is used up. The damaged file is kept under another name. Until it is replaced
    nobody else can write to it.

    Parameters
    ----------
    study : path
    scenario : path or Scenario, optional
        File that was explored. By default it is looked for where the study names it, beside the study and in the
        current folder, and known by its fingerprint.
    simulator : str, optional
        By default that of the study, without options.
    drivers : mapping of str to str or Driver, optional
        Drivers of your own, by entity, where the study has some; presets are those of the study.
    workers : int, default 1
        Simulators side by side.
    memory : str or float, default "4 GB"
        How much the process may take in all, as text or in bytes.

    Returns
    -------
    Repaired

    Raises
    ------
    InputError
        It cannot be brought back, what it takes is not here, another one writes to it, it changed meanwhile, or it
        needs more memory; the study is left as it is.

    See Also
    --------
    cornercase.study.verify : Tells what is damaged.
    """
    file = path("study", study)
    # A link stays one.
    file = file.resolve()
    workers = whole_number("workers", workers, least=1)
    limit = MemoryLimit.of(memory)
    with _said(file), alone_in(file.parent):
        _take_back(file)
    if verify(file).sound:
        return Repaired(file, None, (), ())
    # What stands beside a temporary name is removed after it; what keeps others out ends when the file is replaced.
    with _said(file), ExitStack() as ends, _undone(file), HeldFile(file) as held:
        size = file.stat().st_size
        need = _COPIES * size
        limit.require(need, f"the contents of a study of {size_in_words(size)}", "give more")
        state_need("The contents of the study", need)
        with written_whole(file) as made, _named(made, file):
            made.unlink()
            remains = rebuild(file, made)
            lost = list(remains.lost)
            held.lock()
            if remains.again or not remains.counted:
                _require_runnable(file, remains)
                _run_again(file, made, remains, scenario, simulator, drivers or {}, workers)
            if not remains.counted:
                lost.append(f"how many scenarios it had; its search went on to its budget of {remains.meta.budget}")
            lost += _still_other(made, remains)
            # That takes time, and nothing may take time after it was looked whether the file is the same.
            force_file(made)
            # Another repair would undo what is half done.
            ends.enter_context(alone_in(file.parent))
            held.require_same()
            held.release_to_rename()
            kept = _keep(file)
            held.moved(kept)
    return Repaired(file, kept, remains.again, tuple(lost))


@contextmanager
def _said(file: Path) -> Iterator[None]:
    """Say in a sentence that a study cannot be repaired for want of room or rights."""
    try:
        yield
    except (OSError, sqlite3.Error) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise InputError(f"{file}: cannot be repaired ({why}); make room, or copy it elsewhere.") from error


@contextmanager
def _named(made: Path, file: Path) -> Iterator[None]:
    """Name a study as the user does: the file that is being made has another name until it is whole."""
    try:
        yield
    except InputError as error:
        words = str(error).replace(str(made), str(file))
        raise error if words == str(error) else InputError(words) from error


@contextmanager
def _undone(file: Path) -> Iterator[None]:
    """Take back the other name of a file that is not replaced after all."""
    try:
        yield
    except BaseException:
        with suppress(OSError):
            _take_back(file)
        raise


def _keep(file: Path) -> Path:
    """Give a damaged file another name besides its own, so that there is always one of its own."""
    kept = _free_name(file)
    try:
        os.link(file, kept)
    except OSError:
        # Not all file systems have such names.
        with written_whole(kept) as copy:
            shutil.copyfile(file, copy)
    for ending in OF_SQLITE:
        beside = file.with_name(file.name + ending)
        if beside.exists():
            os.replace(beside, kept.with_name(kept.name + ending))
    return kept


def _take_back(file: Path) -> None:
    """Undo the keeping of a damaged file that a killed repair left with two names."""
    for kept in takewhile(Path.exists, _names(file)):
        if not kept.samefile(file):
            continue
        for ending in OF_SQLITE:
            beside, own = kept.with_name(kept.name + ending), file.with_name(file.name + ending)
            if own.exists() and own.stat().st_size:
                # Somebody has written to it since.
                beside.unlink(missing_ok=True)
            elif beside.exists():
                os.replace(beside, own)
        kept.unlink()


def _free_name(file: Path) -> Path:
    return next(one for one in _names(file) if not one.exists())


def _names(file: Path) -> Iterator[Path]:
    """Names of damaged files, the first first."""
    yield file.with_name(file.name + _DAMAGED)
    yield from (file.with_name(f"{file.name}{_DAMAGED}-{number}") for number in count(2))


def _require_runnable(file: Path, remains: Remains) -> None:
    meta, again = remains.meta, len(remains.again)
    if meta.simulator == IMPORTED or meta.optimizer == "none" or meta.optimizer.startswith("importance-sampling:"):
        command = "import" if meta.simulator == IMPORTED else "test" if meta.suite else "estimate"
        what = f"{again} of its scenarios are damaged" if again else "the number of its scenarios is lost"
        raise InputError(
            f"{file}: {what}, and no search can make them again; make it again with `{command}`, under another name."
        )
    if meta.asynchronous and not all(remains.rounds.values()):
        raise InputError(
            f"{file}: the list of its scenarios is lost, and a search without rounds cannot be repeated; run"
            " `explore` again, into another study."
        )


def _still_other(made: Path, remains: Remains) -> list[str]:
    """Name tables that are not what they were, where that is known."""
    with Study.open(made) as opened:
        now = opened.tallies()
    skipped = ("notes", "outcomes", "analyses", "arrays")
    other = [name for name, one in remains.tallies.items() if name not in skipped and now.get(name, (0, 0)) != one]
    return [f"its table {name} is not what it was" for name in sorted(other)]


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
        about = replace(configuration_of(opened, file, scenario, simulator, drivers), workers=workers)
        objective = about.objective()
        optimizer = create_optimizer(
            about.optimizer, about.logical.space, about.seed, threshold=about.threshold(objective), budget=about.budget
        )
        with configured_simulator(about) as running, started_references(about) as references:
            require_same_runs(file, opened.meta, running)
            kind = _Repairer if remains.counted or not about.asynchronous else AsynchronousExplorer
            explorer = kind(about, running, optimizer, opened, objective, references)
            if isinstance(explorer, _Repairer):
                explorer.repair(remains.rounds, remains.counted)
            else:
                explorer.run()


class _Repairer(ScenarioExplorer):
    """Runs pending scenarios of a study, and asks its search for those that are lost."""

    def repair(self, rounds: Mapping[int, int], counted: bool) -> None:
        """Go through the rounds of the study, and bring each back.

        Parameters
        ----------
        rounds : mapping of int to int
            Round of each scenario by id; 0 where it is not known.
        counted : bool
            Whether these are all; otherwise the search goes on until its budget is used up.
        """
        self._counted = counted
        if not counted:
            rounds = dict.fromkeys(range(1, self._configuration.budget + 1), 0) | dict(rounds)
        elif all(rounds.values()):
            # Nothing is asked, so nothing has to be told.
            self._simulate([row for row in self._study.rows() if row.state == "pending"], None)
            return
        self._search = Search(self._optimizer, self._study.meta.asynchronous)
        self._proposer = Proposer(self._search, self._study)
        known = self._objective.oriented_of(self._study)
        scores: dict[int, Any] = dict(zip((row.id for row in self._study.done()), known, strict=True))
        batch, done = self._configuration.batch, 0
        for number, members in groupby(_filled(rounds, batch).items(), key=lambda one: one[1]):
            ids = [one for one, _ in members]
            there = {row.id: row for row in self._study.rows_of(number)}
            if missing := [one for one in ids if one not in there]:
                there |= self._proposed_again(number, ids, missing, done, there)
            rows = [there[one] for one in ids if one in there]
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
            # It may have no more.
            ids = ids[: len(points)]
            missing = [one for one in missing if one in ids]
        same = len(points) == len(ids) and all(
            np.array_equal(points[k], there[one].point) for k, one in enumerate(ids) if one in there
        )
        if not same:
            raise InputError(
                f"{self._study.path}: its search does not propose the same scenarios again, as with another version"
                " of cornercase; run `explore` again, into another study."
            )
        wanted = [ids.index(one) for one in missing]
        rows = self._study.writer.propose(number, points[wanted], self._space.values(points[wanted]), missing)
        return {row.id: row for row in rows}


def _filled(rounds: Mapping[int, int], batch: int) -> dict[int, int]:
    """Rounds of all scenarios: those that are not known are in that of the one before, until it is full."""
    later, last = {}, math.inf
    for one in sorted(rounds, reverse=True):
        later[one] = last = rounds[one] or last
    filled: dict[int, int] = {}
    current, count = 1, 0
    for one in sorted(rounds):
        turn = rounds[one] or int(min(current if count < batch else current + 1, later[one]))
        current, count = turn, count + 1 if turn == current else 1
        filled[one] = turn
    return filled
