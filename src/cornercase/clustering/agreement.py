"""How far two clusterings of the same scenarios agree."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.optimize import linear_sum_assignment

from cornercase._common.typing import IntArray
from cornercase.study import Study


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


def compare_labels(ids: IntArray, one: IntArray, two: IntArray) -> Agreement:
    """Compare two clusterings of the same scenarios.

    Parameters
    ----------
    ids : ndarray of int64, shape (n,)
        Scenarios.
    one, two : ndarray of int64, shape (n,)
        Labels; noise counts as a cluster.

    Returns
    -------
    Agreement
        How far they agree.
    """
    from sklearn.metrics import adjusted_mutual_info_score, adjusted_rand_score

    first, a = np.unique(one, return_inverse=True)
    second, b = np.unique(two, return_inverse=True)
    table = np.zeros((len(first), len(second)), dtype=np.int64)
    np.add.at(table, (a, b), 1)
    match = dict(zip(*map(np.ndarray.tolist, linear_sum_assignment(-table)), strict=True))
    differ = [int(ids[k]) for k in range(len(ids)) if match.get(int(a[k])) != int(b[k])]
    return Agreement(float(adjusted_rand_score(one, two)), float(adjusted_mutual_info_score(one, two)), tuple(differ))


def compare_clusterings(study: Study) -> dict[tuple[str, str], Agreement]:
    """Compare all pairs of a study's clusterings that hold the same scenarios.

    Parameters
    ----------
    study : Study
        Analysed before.

    Returns
    -------
    dict of (str, str) to Agreement
        By the two aspects.
    """
    found = {name: study.analysis(name, "ids", "labels")[0] for name in study.analyses()}
    return {
        (a, b): compare_labels(found[a]["ids"], found[a]["labels"], found[b]["labels"])
        for a, b in combinations(found, 2)
        if np.array_equal(found[a]["ids"], found[b]["ids"])
    }
