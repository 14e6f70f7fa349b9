"""Phrases and number formats shared by the report page, its figures and ``cornercase show``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from cornercase._common.plugin_errors import group_failure_messages
from cornercase._common.text.sanitize import docstring_summary
from cornercase.clustering import ASPECTS, Analysis, Profile
from cornercase.clustering._headline_aspect import SOME_INFORMATION
from cornercase.evidence._sensitivity import Sensitivity
from cornercase.metrics import METRICS
from cornercase.metrics._critical_if import find_critical_if_condition
from cornercase.report._summary import Summary
from cornercase.scenario import Parameter, Value
from cornercase.study import ScenarioRecord, StudyMeta
from cornercase.study._criterion import Criterion

NOISE_NAME: Final = "noise"
_MAX_LISTED: Final = 12
# Smaller percentages are written as "below".
_SMALLEST_PERCENT: Final = 0.01
_METHOD_NAMES: Final = {"dbscan": "DBSCAN", "hdbscan": "HDBSCAN"}

# Adjusted mutual information from which clusters say a little, and much, about how scenarios end.
_LITTLE_INFORMATION, _MUCH_INFORMATION = 0.1, 0.8


def format_cluster_name(cluster: int, by: str = "cluster") -> str:
    """Return the name of a cluster number: ``"cluster 0"``, with an aspect ``"bearing 0"``, or ``"noise"`` for -1."""
    return NOISE_NAME if cluster < 0 else f"{by} {cluster}"


def format_cluster_title(profile: Profile, by: str) -> str:
    """Return aspect, number, name and collisions of a cluster: ``"bearing 0: Ego yields to C; 3 of 120 collide"``."""
    return ": ".join(filter(None, (format_cluster_name(profile.cluster, by), profile.label)))


def describe_warm_start(meta: StudyMeta) -> str:
    """Describe, as part of a sentence, the earlier study whose results the search began with."""
    source = meta.elsewhere
    return f"{source.get('scenarios', 'some')} scenarios of {source['study']} (simulator {source['simulator']})"


def describe_unmeasured_collisions(summary: Summary, *, counts: bool = True) -> str:
    """Describe collisions of the ego with unmeasured entities; empty if there are no such collisions.

    An entity is unmeasured if no metric measures the ego against the entity.
    """
    touched = [f"{name} in {count}" if counts else name for name, count in summary.unmeasured_collisions.items()]
    if not touched:
        return ""
    others = " and ".join(filter(None, (", ".join(touched[:-1]), touched[-1])))
    of_how_many = f" of {summary.n_run} scenarios" if counts else ""
    return (
        f"{summary.meta.ego} touches {others}{of_how_many}, and is not measured against"
        f" {'it' if len(touched) == 1 else 'them'}: repeat --other."
    )


def describe_dangers(n_selected: int, n_critical: int | None, n_colliding: int, ego: str) -> str:
    """Describe how many selected scenarios are critical, and in how many the ego collides.

    `n_critical` is None if there is no threshold.
    """
    if n_selected == 1:
        collides = f"{ego} collides in it" if n_colliding else f"{ego} does not collide in it"
        is_critical = "" if n_critical is None else f"It is {'' if n_critical else 'not '}critical, and "
        return f"{is_critical}{collides}."
    collides = f"in {n_colliding or 'none'} {ego} collides"
    if n_critical is None:
        return f"{collides[:1].upper()}{collides[1:]}."
    verb = "are" if n_critical > 1 else "is"
    them = "All of them" if 0 < n_critical == n_selected else f"{n_critical or 'None'} of them"
    return f"{them} {verb} critical and {collides}."


def describe_aspect(aspect: str) -> str:
    """Describe by what an aspect compares scenarios; empty if the aspect is unknown.

    Examples are ``"speed of the ego in m/s, regardless of the position"`` and ``"the course of wttc"``.
    """
    if aspect not in ASPECTS:
        return f"the course of {aspect}" if aspect.partition(":")[0] in METRICS else ""
    summary = docstring_summary(ASPECTS.create(aspect)).partition(":")[0].rstrip(".")
    return summary[:1].lower() + summary[1:]


def describe_informativeness(analysis: Analysis) -> str:
    """Describe how much the clusters say about how scenarios end; empty for studies of early versions."""
    by, clustering = analysis.by, analysis.clustering
    if clustering.n_clusters < 2:
        noise = int((clustering.labels < 0).sum())
        outside = f", except {noise} of noise" if noise and clustering.n_clusters else ""
        uniform = "all scenarios are one group" if clustering.n_clusters else "all scenarios are noise"
        return f"No separate kinds: by {by} {uniform}{outside}."
    if not any(profile.name for profile in analysis.profiles):
        return ""
    if not analysis.fact_agreement:
        return f"All scenarios end in the same way; the kinds by {by} distinguish how they get there."
    levels = (("much", _MUCH_INFORMATION, math.inf), ("something", SOME_INFORMATION, _MUCH_INFORMATION))
    parts = []
    for amount, low, high in levels:
        facts = [f"{fact} ({mutual:.2f})" for fact, mutual in analysis.fact_agreement.items() if low <= mutual < high]
        if facts:
            parts.append(f"{amount} about {', '.join(facts)}")
    if parts:
        return f"The kinds by {by} say {', and '.join(parts)}."
    highest = max(analysis.fact_agreement.values())
    if highest < _LITTLE_INFORMATION:
        amount, highest = "nothing", max(highest, 0.0)
    else:
        amount = "little"
    return f"The kinds by {by} say {amount} about how scenarios end (mutual information of at most {highest:.2f})."


def format_assign_command(analysis: Analysis) -> str:
    """Return the command that assigns new scenarios to existing clusters."""
    return f"cornercase analyze STUDY.db --by {analysis.by} --keep-clusters"


def format_explore_settings_command(analysis: Analysis) -> str:
    """Return the command that writes a page on how the settings of the clustering change its result."""
    return f"cornercase analyze STUDY.db --by {analysis.by} --explore-settings settings.html"


def format_criterion(criterion: Criterion, objective: str) -> str:
    """Return the condition for being critical as users type it: ``"wttc <= 1 s"``."""
    if condition := find_critical_if_condition([objective]):
        return condition
    return f"{objective} {criterion}"


def format_criterion_with_signs(criterion: Criterion, objective: str) -> str:
    """Return the condition for being critical with mathematical signs: ``"wttc ≤ 1 s"``."""
    return use_math_signs(format_criterion(criterion, objective))


def describe_threshold_override(summary: Summary) -> str:
    """Describe that the threshold in use is not the study's own; empty if both are the same."""
    critical, own = summary.estimates.critical, summary.meta.critical
    if critical is None or critical.threshold == own:
        return ""
    if own is None:
        return "This threshold was chosen afterwards: the study has none of its own."
    criterion = format_criterion_with_signs(replace(critical.criterion, threshold=own), summary.objective)
    return f"This threshold was chosen afterwards: the study's own is {criterion}."


