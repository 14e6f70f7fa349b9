"""A study, or the path of one, as what functions take for a study, and studies that are begun."""

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
    """Give a study that is open already, or open the one at a path for as long as the block lasts.

    Parameters
    ----------
    study : Study or path
    readonly : bool, default False
        Whether reading is enough.
    critical : float, optional
        Score from which a scenario is critical as long as the block lasts, in place of the one that the study holds,
        which stays as it is.

    Yields
    ------
    Study

    Raises
    ------
    InputError
        As `Study.open`; a study that is to be written is open for reading only; or what is critical cannot be asked of
        it by a score.
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
    """Let a study answer with another threshold."""
    if threshold is None:
        yield
        return
    meta = study.meta
    if condition := condition_of(meta.metrics):
        raise InputError(f"{study.path}: the condition '{condition}' says what is critical; leave `critical` out.")
    if meta.pareto:
        raise InputError(f"{study.path}: no one score of a Pareto front says what is critical; leave `critical` out.")
    if study.estimate() is not None:
        raise InputError(
            f"{study.path}: holds a probability for the threshold it was made with; give `critical` to `estimate`."
        )
    before = study.ask(threshold)
    try:
        yield
    finally:
        study.ask(before)


@contextmanager
def begun_study(path: Path, meta: StudyMeta) -> Iterator[Study]:
    """Open a study for writing for as long as the block lasts; where there is none, make it.

    One that was made is removed again where the block ends by `InputError` and no scenario of it was run.

    Parameters
    ----------
    path : Path
    meta : StudyMeta
        What one that is made is about.

    Yields
    ------
    Study

    Raises
    ------
    InputError
        As `Study.open` and `Study.create`.
    """
    if path.exists():
        with Study.open(path, readonly=False) as study:
            yield study
        return
    with Study.create(path, meta) as study:
        try:
            yield study
        except InputError:
            # Whatever keeps it from being removed is not what the command failed of.
            with suppress(InputError, OSError):
                if not study.done() and not study.notes():
                    study.close()
                    path.unlink()
                    remove_log(path)
            raise
