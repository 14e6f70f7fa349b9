"""Courses as the lines that a page draws."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from cornercase._common.typing import Float32Array, FloatArray

COURSE_POINTS: Final = 48
"""Points of a course in the page's lines; the replay has all."""
_GREATEST: Final = 65534


def draw_course(time: FloatArray, course: Float32Array, lower_is_critical: bool) -> FloatArray:
    """Thin a course out to evenly spread times.

    Parameters
    ----------
    time : ndarray of float64, shape (T,)
        s.
    course : ndarray of float32, shape (T,)
        Capped.
    lower_is_critical : bool

    Returns
    -------
    ndarray of float64, shape (COURSE_POINTS,)
        With its most critical value at the time that is nearest to it, so that a course that is critical for an instant
        is drawn so.
    """
    begin, end = float(time[0]), float(time[-1])
    found = np.interp(np.linspace(begin, end, COURSE_POINTS), time, course)
    worst = int(course.argmin() if lower_is_critical else course.argmax())
    nearest = round((float(time[worst]) - begin) / (end - begin) * (COURSE_POINTS - 1)) if end > begin else 0
    found[nearest] = course[worst]
    return found


def pack_courses(courses: Sequence[FloatArray | None], spans: Sequence[tuple[float, float]]) -> dict[str, Any]:
    """Pack courses at evenly spread times of each scenario, as whole numbers of 16 bits.

    Parameters
    ----------
    courses : sequence of (ndarray of float64, shape (COURSE_POINTS,), or None), length n
        Of each scenario; None where there is none.
    spans : sequence of (float, float), length n
        Begin and end of each, in s.

    Returns
    -------
    dict of str to object
        What ``courses`` of the page's contents holds of a metric; 65535 stands for no value.
    """
    known = [one for one in courses if one is not None]
    low = min((float(np.nanmin(one)) for one in known), default=0.0)
    high = max((float(np.nanmax(one)) for one in known), default=1.0)
    found = np.full((len(courses), COURSE_POINTS), _GREATEST + 1, dtype="<u2")
    for k, one in enumerate(courses):
        if one is not None:
            found[k] = np.rint((one - low) / max(high - low, 1e-12) * _GREATEST)
    return {
        "points": COURSE_POINTS,
        "low": low,
        "high": high,
        "begin": [begin for begin, _ in spans],
        "end": [end for _, end in spans],
        "values": pack(found.tobytes()),
    }


def pack(data: bytes) -> str:
    """Compress bytes, and write them as text.

    Parameters
    ----------
    data : bytes
        The bytes.

    Returns
    -------
    str
        In zlib's format, in base64.
    """
    return base64.b64encode(zlib.compress(data, 9)).decode()
