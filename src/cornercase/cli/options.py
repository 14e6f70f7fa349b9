"""Command line application, and options that several commands share."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer
from rich.console import Console
from rich.text import Text

from cornercase._common.errors import NoticeWarning
from cornercase._common.progress import verbosity
from cornercase._common.text.sanitize import escape_control_characters, format_json, shorten
from cornercase._common.version import __version__
from cornercase.cli.command_groups import GroupedCommands
from cornercase.cli.signals import interrupt_exit_code

if TYPE_CHECKING:
    from cornercase.exploration import ExplorationResult

app = typer.Typer(
    name="cornercase",
    cls=GroupedCommands,
    help="Find, cluster and reduce the critical concrete scenarios of a logical scenario.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


class _EscapingConsole(Console):
    """Console that prints text as it is: markup is not interpreted, and control characters are escaped."""

    def render_str(self, text: str, **options: Any) -> Text:
        return super().render_str(escape_control_characters(text), **options)


_CONSOLE_SETTINGS: Final[Any] = {"soft_wrap": True, "highlight": False, "markup": False, "emoji": False}
out = _EscapingConsole(**_CONSOLE_SETTINGS)
err = _EscapingConsole(stderr=True, **_CONSOLE_SETTINGS)
show_tracebacks: ContextVar[bool] = ContextVar("debugging", default=False)
"""True if failures show tracebacks, as with ``--debug``."""

Option = typer.Option

ScenarioFile = Annotated[Path, typer.Argument(metavar="SCENARIO.xosc", help="OpenSCENARIO file.")]
ScenarioFiles = Annotated[list[Path], typer.Argument(metavar="SCENARIO.xosc…", help="OpenSCENARIO files.")]
ExploredScenario = Annotated[
    Path | None,
    Option(
        metavar="FILE.xosc",
        help="Scenario that was explored; by default searched where this machine explored it, beside the study and in"
        " the current folder.",
    ),
]
NamedScenario = Annotated[
    Path | None,
    Option(
        metavar="FILE.xosc",
        help="Scenario that was explored; by default searched at the stored path, where this machine explored it,"
        " beside the study and in the current folder.",
    ),
]
StudyFile = Annotated[Path, typer.Argument(metavar="STUDY.db", help="Study, as written by explore.")]
StudyOutput = Annotated[Path, Option("--output", "-o", metavar="STUDY.db", help="Study to write or continue.")]
PageOutput = Annotated[Path, Option("--output", "-o", metavar="FILE.html", help="Page to write.")]
CriticalOverride = Annotated[
    float | None,
    Option(
        "--critical",
        metavar="X",
        help="Threshold for this command only: score from which a scenario is critical; default: the study's own.",
    ),
]
MutantSeed = Annotated[
    int, Option(metavar="N", help="Seed of the mutants; the same seed gives the same mutants.", min=0)
]
Values = Annotated[
    list[str] | None, Option("--set", metavar="NAME=VALUE", help="Value of a parameter; repeat it for several.")
]
CompareBy = Annotated[
    list[str] | None,
    Option(
        "--by",
        metavar="ASPECT|METRIC",
        help="Aspect to cluster by, repeatable; default: ego-trajectory, bearing, interaction and metrics.",
    ),
]
Gamma = Annotated[str, Option(metavar="X|auto", help="Width of the kernel.")]
Eps = Annotated[str, Option(metavar="X|auto", help="Radius of DBSCAN's neighbourhood in kernel space.")]
MinSamples = Annotated[
    str, Option(metavar="N|auto", help="Smallest number of scenarios in a dense neighbourhood of DBSCAN.")
]
LocalWorkers = Annotated[int, Option("--workers", metavar="N", help="Number of processes of --cluster local.", min=1)]
Memory = Annotated[str, Option(metavar="SIZE", help="Memory that the command may use, such as 4GB or 500MB.")]


class _StdoutRedirection:
    """Stdout that is reserved for JSON; all other output, such as prints of user code, goes to stderr."""

    def __init__(self) -> None:
        self._stdout, self._stderr = sys.stdout, sys.stderr
        try:
            self._numbers = self._stdout.fileno(), self._stderr.fileno()
            self._copy: int | None = os.dup(self._numbers[0])
        except (AttributeError, OSError, ValueError):
            # A stream is closed or is no file, as in a notebook.
            self._copy = None

    def redirect(self) -> None:
        """Redirect to stderr what this process and its child processes print to stdout."""
        if self._copy is not None:
            os.dup2(self._numbers[1], self._numbers[0])
        sys.stdout = self._stderr

    def restore(self) -> None:
        """End the redirection for now; `redirect` can start it again."""
        sys.stdout = self._stdout
        if self._copy is not None:
            os.dup2(self._copy, self._numbers[0])

    def close(self) -> None:
        """End the redirection for good, and close the copy of stdout."""
        self.restore()
        if self._copy is not None:
            os.close(self._copy)

    def write(self, text: str) -> None:
        """Write a text to the original stdout."""
        self.restore()
        try:
            self._stdout.write(text)
            # Not later, when it is redirected again.
            self._stdout.flush()
        finally:
            self.redirect()


_json_output: ContextVar[_StdoutRedirection | None] = ContextVar("json output", default=None)


@contextmanager
def _keep_stdout_for_json() -> Iterator[None]:
    output = _StdoutRedirection()
    token = _json_output.set(output)
    output.redirect()
    try:
        yield
    finally:
        output.close()
        _json_output.reset(token)


def _prepare_json(context: typer.Context, value: bool) -> bool:
    if value:
        context.with_resource(_keep_stdout_for_json())
    return value


Json = Annotated[bool, Option("--json", help="Print JSON, for programs.", callback=_prepare_json)]


def _add_map_folders(context: typer.Context, folders: list[Path] | None) -> None:
    """While the command runs, search for maps in the folders of ``--maps`` and of the variable ``CORNERCASE_MAPS``."""
    from cornercase.scenario._maps import MAPS_VARIABLE, use_map_folders

    if folders or os.environ.get(MAPS_VARIABLE):
        context.with_resource(use_map_folders(folders or ()))


Maps = Annotated[
    list[Path] | None,
    Option(
        "--maps",
        metavar="FOLDER",
        help="Folder with road files, for maps that scenarios name without a path, such as CARLA's Town01; repeat it"
        " for several. It is searched before the folders in CORNERCASE_MAPS.",
        callback=_add_map_folders,
        expose_value=False,
    ),
]


@app.callback(invoke_without_command=True)
def _apply_global_options(
    version: Annotated[bool, Option("--version", help="Show the version and exit.")] = False,
    debug: Annotated[
        bool, Option("--debug", envvar="CORNERCASE_DEBUG", help="Also show tracebacks: cornercase --debug explore …")
    ] = False,
    quiet: Annotated[
        bool, Option("--quiet", "-q", help="Show no bars and no notices: cornercase -q explore …")
    ] = False,
    verbose: Annotated[
        bool,
        Option("--verbose", "-v", help="Also show minor notices and bars for short steps: cornercase -v explore …"),
    ] = False,
) -> None:
    show_tracebacks.set(debug)
    verbosity.set("quiet" if quiet else "verbose" if verbose else "usual")
    if quiet:
        warnings.simplefilter("ignore", NoticeWarning)
    if version:
        out.print(f"cornercase {__version__}")
        raise typer.Exit


# Largest number of printed reasons of failures, and of characters of each reason.
_MAX_REASONS: Final = 3
_MAX_REASON_LENGTH: Final = 300


def finish_exploration_command(result: ExplorationResult) -> None:
    """Print how an exploration ended; end the command if it was interrupted, failed, or only checked proposals."""
    if result.reproducible is not None:
        out.print(f"{result.study}: {result.reason}.")
        raise typer.Exit(0 if result.reproducible else 1)
    notes = [*result.constant_metrics, *(f"Note: {sentence}" for sentence in result.new_constant_metrics)]
    count = "1 scenario" if result.n_finished == 1 else f"{result.n_finished} scenarios"
    if result.interrupted:
        out.print(f"Interrupted after {count}. Run the same command again to resume {result.study}.")
    else:
        failed = f", {result.failed} of which failed" if result.failed else ""
        out.print(f"{count} in {result.study}{failed}; ended because {result.reason}.")
        print_failure_reasons(result.failure_counts, "; 'show --all' prints all")
    for sentence in (result.roles, *notes):
        out.print(sentence, markup=False)
    if result.interrupted:
        raise typer.Exit(interrupt_exit_code())
    if result.failed and not result.done:
        raise typer.Exit(1)


def print_json(value: object) -> None:
    """Print a value as JSON, for programs."""
    text = format_json(value) + "\n"
    output = _json_output.get()
    if output is None:
        sys.stdout.write(text)
    else:
        output.write(text)


def print_failure_reasons(reasons: Mapping[str, int], suffix: str = "") -> None:
    """Print each reason of failure with its number of scenarios, the most frequent first."""
    for reason, count in list(reasons.items())[:_MAX_REASONS]:
        out.print(f"  {count} failed: {shorten(reason, _MAX_REASON_LENGTH)}")
    if len(reasons) > _MAX_REASONS:
        out.print(f"  and {sum(list(reasons.values())[_MAX_REASONS:])} more, for other reasons{suffix}.")
