"""Files of CARLA's recorder."""

from __future__ import annotations

import math
import struct
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from cornercase._common.errors import InputError
from cornercase._common.io.files import read_file
from cornercase.recordings._from_samples import EntitySamples, box_center_from_point, recording_from_samples
from cornercase.recordings._recording import Collision, Recording

_FRAME_PACKET, _ACTORS_ADDED_PACKET, _ACTORS_REMOVED_PACKET, _COLLISIONS_PACKET, _POSITIONS_PACKET, _BOXES_PACKET = (
    0,
    2,
    3,
    5,
    6,
    13,
)
_VEHICLE_ACTOR, _WALKER_ACTOR = 1, 2
_MAGIC: Final = b"CARLA_RECORDER"
_METRES_PER_CM: Final = 0.01
# Largest file in bytes: ten minutes of a thousand actors.
_MAX_FILE_SIZE: Final = 1_000_000_000


@dataclass
class _Actor:
    name: str
    object_type: str
    box: tuple[float, float, float, float] | None = None
    """Center ahead and to the right of the actor's origin, half length, half width, in m."""
    poses: list[tuple[float, float, float, float]] = field(default_factory=list)
    """Time in s, x and y in m, and heading in rad."""


def read_carla_log(path: Path | str) -> Recording:
    """Read a file of CARLA's recorder (0.9.13 or later, which stores boxes); CARLA itself is not needed.

    Vehicles and walkers are named by their role, such as ``hero``, or by their type if they have no role or one of
    ``autopilot``, ``scenario``, ``default`` and ``background``. If several have the same name, the number of the actor
    follows. Reference points are the box centers. CARLA's axes are left-handed, so y and headings change sign.
    """
    path = Path(path)
    data = read_file(path, _MAX_FILE_SIZE)
    if not data[4:].startswith(_MAGIC):
        raise InputError(f"{path}: is not a file of CARLA's recorder.")
    try:
        actors, touched = _parse_actors_and_collisions(data)
    except (struct.error, UnicodeDecodeError, IndexError) as error:
        raise InputError(f"{path}: is cut off or damaged; record it again.") from error
    # A role may have spaces, too, or end in a number like that of an actor.
    roles = [actor.name.rpartition(" ")[0] for actor in actors]
    often = Counter([*roles, *(actor.name for actor in actors)])
    tracks: dict[str, EntitySamples] = {}
    names: dict[str, str] = {}
    for actor, role in zip(actors, roles, strict=True):
        if not actor.poses or actor.box is None:
            continue
        names[actor.name] = role if often[role] == 1 else actor.name
        ahead, right, length, width = actor.box
        track = EntitySamples(actor.object_type, 2.0 * length, 2.0 * width)
        for time, x, y, heading in actor.poses:
            track.samples[time] = (*box_center_from_point(x, y, heading, ahead, -right), heading, math.nan, math.nan)
        tracks[names[actor.name]] = track
    order = {name: k for k, name in enumerate(tracks)}
    collisions: dict[frozenset[str], Collision] = {}
    for time, a, b in touched:
        if a in names and b in names:
            first, second = sorted((names[a], names[b]), key=order.__getitem__)
            collisions.setdefault(frozenset((a, b)), Collision(time, (first, second)))
    return recording_from_samples(path, tracks, sorted(collisions.values(), key=lambda collision: collision.time))


def _parse_actors_and_collisions(data: bytes) -> tuple[list[_Actor], list[tuple[float, str, str]]]:
    """Return all vehicles and walkers, and the collisions between them."""
    # Header: version, magic, date, name of the map.
    _, at = _read_text(data, 2 + 2 + len(_MAGIC) + 8)
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
        if kind == _FRAME_PACKET:
            _, _, time = struct.unpack_from("<Qdd", packet)
        elif kind == _ACTORS_ADDED_PACKET:
            for number, actor in _parse_added_actors(packet):
                present[number] = actor
                everyone.append(actor)
        elif kind == _ACTORS_REMOVED_PACKET:
            (count,) = struct.unpack_from("<H", packet)
            for number in struct.unpack_from(f"<{count}I", packet, 2):
                present.pop(number, None)
        elif kind == _POSITIONS_PACKET:
            for number, x, y, _, _, _, yaw in _unpack_rows(packet, "<I6f"):
                if number in present:
                    pose = (time, x * _METRES_PER_CM, -y * _METRES_PER_CM, -math.radians(yaw))
                    present[number].poses.append(pose)
        elif kind == _COLLISIONS_PACKET:
            for _, a, b, *_ in _unpack_rows(packet, "<III2?"):
                if a in present and b in present:
                    touched.append((time, present[a].name, present[b].name))
        elif kind == _BOXES_PACKET:
            for number, ahead, right, _, length, width, _ in _unpack_rows(packet, "<I6f"):
                if number in present and present[number].box is None and math.isfinite(length):
                    present[number].box = (
                        ahead * _METRES_PER_CM,
                        right * _METRES_PER_CM,
                        length * _METRES_PER_CM,
                        width * _METRES_PER_CM,
                    )
    return everyone, touched


def _parse_added_actors(packet: bytes) -> list[tuple[int, _Actor]]:
    """Return the vehicles and walkers in a packet of new actors."""
    (count,), at, actors = struct.unpack_from("<H", packet), 2, []
    for _ in range(count):
        number, sort = struct.unpack_from("<IB", packet, at)
        # Skip position, rotation, and number of the blueprint.
        kind, at = _read_text(packet, at + 5 + 28)
        (attributes,), at = struct.unpack_from("<H", packet, at), at + 2
        values = {}
        for _ in range(attributes):
            key, at = _read_text(packet, at + 1)
            values[key], at = _read_text(packet, at)
        if sort in (_VEHICLE_ACTOR, _WALKER_ACTOR):
            role = values.get("role_name", "")
            name = role if role and role not in ("autopilot", "scenario", "default", "background") else kind
            actors.append((number, _Actor(f"{name} {number}", "car" if sort == _VEHICLE_ACTOR else "pedestrian")))
    return actors


def _unpack_rows(packet: bytes, struct_format: str) -> list[Any]:
    (count,) = struct.unpack_from("<H", packet)
    size = struct.calcsize(struct_format)
    return [struct.unpack_from(struct_format, packet, 2 + k * size) for k in range(count)]


def _read_text(data: bytes, offset: int) -> tuple[str, int]:
    (size,) = struct.unpack_from("<H", data, offset)
    text = data[offset + 2 : offset + 2 + size]
    if len(text) < size:
        raise IndexError("cut off")
    return text.decode("utf-8"), offset + 2 + size
