"""Where a track passes nearest to a place, compiled, for one scenario at a time."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator, call-arg, var-annotated"

from __future__ import annotations

import math

import numpy as np

from cornercase._common.addresses import floats_at
from cornercase._common.compiling import kernel
from cornercase.simulators.builtin.tracks import columns
from cornercase.simulators.builtin.tracks.lane_kernels import place_on_path

# A track may pass a point several times. So many of its nearest samples are compared; those whose distance is larger
# than the smallest by at most so many m count as passing, too.
_PASSES = 16
_SAME = 0.3
# Points lie no further out than this, in m.
_ANYWHERE = 1e12
# Every so many samples are looked at first; a power of two.
_COARSE = 64


@kernel(error_model="numpy", forceinline=True)
def nearest_on_lane(tracks, g, x, y, after):
    """Distance along a lane of its point nearest to a place.

    Parameters
    ----------
    tracks : Tracks
    g : int
        Row of the track.
    x, y : float
        m.
    after : float
        Where the track passes the place more than once, the first time after this distance in m counts.

    Returns
    -------
    float
        m.
    """
    return _nearest(
        tracks.address[g, columns.DISTANCE],
        tracks.address[g, columns.X],
        tracks.address[g, columns.Y],
        tracks.address[g, columns.HEADING],
        tracks.address[g, columns.CURVATURE],
        tracks.size[g],
        tracks.chord[g],
        x,
        y,
        after,
    )


@kernel(error_model="numpy", forceinline=True)
def nearest_on_line(tracks, g, n, x, y):
    """Distance along a line of its point nearest to a place.

    Parameters
    ----------
    tracks : Tracks
    g, n : int
        Row of the track, and scenario.
    x, y : float
        m.

    Returns
    -------
    float
        m.
    """
    count = tracks.size[g]
    begin = 8 * count * n
    return _nearest_leg(
        floats_at(tracks.address[g, columns.DISTANCE] + begin, count),
        floats_at(tracks.address[g, columns.X] + begin, count),
        floats_at(tracks.address[g, columns.Y] + begin, count),
        x,
        y,
    )


@kernel(error_model="numpy")
def nearest_on_path(addresses, count, chord, x, y, after):
    """Distances along a path of lanes of its points nearest to places.

    Parameters
    ----------
    addresses : ndarray of int64, shape (14,)
        Where the columns of the path lie.
    count : int
        Its samples.
    chord : float
        Largest gap between two samples that follow each other, in m.
    x, y : ndarray of float64, shape (R,)
        m.
    after : ndarray of float64, shape (R,)
        m; the first time after it counts.

    Returns
    -------
    ndarray of float64, shape (R,)
        m.
    """
    result = np.empty(len(x))
    for i in range(len(x)):
        result[i] = _nearest(
            addresses[columns.DISTANCE],
            addresses[columns.X],
            addresses[columns.Y],
            addresses[columns.HEADING],
            addresses[columns.CURVATURE],
            count,
            chord,
            x[i],
            y[i],
            after[i],
        )
    return result


@kernel(error_model="numpy")
def _nearest(distances, xs, ys, headings, curvatures, count, chord, x, y, after):
    distance, px, py = floats_at(distances, count), floats_at(xs, count), floats_at(ys, count)
    if not (abs(x) < _ANYWHERE and abs(y) < _ANYWHERE):
        x, y = px[0], py[0]
    gaps, samples = np.empty(_PASSES), np.empty(_PASSES, dtype=np.int64)
    known = _closest(px, py, count, chord, x, y, gaps, samples)
    far, step = gaps[0] + _SAME, distance[1]
    # Of several passes the next one counts.
    least, ahead = math.inf, math.inf
    for i in range(known):
        if gaps[i] <= far:
            place = distance[samples[i]]
            least = min(least, place)
            if place >= after - 1.0:
                ahead = min(ahead, place)
    least = ahead if ahead < math.inf else least
    best = 0
    for i in range(known):
        # At an end of the track, all the nearest samples may lie on one side.
        if gaps[i] <= far and least <= distance[samples[i]] < least + _PASSES * step:
            best = samples[i]
            break
    # Between samples, which are close together, the point is projected on the tangent.
    at_x, at_y, heading = place_on_path(distances, xs, ys, headings, curvatures, count, distance[best], 0.0)
    beyond = (x - at_x) * math.cos(heading) + (y - at_y) * math.sin(heading)
    return distance[best] + min(max(beyond, -step), step)


@kernel(error_model="numpy")
def _closest(px, py, count, chord, x, y, gaps, samples):
    """Fill in the nearest samples, the nearest first, and return how many these are."""
    limit, known, most = _bound(px, py, count, x, y), 0, min(_PASSES, count)
    i = 0
    while i < count:
        gap = math.sqrt((px[i] - x) * (px[i] - x) + (py[i] - y) * (py[i] - y))
        if gap > limit:
            # The gap to none of so many that follow can be so small.
            i += max(int(min((gap - limit) / chord, count)), 1)
            continue
        if known < most or gap < gaps[known - 1]:
            known = min(known + 1, most)
            k = known - 1
            while k > 0 and gaps[k - 1] > gap:
                gaps[k], samples[k] = gaps[k - 1], samples[k - 1]
                k -= 1
            gaps[k], samples[k] = gap, i
            if known == most:
                limit = min(limit, gaps[known - 1])
        i += 1
    return known


@kernel(error_model="numpy")
def _bound(px, py, count, x, y):
    """A gap that as many samples as are looked for do not exceed."""
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
    # So much that rounding leaves none of them out.
    return math.sqrt(least) * (1.0 + 1e-12)


@kernel(error_model="numpy")
def _nearest_leg(distance, px, py, x, y):
    best, least, share = 0, math.inf, math.nan if math.isnan(x + y) else 0.0
    for leg in range(px.size - 1):
        dx, dy = px[leg + 1] - px[leg], py[leg + 1] - py[leg]
        part = ((x - px[leg]) * dx + (y - py[leg]) * dy) / max(dx * dx + dy * dy, 1e-30)
        part = min(max(part, 0.0), 1.0)
        gap = math.hypot(px[leg] + part * dx - x, py[leg] + part * dy - y)
        if gap < least:
            best, least, share = leg, gap, part
    return distance[best] + share * (distance[best + 1] - distance[best])
