"""A study, or the path of one, as what functions take for a study."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cornercase.study.store import Study


@contextmanager
def open_study(study: Study | Path | str, readonly: bool = False) -> Iterator[Study]:
    """Give a study that is open already, or open the one at a path for as long as the block lasts.

    Parameters
    ----------
    study : Study or path
    readonly : bool, default False
        How to open a path.

    Yields
    ------
    Study

    Raises
    ------
    InputError
        As `Study.open`.
    """
    if isinstance(study, Study):
        yield study
        return
    with Study.open(study, readonly) as opened:
        yield opened
