"""What an optimizer is."""

from __future__ import annotations

from typing import Protocol

from cornercase._common.typing import FloatArray


class Optimizer(Protocol):
    """Where to look next, in the unit cube; lower scores are more critical.

    An optimizer is a function of its space, its seed and what it was told, in the order of the calls: a new one
    of the same seed that is told the same rounds asks for the same points. So a study goes on after any kind of
    death, by telling it again.

    Attributes
    ----------
    name : str
        As on the command line.
    takes_several : bool, optional
        Whether it takes several scores of each scenario, for a Pareto front; not if it is not there.
    """

    name: str

    def ask(self, n: int) -> FloatArray:
        """Return at most `n` new points, shape (m, d); m < n only when the space has no more."""
        ...

    def tell(self, points: FloatArray, scores: FloatArray) -> None:
        """Take the scores, shape (m,), of points, shape (m, d), of one round; NaN for a scenario that failed.

        Of several scores for each the shape is (m, k).
        """
        ...
