"""The summary of a study as plain values, under identifiers or words, as `show` prints it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, Final

from cornercase.clustering import EVERYWHERE, Analysis, Profile, Rule
from cornercase.drivers import driver_text
from cornercase.evidence import Estimate, Sensitivity
from cornercase.reduction import ClusterShape, Coverage, CriticalCoverage, HeldOut, HeldOutCritical, ReducedSet
from cornercase.report.summary import FailureSummary, MetricSummary, Summary
from cornercase.report.words import (
    judge_clusters,
    name_criterion,
    name_joining,
    name_range,
    tell_asked,
    tell_beginning,
    tell_beside,
    tell_chosen,
    tell_unforetold,
    tell_unknown,
)
from cornercase.study import StudyMeta

NAMED: Final = {
    "parameters": 1, "metrics": 1, "at": 1, "clusters": 1, "collisions_not_measured_against": 1, "scenarios_against": 1,
    "mutual_information_with": 1, "outcomes": 1, "median": 1, "front": 2, "agreement": 1, "references": 1,
    "coverage": 1, "drivers": 1, "failures": 1,
}  # fmt: skip
"""Number of levels below these keys whose keys are names of metrics, parameters or aspects."""
# Words of the keys in which more than the underscores differ.
_WORDS: Final = {
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
_IDENTIFIERS: Final = {words: key for key, words in _WORDS.items()}
_COVERAGE: Final = {
    "largest": "largest_distance_to_a_kept_one",
    "mean": "mean_distance",
    "held_out": "held_out",
}
_HELD_OUT: Final = {
    "scenarios": "scenarios",
    "largest": "largest_distance_to_a_kept_one",
    "mean": "mean_distance",
    "better_largest": "random_subsets_with_a_larger_largest_one",
    "better_mean": "random_subsets_with_a_larger_mean",
    "medoids_largest": "largest_one_of_k_medoids",
    "medoids_mean": "mean_of_k_medoids",
}
_CRITICAL: Final = {
    "within": "alike_up_to_a_distance_of",
    "critical": "like_a_kept_one",
    "boundary": "on_the_boundary_like_a_kept_one",
    "held_out": "held_out",
    "unlike": "one_of_the_space_is_unlike_all_kept",
}
_HELD_OUT_CRITICAL: Final = {
    "scenarios": "critical_scenarios",
    "critical": "like_a_kept_one",
    "random": "like_one_of_a_random_subset",
    "medoids": "like_one_of_k_medoids",
    "boundary": "on_the_boundary_like_a_kept_one",
}


def put_in_words(summary: Summary) -> dict[str, Any]:
    """Return a summary as plain values under identifiers, as ``cornercase show --json`` prints it."""
    meta = summary.meta
    plain: dict[str, Any] = {
        "scenario": meta.scenario,
        "ego": meta.ego,
        "other": meta.other if isinstance(meta.other, str) else list(meta.other),
        "optimizer": meta.optimizer,
        "seed": meta.seed,
        "simulator": meta.simulator,
        **({"drivers": {name: driver_text(driver) for name, driver in meta.drivers.items()}} if meta.drivers else {}),
        "parameters": {parameter.name: name_range(parameter) for parameter in meta.space.parameters},
        "run": summary.run,
        "failed": summary.failed,
        "pending": summary.pending,
        **(
            {"failures": {why: _failure(failure) for why, failure in summary.failures.items()}}
            if summary.failures
            else {}
        ),
        "collisions": summary.collisions,
        **_beside(summary),
        "metrics": {name: _metric(metric, meta) for name, metric in summary.metrics.items()},
        "clusters": {name: _clusters(analysis, summary.run) for name, analysis in summary.analyses.items()},
        "seconds": {stage: round(seconds, 2) for stage, seconds in summary.seconds.items()},
        "searched": summary.searched,
        **({"runs_differ": meta.runs_differ} if meta.runs_differ else {}),
        **({"began_from": tell_beginning(meta)} if meta.elsewhere else {}),
        **({"rounds": "none: each scenario was proposed as soon as one had ended"} if meta.asynchronous else {}),
    }
    plain |= _knowledge(summary)
    plain["agreement"] = {
        f"{aspect} and {other}": {
            "adjusted_rand": agreement.rand,
            "adjusted_mutual_information": agreement.mutual,
            "scenarios_that_differ": len(agreement.differ),
        }
        for (aspect, other), agreement in summary.agreements.items()
    }
    if summary.references:
        plain["references"] = {
            name: {
                "prevents": count.prevents,
                "does_not_prevent": count.collides,
                "says_nothing_of": count.says_nothing,
            }
            for name, count in summary.references.items()
        }
    if summary.probability is not None:
        plain["probability"] = estimate_to_dict(summary.probability)
    return plain | (_reduced(summary, summary.reduced) if summary.reduced is not None else {})


def estimate_to_dict(stored: Mapping[str, Any]) -> dict[str, Any]:
    """Return a stored estimate, whose keys are words, under identifiers."""
    return {
        _IDENTIFIERS.get(words, words.replace(" ", "_")): estimate_to_dict(value) if isinstance(value, dict) else value
        for words, value in stored.items()
    }


def with_words(values: Mapping[str, Any], levels: int = 0) -> dict[str, Any]:
    """Replace identifiers by words, except names in the first `name_levels` levels."""
    renamed = {}
    for key, value in values.items():
        below = levels - 1 if levels else NAMED.get(key, 0)
        words = key if levels else _WORDS.get(key, key.replace("_", " "))
        renamed[words] = with_words(value, below) if isinstance(value, dict) else value
    return renamed


def _failure(one: FailureSummary) -> dict[str, Any]:
    return {"scenarios": one.scenarios, "first": one.first, "at": dict(one.at)}


def _beside(summary: Summary) -> dict[str, Any]:
    if not summary.beside:
        return {}
    return {"collisions_not_measured_against": dict(summary.beside), "note": tell_beside(summary)}


def _metric(one: MetricSummary, meta: StudyMeta) -> dict[str, Any]:
    plain: dict[str, Any] = {
        "unit": one.unit,
        "critical_is": "low" if one.lower_is_critical else "high",
        "most_critical": one.most_critical,
        "median": one.median,
        "at": dict(one.at),
    }
    if one.counts:
        plain |= {"against": one.against, "scenarios_against": dict(one.counts)}
    if one.spread is not None:
        plain |= {
            "runs_of_each": meta.repeats,
            **({} if meta.most_repeats is None else {"runs_of_each_at_most": meta.most_repeats}),
            "spread_of_the_runs_median": one.spread[0],
            "spread_of_the_runs_largest": one.spread[1],
        }
    if one.alike:
        plain["note"] = one.alike
    return plain


def _clusters(one: Analysis, run: int) -> dict[str, Any]:
    plain: dict[str, Any] = {
        "sizes": one.sizes,
        "noise": int((one.labels < 0).sum()),
        "stability": one.clustering.stability,
    }
    if n_unassigned := run - len(one.ids):
        plain |= {"run_since_in_no_cluster_yet": n_unassigned, "they_join_with": name_joining(one)}
    if information := judge_clusters(one):
        plain["in_words"] = information
    if one.tells:
        plain["mutual_information_with"] = dict(one.tells)
    return plain | {
        f"cluster_{profile.cluster}": _named(profile)
        | {
            "scenarios": profile.size,
            "outcomes": profile.outcomes,
            "median": {metric: median for metric, (_, median, _) in profile.scores.items()},
            "where": [_rule(rule) for rule in profile.rules],
        }
        for profile in one.profiles
        if profile.cluster >= 0
    }


def _rule(rule: Rule) -> str:
    # A rule "everywhere" is not evaluated; studies of version 2 have no held-out figures.
    if math.isnan(rule.covers) or rule.text == EVERYWHERE:
        return rule.text
    return f"{rule.text} (held out: {rule.covers:.0%} of it, {rule.purity:.0%} pure)"


def _named(profile: Profile) -> dict[str, Any]:
    if not profile.name:
        return {}
    return {
        "name": profile.name,
        "true_of": profile.true_of,
        "true_of_others": profile.true_elsewhere,
        "example": profile.example,
    }


def _knowledge(summary: Summary) -> dict[str, Any]:
    estimates, plain = summary.knowledge, dict[str, Any]()
    if estimates.front is not None:
        plain["front"] = {f"scenario {scenario}": dict(scores) for scenario, scores in estimates.front.items()}
    if estimates.critical is not None:
        plain["critical"] = {
            "is": name_criterion(estimates.critical, summary.searched),
            **({"asked": override} if (override := tell_asked(summary)) else {}),
            "scenarios": estimates.critical.scenarios,
        }
        if (critical_set := estimates.critical.known) is not None:
            plain["critical"] |= {
                "share": _interval(critical_set.share, critical_set.share_doubt),
                "missed": _interval(critical_set.missed, critical_set.missed_doubt),
                "hidden": critical_set.hidden,
                "overlooked": {"value": critical_set.overlooked, "size": critical_set.region},
                "unvisited": {"value": critical_set.unvisited, "size": critical_set.region},
            }
        else:
            plain["critical"]["note"] = tell_unknown()
        if (audit := estimates.critical.audit) is not None:
            plain["critical"]["audit"] = {
                "scenarios": audit.scenarios,
                "critical": audit.critical,
                "share": asdict(audit.share),
                "missed": audit.missed and asdict(audit.missed),
            }
    if estimates.sensitivity is not None:
        plain["sensitivity"] = _sensitivity(estimates.sensitivity)
    return plain


def _interval(found: Estimate, doubt: str | None) -> dict[str, float | str | None]:
    return asdict(found) if doubt is None else {"value": found.value, "low": None, "high": None, "since": doubt}


def _sensitivity(found: Sensitivity) -> dict[str, Any]:
    rows = zip(found.names, found.first, found.first_interval, found.total, found.total_interval, strict=True)
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
        "predicted_variance": found.predicted,
        "of_little_influence": list(found.little),
    }
    if not found.foretold:
        plain["note"] = tell_unforetold()
    return plain


def _reduced(summary: Summary, reduced: ReducedSet) -> dict[str, Any]:
    coverage = {name: _labelled(entry, _COVERAGE) for name, entry in reduced.coverage.items()}
    for name, entry in reduced.critical.items():
        coverage.setdefault(name, {})["critical_scenarios"] = _labelled(entry, _CRITICAL)
    return {
        "kept": len(reduced.kept),
        **({"chosen": chosen} if (chosen := tell_chosen(summary)) else {}),
        "shapes": {f"cluster_{shape.cluster}": _shape(shape) for shape in reduced.shapes},
        "coverage": coverage,
    }


def _shape(one: ClusterShape) -> dict[str, Any]:
    return {
        "convexity": one.convexity,
        "convexity_in_kernel_space": one.kernel_convexity,
        "archetypes_by": one.method,
        "parts": one.parts,
    }


def _labelled(
    found: Coverage | CriticalCoverage | HeldOut | HeldOutCritical, labels: Mapping[str, str]
) -> dict[str, Any]:
    """Return the known numbers of `values` under their labels."""
    plain: dict[str, Any] = {}
    for key, label in labels.items():
        value = getattr(found, key)
        # Early versions did not measure all of them.
        if value is None or (isinstance(value, float) and math.isnan(value)):
            continue
        if isinstance(value, HeldOut | HeldOutCritical):
            value = _labelled(value, _HELD_OUT if isinstance(value, HeldOut) else _HELD_OUT_CRITICAL)
        plain[label] = asdict(value) if isinstance(value, Estimate) else value
    return plain
