"""Optimizer that uses the samplers of Optuna."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any, Final

import numpy as np

from cornercase._common.errors import InputError, suggest_name
from cornercase._common.optional_packages import describe_install
from cornercase._common.typing import FloatArray
from cornercase._common.validation import repr_short
from cornercase.optimizers._base import Optimizer
from cornercase.optimizers._dedupe import Deduplicator
from cornercase.optimizers._space_filling import Sobol
from cornercase.scenario import ParameterSpace

_SAMPLERS: Final = ("tpe", "nsga2", "cmaes", "gp", "random")
_TRIES = 20


class Optuna(Optimizer):
    """Optimizer that uses a sampler of Optuna, with one score or several.

    A sampler has a state that also depends on its own proposals. When a study is continued, a new sampler gets the
    stored scores of points that it did not propose. So, before each stored round, it is asked for as many points as the
    round has, and proposes the same points again. In a search without rounds, the sampler knows which of its points
    have no result yet.

    Source: T. Akiba et al., "Optuna: A next-generation hyperparameter optimization framework", KDD (2019).

    Parameters
    ----------
    sampler : {"tpe", "nsga2", "cmaes", "gp", "random"}, default "tpe"
        Sampler of Optuna: ``"tpe"`` is the tree-structured Parzen estimator with a constant liar for the points of a
        round, ``"nsga2"`` is NSGA-II, ``"cmaes"`` is CMA-ES (needs the package cmaes), ``"gp"`` is a Gaussian process
        (needs the package torch), and ``"random"`` draws independent points.

    Raises
    ------
    InputError
        There is no such sampler. `start` raises it if Optuna is not installed.

    Examples
    --------
    >>> import cornercase as cc
    >>> search = cc.optimizers.Optuna("nsga2")
    >>> str(search)
    'optuna:sampler=nsga2'
    >>> study.explore(search, budget=200)  # doctest: +SKIP
    """

    name = "optuna"
    multi_objective = True
    is_stateful_ask = True

    def __init__(self, sampler: str = "tpe") -> None:
        if not isinstance(sampler, str):
            raise InputError(
                f"`sampler` {repr_short(sampler)}: give the name of a sampler of Optuna, one of {', '.join(_SAMPLERS)};"
                " cornercase creates the sampler with the seed of the study."
            )
        if sampler not in _SAMPLERS:
            raise InputError(f"The optimizer optuna has no sampler '{sampler}'; {suggest_name(sampler, _SAMPLERS)}")
        self._sampler_name = sampler

    def prepare(self, space: ParameterSpace, seed: int) -> None:
        """Create the sampler for a space."""
        self._space, self._seed = space, seed
        self._sequence = Sobol().start(space, seed)
        self._deduplicator = Deduplicator(space)
        # Optuna's trials of proposed points without a result; None for points of the Sobol' sequence.
        self._open_trials: dict[bytes, Any] = {}
        self._study: Any = None
        self._in_rounds = True
        self._optuna = _import_optuna()
        self._sampler = self._create_sampler()

    def ask(self, n: int) -> FloatArray:
        """Propose at most `n` points, (m, d), as in `Optimizer.ask`."""
        return self._propose(n, np.zeros((0, self._space.dimension)))

    def ask_async(self, n: int, pending: FloatArray, *lies: Any) -> FloatArray:
        """Propose points while others are pending, that is, without a result.

        Optuna counts pending points of its sampler as running trials, which TPE treats as bad.
        """
        self._in_rounds = False
        return self._propose(n, pending)

    def _propose(self, n: int, pending: FloatArray) -> FloatArray:
        if self._study is None:
            # Optuna needs the number of scores, which is known with the first result.
            return self._sequence.ask(n, exclude=pending)
        points: list[FloatArray] = []
        for _ in range(n):
            point = self._new_point(pending)
            if point is None:
                candidates = self._sequence.ask(1, exclude=np.concatenate([pending, self._open_points]))
                if not len(candidates):
                    break
                point = candidates[0]
                self._open_trials[point.tobytes()] = None
            points.append(point)
        return np.array(points).reshape(-1, self._space.dimension)

    def tell(self, points: FloatArray, scores: FloatArray) -> None:
        """Observe scores (m,) or (m, k) of points (m, d), as in `Optimizer.tell`."""
        columns = scores.reshape(len(points), -1)
        if self._study is None:
            self._study = self._optuna.create_study(directions=["minimize"] * columns.shape[1], sampler=self._sampler)
        elif self._in_rounds and not any(point.tobytes() in self._open_trials for point in points):
            self.ask(len(points))
        for point, score in zip(points, columns.tolist(), strict=True):
            trial = self._open_trials.pop(point.tobytes(), None)
            failed = not np.isfinite(score).all()
            if trial is not None:
                state = self._optuna.trial.TrialState.FAIL if failed else None
                self._study.tell(trial, None if failed else score, state=state)
            elif not failed:
                self._study.add_trial(
                    self._optuna.trial.create_trial(
                        params=self._values_from_point(point),
                        distributions=self._parameter_distributions(),
                        values=score,
                    )
                )
        if self._in_rounds:
            self._fail_open_trials()
        self._deduplicator.remember(points)
        self._sequence.tell(points, scores)

    def _fail_open_trials(self) -> None:
        """Mark trials whose points got no score in their round as failed, since their scores will not come later."""
        for trial in self._open_trials.values():
            if trial is not None:
                self._study.tell(trial, state=self._optuna.trial.TrialState.FAIL)
        self._open_trials.clear()

    @property
    def _open_points(self) -> FloatArray:
        """Points that were proposed and have no result yet, (m, d)."""
        return np.array([np.frombuffer(key) for key in self._open_trials]).reshape(-1, self._space.dimension)

    def _new_point(self, pending: FloatArray) -> FloatArray | None:
        """Return a new point of the sampler, shape (d,), that was not proposed before; None if 20 tries give none."""
        for _ in range(_TRIES):
            trial = self._study.ask(self._parameter_distributions())
            for point in self._deduplicator.filter(
                self._point_from_values(trial.params)[None], np.concatenate([pending, self._open_points])
            ):
                self._open_trials[point.tobytes()] = trial
                return np.asarray(point)
            self._study.tell(trial, state=self._optuna.trial.TrialState.FAIL)
        return None

    def _create_sampler(self) -> Any:
        samplers = self._optuna.samplers
        package = {"cmaes": "cmaes", "gp": "torch"}.get(self._sampler_name)
        if package is not None and find_spec(package) is None:
            raise InputError(
                f"The sampler '{self._sampler_name}' of Optuna needs the package {package}; pip install {package}."
            )
        if self._sampler_name == "tpe":
            return samplers.TPESampler(seed=self._seed, constant_liar=True)
        classes = {"nsga2": "NSGAIISampler", "cmaes": "CmaEsSampler", "gp": "GPSampler", "random": "RandomSampler"}
        return getattr(samplers, classes[self._sampler_name])(seed=self._seed)

    def _parameter_distributions(self) -> dict[str, Any]:
        distributions = self._optuna.distributions
        return {
            parameter.name: distributions.CategoricalDistribution(list(range(len(parameter.choices))))
            if parameter.choices
            else distributions.FloatDistribution(0.0, 1.0)
            for parameter in self._space.parameters
        }

    def _point_from_values(self, values: dict[str, Any]) -> FloatArray:
        return np.array(
            [
                parameter.level_midpoints(np.array([values[parameter.name]]))[0]
                if parameter.choices
                else values[parameter.name]
                for parameter in self._space.parameters
            ]
        )

    def _values_from_point(self, point: FloatArray) -> dict[str, Any]:
        return {
            parameter.name: int(parameter.level_indices(point[j : j + 1])[0]) if parameter.choices else float(point[j])
            for j, parameter in enumerate(self._space.parameters)
        }


def _import_optuna() -> Any:
    try:
        import optuna
    except ImportError as error:
        raise InputError(f"Optuna is not installed; {describe_install('optuna')}.") from error
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    return optuna
