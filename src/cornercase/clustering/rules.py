"""Where in the parameter space a cluster lies, as bounds of the parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray
from cornercase.scenario import ParameterSpace, Value

_DEPTH: Final = 3
_LEAST_SHARE: Final = 0.03
_FEWEST: Final = 3

_Bounds = dict[int, tuple[float, float]]


@dataclass(frozen=True)
class Rule:
    """A part of the parameter space in which a cluster prevails.

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
    from sklearn.tree import DecisionTreeClassifier

    columns, names = _columns(space, values)
    everywhere = Rule("everywhere", 1.0, float(members.mean()))
    if members.all() or not columns.shape[1]:
        return (everywhere,)
    least = max(_FEWEST, round(_LEAST_SHARE * len(values)))
    tree = DecisionTreeClassifier(
        max_depth=_DEPTH, min_samples_leaf=least, class_weight="balanced", random_state=0
    ).fit(columns, members)
    parts = _parts(tree.tree_, columns, members, 0, np.ones(len(values), dtype=np.bool_), {})
    found = [
        Rule(_text(names, bounds) or "everywhere", float(members[inside].sum() / members.sum()), float(purity))
        for inside, bounds in parts
        if (purity := members[inside].mean()) > members.mean()
    ]
    return tuple(sorted(found, key=lambda rule: (-rule.covers, rule.text))) or (everywhere,)


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
            names.append((one.name, "", choice))
        if not one.choices:
            columns.append([float(value) for value in read])
            names.append((one.name, one.unit, ""))
    return np.array(columns, dtype=np.float64).reshape(len(columns), len(values)).T, names


def _parts(
    tree: Any, columns: FloatArray, members: BoolArray, node: int, inside: BoolArray, bounds: _Bounds
) -> list[tuple[BoolArray, _Bounds]]:
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