def describe_selection_threshold(summary: Summary) -> str:
    """Describe with which threshold the reduced set was selected; empty if it is the current threshold."""
    critical, reduced = summary.estimates.critical, summary.reduced_set
    if critical is None or reduced is None or reduced.threshold == critical.threshold:
        return ""
    how = "without any threshold"
    if reduced.threshold is not None:
        criterion = replace(critical.criterion, threshold=reduced.threshold)
        how = f"by {format_criterion_with_signs(criterion, summary.objective)}"
    return f"They were chosen {how}; 'cornercase reduce' with --critical {critical.threshold:g} chooses again."


def use_math_signs(criterion: str) -> str:
    """Replace ``<=`` and ``>=`` by ``≤`` and ``≥``."""
    return criterion.replace("<=", "≤").replace(">=", "≥")


def join_with_and(words: list[str]) -> str:
    """Join words: ``"a, b and c"``."""
    return " and ".join(filter(None, (", ".join(words[:-1]), words[-1]))) if words else ""


def describe_little_influence(sensitivity: Sensitivity, on: str = "") -> str:
    """Return a sentence that names the parameters of little influence; empty if there are none.

    `on` is the end of the sentence, such as ``" on that variance"``.
    """
    # Tied parameters have one joint name.
    names = [name for joint in sensitivity.uninfluential_parameters for name in joint.split(", ")]
    if not names:
        return ""
    return f" {join_with_and(names)} {'has' if len(names) == 1 else 'have'} little influence{on}."


