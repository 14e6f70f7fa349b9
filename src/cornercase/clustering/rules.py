"""Rules for clusters: the bounds of the parameters between which a cluster prevails."""

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
# Largest p-value of a rule. Folds share most of their scenarios, so labels of pure noise get a rule about ten times as
# often as this.
_CHANCE: Final = 0.001

_Bounds = dict[int, tuple[float, float]]
_Part = tuple[BoolArray, _Bounds]


@dataclass(frozen=True)
class Rule:
    """Part of the parameter space in which a cluster prevails.

    The shares are cross-validated, as `find_rules` says; NaN in studies of early versions.

    Attributes
    ----------
    text : str
        Bounds of the parameters, as ``"ego_start <= 45.2 m and pedestrian_wait > 6.1 s"``.
    covers : float
        Share of the cluster's scenarios that lie there (recall).
    purity : float
        Share of the scenarios there that belong to the cluster (precision).
    """

    text: str
    covers: float
    purity: float


def find_rules(space: ParameterSpace, values: Sequence[Mapping[str, Value]], members: BoolArray) -> tuple[Rule, ...]:
    """Find the parts of the parameter space in which members prevail, by a shallow decision tree.

    Rules are judged by ten-fold cross-validation: each tenth is judged by the rules of the other nine, and each of
    those counts for the rule of all scenarios that it overlaps most. A rule is returned only if significantly more
    members lie there than by chance; labels of pure noise get one in about 1 of 100 cases. Rules come by falling share
    of the members; a single rule ``"everywhere"`` if all are members or no parameter separates them.
    """
    # Imported here, since opening an analysis does not need it.
    from scipy.stats import hypergeom

    columns, names = _columns(space, values)
    everywhere = Rule(EVERYWHERE, 1.0, float(members.mean()))
    if members.all() or not members.any() or not columns.shape[1]:
        return (everywhere,)
    parts = _prevailing(columns, members)
    judged = _judged_by_others(columns, members, parts)
    rules = []
    for k, (_, bounds) in enumerate(parts):
        is_inside = judged == k
        count, hits = int(is_inside.sum()), int((is_inside & members).sum())
        p_value = float(hypergeom.sf(hits - 1, len(members), int(members.sum()), count))
        if count and p_value <= _CHANCE / len(parts):
            rules.append(Rule(_text(names, bounds), hits / int(members.sum()), hits / count))
    return tuple(sorted(rules, key=lambda rule: (-rule.covers, rule.text))) or (everywhere,)


def _prevailing(columns: FloatArray, members: BoolArray) -> list[_Part]:
    """Parts of the space, with bounds, in which the share of members is above average."""
    from sklearn.tree import DecisionTreeClassifier

    if members.all() or not members.any():
        return []
    min_leaf = max(_FEWEST, round(_LEAST_SHARE * len(members)))
    tree = DecisionTreeClassifier(
        max_depth=_DEPTH, min_samples_leaf=min_leaf, class_weight="balanced", random_state=0
    ).fit(columns, members)
    parts = _parts(tree.tree_, columns, members, 0, np.ones(len(members), dtype=np.bool_), {})
    return [(is_inside, bounds) for is_inside, bounds in parts if bounds and members[is_inside].mean() > members.mean()]


def _judged_by_others(columns: FloatArray, members: BoolArray, parts: Sequence[_Part]) -> IntArray:
    """Part in which each scenario lies by the rules of the other folds; -1 for none, shape (n,)."""
    judged = np.full(len(members), -1)
    fold = _folds(members)
    for k in range(int(fold.max()) + 1):
        training = fold != k
        for _, bounds in _prevailing(columns[training], members[training]):
            is_inside = _within(columns, bounds)
            overlaps = [
                float((is_inside & members_of_part)[training].sum() / (is_inside | members_of_part)[training].sum())
                for members_of_part, _ in parts
            ]
            if max(overlaps, default=0.0) > 0.0:
                judged[is_inside & ~training] = int(np.argmax(overlaps))
    return judged


def _folds(members: BoolArray) -> IntArray:
    """Fold of each scenario; stratified, so that all folds have equally many members, give or take one."""
    rng = np.random.default_rng(0)
    order = np.concatenate([rng.permutation(np.flatnonzero(members)), rng.permutation(np.flatnonzero(~members))])
    fold = np.empty(len(members), dtype=np.int64)
    fold[order] = np.arange(len(order)) % _FOLDS
    return fold


def _within(columns: FloatArray, bounds: _Bounds) -> BoolArray:
    is_inside = np.ones(len(columns), dtype=np.bool_)
    for column, (low, high) in bounds.items():
        is_inside &= (columns[:, column] > low) & (columns[:, column] <= high)
    return is_inside


def _columns(
    space: ParameterSpace, values: Sequence[Mapping[str, Value]]
) -> tuple[FloatArray, list[tuple[str, str, str]]]:
    """Numeric columns for a tree, and for each column its parameter, unit and the choice that it encodes."""
    columns, names = [], []
    for parameter in space.parameters:
        if parameter.size == 1:
            continue
        column = [parameter.read(row) for row in values]
        for choice in parameter.choices:
            columns.append([float(str(value) == choice) for value in column])
            names.append((quoted_name(parameter.name), "", quoted_name(choice)))
        if not parameter.choices:
            columns.append([float(value) for value in column])
            names.append((quoted_name(parameter.name), parameter.unit, ""))
    return np.array(columns, dtype=np.float64).reshape(len(columns), len(values)).T, names


def _parts(
    tree: Any, columns: FloatArray, members: BoolArray, node: int, inside: BoolArray, bounds: _Bounds
) -> list[_Part]:
    """Leaves of the tree in which the members prevail, with the bounds of each column; siblings are merged."""
    left, right = int(tree.children_left[node]), int(tree.children_right[node])
    if left < 0:
        prevails = members[inside].mean() >= 0.5 or members[inside].sum() >= 0.5 * members.sum()
        return [(inside, bounds)] if prevails else []
    column, threshold = int(tree.feature[node]), float(tree.threshold[node])
    low, high = bounds.get(column, (-np.inf, np.inf))
    below = inside & (columns[:, column] <= threshold)
    left_parts = _parts(tree, columns, members, left, below, bounds | {column: (low, min(high, threshold))})
    right_parts = _parts(tree, columns, members, right, inside & ~below, bounds | {column: (max(low, threshold), high)})
    mergeable = len(left_parts) == len(right_parts) == 1 and np.array_equal(
        left_parts[0][0] | right_parts[0][0], inside
    )
    return [(inside, bounds)] if mergeable else [*left_parts, *right_parts]


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
