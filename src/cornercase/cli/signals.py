"""Message and exit code of a command that is interrupted."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import typer
from typer.core import TyperGroup

from cornercase._common.process.signals import install_signal_handlers, last_signal


class InterruptibleGroup(TyperGroup):
    """Command group that prints a sentence when it is interrupted; typer would exit without a message."""

    def make_context(self, *args: Any, **kwargs: Any) -> Any:
        """Parse the command line; if interrupted, print a sentence and exit with `interrupt_exit_code`."""
        with _report_interrupts():
            # Again, as typer has replaced one of the hooks.
            install_signal_handlers()
            return super().make_context(*args, **kwargs)

    def invoke(self, ctx: Any) -> Any:
        """Run the command; if interrupted, print a sentence and exit with `interrupt_exit_code`."""
        with _report_interrupts():
            return super().invoke(ctx)


@contextmanager
def _report_interrupts() -> Iterator[None]:
    """Within the block, turn an interrupt into a sentence and an exit code."""
    try:
        yield
    except KeyboardInterrupt as error:
        print_interrupt()
        raise typer.Exit(interrupt_exit_code()) from error


def print_interrupt() -> None:
    """Print that the command was interrupted, and by which signal."""
    number = last_signal()
    signal_name = "" if number == signal.SIGINT else f" by {number.name}"
    typer.echo(
        f"Interrupted{signal_name}; nothing unfinished was written, and the same command can be run again.", err=True
    )


def interrupt_exit_code() -> int:
    """Return the exit code by the convention of shells: 130 for Ctrl-C, 143 for SIGTERM, 129 for a closed terminal."""
    return 128 + last_signal()
