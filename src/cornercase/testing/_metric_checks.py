"""Contract checks of criticality metrics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Final

import cloudpickle
import numpy as np

from cornercase._common.errors import InputError
from cornercase.metrics import Metric
from cornercase.metrics._own_metrics import resolve_metric
from cornercase.recordings import Recording
from cornercase.recordings._compare import are_bitwise_equal
from cornercase.testing._cases import default_cases
from cornercase.testing._contract_check import ContractCheck

# Relative difference that may come from rounding of positions far from the origin.
_ROUNDING: Final = 1e-5
_SHIFT: Final = (350.0, -120.0)
_TURN: Final = 0.7
# m by which the other entity is moved aside to be far away.
_FAR: Final = 2000.0


def metric_checks(
    metric: str | Metric, recordings: Sequence[tuple[Recording, str, str]] | None = None
) -> list[ContractCheck]:
    """Return the contract checks of a criticality metric.

    Parameters
    ----------
    metric : str or Metric
        Metric, or its name with options after a colon, such as ``"ttc:accelerating=true"``.
    recordings : sequence of tuple, optional
        Recordings, each with the name of the ego and the name of the other entity that the metric measures. By default
        recordings of example scenarios.

    Returns
    -------
    list of ContractCheck

    Examples
    --------
    >>> from cornercase.testing import metric_checks, run_checks
    >>> all(not result.problem for result in run_checks(metric_checks("ttc")))
    True
    """
    given = recordings if recordings is not None else _default_recordings()
    checks = {
        "declares name, unit, direction and cap": _check_metric_declaration,
        "has a value or NaN at each instant": _check_metric_courses,
        "scores within its cap and bound": _check_metric_scores,
        "leaves the recording as it is": _check_recording_unchanged,
        "repeats itself": _check_metric_repeatability,
        "is the same elsewhere on the map": _check_map_invariance,
        "is the same in another order of entities": _check_entity_order_invariance,
        "takes an entity that is not there all the time": _check_absent_entity,
        "is not more critical far away than near": _check_criticality_direction,
        "names an entity that does not exist": _check_unknown_entity,
        "can be sent to another process": _check_metric_pickling,
    }
    created = partial(resolve_metric, metric)
    return [
        ContractCheck(name, partial(_run_metric_check, function, created, given)) for name, function in checks.items()
    ]


def _run_metric_check(function: Any, created: Any, recordings: Any) -> None:
    function(created(), recordings)


def _default_recordings() -> list[tuple[Recording, str, str]]:
    x_intersection, deceleration = (cases.run(duration=12.0) for cases in default_cases())
    others = [next(name for name in deceleration[0].names if name != "Ego")]
    return [(r, "Ego", "Pedestrian") for r in x_intersection] + [(r, "Ego", others[0]) for r in deceleration]


def _check_metric_declaration(metric: Metric, _: Any) -> None:
    assert metric.name, "It has no name."
    assert isinstance(metric.unit, str), f"Its unit is {metric.unit!r}, which is no text."
    assert metric.unit, "It has no unit; '1' stands for none."
    assert isinstance(metric.lower_is_critical, bool), "`lower_is_critical` is neither True nor False."
    assert np.isfinite(metric.cap), f"Its `cap` is {metric.cap}; it replaces infinite values, so give a number."
    if metric.bound is not None:
        side = "below" if metric.lower_is_critical else "above"
        assert (metric.bound < metric.cap) == metric.lower_is_critical, f"Its `bound` is not {side} its `cap`."


def _check_metric_courses(metric: Metric, recordings: Any) -> None:
    for recording, ego, other in recordings:
        course = metric.course(recording, ego, other)
        assert np.shape(course) == recording.time.shape, (
            f"Its course has shape {np.shape(course)} instead of {recording.time.shape}."
        )
        assert np.asarray(course).dtype.kind == "f", f"Its course holds {np.asarray(course).dtype}, not floats."


def _check_metric_scores(metric: Metric, recordings: Any) -> None:
    for recording, ego, other in recordings:
        score = metric.score(metric.course(recording, ego, other))
        assert np.isfinite(score), f"A score is {score}."
        is_within = score <= metric.cap if metric.lower_is_critical else score >= metric.cap
        assert is_within, f"A score of {score:g} is less critical than the cap of {metric.cap:g}."
        if metric.bound is not None:
            is_within = score >= metric.bound if metric.lower_is_critical else score <= metric.bound
            assert is_within, f"A score of {score:g} is more critical than the bound of {metric.bound:g}."


def _check_recording_unchanged(metric: Metric, recordings: Any) -> None:
    for recording, ego, other in recordings:
        copied = cloudpickle.loads(cloudpickle.dumps(recording))
        metric.course(recording, ego, other)
        assert are_bitwise_equal(copied, recording), "It changes the recording that it measures."


def _check_metric_repeatability(metric: Metric, recordings: Any) -> None:
    for recording, ego, other in recordings:
        first, second = (metric.course(recording, ego, other) for _ in range(2))
        assert np.array_equal(first, second, equal_nan=True), (
            "It gives another course if it measures the same recording again."
        )


def _check_map_invariance(metric: Metric, recordings: Any) -> None:
    cos, sin = np.cos(_TURN), np.sin(_TURN)
    for recording, ego, other in recordings:
        x, y = recording.x, recording.y
        moved = replace(
            recording,
            x=cos * x - sin * y + _SHIFT[0],
            y=sin * x + cos * y + _SHIFT[1],
            heading=recording.heading + _TURN,
        )
        score, moved_score = (metric.score(metric.course(r, ego, other)) for r in (recording, moved))
        assert np.isclose(score, moved_score, rtol=_ROUNDING, atol=_ROUNDING), (
            f"On a map that is turned and shifted it scores {moved_score:g} instead of {score:g}."
        )


def _check_entity_order_invariance(metric: Metric, recordings: Any) -> None:
    for recording, ego, other in recordings:
        order = np.arange(len(recording.names))[::-1]
        arrays = {
            name: getattr(recording, name)[order]
            for name in ("x", "y", "heading", "speed", "acceleration", "length", "width", "center_x")
        }
        names, types = ([column[k] for k in order.tolist()] for column in (recording.names, recording.object_types))
        turned = replace(recording, names=tuple(names), object_types=tuple(types), **arrays)
        score, turned_score = (metric.score(metric.course(r, ego, other)) for r in (recording, turned))
        # Sums in another order may differ in their last digits.
        assert np.isclose(score, turned_score, rtol=1e-12, atol=1e-12), (
            "If the entities of a recording are in another order, its score differs."
        )


def _check_absent_entity(metric: Metric, recordings: Any) -> None:
    recording, ego, other = recordings[0]
    k, half = recording.entity_index(other), len(recording.time) // 2
    arrays = {name: getattr(recording, name).copy() for name in ("x", "y", "heading", "speed", "acceleration")}
    for array in arrays.values():
        array[k, :half] = np.nan
    course = metric.course(replace(recording, collisions=(), **arrays), ego, other)
    assert np.isfinite(metric.score(course)), "It gives no score if the other entity is not there from the start."


def _check_criticality_direction(metric: Metric, recordings: Any) -> None:
    for recording, ego, other in recordings:
        k = recording.entity_index(other)
        x, y, heading = recording.x.copy(), recording.y.copy(), recording.heading[recording.entity_index(ego), 0]
        x[k], y[k] = x[k] - _FAR * np.cos(heading), y[k] - _FAR * np.sin(heading)
        far = replace(recording, x=x, y=y, collisions=())
        scores = [metric.score(metric.course(r, ego, other)) for r in (recording, far)]
        is_fine = scores[0] <= scores[1] if metric.lower_is_critical else scores[0] >= scores[1]
        assert is_fine, (
            f"It scores {scores[0]:g}, but {scores[1]:g} if the other is {_FAR:g} m further back; does"
            " `lower_is_critical` fit?"
        )


def _check_unknown_entity(metric: Metric, recordings: Any) -> None:
    recording, ego, other = recordings[0]
    expected, message = metric.course(recording, ego, other), ""
    try:
        # A metric of the ego alone does not need the other entity.
        is_fine = np.array_equal(metric.course(recording, ego, "nobody at all"), expected, equal_nan=True)
    except InputError as error:
        message, is_fine = f": {error}", "nobody at all" in str(error)
    assert is_fine, f"It does not say that an entity does not exist, as Recording.entity_index does{message}"


def _check_metric_pickling(metric: Metric, recordings: Any) -> None:
    recording, ego, other = recordings[0]
    sent = cloudpickle.loads(cloudpickle.dumps(metric))
    first, second = (m.score(m.course(recording, ego, other)) for m in (metric, sent))
    assert first == second, "A copy of it that was pickled, as for another process, gives another score."
