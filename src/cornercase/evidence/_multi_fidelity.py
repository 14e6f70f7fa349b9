"""Predictions from another study of the same parameters (multi-fidelity)."""

from __future__ import annotations

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.evidence.gp._gaussian_process import fit_boundary_process
from cornercase.study._criterion import Criterion


class SourceStudyModel:
    """Model of the scores of another study, for example with another driver, another simulator or a coarser time step.

    A boundary process of the other study's scores (`fit_boundary_process`) predicts how far each scenario is from the
    threshold; 0 is the threshold. A process of the new scores uses this prediction as an additional coordinate
    (`fit_boundary_process` with ``has_prediction``). If the other study predicts the new scores, the new process varies
    along this coordinate and little along the other coordinates. Then few scenarios suffice to learn the relation. If
    the other study does not predict the new scores, the coordinate is dropped.

    `points` (n, e) are scenarios of the other study, encoded in the new space. `scores` (n,) are finite, not all the
    same, and lower is more critical.

    Source: P. Perdikaris, M. Raissi et al., "Nonlinear information fusion algorithms for data-efficient multi-fidelity
    modelling", Proceedings of the Royal Society A 473 (2017), equation 2.14, with the mean of the previous process. A
    learned function replaces the constant factor of M. C. Kennedy, A. O'Hagan, "Predicting the output from a complex
    computer code when fast approximations are available", Biometrika 87 (2000).
    """

    def __init__(self, points: FloatArray, scores: FloatArray, criterion: Criterion) -> None:
        self.process, self._criterion = fit_boundary_process(points, scores, criterion), criterion

    def append_prediction(self, points: FloatArray) -> FloatArray:
        """Append the other study's prediction to encoded points (m, e) as another coordinate, (m, e + 1)."""
        return np.column_stack([points, self.process.predict(points)[0]])

    def improves_prediction(self, points: FloatArray, scores: FloatArray) -> bool:
        """Return whether the other study improves the prediction of new scores (n,) at encoded points (n, e).

        The criterion is that of `fit_boundary_process`.
        """
        process = fit_boundary_process(self.append_prediction(points), scores, self._criterion, has_prediction=True)
        return bool(np.isfinite(process.kernel.length_scales[-1]))


def append_source_prediction(source_model: SourceStudyModel | None, points: FloatArray) -> FloatArray:
    """Append another study's prediction to encoded points (m, e); without `source_model`, return them unchanged."""
    return points if source_model is None else source_model.append_prediction(points)
