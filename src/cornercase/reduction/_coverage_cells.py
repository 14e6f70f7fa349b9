"""Coverage sums for embedded scenarios, computed by cells (groups) of nearby scenarios."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from cornercase._common.typing import FloatArray, IntArray
from cornercase.reduction import _coverage_kernels as coverage_kernels
from cornercase.reduction._coverage_kernels import AXES_PER_STAGE, CELL_SIZE, MAX_KNOWN_TERMS, CoverageCells


class CellCoverageSums:
    """Coverage sum: weighted sum of powers of the distances to the nearest selected scenario, over all clusterings.

    `embeddings`, shape (n, p) each, are coordinates by clustering; distances are squared Euclidean. `usual_distances`
    are the units of the distances; `power` is 2 or 3. At least one scenario is selected. `gains`, shape (n,), is by how
    much each scenario would lower the sum, as of the last computation; the true gain can only be less.
    """

    def __init__(
        self,
        embeddings: Sequence[FloatArray],
        usual_distances: Sequence[float],
        weights: Sequence[FloatArray],
        power: int,
        selected: Sequence[int],
    ) -> None:
        dimensions = -(-max(values.shape[1] for values in embeddings) // AXES_PER_STAGE) * AXES_PER_STAGE
        coordinates = np.stack([np.pad(values, ((0, 0), (0, dimensions - values.shape[1]))) for values in embeddings])
        orders = [_group_into_cells(values) for values in coordinates]
        cells = np.stack([values[order] for values, order in zip(coordinates, orders, strict=True)])
        first = cells[..., :AXES_PER_STAGE]
        centres = first.mean(axis=2)
        radii = np.sqrt(((first - centres[:, :, None]) ** 2).sum(axis=3).max(axis=2))
        nearest_squares = np.full(cells.shape[:3], np.inf)
        # Padding of the last cell has distance 0, so that it never counts.
        nearest_squares.reshape(len(embeddings), -1)[:, len(embeddings[0]) :] = 0.0
        self._cells = CoverageCells(
            coordinates.reshape(len(embeddings), -1, dimensions // AXES_PER_STAGE, AXES_PER_STAGE),
            np.ascontiguousarray(cells.transpose(0, 1, 3, 2)).reshape(
                *cells.shape[:2], dimensions // AXES_PER_STAGE, AXES_PER_STAGE, CELL_SIZE
            ),
            np.ascontiguousarray(centres.transpose(0, 2, 1)),
            radii * (1.0 + 1e-9),
            np.stack([values[order] for values, order in zip(weights, orders, strict=True)]),
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
        """Return the scenario that lowers the sum most, the first if tied, only once each; None if there is no other.

        Only the largest gains are computed again, since gains never rise.
        """
        index = int(coverage_kernels.find_best_candidate(self.gains, self._cells))
        if index < 0:
            return None
        self.gains[index] = -np.inf
        return index

    def add(self, index: int) -> None:
        """Add a scenario to the selection."""
        coverage_kernels.add_to_selection(index, self._cells)


def _group_into_cells(coordinates: FloatArray) -> IntArray:
    """Group scenarios into cells; return indices, shape (cells, CELL). The last scenario pads the last cell."""
    order = cKDTree(coordinates[:, :AXES_PER_STAGE], leafsize=CELL_SIZE).indices
    count = -(-len(order) // CELL_SIZE)
    return np.append(order, np.full(count * CELL_SIZE - len(order), order[-1])).reshape(count, CELL_SIZE)
