"""Names of clusters, as a person would give them."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cornercase._common.texts import quoted_name
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.clustering.clauses import Account, Clause, bounded_clauses, endings, fixed_clauses

TRUE_OF: Final = 0.95
"""Smallest share of a cluster's scenarios for which its name is true."""

_MOST_ENDINGS: Final = 3
_MOST_QUALIFIERS: Final = 3
# Several endings that cover this mean share of the other clusters do not identify a cluster.
_OF_ALL: Final = 0.9
# A name that holds for this mean (largest) share of other clusters is made longer, if that removes `_SETS_APART` of it.
_SAYS_LITTLE: Final = (0.25, 0.5)
_SETS_APART: Final = 0.2
# Handicap of predicates by rank: words without numbers, features, parameters.
_PREFERENCE: Final = (0.0, 0.05, 0.1)
_HOW: Final = ("at low speed", "at medium speed", "at high speed", "closely", "clear")


@dataclass(frozen=True, eq=False)
class KindName:
    """Name of a cluster: how its scenarios end, and further predicates that hold for them."""

    ending: Clause
    qualifiers: tuple[Clause, ...] = ()

    @property
    def text(self) -> str:
        """The name as text."""
        return ", ".join([self.ending.text, *(qualifier.text for qualifier in self.qualifiers)])

    @property
    def holds(self) -> BoolArray:
        """Mask of the scenarios for which the whole name is true, shape (n,)."""
        holds: BoolArray = np.all([self.ending.holds, *(qualifier.holds for qualifier in self.qualifiers)], axis=0)
        return holds

    def with_qualifier(self, clause: Clause) -> KindName:
        """Return the name with one more predicate; it replaces one with a bound on the same side."""
        others = tuple(qualifier for qualifier in self.qualifiers if not qualifier.of or qualifier.of != clause.of)
        return KindName(self.ending, (*others, clause))


def name_kinds(account: Account, labels: IntArray, examples: Sequence[int]) -> dict[int, KindName]:
    """Name each cluster by what is true of at least 95 % of its scenarios; no two names are the same.

    A name starts with how the scenarios end, or the two or three ways in which they do. Predicates follow that separate
    the cluster from those with the same name, or from all if the name is true of many other scenarios: first fixed
    words such as ``"clear"``, then bounds of features, then parts of parameter ranges. `examples` has one scenario per
    cluster, which completes the name if nothing else separates it.
    """
    endings_by_scenario = [endings(outcome) for outcome in account.outcomes]
    fixed = fixed_clauses(account)
    members = {label: labels == label for label in np.unique(labels[labels >= 0]).tolist()}
    names = {
        label: _named_by_ending(
            account, endings_by_scenario, fixed, own, [members[outcome] for outcome in members if outcome != label]
        )
        for label, own in members.items()
    }
    for _ in range(_MOST_QUALIFIERS):
        names = {label: _set_apart(account, fixed, members, names, label) for label in members}
    counts = Counter(name.text for name in names.values())
    everywhere = np.ones(len(labels), dtype=np.bool_)
    return {
        label: name
        if counts[name.text] == 1
        else name.with_qualifier(Clause(f"as in scenario {examples[label]}", everywhere))
        for label, name in names.items()
    }


def _needed(members: BoolArray) -> int:
    return math.ceil(TRUE_OF * int(members.sum()) - 1e-9)


def _named_by_ending(
    account: Account,
    said: Sequence[tuple[str, ...]],
    fixed: Sequence[Clause],
    mine: BoolArray,
    others: Sequence[BoolArray],
) -> KindName:
    """Name a cluster by the fewest endings that cover it, each as specific as is true."""
    ego, needed = quoted_name(account.outcomes[0].ego), _needed(mine)
    members = np.flatnonzero(mine).tolist()
    counts = Counter(said[k][-1] for k in members)
    general = sorted(counts, key=lambda text: (-counts[text], text))
    selected_endings: list[str] = []
    while sum(counts[text] for text in selected_endings) < needed:
        selected_endings.append(general[len(selected_endings)])
    covered = np.array([texts[-1] in selected_endings for texts in said])
    shares = [covered[mask].mean() for mask in others]
    if len(selected_endings) > _MOST_ENDINGS or (len(selected_endings) > 1 and shares and np.mean(shares) >= _OF_ALL):
        return KindName(Clause("any ending", np.ones(len(said), dtype=np.bool_)))
    for k, text in enumerate(selected_endings):
        ladder = dict.fromkeys(detail for i in members if said[i][-1] == text for detail in said[i][:-1])
        # The most specific come first in each scenario's own order.
        for detail in sorted(ladder, key=lambda text: _true_of_all(said, mine, [text])):
            candidate = [*selected_endings[:k], detail, *selected_endings[k + 1 :]]
            if _true_of_all(said, mine, candidate) >= needed:
                selected_endings = candidate
                break
    holds = np.array([any(text in texts for text in selected_endings) for texts in said])
    name = KindName(Clause(f"{ego} {' or '.join(selected_endings)}", holds))
    for clause in fixed:
        if clause.text in _HOW and int((clause.holds & name.holds & mine).sum()) >= needed:
            return name.with_qualifier(clause)
    return name


def _true_of_all(said: Sequence[tuple[str, ...]], mine: BoolArray, texts: Sequence[str]) -> int:
    return sum(any(text in said[k] for text in texts) for k in np.flatnonzero(mine).tolist())


def _set_apart(
    account: Account,
    fixed: Sequence[Clause],
    kinds: dict[int, BoolArray],
    names: dict[int, KindName],
    label: int,
) -> KindName:
    """Add the predicate that best separates a cluster from those of the same name, or from all others."""
    name, is_member = names[label], kinds[label]
    others = [other for other in kinds if other != label]
    same_name = [other for other in others if names[other].text == name.text]
    rivals = same_name or others

    def left(holds: BoolArray) -> FloatArray:
        shares = [holds[kinds[rival]].mean() for rival in rivals]
        return np.array([np.mean(shares), np.max(shares)])

    if not rivals or (not same_name and bool((left(name.holds) <= _SAYS_LITTLE).all())):
        return name
    needed = _needed(is_member)
    competing = np.any([kinds[other] for other in rivals], axis=0) & name.holds
    bounded = bounded_clauses(account, is_member & name.holds, needed, competing)
    best, lowest = name, (1.0 - _SETS_APART) * left(name.holds).mean()
    for rank, clause in [*((0, predicate) for predicate in fixed), *bounded]:
        holds = name.holds & clause.holds
        if int(holds[is_member].sum()) >= needed and left(holds).mean() + _PREFERENCE[rank] < lowest:
            best, lowest = name.with_qualifier(clause), left(holds).mean() + _PREFERENCE[rank]
    return best
