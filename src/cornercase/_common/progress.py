"""Progress bars in terminals and notebooks, lines of text in files."""

from __future__ import annotations

import importlib
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from html import escape
from typing import Any, Final, Literal

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

_SECONDS_BETWEEN_LINES: Final = 5.0
# A notebook stores each state of a bar that is sent to it.
_SECONDS_BETWEEN_NOTEBOOK_UPDATES: Final = 0.2
# Seconds after the first item before a rate is shown; it would be too uncertain earlier.
_MIN_SECONDS_FOR_RATE: Final = 1.0
# Seconds before a step, which is often short, gets a bar.
_SECONDS_BEFORE_BAR: Final = 2.0


def format_duration(seconds: float) -> str:
    """Format a duration: ``"40 s"``, ``"4 min 10 s"``, ``"2 h 5 min"``."""
    total = round(seconds)
    if total < 60:
        return f"{total} s"
    if total < 3600:
        return f"{total // 60} min {total % 60} s"
    return f"{total // 3600} h {total % 3600 // 60} min"


class ProgressBar:
    """Display of progress, rate, remaining time and a status: a bar in terminals and notebooks, otherwise lines.

    `activity` is a word such as ``"exploring"``, and `unit` is the noun for what is counted, such as ``"scenarios"``.
    `start_time` is the start by `time.monotonic`; if it is None, the rate is measured from the moment at which `update`
    first gets a higher number than in its first call.
    Nothing is shown unless `enabled`.
    """

    def __init__(
        self, total: int, activity: str, unit: str, start_time: float | None = None, *, enabled: bool = True
    ) -> None:
        self._total, self._unit = total, unit
        self._last_line_time, self._last_n_done = 0.0, -1
        # Number done at first; (number done, time) from which the rate is counted.
        self._first_n_done: int | None = None
        self._rate_start: tuple[int, float] | None = None if start_time is None else (0, start_time)
        console = Console(stderr=True)
        self._progress: Progress | None = None
        self._task: Any = None
        self._is_quiet = not enabled or verbosity.get() == "quiet"
        self._notebook_bar = _NotebookBar(activity, unit) if _is_in_notebook() and not self._is_quiet else None
        if self._notebook_bar is not None:
            self._notebook_bar.show(0, total, "", is_last=True)
        elif console.is_terminal and not self._is_quiet:
            self._progress = Progress(
                TextColumn(activity),
                BarColumn(),
                MofNCompleteColumn(),
                TextColumn("{task.fields[rate]}"),
                TextColumn("{task.fields[word]}"),
                console=console,
            )
            self._progress.start()
            self._task = self._progress.add_task("", total=total, rate="", word="")

    def update(self, n_done: int, status: str, total: int | None = None) -> None:
        """Show the number done and a status word; pass `total` if it has changed."""
        self._total = self._total if total is None else total
        now = time.monotonic()
        if self._first_n_done is None:
            self._first_n_done = n_done
        elif self._rate_start is None and n_done > self._first_n_done:
            # The preparation of the first item says nothing about the rate.
            self._rate_start = (n_done, now)
        rate = 0.0
        if self._rate_start is not None and now - self._rate_start[1] >= _MIN_SECONDS_FOR_RATE:
            rate = (n_done - self._rate_start[0]) / (now - self._rate_start[1])
        speed = self._format_rate(n_done, rate)
        if self._notebook_bar is not None:
            text = ", ".join(filter(None, (speed, status)))
            self._notebook_bar.show(n_done, self._total, text, is_last=n_done >= self._total)
        elif self._progress is not None:
            self._progress.update(self._task, completed=n_done, total=self._total, rate=speed, word=status)
        elif not self._is_quiet and (
            now - self._last_line_time > _SECONDS_BETWEEN_LINES
            or (n_done >= self._total and n_done != self._last_n_done)
        ):
            self._last_line_time, self._last_n_done = now, n_done
            parts = [f"{n_done} of {self._total} {self._unit}", speed, status]
            print(", ".join(filter(None, parts)), file=sys.stderr, flush=True)

    def _format_rate(self, n_done: int, rate: float) -> str:
        """Return rate and remaining time as text; empty as long as they are unknown."""
        if rate <= 0.0:
            return ""
        text = f"{rate:.1f}/s" if rate >= 0.1 else f"{60.0 * rate:.1f}/min"
        return text if n_done >= self._total else f"{text}, {format_duration((self._total - n_done) / rate)} left"

    def stop(self) -> None:
        """Remove the bar from the terminal."""
        if self._progress is not None:
            self._progress.stop()


class _NotebookBar:
    """A bar in the output of a notebook's cell."""

    def __init__(self, activity: str, unit: str) -> None:
        self._activity, self._unit = activity, unit
        self._display: Any = None
        self._last_time = 0.0

    def show(self, n_done: int, total: int, text: str, *, is_last: bool) -> None:
        """Show the progress; calls that follow too soon are skipped, except the last one."""
        now = time.monotonic()
        if not is_last and now - self._last_time < _SECONDS_BETWEEN_NOTEBOOK_UPDATES:
            return
        self._last_time = now
        label = f"{self._activity}: {n_done} of {total} {self._unit}" + (f", {text}" if text else "")
        ipython: Any = importlib.import_module("IPython.display")
        page = ipython.HTML(f'<progress value="{n_done}" max="{total}"></progress> {escape(label)}')
        if self._display is None:
            self._display = ipython.display(page, display_id=True)
        else:
            self._display.update(page)


def can_show_bar() -> bool:
    """Return whether a progress bar can be seen, because the code runs in a notebook or a terminal."""
    return _is_in_notebook() or sys.stderr.isatty()


def _is_in_notebook() -> bool:
    """Return whether the code runs in the kernel of a notebook."""
    ipython = sys.modules.get("IPython")
    return ipython is not None and "ipykernel" in sys.modules and ipython.get_ipython() is not None


verbosity: ContextVar[Literal["quiet", "usual", "verbose"]] = ContextVar("loudness", default="usual")
"""Choice of progress bars that are shown: none (quiet), bars of long steps (usual), or all (verbose)."""

_bars_enabled: ContextVar[bool] = ContextVar("wanted", default=False)


@contextmanager
def show_bars(enabled: bool) -> Iterator[None]:
    """Within the block, enable or disable the bars that `progress_step` shows."""
    before = _bars_enabled.set(enabled)
    try:
        yield
    finally:
        _bars_enabled.reset(before)


@contextmanager
def progress_step(total: int, activity: str, unit: str) -> Iterator[Callable[[int], None]]:
    """Show a bar for one step of a long computation, if `show_bars` has enabled bars.

    Yields a function to call with the number done so far.
    """
    start, bar = time.monotonic(), None
    is_enabled = _bars_enabled.get()
    delay = 0.0 if verbosity.get() == "verbose" else _SECONDS_BEFORE_BAR

    def update(done: int) -> None:
        nonlocal bar
        if bar is None and is_enabled and time.monotonic() - start >= delay:
            bar = ProgressBar(total, activity, unit, start)
        if bar is not None:
            bar.update(done, "")

    try:
        yield update
    finally:
        if bar is not None:
            bar.stop()
