"""Phrases that the report and its figures share."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from cornercase._common.parts import group_reasons
from cornercase._common.texts import first_line
from cornercase.clustering import ASPECTS, Analysis, Profile
from cornercase.metrics import METRICS, condition_of
from cornercase.report.knowledge import CriticalKnowledge
from cornercase.report.summary import Summary
from cornercase.scenario import Parameter, Value
from cornercase.study import Row, StudyMeta

NOISE_NAME: Final = "noise"
_MOST_NAMED: Final = 12
# Percent below which a share is told as less than that.
_SMALLEST: Final = 0.01
_METHODS: Final = {"dbscan": "DBSCAN", "hdbscan": "HDBSCAN"}

# Adjusted mutual information from which clusters say a little, something, and most of what happened.
_SAYS_NOTHING, _SAYS_SOMETHING, _SAYS_MOST = 0.1, 0.4, 0.8


def name_cluster(cluster: int) -> str:
    """Name a cluster for people.

    Parameters
    ----------
    cluster : int
        -1 is noise.

    Returns
    -------
    str
        ``"cluster 0"`` or ``"noise"``.
    """
    return NOISE_NAME if cluster < 0 else f"cluster {cluster}"


def name_kind(profile: Profile) -> str:
    """Name a cluster by what its scenarios have in common.

    Parameters
    ----------
    profile : Profile
        Of the cluster.

    Returns
    -------
    str
        ``"cluster 0: Ego yields to Pedestrian; 3 of 120 collide"``; without a name as `name_cluster`.
    """
    return ": ".join(filter(None, (name_cluster(profile.cluster), profile.label)))


def tell_roles(meta: StudyMeta) -> str:
    """Say who is the ego, and whom it is measured against.

    Parameters
    ----------
    meta : StudyMeta
        What the study is about.

    Returns
    -------
    str
        A sentence.
    """
    others = meta.others
    if len(others) == 1:
        return f"Under test: {meta.ego}, against {others[0]}."
    return f"Under test: {meta.ego}, against {', '.join(others[:-1])} and {others[-1]}; the most critical counts."


def tell_beginning(meta: StudyMeta) -> str:
    """Say what a search began from.

    Parameters
    ----------
    meta : StudyMeta
        Of a study whose search began from another one.

    Returns
    -------
    str
        A part of a sentence.
    """
    known = meta.elsewhere
    return f"{known.get('scenarios', 'some')} scenarios of {known['study']} (simulator {known['simulator']})"


def tell_beside(summary: Summary, *, counts: bool = True) -> str:
    """Say in how many scenarios the ego touches somebody whom it is not measured against.

    Parameters
    ----------
    summary : Summary
        Of the study.
    counts : bool, default True
        Say in how many.

    Returns
    -------
    str
        A sentence; empty where there is none.
    """
    touched = [f"{name} in {count}" if counts else name for name, count in summary.beside.items()]
    if not touched:
        return ""
    whom = " and ".join(filter(None, (", ".join(touched[:-1]), touched[-1])))
    of_how_many = f" of {summary.run} scenarios" if counts else ""
    return (
        f"{summary.meta.ego} touches {whom}{of_how_many}, and is not measured against"
        f" {'it' if len(touched) == 1 else 'them'}: repeat --other."
    )


def tell_compared(by: str) -> str:
    """Say what of two scenarios an aspect compares.

    Parameters
    ----------
    by : str
        Name of the aspect.

    Returns
    -------
    str
        ``"the direction in which the ego sees the other"``; empty for an aspect that is not known here.
    """
    if by not in ASPECTS:
        return f"the course of {by}" if by.partition(":")[0] in METRICS else ""
    said = first_line(ASPECTS.create(by)).partition(":")[0].rstrip(".")
    return said[:1].lower() + said[1:]


def judge_clusters(analysis: Analysis) -> str:
    """Say whether clusters are kinds that tell something of what happened.

    Parameters
    ----------
    analysis : Analysis
        The clusters, and how they agree with what happened.

    Returns
    -------
    str
        A sentence; empty where a study of an early version does not know.
    """
    by, found = analysis.by, analysis.clustering
    if found.n_clusters < 2:
        noise = int((found.labels < 0).sum())
        outside = f", except {noise} of noise" if noise and found.n_clusters else ""
        alike = "all scenarios are one group" if found.n_clusters else "all scenarios are noise"
        return f"No separate kinds: by {by} {alike}{outside}."
    if not any(one.name for one in analysis.profiles):
        return ""
    if not analysis.tells:
        return f"All scenarios end in the same way; the kinds by {by} distinguish how they get there."
    levels = (("much", _SAYS_MOST, math.inf), ("something", _SAYS_SOMETHING, _SAYS_MOST))
    said = []
    for much, low, high in levels:
        facts = [f"{fact} ({mutual:.2f})" for fact, mutual in analysis.tells.items() if low <= mutual < high]
        if facts:
            said.append(f"{much} about {', '.join(facts)}")
    if said:
        return f"The kinds by {by} say {', and '.join(said)}."
    best = max(analysis.tells.values())
    if best < _SAYS_NOTHING:
        much, best = "nothing", max(best, 0.0)
    else:
        much = "little"
    return f"The kinds by {by} say {much} about how scenarios end (mutual information of at most {best:.2f})."


def name_joining(analysis: Analysis) -> str:
    """Name the command by which scenarios that were run since join the clusters.

    Parameters
    ----------
    analysis : Analysis
        The clusters.

    Returns
    -------
    str
        ``"cornercase analyze STUDY.db --by wttc --keep-clusters"``.
    """
    return f"cornercase analyze STUDY.db --by {analysis.by} --keep-clusters"


def name_criterion(known: CriticalKnowledge, searched: str) -> str:
    """Say when a scenario is critical.

    Parameters
    ----------
    known : CriticalKnowledge
        What is known of the critical scenarios.
    searched : str
        What is searched.

    Returns
    -------
    str
        ``"wttc <= 1 s"``; a condition as it was given.
    """
    if condition := condition_of([searched]):
        return condition
    return f"{searched} {'<=' if known.lower_is_critical else '>='} {known.threshold:g} {known.unit}".rstrip()


def tell_criterion(known: CriticalKnowledge, searched: str) -> str:
    """Say in a sentence when a scenario is critical.

    Parameters
    ----------
    known : CriticalKnowledge
        What is known of the critical scenarios.
    searched : str
        What is searched.

    Returns
    -------
    str
        ``"wttc ≤ 1 s"``.
    """
    return with_signs(name_criterion(known, searched))


def tell_asked(summary: Summary) -> str:
    """Say that what is critical was asked of a study afterwards, by another threshold than it was searched with.

    Parameters
    ----------
    summary : Summary
        The summary.

    Returns
    -------
    str
        A sentence; empty where the study's own threshold holds.
    """
    known, own = summary.knowledge.critical, summary.meta.critical
    if known is None or known.threshold == own:
        return ""
    if own is None:
        return "This threshold was chosen afterwards: the study has none of its own."
    searched = tell_criterion(replace(known, threshold=own), summary.searched)
    return f"This threshold was chosen afterwards: the study's own is {searched}."


def tell_chosen(summary: Summary) -> str:
    """Say that the kept scenarios were chosen by another threshold than the one that is asked.

    Parameters
    ----------
    summary : Summary
        The summary.

    Returns
    -------
    str
        A sentence; empty where it is the same, or nothing was reduced.
    """
    known, reduced = summary.knowledge.critical, summary.reduced
    if known is None or reduced is None or reduced.threshold == known.threshold:
        return ""
    by = "without any threshold"
    if reduced.threshold is not None:
        by = f"by {tell_criterion(replace(known, threshold=reduced.threshold), summary.searched)}"
    return f"They were chosen {by}; 'cornercase reduce' with --critical {known.threshold:g} chooses again."


def with_signs(criterion: str) -> str:
    """Write a criterion with the signs that it has in print.

    Parameters
    ----------
    criterion : str
        As it is typed.

    Returns
    -------
    str
        ``"wttc ≤ 1 s"``.
    """
    return criterion.replace("<=", "≤").replace(">=", "≥")


def name_range(parameter: Parameter) -> str:
    """Say between which values a parameter varies.

    Parameters
    ----------
    parameter : Parameter
        The parameter.

    Returns
    -------
    str
        ``"20 to 80 m"``, or the choices.
    """
    if parameter.choices:
        return ", ".join(parameter.choices)
    low = high = ""
    # Coordinates may differ in the last of many digits only.
    for digits in (6, 9, 12, 17):
        low, high = f"{parameter.low:.{digits}g}", f"{parameter.high:.{digits}g}"
        if low != high or parameter.low == parameter.high:
            break
    return f"{low} to {high} {parameter.unit}".strip()


def name_axis(parameter: Parameter) -> str:
    """Name a parameter, with the unit where it is known.

    Parameters
    ----------
    parameter : Parameter
        The parameter.

    Returns
    -------
    str
        ``"ego_start [m]"``.
    """
    return f"{parameter.name} [{parameter.unit}]" if parameter.unit else parameter.name


def tell_how_found(analysis: Analysis) -> str:
    """Say by what the clusters of an analysis were found.

    Parameters
    ----------
    analysis : Analysis
        The clusters.

    Returns
    -------
    str
        Sentences.
    """
    found = analysis.clustering
    text = (
        f"Dynamic Time Warping, RBF kernel PCA (gamma {found.gamma:.4g}, {100 * found.explained:.0f} % of the variance"
        f" in {found.embedding.shape[1]} components), {_METHODS[found.method]} (eps {found.eps:.4g}, min samples"
        f" {found.min_samples})."
    )
    if len(found.landmarks):
        text += (
            f" The kernel space is that of {len(found.landmarks)} landmarks, which loses"
            f" {found.error:.1%} of the kernel between the other scenarios."
        )
    if analysis.inexact is not None:
        every = f", at one of {analysis.every} instants" if analysis.every > 1 else ""
        text += (
            f" All scenarios were compared with the landmarks{every}. Other distances follow from that, with an error"
            f" of {analysis.inexact:.1%} on average."
        )
    fitted, joined = len(analysis.fitted), len(analysis.ids) - len(analysis.fitted)
    if joined > 0:
        text += f" Found among {fitted} scenarios; {joined} have joined since."
    return text


def format_value(value: Value, digits: int = 6) -> str:
    """Write the value of a parameter.

    Parameters
    ----------
    value : float or str
        The value.
    digits : int, default 6
        Most digits of a number.

    Returns
    -------
    str
        A choice as it is called.
    """
    return value if isinstance(value, str) else f"{value:.{digits}g}"


def with_unit(number: str, unit: str) -> str:
    """Write a unit behind a number.

    Parameters
    ----------
    number : str
        As it is written.
    unit : str
        Empty or ``"1"`` for none.

    Returns
    -------
    str
        ``"0.2 s"``.
    """
    return number if unit in ("", "1") else f"{number} {unit}"


def percent(share: float) -> str:
    """Write a share in percent.

    Parameters
    ----------
    share : float
        From 0 to 1.

    Returns
    -------
    str
        Two digits that count, or all before the point: ``"0.34 %"``, ``"12 %"``; nearly all is not written as all,
        nor hardly anything in powers of ten.
    """
    value = 100.0 * share
    if 0.0 < value < _SMALLEST:
        return f"below {_SMALLEST} %"
    if 99.5 <= value < 100.0:
        return "over 99 %"
    return f"{value:.0f} %" if value >= 9.95 or value == 0.0 else f"{value:.2g} %"


def list_scenarios(ids: Sequence[int]) -> str:
    """List the ids of scenarios.

    Parameters
    ----------
    ids : sequence of int
        In any number.

    Returns
    -------
    str
        Twelve of them at most.
    """
    return ", ".join(map(str, ids[:_MOST_NAMED])) + (" …" if len(ids) > _MOST_NAMED else "")


def find_reasons(failed: Sequence[Row]) -> dict[str, list[int]]:
    """Find for what reasons scenarios could not be run.

    Parameters
    ----------
    failed : sequence of Row
        Scenarios that could not be run.

    Returns
    -------
    dict of str to list of int
        Ids by reason, the most frequent one first.
    """
    groups = group_reasons(row.error or "" for row in failed)
    return {reason: [failed[k].id for k in members] for reason, members in groups.items()}


def tell_front(count: int) -> str:
    """Say what a Pareto front is.

    Parameters
    ----------
    count : int
        Number of scenarios on it.

    Returns
    -------
    str
        A sentence.
    """
    if count == 1:
        return "One scenario is as critical as any other in every metric."
    return f"{count} scenarios: no other is at least as critical in every metric and more critical in one."


def tell_unknown() -> str:
    """Say that nothing is known of scenarios that were not run."""
    return "There are too few different scores to say anything about all other scenarios."


def tell_unforetold() -> str:
    """Say that nothing is known of the influence of parameters."""
    return "The model predicts almost nothing of the scores, so it is unknown which parameter matters."
