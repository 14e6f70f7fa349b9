"""What the scenarios of a cluster have in common, so that a person can name it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cornercase._common.typing import IntArray
from cornercase.clustering.rules import Rule, find_rules
from cornercase.study import Study


@dataclass(frozen=True)
class Profile:
    """One cluster.

    Attributes
    ----------
    cluster : int
        -1 for noise.
    size : int
    scores : dict of str to tuple of float
        By metric the lower quartile, the median and the upper quartile.
    outcomes : dict of str to int
        How many ended how: who collided, or who was first where the ways of ego and other cross.
    rules : tuple of Rule
        By falling share of the cluster's scenarios; none for noise.
    """

    cluster: int
    size: int
    scores: dict[str, tuple[float, float, float]]
    outcomes: dict[str, int]
    rules: tuple[Rule, ...]


def describe_clusters(study: Study, labels: IntArray, outcomes: Sequence[str]) -> tuple[Profile, ...]:
    """Describe each cluster of a study, noise last.

    Parameters
    ----------
    study : Study
        Holds their parameters and scores.
    labels : ndarray of int64, shape (n,)
        Cluster of each scenario that ended.
    outcomes : sequence of str, length n
        How each ended, as in `cornercase.clustering.outcomes.tell_outcome`.

    Returns
    -------
    tuple of Profile
        One for each cluster.
    """
    values = [row.values for row in study.done()]
    scores = {name: study.scores(name) for name in study.meta.metrics}
    found = []
    for label in sorted(np.unique(labels).tolist(), key=lambda one: (one < 0, one)):
        members = labels == label
        ends = [outcomes[k] for k in np.flatnonzero(members)]
        quartiles = {
            name: np.percentile(each_score[members], (25, 50, 75)).tolist() for name, each_score in scores.items()
        }
        found.append(
            Profile(
                label,
                int(members.sum()),
                {name: (low, middle, high) for name, (low, middle, high) in quartiles.items()},
                {end: ends.count(end) for end in sorted(set(ends), key=lambda one: (-ends.count(one), one))},
                find_rules(study.space, values, members) if label >= 0 else (),
            )
        )
    return tuple(found)
