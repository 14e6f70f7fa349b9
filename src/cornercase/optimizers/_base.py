"""Base class of optimizers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from copy import deepcopy
from typing import Any, ClassVar, Literal

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray

OptimizerInput = Literal["threshold", "budget", "features"]
"""Constructor arguments that an optimizer may require besides space and seed."""


class Optimizer(ABC):
    """Proposes scenarios to run, as points of the unit cube.

    An optimizer depends only on its space, its seed and the observed scores, in the order of the calls: a new one with
    the same seed that observes the same rounds proposes the same points. So a killed study is resumed by telling it the
    results again.

    A subclass takes ``space`` (a `ParameterSpace`), ``seed`` (int) and what it `requires` as keyword arguments, and
    defines `ask` and `tell`. Further arguments have defaults; users set them after a colon, as in ``bayes:filling=0``.

    Attributes
    ----------
    name : str
        As on the command line.
    multi_objective : bool, default False
        Whether it takes several scores per scenario and searches their Pareto front.
    supports_warm_start : bool, default False
        Whether `warm_start` accepts the scores of another study.
    requires : frozenset of {"threshold", "budget", "features"}, default empty
        Keyword arguments besides ``space`` and ``seed``: ``threshold``, the score up to which a scenario is critical;
        ``budget``, the total number of scenarios; ``features``, the `Feature` of each column of features. The proposals
        of an optimizer that requires the budget depend on it, so its studies keep their initial budget. The `tell` of
        one that requires features takes them as third argument, shape (m, f), NaN for a scenario that failed.
    is_stateful_ask : bool, default False
        Whether its proposals also depend on earlier calls of `ask`. If a search without rounds is resumed, these are
        repeated.

    See Also
    --------
    cornercase.optimizers.OPTIMIZERS : Optimizers by name, including those of other packages.

    Examples
    --------
    >>> import numpy as np
    >>> from cornercase.optimizers import Optimizer
    >>> class Centre(Optimizer):
    ...     name = "centre"
    ...
    ...     def __init__(self, space, seed):
    ...         self._points = np.full((1, space.dimension), 0.5)
    ...
    ...     def ask(self, n):
    ...         return self._points[:n]
    ...
    ...     def tell(self, points, scores):
    ...         self._points = self._points[:0]
    """

    name: str
    multi_objective: ClassVar[bool] = False
    supports_warm_start: ClassVar[bool] = False
    requires: ClassVar[frozenset[OptimizerInput]] = frozenset()
    is_stateful_ask: ClassVar[bool] = False

    @abstractmethod
    def ask(self, n: int) -> FloatArray:
        """Propose points that were not observed yet.

        Parameters
        ----------
        n : int

        Returns
        -------
        ndarray of float64, shape (m, d)
            In the unit cube; m < n only if the space has no more.
        """

    @abstractmethod
    def tell(self, points: FloatArray, scores: FloatArray) -> None:
        """Observe the scores of one round.

        Parameters
        ----------
        points : ndarray of float64, shape (m, d)
        scores : ndarray of float64, shape (m,) or (m, k)
            Lower is more critical. NaN for a scenario that failed. k scores per scenario only if the optimizer is
            `multi_objective`.
        """

    def ask_async(self, n: int, pending: FloatArray, *pseudo_results: Any) -> FloatArray:
        """Propose points while others are running, in a search without rounds.

        By default a copy of the optimizer observes the mean of all scores for each pending point (constant liar), and
        then proposes points.

        Parameters
        ----------
        n : int
        pending : ndarray of float64, shape (p, d)
            Points that were proposed and have no result yet, in the order in which they were proposed.
        *pseudo_results : ndarray of float64, shape (p,), (p, k) or (p, f)
            Results that a constant liar assumes for them: the further arguments of `tell`.

        Returns
        -------
        ndarray of float64, shape (m, d)
            As from `ask`; none of `pending`.

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
        """Observe another study, before the first `tell`. Refused by default.

        Parameters
        ----------
        points : ndarray of float64, shape (n, d)
            Scenarios of a study of the same parameters, of another driver, simulator or time step.
        scores : ndarray of float64, shape (n,)
            Lower is more critical; finite; at least 10, not all the same.

        Raises
        ------
        InputError
            The optimizer does not support a warm start.
        """
        raise InputError(f"`warm_start`: {self.name} learns nothing from another study; use level-set or committee.")
