"""How far something is, for a person who waits."""

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
# s that must have passed since the first thing was done, before a rate is told: the next may take quite as long.
_SECONDS_OF_A_RATE: Final = 1.0
# s before a step that is often short gets a bar.
_SECONDS_OF_A_SHORT_STEP: Final = 2.0


def words_of_seconds(seconds: float) -> str:
    """Say how long something takes.

    Parameters
    ----------
    seconds : float

    Returns
    -------
    str
        ``"40 s"``, ``"4 min 10 s"``, ``"2 h 5 min"``.
    """
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"


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
    begun : float, optional
        When the first one was begun, by `time.monotonic`; by default it is not known before the first `update`.
    """

    def __init__(self, total: int, doing: str, things: str, begun: float | None = None) -> None:
        self._total, self._things = total, things
        self._said, self._done = 0.0, -1
        # How many were done at first, and how many at which moment since which the rate is counted.
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
        """Show how many are done, and a word; the number in all where it has become another."""
        self._total = self._total if total is None else total
        now = time.monotonic()
        if self._first is None:
            self._first = done
        elif self._since is None and done > self._first:
            # What had to be made ready before the first one says nothing of those that follow.
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
            said = [f"{done} of {self._total} {self._things}", speed, word]
            print(", ".join(filter(None, said)), file=sys.stderr, flush=True)

    def _rate_of(self, done: int, rate: float) -> str:
        """How fast it goes and how long it will take; nothing while nobody can know."""
        if rate <= 0.0:
            return ""
        fast = f"{rate:.1f}/s" if rate >= 0.1 else f"{60.0 * rate:.1f}/min"
        return fast if done >= self._total else f"{fast}, {words_of_seconds((self._total - done) / rate)} left"

    def stop(self) -> None:
        """Leave the terminal as it was."""
        if self._progress is not None:
            self._progress.stop()


loudness: ContextVar[Literal["quiet", "usual", "verbose"]] = ContextVar("loudness", default="usual")
"""Whether no bar is shown, or those of long steps, or all."""

_wanted: ContextVar[bool] = ContextVar("wanted", default=False)


@contextmanager
def bars_wanted(wanted: bool) -> Iterator[None]:
    """Let the steps within the block show bars, or let them be quiet.

    Parameters
    ----------
    wanted : bool

    Yields
    ------
    None
    """
    before = _wanted.set(wanted)
    try:
        yield
    finally:
        _wanted.reset(before)


@contextmanager
def step(total: int, doing: str, things: str) -> Iterator[Callable[[int], None]]:
    """Show a bar for what may take a while, once it does, within `bars_wanted`.

    Parameters
    ----------
    total : int
        Things in all.
    doing : str
        What is done: ``"clustering"``.
    things : str
        Of what there are so many: ``"settings"``.

    Yields
    ------
    callable
        To be called with how many are done.
    """
    begun, bar = time.monotonic(), None
    wanted = _wanted.get()
    short = 0.0 if loudness.get() == "verbose" else _SECONDS_OF_A_SHORT_STEP

    def tell(done: int) -> None:
        nonlocal bar
        if bar is None and wanted and time.monotonic() - begun >= short:
            bar = ProgressBar(total, doing, things, begun)
        if bar is not None:
            bar.update(done, "")

    try:
        yield tell
    finally:
        if bar is not None:
            bar.stop()
