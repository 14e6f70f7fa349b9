"""Model of the score as JSON values, with which the report page predicts scores without a server."""

from __future__ import annotations

import base64
import math
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from cornercase.evidence._score_surrogate import ScoreSurrogate
from cornercase.report._report_data import ReportData
from cornercase.report.text._phrases import format_percent
from cornercase.scenario import Parameter, ParameterSpace
from cornercase.study._objective import Objective

# A page evaluates thousands of points at once, at a cost that grows with the square of this number.
_MAX_POINTS: Final = 192
# Positions at which the distribution of a parameter is given; the page interpolates between them.
_DISTRIBUTION_SAMPLES: Final = 129


def predictor_payload(data: ReportData) -> dict[str, Any]:
    """Return the model that predicts scores on the report page, as JSON values.

    The key ``predictor`` holds the model or None. The model is left out if it predicts hardly anything; then
    ``predictor_missing`` says so. There is also no model for a Pareto front, a suite, an estimate of a probability, or
    too few scenarios; then ``predictor_missing`` is empty.
    """
    surrogate = data.summary.estimates.surrogate
    if surrogate is None or not data.summary.represents_space:
        return {"predictor": None, "predictor_missing": ""}
    condensed = surrogate.condense(_MAX_POINTS)
    objective = Objective.from_study_meta(data.summary.meta)
    if not condensed.is_meaningful:
        share = format_percent(max(condensed.predicted, 0.0))
        missing = (
            f"The parameters predict hardly anything of {objective.label}: {share} of its variance, with each scenario"
            " left out in turn. So nothing is drawn between the scenarios."
        )
        return {"predictor": None, "predictor_missing": missing}
    return {"predictor": _encode_predictor(condensed, objective), "predictor_missing": ""}


def _encode_predictor(surrogate: ScoreSurrogate, objective: Objective) -> dict[str, Any]:
    form = surrogate.process.closed_form()
    sign = 1.0 if objective.lower_is_critical else -1.0
    count = len(form.points)
    return {
        "metric": objective.label,
        "unit": objective.unit,
        "predicted": float(f"{surrogate.predicted:.5g}"),
        "scale": sign * surrogate.deviation,
        "offset": sign * surrogate.mean + sign * surrogate.deviation * form.mean,
        "signal": form.kernel.signal,
        "noise": form.kernel.noise,
        "length_scales": form.kernel.length_scales.tolist(),
        "positions": [_values_with_unit_positions(parameter) for parameter in surrogate.space.parameters],
        "constrained": _constrained_parameters(surrogate.space),
        "count": count,
        "points": _to_base64(form.points, "<f8"),
        "weights": _to_base64(form.weights, "<f8"),
        "single": form.inverse_factor.dtype == np.float32,
        "factor": _to_base64(
            form.inverse_factor[np.tril_indices(count)], "<f4" if form.inverse_factor.dtype == np.float32 else "<f8"
        ),
    }


def _values_with_unit_positions(parameter: Parameter) -> list[list[float]] | None:
    """Return values of a parameter and their positions in the unit interval; None for a parameter with choices."""
    if parameter.choices:
        return None
    positions = np.linspace(0.0, 1.0, 2 if parameter.distribution is None else _DISTRIBUTION_SAMPLES)
    values = sorted({float(parameter.value_at(position)) for position in positions.tolist()})
    values = [value for value in values if math.isfinite(value)]
    return [values, [parameter.unit_position(value) for value in values]]


def _constrained_parameters(space: ParameterSpace) -> list[int]:
    """Return the indices of the parameters whose values are limited by constraints in the scenario file."""
    names = {declaration.name for declaration in space.declarations if declaration.constraint_groups}
    return [k for k, parameter in enumerate(space.parameters) if not names.isdisjoint(parameter.assigned_names)]


def _to_base64(values: npt.NDArray[np.floating[Any]], kind: str) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype=kind).tobytes()).decode()
