"""How far clusterings agree: with each other, and with what happened in the scenarios."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.optimize import linear_sum_assignment

from cornercase._common.texts import quoted_name
from cornercase._common.typing import IntArray
from cornercase.clustering.outcomes import Outcome
from cornercase.exploration import Objective
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
    """Compare all pairs of a study's clusterings that hold the same scenarios, and that divide them.

    Parameters
    ----------
    study : Study
        Analysed before.

    Returns
    -------
    dict of (str, str) to Agreement
        By the two aspects; without those by both of which all scenarios are one group, or noise: these are the same
        by construction.
    """
    found = {name: study.analysis(name, "ids", "labels")[0] for name in study.analyses()}
    return {
        (a, b): compare_labels(found[a]["ids"], found[a]["labels"], found[b]["labels"])
        for a, b in combinations(found, 2)
        if np.array_equal(found[a]["ids"], found[b]["ids"])
        and max(len(np.unique(found[one]["labels"])) for one in (a, b)) > 1
    }


def find_facts(study: Study, outcomes: Sequence[Outcome]) -> dict[str, list[str]]:
    """Find what a clustering of a study's scenarios may say something of.

    Parameters
    ----------
    study : Study
        Says what is critical.
    outcomes : sequence of Outcome, length n
        Of the scenarios that ended.

    Returns
    -------
    dict of str to list of str, each of length n
        By name what is the case in each scenario: ``"outcome"`` in words, who is ``"first"`` (nobody where ego and
        other collide) and whether that is the ego (``"ego first"``), the ``"collision"``, whether the ego
        ``"stopped"``, who is ``"first of Ego and C"`` for further entities, and whether the scenario is ``"critical"``,
        where a threshold says so. What is the same in all scenarios is left out.
    """
    other = outcomes[0].encounter.entity
    firsts = [None if other in {hit.entity for hit in one.impacts} else one.first for one in outcomes]
    facts = {
        "outcome": [one.text for one in outcomes],
        "first": [str(first) for first in firsts],
        "ego first": [str(first == study.meta.ego) for first in firsts],
        "collision": [str(one.collision) for one in outcomes],
        "stopped": [str(one.stops) for one in outcomes],
    }
    for name in dict.fromkeys(met.entity for one in outcomes for met in one.others):
        firsts = [{met.entity: met.first for met in one.others}.get(name) for one in outcomes]
        facts[f"first of {quoted_name(study.meta.ego)} and {quoted_name(name)}"] = [str(first) for first in firsts]
    if study.critical is not None and not study.meta.pareto:
        facts["critical"] = [str(one) for one in Objective.of_study(study.meta).critical_of(study).tolist()]
    return {name: values for name, values in facts.items() if len(set(values)) > 1}


def agree_with_facts(labels: IntArray, facts: Mapping[str, Sequence[str]]) -> dict[str, float]:
    """Measure how much a clustering says of what happened.

    Parameters
    ----------
    labels : ndarray of int64, shape (n,)
        Labels; noise counts as a cluster.
    facts : mapping of str to sequence of str, each of length n
        By name what is the case in each scenario.

    Returns
    -------
    dict of str to float
        Adjusted mutual information (Vinh et al. 2010) by name: 1 where clusters and fact are the same, about 0 where
        they have nothing to do with each other.
    """
    from sklearn.metrics import adjusted_mutual_info_score

    return {name: float(adjusted_mutual_info_score(list(values), labels)) for name, values in facts.items()}


def agree_with_critical(study: Study, ids: IntArray, labels: IntArray) -> dict[str, float]:
    """Measure how much a clustering says of what is critical.

    Parameters
    ----------
    study : Study
        Says what is critical.
    ids, labels : ndarray of int64, shape (n,)
        Scenarios, and the cluster of each.

    Returns
    -------
    dict of str to float
        As `agree_with_facts`, by ``"critical"``; empty where all scenarios or none are critical.
    """
    found = dict(zip((row.id for row in study.done()), Objective.of_study(study.meta).critical_of(study), strict=True))
    critical = [str(bool(found[one])) for one in ids.tolist()]
    return agree_with_facts(labels, {"critical": critical}) if len(set(critical)) > 1 else {}
