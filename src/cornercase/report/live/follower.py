"""Follow a study that another process writes; each scenario that has ended is read once."""

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

# Seconds between two polls of the study.
_PAUSE: Final = 0.25
# Additional seconds before an unreadable study is polled again.
_AFTER_TROUBLE: Final = 1.0
# Scenarios that are read before they are shown.
_AT_ONCE: Final = 100


@dataclass(frozen=True)
class State:
    """Progress of the study."""

    name: Literal["waiting", "live"] = "waiting"
    why: str = ""  # what is waited for, as a sentence
    run: int = 0
    failed: int = 0
    pending: int = 0
    last: float | None = None  # time of the last new scenario, in s since 1970; None before one arrived

    @property
    def ended(self) -> int:
        """Number of scenarios that were run or failed."""
        return self.run + self.failed


class Follower:
    """Follows a study in a background thread, even if it appears later, is replaced, or its writer restarts.

    Attributes: `state`; `n_changes`, a counter of changes to the study; `notes` by scenario id.
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
        """Start following."""
        self._thread.start()

    def stop(self) -> None:
        """Stop following."""
        self._end.set()
        if self._thread.is_alive():
            self._thread.join(timeout=5.0)

    @property
    def epoch(self) -> str:
        """Identifier of the followed study; changes when the study is replaced or starts again."""
        return f"{self._server}-{self._generation}"

    def known(self) -> tuple[str, StudyMeta | None, list[Digest], State]:
        """Return epoch, meta (None without a study), digests in read order, and the state that counts them."""
        with self._lock:
            return self.epoch, self._meta, list(self._digests), self.state

    def since(self, epoch: str, count: int, most: int = _AT_ONCE) -> tuple[Sequence[Digest], State | None] | None:
        """Return up to `max_digests` after the first `n_known`, with the state if these are all.

        None if `epoch` is over.
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
                # It may be half copied, and complete the next time.
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
        """Read what is new in the study and return it; None if it must be opened again."""
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
        version = study.changes()
        if version is not None and version == self._seen:
            return study
        self._seen = version
        if not self._read(study):
            study.close()
            return None
        self.changes += 1
        return study

    def _read(self, study: Study) -> bool:
        """Read new scenarios; return False if the study has become a different one."""
        with study.snapshot():
            is_same_meta = study.stored_meta() == study.meta
            rows = study.rows_from(min(self._pending, default=self._next))
            is_cleared = self._next > 1 and not study.rows_from(self._next - 1)
            notes = study.notes()
            # Failed scenarios may be run again.
            failed = {row.id: row.error for row in study.failed()} if self._failed else {}
        if is_cleared or not self._failed.items() <= failed.items():
            self._reset()
            return False
        if not is_same_meta:
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
            digests = [digester.read(row) for row in ended[k : k + _AT_ONCE]]
            self._count(digests, len(pending), None if is_first else time.time())
        self._next = max(self._next, max((row.id for row in rows), default=0) + 1)
        self._pending = pending
        self._count((), len(pending), self.state.last)
        return True

    def _count(self, read: Sequence[Digest], pending: int, last: float | None) -> None:
        """Add digests and update the state under one lock."""
        self._failed |= {digest.row.id: digest.row.error for digest in read if digest.row.state == "failed"}
        failed = len(self._failed)
        with self._lock:
            self._digests += read
            self.state = State("live", "", len(self._digests) - failed, failed, pending, last)


def _are_alike(one: StudyMeta, other: StudyMeta) -> bool:
    # A resumed search may have a different budget.
    return replace(one, budget=0) == replace(other, budget=0)


def _stamp(path: Path) -> tuple[tuple[int, int], int, int] | None:
    """Return device and inode, modification time and size of a file; None if it does not exist."""
    try:
        status = path.stat()
    except OSError:
        return None
    return (status.st_dev, status.st_ino), status.st_mtime_ns, status.st_size
