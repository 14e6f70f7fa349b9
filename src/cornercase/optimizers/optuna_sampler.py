"""Optuna's samplers as searches."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any, Final

import numpy as np

from cornercase._common.errors import InputError, suggestion
from cornercase._common.typing import FloatArray
from cornercase.optimizers.sequences import SequenceOptimizer
from cornercase.scenario import ParameterSpace

_SAMPLERS: Final = ("tpe", "nsga2", "cmaes", "gp", "random")
_TRIES = 20


class OptunaOptimizer:
    """A sampler of Optuna, with one score or several.

    Parameters
    ----------
    space : ParameterSpace
    seed : int
    sampler : {"tpe", "nsga2", "cmaes", "gp", "random"}, default "tpe"
        Tree-structured Parzen estimator with a constant liar for rounds, NSGA-II, CMA-ES (needs the package cmaes),
        Gaussian process (needs torch), or independent points.

    Raises
    ------
    InputError
        Optuna is not there, or has no such sampler here.

    Notes
    -----
    Source: T. Akiba et al., "Optuna: A next-generation hyperparameter optimization framework", KDD (2019).

    A sampler keeps more in mind than points and scores. So when it is told points that it was not asked for, as when
    a study goes on, it is asked for as many first; with the same rounds these are the same points.
    """

    name = "optuna"
    takes_several = True

    def __init__(self, space: ParameterSpace, seed: int, sampler: str = "tpe") -> None:
        if sampler not in _SAMPLERS:
            raise InputError(f"There is no sampler '{sampler}' of Optuna here; {suggestion(sampler, _SAMPLERS)}")
        self._space, self._seed, self._kind = space, seed, sampler
        self._sequence = SequenceOptimizer(space, seed, "sobol")
        self._told: set[bytes] = set()
        self._asked: dict[bytes, Any] = {}
        self._study: Any = None
        self._optuna = _imported()
        self._sampler = self._made()

    def ask(self, n: int) -> FloatArray:
        """Return at most `n` points, shape (m, d), none of which was told; m < n only when the space has no more."""
        if self._study is None:
            # Optuna has to know the number of scores, which comes with the first.
            return self._sequence.ask(n)
        points: list[FloatArray] = []
        for _ in range(n):
            point = self._new()
            if point is None:
                asked = np.array([np.frombuffer(key) for key in self._asked])
                found = self._sequence.ask(1, besides=asked.reshape(-1, self._space.dimension))
                if not len(found):
                    break
                point = found[0]
                self._asked[point.tobytes()] = None
            points.append(point)
        return np.array(points).reshape(-1, self._space.dimension)

    def tell(self, points: FloatArray, scores: FloatArray) -> None:
        """Take scores, shape (m,) or (m, k), lower being more critical; NaN for a scenario that failed."""
        columns = scores.reshape(len(points), -1)
        if self._study is None:
            self._study = self._optuna.create_study(directions=["minimize"] * columns.shape[1], sampler=self._sampler)
        elif not any(point.tobytes() in self._asked for point in points):
            self.ask(len(points))
        for point, score in zip(points, columns.tolist(), strict=True):
            trial = self._asked.pop(point.tobytes(), None)
            failed = not np.isfinite(score).all()
            if trial is not None:
                state = self._optuna.trial.TrialState.FAIL if failed else None
                self._study.tell(trial, None if failed else score, state=state)
            elif not failed:
                self._study.add_trial(
                    self._optuna.trial.create_trial(
                        params=self._parameters(point), distributions=self._distributions(), values=score
                    )
                )
        # What was asked for and never told will not come any more.
        for trial in self._asked.values():
            if trial is not None:
                self._study.tell(trial, state=self._optuna.trial.TrialState.FAIL)
        self._asked.clear()
        self._told |= {point.tobytes() for point in points}
        self._sequence.tell(points, np.zeros(len(points)))

    def _new(self) -> FloatArray | None:
        """A point that was not met yet; None if the sampler proposes none."""
        for _ in range(_TRIES):
            trial = self._study.ask(self._distributions())
            point: FloatArray = self._space.snap(self._point(trial.params)[None])[0]
            key = point.tobytes()
            if key not in self._told and key not in self._asked and self._space.admits(point[None])[0]:
                self._asked[key] = trial
                return point
            self._study.tell(trial, state=self._optuna.trial.TrialState.FAIL)
        return None

    def _made(self) -> Any:
        samplers = self._optuna.samplers
        needed = {"cmaes": "cmaes", "gp": "torch"}.get(self._kind)
        if needed is not None and find_spec(needed) is None:
            raise InputError(f"The sampler '{self._kind}' of Optuna needs the package {needed}; pip install {needed}.")
        if self._kind == "tpe":
            return samplers.TPESampler(seed=self._seed, constant_liar=True)
        kinds = {"nsga2": "NSGAIISampler", "cmaes": "CmaEsSampler", "gp": "GPSampler", "random": "RandomSampler"}
        return getattr(samplers, kinds[self._kind])(seed=self._seed)

    def _distributions(self) -> dict[str, Any]:
        kinds = self._optuna.distributions
        return {
            one.name: kinds.CategoricalDistribution(list(range(len(one.choices))))
            if one.choices
            else kinds.FloatDistribution(0.0, 1.0)
            for one in self._space.parameters
        }

    def _point(self, parameters: dict[str, Any]) -> FloatArray:
        return np.array(
            [
                one.middles(np.array([parameters[one.name]]))[0] if one.choices else parameters[one.name]
                for one in self._space.parameters
            ]
        )

    def _parameters(self, point: FloatArray) -> dict[str, Any]:
        return {
            one.name: int(one.numbers(point[j : j + 1])[0]) if one.choices else float(point[j])
            for j, one in enumerate(self._space.parameters)
        }


def _imported() -> Any:
    try:
        import optuna
    except ImportError as error:
        raise InputError("Optuna is not installed; it comes with pip install 'cornercase[optuna]'.") from error
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    return optuna
