"""What of a study may judge a search, since the search did not choose it by what it had learned."""

from __future__ import annotations

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.rows import row_keys
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.evidence import CriticalSet, Elsewhere, encoded
from cornercase.metrics import features_of, known_features
from cornercase.optimizers import GridOptimizer, RandomOptimizer, SobolOptimizer, optimizer_needs
from cornercase.scenario import ParameterSpace
from cornercase.study import Study

# Keeps the audits apart from all that is drawn with the seed of the search.
_AUDITS = 0xA0D17


def audits_of(space: ParameterSpace, seed: int) -> RandomOptimizer:
    """Sequence of the audits of a study: independent points of the space, each once.

    Parameters
    ----------
    space : ParameterSpace
    seed : int
        Of the study.

    Returns
    -------
    RandomOptimizer
        It is never told anything, so that what it draws depends on nothing else.
    """
    return RandomOptimizer(space, int(np.random.SeedSequence([seed, _AUDITS]).generate_state(1)[0]))


def chosen_blindly(optimizer: str, space: ParameterSpace, seed: int, points: FloatArray) -> BoolArray:
    """Tell which points fill the space, whatever the scores are.

    Those are the first ones of the sequence that the searches fill the space with, as far as all of it was run: which
    points these are does not depend on scores, also where a search came to one of them by itself. Of a grid it is all.

    Parameters
    ----------
    optimizer : str
        Name of the search, with its options.
    space : ParameterSpace
    seed : int
        Of the search.
    points : ndarray of float64, shape (n, d)
        All that the search was told.

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    name = optimizer.partition(":")[0]
    if name == GridOptimizer.name:
        return np.ones(len(points), dtype=np.bool_)
    kind = RandomOptimizer if name == RandomOptimizer.name else SobolOptimizer
    keys = row_keys(space.snap(points))
    ran, filling = set(keys), set[bytes]()
    for key in row_keys(kind(space, seed).ask(len(points))):
        if key not in ran:
            break
        filling.add(key)
    return np.array([key in filling for key in keys], dtype=np.bool_)


def learns_from_features(optimizer: str) -> bool:
    """Tell whether a search learns from features of recordings; then what is found is told by them too.

    Parameters
    ----------
    optimizer : str
        Name of the search, with its options.

    Returns
    -------
    bool
        False for one that is not known here.
    """
    try:
        return "features" in optimizer_needs(optimizer)
    except InputError:
        return False


def elsewhere_of(study: Study, threshold: float) -> Elsewhere | None:
    """What another study predicts, where the search of a study began from one.

    Parameters
    ----------
    study : Study
    threshold : float
        Oriented score up to which a scenario is critical.

    Returns
    -------
    Elsewhere or None
        None also where all that is known elsewhere is the same.
    """
    known = study.elsewhere()
    if known is None or np.ptp(known[1]) == 0.0:
        return None
    return Elsewhere(encoded(study.space, known[0]), known[1], threshold)


def critical_set_of(
    study: Study, scores: FloatArray, threshold: float, *, last: int | None = None, seed: int | None = None
) -> CriticalSet:
    """Estimate the critical set of a study; its audits judge, and say nothing of what is found.

    Parameters
    ----------
    study : Study
    scores : ndarray of float64, shape (n,)
        Oriented, of all scenarios that were run, audits too.
    threshold : float
        Oriented score up to which a scenario is critical.
    last : int, optional
        Id of a scenario: only it and those that were proposed before it count, as when it had just been run.
    seed : int, optional
        Of what is drawn; by default the study's. Two sets are compared with the same one.

    Returns
    -------
    CriticalSet

    Raises
    ------
    ValueError
        There are fewer than 10 scores without audits, or all are the same.
    """
    meta = study.meta
    every = [row for row in study.rows() if last is None or row.id <= last]
    ended = [row for row in every if row.state == "done"]
    audits = np.array([meta.is_audit(row.id) for row in ended], dtype=np.bool_)
    points = np.array([row.point for row in ended]).reshape(-1, study.space.dimension)
    scores = scores[: len(ended)]
    # Also what failed was chosen by the sequence.
    rows = [row for row in every if not meta.is_audit(row.id)]
    blindly = chosen_blindly(meta.optimizer, study.space, meta.seed, np.array([row.point for row in rows]))
    happened = None
    if learns_from_features(meta.optimizer):
        recordings = (study.recording(row.id) for row in rows if row.state == "done")
        happened = known_features(), features_of(recordings, meta.ego, meta.others)
    return CriticalSet(
        study.space,
        points[~audits],
        scores[~audits],
        threshold,
        meta.seed if seed is None else seed,
        filling=blindly[[row.state == "done" for row in rows]],
        audits=(points[audits], scores[audits]),
        happened=happened,
        elsewhere=elsewhere_of(study, threshold),
    )
