"""How far something is, for a person who waits."""

from __future__ import annotations

import sys
import time
from typing import Any, Final

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

_SECONDS_BETWEEN_LINES: Final = 5.0


class ProgressBar:
    """Shows the rate, the time left and a word of what is going on: a bar on a terminal, now and then a line elsewhere.

    Parameters
    ----------
    total : int
        Things in all.
    doing : str
        What is done: ``"exploring"``.
    things : str
        Of what there are so many: ``"scenarios"``.
    """

    def __init__(self, total: int, doing: str, things: str) -> None:
        self._total, self._things = total, things
        self._begun, self._first, self._said, self._done = time.monotonic(), -1, 0.0, -1
        console = Console(stderr=True)
        self._progress: Progress | None = None
        self._task: Any = None
        if console.is_terminal:
            self._progress = Progress(
                TextColumn(doing),
                BarColumn(),
                MofNCompleteColumn(),
                TextColumn("{task.fields[rate]}"),
                TimeRemainingColumn(),
                TextColumn("{task.fields[word]}"),
                console=console,
            )
            self._progress.start()
            self._task = self._progress.add_task("", total=total, rate="", word="")

    def update(self, done: int, word: str, total: int | None = None) -> None:
        """Show how many are done, and a word; the number in all where it has become another."""
        self._total = self._total if total is None else total
        if self._first < 0:
            self._first = done
        now = time.monotonic()
        rate = (done - self._first) / max(now - self._begun, 1e-9)
        if self._progress is not None:
            self._progress.update(self._task, completed=done, total=self._total, rate=f"{rate:.1f}/s", word=word)
        elif now - self._said > _SECONDS_BETWEEN_LINES or (done >= self._total and done != self._done):
            self._said, self._done = now, done
            left = f"{(self._total - done) / rate:.0f} s left" if rate > 0 else "starting"
            said = [f"{done} of {self._total} {self._things}", f"{rate:.1f}/s", left, word]
            print(", ".join(filter(None, said)), file=sys.stderr, flush=True)

    def stop(self) -> None:
        """Leave the terminal as it was."""
        if self._progress is not None:
            self._progress.stop()
