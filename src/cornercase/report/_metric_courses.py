"""Encode courses (values of metrics over time) for the charts of the report page."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.study._scenario_digest import COURSE_POINTS

_MAX_CODE: Final = 65534


def encode_courses(courses: Sequence[FloatArray | None], time_spans: Sequence[tuple[float, float]]) -> dict[str, Any]:
    """Encode the resampled courses (values of one metric over time) of all scenarios as 16-bit integers.

    None stands for a scenario without a course. `time_spans` are begin and end of each recording in s. The integer
    65535 stands for a missing value, which is NaN in a course.
    """
    missing = np.full(COURSE_POINTS, np.nan)
    lines = [missing if course is None else course for course in courses]
    defined = [line for line in lines if not np.isnan(line).all()]
    low = min((float(np.nanmin(line)) for line in defined), default=0.0)
    high = max((float(np.nanmax(line)) for line in defined), default=1.0)
    codes = np.full((len(courses), COURSE_POINTS), _MAX_CODE + 1, dtype="<u2")
    for k, line in enumerate(lines):
        is_defined = ~np.isnan(line)
        codes[k, is_defined] = np.rint((line[is_defined] - low) / max(high - low, 1e-12) * _MAX_CODE)
    return {
        "points": COURSE_POINTS,
        "low": low,
        "high": high,
        "begin": [begin for begin, _ in time_spans],
        "end": [end for _, end in time_spans],
        "values": compress_to_base64(codes.tobytes()),
    }


def compress_to_base64(content: bytes) -> str:
    """Compress bytes with zlib and encode them in base64."""
    return base64.b64encode(zlib.compress(content, 9)).decode()
