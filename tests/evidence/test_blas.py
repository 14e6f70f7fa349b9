"""Matrix products, compared with NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from cornercase.evidence.gp._triangular_products import (
    gram_lower_half,
    multiply_by_lower_transposed,
    multiply_by_transposed,
    multiply_lower_triangular,
)


@pytest.mark.parametrize("order", ["C", "F"])
def test_products_are_those_of_numpy_however_matrices_lie_in_memory(order):
    rng = np.random.default_rng(0)
    square, left, right = (np.asarray(rng.normal(size=size), order=order) for size in ((7, 7), (5, 7), (7, 3)))
    lower = np.tril(square)
    # The part above the diagonal is not read.
    np.testing.assert_allclose(multiply_lower_triangular(square, right), lower @ right, atol=1e-12)
    np.testing.assert_allclose(multiply_by_lower_transposed(left, square), left @ lower.T, atol=1e-12)
    np.testing.assert_allclose(multiply_by_transposed(left, square), left @ square.T, atol=1e-12)
    np.testing.assert_allclose(gram_lower_half(left), np.tril(left @ left.T), atol=1e-12)
