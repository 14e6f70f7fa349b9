"""What the scenarios of a study are compared by."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from cornercase._common.errors import InputError, suggestion
from cornercase._common.interrupts import requests_heard
from cornercase._common.parts import raise_if_request
from cornercase._common.texts import in_one_line
from cornercase._common.typing import FloatArray
from cornercase.clustering.aspects import ASPECTS, EGO_TRAJECTORY, Aspect
from cornercase.metrics import METRICS
from cornercase.recordings import MOTION, Recording
from cornercase.study import Study

BY_DEFAULT: Final = (EGO_TRAJECTORY, "bearing", "interaction")
"""Aspects that a study is analysed by beside its metrics."""


def default_aspects(study: Study) -> tuple[str, ...]:
    """Names of the aspects that a study is analysed by unless others are asked for.

    Parameters
    ----------
    study : Study
        Its metrics are among them.

    Returns
    -------
    tuple of str
        `BY_DEFAULT`, then the metrics.
    """
    return (*BY_DEFAULT, *study.meta.metrics)


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
        It is none of `ASPECTS` and no metric of the study.
    """
    if aspect in study.meta.metrics:
        return
    if aspect.partition(":")[0] not in ASPECTS:
        known = sorted({*ASPECTS.names(), *study.meta.metrics})
        raise InputError(f"`by` {aspect}: {study.path} holds nothing to compare by it; {suggestion(aspect, known)}")
    make_aspect(aspect)


def make_aspect(name: str) -> Aspect:
    """Make an aspect, which may be one of another package.

    Parameters
    ----------
    name : str
        One of `ASPECTS`.

    Returns
    -------
    Aspect
        It has a name and a unit.

    Raises
    ------
    InputError
        There is none, or it cannot be made.
    """
    try:
        made = ASPECTS.create(name)
        unit, _ = made.unit, made.name
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"The aspect '{name}' cannot be made: {in_one_line(error)}.") from error
    if not isinstance(unit, str):
        raise InputError(f"The aspect '{name}' has {unit!r} as its unit; it has to be a text.")
    return made


def series_of(study: Study, aspect: str) -> list[FloatArray]:
    """Time series that the scenarios are compared by, one for each that was run.

    Parameters
    ----------
    study : Study
        Its metrics can be aspects.
    aspect : str
        One of `ASPECTS`, or a metric, which gives its capped course in its unit.

    Returns
    -------
    list of ndarray of float64, shape (T_i, k) or (T_i,)
        In the order of the scenarios.

    Raises
    ------
    InputError
        The study cannot be compared by it.
    """
    require_aspect(study, aspect)
    rows = study.done()
    if aspect in study.meta.metrics:
        metric = METRICS.create(aspect)
        return [metric.capped(study.course(row.id, aspect)) for row in rows]
    chosen = make_aspect(aspect)
    other = study.main_other()
    series = [series_in(study, row.id, study.recording(row.id), chosen, other) for row in rows]
    require_same_channels(study, aspect, [row.id for row in rows], series)
    return series


def series_in(study: Study, scenario: int, recording: Recording, aspect: Aspect, other: str) -> FloatArray:
    """Time series that one scenario is compared by.

    Parameters
    ----------
    study : Study
        Says who is the ego.
    scenario : int
        Id.
    recording : Recording
        Of the scenario.
    aspect : Aspect
        What is compared.
    other : str
        Whom the aspect looks at beside the ego; the same in all scenarios that are compared.

    Returns
    -------
    ndarray of float64, shape (T, k)

    Raises
    ------
    InputError
        The aspect fails, or gives something else.
    """
    # Other aspects get the same recording: one that writes into it would change what these compare.
    for name in MOTION:
        getattr(recording, name).flags.writeable = False
    heard = requests_heard()
    try:
        given = aspect.series(recording.with_absent([other]), study.meta.ego, other)
    except BaseException as error:
        raise_if_request(error, heard)
        raise InputError(
            f"The aspect '{aspect.name}' fails for scenario {scenario} of {study.path}: {in_one_line(error)}."
        ) from error
    try:
        series = np.asarray(given).astype(np.float64, casting="same_kind")
    except (TypeError, ValueError):
        raise InputError(
            f"The aspect '{aspect.name}' gives no numbers for scenario {scenario} of {study.path}; it has to give one"
            f" finite row for each of {len(recording.time)} instants."
        ) from None
    if series.ndim != 2 or len(series) != len(recording.time) or not series.size or not np.isfinite(series).all():
        raise InputError(
            f"The aspect '{aspect.name}' gives shape {series.shape} for scenario {scenario} of {study.path}, or what is"
            f" not finite; it has to give one finite row for each of {len(recording.time)} instants."
        )
    return series


def require_same_channels(study: Study, aspect: str, ids: Sequence[int], series: Sequence[FloatArray]) -> None:
    """Refuse series that cannot be compared with each other.

    Parameters
    ----------
    study : Study
        Holds the scenarios.
    aspect : str
        What gave the series.
    ids : sequence of int, length n
        Scenarios.
    series : sequence of ndarray of float64, length n
        Of each, shape (T_i, k).

    Raises
    ------
    InputError
        One has another number of channels than the first.
    """
    for scenario, one in zip(ids, series, strict=True):
        if one.shape[1:] != series[0].shape[1:]:
            raise InputError(
                f"The aspect '{aspect}' gives {one.shape[1]} numbers for each instant of scenario {scenario} of"
                f" {study.path}, and {series[0].shape[1]} for scenario {ids[0]}; it has to give as many for each."
            )


def unit_of(study: Study, aspect: str) -> str:
    """Unit of a distance between two scenarios by an aspect.

    Parameters
    ----------
    study : Study
        Its metrics can be aspects.
    aspect : str
        Name of the aspect.

    Returns
    -------
    str
        The distance is a sum along the best path, so it has the unit of the series; ``"1"`` for none.

    Raises
    ------
    InputError
        The study cannot be compared by it.
    """
    require_aspect(study, aspect)
    return METRICS.create(aspect).unit if aspect in study.meta.metrics else make_aspect(aspect).unit


def instants_within(times: Sequence[FloatArray], window: float | None) -> int | None:
    """Turn a window in seconds into that of `cornercase.dtw.distance_matrix`.

    Parameters
    ----------
    times : sequence of ndarray of float64, shape (T_i,)
        Of each recording.
    window : float or None
        s; how far apart two instants may be that are matched, beyond the difference of the recordings' lengths. None
        for any.

    Returns
    -------
    int or None

    Raises
    ------
    InputError
        The window is negative or not finite, or the recordings have different time steps.
    """
    if window is None:
        return None
    if isinstance(window, bool) or not isinstance(window, int | float | np.number) or not 0.0 <= window < math.inf:
        raise InputError(f"`window` {window!r}: give a time in s of at least 0.")
    steps = [float(np.median(np.diff(time))) for time in times if len(time) > 1]
    if not steps:
        return 1
    if max(steps) > 1.01 * min(steps):
        raise InputError(
            f"`window`: the recordings have time steps from {min(steps):.4g} s to {max(steps):.4g} s; leave it out."
        )
    # No recording has as many instants.
    return math.floor(min(float(window) / steps[0], 1e9) + 1e-6) + 1
