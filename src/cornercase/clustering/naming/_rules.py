"""Rules for clusters: bounds of the parameters between which most scenarios belong to a cluster."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from cornercase._common.text.sanitize import quote_name
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.scenario import ParameterSpace, Value

EVERYWHERE_TEXT: Final = "everywhere"
"""Text of the rule that all scenarios follow."""

_MAX_DEPTH: Final = 3
_MIN_LEAF_SHARE: Final = 0.03
_MIN_LEAF: Final = 3
_N_FOLDS: Final = 10
# Largest p-value of a rule. The folds of cross-validation share most of their scenarios, so labels of pure noise get a
# rule about ten times as often as this p-value says.
_MAX_P_VALUE: Final = 0.001

_Bounds = dict[int, tuple[float, float]]
_Region = tuple[BoolArray, _Bounds]


@dataclass(frozen=True)
class Rule:
    """Part of the parameter space in which a cluster prevails.

    The shares are cross-validated; they are NaN in studies of early versions.

    Attributes
    ----------
    text : str
        Bounds of the parameters, such as ``"ego_start <= 45.2 m and pedestrian_wait > 6.1 s"``.
    covers : float
        Share of the cluster's scenarios that lie in this part (recall).
    purity : float
        Share of the scenarios in this part that belong to the cluster (precision).

    Examples
    --------
    >>> from cornercase.clustering import read_analysis
    >>> rule = read_analysis("study.db", "interaction").profiles[0].rules[0]  # doctest: +SKIP
    >>> print(f"{rule.text} (covers {rule.covers:.0%}, purity {rule.purity:.0%})")  # doctest: +SKIP
    ego_start <= 71.3 m and pedestrian_wait <= 6.505 s (covers 61%, purity 97%)
    """

    text: str
    covers: float
    purity: float


def find_rules(space: ParameterSpace, values: Sequence[Mapping[str, Value]], is_member: BoolArray) -> tuple[Rule, ...]:
    """Find the parts of the parameter space in which members of a cluster prevail, by a shallow decision tree.

    The rules are found in all scenarios, and judged by ten-fold cross-validation: a tree is trained on nine tenths of
    the scenarios, and applied to the last tenth. What a rule of this tree gets right or wrong there is credited to the
    rule from all scenarios with the largest overlap. A rule is returned only if its part has significantly more members
    than by chance: if membership were random, a rule would be returned in about 1 of 100 cases. Rules come by falling
    share of the members. If all scenarios are members, or no parameter separates the members, there is a single rule
    ``"everywhere"``.
    """
    # Imported here, since opening an analysis does not need it.
    from scipy.stats import hypergeom

    columns, names = _encode_parameters(space, values)
    everywhere = Rule(EVERYWHERE_TEXT, 1.0, float(is_member.mean()))
    if is_member.all() or not is_member.any() or not columns.shape[1]:
        return (everywhere,)
    parts = _find_prevailing_regions(columns, is_member)
    judged = _cross_validated_regions(columns, is_member, parts)
    rules = []
    for k, (_, bounds) in enumerate(parts):
        is_inside = judged == k
        count, hits = int(is_inside.sum()), int((is_inside & is_member).sum())
        p_value = float(hypergeom.sf(hits - 1, len(is_member), int(is_member.sum()), count))
        if count and p_value <= _MAX_P_VALUE / len(parts):
            rules.append(Rule(_format_bounds(names, bounds), hits / int(is_member.sum()), hits / count))
    return tuple(sorted(rules, key=lambda rule: (-rule.covers, rule.text))) or (everywhere,)


def _find_prevailing_regions(columns: FloatArray, is_member: BoolArray) -> list[_Region]:
    """Find parts of the parameter space in which the share of members is above average.

    Each part has a mask of its scenarios and the bounds of the parameters.
    """
    from sklearn.tree import DecisionTreeClassifier

    if is_member.all() or not is_member.any():
        return []
    min_leaf = max(_MIN_LEAF, round(_MIN_LEAF_SHARE * len(is_member)))
    tree = DecisionTreeClassifier(
        max_depth=_MAX_DEPTH, min_samples_leaf=min_leaf, class_weight="balanced", random_state=0
    ).fit(columns, is_member)
    parts = _collect_leaves(tree.tree_, columns, is_member, 0, np.ones(len(is_member), dtype=np.bool_), {})
    return [
        (is_inside, bounds) for is_inside, bounds in parts if bounds and is_member[is_inside].mean() > is_member.mean()
    ]


def _cross_validated_regions(columns: FloatArray, is_member: BoolArray, regions: Sequence[_Region]) -> IntArray:
    """Return the index of the region of each scenario by cross-validation, shape (n,); -1 outside all regions.

    The region of a scenario is found by rules that were learned from the scenarios of the other folds.
    """
    judged = np.full(len(is_member), -1)
    fold = _stratified_folds(is_member)
    for k in range(int(fold.max()) + 1):
        training = fold != k
        for _, bounds in _find_prevailing_regions(columns[training], is_member[training]):
            is_inside = _is_within_bounds(columns, bounds)
            overlaps = [
                float((is_inside & members_of_part)[training].sum() / (is_inside | members_of_part)[training].sum())
                for members_of_part, _ in regions
            ]
            if max(overlaps, default=0.0) > 0.0:
                judged[is_inside & ~training] = int(np.argmax(overlaps))
    return judged


def _stratified_folds(is_member: BoolArray) -> IntArray:
    """Return the number of the cross-validation fold of each scenario, shape (n,).

    The numbers of members in any two folds differ by at most one.
    """
    rng = np.random.default_rng(0)
    order = np.concatenate([rng.permutation(np.flatnonzero(is_member)), rng.permutation(np.flatnonzero(~is_member))])
    fold = np.empty(len(is_member), dtype=np.int64)
    fold[order] = np.arange(len(order)) % _N_FOLDS
    return fold


def _is_within_bounds(columns: FloatArray, bounds: _Bounds) -> BoolArray:
    is_inside = np.ones(len(columns), dtype=np.bool_)
    for column, (low, high) in bounds.items():
        is_inside &= (columns[:, column] > low) & (columns[:, column] <= high)
    return is_inside


def _encode_parameters(
    space: ParameterSpace, values: Sequence[Mapping[str, Value]]
) -> tuple[FloatArray, list[tuple[str, str, str]]]:
    """Return numeric columns of parameter values for a decision tree, shape (n, columns).

    A number has one column, and none if it has a single value. A parameter with choices has one column per choice,
    which is 1 in scenarios with this choice and 0 in others. The second result has parameter, unit and choice of each
    column; "" if there is none.
    """
    columns, names = [], []
    for parameter in space.parameters:
        if parameter.size == 1:
            continue
        column = [parameter.extract_value(row) for row in values]
        for choice in parameter.choices:
            columns.append([float(str(value) == choice) for value in column])
            names.append((quote_name(parameter.name), "", quote_name(choice)))
        if not parameter.choices:
            columns.append([float(value) for value in column])
            names.append((quote_name(parameter.name), parameter.unit, ""))
    return np.array(columns, dtype=np.float64).reshape(len(columns), len(values)).T, names


def _collect_leaves(
    tree: Any, columns: FloatArray, is_member: BoolArray, node: int, is_inside: BoolArray, bounds: _Bounds
) -> list[_Region]:
    """Return the leaves below `node` of a decision tree in which members prevail, with the bounds of each column.

    Members prevail if they are at least half of the scenarios in a leaf, or if at least half of all members are in the
    leaf. Two sibling leaves in which members prevail are merged.
    """
    left, right = int(tree.children_left[node]), int(tree.children_right[node])
    if left < 0:
        prevails = is_member[is_inside].mean() >= 0.5 or is_member[is_inside].sum() >= 0.5 * is_member.sum()
        return [(is_inside, bounds)] if prevails else []
    column, threshold = int(tree.feature[node]), float(tree.threshold[node])
    low, high = bounds.get(column, (-np.inf, np.inf))
    below = is_inside & (columns[:, column] <= threshold)
    left_parts = _collect_leaves(tree, columns, is_member, left, below, bounds | {column: (low, min(high, threshold))})
    right_parts = _collect_leaves(
        tree, columns, is_member, right, is_inside & ~below, bounds | {column: (max(low, threshold), high)}
    )
    mergeable = len(left_parts) == len(right_parts) == 1 and np.array_equal(
        left_parts[0][0] | right_parts[0][0], is_inside
    )
    return [(is_inside, bounds)] if mergeable else [*left_parts, *right_parts]


def _format_bounds(names: list[tuple[str, str, str]], bounds: _Bounds) -> str:
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
