"""Scenarios that were run, and which of several classifiers tells best from them what is critical.

What a search is said to find depends on who tells what is critical from its runs. So each search is judged by the
classifier that tells its own runs best: the one with the least log loss of each run as told by others, in five folds.
It never sees the truth. The classifiers are the same for all:

- ``process``: the Gaussian process of the scores near the threshold, `cornercase.evidence.fit_boundary_process`;
- ``committee``: `cornercase.evidence._committee.CommitteeModel`, with the features of the recordings;
- ``scores``: the same with the scores alone;
- ``forest``: scikit-learn's random forest of the parameters.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr
from sklearn.ensemble import RandomForestClassifier
from sklearn.model_selection import StratifiedKFold, cross_val_predict

from cornercase.evidence._committee import PREDICTED_CRITICAL, CommitteeModel
from cornercase.evidence.gp._gaussian_process import fit_boundary_process
from cornercase.metrics import registered_features
from cornercase.study._criterion import Criterion

Floats = npt.NDArray[np.float64]
Probability = Callable[[Floats], Floats]
CLASSIFIERS = ("process", "committee", "scores", "forest")
FOLDS, TREES = 5, 200
CUTS = {"committee": PREDICTED_CRITICAL, "scores": PREDICTED_CRITICAL}
"""Probability from which a classifier takes a scenario for critical, as the package does; 0.5 for others."""


def classified(
    kind: str, points: Floats, scores: Floats, features: Floats, critical: float, seed: int
) -> tuple[Floats, Probability]:
    """Probabilities of one kind of classifier: of each run by others, and of scenarios by all runs."""
    if kind == "process":
        process = fit_boundary_process(points, scores, Criterion(critical))
        mean, deviation = process.leave_one_out()

        def by_process(at: Floats) -> Floats:
            mean, deviation = process.predict(at)
            return np.asarray(ndtr(-mean / deviation))

        return np.asarray(ndtr(-mean / deviation)), by_process
    if kind == "forest":
        side = scores <= critical
        forest: Any = RandomForestClassifier(TREES, random_state=seed)
        folds = StratifiedKFold(FOLDS, shuffle=True, random_state=seed)
        held = cross_val_predict(forest, points, side, cv=folds, method="predict_proba")[:, 1]
        forest.fit(points, side)
        return held, lambda at: np.asarray(forest.predict_proba(at)[:, 1])
    with_features = kind == "committee"
    committee = CommitteeModel(Criterion(critical), registered_features() if with_features else (), seed)
    committee.fit(points, scores, features if with_features else None)
    return committee.out_of_fold_probability(), lambda at: committee.predict(at)[0]


def log_loss(probability: Floats, side: npt.NDArray[np.bool_]) -> float:
    """Mean log loss, of which no single run is worth more than 1 in 1,000."""
    right = np.clip(np.where(side, probability, 1.0 - probability), 1e-3, 1.0)
    return float(-np.log(right).mean())


def best_classifier(
    kinds: tuple[str, ...], points: Floats, scores: Floats, features: Floats, critical: float, seed: int
) -> tuple[str, Probability | None]:
    """The kind with the least log loss of the runs by others; none of them where too few runs are of one side."""
    known = np.isfinite(scores)
    points, scores, features = points[known], scores[known], features[known]
    side = scores <= critical
    if len(side) < 10 or min(side.sum(), (~side).sum()) < FOLDS:
        return "none", None
    made = {kind: classified(kind, points, scores, features, critical, seed) for kind in kinds}
    losses = {kind: log_loss(held, side) for kind, (held, _) in made.items()}
    best = min(losses, key=lambda kind: losses[kind])
    return best, made[best][1]
