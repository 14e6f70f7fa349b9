"""Message and exit code of a command that is interrupted."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import typer
from typer.core import TyperGroup

from cornercase._common.interrupts import hear_requests, last_request


class InterruptedGroup(TyperGroup):
    """Command group that reports interrupts in a sentence; typer would exit silently."""

    def make_context(self, *given: Any, **more: Any) -> Any:
        """Parse the command line; an interrupt raises `typer.Exit` with `interrupt_exit_code`."""
        with _end_in_a_sentence():
            # Again, as typer has replaced one of the hooks.
            hear_requests()
            return super().make_context(*given, **more)

    def invoke(self, ctx: Any) -> Any:
        """Run the command; an interrupt raises `typer.Exit` with `interrupt_exit_code`."""
        with _end_in_a_sentence():
            return super().invoke(ctx)


@contextmanager
def _end_in_a_sentence() -> Iterator[None]:
    """Report an interrupt and exit with its code."""
    try:
        yield
    except KeyboardInterrupt as error:
        tell_of_interrupt()
        raise typer.Exit(exit_code()) from error


def tell_of_interrupt() -> None:
    """Print that the command was interrupted, and by which signal."""
    number = last_request()
    signal_name = "" if number == signal.SIGINT else f" by {number.name}"
    typer.echo(
        f"Interrupted{signal_name}; nothing unfinished was written, and the same command can be run again.", err=True
    )


def exit_code() -> int:
    """Return the exit code that shells give: 130 for Ctrl-C, 143 for SIGTERM, 129 for a closed terminal."""
    return 128 + last_request()
