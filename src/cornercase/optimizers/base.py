"""What an optimizer is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from copy import deepcopy
from typing import Any, ClassVar, Literal

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray

Need = Literal["threshold", "budget", "features"]
"""What an optimizer may need beside the space and the seed."""


class Optimizer(ABC):
    """Chooses where to look next, in the unit cube.

    An optimizer depends on its space, its seed and what it was told, in the order of the calls, and on nothing else:
    a new one of the same seed that is told the same rounds asks for the same points. So a study that was killed goes
    on by telling it again.

    A subclass takes ``space`` (a `ParameterSpace`), ``seed`` (int) and what it needs as keyword arguments, and
    defines `ask` and `tell`. Further arguments have defaults; users set them after a colon, as in
    ``bayes:filling=0``.

    Attributes
    ----------
    name : str
        As on the command line.
    takes_several : bool, default False
        Whether it takes several scores per scenario and searches their Pareto front.
    begins_from_studies : bool, default False
        Whether it takes the scores of another study to begin from, by `begin_from`.
    needs : frozenset of {"threshold", "budget", "features"}, default empty
        What it is given as keyword arguments beside ``space`` and ``seed``: ``threshold``, the oriented score up to
        which a scenario is critical; ``budget``, the number of scenarios in all; ``features``, the `Feature` of each
        number by which it is told what happened in a run. An optimizer that needs the budget asks for other points
        with another one, so its studies keep the budget that they began with. The `tell` of one that needs features
        takes them as its third argument, shape (m, f), NaN for a scenario that failed.
    remembers_asking : bool, default False
        Whether it depends on what it was asked for, too. A search without rounds asks it again before it goes on.

    See Also
    --------
    cornercase.optimizers.OPTIMIZERS : Optimizers by name, also those of other packages.

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
    takes_several: ClassVar[bool] = False
    begins_from_studies: ClassVar[bool] = False
    needs: ClassVar[frozenset[Need]] = frozenset()
    remembers_asking: ClassVar[bool] = False

    @abstractmethod
    def ask(self, n: int) -> FloatArray:
        """Propose points that were not told yet.

        Parameters
        ----------
        n : int

        Returns
        -------
        ndarray of float64, shape (m, d)
            In the unit cube; m < n only when the space has no more.
        """

    @abstractmethod
    def tell(self, points: FloatArray, scores: FloatArray) -> None:
        """Take the scores of one round.

        Parameters
        ----------
        points : ndarray of float64, shape (m, d)
        scores : ndarray of float64, shape (m,) or (m, k)
            Oriented: lower is more critical. NaN for a scenario that failed. Several scores each, k of them, only
            where the optimizer `takes_several`.
        """

    def ask_beside(self, n: int, pending: FloatArray, *lies: Any) -> FloatArray:
        """Propose points while others are run, in a search without rounds.

        By default a copy of the optimizer is told the mean of all scores for each point that is run (a constant liar)
        and asked for points.

        Parameters
        ----------
        n : int
        pending : ndarray of float64, shape (p, d)
            Points that were proposed and not told yet, in the order in which they were proposed.
        *lies : ndarray of float64, shape (p,), (p, k) or (p, f)
            What a constant liar tells of them: the further arguments of `tell`.

        Returns
        -------
        ndarray of float64, shape (m, d)
            As of `ask`; none of `pending`.

        Notes
        -----
        Source: D. Ginsbourger, R. Le Riche, L. Carraro, "Kriging is well-suited to parallelize optimization", in
        Computational Intelligence in Expensive Optimization Problems (2010).
        """
        liar = deepcopy(self)
        if len(pending):
            liar.tell(pending, *lies)
        return liar.ask(n)

    def begin_from(self, points: FloatArray, scores: FloatArray) -> None:
        """Take what another study knows, before anything is told; by default it is refused.

        Parameters
        ----------
        points : ndarray of float64, shape (n, d)
            Scenarios of a study of the same parameters, of another driver, simulator or time step.
        scores : ndarray of float64, shape (n,)
            Oriented and finite; 10 at least, not all the same.

        Raises
        ------
        InputError
            It learns nothing from another study.
        """
        raise InputError(f"`from_study`: {self.name} learns nothing from another study; use level-set or committee.")
