"""Names of clusters in plain words."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cornercase._common.text.sanitize import quote_name
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.clustering.naming._predicates import (
    FAULT,
    NamingFacts,
    Predicate,
    describe_ending,
    predicates_with_fitted_bounds,
    predicates_with_fixed_bounds,
)

MIN_TRUE_SHARE: Final = 0.95
"""Smallest share of a cluster's scenarios for which its name is true."""

_MAX_ENDINGS: Final = 3
_MAX_QUALIFIERS: Final = 3
# Several endings that cover this mean share of the other clusters do not identify a cluster.
_UNINFORMATIVE_SHARE: Final = 0.9
# A name is made longer if it holds for more than this mean share of the other clusters, or for more than this share of
# any other cluster. The longer name must lower the mean of both shares by the fraction `_MIN_IMPROVEMENT`.
_AMBIGUOUS_SHARES: Final = (0.25, 0.5)
_MIN_IMPROVEMENT: Final = 0.2
# Handicap of a predicate by its rank: 0 for words without numbers, 1 for bounds of features, 2 for parameters.
_RANK_HANDICAP: Final = (0.0, 0.05, 0.1)
_ENDING_ADVERBS: Final = ("at low speed", "at medium speed", "at high speed", "closely", "clear")


@dataclass(frozen=True, eq=False)
class ClusterName:
    """Name of a cluster: a predicate about how its scenarios end, and further predicates that hold for them."""

    ending: Predicate
    qualifiers: tuple[Predicate, ...] = ()

    @property
    def text(self) -> str:
        """Name as text: all predicates, separated by commas."""
        return ", ".join([self.ending.text, *(qualifier.text for qualifier in self.qualifiers)])

    @property
    def holds(self) -> BoolArray:
        """Mask of the scenarios for which all predicates of the name hold, shape (n,)."""
        holds: BoolArray = np.all([self.ending.holds, *(qualifier.holds for qualifier in self.qualifiers)], axis=0)
        return holds

    def with_qualifier(self, predicate: Predicate) -> ClusterName:
        """Return the name with one more predicate.

        The predicate replaces a predicate of the name with the same `Predicate.quantity`, such as another upper bound
        of the speed.
        """
        others = tuple(
            qualifier
            for qualifier in self.qualifiers
            if not qualifier.quantity or qualifier.quantity != predicate.quantity
        )
        return ClusterName(self.ending, (*others, predicate))


def name_clusters(facts: NamingFacts, labels: IntArray, examples: Sequence[int]) -> dict[int, ClusterName]:
    """Name each cluster by what is true of at least 95 % of its scenarios. No two clusters have the same name.

    A name starts with how the scenarios end, or with the two or three ways in which they end. Then predicates (short
    statements) separate the cluster from clusters with the same name. If the name is true of many scenarios of other
    clusters, predicates separate the cluster from all clusters. Fixed words such as ``"clear"`` are tried first, then
    bounds of features, then parts of parameter ranges. `examples` has the id of one scenario per cluster. If two
    clusters would still have the same name, the id of the example is added to the name.
    """
    endings_by_scenario = [describe_ending(outcome) for outcome in facts.outcomes]
    fixed = predicates_with_fixed_bounds(facts)
    members = {label: labels == label for label in np.unique(labels[labels >= 0]).tolist()}
    names = {
        label: _name_by_ending(
            facts, endings_by_scenario, fixed, own, [members[other] for other in members if other != label]
        )
        for label, own in members.items()
    }
    for _ in range(_MAX_QUALIFIERS):
        names = {label: _add_distinguishing_predicate(facts, fixed, members, names, label) for label in members}
    counts = Counter(name.text for name in names.values())
    everywhere = np.ones(len(labels), dtype=np.bool_)
    return {
        label: name
        if counts[name.text] == 1
        else name.with_qualifier(Predicate(f"as in scenario {examples[label]}", everywhere))
        for label, name in names.items()
    }


def _min_members(members: BoolArray) -> int:
    return math.ceil(MIN_TRUE_SHARE * int(members.sum()) - 1e-9)


