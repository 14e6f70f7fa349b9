"""Products of matrices in double precision by SciPy's BLAS, which make use of what is known of them.

NumPy and SciPy each bring a BLAS of their own; a product with a triangular matrix, or of a matrix with its transpose,
takes half the sums of another product.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg.blas import dgemm, dsyrk, dtrmm

from cornercase._common.typing import FloatArray


def lower_times(lower: FloatArray, right: FloatArray) -> FloatArray:
    """Multiply a lower triangular matrix with another one.

    Parameters
    ----------
    lower : ndarray of float64, shape (n, n)
        What stands above its diagonal is not looked at.
    right : ndarray of float64, shape (n, m)

    Returns
    -------
    ndarray of float64, shape (n, m)
    """
    # BLAS takes columns one after the other: matrices that lie row by row go in as their transposes, uncopied.
    if lower.flags.f_contiguous:
        return np.asarray(dtrmm(1.0, lower, right.T, side=1, lower=1, trans_a=1)).T
    return np.asarray(dtrmm(1.0, lower.T, right.T, side=1, lower=0)).T


def times_lower_transposed(left: FloatArray, lower: FloatArray) -> FloatArray:
    """Multiply a matrix with the transpose of a lower triangular one.

    Parameters
    ----------
    left : ndarray of float64, shape (m, n)
    lower : ndarray of float64, shape (n, n)
        What stands above its diagonal is not looked at.

    Returns
    -------
    ndarray of float64, shape (m, n)
    """
    return lower_times(lower, left.T).T


def times_transposed(left: FloatArray, right: FloatArray) -> FloatArray:
    """Multiply a matrix with the transpose of another one.

    Parameters
    ----------
    left : ndarray of float64, shape (n, k)
    right : ndarray of float64, shape (m, k)

    Returns
    -------
    ndarray of float64, shape (n, m)
    """
    return np.asarray(dgemm(1.0, left, right, trans_b=1))


def products_of_rows(rows: FloatArray) -> FloatArray:
    """Multiply a matrix with its transpose; only the lower half is computed.

    Parameters
    ----------
    rows : ndarray of float64, shape (n, k)

    Returns
    -------
    ndarray of float64, shape (n, n)
        Zero above the diagonal.
    """
    if rows.flags.f_contiguous:
        return np.asarray(dsyrk(1.0, rows, lower=1))
    return np.asarray(dsyrk(1.0, rows.T, trans=1, lower=1))
