"""Project points onto tracks, for one scenario at a time."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator, call-arg, var-annotated"

from __future__ import annotations

import math

import numpy as np

from cornercase._common.addresses import floats_at
from cornercase._common.compiling import kernel
from cornercase.simulators.builtin.tracks import columns
from cornercase.simulators.builtin.tracks.lane_kernels import place_on_path

# A track may pass a point several times. Number of nearest samples that are compared, and the excess over the smallest
# gap, in m, up to which a sample counts as a pass.
_PASSES = 16
_SAME = 0.3
# m; no valid coordinate is larger.
_ANYWHERE = 1e12
# Stride of the first coarse search; a power of two.
_COARSE = 64


@kernel(error_model="numpy")
def nearest_on_path(addresses, count, chord, x, y, after):
    """Distances in m, shape (R,), along a lane path of its points nearest to (x, y), the first ones after `after`.

    `n_samples` is the number of samples, `max_sample_gap` the largest gap between consecutive samples in m.
    """
    result = np.empty(len(x))
    for i in range(len(x)):
        result[i] = _nearest(addresses, count, chord, x[i], y[i], after[i])
    return result


@kernel(error_model="numpy")
def _nearest(addresses, count, chord, x, y, after):
    distance = floats_at(addresses[columns.DISTANCE], count)
    px, py = floats_at(addresses[columns.X], count), floats_at(addresses[columns.Y], count)
    if not (abs(x) < _ANYWHERE and abs(y) < _ANYWHERE):
        x, y = px[0], py[0]
    gaps, samples = np.empty(_PASSES), np.empty(_PASSES, dtype=np.int64)
    n_found = _closest(px, py, count, chord, x, y, gaps, samples)
    max_gap, step = gaps[0] + _SAME, distance[1]
    # The next of several passes counts.
    first, first_ahead = math.inf, math.inf
    for i in range(n_found):
        if gaps[i] <= max_gap:
            sample_distance = distance[samples[i]]
            first = min(first, sample_distance)
            if sample_distance >= after - 1.0:
                first_ahead = min(first_ahead, sample_distance)
    first = first_ahead if first_ahead < math.inf else first
    best = 0
    for i in range(n_found):
        # At an end of the track, all nearest samples may be on one side.
        if gaps[i] <= max_gap and first <= distance[samples[i]] < first + _PASSES * step:
            best = samples[i]
            break
    # Samples are close together, so the point is projected onto the tangent between them.
    point_x, point_y, heading = place_on_path(addresses, count, distance[best], 0.0)
    beyond = (x - point_x) * math.cos(heading) + (y - point_y) * math.sin(heading)
    return distance[best] + min(max(beyond, -step), step)


@kernel(error_model="numpy")
def _closest(px, py, count, chord, x, y, gaps, samples):
    """Fill in the nearest samples, nearest first, and return their number."""
    limit, n_found, n_wanted = _bound(px, py, count, x, y), 0, min(_PASSES, count)
    i = 0
    while i < count:
        gap = math.sqrt((px[i] - x) * (px[i] - x) + (py[i] - y) * (py[i] - y))
        if gap > limit:
            # None of the next samples can be within the limit.
            i += max(int(min((gap - limit) / chord, count)), 1)
            continue
        if n_found < n_wanted or gap < gaps[n_found - 1]:
            n_found = min(n_found + 1, n_wanted)
            k = n_found - 1
            while k > 0 and gaps[k - 1] > gap:
                gaps[k], samples[k] = gaps[k - 1], samples[k - 1]
                k -= 1
            gaps[k], samples[k] = gap, i
            if n_found == n_wanted:
                limit = min(limit, gaps[n_found - 1])
        i += 1
    return n_found


@kernel(error_model="numpy")
def _bound(px, py, count, x, y):
    """Upper bound of the gap to the `_N_NEAREST_SAMPLES` nearest samples."""
    best, least = 0, math.inf
    for i in range(0, count, _COARSE):
        squared = (px[i] - x) * (px[i] - x) + (py[i] - y) * (py[i] - y)
        if squared < least:
            best, least = i, squared
    step = _COARSE // 2
    while step > 0:
        for i in (best - step, best + step):
            if 0 <= i < count:
                squared = (px[i] - x) * (px[i] - x) + (py[i] - y) * (py[i] - y)
                if squared < least:
                    best, least = i, squared
        step //= 2
    begin = min(max(best - _PASSES // 2, 0), max(count - _PASSES, 0))
    for i in range(begin, min(begin + _PASSES, count)):
        least = max(least, (px[i] - x) * (px[i] - x) + (py[i] - y) * (py[i] - y))
    # Slightly larger, so that rounding excludes none of them.
    return math.sqrt(least) * (1.0 + 1e-12)
