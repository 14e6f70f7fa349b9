"""Agreement of clusterings with each other, and with facts about the scenarios."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.optimize import linear_sum_assignment

from cornercase._common.text.sanitize import quote_name
from cornercase._common.typing import IntArray
from cornercase.metrics._outcome import Outcome
from cornercase.study import StudyFile


@dataclass(frozen=True)
class Agreement:
    """Agreement of two clusterings of the same scenarios.

    Attributes
    ----------
    adjusted_rand, mutual_information : float
        Adjusted Rand index (Hubert and Arabie 1985) and adjusted mutual information (Vinh et al. 2010): 1 if the
        clusterings are the same, about 0 if they are independent.
    differing : tuple of int
        Ids of the scenarios that are in different clusters. For this, each cluster of one clustering is paired with a
        cluster of the other clustering so that as many scenarios as possible agree.

    Examples
    --------
    >>> import cornercase as cc
    >>> agreement = cc.summarize("study.db").agreements["bearing", "interaction"]  # doctest: +SKIP
    >>> agreement.adjusted_rand, agreement.differing  # doctest: +SKIP
    (1.0, ())
    """

    adjusted_rand: float
    mutual_information: float
    differing: tuple[int, ...]


def compare_labels(ids: IntArray, labels_a: IntArray, labels_b: IntArray) -> Agreement:
    """Return the agreement of two clusterings of the same scenarios, given as labels.

    `ids`, `labels_a` and `labels_b` have shape (n,); noise counts as a cluster.
    """
    from sklearn.metrics import adjusted_mutual_info_score, adjusted_rand_score

    names_a, a = np.unique(labels_a, return_inverse=True)
    names_b, b = np.unique(labels_b, return_inverse=True)
    table = np.zeros((len(names_a), len(names_b)), dtype=np.int64)
    np.add.at(table, (a, b), 1)
    match = dict(zip(*map(np.ndarray.tolist, linear_sum_assignment(-table)), strict=True))
    different = [int(ids[k]) for k in range(len(ids)) if match.get(int(a[k])) != int(b[k])]
    return Agreement(
        float(adjusted_rand_score(labels_a, labels_b)),
        float(adjusted_mutual_info_score(labels_a, labels_b)),
        tuple(different),
    )


def compare_clusterings(study: StudyFile) -> dict[tuple[str, str], Agreement]:
    """Compare all pairs of a study's analyses that have the same scenarios; return agreements by pair of aspects.

    An aspect is what scenarios are compared by. A pair is left out if both clusterings have a single cluster or only
    noise, since such clusterings always agree.
    """
    arrays = {name: study.read_analysis(name, "ids", "labels")[0] for name in study.analyzed_aspects()}
    return {
        (a, b): compare_labels(arrays[a]["ids"], arrays[a]["labels"], arrays[b]["labels"])
        for a, b in combinations(arrays, 2)
        if np.array_equal(arrays[a]["ids"], arrays[b]["ids"])
        and max(len(np.unique(arrays[by]["labels"])) for by in (a, b)) > 1
    }


def collect_facts(study: StudyFile, outcomes: Sequence[Outcome]) -> dict[str, list[str]]:
    """Return facts about scenarios, to compare clusterings with: for each name of a fact, one value per scenario.

    The names are ``"outcome"`` (a text), ``"first"`` (who is first where the paths cross, or ahead in a lane;
    ``"None"`` if the paths do not meet, or if ego and other entity collide), ``"ego first"``, ``"collision"``,
    ``"fault"`` (who is at fault), ``"stopped"``, and ``"first of Ego and C"`` for each further entity C. ``"critical"``
    is added if the study has a threshold and its search was for no Pareto front. Facts that are the same for all
    scenarios are left out.
    """
    other = outcomes[0].encounter.entity
    firsts = [None if other in {hit.entity for hit in outcome.impacts} else outcome.first for outcome in outcomes]
    facts = {
        "outcome": [outcome.text for outcome in outcomes],
        "first": [str(first) for first in firsts],
        "ego first": [str(first == study.meta.ego) for first in firsts],
        "collision": [str(outcome.collision) for outcome in outcomes],
        "fault": [str(outcome.fault and outcome.fault.who) for outcome in outcomes],
        "stopped": [str(outcome.stops) for outcome in outcomes],
    }
    for name in dict.fromkeys(encounter.entity for outcome in outcomes for encounter in outcome.others):
        firsts = [{encounter.entity: encounter.first for encounter in outcome.others}.get(name) for outcome in outcomes]
        facts[f"first of {quote_name(study.meta.ego)} and {quote_name(name)}"] = [str(first) for first in firsts]
    if study.critical is not None and not study.meta.pareto:
        facts["critical"] = [str(is_critical) for is_critical in study.critical_mask().tolist()]
    return {name: values for name, values in facts.items() if len(set(values)) > 1}


def mutual_information_with_facts(labels: IntArray, facts: Mapping[str, Sequence[str]]) -> dict[str, float]:
    """Return the adjusted mutual information (Vinh et al. 2010) of cluster labels with each fact.

    The value is 1 if clusters and fact are the same, about 0 if they are independent. Noise counts as a cluster.
    """
    from sklearn.metrics import adjusted_mutual_info_score

    return {name: float(adjusted_mutual_info_score(list(values), labels)) for name, values in facts.items()}


def mutual_information_with_critical(study: StudyFile, ids: IntArray, labels: IntArray) -> dict[str, float]:
    """Return ``{"critical": information}``: the adjusted mutual information of labels and of being critical.

    The dictionary is empty if all scenarios are critical, or if none is.
    """
    is_critical = dict(
        zip(
            (row.id for row in study.finished_rows()),
            study.critical_mask(),
            strict=True,
        )
    )
    critical = [str(bool(is_critical[scenario])) for scenario in ids.tolist()]
    return mutual_information_with_facts(labels, {"critical": critical}) if len(set(critical)) > 1 else {}