def format_range(parameter: Parameter) -> str:
    """Return the range of a parameter, such as ``"20 to 80 m"``, or its choices."""
    if parameter.choices:
        return ", ".join(parameter.choices)
    low = high = ""
    # Large coordinates may differ only in their last digits.
    for digits in (6, 9, 12, 17):
        low, high = f"{parameter.low:.{digits}g}", f"{parameter.high:.{digits}g}"
        if low != high or parameter.low == parameter.high:
            break
    return f"{low} to {high} {parameter.unit}".strip()


def format_axis_label(parameter: Parameter) -> str:
    """Return the name of a parameter with its unit, such as ``"ego_start [m]"``."""
    return f"{parameter.name} [{parameter.unit}]" if parameter.unit else parameter.name


def describe_clustering_method(analysis: Analysis) -> str:
    """Describe the method and settings that found the clusters."""
    clustering = analysis.clustering
    text = (
        f"Dynamic Time Warping, RBF kernel PCA (gamma {clustering.gamma:.4g}, {100 * clustering.explained:.0f} % of the"
        f" variance in {clustering.embedding.shape[1]} components), {_METHOD_NAMES[clustering.method]}"
        f" (eps {clustering.eps:.4g}, min samples {clustering.min_samples})."
    )
    if len(clustering.landmarks):
        text += (
            f" The kernel space is that of {len(clustering.landmarks)} landmarks, which loses"
            f" {clustering.error:.1%} of the kernel between the other scenarios."
        )
    if analysis.embedding_error is not None:
        stride = f", at one of {analysis.stride} instants" if analysis.stride > 1 else ""
        text += (
            f" All scenarios were compared with landmarks{stride}. Other distances follow from that, with an error"
            f" of {analysis.embedding_error:.1%} on average."
        )
    fitted, assigned = len(analysis.fitted_ids), len(analysis.ids) - len(analysis.fitted_ids)
    if assigned > 0:
        text += f" Found among {fitted} scenarios; {assigned} have joined since."
    return text


def format_value(value: Value, digits: int = 6) -> str:
    """Format a parameter value with at most `digits` significant digits; a choice stays as it is."""
    return value if isinstance(value, str) else f"{value:.{digits}g}"


def append_unit(number: str, unit: str) -> str:
    """Append a unit to a number, as ``"0.2 s"``; nothing is appended if the unit is empty or ``"1"`` (no dimension)."""
    return number if unit in ("", "1") else f"{number} {unit}"


def format_percent(share: float) -> str:
    """Format a fraction (0 to 1) in percent with two significant digits: ``"0.34 %"``, ``"12 %"``.

    Values below 1 are never rounded to 100 %; tiny values become ``"below 0.01 %"``.
    """
    value = 100.0 * share
    if 0.0 < value < _SMALLEST_PERCENT:
        return f"below {_SMALLEST_PERCENT} %"
    if 99.5 <= value < 100.0:
        return "over 99 %"
    return f"{value:.0f} %" if value >= 9.95 or value == 0.0 else f"{value:.2g} %"


def format_scenario_ids(ids: Sequence[int]) -> str:
    """Format the first twelve scenario ids of a list; an ellipsis stands for the rest."""
    return ", ".join(map(str, ids[:_MAX_LISTED])) + (" …" if len(ids) > _MAX_LISTED else "")


def group_failures_by_reason(failed: Sequence[ScenarioRecord]) -> dict[str, list[int]]:
    """Group ids of failed scenarios by reason, the most frequent reason first."""
    groups = group_failure_messages(row.error or "" for row in failed)
    return {reason: [failed[k].id for k in members] for reason, members in groups.items()}


def describe_front(n_scenarios: int) -> str:
    """Describe a Pareto front with `n_scenarios` scenarios."""
    if n_scenarios == 1:
        return "One scenario is as critical as any other in every metric."
    return f"{n_scenarios} scenarios: no other is at least as critical in every metric and more critical in one."


def describe_too_few_scores() -> str:
    """Explain that there are too few scores for estimates."""
    return "There are too few different scores to say anything about all other scenarios."


def describe_missing_sensitivity() -> str:
    """Explain that the model predicts too poorly to estimate sensitivities."""
    return "The model predicts almost nothing of the scores, so it is unknown which parameter matters."
