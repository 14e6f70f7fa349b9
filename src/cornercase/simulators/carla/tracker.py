"""A second client, which notes how the entities move while ScenarioRunner runs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, NamedTuple, Self

from cornercase._common.errors import SimulationError, SimulatorError
from cornercase.recordings import Collision, EntitySamples, Recording, box_center, recording_of

_KINDS: Final = {"motorcycle": "motorbike", "Bus": "bus"}
_SENSOR: Final = "sensor.other.collision"


class _Frame(NamedTuple):
    number: int
    delta: float
    places: dict[int, tuple[float, float, float, float]]
    """x and y in m, heading in rad, speed in m/s, by the number of the actor."""


class Tracker:
    """Notes all entities of a run, from the first frame in which all are there.

    CARLA's left-handed axes are turned: y and headings change their sign.

    Parameters
    ----------
    client : carla.Client
        Of its own, beside ScenarioRunner's.
    names : sequence of str
        Of the scenario's entities, which are the actors' role names.
    ego : str
        With it the run ends.
    time_step : float
        s between frames while the scenario runs.

    Attributes
    ----------
    missing : tuple of str
        Entities that were not there when they were last looked for.
    """

    def __init__(self, client: Any, names: Sequence[str], ego: str, time_step: float) -> None:
        import carla

        self._carla, self._client = carla, client
        self._names, self._ego, self._time_step = tuple(names), ego, time_step
        self.missing = self._names
        self._world = client.get_world()
        self._before = {actor.id for actor in self._world.get_actors()}
        self._ids: dict[str, int] = {}
        self._wanted: frozenset[int] = frozenset()
        self._bodies: dict[str, tuple[str, float, float, float, float]] = {}
        self._sensors: list[Any] = []
        self._frames: list[_Frame] = []
        self._touched: list[tuple[int, int, int]] = []
        self._callback = self._world.on_tick(self._note)

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

    def _note(self, snapshot: Any) -> None:
        """Store a frame; called from a thread of CARLA's client."""
        wanted, places = self._wanted, {}
        for actor in snapshot:
            # Until the entities are found, all actors are noted that were not there before.
            if actor.id in self._before or (wanted and actor.id not in wanted):
                continue
            transform, velocity = actor.get_transform(), actor.get_velocity()
            heading = -math.radians(transform.rotation.yaw)
            speed = velocity.x * math.cos(heading) - velocity.y * math.sin(heading)
            places[actor.id] = (transform.location.x, -transform.location.y, heading, speed)
        self._frames.append(_Frame(snapshot.timestamp.frame, snapshot.timestamp.delta_seconds, places))

    def look(self) -> None:
        """Find the entities, until all are there."""
        if self._ids:
            return
        world = self._client.get_world()
        found = {}
        for actor in world.get_actors():
            name = actor.attributes.get("role_name", "")
            if name in self._names and actor.id not in self._before:
                found[name] = actor
        self.missing = tuple(name for name in self._names if name not in found)
        if self.missing:
            return
        # Asked for now, as the server forgets actors that are gone.
        self._bodies = {name: _body(found[name]) for name in self._names}
        blueprint = world.get_blueprint_library().find(_SENSOR)
        for actor in found.values():
            sensor = world.spawn_actor(blueprint, self._carla.Transform(), attach_to=actor)
            sensor.listen(self._collide)
            self._sensors.append(sensor)
        self._ids = {name: found[name].id for name in self._names}
        self._wanted = frozenset(self._ids.values())

    def _collide(self, event: Any) -> None:
        if event.other_actor is not None:
            self._touched.append((event.frame, event.actor.id, event.other_actor.id))

    @property
    def collided(self) -> bool:
        """Whether two entities have collided."""
        return any({a, b} <= self._wanted for _, a, b in self._touched)

    @property
    def frames(self) -> int:
        """How many frames have come, of the run or before."""
        return len(self._frames)

    def progress(self) -> tuple[float, bool]:
        """Tell how far the run is.

        Returns
        -------
        time : float
            Of the run so far, in s.
        ended : bool
            Whether the ego was there and is gone.
        """
        run = self._run()
        if not run:
            return 0.0, False
        return (len(run) - 1) * self._time_step, self._ids[self._ego] not in self._frames[-1].places

    def recording(self, source: Path, duration: float, until_collision: bool) -> Recording:
        """Put together how the entities moved.

        Parameters
        ----------
        source : Path
            For messages.
        duration : float
            s after which nothing is taken.
        until_collision : bool
            Whether the first collision is the end.

        Returns
        -------
        Recording

        Raises
        ------
        SimulationError
            The entities were never there all at once.
        SimulatorError
            Frames are missing.
        """
        frames = self._run()
        if len(frames) < 2:
            raise SimulationError(f"CARLA showed no two frames with all of {', '.join(self._names)}")
        first = frames[0].number
        collisions = self._collisions({frame.number for frame in frames})
        last = first + round(duration / self._time_step)
        if until_collision and collisions:
            last = min(last, collisions[0][0])
        tracks = {}
        for name, number in self._ids.items():
            kind, length, width, ahead, right = self._bodies[name]
            tracks[name] = track = EntitySamples(kind, length, width)
            for frame in frames:
                if frame.number <= last and number in frame.places:
                    x, y, heading, speed = frame.places[number]
                    # The offset points to the right of the vehicle, also after CARLA's axes are turned.
                    place = box_center(x, y, heading, ahead, -right)
                    track.samples[(frame.number - first) * self._time_step] = (*place, heading, speed, math.nan)
        ended = [Collision((number - first) * self._time_step, pair) for number, pair in collisions if number <= last]
        return recording_of(source, tracks, ended)

    def _run(self) -> list[_Frame]:
        """Frames of the scenario, in equal steps: from the first with all entities on, as long as the ego exists."""
        if not self._ids:
            return []
        ego = self._ids[self._ego]
        frames = sorted({frame.number: frame for frame in self._frames}.values(), key=lambda frame: frame.number)
        begun = next((k for k, frame in enumerate(frames) if self._wanted <= frame.places.keys()), len(frames))
        run: list[_Frame] = []
        for frame in frames[begun:]:
            # When ScenarioRunner has ended, it removes the entities, and lets the server run at its own pace.
            if ego not in frame.places or (run and abs(frame.delta - self._time_step) > 1e-6):
                break
            if run and frame.number != run[-1].number + 1:
                raise SimulatorError(f"{frame.number - run[-1].number - 1} frames did not come from CARLA")
            run.append(frame)
        return run

    def _collisions(self, frames: set[int]) -> list[tuple[int, tuple[str, str]]]:
        """First frame in which each pair of entities touches, in order."""
        names = {number: name for name, number in self._ids.items()}
        first: dict[tuple[str, str], int] = {}
        for frame, a, b in sorted(self._touched):
            if frame in frames and a in names and b in names and a != b:
                one, other = sorted((names[a], names[b]), key=self._names.index)
                first.setdefault((one, other), frame)
        return sorted((frame, pair) for pair, frame in first.items())


def _body(actor: Any) -> tuple[str, float, float, float, float]:
    """Kind, length and width in m, and where the box's centre lies ahead and to the right of the origin."""
    kind = actor.attributes.get("base_type", "car")
    if actor.type_id.startswith("walker."):
        kind = "pedestrian"
    elif not actor.type_id.startswith("vehicle."):
        kind = "misc"
    box = actor.bounding_box
    return _KINDS.get(kind, kind or "car"), 2 * box.extent.x, 2 * box.extent.y, box.location.x, box.location.y
