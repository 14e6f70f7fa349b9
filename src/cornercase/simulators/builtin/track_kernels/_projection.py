"""Projection of points onto lane paths, in one scenario at a time."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator, call-arg, var-annotated"

from __future__ import annotations

import math

import numpy as np

from cornercase._common.numba.kernel import kernel
from cornercase._common.numba.pointers import floats_at_address
from cornercase.simulators.builtin.track_kernels import _track_layout as track_layout
from cornercase.simulators.builtin.track_kernels._lane_track import pose_on_lane_path

# A path may pass a point several times. Number of nearest samples that are compared, and the largest difference in m
# from the smallest gap for which a sample counts as a pass.
_N_NEAREST_SAMPLES = 16
_PASS_TOLERANCE = 0.3
# m; larger coordinates are invalid.
_MAX_COORDINATE = 1e12
# Stride of the first coarse search; a power of two.
_COARSE_STRIDE = 64


@kernel(interpreted_seconds=lambda *arguments: 1e-3 * len(arguments[-1]), error_model="numpy")
def project_on_lane_path(addresses, n_samples, max_sample_gap, x, y, after):
    """Return the distance along a lane path at which the path is nearest to each of R points, in m, shape (R,).

    If the path passes a point several times, the 16 samples nearest to the point are compared. The first one beyond
    `after` - 1 m decides which pass counts. If there is none, the first pass among them counts. With many passes, the
    right one may be missed. `addresses` are the memory addresses of the arrays of the path with `n_samples` samples.
    `max_sample_gap` is the largest distance between consecutive samples in m.
    """
    result = np.empty(len(x))
    for i in range(len(x)):
        result[i] = _project_on_samples(addresses, n_samples, max_sample_gap, x[i], y[i], after[i])
    return result


@kernel(error_model="numpy")
def _project_on_samples(addresses, n_samples, max_sample_gap, x, y, after):
    distance = floats_at_address(addresses[track_layout.DISTANCE], n_samples)
    px = floats_at_address(addresses[track_layout.X], n_samples)
    py = floats_at_address(addresses[track_layout.Y], n_samples)
    if not (abs(x) < _MAX_COORDINATE and abs(y) < _MAX_COORDINATE):
        x, y = px[0], py[0]
    gaps, samples = np.empty(_N_NEAREST_SAMPLES), np.empty(_N_NEAREST_SAMPLES, dtype=np.int64)
    n_found = _find_nearest_samples(px, py, n_samples, max_sample_gap, x, y, gaps, samples)
    max_gap, step = gaps[0] + _PASS_TOLERANCE, distance[1]
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
        if gaps[i] <= max_gap and first <= distance[samples[i]] < first + _N_NEAREST_SAMPLES * step:
            best = samples[i]
            break
    # Samples are close together, so the point is projected onto the tangent between them.
    point_x, point_y, heading = pose_on_lane_path(addresses, n_samples, distance[best], 0.0)
    beyond = (x - point_x) * math.cos(heading) + (y - point_y) * math.sin(heading)
    return distance[best] + min(max(beyond, -step), step)


@kernel(error_model="numpy")
def _find_nearest_samples(px, py, n_samples, max_sample_gap, x, y, gaps, samples):
    """Fill `samples` with the indices of the samples nearest to (x, y), and `gaps` with their distances in m.

    The nearest sample comes first. Returns how many samples were found, at most `_N_NEAREST_SAMPLES`.
    """
    limit, n_found, n_wanted = _upper_bound_of_gap(px, py, n_samples, x, y), 0, min(_N_NEAREST_SAMPLES, n_samples)
    i = 0
    while i < n_samples:
        gap = math.sqrt((px[i] - x) * (px[i] - x) + (py[i] - y) * (py[i] - y))
        if gap > limit:
            # None of the next samples can be within the limit.
            i += max(int(min((gap - limit) / max_sample_gap, n_samples)), 1)
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
def _upper_bound_of_gap(px, py, n_samples, x, y):
    """Return an upper bound in m of the distances from (x, y) to the `_N_NEAREST_SAMPLES` nearest samples of a path."""
    best, least = 0, math.inf
    for i in range(0, n_samples, _COARSE_STRIDE):
        squared = (px[i] - x) * (px[i] - x) + (py[i] - y) * (py[i] - y)
        if squared < least:
            best, least = i, squared
    step = _COARSE_STRIDE // 2
    while step > 0:
        for i in (best - step, best + step):
            if 0 <= i < n_samples:
                squared = (px[i] - x) * (px[i] - x) + (py[i] - y) * (py[i] - y)
                if squared < least:
                    best, least = i, squared
        step //= 2
    begin = min(max(best - _N_NEAREST_SAMPLES // 2, 0), max(n_samples - _N_NEAREST_SAMPLES, 0))
    for i in range(begin, min(begin + _N_NEAREST_SAMPLES, n_samples)):
        least = max(least, (px[i] - x) * (px[i] - x) + (py[i] - y) * (py[i] - y))
    # Slightly larger, so that rounding excludes none of them.
    return math.sqrt(least) * (1.0 + 1e-12)
