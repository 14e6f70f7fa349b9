"""Estimate the critical set of a study, and select its scenarios that were chosen independently of scores."""

from __future__ import annotations

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.row_keys import row_keys
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.evidence._critical_set_estimate import CriticalSet
from cornercase.evidence._multi_fidelity import SourceStudyModel
from cornercase.evidence.gp._gaussian_process import encode_points
from cornercase.metrics import registered_features
from cornercase.optimizers import OPTIMIZERS, Grid, Random, Sobol
from cornercase.scenario import ParameterSpace
from cornercase.study import StudyFile
from cornercase.study._criterion import Criterion

# Separates the random numbers of audits from those of the search.
_AUDIT_SEED_SALT = 0xA0D17
# Most scenarios with which every study is judged with features. With more, a committee takes long.
_MAX_FEATURE_SCENARIOS = 2000


def audit_sampler(space: ParameterSpace, seed: int) -> Random:
    """Create the sampler of a study's audits (scenarios drawn at random as a check), which draws no point twice.

    The sampler never observes results, so its points depend on the space and the seed only.
    """
    return Random().start(space, int(np.random.SeedSequence([seed, _AUDIT_SEED_SALT]).generate_state(1)[0]))


def is_score_independent(optimizer: str, space: ParameterSpace, seed: int, points: FloatArray) -> BoolArray:
    """Return which points were chosen independently of scores, shape (n,): the initial design, or all points of a grid.

    `points`, shape (n, d), are all points that the search observed. The initial design is the space-filling
    sequence of the search, up to the first point that was not run. A point of the initial design counts even if the
    search proposed it because of scores, too.
    """
    name = optimizer.partition(":")[0]
    if name == Grid.name:
        return np.ones(len(points), dtype=np.bool_)
    sampler = Random() if name == Random.name else Sobol()
    keys = row_keys(space.snap(points))
    ran, initial_design = set(keys), set[bytes]()
    for key in row_keys(sampler.start(space, seed).ask(len(points))):
        if key not in ran:
            break
        initial_design.add(key)
    return np.array([key in initial_design for key in keys], dtype=np.bool_)


def uses_features_for_critical_set(optimizer: str, n_scenarios: int) -> bool:
    """Return whether the critical set of a study is estimated with features of recordings.

    True for up to 2,000 finished scenarios (`n_scenarios`), and for optimizers that use features.
    """
    if n_scenarios <= _MAX_FEATURE_SCENARIOS:
        return True
    try:
        return "features" in OPTIMIZERS.get_class(optimizer).requires
    except InputError:
        return False


def source_study_model(study: StudyFile, criterion: Criterion) -> SourceStudyModel | None:
    """Create the model of the other study whose scores warm-started a study's search.

    None if the search had no warm start, or if all scores of the other study are equal.
    """
    warm_start = study.warm_start_data()
    if warm_start is None or np.ptp(warm_start[1]) == 0.0:
        return None
    return SourceStudyModel(encode_points(study.space, warm_start[0]), warm_start[1], criterion)


def estimate_critical_set(study: StudyFile, *, last_id: int | None = None, seed: int | None = None) -> CriticalSet:
    """Estimate the critical set of a study; audits do not influence the estimate, but assess it.

    Audits are scenarios drawn at random as a check. Scenarios with an id above `last_id` are ignored, except that the
    number of all scenarios decides whether features are used. `seed` replaces the seed of the study, so that two
    critical sets can be compared with the same seed. Raises ValueError if there is no threshold, if there are fewer
    than 10 scores without audits, or if all scores are equal.
    """
    meta, objective = study.meta, study.objective
    if (criterion := objective.criterion) is None:
        raise ValueError("The study has no threshold.")
    n_finished = sum(not meta.is_audit(row.id) for row in study.finished_rows())
    candidates = [row for row in study.rows() if last_id is None or row.id <= last_id]
    ended = [row for row in candidates if row.state == "done"]
    audits = np.array([meta.is_audit(row.id) for row in ended], dtype=np.bool_)
    points = np.array([row.point for row in ended]).reshape(-1, study.space.dimension)
    scores = objective.minimized_scores(study)[: len(ended)]
    # Failed scenarios belong to the initial design as well.
    rows = [row for row in candidates if not meta.is_audit(row.id)]
    score_independent = is_score_independent(
        meta.optimizer, study.space, meta.seed, np.array([row.point for row in rows])
    )
    features, finished = None, [row.id for row in rows if row.state == "done"]
    if uses_features_for_critical_set(meta.optimizer, n_finished):
        features = registered_features(), study.features(finished)
    return CriticalSet(
        study.space,
        points[~audits],
        scores[~audits],
        criterion,
        meta.seed if seed is None else seed,
        initial_design=score_independent[[row.state == "done" for row in rows]],
        audits=(points[audits], scores[audits]),
        features=features,
        source_model=source_study_model(study, criterion),
    )
