"""Two or more road users on given paths, recorded until the first two of them touch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cornercase.metrics._geometry.boxes import boxes_touch_over_time
from cornercase.recordings import Collision, Recording

STEP = 0.05
CAR, PEDESTRIAN = ("car", 4.0, 2.0), ("pedestrian", 0.6, 0.6)


def straight(x, y, heading, speed, kind=CAR, until=8.0):
    """Drive straight on; `speed` is a number, or a function of time."""
    time = STEP * np.arange(round(until / STEP) + 1)
    speeds = np.broadcast_to(np.asarray(speed(time) if callable(speed) else speed, float), time.shape)
    driven = np.append(0.0, np.cumsum(0.5 * (speeds[1:] + speeds[:-1]) * STEP))
    heading = np.full(len(time), float(heading))
    return kind, time, x + driven * np.cos(heading), y + driven * np.sin(heading), heading, speeds


def moved(road_user, sideways, begin, end):
    """Let somebody move sideways, positive to the left, evenly between two times in s."""
    kind, time, x, y, heading, speed = road_user
    share = np.clip((time - begin) / (end - begin), 0.0, 1.0)
    rate = np.where((time >= begin) & (time <= end), sideways / (end - begin), 0.0)
    x, y = x - sideways * share * np.sin(heading), y + sideways * share * np.cos(heading)
    return kind, time, x, y, heading + np.arctan2(rate, np.maximum(np.abs(speed), 1e-6)), speed


def crash(ego, other, *more) -> Recording:
    """Record until the ego and the other touch, which they have to."""
    users = (ego, other, *more)
    names = ("Ego", "Other", *(f"Third{k}" for k in range(len(more))))
    x, y, heading, speed = (np.array([user[k] for user in users]) for k in (2, 3, 4, 5))
    recording = Recording(
        time=ego[1], names=names, object_types=tuple(user[0][0] for user in users),
        x=x, y=y, heading=heading, speed=speed, acceleration=np.gradient(speed, ego[1], axis=1),
        length=np.array([user[0][1] for user in users]), width=np.array([user[0][2] for user in users]),
        center_x=np.zeros(len(users)),
    )  # fmt: skip
    touches = boxes_touch_over_time(recording, "Ego", "Other")
    assert touches.any(), "they do not touch"
    last = int(touches.argmax())
    cut = {name: getattr(recording, name)[:, : last + 1] for name in ("x", "y", "heading", "speed", "acceleration")}
    hit = Collision(float(recording.time[last]), ("Ego", "Other"))
    return replace(recording, time=recording.time[: last + 1], collisions=(hit,), **cut)


def swapped(recording: Recording) -> Recording:
    """Let both change roles."""
    names = ("Other", "Ego", *recording.names[2:])
    (hit,) = recording.collisions
    return replace(recording, names=names, collisions=(Collision(hit.time, ("Other", "Ego")),))


def turned(recording: Recording, angle: float, mirror: bool = False) -> Recording:
    """Turn the scene by an angle in rad, after mirroring it."""
    x, y, heading = recording.x, recording.y, recording.heading
    if mirror:
        y, heading = -y, -heading
    cos, sin = np.cos(angle), np.sin(angle)
    return replace(recording, x=cos * x - sin * y, y=sin * x + cos * y, heading=heading + angle)
