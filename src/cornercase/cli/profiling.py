"""Option ``--profile``, which writes to a file how much time each function took."""

from __future__ import annotations

import cProfile
import io
import pstats
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Final

import typer

from cornercase._common.errors import InputError
from cornercase._common.io.files import atomic_write

_FIRST_LINE: Final = "Where cornercase spent its time"
_MAX_FUNCTIONS: Final = 80


def _start_profiling(context: typer.Context, file: Path | None) -> Path | None:
    """Start profiling; the file is written when the command ends, even by an error."""
    if file is not None:
        if file.is_dir() or (file.exists() and not file.read_bytes().startswith(_FIRST_LINE.encode())):
            raise InputError(f"`profile`: {file} exists already and is not a profile; choose another file.")
        context.with_resource(_profile_to(file))
    return file


@contextmanager
def _profile_to(file: Path) -> Iterator[None]:
    profiler = cProfile.Profile()
    profiler.enable()
    try:
        yield
    finally:
        profiler.disable()
        text = io.StringIO()
        text.write(f"{_FIRST_LINE}; s in the main thread, compiled code counts for its caller.\n\n")
        stats = pstats.Stats(profiler, stream=text)
        for order, title in (("tottime", "In functions themselves"), ("cumtime", "With all that they call")):
            text.write(f"{title}\n")
            stats.sort_stats(order).print_stats(_MAX_FUNCTIONS)
        with atomic_write(file) as temporary:
            temporary.write_text(text.getvalue(), encoding="utf-8", newline="\n")


Profile = Annotated[
    Path | None,
    typer.Option(
        "--profile", metavar="FILE.txt", help="Write how much time each function takes.", callback=_start_profiling
    ),
]
