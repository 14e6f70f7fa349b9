"""What a command says when it is asked to end before it has ended."""

from __future__ import annotations

import signal
from typing import Any

import typer
from typer.core import TyperGroup

from cornercase._common.interrupts import last_request


class InterruptedGroup(TyperGroup):
    """Commands that say so in a sentence when they are interrupted."""

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
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as error:
            number = last_request()
            by = "" if number == signal.SIGINT else f" by {number.name}"
            typer.echo(
                f"Interrupted{by}; what was not finished is not written, and the same command can be given again.",
                err=True,
            )
            raise typer.Exit(exit_code()) from error


def exit_code() -> int:
    """Return the exit code of a command that was interrupted.

    Returns
    -------
    int
        As shells give it: 130 for Ctrl-C, 143 for SIGTERM, 129 for a terminal that was closed.
    """
    return 128 + last_request()
