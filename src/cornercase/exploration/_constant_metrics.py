"""Detect metrics with the same score in all scenarios, and thresholds by which every or no scenario is critical."""

from __future__ import annotations

from typing import Final

import numpy as np

from cornercase._common.configurable import given_options
from cornercase._common.errors import InputError
from cornercase._common.io.support_table import issue_notice_warning
from cornercase.study import StudyFile
from cornercase.study._damage import DamageError
from cornercase.study._objective import Objective

# Minimum number of finished scenarios.
MIN_SCENARIOS_TO_COMPARE: Final = 10


def describe_constant_metrics(study: StudyFile) -> dict[str, str]:
    """Return a sentence for each metric that has the same score in all scenarios, by name of the metric.

    Empty for fewer than 10 scenarios. A search gets no guidance from a metric with equal scores. For metrics that are
    not searched, equal scores may be fine.
    """
    sentences: dict[str, str] = {}
    if len(study.finished_rows()) < MIN_SCENARIOS_TO_COMPARE:
        return sentences
    searched = study.meta.objective_metrics
    for name in study.meta.metrics:
        try:
            scores = study.scores(name)
        except DamageError:
            raise
        except InputError:
            # Not measured for all scenarios.
            continue
        if np.ptp(scores) > 0.0:
            continue
        unit = study.meta.create_metric(name).unit
        value = f"{scores[0]:.4g}{'' if unit == '1' else f' {unit}'}"
        sentences[name] = f"All {len(scores)} scenarios have the same {name} score ({value})"
        if name not in searched:
            sentences[name] += "."
        elif len(searched) == 1:
            sentences[name] += ", so the search has no gradient to follow. Choose another metric or widen the ranges."
        else:
            sentences[name] += ", so the search has only the other metrics to follow. Leave it out or widen the ranges."
    return sentences


def warn_about_threshold(objective: Objective, name: str) -> None:
    """Issue a `NoticeWarning` if, by the range of the metric's scores, every scenario or no scenario is critical.

    `name` is the name of the argument that contains the threshold, for the message.
    """
    if objective.weights or objective.threshold is None:
        return
    metric, threshold = objective.metrics[0], objective.threshold
    most_critical = metric.bound
    # Options such as `signed` go beyond contact.
    if most_critical is None and not given_options(metric):
        most_critical = metric.contact_score
    least, limit = metric.to_minimize(metric.cap), metric.to_minimize(threshold)
    if limit >= least:
        effect = "each scenario is critical"
    elif most_critical is not None and limit < metric.to_minimize(most_critical):
        effect = "no scenario is critical"
    else:
        return
    unit = "" if metric.unit == "1" else f" {metric.unit}"
    if most_critical is None:
        scores = f"{'at most' if metric.lower_is_critical else 'at least'} {metric.cap:g}{unit}"
    else:
        scores = f"from {min(metric.cap, most_critical):g} to {max(metric.cap, most_critical):g}{unit}"
    issue_notice_warning(f"`{name}` {threshold:g}: scores by {metric.name} are {scores}, so {effect}")
