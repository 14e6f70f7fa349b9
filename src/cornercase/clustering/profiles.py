"""What the scenarios of a cluster have in common, so that a person can name it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from cornercase._common.typing import IntArray
from cornercase.clustering.clauses import Account
from cornercase.clustering.names import name_kinds
from cornercase.clustering.places import Distances, PlacedDistances
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
    name : str
        What a person would call it, as ``"Ego yields to Pedestrian, closely"``; empty for noise, and in a study of an
        early version.
    true_of, true_elsewhere : float
        Share of its scenarios that the name is true of, and of all scenarios of other clusters; NaN without a name.
    example : int or None
        Id of the scenario with the smallest sum of distances to the others of the cluster; None without a name.
    """

    cluster: int
    size: int
    scores: dict[str, tuple[float, float, float]]
    outcomes: dict[str, int]
    rules: tuple[Rule, ...]
    name: str = ""
    true_of: float = math.nan
    true_elsewhere: float = math.nan
    example: int | None = None

    @property
    def collisions(self) -> int:
        """Number of its scenarios in which the ego collides."""
        return sum(count for outcome, count in self.outcomes.items() if outcome.endswith(" collide"))

    @property
    def label(self) -> str:
        """Its name, with the number of collisions where only some of its scenarios end so."""
        if not self.name or self.collisions in (0, self.size):
            return self.name
        return f"{self.name}; {self.collisions} of {self.size} collide"


def describe_clusters(study: Study, labels: IntArray, account: Account, distances: Distances) -> tuple[Profile, ...]:
    """Describe each cluster of a study, noise last.

    Parameters
    ----------
    study : Study
        Holds their scores.
    labels : ndarray of int64, shape (n,)
        Cluster of each scenario that ended.
    account : Account
        How each went, with its parameters.
    distances : ndarray of float64, shape (n, n), or PlacedDistances
        Distances that they were clustered by.

    Returns
    -------
    tuple of Profile
        One for each cluster.
    """
    ids = [row.id for row in study.done()]
    scores = {name: study.scores(name) for name in study.meta.metrics}
    clusters = sorted(np.unique(labels).tolist(), key=lambda one: (one < 0, one))
    examples = [ids[_medoid(distances, np.flatnonzero(labels == label))] for label in clusters if label >= 0]
    names = name_kinds(account, labels, examples)
    found = []
    for label in clusters:
        members = labels == label
        ends = [account.outcomes[k].text for k in np.flatnonzero(members)]
        quartiles = {
            name: np.percentile(each_score[members], (25, 50, 75)).tolist() for name, each_score in scores.items()
        }
        profile = Profile(
            label,
            int(members.sum()),
            {name: (low, middle, high) for name, (low, middle, high) in quartiles.items()},
            {end: ends.count(end) for end in sorted(set(ends), key=lambda one: (-ends.count(one), one))},
            find_rules(study.space, account.values, members) if label >= 0 else (),
        )
        if label >= 0:
            name, others = names[label], (labels >= 0) & ~members
            profile = replace(
                profile,
                name=name.text,
                true_of=float(name.holds[members].mean()),
                true_elsewhere=float(name.holds[others].mean()) if others.any() else 0.0,
                example=examples[label],
            )
        found.append(profile)
    return tuple(found)


def _medoid(distances: Distances, members: IntArray) -> int:
    if isinstance(distances, PlacedDistances):
        return distances.middle(members)
    return int(members[distances[np.ix_(members, members)].sum(axis=1).argmin()])
