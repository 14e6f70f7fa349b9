"""What is alike within a cluster, in words: so that a person can name it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, Final

import numpy as np
from scipy.optimize import linear_sum_assignment

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.metrics import visits
from cornercase.recordings import Recording
from cornercase.scenario import ParameterSpace, Value
from cornercase.study import Row, Study

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


@dataclass(frozen=True)
class Agreement:
    """How far two clusterings of the same scenarios agree.

    Attributes
    ----------
    rand, mutual : float
        Adjusted Rand index (Hubert and Arabie 1985) and adjusted mutual information (Vinh et al. 2010): 1 where they
        are the same, about 0 where one says nothing of the other.
    differ : tuple of int
        Scenarios whose cluster of the one is not matched with their cluster of the other, when clusters are matched
        so that as many scenarios as possible agree.
    """

    rand: float
    mutual: float
    differ: tuple[int, ...]


def profiles(study: Study, labels: IntArray, outcomes: Sequence[str]) -> tuple[Profile, ...]:
    """Describe each cluster of a study, noise last.

    Parameters
    ----------
    study : Study
    labels : ndarray of int64, shape (n,)
        Cluster of each scenario that ended.
    outcomes : sequence of str, length n
        As of `outcome`.

    Returns
    -------
    tuple of Profile
    """
    rows = study.done()
    scores = {name: study.scores(name) for name in study.meta.metrics}
    found = []
    for label in sorted(np.unique(labels).tolist(), key=lambda one: (one < 0, one)):
        members = labels == label
        each = [outcomes[k] for k in np.flatnonzero(members)]
        quartiles = {name: np.percentile(values[members], (25, 50, 75)).tolist() for name, values in scores.items()}
        found.append(
            Profile(
                label,
                int(members.sum()),
                {name: (low, middle, high) for name, (low, middle, high) in quartiles.items()},
                {end: each.count(end) for end in sorted(set(each), key=lambda one: (-each.count(one), one))},
                rules(study.space, rows, members) if label >= 0 else (),
            )
        )
    return tuple(found)


def outcome(recording: Recording, ego: str, other: str) -> str:
    """How a scenario ended for the ego: who collided, else who was first where the ways cross.

    Parameters
    ----------
    recording : Recording
    ego, other : str

    Returns
    -------
    str
    """
    hit = [collision for collision in recording.collisions if ego in collision.entities]
    if hit:
        return f"{ego} and {' '.join(name for name in hit[0].entities if name != ego)} collide"
    stays = visits(recording, ego, other, None)
    if not stays:
        return "ways do not cross"
    mine, others = min(stays, key=lambda pair: min(pair[0].enters, pair[1].enters))
    return f"{ego} first" if mine.enters < others.enters else f"{other} first"


def rules(space: ParameterSpace, rows: Sequence[Row], members: BoolArray) -> tuple[Rule, ...]:
    """Say in which parts of the parameter space some scenarios prevail, by a shallow decision tree.

    Parameters
    ----------
    space : ParameterSpace
    rows : sequence of Row, length n
    members : ndarray of bool, shape (n,)

    Returns
    -------
    tuple of Rule
        One ``"everywhere"`` where the scenarios are all, or nothing sets them apart.
    """
    # Loaded here, so that who only looks at a study does not wait for it.
    from sklearn.tree import DecisionTreeClassifier

    columns, names = _columns(space, [row.values for row in rows])
    everywhere = Rule("everywhere", 1.0, float(members.mean()))
    if members.all() or not columns.shape[1]:
        return (everywhere,)
    least = max(_FEWEST, round(_LEAST_SHARE * len(rows)))
    tree = DecisionTreeClassifier(
        max_depth=_DEPTH, min_samples_leaf=least, class_weight="balanced", random_state=0
    ).fit(columns, members)
    parts = _parts(tree.tree_, columns, members, 0, np.ones(len(rows), dtype=np.bool_), {})
    found = [
        Rule(_text(names, bounds) or "everywhere", float(members[inside].sum() / members.sum()), float(purity))
        for inside, bounds in parts
        if (purity := members[inside].mean()) > members.mean()
    ]
    return tuple(sorted(found, key=lambda rule: (-rule.covers, rule.text))) or (everywhere,)


def agreement(ids: IntArray, one: IntArray, two: IntArray) -> Agreement:
    """Compare two clusterings.

    Parameters
    ----------
    ids : ndarray of int64, shape (n,)
        Scenarios.
    one, two : ndarray of int64, shape (n,)
        Labels; noise counts as a cluster.
    """
    from sklearn.metrics import adjusted_mutual_info_score, adjusted_rand_score

    first, a = np.unique(one, return_inverse=True)
    second, b = np.unique(two, return_inverse=True)
    table = np.zeros((len(first), len(second)), dtype=np.int64)
    np.add.at(table, (a, b), 1)
    match = dict(zip(*map(np.ndarray.tolist, linear_sum_assignment(-table)), strict=True))
    differ = [int(ids[k]) for k in range(len(ids)) if match.get(int(a[k])) != int(b[k])]
    return Agreement(float(adjusted_rand_score(one, two)), float(adjusted_mutual_info_score(one, two)), tuple(differ))


def agreements(study: Study) -> dict[tuple[str, str], Agreement]:
    """Compare all pairs of a study's clusterings that hold the same scenarios."""
    found = {name: study.analysis(name, "ids", "labels")[0] for name in study.analyses()}
    return {
        (a, b): agreement(found[a]["ids"], found[a]["labels"], found[b]["labels"])
        for a, b in combinations(found, 2)
        if np.array_equal(found[a]["ids"], found[b]["ids"])
    }


def _columns(space: ParameterSpace, values: list[dict[str, Value]]) -> tuple[FloatArray, list[tuple[str, str, str]]]:
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
    """Parts of the space in which the members prevail, with the bounds of each column; what touches is one part."""
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
