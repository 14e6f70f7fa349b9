"""Euclidean distance."""

from __future__ import annotations

import numpy as np

from cornercase.metrics.base import worst
from cornercase.recording import Recording
from cornercase.typing import FloatArray


class Distance:
    """Distance between the centres of two bounding boxes.

    ``|p_other - p_ego|`` in the plane, in m. It depends on positions only, so standing entities are nothing
    special; 0 when the centres coincide. Boxes that touch still have a positive distance: their gap is
    `cornercase.geometry.box_distance`.

    Not defined where one of the two does not exist. Cap: 100 m.

    Notes
    -----
    Source: Euclidean distance, as an objective in Schütt, Otten and Sax, "Clustering-based
    criticality analysis for testing of automated driving systems" (2023), scenario 2.
    """

    name = "distance"
    unit = "m"
    lower_is_critical = True
    cap = 100.0
    source = "Euclidean distance between the centres of the bounding boxes"

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        """Distance at each instant.

        Parameters
        ----------
        recording : Recording
        ego, other : str
            Names of two entities.

        Returns
        -------
        ndarray of float64, shape (T,)
            m; NaN where one does not exist.

        Raises
        ------
        InputError
            There is no entity of that name.
        """
        gap = recording.center(other) - recording.center(ego)
        return np.hypot(gap[:, 0], gap[:, 1])

    def score(self, course: FloatArray) -> float:
        """Smallest distance of the course in m, the cap if there is none below it."""
        return worst(self, course)
