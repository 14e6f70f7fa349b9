"""A second client that records the motion of entities while ScenarioRunner runs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, NamedTuple, Self

from cornercase._common.errors import SimulationError, SimulatorError
from cornercase.recordings import Collision, Recording
from cornercase.recordings._from_samples import EntitySamples, box_center_from_point, recording_from_samples

_OBJECT_TYPES: Final = {"motorcycle": "motorbike", "Bus": "bus"}
_COLLISION_SENSOR: Final = "sensor.other.collision"


class _TrackedFrame(NamedTuple):
    number: int
    time_step: float
    poses: dict[int, tuple[float, float, float, float]]
    """x and y in m, heading in rad, speed in m/s, by the number of the actor."""


class EntityTracker:
    """Records the motion of all entities in a run, from the first frame in which all of them exist.

    `client` is a separate CARLA client, `names` are the role names of the actors, and `time_step` is the time between
    frames in s. The run ends when the actor `ego` is removed. `missing` lists entities that the last search did not
    find. CARLA's left-handed axes are converted: y and headings change sign.
    """

    def __init__(self, client: Any, names: Sequence[str], ego: str, time_step: float) -> None:
        import carla

        self._carla, self._client = carla, client
        self._names, self._ego, self._time_step = tuple(names), ego, time_step
        self.missing = self._names
        self._world = client.get_world()
        self._earlier_actor_ids = {actor.id for actor in self._world.get_actors()}
        self._ids: dict[str, int] = {}
        self._entity_ids: frozenset[int] = frozenset()
        self._boxes: dict[str, tuple[str, float, float, float, float]] = {}
        self._sensors: list[Any] = []
        self._frames: list[_TrackedFrame] = []
        self._contacts: list[tuple[int, int, int]] = []
        self._callback = self._world.on_tick(self._store_frame)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        # The server may be gone by now.
        with suppress(RuntimeError):
            self._world.remove_on_tick(self._callback)
        for sensor in self._sensors:
            with suppress(RuntimeError):
                sensor.stop()
                sensor.destroy()

    def _store_frame(self, snapshot: Any) -> None:
        """Store a frame; CARLA's client calls this in its own thread."""
        entity_ids, poses = self._entity_ids, {}
        for actor in snapshot:
            # Until the entities are found, record all new actors.
            if actor.id in self._earlier_actor_ids or (entity_ids and actor.id not in entity_ids):
                continue
            transform, velocity = actor.get_transform(), actor.get_velocity()
            heading = -math.radians(transform.rotation.yaw)
            speed = velocity.x * math.cos(heading) - velocity.y * math.sin(heading)
            poses[actor.id] = (transform.location.x, -transform.location.y, heading, speed)
        self._frames.append(_TrackedFrame(snapshot.timestamp.frame, snapshot.timestamp.delta_seconds, poses))

    def find_entities(self) -> None:
        """Search for entities that were not found before."""
        if self._ids:
            return
        world = self._client.get_world()
        actors = {}
        for actor in world.get_actors():
            name = actor.attributes.get("role_name", "")
            if name in self._names and actor.id not in self._earlier_actor_ids:
                actors[name] = actor
        self.missing = tuple(name for name in self._names if name not in actors)
        if self.missing:
            return
        # Read now, since the server forgets removed actors.
        self._boxes = {name: _box_of(actors[name]) for name in self._names}
        blueprint = world.get_blueprint_library().find(_COLLISION_SENSOR)
        for actor in actors.values():
            sensor = world.spawn_actor(blueprint, self._carla.Transform(), attach_to=actor)
            sensor.listen(self._store_collision)
            self._sensors.append(sensor)
        self._ids = {name: actors[name].id for name in self._names}
        self._entity_ids = frozenset(self._ids.values())

    def _store_collision(self, event: Any) -> None:
        if event.other_actor is not None:
            self._contacts.append((event.frame, event.actor.id, event.other_actor.id))

    @property
    def has_collision(self) -> bool:
        """Whether two entities have collided."""
        return any({a, b} <= self._entity_ids for _, a, b in self._contacts)

    @property
    def n_frames(self) -> int:
        """Number of frames received so far, including frames before the run."""
        return len(self._frames)

    def progress(self) -> tuple[float, bool]:
        """Return the elapsed time of the run in s, and whether the ego has been removed."""
        run = self._run_frames()
        if not run:
            return 0.0, False
        return (len(run) - 1) * self._time_step, self._ids[self._ego] not in self._frames[-1].poses

    def make_recording(self, source: Path, duration: float, until_collision: bool) -> Recording:
        """Create the recording, up to `duration` s or the first collision; `source` names the run in messages."""
        frames = self._run_frames()
        if len(frames) < 2:
            raise SimulationError(f"CARLA showed no two frames with all of {', '.join(self._names)}")
        first = frames[0].number
        collisions = self._first_collisions({frame.number for frame in frames})
        last = first + round(duration / self._time_step)
        if until_collision and collisions:
            last = min(last, collisions[0][0])
        tracks = {}
        for name, number in self._ids.items():
            object_type, length, width, ahead, right = self._boxes[name]
            tracks[name] = track = EntitySamples(object_type, length, width)
            for frame in frames:
                if frame.number <= last and number in frame.poses:
                    x, y, heading, speed = frame.poses[number]
                    # The offset points to the right of the vehicle, also after the conversion of axes.
                    center = box_center_from_point(x, y, heading, ahead, -right)
                    track.samples[(frame.number - first) * self._time_step] = (*center, heading, speed, math.nan)
        collisions_until_end = [
            Collision((number - first) * self._time_step, pair) for number, pair in collisions if number <= last
        ]
        return recording_from_samples(source, tracks, collisions_until_end)

    def _run_frames(self) -> list[_TrackedFrame]:
        """Return frames at equal time steps, from the first with all entities to the last with the ego."""
        if not self._ids:
            return []
        ego = self._ids[self._ego]
        frames = sorted({frame.number: frame for frame in self._frames}.values(), key=lambda frame: frame.number)
        first_index = next((k for k, frame in enumerate(frames) if self._entity_ids <= frame.poses.keys()), len(frames))
        run: list[_TrackedFrame] = []
        for frame in frames[first_index:]:
            # When ScenarioRunner ends, it removes the entities and leaves synchronous mode.
            if ego not in frame.poses or (run and abs(frame.time_step - self._time_step) > 1e-6):
                break
            if run and frame.number != run[-1].number + 1:
                raise SimulatorError(f"{frame.number - run[-1].number - 1} frames did not come from CARLA")
            run.append(frame)
        return run

    def _first_collisions(self, frames: set[int]) -> list[tuple[int, tuple[str, str]]]:
        """Return the index of the first frame in which each pair of entities touches, and the pair, sorted."""
        names = {number: name for name, number in self._ids.items()}
        first: dict[tuple[str, str], int] = {}
        for frame, a, b in sorted(self._contacts):
            if frame in frames and a in names and b in names and a != b:
                first_name, second_name = sorted((names[a], names[b]), key=self._names.index)
                first.setdefault((first_name, second_name), frame)
        return sorted((frame, pair) for pair, frame in first.items())


def _box_of(actor: Any) -> tuple[str, float, float, float, float]:
    """Return object type, box length and width in m, and the offset of the box center ahead and to the right, in m."""
    object_type = actor.attributes.get("base_type", "car")
    if actor.type_id.startswith("walker."):
        object_type = "pedestrian"
    elif not actor.type_id.startswith("vehicle."):
        object_type = "misc"
    box = actor.bounding_box
    return (
        _OBJECT_TYPES.get(object_type, object_type or "car"),
        2 * box.extent.x,
        2 * box.extent.y,
        box.location.x,
        box.location.y,
    )
