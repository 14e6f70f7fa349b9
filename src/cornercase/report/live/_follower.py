"""Background thread that follows a study which another process writes, and reads each scenario when it has ended."""

from __future__ import annotations

import secrets
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal

from cornercase._common.errors import InputError
from cornercase.report.live._live_scenario_reader import LiveScenario, LiveScenarioReader
from cornercase.study import StudyFile, StudyMeta

# Seconds between two polls of the study.
_POLL_SECONDS: Final = 0.25
# Additional seconds before an unreadable study is polled again.
_RETRY_SECONDS: Final = 1.0
# Number of scenarios that are read before they are shown together.
_BATCH_SIZE: Final = 100


@dataclass(frozen=True)
class StudyProgress:
    """Progress of a study: numbers of scenarios, and the time of the last new scenario."""

    name: Literal["waiting", "live"] = "waiting"
    why: str = ""  # sentence that says what is waited for
    run: int = 0
    failed: int = 0
    pending: int = 0
    last: float | None = None  # time of the last new scenario, in s since 1970; None before one arrived

    @property
    def ended(self) -> int:
        """Number of scenarios that were run or failed."""
        return self.run + self.failed


class StudyFollower:
    """Background thread that reads new scenarios of a study while another process writes the study.

    The study may appear later or be replaced, and the other process may restart.

    Attributes: `state` is the progress, `n_changes` counts changes of the study, `notes` are notes by scenario id.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.state = StudyProgress()
        self.n_changes = 0
        self.notes: dict[int, str] = {}
        self._server = secrets.token_hex(4)
        self._generation = 0
        self._meta: StudyMeta | None = None
        self._digests: list[LiveScenario] = []
        self._lock = threading.Lock()
        self._stop_event = threading.Event()
        self._thread = threading.Thread(target=self._run, name="follower of a study", daemon=True)
        self._reset()

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self) -> None:
        """Stop the thread, and wait at most 5 s for its end."""
        self._stop_event.set()
        if self._thread.is_alive():
            self._thread.join(timeout=5.0)

    @property
    def epoch(self) -> str:
        """Identifier of the followed study, which changes when the study is replaced or started again."""
        return f"{self._server}-{self._generation}"

    def snapshot(self) -> tuple[str, StudyMeta | None, list[LiveScenario], StudyProgress]:
        """Return epoch, metadata, scenarios in the order in which they were read, and progress, at the same moment.

        The epoch is a text that identifies the followed study. The metadata are None without a study.
        """
        with self._lock:
            return self.epoch, self._meta, list(self._digests), self.state

    def scenarios_since(
        self, epoch: str, n_known: int, max_digests: int = _BATCH_SIZE
    ) -> tuple[Sequence[LiveScenario], StudyProgress | None] | None:
        """Return up to `max_digests` scenarios after the first `n_known`, and the progress if no more scenarios follow.

        `epoch` identifies the study that contains the first `n_known` scenarios. The result is None if this thread
        follows another study now.
        """
        with self._lock:
            if epoch != self.epoch:
                return None
            is_all = n_known + max_digests >= len(self._digests)
            return self._digests[n_known : n_known + max_digests], self.state if is_all else None

    def _reset(self, why: str = "Nothing was looked at yet.") -> None:
        with self._lock:
            self._generation += 1
            self._meta = None
            self._digests = []
            self.state = StudyProgress(why=why)
        self.notes = {}
        self._next_id, self._pending_ids = 1, set[int]()
        self._failed_errors: dict[int, str | None] = {}
        self._file_stamp: Any = None
        self._last_version: int | None = None

    def _run(self) -> None:
        study: StudyFile | None = None
        while not self._stop_event.is_set():
            try:
                study = self._poll(study)
            except (InputError, OSError) as error:
                # The file may be half copied, and complete the next time.
                self._drop_study(study, str(error))
                study = None
                self._stop_event.wait(_RETRY_SECONDS)
            self._stop_event.wait(_POLL_SECONDS)
        if study is not None:
            study.close()

    def _drop_study(self, study: StudyFile | None, why: str) -> None:
        if study is not None:
            study.close()
        if self._meta is not None:
            self._reset(why)
        else:
            self.state = StudyProgress(why=why)

    def _poll(self, study: StudyFile | None) -> StudyFile | None:
        """Read new scenarios of the study, opening it if necessary; return None if the file must be opened again."""
        stamp = _file_stamp(self.path)
        if stamp is None:
            self._drop_study(study, f"{self.path.name} is not there yet.")
            return None
        if study is not None and (
            stamp[0] != self._file_stamp[0] or (study.data_version() is None and stamp != self._file_stamp)
        ):
            study.close()
            study = None
        if study is None:
            study = StudyFile.open(self.path, readonly=True)
            if self._meta is not None and not (
                self._file_stamp[0] == stamp[0] and _is_same_search(self._meta, study.meta)
            ):
                self._reset()
            self._file_stamp, self._last_version = stamp, -1
            with self._lock:
                self._meta = study.meta
        version = study.data_version()
        if version is not None and version == self._last_version:
            return study
        self._last_version = version
        if not self._read_new(study):
            study.close()
            return None
        self.n_changes += 1
        return study

    def _read_new(self, study: StudyFile) -> bool:
        """Read new scenarios; return False if the file must be opened again, as the study or a part was replaced."""
        with study.snapshot():
            is_same_meta = study.read_meta() == study.meta
            rows = study.rows_from_id(min(self._pending_ids, default=self._next_id))
            is_cleared = self._next_id > 1 and not study.rows_from_id(self._next_id - 1)
            notes = study.notes()
            # Failed scenarios may be run again.
            failed = {row.id: row.error for row in study.failed_rows()} if self._failed_errors else {}
        if is_cleared or not self._failed_errors.items() <= failed.items():
            self._reset()
            return False
        if not is_same_meta:
            return False
        ended = [
            row for row in rows if row.state != "pending" and (row.id >= self._next_id or row.id in self._pending_ids)
        ]
        pending = {row.id for row in rows if row.state == "pending"}
        is_first = self.state.name == "waiting"
        digester = LiveScenarioReader(study)
        if notes != self.notes:
            self.notes = notes
        for k in range(0, len(ended), _BATCH_SIZE):
            if self._stop_event.is_set():
                return True
            digests = [digester.read(row) for row in ended[k : k + _BATCH_SIZE]]
            self._add_scenarios(digests, len(pending), None if is_first else time.time())
        self._next_id = max(self._next_id, max((row.id for row in rows), default=0) + 1)
        self._pending_ids = pending
        self._add_scenarios((), len(pending), self.state.last)
        return True

    def _add_scenarios(self, digests: Sequence[LiveScenario], n_pending: int, last_time: float | None) -> None:
        """Add scenarios and update the progress under one lock, so that the progress always matches the scenarios."""
        self._failed_errors |= {digest.row.id: digest.row.error for digest in digests if digest.row.state == "failed"}
        failed = len(self._failed_errors)
        with self._lock:
            self._digests += digests
            self.state = StudyProgress("live", "", len(self._digests) - failed, failed, n_pending, last_time)


def _is_same_search(one: StudyMeta, other: StudyMeta) -> bool:
    # A resumed search may have a different budget.
    return replace(one, budget=0) == replace(other, budget=0)


def _file_stamp(path: Path) -> tuple[tuple[int, int], int, int] | None:
    """Return device and inode, modification time and size of a file; None if it does not exist."""
    try:
        status = path.stat()
    except OSError:
        return None
    return (status.st_dev, status.st_ino), status.st_mtime_ns, status.st_size
