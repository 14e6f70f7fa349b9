"""Predictions from another study of the same parameters (multi-fidelity)."""

from __future__ import annotations

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.evidence.gp._process import fit_boundary_process


class SourceStudyModel:
    """Predicts scores from another study: of another driver, another simulator or a coarser time step.

    A boundary process of the other study's scores (`fit_boundary_process`) predicts how far each scenario is from the
    threshold, with 0 at the threshold. A process of the scores at hand uses this as one more coordinate
    (`fit_boundary_process` with ``has_prediction``). If the other study predicts the scores, the new process varies
    along this coordinate and little along the others, so few scenarios suffice to learn the relation; if it does not,
    the coordinate is dropped.

    `points` (n, e) are scenarios of the other study, encoded in the space at hand; `scores` (n,) are minimized and
    finite, not all the same.

    Source: P. Perdikaris, M. Raissi et al., "Nonlinear information fusion algorithms for data-efficient multi-fidelity
    modelling", Proceedings of the Royal Society A 473 (2017), equation 2.14 with the mean of the process before; it
    replaces the factor of M. C. Kennedy, A. O'Hagan, "Predicting the output from a complex computer code when fast
    approximations are available", Biometrika 87 (2000), by a function that is learned.
    """

    def __init__(self, points: FloatArray, scores: FloatArray, threshold: float) -> None:
        self.process, self._threshold = fit_boundary_process(points, scores, threshold), threshold

    def augment(self, points: FloatArray) -> FloatArray:
        """Append the other study's prediction to encoded points, (m, e + 1)."""
        return np.column_stack([points, self.process.predict(points)[0]])

    def improves_prediction(self, points: FloatArray, scores: FloatArray) -> bool:
        """Whether the other study improves the prediction of the scores, as `fit_boundary_process` decides."""
        process = fit_boundary_process(self.augment(points), scores, self._threshold, has_prediction=True)
        return bool(np.isfinite(process.kernel.length_scales[-1]))


def augment_points(source_model: SourceStudyModel | None, points: FloatArray) -> FloatArray:
    """Append another study's prediction to encoded points, if there is such a study."""
    return points if source_model is None else source_model.augment(points)
