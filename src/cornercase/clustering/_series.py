"""Time series by which the scenarios of a study are compared, for each aspect or metric."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from cornercase._common.errors import InputError, suggest_name
from cornercase._common.plugin_errors import reraise_termination_request
from cornercase._common.process.signals import count_termination_requests
from cornercase._common.text.sanitize import format_exception
from cornercase._common.typing import FloatArray
from cornercase.clustering._aspects import ASPECTS, EGO_TRAJECTORY, Aspect, Bearing, EgoTrajectory, JointPositions
from cornercase.metrics import METRICS
from cornercase.recordings import Recording
from cornercase.recordings._recording import read_only
from cornercase.study import StudyFile
from cornercase.study._scenario_digest import ScenarioDigest

DEFAULT_ASPECTS: Final = (EGO_TRAJECTORY, "bearing", "interaction")
"""Aspects that `analyze` uses by default, in addition to the metrics of the study."""


def default_aspects(study: StudyFile) -> tuple[str, ...]:
    """Return the aspects that `analyze` uses by default: `DEFAULT_ASPECTS`, then the metrics of the study."""
    return (*DEFAULT_ASPECTS, *study.meta.metrics)


def require_known_aspect(study: StudyFile, aspect: str) -> None:
    """Raise `InputError` unless `aspect` is in `ASPECTS` or a metric of the study."""
    if aspect in study.meta.metrics:
        return
    if aspect.partition(":")[0] not in ASPECTS:
        if aspect.partition(":")[0] in METRICS:
            has = ", ".join(study.meta.metrics)
            raise InputError(f"`by` {aspect}: {study.path} was explored without this metric; the study has {has}.")
        names = sorted({*ASPECTS.names(), *study.meta.metrics})
        raise InputError(f"`by` {aspect}: {study.path} has no such aspect or metric; {suggest_name(aspect, names)}")
    create_aspect(aspect)


def create_aspect(name: str) -> Aspect:
    """Create a registered aspect, and check that it has a name, and a unit that is a string.

    The class of the aspect may come from another package, so the name or the unit may be missing or invalid.
    """
    try:
        aspect = ASPECTS.create(name)
        unit, _ = aspect.unit, aspect.name
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"The aspect '{name}' cannot be created: {format_exception(error)}.") from error
    if not isinstance(unit, str):
        raise InputError(f"The aspect '{name}' has {unit!r} as its unit; it has to be a string.")
    return aspect


def read_series(
    study: StudyFile, aspect: str, ids: Sequence[int] | None = None, other_entity: str | None = None
) -> list[FloatArray]:
    """Return the time series of each scenario in `ids`, or of each finished scenario, for an aspect.

    An aspect is what scenarios are compared by. The series have shape (T_i, k), or (T_i,) if the aspect is a metric.
    `other_entity` is the entity that the aspect looks at in addition to the ego; by default the main other entity of
    the study.
    """
    require_known_aspect(study, aspect)
    ids = [row.id for row in study.finished_rows()] if ids is None else ids
    if aspect in study.meta.metrics:
        metric = study.meta.create_metric(aspect)
        return [metric.clip_course(study.course(scenario, aspect)) for scenario in ids]
    aspect_object, other_entity = create_aspect(aspect), study.primary_other() if other_entity is None else other_entity
    series = [
        compute_aspect_series(study, scenario, study.recording(scenario), aspect_object, other_entity)
        for scenario in ids
    ]
    require_same_channels(study, aspect, ids, series)
    return series


def series_from_digest(digest: ScenarioDigest, aspect: Aspect, other_index: int) -> FloatArray | None:
    """Return the series of one scenario for an aspect from its digest (downsampled recording), shape (M, k).

    The result is None if the series of this aspect cannot be read from a digest. `other_index` is the index, among the
    other entities of the study, of the entity that the aspect looks at in addition to the ego.
    """
    position, bearing = digest.position_and_bearing(other_index)
    # Another package may have replaced an aspect.
    if type(aspect) is EgoTrajectory:
        return digest.ego_position
    if type(aspect) is Bearing:
        return bearing
    return np.hstack((digest.ego_position, position)) if type(aspect) is JointPositions else None


def compute_aspect_series(
    study: StudyFile, scenario: int, recording: Recording, aspect: Aspect, other_entity: str
) -> FloatArray:
    """Compute and check the time series of one scenario for an aspect, shape (T, k).

    `other_entity` is the entity that the aspect looks at in addition to the ego, the same in all compared scenarios.
    """
    # All aspects get the same recording.
    recording = read_only(recording)
    requests = count_termination_requests()
    try:
        values = aspect.series(recording.with_absent_entities([other_entity]), study.meta.ego, other_entity)
    except BaseException as error:
        reraise_termination_request(error, requests)
        raise InputError(
            f"The aspect '{aspect.name}' fails for scenario {scenario} of {study.path}: {format_exception(error)}."
        ) from error
    try:
        series = np.asarray(values).astype(np.float64, casting="same_kind")
    except (TypeError, ValueError):
        raise InputError(
            f"The aspect '{aspect.name}' returns no numbers for scenario {scenario} of {study.path}; an aspect has"
            f" to return one row of finite numbers for each of {len(recording.time)} instants."
        ) from None
    if series.ndim != 2 or len(series) != len(recording.time) or not series.size or not np.isfinite(series).all():
        raise InputError(
            f"The aspect '{aspect.name}' returns shape {series.shape} for scenario {scenario} of {study.path}, possibly"
            f" with NaN or infinite values; an aspect has to return one row of finite numbers for each of"
            f" {len(recording.time)} instants."
        )
    return series


def require_same_channels(study: StudyFile, aspect: str, ids: Sequence[int], series: Sequence[FloatArray]) -> None:
    """Raise `InputError` if the series differ in their number of channels."""
    for scenario, values in zip(ids, series, strict=True):
        if values.shape[1:] != series[0].shape[1:]:
            raise InputError(
                f"The aspect '{aspect}' returns {values.shape[1]} channels for scenario {scenario} of {study.path}, and"
                f" {series[0].shape[1]} for scenario {ids[0]}; it has to return the same number for all."
            )


def distance_unit(study: StudyFile, aspect: str) -> str:
    """Return the unit of the series and DTW distances of an aspect; "1" if they have no unit."""
    require_known_aspect(study, aspect)
    return study.meta.create_metric(aspect).unit if aspect in study.meta.metrics else create_aspect(aspect).unit


def window_in_instants(times: Sequence[FloatArray], window_seconds: float | None) -> int | None:
    """Convert a DTW window from s to a number of instants, for `cornercase.dtw.distance_matrix`; None for no window.

    The window is the largest difference in time of two instants that Dynamic Time Warping (DTW) may match.
    """
    if window_seconds is None:
        return None
    if (
        isinstance(window_seconds, bool)
        or not isinstance(window_seconds, int | float | np.number)
        or not 0.0 <= window_seconds < math.inf
    ):
        raise InputError(f"`window` {window_seconds!r}: give a time in s of at least 0.")
    steps = [float(np.median(np.diff(time))) for time in times if len(time) > 1]
    if not steps:
        return 1
    if max(steps) > 1.01 * min(steps):
        raise InputError(
            f"`window`: needs recordings with equal time steps, but the steps range from {min(steps):.4g} s to"
            f" {max(steps):.4g} s; leave `window` out."
        )
    # The cap avoids an overflow; no recording has that many instants.
    return math.floor(min(float(window_seconds) / steps[0], 1e9) + 1e-6) + 1
