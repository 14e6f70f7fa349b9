"""Recording of the motion of entities while ScenarioRunner runs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, NamedTuple, Self

from cornercase._common.errors import SimulationError, SimulatorError
from cornercase.recordings import Collision, Recording
from cornercase.recordings._from_samples import EntitySamples, box_center_from_point, recording_from_samples
from cornercase.simulators.carla._server import CarlaServer

_OBJECT_TYPES: Final = {"motorcycle": "motorbike", "Bus": "bus"}


class _TrackedFrame(NamedTuple):
    number: int
    time_step: float
    poses: dict[int, tuple[float, ...]]
    """x and y in m, heading in rad, speed in m/s, by the number of the actor."""


class _Box(NamedTuple):
    """Object type of an actor, and length and width of its bounding box in m.

    `ahead` and `left`: how far the centre of the box is ahead of the actor's origin and to its left, in m.
    """

    object_type: str
    length: float
    width: float
    ahead: float
    left: float

    @classmethod
    def from_actor(cls, actor: Mapping[str, Any]) -> Self:
        object_type = actor["base_type"]
        if actor["type_id"].startswith("walker."):
            object_type = "pedestrian"
        elif not actor["type_id"].startswith("vehicle."):
            object_type = "misc"
        object_type = _OBJECT_TYPES.get(object_type, object_type or "car")
        return cls(object_type, *(actor[key] for key in ("length", "width", "ahead", "left")))


class EntityTracker:
    """Recorder of the motion of all entities in a run, by the client of a CARLA server.

    `names`: role names of the actors. `ego`: actor whose removal ends the run. `time_step`: time between frames in s.
    `external`: actor that may exist before the run. `missing`: entities that the last search did not find.
    `first_frame` and `last_frame`: numbers of the frames in which the storyboard begins and ends.
    """

    def __init__(
        self, server: CarlaServer, names: Sequence[str], ego: str, time_step: float, *, external: str = ""
    ) -> None:
        self._server, self._external = server, external
        self._names, self._ego, self._time_step = tuple(names), ego, time_step
        self.missing = self._names
        self.first_frame: int | None = None
        self.last_frame: float = math.inf
        self._ids: dict[str, int] = {}
        self._entity_ids: frozenset[int] = frozenset()
        self._boxes: dict[str, _Box] = {}
        self._frames: list[_TrackedFrame] = []
        self._contacts: list[tuple[int, int, int]] = []

    def __enter__(self) -> Self:
        self._server.track(self._names, self._external)
        return self

    def __exit__(self, *exception: object) -> None:
        # The server may be gone by now.
        with suppress(SimulatorError):
            self._server.end_tracking()

    def update(self) -> None:
        """Fetch what was recorded since the last call, and look for entities that were not found before."""
        news = self._server.poll()
        self._frames += [
            _TrackedFrame(number, step, {int(actor): tuple(pose) for actor, pose in poses.items()})
            for number, step, poses in news["frames"]
        ]
        self._contacts += [(frame, actor, other) for frame, actor, other in news["contacts"]]
        self.missing = tuple(news["missing"])
        if news["entities"]:
            self._boxes = {name: _Box.from_actor(actor) for name, actor in news["entities"].items()}
            self._ids = {name: actor["id"] for name, actor in news["entities"].items()}
            self._entity_ids = frozenset(self._ids.values())

    @property
    def has_collision(self) -> bool:
        """True if two entities have collided, and the frame of the collision has been received.

        A frame may be received later than its collision.
        """
        newest = max((frame.number for frame in self._frames), default=0) if self._contacts else 0
        return any(number <= newest and {a, b} <= self._entity_ids for number, a, b in self._contacts)

    @property
    def n_frames(self) -> int:
        """Number of frames received so far, including frames before the run."""
        return len(self._frames)

    def progress(self) -> tuple[float, bool]:
        """Return the elapsed time of the run in s, and whether the ego has been removed."""
        run = self._select_frames_of_run()
        if not run:
            return 0.0, False
        return (len(run) - 1) * self._time_step, self._ids[self._ego] not in self._frames[-1].poses

    def describe_early_end(self) -> str:
        """Return, as a clause, why the recording ends before the storyboard; empty if it does not."""
        run = self._select_frames_of_run()
        later = [] if not run else [frame for frame in self._frames if run[-1].number < frame.number <= self.last_frame]
        # ScenarioRunner may remove entities at the end of the last frame.
        if len({frame.number for frame in later}) < 2:
            return ""
        following, instant = min(later, key=lambda frame: frame.number), len(run) * self._time_step
        if self._ids[self._ego] not in following.poses:
            return f"{self._ego} was removed from CARLA at t = {instant:g} s, while the storyboard went on"
        return f"the time step of CARLA became {following.time_step:g} s at t = {instant:g} s"

    def make_recording(self, source: Path, duration: float, until_collision: bool) -> Recording:
        """Create the recording, up to `duration` s, or to the first collision if `until_collision`.

        `source` names the run in messages.
        """
        frames = self._select_frames_of_run()
        if len(frames) < 2:
            raise SimulationError(f"CARLA sent fewer than two frames with all of {', '.join(self._names)}")
        first = frames[0].number
        collisions = self._first_collisions({frame.number for frame in frames})
        last = first + round(duration / self._time_step)
        if until_collision and collisions:
            last = min(last, collisions[0][0])
        tracks = {}
        for name, number in self._ids.items():
            box = self._boxes[name]
            tracks[name] = track = EntitySamples(box.object_type, box.length, box.width)
            for frame in frames:
                if frame.number <= last and number in frame.poses:
                    x, y, heading, speed = frame.poses[number]
                    center = box_center_from_point(x, y, heading, box.ahead, box.left)
                    track.samples[(frame.number - first) * self._time_step] = (*center, heading, speed, math.nan)
        collisions_until_end = [
            Collision((number - first) * self._time_step, pair) for number, pair in collisions if number <= last
        ]
        return recording_from_samples(source, tracks, collisions_until_end)

    def _select_frames_of_run(self) -> list[_TrackedFrame]:
        """Return the frames of the run, from the start of the storyboard to its end.

        They end earlier if the ego is removed, or if the time step changes. Raises `SimulatorError` if a frame in
        between is missing.
        """
        if self.first_frame is None or not self._ids:
            return []
        ego = self._ids[self._ego]
        run: list[_TrackedFrame] = []
        # The server may send a frame again when its settings change, with the new settings or without entities.
        for _, frame in sorted({frame.number: frame for frame in reversed(self._frames)}.items()):
            if not self.first_frame <= frame.number <= self.last_frame:
                continue
            # When ScenarioRunner ends, it removes the entities and leaves synchronous mode.
            if ego not in frame.poses or (run and abs(frame.time_step - self._time_step) > 1e-6):
                break
            if run and frame.number != run[-1].number + 1:
                raise SimulatorError(f"CARLA did not send {frame.number - run[-1].number - 1} of the frames")
            run.append(frame)
        if len(run) > 1:
            # The storyboard sets the first speeds in this frame, so they are there in the next one.
            speeds = {actor: pose[3] for actor, pose in run[1].poses.items()}
            poses = {actor: (*pose[:3], speeds.get(actor, pose[3])) for actor, pose in run[0].poses.items()}
            run[0] = run[0]._replace(poses=poses)
        return run

    def _first_collisions(self, frames: set[int]) -> list[tuple[int, tuple[str, str]]]:
        """Return the number of the first frame in which two entities touch, and their names, for each such pair."""
        names = {number: name for name, number in self._ids.items()}
        first: dict[tuple[str, str], int] = {}
        for frame, a, b in sorted(self._contacts):
            if frame in frames and a in names and b in names and a != b:
                first_name, second_name = sorted((names[a], names[b]), key=self._names.index)
                first.setdefault((first_name, second_name), frame)
        return sorted((frame, pair) for pair, frame in first.items())
