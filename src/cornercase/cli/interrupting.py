"""What a command says when it is asked to end before it has ended."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import typer
from typer.core import TyperGroup

from cornercase._common.interrupts import hear_requests, last_request


class InterruptedGroup(TyperGroup):
    """Commands that say so in a sentence when they are interrupted."""

    def make_context(self, *given: Any, **more: Any) -> Any:
        """Read the words of the command.

        Parameters
        ----------
        *given, **more
            As click has them.

        Returns
        -------
        click.Context

        Raises
        ------
        typer.Exit
            It was interrupted, with `exit_code`.
        """
        with _end_in_a_sentence():
            # Again, as typer has put a hook of its own in the place of one.
            hear_requests()
            return super().make_context(*given, **more)

    def invoke(self, ctx: Any) -> Any:
        """Run the command that was asked for.

        Parameters
        ----------
        ctx : click.Context

        Returns
        -------
        object
            What it returned.

        Raises
        ------
        typer.Exit
            It was interrupted, with `exit_code`.
        """
        with _end_in_a_sentence():
            return super().invoke(ctx)


@contextmanager
def _end_in_a_sentence() -> Iterator[None]:
    """Else typer takes each interrupt for Ctrl-C, and says nothing."""
    try:
        yield
    except KeyboardInterrupt as error:
        tell_of_interrupt()
        raise typer.Exit(exit_code()) from error


def tell_of_interrupt() -> None:
    """Say that the command was interrupted, and by what."""
    number = last_request()
    by = "" if number == signal.SIGINT else f" by {number.name}"
    typer.echo(
        f"Interrupted{by}; what was not finished is not written, and the same command can be given again.", err=True
    )


def exit_code() -> int:
    """Return the exit code of a command that was interrupted.

    Returns
    -------
    int
        As shells give it: 130 for Ctrl-C, 143 for SIGTERM, 129 for a terminal that was closed.
    """
    return 128 + last_request()
