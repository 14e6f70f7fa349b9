"""Genetic algorithm, for one or several scores."""

from __future__ import annotations

from typing import Any

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray
from cornercase._common.validation import check_int
from cornercase.optimizers._base import Optimizer
from cornercase.optimizers._dedupe import Deduplicator
from cornercase.optimizers._space_filling import Sobol
from cornercase.scenario import ParameterSpace

_TRIES = 50


class Evolutionary(Optimizer):
    """Genetic algorithm; with several scores it is NSGA-II and searches their Pareto front.

    The population of a round consists of the best of all observed scenarios, by non-dominated sorting and crowding
    distance. Tournaments of two select parents from the population. Children come from simulated binary crossover and
    polynomial mutation. A parameter with choices is inherited from some parent, or drawn at random. Children that were
    run before, or violate constraints, are replaced by further children.

    Source: K. Deb et al., "A fast and elitist multiobjective genetic algorithm: NSGA-II", IEEE Transactions on
    Evolutionary Computation 6 (2002); implemented with pymoo (J. Blank, K. Deb, IEEE Access 8, 2020).

    Parameters
    ----------
    population : int, default 40
        Number of best scenarios that can be parents. Until this number of scenarios is finished, points come from the
        Sobol' sequence.

    Raises
    ------
    InputError
        The population is smaller than two.

    Examples
    --------
    >>> import cornercase as cc
    >>> search = cc.optimizers.Evolutionary()
    >>> str(search)
    'evolutionary'
    >>> study.explore(search, budget=400)  # doctest: +SKIP
    """

    name = "evolutionary"
    multi_objective = True

    def __init__(self, population: int = 40) -> None:
        self._population = check_int("population", population, 2)

    def prepare(self, space: ParameterSpace, seed: int) -> None:
        """Start the Sobol' sequence of the space."""
        self._space, self._seed = space, seed
        self._has_choices = np.array([bool(parameter.choices) for parameter in space.parameters])
        self._sequence = Sobol().start(space, seed)
        self._deduplicator = Deduplicator(space)
        self._points = np.zeros((0, space.dimension))
        self._scores: FloatArray | None = None

    def ask(self, n: int) -> FloatArray:
        """Propose at most `n` points, (m, d), as in `Optimizer.ask`."""
        return self.ask_async(n, self._points[:0])

    def ask_async(self, n: int, pending: FloatArray, *lies: Any) -> FloatArray:
        """Propose points while others are pending, that is, without a result; only finished scenarios are parents."""
        if self._scores is None or np.isfinite(self._scores).all(axis=1).sum() < self._population:
            return self._sequence.ask(n, exclude=pending)
        children = self._make_children(n, pending)
        exclude = np.concatenate([pending, children])
        return np.concatenate([children, self._sequence.ask(n - len(children), exclude=exclude)])

    def tell(self, points: FloatArray, scores: FloatArray) -> None:
        """Observe scores (m,) or (m, k) of points (m, d), as in `Optimizer.tell`."""
        columns = scores.reshape(len(points), -1)
        self._points = np.concatenate([self._points, points])
        self._scores = columns if self._scores is None else np.concatenate([self._scores, columns])
        self._deduplicator.remember(points)
        self._sequence.tell(points, scores)

    def _make_children(self, n: int, pending: FloatArray) -> FloatArray:
        """Generate at most `n` points, shape (m, d), from the best scenarios, neither observed nor pending."""
        from pymoo.core.mating import Mating
        from pymoo.core.population import Population
        from pymoo.core.problem import Problem
        from pymoo.operators.crossover.sbx import SBX
        from pymoo.operators.mutation.pm import PM
        from pymoo.operators.selection.tournament import TournamentSelection
        from pymoo.operators.survival.rank_and_crowding import RankAndCrowding

        assert self._scores is not None
        rng = np.random.default_rng([self._seed, len(self._points) + len(pending)])
        finished = np.flatnonzero(np.isfinite(self._scores).all(axis=1))
        best = finished[_mask_first_pareto_fronts(self._scores[finished], self._population)]
        problem = Problem(n_var=self._space.dimension, n_obj=self._scores.shape[1], xl=0.0, xu=1.0)
        population = Population.new(X=self._points[best], F=self._scores[best])
        parents = RankAndCrowding().do(problem, population, n_survive=self._population, random_state=rng)
        mating = Mating(TournamentSelection(func_comp=_tournament_winners), SBX(), PM())
        accepted = np.zeros((0, self._space.dimension))
        for _ in range(_TRIES):
            if len(accepted) == n:
                break
            children = mating.do(problem, parents, 2 * n, random_state=rng).get("X")
            children = self._inherit_choices(np.clip(children, 0.0, 1.0), parents.get("X"), rng)
            exclude = np.concatenate([pending, accepted])
            accepted = np.concatenate([accepted, self._deduplicator.filter(children, exclude=exclude)])[:n]
        return accepted

    def _inherit_choices(self, children: FloatArray, parents: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Set the parameters with choices of each child: each takes the choice of a random parent.

        With a probability of 1/d, where d is the number of parameters, the choice is drawn at random instead.
        """
        inherited = parents[rng.integers(len(parents), size=children.shape), np.arange(children.shape[1])]
        new = rng.random(children.shape)
        mutates = rng.random(children.shape) < 1.0 / children.shape[1]
        return np.where(self._has_choices, np.where(mutates, new, inherited), children)


def _mask_first_pareto_fronts(scores: FloatArray, count: int) -> BoolArray:
    """Return the mask of the rows of scores, shape (m, k), on the first Pareto fronts.

    There are as many fronts as are needed to hold at least `count` rows.
    """
    if scores.shape[1] == 1:
        return np.asarray(scores[:, 0] <= np.partition(scores[:, 0], count - 1)[count - 1])
    from moocore import pareto_rank

    rank = np.asarray(pareto_rank(scores))
    return np.asarray(rank <= np.partition(rank, count - 1)[count - 1])


def _tournament_winners(population: Any, pairs: Any, random_state: Any = None, **_: Any) -> Any:
    """Return the winner of each pair: the individual of lower rank, or if tied, the less crowded individual."""
    rank, crowding = population.get("rank"), population.get("crowding")
    first, second = pairs.T
    wins = (rank[first] < rank[second]) | ((rank[first] == rank[second]) & (crowding[first] >= crowding[second]))
    return np.where(wins, first, second)[:, None]
