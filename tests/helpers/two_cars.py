"""Recordings of two cars with a motion that is said."""

from __future__ import annotations

import numpy as np

from cornercase.recordings import Collision, Recording


def met(ego, other, collides=None, step=0.1) -> Recording:
    """Two cars, 4 m by 2 m about their reference points; each is x, y, heading and speed at each instant."""
    tracks = [np.array([np.broadcast_to(one, len(ego[0])) for one in each], dtype=float) for each in (ego, other)]
    x, y, heading, speed = np.stack(tracks, axis=1)
    return Recording(
        time=step * np.arange(len(ego[0])),
        names=("Ego", "Other"),
        object_types=("car", "car"),
        x=x,
        y=y,
        heading=heading,
        speed=speed,
        acceleration=np.zeros_like(x),
        length=np.full(2, 4.0),
        width=np.full(2, 2.0),
        center_x=np.zeros(2),
        collisions=() if collides is None else (Collision(collides, ("Ego", "Other")),),
    )
