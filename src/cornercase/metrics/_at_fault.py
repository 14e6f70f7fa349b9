"""Determine whether a collision is the ego's fault, as far as its motion shows it."""

from __future__ import annotations

from typing import Final

import numpy as np

from cornercase._common.geometry.boxes import box_axes, box_corners, project_on_axes
from cornercase._common.typing import FloatArray
from cornercase.recordings import Collision, Recording

MIN_CLOSING_SPEED: Final = 0.1
"""Smallest closing speed of the ego in m/s at which it is at fault."""


def is_at_fault(recording: Recording, ego: str, collision: Collision) -> bool:
    """Whether a collision is the ego's fault; True as well if the motion at contact is unknown.

    Before contact the boxes have a gap along the direction of some of their sides. The direction in which this gap
    closes last is that of the contact. The ego is at fault if it moves in this direction, towards the other entity,
    with at least 0.1 m/s. So it is not at fault if it stands, or is hit from behind or from the side. In a head-on
    collision it is at fault if it moves. Right of way is not considered, since a recording does not contain it.
    """
    (other,) = (name for name in collision.entities if name != ego)
    i, j = recording.entity_index(ego), recording.entity_index(other)
    # The last sample before the contact, and the first one of it.
    index = int(np.abs(recording.time - collision.time).argmin())
    before, at_contact = max(index - 1, 0), index
    direction = _contact_direction(recording, i, j, before, at_contact)
    speed = recording.speed[i, [before, at_contact]]
    heading = recording.heading[i, [before, at_contact]]
    closing_speed = speed * (direction[0] * np.cos(heading) + direction[1] * np.sin(heading))
    if not np.isfinite(closing_speed).any():
        return True
    return bool(np.nanmax(closing_speed) >= MIN_CLOSING_SPEED)


def _contact_direction(
    recording: Recording, ego_index: int, other_index: int, earlier_index: int, contact_index: int
) -> FloatArray:
    """Unit vector, shape (2,), from the ego towards the other entity, in the direction of their contact."""
    boxes_before, boxes_now = (
        tuple(_entity_box_corners(recording, k, at) for k in (ego_index, other_index))
        for at in (earlier_index, contact_index)
    )
    axes = np.concatenate([box_axes(boxes_now[0]), box_axes(boxes_now[1])])
    # In both directions, as the other may be on either side.
    axes = np.concatenate([axes, -axes])
    gap_before, gap_now = (_gaps_along_axes(axes, *boxes) for boxes in (boxes_before, boxes_now))
    closing = gap_before - gap_now
    is_closing = (gap_before > 0.0) & (closing > 0.0)
    if is_closing.any():
        # Fraction of the time step after which the gap is closed.
        share = np.where(is_closing, gap_before / np.where(closing > 0.0, closing, 1.0), -np.inf)
        return np.asarray(axes[int(share.argmax())])
    # They touch from the beginning: use the direction of least overlap.
    return np.asarray(axes[int(gap_now.argmax())])


def _gaps_along_axes(axes: FloatArray, ego: FloatArray, other: FloatArray) -> FloatArray:
    """Gap between two boxes along each axis in m, shape (n,); negative if the boxes overlap."""
    return np.asarray(project_on_axes(axes, other).min(-1) - project_on_axes(axes, ego).max(-1))


def _entity_box_corners(recording: Recording, entity_index: int, time_index: int) -> FloatArray:
    heading = recording.heading[entity_index, time_index]
    offset = recording.center_x[entity_index]
    x = recording.x[entity_index, time_index] + offset * np.cos(heading)
    y = recording.y[entity_index, time_index] + offset * np.sin(heading)
    return box_corners(x, y, heading, recording.length[entity_index], recording.width[entity_index])
