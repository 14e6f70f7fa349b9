"""Greedy search for scenarios that lower the coverage sum most, computed by cells (groups) of nearby scenarios."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.clustering._cells import AXES_PER_STAGE, CELL_SIZE, make_cells, pad_axes
from cornercase.reduction import _coverage_kernels as coverage_kernels
from cornercase.reduction._coverage_kernels import MAX_KNOWN_TERMS, CoverageCells


class CellGreedySearch:
    """Greedy search for the next scenario to select: the one that lowers the coverage sum most.

    The coverage sum is the weighted sum, over all scenarios and clusterings, of ``(distance / usual_distance)**power``.
    The distance is the squared Euclidean distance to the nearest selected scenario in the coordinates of a clustering,
    one of the `embeddings`, shape (n, p) each. `power` is 2 or 3. At least one scenario must be selected. `gains`,
    shape (n,), is by how much each scenario would lower the sum; a gain that was computed earlier may be too high.
    """

    def __init__(
        self,
        embeddings: Sequence[FloatArray],
        usual_distances: Sequence[float],
        weights: Sequence[FloatArray],
        power: int,
        selected: Sequence[int],
    ) -> None:
        n_axes = max(values.shape[1] for values in embeddings)
        coordinates = np.stack(
            [pad_axes(np.pad(values, ((0, 0), (0, n_axes - values.shape[1])))) for values in embeddings]
        )
        cells = [make_cells(values) for values in coordinates]
        radii = np.stack([made.radii for made in cells])
        nearest_squares = np.full((*radii.shape, CELL_SIZE), np.inf)
        # Padding of the last cell has distance 0, so that it never counts.
        nearest_squares.reshape(len(embeddings), -1)[:, len(embeddings[0]) :] = 0.0
        self._cells = CoverageCells(
            coordinates.reshape(*coordinates.shape[:2], -1, AXES_PER_STAGE),
            np.stack([made.members for made in cells]),
            np.stack([made.centers for made in cells]),
            radii,
            # Padding counts nothing, whatever its weight.
            np.stack([values[made.indices] for values, made in zip(weights, cells, strict=True)]),
            np.array(usual_distances),
            power,
            nearest_squares,
            np.full(radii.shape, np.inf),
            nearest_squares.copy(),
            np.full(len(embeddings[0]), -1, dtype=np.int64),
            np.empty((len(embeddings[0]), MAX_KNOWN_TERMS), dtype=np.int32),
            np.empty((len(embeddings[0]), MAX_KNOWN_TERMS)),
        )
        for index in selected:
            self.add(index)
        self.gains = np.empty(len(embeddings[0]))
        coverage_kernels.fill_gains(self.gains, self._cells)

    def pop_best_candidate(self) -> int | None:
        """Return the scenario that lowers the coverage sum most, the first if tied; None if no scenario is left.

        Each scenario is returned only once. Only the largest gains are computed again, since gains never rise.
        """
        index = int(coverage_kernels.find_best_candidate(self.gains, self._cells))
        if index < 0:
            return None
        self.gains[index] = -np.inf
        return index

    def add(self, index: int) -> None:
        """Add the scenario with this index to the selection."""
        coverage_kernels.add_to_selection(index, self._cells)
