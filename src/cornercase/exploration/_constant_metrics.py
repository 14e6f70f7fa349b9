"""Detect metrics with the same score in all scenarios."""

from __future__ import annotations

from typing import Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase.study import StudyFile
from cornercase.study._damage import DamageError

# Minimum number of finished scenarios.
MIN_SCENARIOS_TO_COMPARE: Final = 10


def describe_constant_metrics(study: StudyFile) -> dict[str, str]:
    """Describe each metric that has the same score in all scenarios of a study; empty for fewer than 10 scenarios.

    If such a metric is searched, the search has no gradient to follow. For other metrics this may be fine.
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
