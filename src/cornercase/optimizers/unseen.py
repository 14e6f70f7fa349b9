"""No scenario is proposed twice."""

from __future__ import annotations

from cornercase._common.rows import row_keys, surely_distinct
from cornercase._common.typing import FloatArray
from cornercase.scenario import ParameterSpace


class Unseen:
    """Remembers the points of a space that were told, and leaves them out of what is proposed.

    Two points are the same when they stand for the same concrete scenario: points are snapped to steps and choices
    before they are compared.

    Parameters
    ----------
    space : ParameterSpace
    """

    def __init__(self, space: ParameterSpace) -> None:
        self._space = space
        self._told: set[bytes] = set()

    def __len__(self) -> int:
        return len(self._told)

    def tell(self, points: FloatArray) -> None:
        """Remember points, shape (n, d)."""
        self._told |= _keys(self._space.snap(points))

    def among(self, points: FloatArray, besides: FloatArray | None = None) -> FloatArray:
        """Select the points that can be proposed.

        Parameters
        ----------
        points : ndarray of float64, shape (n, d)
            In the unit cube.
        besides : ndarray of float64, shape (k, d), optional
            Further points to leave out, such as those of the same round.

        Returns
        -------
        ndarray of float64, shape (m, d)
            In the same order, snapped, each once, within the constraints of the space, neither told nor in `besides`.
        """
        snapped = self._space.snap(points)
        return self.left(snapped[self._space.admits(snapped)], besides)

    def left(self, points: FloatArray, besides: FloatArray | None = None) -> FloatArray:
        """As `among`, of points that are snapped and within the constraints already."""
        left_out = self._told if besides is None else self._told | _keys(self._space.snap(besides))
        if surely_distinct(points, left_out):
            return points
        keys = row_keys(points)
        # Of equal points the first stays, as the last one that is put in: in plain calls, as there are 100,000 points.
        first = dict(zip(reversed(keys), range(len(keys) - 1, -1, -1), strict=True))
        for key in left_out & first.keys():
            del first[key]
        return points[sorted(first.values())].reshape(-1, self._space.dimension)


def _keys(points: FloatArray) -> set[bytes]:
    return set(row_keys(points))
