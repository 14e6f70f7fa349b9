"""Searches of functions whose critical sets are known."""

from __future__ import annotations

import numpy as np
from scipy.stats import qmc

from cornercase.metrics import Feature
from cornercase.scenario import ParameterSpace

CUBE = ParameterSpace.from_ranges(["a=0:1", "b=0:1", "c=0:1"])


def ridge(points):
    """Zero where a and b differ by less than 0.05; c does not matter."""
    return np.maximum(np.abs(points[:, 0] - points[:, 1]) - 0.05, 0.0)


def explored(optimizer, budget, batch=10, function=ridge):
    points = optimizer.ask(0)
    while len(points) < budget:
        new = optimizer.ask(min(batch, budget - len(points)))
        optimizer.tell(new, function(new))
        points = np.concatenate([points, new])
    return points


THRESHOLD = 1.0
EVERYWHERE = qmc.Sobol(3, seed=1).random(2**14)


def two_regions(points):
    """At most 1 in a pillar and in a ball apart from it, 13.6 % of the cube; 5 for a distance of 1."""
    pillar = np.hypot(points[:, 0] - 0.25, points[:, 1] - 0.3) - 0.18
    ball = np.linalg.norm(points - (0.8, 0.75, 0.5), axis=1) - 0.2
    return THRESHOLD + 5 * np.minimum(pillar, ball)


FEATURES = (Feature("least-clearance", "m"), Feature("crossing-gap", "s", branch=True), Feature("lowest-speed", "m/s"))


def wall(points):
    """Score and features where one of two yields only if it comes later: the score jumps to 5 along a curved wall."""
    a, b, c = points.T
    gap = a + 0.3 * np.sin(4 * b) - 0.6
    first = gap > 0.0
    near = 2.0 * np.abs(gap) + 0.4 * np.abs(c - 0.5)
    scores = np.where(first, 5.0 + near, near + 0.6)
    return scores, np.stack([np.where(first, 3.0 + near, near), gap, np.where(first, 1.0, 0.0) + b], axis=1)
