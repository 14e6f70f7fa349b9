"""Base class of optimizers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from copy import deepcopy
from typing import Any, ClassVar, Literal, Self

from cornercase._common.configurable import Configurable
from cornercase._common.errors import InputError
from cornercase._common.plugin_errors import convert_plugin_errors
from cornercase._common.typing import FloatArray
from cornercase.metrics import Feature, registered_features
from cornercase.scenario import ParameterSpace

OptimizerInput = Literal["threshold", "budget", "features"]
"""Argument that an optimizer may require in addition to the parameter space and the seed."""


class Optimizer(Configurable, ABC):
    """Base class of optimizers, which propose scenarios to run as points of the unit cube.

    The constructor takes options only. `start` returns a copy that searches a parameter space: `ask` proposes points,
    and `tell` gives the copy their scores.

    The proposals depend only on the space, the seed, and the observed scores in the order of the calls. So a search can
    continue after it was killed, or with a larger budget: a new copy gets all stored scores by `tell`, round by round,
    and then makes the same proposals as the first copy would have made. But a random number generator that `ask`
    advances would start again in the new copy. There are two solutions. Either draw from
    ``np.random.default_rng([seed, n])`` in each `ask`; n is the number of scenarios that `tell` got so far. Or set
    `is_stateful_ask`, as in the example ``Uniform``: then `ask` is called for each stored round before `tell`.

    A subclass defines `prepare`, `ask` and `tell`. The arguments of its constructor are its options and have defaults.
    On the command line options follow a colon, as in ``bayes:filling=0``. This is also the text (`str`) of the object.
    Two optimizers are equal if their class and options are equal. A study stores the text of the optimizer, so the
    study can be read without the class. It can be continued if an equal object is given to `explore` again.

    Attributes
    ----------
    name : str
        Name, also on the command line; in an object, the given options follow. No other optimizer may have this name.
    multi_objective : bool, default False
        True if the optimizer takes several scores per scenario and searches their Pareto front.
    supports_warm_start : bool, default False
        True if `warm_start` accepts the scores of another study.
    requires : frozenset of {"threshold", "budget", "features"}, default empty
        Arguments of `prepare` in addition to ``space`` and ``seed``: ``threshold``, the score up to which a scenario is
        critical; ``budget``, the total number of scenarios; ``features``, the f features of recordings (`Feature`)
        whose values `tell` gets. If the budget is required, proposals depend on the budget, so a study keeps its
        initial budget. If features are required, `tell` takes their values as third argument, shape (m, f), NaN for a
        scenario that failed.
    is_stateful_ask : bool, default False
        True if proposals also depend on earlier calls of `ask`. If a search is continued, these calls are repeated.

    See Also
    --------
    cornercase.optimizers.OPTIMIZERS : Optimizers by name, including those of other packages.

    Examples
    --------
    >>> import numpy as np
    >>> from cornercase.optimizers import LevelSet, Optimizer
    >>> from cornercase.scenario import ParameterSpace
    >>> space = ParameterSpace.from_ranges(["speed=5:15", "gap=0:40"])
    >>> LevelSet(filling=0.1).start(space, seed=1, threshold=0.5).ask(3).shape
    (3, 2)
    >>> class Centre(Optimizer):
    ...     name = "centre"
    ...
    ...     def __init__(self, offset=0.0):
    ...         self.offset = offset
    ...
    ...     def prepare(self, space, seed):
    ...         self._points = np.full((1, space.dimension), 0.5 + self.offset)
    ...
    ...     def ask(self, n):
    ...         return self._points[:n]
    ...
    ...     def tell(self, points, scores):
    ...         self._points = self._points[:0]
    >>> Centre(offset=0.25).start(space, seed=1).ask(1)
    array([[0.75, 0.75]])
    >>> Centre(offset=0.25), str(Centre(offset=0.25))
    (Centre(offset=0.25), 'centre:offset=0.25')
    >>> class Uniform(Optimizer):
    ...     name, is_stateful_ask = "uniform", True
    ...
    ...     def prepare(self, space, seed):
    ...         self._rng, self._dimension = np.random.default_rng(seed), space.dimension
    ...
    ...     def ask(self, n):
    ...         return self._rng.random((n, self._dimension))
    ...
    ...     def tell(self, points, scores):
    ...         pass
    >>> Uniform().start(space, seed=1).ask(2).shape
    (2, 2)
    >>> import cornercase as cc
    >>> folder = "examples/x_intersection/x_intersection"
    >>> scenario = cc.LogicalScenario.read(f"{folder}.xosc", f"{folder}.space.xosc")
    >>> problem = cc.Problem(scenario, ego="Ego", other="Pedestrian", metrics=["wttc"])
    >>> cc.Study.create("centre.db", problem).explore(Centre(offset=0.25), budget=20)
    <ExplorationResult: 1 scenarios done in centre.db; the search has no proposals after these 1 scenarios>
    """

    multi_objective: ClassVar[bool] = False
    supports_warm_start: ClassVar[bool] = False
    requires: ClassVar[frozenset[OptimizerInput]] = frozenset()
    is_stateful_ask: ClassVar[bool] = False

    def start(
        self,
        space: ParameterSpace,
        seed: int,
        *,
        threshold: float | None = None,
        budget: int | None = None,
        features: Sequence[Feature] | None = None,
    ) -> Self:
        """Return a copy that searches a space; this object stays as it is.

        Parameters
        ----------
        space : ParameterSpace
        seed : int
            The same seed gives the same proposals.
        threshold : float, optional
            Score up to which a scenario is critical; lower scores are more critical. `threshold`, `budget` and
            `features` have an effect only if the optimizer `requires` them.
        budget : int, optional
            Total number of scenarios.
        features : sequence of Feature, optional
            Features whose values `tell` gets, one per column. By default all registered features.

        Returns
        -------
        Optimizer

        Raises
        ------
        InputError
            The optimizer requires a threshold or a budget and there is none, or an option does not fit the space.
        """
        offered = {"threshold": threshold, "budget": budget, "features": features}
        required = {name: offered[name] for name in self.requires}
        if "features" in required and features is None:
            required["features"] = registered_features()
        for name in ("threshold", "budget"):
            if name in required and required[name] is None:
                raise InputError(f"The optimizer '{self}' needs a {name}; give one with `{name}`.")
        started = self.with_options()
        with convert_plugin_errors(f"The optimizer '{self}'", started, "in prepare"):
            started.prepare(space, seed, **required)
        return started

    @abstractmethod
    def prepare(self, space: ParameterSpace, seed: int, *further: Any, **required: Any) -> None:
        """Prepare the search of a space; called once, before the first `ask`.

        Parameters
        ----------
        space : ParameterSpace
        seed : int
        *further, **required
            The arguments that the attribute `requires` lists, such as ``threshold=0.5``.

        Raises
        ------
        InputError
            An option does not fit the space.
        """

    @abstractmethod
    def ask(self, n: int) -> FloatArray:
        """Propose points that were not observed yet.

        Parameters
        ----------
        n : int

        Returns
        -------
        ndarray of float64, shape (m, d)
            Points in the unit cube; fewer than n only if the space has no more points.
        """

    @abstractmethod
    def tell(self, points: FloatArray, scores: FloatArray) -> None:
        """Observe the scores of one round.

        Parameters
        ----------
        points : ndarray of float64, shape (m, d)
        scores : ndarray of float64, shape (m,) or (m, k)
            Lower is more critical. NaN for a scenario that failed. There are k scores per scenario only if the
            optimizer is `multi_objective`.
        """

    def ask_async(self, n: int, pending: FloatArray, *pseudo_results: Any) -> FloatArray:
        """Propose points while other scenarios are running, in a search without rounds.

        By default a copy of the optimizer proposes the points, after the copy has observed the mean of all scores as
        the score of each pending point (constant liar).

        Parameters
        ----------
        n : int
        pending : ndarray of float64, shape (p, d)
            Points that were proposed and have no result yet, in the order in which they were proposed.
        *pseudo_results : ndarray of float64, shape (p,), (p, k) or (p, f)
            Results that are assumed for the pending points: one array for each argument of `tell` after the points, in
            the same order (k scores or f features of a point). NaN as long as no scenario has a result.

        Returns
        -------
        ndarray of float64, shape (m, d)
            Points as from `ask`, without the points of `pending`.

        Notes
        -----
        Source: D. Ginsbourger, R. Le Riche, L. Carraro, "Kriging is well-suited to parallelize optimization", in
        Computational Intelligence in Expensive Optimization Problems (2010).
        """
        optimizer = deepcopy(self)
        if len(pending):
            optimizer.tell(pending, *pseudo_results)
        return optimizer.ask(n)

    def warm_start(self, points: FloatArray, scores: FloatArray) -> None:
        """Observe the scores of another study, before the first `tell`. The base class refuses this.

        Parameters
        ----------
        points : ndarray of float64, shape (n, d)
            Scenarios of a study with the same parameters but, for example, another driver, simulator or time step.
        scores : ndarray of float64, shape (n,)
            Scores of these scenarios, lower is more critical. All are finite; there are at least 10, not all the same.

        Raises
        ------
        InputError
            The optimizer does not support a warm start.
        """
        raise InputError(
            f"`warm_start`: {self.name} learns nothing from another study; use the optimizer auto, level-set or"
            " committee."
        )
