"""Compiled projection on the unit simplex."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

from cornercase._common.numba.kernel import kernel


@kernel(error_model="numpy", _nrt=False)
def project_on_simplex(rows):
    """Move each row, in place, to the nearest point with nonnegative coordinates that sum to 1.

    C. Michelot, "A finite algorithm for finding the projection of a point onto the canonical simplex of R^n", 1986.
    """
    for i in range(len(rows)):
        row = rows[i]
        limit, count, n_positive = (row.sum() - 1.0) / len(row), len(row) + 1, len(row)
        # Coordinates up to the limit become 0, which raises the limit for the others. None exceeds it if all are huge.
        while 0 < n_positive < count:
            count, n_positive, total = n_positive, 0, -1.0
            for j in range(len(row)):
                if row[j] > limit:
                    total += row[j]
                    n_positive += 1
            if n_positive:
                limit = total / n_positive
        for j in range(len(row)):
            row[j] = max(row[j] - limit, 0.0)
