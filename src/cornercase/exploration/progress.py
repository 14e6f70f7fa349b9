"""How far an exploration is, for a person who waits."""

from __future__ import annotations

import sys
import time
from typing import Any, Final

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

_SECONDS_BETWEEN_LINES: Final = 5.0


class ProgressBar:
    """Shows the best score so far, the rate and the time left: a bar on a terminal, now and then a line elsewhere.

    Parameters
    ----------
    total : int
        Scenarios in all.
    """

    def __init__(self, total: int) -> None:
        self._total = total
        self._begun, self._first, self._said, self._done = time.monotonic(), -1, 0.0, -1
        console = Console(stderr=True)
        self._progress: Progress | None = None
        self._task: Any = None
        if console.is_terminal:
            self._progress = Progress(
                TextColumn("exploring"),
                BarColumn(),
                MofNCompleteColumn(),
                TextColumn("{task.fields[rate]}"),
                TimeRemainingColumn(),
                TextColumn("{task.fields[best]}"),
                console=console,
            )
            self._progress.start()
            self._task = self._progress.add_task("", total=total, rate="", best="")

    def update(self, done: int, best: str) -> None:
        """Show how many scenarios have ended, and the best score in words."""
        if self._first < 0:
            self._first = done
        now = time.monotonic()
        rate = (done - self._first) / max(now - self._begun, 1e-9)
        if self._progress is not None:
            self._progress.update(self._task, completed=done, rate=f"{rate:.1f}/s", best=best)
        elif now - self._said > _SECONDS_BETWEEN_LINES or (done >= self._total and done != self._done):
            self._said, self._done = now, done
            left = f"{(self._total - done) / rate:.0f} s left" if rate > 0 else "starting"
            said = [f"{done} of {self._total} scenarios", f"{rate:.1f}/s", left, best]
            print(", ".join(filter(None, said)), file=sys.stderr, flush=True)

    def stop(self) -> None:
        """Leave the terminal as it was."""
        if self._progress is not None:
            self._progress.stop()
