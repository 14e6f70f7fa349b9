"""Where a distance along a track of any kind that kernels know is, for one scenario at a time."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

from cornercase._common.compiling import kernel
from cornercase.simulators.builtin.tracks import pool
from cornercase.simulators.builtin.tracks.lane_kernels import place_on_lane
from cornercase.simulators.builtin.tracks.line_kernels import place_on_line


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def place_on(tracks, g, n, distance, offset):
    """Place at a distance along a track, whose kind is `LANE` or `LINE`.

    Parameters
    ----------
    tracks : Tracks
    g, n : int
        Row of the track, and scenario.
    distance, offset : float
        m along it, and to the left.

    Returns
    -------
    x, y, heading : float
        m, m, rad.
    """
    if tracks.kind[g] == pool.LANE:
        return place_on_lane(tracks, g, distance, offset)
    return place_on_line(tracks, g, n, distance, offset)
