"""Metrics by which all scenarios of a study are the same."""

from __future__ import annotations

from typing import Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase.metrics import METRICS
from cornercase.study import DamageError, Study

_ENOUGH: Final = 10


def tell_alike(study: Study) -> dict[str, str]:
    """Say of which metrics all scores are the same, so that there was nothing for a search to follow.

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
    if len(study.done()) < _ENOUGH:
        return found
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
        found[name] = (
            f"All {len(scores)} scenarios score {value} by {name}, so it tells nothing of them and a search has nothing"
            " to follow; look at what its definition says of such scenarios, and choose another metric or wider ranges."
        )
    return found
