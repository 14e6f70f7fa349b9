"""Products of structured matrices in double precision, by SciPy's BLAS.

A product with a triangular matrix, or of a matrix with its transpose, takes half the operations of a general product.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg.blas import dgemm, dsyrk, dtrmm

from cornercase._common.typing import FloatArray


def multiply_lower_triangular(lower: FloatArray, right: FloatArray) -> FloatArray:
    """Multiply a lower triangular matrix with another matrix; entries above the diagonal of `lower` are not read."""
    # BLAS is column-major: row-major matrices are passed as their transposes, without a copy.
    if lower.flags.f_contiguous:
        return np.asarray(dtrmm(1.0, lower, right.T, side=1, lower=1, trans_a=1)).T
    return np.asarray(dtrmm(1.0, lower.T, right.T, side=1, lower=0)).T


def multiply_by_lower_transposed(left: FloatArray, lower: FloatArray) -> FloatArray:
    """Multiply a matrix with the transpose of `lower`; entries above the diagonal of `lower` are not read."""
    return multiply_lower_triangular(lower, left.T).T


def multiply_by_transposed(left: FloatArray, right: FloatArray) -> FloatArray:
    """Multiply a matrix (n, k) with the transpose of a matrix (m, k)."""
    return np.asarray(dgemm(1.0, left, right, trans_b=1))


def gram_lower_half(rows: FloatArray) -> FloatArray:
    """Return the lower half of `rows @ rows.T`, with zeros above the diagonal."""
    if rows.flags.f_contiguous:
        return np.asarray(dsyrk(1.0, rows, lower=1))
    return np.asarray(dsyrk(1.0, rows.T, trans=1, lower=1))
