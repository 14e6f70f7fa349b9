"""Recordings of two or more that meet, written by hand."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from cornercase.recordings import Recording

TIMES = np.arange(0.0, 20.05, 0.1)
NORTH = math.pi / 2


def entity(x, y, heading, *speeds, kind="car", length=4.0, width=2.0, exists=(-1.0, 99.0)):
    """One that goes straight, with speeds given as (time, speed)."""
    speed = np.interp(TIMES, *np.transpose(speeds))
    way = np.append(0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(TIMES)))
    there = np.where(np.abs(TIMES - np.mean(exists)) <= np.ptp(exists) / 2.0, 1.0, np.nan)
    return {
        "x": there * (x + way * math.cos(heading)),
        "y": there * (y + way * math.sin(heading)),
        "heading": there * heading,
        "speed": there * speed,
        "acceleration": there * np.gradient(speed, TIMES),
        "kind": kind,
        "length": length,
        "width": width,
    }


def recording(*collisions, until=20.0, **entities):
    rows: list[Any] = list(entities.values())
    shown = until + 1e-9 >= TIMES
    motion: dict[str, Any] = {
        key: np.array([one[key][shown] for one in rows]) for key in ("x", "y", "heading", "speed", "acceleration")
    }
    return Recording(
        time=TIMES[shown],
        names=tuple(entities),
        object_types=tuple(one["kind"] for one in rows),
        **motion,
        length=np.array([one["length"] for one in rows]),
        width=np.array([one["width"] for one in rows]),
        center_x=np.zeros(len(rows)),
        collisions=collisions,
    )


def walker(exists=(-1.0, 99.0), y=-6.0):
    """A pedestrian who goes north across the ego's way at x = 50."""
    return entity(50.0, y, NORTH, (0, 1.5), kind="pedestrian", length=0.6, width=0.6, exists=exists)


CROSSES = walker()
PASSES = entity(0.0, 0.0, 0.0, (0, 20.0))
