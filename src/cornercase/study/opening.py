"""Open a study for as long as a block lasts."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from cornercase._common.arguments import number, path
from cornercase._common.errors import InputError
from cornercase.metrics import condition_of
from cornercase.study.connecting import remove_log
from cornercase.study.meta import StudyMeta
from cornercase.study.store import Study


@contextmanager
def open_study(study: Study | Path | str, readonly: bool = False, critical: float | None = None) -> Iterator[Study]:
    """Give an open study, or open the one at a path for as long as the block lasts.

    `critical` replaces the threshold of the study within the block; the file stays as it is. Raises `InputError` if an
    open study cannot be written but should be, or if the study has no single score that a threshold could apply to.
    """
    threshold = None if critical is None else number("critical", critical)
    if isinstance(study, Study):
        if study.readonly and not readonly:
            raise InputError(f"{study.path}: is open for reading only; open it with readonly=False, or give its path.")
        with _asked(study, threshold):
            yield study
        return
    with Study.open(path("study", study), readonly) as opened, _asked(opened, threshold):
        yield opened


@contextmanager
def _asked(study: Study, threshold: float | None) -> Iterator[None]:
    """Replace the threshold of a study within the block."""
    if threshold is None:
        yield
        return
    meta = study.meta
    if condition := condition_of(meta.metrics):
        raise InputError(f"{study.path}: the condition '{condition}' replaces a threshold; leave out `critical`.")
    if meta.pareto:
        raise InputError(f"{study.path}: a Pareto front has no threshold; leave out `critical`.")
    if study.estimate() is not None:
        raise InputError(
            f"{study.path}: its probabilities are for the threshold of the estimate; give `critical` to `estimate`."
        )
    previous = study.ask(threshold)
    try:
        yield
    finally:
        study.ask(previous)


@contextmanager
def begun_study(path: Path, meta: StudyMeta) -> Iterator[Study]:
    """Open a study for writing for as long as the block lasts; create it if there is none.

    A study that was created is removed again if the block raises `InputError` and no scenario has run.
    """
    if path.exists():
        with Study.open(path, readonly=False) as study:
            yield study
        return
    with Study.create(path, meta) as study:
        try:
            yield study
        except InputError:
            # The error of the block matters more than that of removing the file.
            with suppress(InputError, OSError):
                if not study.done() and not study.notes():
                    study.close()
                    path.unlink()
                    remove_log(path)
            raise
