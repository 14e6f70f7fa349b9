"""Removal of proposed scenarios that were observed before, or that are proposed twice."""

from __future__ import annotations

from cornercase._common.row_keys import no_duplicates, row_keys
from cornercase._common.typing import FloatArray
from cornercase.scenario import ParameterSpace


class Deduplicator:
    """Filter that removes repeated points, and points observed before, from the proposals for a parameter space.

    Two points are equal if they represent the same concrete scenario. Before points are compared, they are snapped to
    the steps and choices of the parameters.
    """

    def __init__(self, space: ParameterSpace) -> None:
        self._space = space
        self._remembered: set[bytes] = set()

    def __len__(self) -> int:
        return len(self._remembered)

    def remember(self, points: FloatArray) -> None:
        """Remember points (n, d), so that they are not proposed again."""
        self._remembered |= _point_keys(self._space.snap(points))

    def filter(self, points: FloatArray, exclude: FloatArray | None = None) -> FloatArray:
        """Return those of n points of the unit cube, shape (n, d), that can be proposed, in order and each only once.

        First, the points are snapped (moved) to the steps and choices of the parameters. A point can be proposed if it
        fulfils the constraints of the space, and is neither remembered nor in `exclude`, shape (k, d).
        """
        snapped = self._space.snap(points)
        return self.filter_snapped(snapped[self._space.is_admissible(snapped)], exclude)

    def filter_snapped(self, points: FloatArray, exclude: FloatArray | None = None) -> FloatArray:
        """Do the same as `filter`, for points that are already snapped to steps and choices and fulfil the constraints.

        Return the distinct points that can be proposed, in order, shape (m, d).
        """
        excluded = self._remembered if exclude is None else self._remembered | _point_keys(self._space.snap(exclude))
        if no_duplicates(points, excluded):
            return points
        keys = row_keys(points)
        # Inserted in reverse, so that the first of equal points remains; fast for 100,000 points.
        first = dict(zip(reversed(keys), range(len(keys) - 1, -1, -1), strict=True))
        for key in excluded & first.keys():
            del first[key]
        return points[sorted(first.values())].reshape(-1, self._space.dimension)


def _point_keys(points: FloatArray) -> set[bytes]:
    return set(row_keys(points))
