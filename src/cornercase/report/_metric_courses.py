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
    65535 stands for a missing value.
    """
    present = [course for course in courses if course is not None]
    low = min((float(np.nanmin(course)) for course in present), default=0.0)
    high = max((float(np.nanmax(course)) for course in present), default=1.0)
    codes = np.full((len(courses), COURSE_POINTS), _MAX_CODE + 1, dtype="<u2")
    for k, course in enumerate(courses):
        if course is not None:
            codes[k] = np.rint((course - low) / max(high - low, 1e-12) * _MAX_CODE)
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
