"""Whether a collision is the ego's fault, as far as its motion tells."""

from __future__ import annotations

from typing import Final

import numpy as np

from cornercase._common.geometry import box_axes, box_corners, project
from cornercase._common.typing import FloatArray
from cornercase.recordings import Collision, Recording

MOVING: Final = 0.1
"""Speed in m/s from which an entity drives into another."""


def is_at_fault(recording: Recording, ego: str, collision: Collision) -> bool:
    """Tell whether the ego drove into the other.

    Two boxes that are apart have a gap along one of their sides' directions; the one along which it closes last is the
    direction of the contact. The ego is at fault where it moves towards the other along it with 0.1 m/s or more: who
    is hit from behind, at its side, or while it stands is not. Where both drive into each other, as head-on, the ego is
    at fault too. Who had to give way is not asked, since a recording does not tell.

    Parameters
    ----------
    recording : Recording
    ego : str
    collision : Collision
        One of the ego.

    Returns
    -------
    bool
        True too where the motion at the contact is not known.
    """
    (other,) = (name for name in collision.entities if name != ego)
    i, j = recording.index(ego), recording.index(other)
    # The last instant before the contact and the first one of it, whatever the clock of the simulator is.
    nearest = int(np.abs(recording.time - collision.time).argmin())
    before, now = max(nearest - 1, 0), nearest
    direction = _direction(recording, i, j, before, now)
    speed = recording.speed[i, [before, now]]
    heading = recording.heading[i, [before, now]]
    towards = speed * (direction[0] * np.cos(heading) + direction[1] * np.sin(heading))
    if not np.isfinite(towards).any():
        return True
    return bool(np.nanmax(towards) >= MOVING)


def _direction(recording: Recording, i: int, j: int, before: int, now: int) -> FloatArray:
    """Unit vector from the ego to the other along which they come into contact, shape (2,)."""
    first, last = (tuple(_corners(recording, k, at) for k in (i, j)) for at in (before, now))
    axes = np.concatenate([box_axes(last[0]), box_axes(last[1])])
    # To both sides of each axis, as the other may be on either.
    axes = np.concatenate([axes, -axes])
    gap_before, gap_now = (_gaps(axes, *boxes) for boxes in (first, last))
    closing = gap_before - gap_now
    apart = (gap_before > 0.0) & (closing > 0.0)
    if apart.any():
        # Share of the time between both instants after which the gap is closed.
        share = np.where(apart, gap_before / np.where(closing > 0.0, closing, 1.0), -np.inf)
        return np.asarray(axes[int(share.argmax())])
    # They touch from the beginning: along the direction in which they overlap least.
    return np.asarray(axes[int(gap_now.argmax())])


def _gaps(axes: FloatArray, ego: FloatArray, other: FloatArray) -> FloatArray:
    """How far the other is beyond the ego along each axis in m, negative where they overlap, shape (n,)."""
    return np.asarray(project(axes, other).min(-1) - project(axes, ego).max(-1))


def _corners(recording: Recording, row: int, at: int) -> FloatArray:
    heading = recording.heading[row, at]
    ahead = recording.center_x[row]
    x = recording.x[row, at] + ahead * np.cos(heading)
    y = recording.y[row, at] + ahead * np.sin(heading)
    return box_corners(x, y, heading, recording.length[row], recording.width[row])
