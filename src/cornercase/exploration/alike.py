"""Metrics by which all scenarios of a study are the same."""

from __future__ import annotations

from typing import Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase.metrics import METRICS
from cornercase.study import DamageError, Study

ENOUGH_ALIKE: Final = 10
"""Scenarios that have to be run before anything is said of their scores."""


def tell_alike(study: Study) -> dict[str, str]:
    """Say of which metrics all scores are the same.

    Where the metric is searched, there was nothing for the search to follow. Where it is not, all may be well.

    Parameters
    ----------
    study : Study
        Nothing is said before 10 scenarios were run.

    Returns
    -------
    dict of str to str
        By metric, a sentence; empty where the scores of each differ.
    """
    found: dict[str, str] = {}
    if len(study.done()) < ENOUGH_ALIKE:
        return found
    searched = study.meta.searched
    for name in study.meta.metrics:
        try:
            scores = study.scores(name)
        except DamageError:
            raise
        except InputError:
            # Not measured of all scenarios.
            continue
        if np.ptp(scores) > 0.0:
            continue
        unit = METRICS.create(name).unit
        value = f"{scores[0]:.4g}{'' if unit == '1' else f' {unit}'}"
        found[name] = f"All {len(scores)} scenarios have the same {name} score ({value})"
        if name not in searched:
            found[name] += "."
        elif len(searched) == 1:
            found[name] += ", so the search has no gradient to follow. Choose another metric or widen the ranges."
        else:
            found[name] += ", so the search has only the other metrics to follow. Leave it out or widen the ranges."
    return found
