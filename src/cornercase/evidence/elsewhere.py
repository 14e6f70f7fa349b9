"""What another study of the same parameters says about scenarios that were not run."""

from __future__ import annotations

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.evidence.gaussian_process import boundary_process


class Elsewhere:
    """Foretells scores by those of another study: of another driver, another simulator or a coarser time step.

    A `boundary_process` of the other study's scores says at each place how far its scenario is from the threshold, with
    0 at the threshold. A process of the scores at hand takes that for one more coordinate, `boundary_process` with
    ``foretold``. Where the other study predicts them, the new process varies along this coordinate and little along
    the others, so that few scenarios are enough to learn how the one follows from the other; where it does not, the
    coordinate is left out.

    Parameters
    ----------
    points : ndarray of float64, shape (n, e)
        Scenarios of the other study, as `encoded` in the space at hand.
    scores : ndarray of float64, shape (n,)
        Oriented and finite; not all the same.
    threshold : float
        Oriented score up to which a scenario is critical.

    Attributes
    ----------
    process : GaussianProcess
        Of the scores of the other study, as of `boundary_process`.

    Notes
    -----
    Source: P. Perdikaris, M. Raissi et al., "Nonlinear information fusion algorithms for data-efficient multi-fidelity
    modelling", Proceedings of the Royal Society A 473 (2017), equation 2.14 with the mean of the process before; it
    makes the factor of M. C. Kennedy, A. O'Hagan, "Predicting the output from a complex computer code when fast
    approximations are available", Biometrika 87 (2000), a function that is learned.
    """

    def __init__(self, points: FloatArray, scores: FloatArray, threshold: float) -> None:
        self.process, self._threshold = boundary_process(points, scores, threshold), threshold

    def beside(self, points: FloatArray) -> FloatArray:
        """Put beside the coordinates of points what the other study says there.

        Parameters
        ----------
        points : ndarray of float64, shape (m, e)
            As `encoded`.

        Returns
        -------
        ndarray of float64, shape (m, e + 1)
        """
        return np.column_stack([points, self.process.predict(points)[0]])

    def foretells(self, points: FloatArray, scores: FloatArray) -> bool:
        """Tell whether scores of the study at hand are told better with the other study than without it.

        Parameters
        ----------
        points : ndarray of float64, shape (m, e)
            As `encoded`.
        scores : ndarray of float64, shape (m,)
            Oriented and finite; not all the same.

        Returns
        -------
        bool
            As `boundary_process` decides.
        """
        process = boundary_process(self.beside(points), scores, self._threshold, foretold=True)
        return bool(np.isfinite(process.kernel.widths[-1]))


def with_foretold(elsewhere: Elsewhere | None, points: FloatArray) -> FloatArray:
    """Put what another study says beside the coordinates of points, where there is another one.

    Parameters
    ----------
    elsewhere : Elsewhere or None
    points : ndarray of float64, shape (m, e)
        As `encoded`.

    Returns
    -------
    ndarray of float64, shape (m, e) or (m, e + 1)
    """
    return points if elsewhere is None else elsewhere.beside(points)
