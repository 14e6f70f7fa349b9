"""Profiles of clusters: what the scenarios of a cluster have in common."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from cornercase._common.typing import IntArray
from cornercase.clustering._embedding import Distances, EmbeddedDistances
from cornercase.clustering.naming._names import name_clusters
from cornercase.clustering.naming._predicates import NamingFacts
from cornercase.clustering.naming._rules import Rule, find_rules
from cornercase.study import StudyFile


@dataclass(frozen=True)
class Profile:
    """Description of one cluster: what its scenarios have in common.

    Attributes
    ----------
    cluster : int
        Number of the cluster; -1 for noise.
    size : int
        Number of scenarios.
    scores : dict of str to tuple of float
        Lower quartile, median and upper quartile of the scores, by metric.
    outcomes : dict of str to int
        Number of scenarios by ending: who collided, or who was first if the paths of ego and other entity cross.
    rules : tuple of Rule
        Parts of the parameter space in which the cluster prevails, by falling share of the cluster's scenarios; none
        for noise.
    name : str
        Name such as ``"Ego yields to Pedestrian, closely"``; empty for noise, and in a study of an early version.
    true_of, true_elsewhere : float
        Share of the cluster's scenarios for which the name is true, and share of all scenarios of other clusters for
        which it is true; NaN without a name.
    example : int or None
        Id of the scenario with the smallest sum of distances to the other scenarios of the cluster (medoid); None
        without a name.

    Examples
    --------
    >>> from cornercase.clustering import read_analysis
    >>> for profile in read_analysis("study.db", "interaction").profiles:  # doctest: +SKIP
    ...     print(profile.cluster, profile.size, profile.label)
    0 146 Ego passes after Pedestrian or is hit by Pedestrian while it stands; 10 of 146 collide
    1 54 Ego passes before Pedestrian
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
        """Number of scenarios of the cluster in which the ego collides."""
        return sum(count for outcome, count in self.outcomes.items() if outcome.endswith(" collide"))

    @property
    def label(self) -> str:
        """Name of the cluster, with the number of collisions if only some of its scenarios end in a collision."""
        if not self.name or self.collisions in (0, self.size):
            return self.name
        return f"{self.name}; {self.collisions} of {self.size} collide"


def profile_clusters(
    study: StudyFile, labels: IntArray, facts: NamingFacts, distances: Distances
) -> tuple[Profile, ...]:
    """Return the profile of each cluster, noise last, given the distances by which the scenarios were clustered."""
    ids = [row.id for row in study.finished_rows()]
    scores = {name: study.scores(name) for name in study.meta.metrics}
    clusters = sorted(np.unique(labels).tolist(), key=lambda label: (label < 0, label))
    examples = [ids[_find_medoid(distances, np.flatnonzero(labels == label))] for label in clusters if label >= 0]
    names = name_clusters(facts, labels, examples)
    profiles = []
    for label in clusters:
        members = labels == label
        endings = [facts.outcomes[k].text for k in np.flatnonzero(members)]
        quartiles = {name: np.percentile(values[members], (25, 50, 75)).tolist() for name, values in scores.items()}
        profile = Profile(
            label,
            int(members.sum()),
            {name: (low, median, high) for name, (low, median, high) in quartiles.items()},
            {end: endings.count(end) for end in sorted(set(endings), key=lambda text: (-endings.count(text), text))},
            find_rules(study.space, facts.values, members) if label >= 0 else (),
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
        profiles.append(profile)
    return tuple(profiles)


def _find_medoid(distances: Distances, members: IntArray) -> int:
    if isinstance(distances, EmbeddedDistances):
        return distances.medoid(members)
    return int(members[distances[np.ix_(members, members)].sum(axis=1).argmin()])
