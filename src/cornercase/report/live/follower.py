"""Following a study that others write: each scenario that has ended is read once."""

from __future__ import annotations

import secrets
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal

from cornercase._common.errors import InputError
from cornercase.report.live.digests import Digest, Digester
from cornercase.study import Study, StudyMeta

# s between two looks at the study.
_PAUSE: Final = 0.25
# s more before a study is looked at again that could not be read.
_AFTER_TROUBLE: Final = 1.0
# Scenarios that are read before what was read is shown.
_AT_ONCE: Final = 100


@dataclass(frozen=True)
class State:
    """How far the study is.

    Attributes
    ----------
    name : {"waiting", "live"}
        It is waited for a study, or one is followed.
    why : str
        What is waited for, in a sentence.
    run, failed, pending : int
        Number of scenarios.
    last : float or None
        When the last scenario came in, in s since 1970; None before one came while the study was followed.
    """

    name: Literal["waiting", "live"] = "waiting"
    why: str = ""
    run: int = 0
    failed: int = 0
    pending: int = 0
    last: float | None = None

    @property
    def ended(self) -> int:
        """Number of scenarios that were run or failed."""
        return self.run + self.failed


class Follower:
    """Follows a study, in a thread of its own.

    The study may come, grow, be replaced, or go; whoever writes it may be killed and started again.

    Parameters
    ----------
    path : Path
        Where the study is, or will be.

    Attributes
    ----------
    state : State
    changes : int
        Grows with each thing that is written to the study.
    notes : dict of int to str
        By id.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.state = State()
        self.changes = 0
        self.notes: dict[int, str] = {}
        self._server = secrets.token_hex(4)
        self._generation = 0
        self._meta: StudyMeta | None = None
        self._digests: list[Digest] = []
        self._lock = threading.Lock()
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._follow, name="follower of a study", daemon=True)
        self._reset()

    def start(self) -> None:
        """Begin to follow."""
        self._thread.start()

    def stop(self) -> None:
        """Follow no longer."""
        self._end.set()
        if self._thread.is_alive():
            self._thread.join(timeout=5.0)

    @property
    def epoch(self) -> str:
        """Which study is followed: another text after it was replaced, or begun anew."""
        return f"{self._server}-{self._generation}"

    def known(self) -> tuple[str, StudyMeta | None, list[Digest], State]:
        """Give what was read so far.

        Returns
        -------
        epoch : str
        meta : StudyMeta or None
            None while there is no study.
        digests : list of Digest
            In the order in which they were read.
        state : State
            That counts them.
        """
        with self._lock:
            return self.epoch, self._meta, list(self._digests), self.state

    def since(self, epoch: str, count: int, most: int = _AT_ONCE) -> tuple[Sequence[Digest], State | None] | None:
        """Give what was read after the first scenarios.

        Parameters
        ----------
        epoch : str
            Which study they are of.
        count : int
            How many are known already.
        most : int, default 100
            How many are given at most.

        Returns
        -------
        digests : sequence of Digest
        state : State or None
            That counts them and those that are known already; None where more were read. None is returned where the
            study is another one by now.
        """
        with self._lock:
            if epoch != self.epoch:
                return None
            is_all = count + most >= len(self._digests)
            return self._digests[count : count + most], self.state if is_all else None

    def _reset(self, why: str = "Nothing was looked at yet.") -> None:
        with self._lock:
            self._generation += 1
            self._meta = None
            self._digests = []
            self.state = State(why=why)
        self.notes = {}
        self._next, self._pending = 1, set[int]()
        self._failed: dict[int, str | None] = {}
        self._stamp: Any = None
        self._seen: int | None = None

    def _follow(self) -> None:
        study: Study | None = None
        while not self._end.is_set():
            try:
                study = self._look(study)
            except (InputError, OSError) as error:
                # It may be half copied, or of another version; it may be whole the next time.
                self._lose(study, str(error))
                study = None
                self._end.wait(_AFTER_TROUBLE)
            self._end.wait(_PAUSE)
        if study is not None:
            study.close()

    def _lose(self, study: Study | None, why: str) -> None:
        if study is not None:
            study.close()
        if self._meta is not None:
            self._reset(why)
        else:
            self.state = State(why=why)

    def _look(self, study: Study | None) -> Study | None:
        """Read what is new in the study, and give it; None where it has to be opened again."""
        stamp = _stamp(self.path)
        if stamp is None:
            self._lose(study, f"{self.path.name} is not there yet.")
            return None
        if study is not None and (stamp[0] != self._stamp[0] or (study.changes() is None and stamp != self._stamp)):
            study.close()
            study = None
        if study is None:
            study = Study.open(self.path, readonly=True)
            if self._meta is not None and not (self._stamp[0] == stamp[0] and _are_alike(self._meta, study.meta)):
                self._reset()
            self._stamp, self._seen = stamp, -1
            with self._lock:
                self._meta = study.meta
        seen = study.changes()
        if seen is not None and seen == self._seen:
            return study
        self._seen = seen
        if not self._read(study):
            study.close()
            return None
        self.changes += 1
        return study

    def _read(self, study: Study) -> bool:
        """Read what is new; False where the study has become another one."""
        with study.snapshot():
            same = study.stored_meta() == study.meta
            rows = study.rows_from(min(self._pending, default=self._next))
            is_cleared = self._next > 1 and not study.rows_from(self._next - 1)
            notes = study.notes()
            # Scenarios that failed may be run again.
            failed = {row.id: row.error for row in study.failed()} if self._failed else {}
        if is_cleared or not self._failed.items() <= failed.items():
            self._reset()
            return False
        if not same:
            return False
        ended = [row for row in rows if row.state != "pending" and (row.id >= self._next or row.id in self._pending)]
        pending = {row.id for row in rows if row.state == "pending"}
        is_first = self.state.name == "waiting"
        digester = Digester(study)
        if notes != self.notes:
            self.notes = notes
        for k in range(0, len(ended), _AT_ONCE):
            if self._end.is_set():
                return True
            read = [digester.read(row) for row in ended[k : k + _AT_ONCE]]
            self._count(read, len(pending), None if is_first else time.time())
        self._next = max(self._next, max((row.id for row in rows), default=0) + 1)
        self._pending = pending
        self._count((), len(pending), self.state.last)
        return True

    def _count(self, read: Sequence[Digest], pending: int, last: float | None) -> None:
        """Take up what was read, and count it in the same moment."""
        self._failed |= {one.row.id: one.row.error for one in read if one.row.state == "failed"}
        failed = len(self._failed)
        with self._lock:
            self._digests += read
            self.state = State("live", "", len(self._digests) - failed, failed, pending, last)


def _are_alike(one: StudyMeta, other: StudyMeta) -> bool:
    # A search that goes on may have another budget.
    return replace(one, budget=0) == replace(other, budget=0)


def _stamp(path: Path) -> tuple[tuple[int, int], int, int] | None:
    """Tell a file from another of the same name, and whether it was written; None where there is none."""
    try:
        found = path.stat()
    except OSError:
        return None
    return (found.st_dev, found.st_ino), found.st_mtime_ns, found.st_size
