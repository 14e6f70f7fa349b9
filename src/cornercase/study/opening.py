"""A study, or the path of one, as what functions take for a study."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cornercase._common.arguments import path
from cornercase._common.errors import InputError
from cornercase.study.store import Study


@contextmanager
def open_study(study: Study | Path | str, readonly: bool = False) -> Iterator[Study]:
    """Give a study that is open already, or open the one at a path for as long as the block lasts.

    Parameters
    ----------
    study : Study or path
    readonly : bool, default False
        Whether reading is enough.

    Yields
    ------
    Study

    Raises
    ------
    InputError
        As `Study.open`; or a study that is to be written is open for reading only.
    """
    if isinstance(study, Study):
        if study.readonly and not readonly:
            raise InputError(f"{study.path}: is open for reading only; open it with readonly=False, or give its path.")
        yield study
        return
    with Study.open(path("study", study), readonly) as opened:
        yield opened