def _name_by_ending(
    facts: NamingFacts,
    endings: Sequence[tuple[str, ...]],
    predicates: Sequence[Predicate],
    is_member: BoolArray,
    other_clusters: Sequence[BoolArray],
) -> ClusterName:
    """Name a cluster by the fewest endings that cover its scenarios, each as specific as possible.

    `endings` are the descriptions of how each scenario ended, the most specific first.
    """
    ego, needed = quote_name(facts.outcomes[0].ego), _min_members(is_member)
    members = np.flatnonzero(is_member).tolist()
    counts = Counter(endings[k][-1] for k in members)
    general = sorted(counts, key=lambda text: (-counts[text], text))
    selected_endings: list[str] = []
    while sum(counts[text] for text in selected_endings) < needed:
        selected_endings.append(general[len(selected_endings)])
    covered = np.array([texts[-1] in selected_endings for texts in endings])
    shares = [covered[mask].mean() for mask in other_clusters]
    if len(selected_endings) > _MAX_ENDINGS or (
        len(selected_endings) > 1 and shares and np.mean(shares) >= _UNINFORMATIVE_SHARE
    ):
        return ClusterName(Predicate(f"{ego} ends in several ways", np.ones(len(endings), dtype=np.bool_)))
    for k, text in enumerate(selected_endings):
        ladder = dict.fromkeys(detail for i in members if endings[i][-1] == text for detail in endings[i][:-1])
        # The most specific come first in each scenario's own order.
        for detail in sorted(ladder, key=lambda text: _count_covered_members(endings, is_member, [text])):
            candidate = [*selected_endings[:k], detail, *selected_endings[k + 1 :]]
            if _count_covered_members(endings, is_member, candidate) >= needed:
                selected_endings = candidate
                break
    holds = np.array([any(text in texts for text in selected_endings) for texts in endings])
    name = ClusterName(Predicate(f"{ego} {' or '.join(selected_endings)}", holds))
    for clause in predicates:
        if clause.text in _ENDING_ADVERBS and int((clause.holds & name.holds & is_member).sum()) >= needed:
            name = name.with_qualifier(clause)
            break
    for clause in predicates:
        if clause.quantity == FAULT and int((clause.holds & name.holds & is_member).sum()) >= needed:
            return name.with_qualifier(clause)
    return name


def _count_covered_members(endings: Sequence[tuple[str, ...]], is_member: BoolArray, texts: Sequence[str]) -> int:
    return sum(any(text in endings[k] for text in texts) for k in np.flatnonzero(is_member).tolist())


def _add_distinguishing_predicate(
    facts: NamingFacts,
    predicates: Sequence[Predicate],
    clusters: dict[int, BoolArray],
    names: dict[int, ClusterName],
    label: int,
) -> ClusterName:
    """Add the predicate that best separates a cluster from clusters of the same name, or from all others."""
    name, is_member = names[label], clusters[label]
    others = [other for other in clusters if other != label]
    same_name = [other for other in others if names[other].text == name.text]
    rivals = same_name or others

    def shares_of_rivals(holds: BoolArray) -> FloatArray:
        shares = [holds[clusters[rival]].mean() for rival in rivals]
        return np.array([np.mean(shares), np.max(shares)])

    if not rivals or (not same_name and bool((shares_of_rivals(name.holds) <= _AMBIGUOUS_SHARES).all())):
        return name
    needed = _min_members(is_member)
    competing = np.any([clusters[other] for other in rivals], axis=0) & name.holds
    bounded = predicates_with_fitted_bounds(facts, is_member & name.holds, needed, competing)
    best, lowest = name, (1.0 - _MIN_IMPROVEMENT) * shares_of_rivals(name.holds).mean()
    for rank, clause in [*((0, predicate) for predicate in predicates), *bounded]:
        holds = name.holds & clause.holds
        if int(holds[is_member].sum()) >= needed and shares_of_rivals(holds).mean() + _RANK_HANDICAP[rank] < lowest:
            best, lowest = name.with_qualifier(clause), shares_of_rivals(holds).mean() + _RANK_HANDICAP[rank]
    return best
