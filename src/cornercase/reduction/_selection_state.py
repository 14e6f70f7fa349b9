"""State of a selection: the scenarios selected so far, and which further scenarios may be added."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering._embedding import Distances

# Share of the largest distance up to which two scenarios are similar.
SIMILAR_SHARE: Final = 1e-3

Role = Literal["archetype", "prototype", "critical prototype", "gap", "exposing", "chosen"]


@dataclass(frozen=True)
class Selected:
    """A selected scenario: its index, the cluster that it represents (-1 for noise), and its role.

    Role ``"critical prototype"``: the medoid of the critical scenarios of a cluster whose prototype is not critical.
    Role ``"gap"``: a scenario that was far from all scenarios selected before. Role ``"exposing"``: a scenario that
    kills mutants of the driver. Role ``"chosen"``: a scenario that a user chose by its id.
    """

    index: int
    cluster: int
    role: Role


class Selection:
    """Scenarios selected so far, in order.

    A scenario is not added if it is similar to a selected scenario, or if `size` scenarios are selected.
    """

    def __init__(self, distances: Sequence[Distances], size: int | None) -> None:
        self._distances = distances
        self._extents = [max(float(matrix.max()), 1e-300) for matrix in distances]
        self.selected: list[Selected] = []
        self._size = size

    @property
    def indices(self) -> list[int]:
        """Indices of the selected scenarios."""
        return [selected.index for selected in self.selected]

    def distances_to(self, indices: Sequence[int] | IntArray) -> FloatArray:
        """Return the distances from m scenarios to all n scenarios, shape (m, n), over all clusterings.

        In each clustering, distances are divided by the largest distance of the clustering. Of the quotients for two
        scenarios, the largest is returned. Only the requested rows are computed, since all n rows would need as much
        memory as the distances of a clustering.
        """
        rows = list(indices)
        scaled = [matrix[rows] / extent for matrix, extent in zip(self._distances, self._extents, strict=True)]
        return np.asarray(np.max(scaled, axis=0))

    def copy(self) -> Selection:
        """Copy the selection, so that both copies can be continued in different ways."""
        other = copy(self)
        other.selected = self.selected[:]
        return other

    @property
    def is_complete(self) -> bool:
        """True if `size` scenarios are selected."""
        return self._size is not None and len(self.selected) >= self._size

    def add(self, scenario: Selected) -> bool:
        """Add a scenario unless it is similar to a selected one or the selection is complete.

        Returns whether the scenario was added.
        """
        if self.is_complete or self._is_similar_to_selected(scenario.index):
            return False
        self.selected.append(scenario)
        return True

    def _is_similar_to_selected(self, index: int) -> bool:
        candidates = np.array(self.indices, dtype=np.int64)
        # Few candidates are left after the first clustering.
        for matrix, extent in zip(self._distances, self._extents, strict=True):
            if len(candidates):
                candidates = candidates[matrix[np.ix_(np.array([index]), candidates)][0] / extent <= SIMILAR_SHARE]
        return bool(len(candidates))
