"""Where in the parameter space a cluster lies, as bounds of the parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from cornercase._common.texts import quoted_name
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.scenario import ParameterSpace, Value

EVERYWHERE: Final = "everywhere"
"""Text of the rule that all scenarios follow."""

_DEPTH: Final = 3
_LEAST_SHARE: Final = 0.03
_FEWEST: Final = 3
_FOLDS: Final = 10
# A rule is told where chance would put as many members there with this probability at most. Folds share most of their
# scenarios, so labels of pure noise get a rule about ten times as often.
_CHANCE: Final = 0.001

_Bounds = dict[int, tuple[float, float]]
_Part = tuple[BoolArray, _Bounds]


@dataclass(frozen=True)
class Rule:
    """A part of the parameter space in which a cluster prevails.

    The shares are of scenarios that the rule was not found from, as `find_rules` says; NaN in a study of an early
    version, which knew only those of the scenarios that it was found from.

    Attributes
    ----------
    text : str
        Bounds of the parameters, as ``"ego_start <= 45.2 m and pedestrian_wait > 6.1 s"``.
    covers : float
        Share of the cluster's scenarios that lie there.
    purity : float
        Share of the scenarios there that are the cluster's.
    """

    text: str
    covers: float
    purity: float


def find_rules(space: ParameterSpace, values: Sequence[Mapping[str, Value]], members: BoolArray) -> tuple[Rule, ...]:
    """Find the parts of the parameter space in which some scenarios prevail, by a shallow decision tree.

    What found a rule does not judge it: the scenarios are divided in ten, and each tenth is judged by the rules that
    are found from the others. Each of these rules counts for the rule of all scenarios that it shares most scenarios
    with. A rule is told only where more members lie there than chance would put there: labels of pure noise get one in
    about 1 of 100 cases.

    Parameters
    ----------
    space : ParameterSpace
        Names, units and choices of the parameters.
    values : sequence of mapping of str to float or str, length n
        Parameters of each scenario.
    members : ndarray of bool, shape (n,)
        Mask of the scenarios whose parts are searched.

    Returns
    -------
    tuple of Rule
        By falling share of the members. One rule ``"everywhere"`` where all are members, or no parameter tells the
        members from the others.
    """
    # Loaded here: opening an analysis does not need it.
    from scipy.stats import hypergeom

    columns, names = _columns(space, values)
    everywhere = Rule(EVERYWHERE, 1.0, float(members.mean()))
    if members.all() or not members.any() or not columns.shape[1]:
        return (everywhere,)
    parts = _prevailing(columns, members)
    judged = _judged_by_others(columns, members, parts)
    found = []
    for k, (_, bounds) in enumerate(parts):
        there = judged == k
        inside, hits = int(there.sum()), int((there & members).sum())
        by_chance = float(hypergeom.sf(hits - 1, len(members), int(members.sum()), inside))
        if inside and by_chance <= _CHANCE / len(parts):
            found.append(Rule(_text(names, bounds), hits / int(members.sum()), hits / inside))
    return tuple(sorted(found, key=lambda rule: (-rule.covers, rule.text))) or (everywhere,)


def _prevailing(columns: FloatArray, members: BoolArray) -> list[_Part]:
    """Parts of the space in which more of the scenarios are members than elsewhere; each has bounds."""
    from sklearn.tree import DecisionTreeClassifier

    if members.all() or not members.any():
        return []
    least = max(_FEWEST, round(_LEAST_SHARE * len(members)))
    tree = DecisionTreeClassifier(
        max_depth=_DEPTH, min_samples_leaf=least, class_weight="balanced", random_state=0
    ).fit(columns, members)
    parts = _parts(tree.tree_, columns, members, 0, np.ones(len(members), dtype=np.bool_), {})
    return [(inside, bounds) for inside, bounds in parts if bounds and members[inside].mean() > members.mean()]


def _judged_by_others(columns: FloatArray, members: BoolArray, parts: Sequence[_Part]) -> IntArray:
    """Part in which each scenario lies by the rules that others give; -1 for none, shape (n,)."""
    judged = np.full(len(members), -1)
    fold = _folds(members)
    for k in range(int(fold.max()) + 1):
        others = fold != k
        for _, bounds in _prevailing(columns[others], members[others]):
            inside = _within(columns, bounds)
            shared = [float((inside & mine)[others].sum() / (inside | mine)[others].sum()) for mine, _ in parts]
            if max(shared, default=0.0) > 0.0:
                judged[inside & ~others] = int(np.argmax(shared))
    return judged


def _folds(members: BoolArray) -> IntArray:
    """Fold of each scenario, such that each has as many members as the next, give or take one."""
    rng = np.random.default_rng(0)
    order = np.concatenate([rng.permutation(np.flatnonzero(members)), rng.permutation(np.flatnonzero(~members))])
    fold = np.empty(len(members), dtype=np.int64)
    fold[order] = np.arange(len(order)) % _FOLDS
    return fold


def _within(columns: FloatArray, bounds: _Bounds) -> BoolArray:
    inside = np.ones(len(columns), dtype=np.bool_)
    for column, (low, high) in bounds.items():
        inside &= (columns[:, column] > low) & (columns[:, column] <= high)
    return inside


def _columns(
    space: ParameterSpace, values: Sequence[Mapping[str, Value]]
) -> tuple[FloatArray, list[tuple[str, str, str]]]:
    """Numbers for a tree, and for each column its parameter, its unit, and the choice that it stands for."""
    columns, names = [], []
    for one in space.parameters:
        if one.size == 1:
            continue
        read = [one.read(each) for each in values]
        for choice in one.choices:
            columns.append([float(str(value) == choice) for value in read])
            names.append((quoted_name(one.name), "", quoted_name(choice)))
        if not one.choices:
            columns.append([float(value) for value in read])
            names.append((quoted_name(one.name), one.unit, ""))
    return np.array(columns, dtype=np.float64).reshape(len(columns), len(values)).T, names


def _parts(
    tree: Any, columns: FloatArray, members: BoolArray, node: int, inside: BoolArray, bounds: _Bounds
) -> list[_Part]:
    """Parts of the space in which the members prevail, with the bounds of each column; two that touch are one."""
    left, right = int(tree.children_left[node]), int(tree.children_right[node])
    if left < 0:
        prevail = members[inside].mean() >= 0.5 or members[inside].sum() >= 0.5 * members.sum()
        return [(inside, bounds)] if prevail else []
    column, threshold = int(tree.feature[node]), float(tree.threshold[node])
    low, high = bounds.get(column, (-np.inf, np.inf))
    below = inside & (columns[:, column] <= threshold)
    under = _parts(tree, columns, members, left, below, bounds | {column: (low, min(high, threshold))})
    over = _parts(tree, columns, members, right, inside & ~below, bounds | {column: (max(low, threshold), high)})
    both = len(under) == len(over) == 1 and np.array_equal(under[0][0] | over[0][0], inside)
    return [(inside, bounds)] if both else [*under, *over]


def _text(names: list[tuple[str, str, str]], bounds: _Bounds) -> str:
    parts = []
    for column, (low, high) in sorted(bounds.items()):
        name, unit, choice = names[column]
        if choice:
            parts.append(f"{name} is {'' if low > 0.0 else 'not '}{choice}")
        elif np.isinf(low):
            parts.append(f"{name} <= {high:.4g} {unit}".rstrip())
        elif np.isinf(high):
            parts.append(f"{name} > {low:.4g} {unit}".rstrip())
        else:
            parts.append(f"{low:.4g} < {name} <= {high:.4g} {unit}".rstrip())
    return " and ".join(parts)
