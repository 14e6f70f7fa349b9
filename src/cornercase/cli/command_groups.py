"""Command group whose help lists the commands by purpose."""

from __future__ import annotations

from typing import Any, Final

from cornercase.cli.signals import InterruptibleGroup

COMMANDS_BY_PURPOSE: Final = {
    "Find critical scenarios": ("check", "vary", "explore", "demo", "paper"),
    "Understand them, and keep a few": ("show", "analyze", "reduce", "report", "watch", "replay", "export"),
    "Test a system": ("test", "compare", "estimate"),
    "Single scenarios and recordings": ("simulate", "measure", "import", "convert"),
    "What can be chosen": ("metrics", "simulators", "drivers"),
    "Check what is attached or stored": ("check-sut", "check-simulator", "verify", "warm-up"),
}
"""Commands by purpose, in the order in which a first study needs them."""

_MAX_SENTENCE: Final = 200


class GroupedCommands(InterruptibleGroup):
    """Command group whose help has a section for each purpose."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write a section of the help for each purpose; click calls this method."""
        width = max(map(len, self.commands))
        for heading, names in COMMANDS_BY_PURPOSE.items():
            with formatter.section(heading):
                # The first sentence as a whole.
                formatter.write_dl(
                    [(f"{name:{width}}", self.commands[name].get_short_help_str(_MAX_SENTENCE)) for name in names]
                )
