"""Names of kinds of scenario, as a person would give them."""

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
"""Share of the scenarios of a kind that its name is true of, at least."""

_MOST_ENDINGS: Final = 3
_MOST_QUALIFIERS: Final = 3
# Several endings that are those of so many of the other kinds, in the mean, say nothing.
_OF_ALL: Final = 0.9
# A name that is as true of other kinds (in the mean, of the one most alike) is made longer, where that takes such a
# share of it away.
_SAYS_LITTLE: Final = (0.25, 0.5)
_SETS_APART: Final = 0.2
# By how much less of the others must be left for a trait or a parameter to be named rather than words without numbers.
_PREFERENCE: Final = (0.0, 0.05, 0.1)
_HOW: Final = ("at low speed", "at medium speed", "at high speed", "closely", "clear")


@dataclass(frozen=True, eq=False)
class KindName:
    """Name of a kind of scenario.

    Attributes
    ----------
    ending : Clause
        How its scenarios end.
    qualifiers : tuple of Clause
        What is true of them, too.
    """

    ending: Clause
    qualifiers: tuple[Clause, ...] = ()

    @property
    def text(self) -> str:
        """The name."""
        return ", ".join([self.ending.text, *(one.text for one in self.qualifiers)])

    @property
    def holds(self) -> BoolArray:
        """Of which scenarios it is true, shape (n,)."""
        holds: BoolArray = np.all([self.ending.holds, *(one.holds for one in self.qualifiers)], axis=0)
        return holds

    def with_qualifier(self, clause: Clause) -> KindName:
        """Say one thing more.

        Parameters
        ----------
        clause : Clause
            Takes the place of one with a bound on the same side.

        Returns
        -------
        KindName
            The longer name.
        """
        kept = tuple(one for one in self.qualifiers if not one.of or one.of != clause.of)
        return KindName(self.ending, (*kept, clause))


def name_kinds(account: Account, labels: IntArray, examples: Sequence[int]) -> dict[int, KindName]:
    """Name the kinds of a clustering, each by what is true of at least 95 % of its scenarios.

    Each is named by how its scenarios end; where that is not all of one kind, by the two or three ways in which they
    do. What follows sets it apart from kinds of the same name, and from all others where the name is true of many of
    them: first words with bounds of their own, as ``"clear"``, then more or less of a trait, then a part of a
    parameter's range.

    Parameters
    ----------
    account : Account
        What is known of the n scenarios.
    labels : ndarray of int64, shape (n,)
        Kind of each; -1 is noise, which has no name.
    examples : sequence of int
        By kind, from 0 on, a scenario that it is named after where nothing else sets it apart from another one.

    Returns
    -------
    dict of int to KindName
        By kind; no two have the same text.
    """
    said = [endings(one) for one in account.outcomes]
    fixed = fixed_clauses(account)
    kinds = {label: labels == label for label in np.unique(labels[labels >= 0]).tolist()}
    names = {
        label: _named_by_ending(account, said, fixed, mine, [kinds[one] for one in kinds if one != label])
        for label, mine in kinds.items()
    }
    for _ in range(_MOST_QUALIFIERS):
        names = {label: _set_apart(account, fixed, kinds, names, label) for label in kinds}
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
    """Name a kind by the fewest endings that cover it, each as much in detail as is true."""
    ego, needed = quoted_name(account.outcomes[0].ego), _needed(mine)
    members = np.flatnonzero(mine).tolist()
    counts = Counter(said[k][-1] for k in members)
    general = sorted(counts, key=lambda text: (-counts[text], text))
    chosen: list[str] = []
    while sum(counts[text] for text in chosen) < needed:
        chosen.append(general[len(chosen)])
    covered = np.array([each[-1] in chosen for each in said])
    of_others = [covered[one].mean() for one in others]
    if len(chosen) > _MOST_ENDINGS or (len(chosen) > 1 and of_others and np.mean(of_others) >= _OF_ALL):
        return KindName(Clause("any ending", np.ones(len(said), dtype=np.bool_)))
    for k, text in enumerate(chosen):
        ladder = dict.fromkeys(one for i in members if said[i][-1] == text for one in said[i][:-1])
        # Those that say most come first in each scenario's own order.
        for one in sorted(ladder, key=lambda one: _true_of_all(said, mine, [one])):
            tried = [*chosen[:k], one, *chosen[k + 1 :]]
            if _true_of_all(said, mine, tried) >= needed:
                chosen = tried
                break
    holds = np.array([any(text in each for text in chosen) for each in said])
    name = KindName(Clause(f"{ego} {' or '.join(chosen)}", holds))
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
    """Say one thing more of a kind, where that sets it apart from those that have its name, or from all others."""
    name, mine = names[label], kinds[label]
    others = [one for one in kinds if one != label]
    alike = [one for one in others if names[one].text == name.text]

    rivals = alike or others

    def left(holds: BoolArray) -> FloatArray:
        shares = [holds[kinds[one]].mean() for one in rivals]
        return np.array([np.mean(shares), np.max(shares)])

    if not rivals or (not alike and bool((left(name.holds) <= _SAYS_LITTLE).all())):
        return name
    needed = _needed(mine)
    among = np.any([kinds[one] for one in rivals], axis=0) & name.holds
    bounded = bounded_clauses(account, mine & name.holds, needed, among)
    before = name.holds
    best, least = name, (1.0 - _SETS_APART) * left(before).mean()
    for rank, clause in [*((0, one) for one in fixed), *bounded]:
        holds = before & clause.holds
        if int(holds[mine].sum()) >= needed and left(holds).mean() + _PREFERENCE[rank] < least:
            best, least = name.with_qualifier(clause), left(holds).mean() + _PREFERENCE[rank]
    return best
