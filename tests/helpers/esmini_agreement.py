"""How far a recording agrees with one of esmini, within the limits that count as the same."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt

from cornercase.recordings import Recording

Floats = npt.NDArray[np.float64]
# Time, x, y, heading and speed of each entity, a row for each instant.
Tracks = Mapping[str, Floats]

LIMITS = {"position": 0.25, "heading": 0.05, "speed": 0.25, "end": 0.15}
UNITS = {"position": "m", "heading": "rad", "speed": "m/s", "end": "s"}


def tracks_of_file(path: Path) -> dict[str, Floats]:
    """Tracks of a CSV file of esmini's motion."""
    tracks: dict[str, list[list[float]]] = {}
    with open(path, newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            values = [float(row[key] or "nan") for key in ("time", "x", "y", "heading", "speed")]
            if np.isfinite(values[:3]).all():
                track = tracks.setdefault(row["entity"], [])
                # The frame in which a storyboard stops is written too, at the time of the one before.
                if not track or values[0] > track[-1][0]:
                    track.append(values)
    return {name: np.array(track) for name, track in tracks.items()}


def tracks_of(recording: Recording) -> dict[str, Floats]:
    """Tracks of a recording, without entities that never exist."""
    tracks = {}
    for k, name in enumerate(recording.names):
        there = np.isfinite(recording.x[k])
        if there.any():
            rows = (recording.time, recording.x[k], recording.y[k], recording.heading[k], recording.speed[k])
            tracks[name] = np.stack(rows, axis=1)[there]
    return tracks


def last_instant(tracks: Tracks) -> float:
    """When the last of the entities is seen for the last time, in s."""
    return max(float(track[-1, 0]) for track in tracks.values())


def errors(expected: Floats, found: Floats) -> dict[str, float]:
    """Largest errors of one entity at the instants that both have, and how far apart they end."""
    shared = expected[expected[:, 0] <= min(found[-1, 0], expected[-1, 0]) + 1e-9]
    x, y, heading, speed = (
        np.interp(shared[:, 0], found[:, 0], one)
        for one in (found[:, 1], found[:, 2], np.unwrap(found[:, 3]), found[:, 4])
    )
    turn = np.abs((shared[:, 3] - heading + np.pi) % (2 * np.pi) - np.pi)
    return {
        "position": float(np.hypot(shared[:, 1] - x, shared[:, 2] - y).max(initial=0.0)),
        "heading": float(turn.max(initial=0.0)),
        "speed": float(np.abs(shared[:, 4] - speed).max(initial=0.0)),
        "end": float(abs(found[-1, 0] - expected[-1, 0])),
    }


def disagreement(expected: Tracks, recording: Recording) -> str:
    """What of the first entity that is beyond the limits differs, in a few words; empty where all agree."""
    found = tracks_of(recording)
    for name, track in expected.items():
        if name not in found:
            return f"{name}: is not there"
        worst = errors(track, found[name])
        off = [f"{key} {worst[key]:.3g} {UNITS[key]}" for key, limit in LIMITS.items() if worst[key] > limit]
        if off:
            return f"{name}: {', '.join(off)}"
    return ""
