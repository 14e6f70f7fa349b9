"""Conversion of the summary of a study to nested dictionaries of plain values, as ``cornercase show`` prints it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, Final

from cornercase.clustering import Analysis, Profile, Rule
from cornercase.clustering.naming._rules import EVERYWHERE_TEXT
from cornercase.drivers._serialization import format_driver
from cornercase.evidence import Estimate, Sensitivity
from cornercase.evidence._criticality_bands import Bands
from cornercase.reduction import (
    ClusterShape,
    Coverage,
    CriticalCoverage,
    HeldOutCoverage,
    HeldOutCriticalCoverage,
    ReducedSet,
)
from cornercase.report._collision_reactions import CollisionReactionCounts
from cornercase.report._summary import FailureSummary, MetricSummary, Summary
from cornercase.report.text._phrases import (
    describe_informativeness,
    describe_missing_sensitivity,
    describe_selection_threshold,
    describe_threshold_override,
    describe_too_few_scores,
    describe_unmeasured_collisions,
    describe_warm_start,
    format_assign_command,
    format_criterion,
    format_range,
)
from cornercase.study import StudyMeta

NAME_LEVELS_BELOW_KEY: Final = {
    "parameters": 1, "metrics": 1, "at": 1, "clusters": 1, "collisions_not_measured_against": 1, "scenarios_against": 1,
    "mutual_information_with": 1, "outcomes": 1, "median": 1, "front": 2, "agreement": 1, "references": 1,
    "coverage": 1, "drivers": 1, "failures": 1, "bands": 1, "avoided_by_braking_earlier": 1,
}  # fmt: skip
"""Number of dictionary levels below each of these keys that have names (of metrics, parameters, …) as their keys."""
# Words for keys that differ from the key in more than the underscores.
_WORDS_BY_KEY: Final = {
    "largest_one_of_k_medoids": "largest one of k-medoids",
    "mean_of_k_medoids": "mean of k-medoids",
    "on_the_boundary_like_a_kept_one": "on the boundary, like a kept one",
    "like_one_of_k_medoids": "like one of k-medoids",
    "runs_of_each_at_most": "runs of each, at most",
    "spread_of_the_runs_median": "spread of the runs, median",
    "spread_of_the_runs_largest": "spread of the runs, largest",
    "run_since_in_no_cluster_yet": "run since, in no cluster yet",
    "first_order_interval_90": "first order, 90 % interval",
    "total_interval_90": "total, 90 % interval",
    "interval_95": "95 % interval",
    "interval_90": "90 % interval",
    "plain_monte_carlo_would_need": "plain Monte Carlo would need",
}
_KEYS_BY_WORDS: Final = {words: key for key, words in _WORDS_BY_KEY.items()}
_COVERAGE_KEYS: Final = {
    "largest": "largest_distance_to_a_kept_one",
    "mean": "mean_distance",
    "held_out": "held_out",
}
_HELD_OUT_KEYS: Final = {
    "scenarios": "scenarios",
    "largest": "largest_distance_to_a_kept_one",
    "mean": "mean_distance",
    "better_largest": "random_subsets_with_a_larger_largest_one",
    "better_mean": "random_subsets_with_a_larger_mean",
    "medoids_largest": "largest_one_of_k_medoids",
    "medoids_mean": "mean_of_k_medoids",
}
_CRITICAL_KEYS: Final = {
    "within": "alike_up_to_a_distance_of",
    "critical": "like_a_kept_one",
    "boundary": "on_the_boundary_like_a_kept_one",
    "held_out": "held_out",
    "unlike": "one_of_the_space_is_unlike_all_kept",
}
_HELD_OUT_CRITICAL_KEYS: Final = {
    "scenarios": "critical_scenarios",
    "critical": "like_a_kept_one",
    "random": "like_one_of_a_random_subset",
    "medoids": "like_one_of_k_medoids",
    "boundary": "on_the_boundary_like_a_kept_one",
}


def summary_to_dict(summary: Summary) -> dict[str, Any]:
    """Return a summary as plain values with identifiers as keys, as ``cornercase show --json`` prints it."""
    meta = summary.meta
    plain: dict[str, Any] = {
        "scenario": meta.scenario,
        "ego": meta.ego,
        "other": meta.other if isinstance(meta.other, str) else list(meta.other),
        "optimizer": meta.optimizer,
        "seed": meta.seed,
        "simulator": meta.simulator,
        **({"drivers": {name: format_driver(driver) for name, driver in meta.drivers.items()}} if meta.drivers else {}),
        "parameters": {parameter.name: format_range(parameter) for parameter in meta.space.parameters},
        "run": summary.n_run,
        "failed": summary.n_failed,
        "pending": summary.n_pending,
        **(
            {"failures": {why: _failure_to_dict(failure) for why, failure in summary.failures.items()}}
            if summary.failures
            else {}
        ),
        "collisions": summary.n_collisions,
        **({"fault": dict(summary.faults)} if summary.faults else {}),
        **_unmeasured_collisions_to_dict(summary),
        **({} if summary.replies is None else {"replies": _replies_to_dict(summary.replies)}),
        "metrics": {name: _metric_to_dict(metric, meta) for name, metric in summary.metrics.items()},
        **({"bands": {name: _bands_to_dict(bands) for name, bands in summary.bands.items()}} if summary.bands else {}),
        "clusters": {name: _clusters_to_dict(analysis, summary.n_run) for name, analysis in summary.analyses.items()},
        "seconds": {stage: round(seconds, 2) for stage, seconds in summary.seconds_by_stage.items()},
        "searched": summary.objective,
        **({"runs_differ": meta.nondeterminism_text} if meta.nondeterminism_text else {}),
        **({"began_from": describe_warm_start(meta)} if meta.elsewhere else {}),
        **({"rounds": "none: each scenario was proposed as soon as one had ended"} if meta.asynchronous else {}),
    }
    plain |= _estimates_to_dict(summary)
    plain["agreement"] = {
        f"{aspect} and {other}": {
            "adjusted_rand": agreement.adjusted_rand,
            "adjusted_mutual_information": agreement.mutual_information,
            "scenarios_that_differ": len(agreement.differing),
        }
        for (aspect, other), agreement in summary.agreements.items()
    }
    if summary.references:
        plain["references"] = {
            name: {
                "prevents": count.n_prevented,
                "does_not_prevent": count.n_colliding,
                "says_nothing_of": count.n_not_applicable,
            }
            for name, count in summary.references.items()
        }
    if summary.probability is not None:
        plain["probability"] = replace_words_by_keys(summary.probability)
    return plain | (_reduced_set_to_dict(summary, summary.reduced_set) if summary.reduced_set is not None else {})


def replace_words_by_keys(stored: Mapping[str, Any]) -> dict[str, Any]:
    """Return a stored estimate with its keys as identifiers: ``interval_95`` instead of ``95 % interval``."""
    return {
        _KEYS_BY_WORDS.get(words, words.replace(" ", "_")): replace_words_by_keys(value)
        if isinstance(value, dict)
        else value
        for words, value in stored.items()
    }


def replace_keys_by_words(values: Mapping[str, Any], name_levels: int = 0) -> dict[str, Any]:
    """Replace keys that are identifiers by words: ``most_critical`` by ``most critical``.

    Keys in the first `name_levels` levels are names, for example of metrics, and stay.
    """
    renamed = {}
    for key, value in values.items():
        below = name_levels - 1 if name_levels else NAME_LEVELS_BELOW_KEY.get(key, 0)
        words = key if name_levels else _WORDS_BY_KEY.get(key, key.replace("_", " "))
        renamed[words] = replace_keys_by_words(value, below) if isinstance(value, dict) else value
    return renamed


def _replies_to_dict(replies: CollisionReactionCounts) -> dict[str, Any]:
    return {
        "collisions": replies.n_measured,
        "without_braking": replies.n_without_braking,
        "braking_until_contact": replies.n_braking,
        "driving_on": replies.n_driving_on,
        "median_reaction": replies.median_reaction,
        "seen_too_late": replies.n_seen_too_late,
        "avoided_by_braking_earlier": {f"{time:g} s": count for time, count in replies.n_avoided_earlier.items()},
        "avoided_by_full_braking": replies.n_avoided_by_full_braking,
        "avoided_by_waiting": replies.n_avoided_by_waiting,
    }


def _failure_to_dict(failure: FailureSummary) -> dict[str, Any]:
    return {"scenarios": failure.n_scenarios, "first": failure.first_id, "at": dict(failure.parameters)}


def _unmeasured_collisions_to_dict(summary: Summary) -> dict[str, Any]:
    if not summary.unmeasured_collisions:
        return {}
    return {
        "collisions_not_measured_against": dict(summary.unmeasured_collisions),
        "note": describe_unmeasured_collisions(summary),
    }


def _metric_to_dict(metric: MetricSummary, meta: StudyMeta) -> dict[str, Any]:
    plain: dict[str, Any] = {
        "unit": metric.unit,
        "critical_is": "low" if metric.lower_is_critical else "high",
        "most_critical": metric.most_critical,
        "median": metric.median,
        "at": dict(metric.parameters),
    }
    if metric.scores_per_other:
        plain |= {"against": metric.most_critical_other, "scenarios_against": dict(metric.scores_per_other)}
    if metric.repeat_spread is not None:
        plain |= {
            "runs_of_each": meta.repeats,
            **({} if meta.most_repeats is None else {"runs_of_each_at_most": meta.most_repeats}),
            "spread_of_the_runs_median": metric.repeat_spread[0],
            "spread_of_the_runs_largest": metric.repeat_spread[1],
        }
    if metric.constant_note:
        plain["note"] = metric.constant_note
    return plain


def _bands_to_dict(bands: Bands) -> dict[str, Any]:
    sizes = zip(bands.names, bands.sizes, strict=True)
    return {
        "by": bands.method,
        **{name: {"scores": bands.describe_range(band), "scenarios": size} for band, (name, size) in enumerate(sizes)},
        "explained_variance": bands.explained,
    }


def _clusters_to_dict(analysis: Analysis, n_run: int) -> dict[str, Any]:
    plain: dict[str, Any] = {
        "sizes": analysis.sizes,
        "noise": int((analysis.labels < 0).sum()),
        "stability": analysis.clustering.stability,
    }
    if n_unassigned := n_run - len(analysis.ids):
        plain |= {"run_since_in_no_cluster_yet": n_unassigned, "they_join_with": format_assign_command(analysis)}
    if information := describe_informativeness(analysis):
        plain["in_words"] = information
    if analysis.fact_agreement:
        plain["mutual_information_with"] = dict(analysis.fact_agreement)
    return plain | {
        f"cluster_{profile.cluster}": _cluster_name_to_dict(profile)
        | {
            "scenarios": profile.size,
            "outcomes": profile.outcomes,
            "median": {metric: median for metric, (_, median, _) in profile.scores.items()},
            "where": [_format_rule(rule) for rule in profile.rules],
        }
        for profile in analysis.profiles
        if profile.cluster >= 0
    }


def _format_rule(rule: Rule) -> str:
    # A rule "everywhere" is not evaluated; studies of version 2 have no held-out figures.
    if math.isnan(rule.covers) or rule.text == EVERYWHERE_TEXT:
        return rule.text
    return f"{rule.text} (held out: {rule.covers:.0%} of it, {rule.purity:.0%} pure)"


def _cluster_name_to_dict(profile: Profile) -> dict[str, Any]:
    if not profile.name:
        return {}
    return {
        "name": profile.name,
        "true_of": profile.true_of,
        "true_of_others": profile.true_elsewhere,
        "example": profile.example,
    }


def _estimates_to_dict(summary: Summary) -> dict[str, Any]:
    estimates, plain = summary.estimates, dict[str, Any]()
    if estimates.pareto_front is not None:
        plain["front"] = {f"scenario {scenario}": dict(scores) for scenario, scores in estimates.pareto_front.items()}
    if estimates.critical is not None:
        plain["critical"] = {
            "is": format_criterion(estimates.critical.criterion, summary.objective),
            **({"asked": override} if (override := describe_threshold_override(summary)) else {}),
            "scenarios": estimates.critical.n_critical,
        }
        if (critical_set := estimates.critical.critical_set) is not None:
            plain["critical"] |= {
                "share": _interval_to_dict(critical_set.critical_fraction, critical_set.interval_unavailable),
                "missed": _interval_to_dict(critical_set.missed_fraction, critical_set.missed_interval_unavailable),
                "hidden": critical_set.max_fraction_in_empty_region,
                "overlooked": {"value": critical_set.p_overlooked_region, "size": critical_set.region_fraction},
                "unvisited": {"value": critical_set.unexplored_fraction, "size": critical_set.region_fraction},
            }
        else:
            plain["critical"]["note"] = describe_too_few_scores()
        if (audit := estimates.critical.audits) is not None:
            plain["critical"]["audit"] = {
                "scenarios": audit.n_scenarios,
                "critical": audit.n_critical,
                "share": asdict(audit.critical_fraction),
                "missed": audit.missed_fraction and asdict(audit.missed_fraction),
            }
    if estimates.sensitivity is not None:
        plain["sensitivity"] = _sensitivity_to_dict(estimates.sensitivity)
    return plain


def _interval_to_dict(estimate: Estimate, reason_unavailable: str | None) -> dict[str, float | str | None]:
    return (
        asdict(estimate)
        if reason_unavailable is None
        else {"value": estimate.value, "low": None, "high": None, "since": reason_unavailable}
    )


def _sensitivity_to_dict(sensitivity: Sensitivity) -> dict[str, Any]:
    rows = zip(
        sensitivity.names,
        sensitivity.first,
        sensitivity.first_interval,
        sensitivity.total,
        sensitivity.total_interval,
        strict=True,
    )
    plain: dict[str, Any] = {
        "parameters": {
            name: {
                "first_order": first,
                "first_order_interval_90": list(firsts),
                "total": total,
                "total_interval_90": list(totals),
            }
            for name, first, firsts, total, totals in rows
        },
        "predicted_variance": sensitivity.predicted,
        "of_little_influence": list(sensitivity.uninfluential_parameters),
    }
    if not sensitivity.is_meaningful:
        plain["note"] = describe_missing_sensitivity()
    return plain


def _reduced_set_to_dict(summary: Summary, reduced: ReducedSet) -> dict[str, Any]:
    coverage = {name: _fields_to_dict(entry, _COVERAGE_KEYS) for name, entry in reduced.coverage.items()}
    for name, entry in reduced.critical.items():
        coverage.setdefault(name, {})["critical_scenarios"] = _fields_to_dict(entry, _CRITICAL_KEYS)
    return {
        "kept": len(reduced.scenarios),
        **({"chosen": chosen} if (chosen := describe_selection_threshold(summary)) else {}),
        "shapes": {f"cluster_{shape.cluster}": _shape_to_dict(shape) for shape in reduced.shapes},
        "coverage": coverage,
    }


def _shape_to_dict(shape: ClusterShape) -> dict[str, Any]:
    return {
        "convexity": shape.convexity,
        "convexity_in_kernel_space": shape.kernel_convexity,
        "archetypes_by": shape.method,
        "parts": shape.parts,
    }


def _fields_to_dict(
    values: Coverage | CriticalCoverage | HeldOutCoverage | HeldOutCriticalCoverage, key_by_field: Mapping[str, str]
) -> dict[str, Any]:
    """Return the fields of `values` that are neither None nor NaN, with keys from `key_by_field`."""
    plain: dict[str, Any] = {}
    for key, label in key_by_field.items():
        value = getattr(values, key)
        # Early versions did not measure all of them.
        if value is None or (isinstance(value, float) and math.isnan(value)):
            continue
        if isinstance(value, HeldOutCoverage | HeldOutCriticalCoverage):
            value = _fields_to_dict(
                value, _HELD_OUT_KEYS if isinstance(value, HeldOutCoverage) else _HELD_OUT_CRITICAL_KEYS
            )
        plain[label] = asdict(value) if isinstance(value, Estimate) else value
    return plain
