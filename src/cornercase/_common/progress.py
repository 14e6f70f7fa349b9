"""Progress bars and progress lines."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, Final, Literal

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

_SECONDS_BETWEEN_LINES: Final = 5.0
# Seconds after the first item before a rate is shown; it would be too uncertain earlier.
_SECONDS_OF_A_RATE: Final = 1.0
# Seconds before a step, which is often short, gets a bar.
_SECONDS_OF_A_SHORT_STEP: Final = 2.0


def words_of_seconds(seconds: float) -> str:
    """Format a duration: ``"40 s"``, ``"4 min 10 s"``, ``"2 h 5 min"``."""
    total = round(seconds)
    if total < 60:
        return f"{total} s"
    if total < 3600:
        return f"{total // 60} min {total % 60} s"
    return f"{total // 3600} h {total % 3600 // 60} min"


class ProgressBar:
    """Shows progress, rate, time left and a status word: a bar on a terminal, otherwise a line every few seconds.

    `activity` is the activity (``"exploring"``), `unit` what is counted (``"scenarios"``), `start_time` the start by
    `time.monotonic`; without it, the rate is counted from the first `update` on.
    """

    def __init__(self, total: int, doing: str, things: str, begun: float | None = None) -> None:
        self._total, self._things = total, things
        self._said, self._done = 0.0, -1
        # Number done at first; (number done, time) from which the rate is counted.
        self._first: int | None = None
        self._since: tuple[int, float] | None = None if begun is None else (0, begun)
        console = Console(stderr=True)
        self._progress: Progress | None = None
        self._task: Any = None
        self._quiet = loudness.get() == "quiet"
        if console.is_terminal and not self._quiet:
            self._progress = Progress(
                TextColumn(doing),
                BarColumn(),
                MofNCompleteColumn(),
                TextColumn("{task.fields[rate]}"),
                TextColumn("{task.fields[word]}"),
                console=console,
            )
            self._progress.start()
            self._task = self._progress.add_task("", total=total, rate="", word="")

    def update(self, done: int, word: str, total: int | None = None) -> None:
        """Show the number done and a status word; `total` if it has changed."""
        self._total = self._total if total is None else total
        now = time.monotonic()
        if self._first is None:
            self._first = done
        elif self._since is None and done > self._first:
            # The preparation of the first item says nothing about the rate.
            self._since = (done, now)
        rate = 0.0
        if self._since is not None and now - self._since[1] >= _SECONDS_OF_A_RATE:
            rate = (done - self._since[0]) / (now - self._since[1])
        speed = self._rate_of(done, rate)
        if self._progress is not None:
            self._progress.update(self._task, completed=done, total=self._total, rate=speed, word=word)
        elif not self._quiet and (
            now - self._said > _SECONDS_BETWEEN_LINES or (done >= self._total and done != self._done)
        ):
            self._said, self._done = now, done
            parts = [f"{done} of {self._total} {self._things}", speed, word]
            print(", ".join(filter(None, parts)), file=sys.stderr, flush=True)

    def _rate_of(self, done: int, rate: float) -> str:
        """Format rate and time left; empty while they are unknown."""
        if rate <= 0.0:
            return ""
        text = f"{rate:.1f}/s" if rate >= 0.1 else f"{60.0 * rate:.1f}/min"
        return text if done >= self._total else f"{text}, {words_of_seconds((self._total - done) / rate)} left"

    def stop(self) -> None:
        """Remove the bar from the terminal."""
        if self._progress is not None:
            self._progress.stop()


loudness: ContextVar[Literal["quiet", "usual", "verbose"]] = ContextVar("loudness", default="usual")
"""Whether no bars are shown, those of long steps, or all."""

_wanted: ContextVar[bool] = ContextVar("wanted", default=False)


@contextmanager
def bars_wanted(wanted: bool) -> Iterator[None]:
    """Enable or disable the bars of `progress_step` within the block."""
    before = _wanted.set(wanted)
    try:
        yield
    finally:
        _wanted.reset(before)


@contextmanager
def step(total: int, doing: str, things: str) -> Iterator[Callable[[int], None]]:
    """Show a bar for a step that takes long, within `show_bars`; yields a function to call with the number done."""
    start, bar = time.monotonic(), None
    is_enabled = _wanted.get()
    delay = 0.0 if loudness.get() == "verbose" else _SECONDS_OF_A_SHORT_STEP

    def tell(done: int) -> None:
        nonlocal bar
        if bar is None and is_enabled and time.monotonic() - start >= delay:
            bar = ProgressBar(total, doing, things, start)
        if bar is not None:
            bar.update(done, "")

    try:
        yield tell
    finally:
        if bar is not None:
            bar.stop()
