"""Contract checks of optimizers."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any, Final

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.metrics import registered_features
from cornercase.optimizers import OPTIMIZERS, Optimizer
from cornercase.scenario import ParameterSpace
from cornercase.testing._contract_check import ContractCheck

_BUDGET: Final = 24
_PER_ROUND: Final = 4
_SPACES: Final = (("speed=5:15",), ("speed=5:15", "gap=0:40"), ("a=0:1", "b=0:1:0.25", "c=-3:3", "d=1:2"))


def optimizer_checks(optimizer: str | Optimizer) -> list[ContractCheck]:
    """Return the contract checks of an optimizer.

    Parameters
    ----------
    optimizer : str or Optimizer
        Optimizer, or its name with options after a colon, such as ``"level-set:filling=0.1"``.

    Returns
    -------
    list of ContractCheck

    Examples
    --------
    >>> from cornercase.testing import optimizer_checks, run_checks
    >>> [result.problem for result in run_checks(optimizer_checks("sobol")[:2])]
    ['', '']
    """
    checks = {
        "proposes points of the unit cube": _check_proposals,
        "proposes the same for the same seed": _check_seed_repeatability,
        "goes on after a restart as if nothing had happened": _check_resumption,
        "takes scores that are all equal": _check_equal_scores,
        "leaves what it is told as it is": _check_inputs_unchanged,
        "leaves the object as it is": _check_searches_independent,
    }
    return [ContractCheck(name, partial(function, optimizer)) for name, function in checks.items()]


def _start(optimizer: Any, space: ParameterSpace, seed: int = 1) -> Optimizer:
    created = OPTIMIZERS.resolve(optimizer, "optimizer")
    return created.start(space, seed, threshold=0.3, budget=_BUDGET)


def _iter_example_spaces() -> Iterator[ParameterSpace]:
    yield from (ParameterSpace.from_ranges(list(ranges)) for ranges in _SPACES)


def _compute_example_score(points: FloatArray) -> FloatArray:
    """Return a smooth example score of points, with one critical region; lower is more critical."""
    return np.asarray(np.linalg.norm(points - 0.35, axis=1))


def _pass_scores(search: Optimizer, points: FloatArray, scores: FloatArray) -> None:
    shown = scores[:, None] if search.multi_objective else scores
    if "features" in search.requires:
        features = np.tile(points[:, :1], (1, len(registered_features())))
        search.tell(points, shown, features)  # type: ignore[call-arg]
    else:
        search.tell(points, shown)


def _search(optimizer: Any, space: ParameterSpace, rounds: int) -> tuple[Optimizer, list[FloatArray]]:
    search, proposals = _start(optimizer, space), []
    for _ in range(rounds):
        points = search.ask(_PER_ROUND)
        proposals.append(np.array(points))
        if not len(points):
            break
        _pass_scores(search, points, _compute_example_score(points))
    return search, proposals


def _check_proposals(optimizer: Any) -> None:
    for space in _iter_example_spaces():
        _, proposals = _search(optimizer, space, _BUDGET // _PER_ROUND)
        assert len(proposals[0]), "It proposes nothing in the first round."
        for points in proposals:
            assert points.shape[1:] == (space.dimension,), (
                f"It proposes an array of shape {points.shape} for {space.dimension} parameters."
            )
            assert len(points) <= _PER_ROUND, f"It proposes {len(points)} points instead of at most {_PER_ROUND}."
            assert ((points >= 0.0) & (points <= 1.0)).all(), "It proposes a point outside of the unit cube."


def _check_seed_repeatability(optimizer: Any) -> None:
    for space in _iter_example_spaces():
        first, second = (_search(optimizer, space, 4)[1] for _ in range(2))
        assert all(map(np.array_equal, first, second)), "With the same seed and scores it proposes other points."


def _check_resumption(optimizer: Any) -> None:
    for space in _iter_example_spaces():
        search, proposals = _search(optimizer, space, 3)
        resumed = _start(optimizer, space)
        for points in proposals:
            if resumed.is_stateful_ask:
                resumed.ask(_PER_ROUND)
            if len(points):
                _pass_scores(resumed, points, _compute_example_score(points))
        assert np.array_equal(search.ask(_PER_ROUND), resumed.ask(_PER_ROUND)), (
            "A fresh copy with the same scores proposes other points, so a killed search could not be resumed."
        )


def _check_equal_scores(optimizer: Any) -> None:
    for space in _iter_example_spaces():
        search = _start(optimizer, space)
        for _ in range(4):
            points = search.ask(_PER_ROUND)
            if len(points):
                _pass_scores(search, points, np.zeros(len(points)))


def _check_inputs_unchanged(optimizer: Any) -> None:
    for space in _iter_example_spaces():
        search = _start(optimizer, space)
        points = search.ask(_PER_ROUND)
        scores = _compute_example_score(points)
        copies = points.copy(), scores.copy()
        _pass_scores(search, points, scores)
        search.ask(_PER_ROUND)
        is_unchanged = np.array_equal(copies[0], points) and np.array_equal(copies[1], scores)
        assert is_unchanged, "It changes the arrays of points or scores that it is given."


def _check_searches_independent(optimizer: Any) -> None:
    created = OPTIMIZERS.resolve(optimizer, "optimizer")
    space = next(_iter_example_spaces())
    first, second = (created.start(space, 1, threshold=0.3, budget=_BUDGET) for _ in range(2))
    points = first.ask(_PER_ROUND)
    _pass_scores(first, points, np.zeros(len(points)))
    fresh = created.start(space, 1, threshold=0.3, budget=_BUDGET)
    assert np.array_equal(second.ask(_PER_ROUND), fresh.ask(_PER_ROUND)), (
        "Two searches that were started from one object share state."
    )
