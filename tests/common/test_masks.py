import numpy as np

from cornercase._common.masks import any_true


def test_a_mask_holds_anywhere_where_any_of_it_is_true():
    for mask in (
        np.zeros(0, dtype=bool),
        np.zeros(5, dtype=bool),
        np.array([False, True]),
        np.ones((2, 3), dtype=bool),
    ):
        assert any_true(mask) is bool(mask.any())
