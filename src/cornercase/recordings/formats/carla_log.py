"""Files of CARLA's recorder."""

from __future__ import annotations

import math
import struct
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from cornercase._common.errors import InputError
from cornercase._common.files import read_file
from cornercase.recordings.recording import Collision, Recording
from cornercase.recordings.samples import EntitySamples, box_center, recording_of

_FRAME, _ADDED, _REMOVED, _COLLISIONS, _POSITIONS, _BOXES = 0, 2, 3, 5, 6, 13
_VEHICLE, _WALKER = 1, 2
_MAGIC: Final = b"CARLA_RECORDER"
_CM: Final = 0.01
# Largest file in bytes: ten minutes of a thousand actors.
_LARGEST: Final = 1_000_000_000


@dataclass
class _Actor:
    name: str
    kind: str
    box: tuple[float, float, float, float] | None = None
    """Center ahead and to the right of the actor's origin, half length, half width, in m."""
    places: list[tuple[float, float, float, float]] = field(default_factory=list)
    """Time in s, x and y in m, and heading in rad."""


def read_carla_log(path: Path | str) -> Recording:
    """Read a file of CARLA's recorder (0.9.13 and later, which store boxes), without CARLA.

    Vehicles and walkers are named by their role if it is unique (``hero``), else by type and number. Reference points
    are the box centers; y and headings change their sign, since CARLA's axes are left-handed.
    """
    path = Path(path)
    data = read_file(path, _LARGEST)
    if not data[4:].startswith(_MAGIC):
        raise InputError(f"{path}: is not a file of CARLA's recorder.")
    try:
        actors, touched = _actors(data)
    except (struct.error, UnicodeDecodeError, IndexError) as error:
        raise InputError(f"{path}: is cut off or damaged; record it again.") from error
    roles = [actor.name.partition(" ")[0] for actor in actors]
    often = Counter(roles)
    tracks: dict[str, EntitySamples] = {}
    names: dict[str, str] = {}
    for actor, role in zip(actors, roles, strict=True):
        if not actor.places or actor.box is None:
            continue
        names[actor.name] = role if often[role] == 1 else actor.name
        ahead, right, length, width = actor.box
        track = EntitySamples(actor.kind, 2.0 * length, 2.0 * width)
        for time, x, y, heading in actor.places:
            track.samples[time] = (*box_center(x, y, heading, ahead, -right), heading, math.nan, math.nan)
        tracks[names[actor.name]] = track
    order = {name: k for k, name in enumerate(tracks)}
    collisions: dict[frozenset[str], Collision] = {}
    for time, a, b in touched:
        if a in names and b in names:
            first, second = sorted((names[a], names[b]), key=order.__getitem__)
            collisions.setdefault(frozenset((a, b)), Collision(time, (first, second)))
    return recording_of(path, tracks, sorted(collisions.values(), key=lambda collision: collision.time))


def _actors(data: bytes) -> tuple[list[_Actor], list[tuple[float, str, str]]]:
    """Return all actors, and the collisions between them."""
    # Header: version, magic, date, name of the map.
    _, at = _text(data, 2 + 2 + len(_MAGIC) + 8)
    present: dict[int, _Actor] = {}
    everyone: list[_Actor] = []
    touched: list[tuple[float, str, str]] = []
    time = 0.0
    while at < len(data):
        kind, size = struct.unpack_from("<BI", data, at)
        packet = data[at + 5 : at + 5 + size]
        if len(packet) < size:
            raise IndexError("cut off")
        at += 5 + size
        if kind == _FRAME:
            _, _, time = struct.unpack_from("<Qdd", packet)
        elif kind == _ADDED:
            for number, actor in _added(packet):
                present[number] = actor
                everyone.append(actor)
        elif kind == _REMOVED:
            (count,) = struct.unpack_from("<H", packet)
            for number in struct.unpack_from(f"<{count}I", packet, 2):
                present.pop(number, None)
        elif kind == _POSITIONS:
            for number, x, y, _, _, _, yaw in _rows(packet, "<I6f"):
                if number in present:
                    pose = (time, x * _CM, -y * _CM, -math.radians(yaw))
                    present[number].places.append(pose)
        elif kind == _COLLISIONS:
            for _, a, b, *_ in _rows(packet, "<III2?"):
                if a in present and b in present:
                    touched.append((time, present[a].name, present[b].name))
        elif kind == _BOXES:
            for number, ahead, right, _, length, width, _ in _rows(packet, "<I6f"):
                if number in present and present[number].box is None and math.isfinite(length):
                    present[number].box = (ahead * _CM, right * _CM, length * _CM, width * _CM)
    return everyone, touched


def _added(packet: bytes) -> list[tuple[int, _Actor]]:
    """Return the vehicles and walkers among new actors."""
    (count,), at, actors = struct.unpack_from("<H", packet), 2, []
    for _ in range(count):
        number, sort = struct.unpack_from("<IB", packet, at)
        # Skip position, rotation, and number of the blueprint.
        kind, at = _text(packet, at + 5 + 28)
        (attributes,), at = struct.unpack_from("<H", packet, at), at + 2
        values = {}
        for _ in range(attributes):
            key, at = _text(packet, at + 1)
            values[key], at = _text(packet, at)
        if sort in (_VEHICLE, _WALKER):
            role = values.get("role_name", "")
            name = role if role and role not in ("autopilot", "scenario", "default", "background") else kind
            actors.append((number, _Actor(f"{name} {number}", "car" if sort == _VEHICLE else "pedestrian")))
    return actors


def _rows(packet: bytes, form: str) -> list[Any]:
    (count,) = struct.unpack_from("<H", packet)
    size = struct.calcsize(form)
    return [struct.unpack_from(form, packet, 2 + k * size) for k in range(count)]


def _text(data: bytes, at: int) -> tuple[str, int]:
    (size,) = struct.unpack_from("<H", data, at)
    text = data[at + 2 : at + 2 + size]
    if len(text) < size:
        raise IndexError("cut off")
    return text.decode("utf-8"), at + 2 + size
