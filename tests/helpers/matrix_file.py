"""A distance matrix in a file, in so small squares that a few series have several of them."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from cornercase.dtw._distance_matrix import _subtract_common_mean, _validate_series
from cornercase.dtw._in_memory import DtwSettings
from cornercase.dtw._matrix_file import FloatMap, fill_matrix_file

SIDE: Final = 16
"""Series per side of a square."""


def fill_small_squares(
    series: Any,
    out: Any,
    *,
    resume: bool = False,
    client: Any = None,
    local_cost: str = "euclidean",
    window: int | None = None,
    dtype: str = "float64",
) -> FloatMap:
    """Fill a file as `distance_matrix` does with `out`, in smaller squares."""
    settings = DtwSettings(local_cost == "squared", window, np.dtype(dtype), 1, "cpu")
    return fill_matrix_file(
        _subtract_common_mean(_validate_series(series), settings.dtype, len(series)),
        out,
        resume=resume,
        settings=settings,
        report_progress=lambda cells: None,
        client=client,
        side=SIDE,
    )
