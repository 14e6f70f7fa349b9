"""Aspects: what of two scenarios is compared, by name."""

from __future__ import annotations

from typing import Final

from cornercase._common.errors import InputError, suggestion
from cornercase._common.typing import FloatArray
from cornercase.metrics import METRICS
from cornercase.study import Study

EGO_TRAJECTORY: Final = "ego-trajectory"
"""The way that the ego takes, and when."""


def aspects_of(study: Study) -> tuple[str, ...]:
    """Names of all aspects that the scenarios of a study can be compared by.

    Parameters
    ----------
    study : Study
        Its metrics can be aspects.

    Returns
    -------
    tuple of str
        ``"ego-trajectory"``, then the course of each metric by the metric's name.
    """
    return (EGO_TRAJECTORY, *study.meta.metrics)


def require_aspect(study: Study, aspect: str) -> None:
    """Refuse an aspect that the scenarios of a study cannot be compared by.

    Parameters
    ----------
    study : Study
        Its metrics can be aspects.
    aspect : str
        Name of the aspect.

    Raises
    ------
    InputError
        It is neither the ego's trajectory nor a metric of the study.
    """
    known = aspects_of(study)
    if aspect not in known:
        raise InputError(f"`by` {aspect}: {study.path} holds nothing to compare by it; {suggestion(aspect, known)}")


def series_of(study: Study, aspect: str) -> list[FloatArray]:
    """Time series that the scenarios are compared by, one for each that was run.

    Parameters
    ----------
    study : Study
        Its metrics can be aspects.
    aspect : str
        ``"ego-trajectory"`` gives the centre of the ego's box in m, a metric its capped course in its unit.

    Returns
    -------
    list of ndarray of float64, shape (T_i, 2) or (T_i,)
        In the order of the scenarios.

    Raises
    ------
    InputError
        The study holds no such metric.
    """
    require_aspect(study, aspect)
    rows = study.done()
    if aspect == EGO_TRAJECTORY:
        return [study.recording(row.id).center(study.meta.ego) for row in rows]
    metric = METRICS.create(aspect)
    return [metric.capped(study.course(row.id, aspect)) for row in rows]


def unit_of(aspect: str) -> str:
    """Unit of a distance between two scenarios by an aspect.

    Parameters
    ----------
    aspect : str
        Name of the aspect.

    Returns
    -------
    str
        The distance is a sum along the best path, so it has the unit of the series; ``"1"`` for none.
    """
    return "m" if aspect == EGO_TRAJECTORY else METRICS.create(aspect).unit
