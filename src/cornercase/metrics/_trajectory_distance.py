"""Metric of the distance along both trajectories to their crossing."""

from __future__ import annotations

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray
from cornercase.metrics._base import Metric
from cornercase.metrics._geometry.crossing import distances_to_crossing
from cornercase.recordings import Recording


class TrajectoryDistance(Metric):
    """Sum of the distances that both entities still have along their tracks to the crossing of the tracks.

    ``d_ego + d_other`` in m. A track joins the recorded centres of the bounding box. After the last centre it goes
    straight on for `ahead`, along the last heading, or backwards if the entity last moved backwards. So an entity that
    stands, or stops before the crossing, has a path too. Only a crossing ahead of both entities counts; if there are
    several, the one with the smallest sum. The value depends on the shape of the tracks, not on the speeds.

    Not defined if one of the two does not exist, or if no crossing lies ahead of both. Some tracks do not cross:
    parallel tracks, one entity behind the other, and tracks that merge without touching. A track that joins the other
    and then follows it exactly meets it where it joins. Least critical value (cap): 200 m.

    Source: trajectory distance, first objective of scenario 1 in Schütt, Otten and Sax, "Clustering-based criticality
    analysis for testing of automated driving systems" (2023).

    Parameters
    ----------
    ahead : float, default 100.0
        Length in m by which each track goes straight on after the recording; 0 for recorded tracks only.

    Raises
    ------
    InputError
        `ahead` is negative or not finite.

    Examples
    --------
    >>> import cornercase as cc
    >>> recording = cc.simulate(
    ...     "examples/x_intersection/x_intersection.xosc", {"ego_start": 44.0}, drivers={"Ego": "aggressive"}
    ... )
    >>> cc.measure(recording, "Ego", "Pedestrian", [cc.metrics.TrajectoryDistance()])
    metric               score  unit  critical is
    trajectory-distance  21.47  m     low
    """

    name = "trajectory-distance"
    unit = "m"
    lower_is_critical = True
    cap = 200.0
    source = "Schütt, Otten and Sax 2023"

    def __init__(self, ahead: float = 100.0) -> None:
        if not 0.0 <= ahead < np.inf:
            raise InputError(f"trajectory-distance cannot look {ahead} m ahead; give a finite length of 0 or more.")
        self.ahead = ahead

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        ego_distance, other_distance = distances_to_crossing(recording, ego, other, self.ahead)
        return ego_distance + other_distance
