"""Program that loads maps and records all entities on a CARLA server, as a client of the server.

cornercase starts this program in ScenarioRunner's own Python (3.7 or later), which has CARLA's client, so it must not
import cornercase. Requests are lines of JSON on standard input: ``["method", argument, ...]``. For each request, the
program writes one line of JSON to standard output: ``{"result": ...}`` or ``{"error": "..."}``. Positions are in the
right-handed axes of scenarios.
"""

from __future__ import annotations

import json
import math
import os
import sys
from threading import Lock
from typing import Any

import carla

_COLLISION_SENSOR = "sensor.other.collision"
# Actors of runs: ScenarioRunner leaves the road's friction behind, and all of these if it is killed.
_OWN_ACTORS = ("vehicle.", "walker.", "sensor.", "controller.", "static.")
# Movable things of CARLA's own maps.
_MAP_ACTORS = "static.prop.mesh"


class Client:
    """Client of a CARLA server that executes the requests of cornercase."""

    def __init__(self) -> None:
        self._client: Any = None
        self._tracker: Tracker | None = None
        # Whether the server had been told to draw nothing.
        self._draws_not: bool | None = None

    def get_version(self) -> str:
        """Return the version of CARLA's client."""
        return str(carla.Client("127.0.0.1", 1).get_client_version())

    def connect(self, host: str, port: int, timeout: float) -> list[str]:
        """Connect to a server, with a time limit in s; return the versions of client and server."""
        self._client = carla.Client(host, port)
        self._client.set_timeout(timeout)
        return [self._client.get_client_version(), self._client.get_server_version()]

    def load_map(self, name: str, road: str, mesh: dict[str, Any], timeout: float, usual_timeout: float) -> list[str]:
        """Load the map `name` of CARLA, or a world generated from `road`, the text of a road file.

        Nothing is loaded if the server has this map or world already. If the server has no map of this name, return
        the names of its maps, else an empty list. `mesh`: parameters of the generated world. `timeout`: time limit for
        loading in s. `usual_timeout`: time limit for later calls in s.
        """
        loaded = self._client.get_world().get_map()
        if road and _strip_before_root(loaded.to_opendrive()) != road:
            self._client.set_timeout(timeout)
            self._client.generate_opendrive_world(road, carla.OpendriveGenerationParameters(**mesh))
        elif name and loaded.name.rpartition("/")[2] != name:
            available = sorted({path.rpartition("/")[2] for path in self._client.get_available_maps()})
            if name not in available:
                return available
            self._client.set_timeout(timeout)
            self._client.load_world(name)
        self._client.set_timeout(usual_timeout)
        return []

    def remove_actors(self, keep: str) -> None:
        """Remove actors that earlier runs have left, except the actor with the role name `keep` and its sensors."""
        actors = list(self._client.get_world().get_actors())
        external = [actor.id for actor in actors if keep and actor.attributes.get("role_name", "") == keep]
        for actor in actors:
            is_external = actor.id in external or (actor.parent is not None and actor.parent.id in external)
            if actor.type_id.startswith(_OWN_ACTORS) and actor.type_id != _MAP_ACTORS and not is_external:
                actor.destroy()

    def leave_synchronous_mode(self, renders: bool | None = None) -> None:
        """Leave synchronous mode: in it, the server would wait forever, since no client sends ticks any more.

        `renders`: whether the server draws pictures from now on; None restores the server's original setting.
        """
        world = self._client.get_world()
        settings = world.get_settings()
        if self._draws_not is None:
            self._draws_not = settings.no_rendering_mode
        draws_not = self._draws_not if renders is None else not renders
        if settings.synchronous_mode or settings.no_rendering_mode != draws_not:
            settings.synchronous_mode, settings.fixed_delta_seconds = False, None
            settings.no_rendering_mode = draws_not
            world.apply_settings(settings)

    def start_recorder(self, path: str) -> None:
        """Let CARLA's recorder write a recording into a file on the server's machine."""
        self._client.start_recorder(path, True)

    def stop_recorder(self) -> None:
        """Stop CARLA's recorder, so that it closes its file."""
        self._client.stop_recorder()
        # The server answers this only after it has closed the file.
        self._client.get_world().get_settings()

    def track(self, names: list[str], external: str) -> None:
        """Begin to record the actors whose role names are in `names`.

        Actors that exist already are ignored, except the actor with the role name `external`.
        """
        self.end_tracking()
        self._tracker = Tracker(self._client, names, external)

    def poll(self) -> dict[str, Any]:
        """Return what was recorded since the last call: states of the actors by time step, contacts, and entities."""
        assert self._tracker is not None
        return self._tracker.poll()

    def end_tracking(self) -> None:
        """Stop recording, and remove the collision sensors from the actors."""
        if self._tracker is not None:
            self._tracker.close()
        self._tracker = None


class Tracker:
    """Recorder of the motion and the collisions of actors; records from the next time step of the server on."""

    def __init__(self, client: Any, names: list[str], external: str) -> None:
        self._client, self._names = client, names
        self._lock = Lock()
        self._frames: list[tuple[int, float, dict[int, tuple[float, float, float, float]]]] = []
        self._contacts: list[tuple[int, int, int]] = []
        self._ids: list[int] = []
        self._sensors: list[Any] = []
        self._world = client.get_world()
        self._earlier_ids = {
            actor.id
            for actor in self._world.get_actors()
            if not external or actor.attributes.get("role_name", "") != external
        }
        self._callback = self._world.on_tick(self._store_frame)

    def poll(self) -> dict[str, Any]:
        """Return the states by time step and the contacts since the last call, and the names of missing actors.

        The first call that finds all actors also attaches collision sensors to the actors and returns their boxes.
        """
        missing, entities = self._find_entities() if not self._ids else ([], {})
        with self._lock:
            frames, contacts = self._frames, self._contacts
            self._frames, self._contacts = [], []
        return {"frames": frames, "contacts": contacts, "missing": missing, "entities": entities}

    def close(self) -> None:
        """Stop recording, and remove the collision sensors; an error because the server has ended is ignored."""
        try:
            self._world.remove_on_tick(self._callback)
            for sensor in self._sensors:
                sensor.stop()
                sensor.destroy()
        except RuntimeError:
            pass

    def _find_entities(self) -> tuple[list[str], dict[str, Any]]:
        actors: dict[str, Any] = {}
        world = self._client.get_world()
        for actor in world.get_actors():
            name = actor.attributes.get("role_name", "")
            is_new = name in self._names and actor.id not in self._earlier_ids
            # An agent may make another actor of the same name.
            if is_new and (name not in actors or actor.id < actors[name].id):
                actors[name] = actor
        missing = [name for name in self._names if name not in actors]
        if missing:
            return missing, {}
        # Read now, since the server forgets removed actors.
        entities = {name: _describe(actors[name]) for name in self._names}
        blueprint = world.get_blueprint_library().find(_COLLISION_SENSOR)
        for name in self._names:
            sensor = world.spawn_actor(blueprint, carla.Transform(), attach_to=actors[name])
            sensor.listen(self._store_contact)
            self._sensors.append(sensor)
        self._ids = [actors[name].id for name in self._names]
        return [], entities

    def _store_frame(self, snapshot: Any) -> None:
        """Store the states of recorded actors in one time step; CARLA's client calls this in a thread of the client."""
        poses = {}
        for actor in snapshot:
            # Until the entities are found, record all new actors.
            if actor.id in self._earlier_ids or (self._ids and actor.id not in self._ids):
                continue
            transform, velocity = actor.get_transform(), actor.get_velocity()
            # CARLA's axes are left-handed.
            heading = -math.radians(transform.rotation.yaw)
            speed = velocity.x * math.cos(heading) - velocity.y * math.sin(heading)
            poses[actor.id] = (transform.location.x, -transform.location.y, heading, speed)
        with self._lock:
            self._frames.append((snapshot.timestamp.frame, snapshot.timestamp.delta_seconds, poses))

    def _store_contact(self, event: Any) -> None:
        if event.other_actor is not None:
            with self._lock:
                self._contacts.append((event.frame, event.actor.id, event.other_actor.id))


def _describe(actor: Any) -> dict[str, Any]:
    """Return id, type and box of an actor; lengths in m, the centre of the box relative to the actor's origin."""
    box = actor.bounding_box
    return {
        "id": actor.id,
        "type_id": actor.type_id,
        "base_type": actor.attributes.get("base_type", ""),
        "length": 2.0 * box.extent.x,
        "width": 2.0 * box.extent.y,
        "ahead": box.location.x,
        "left": -box.location.y,
    }


def _strip_before_root(text: str) -> str:
    return text[text.find("<OpenDRIVE") :]


def main() -> None:
    """Answer requests until standard input ends."""
    # What CARLA's client prints must not be taken for an answer.
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    client = Client()
    for line in sys.stdin.buffer:
        method, *arguments = json.loads(line.decode("utf-8"))
        try:
            answer = {"result": getattr(client, method)(*arguments)}
        except RuntimeError as error:
            # CARLA's client raises this if the server is gone or does not answer in time.
            answer = {"error": str(error)}
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


if __name__ == "__main__":
    main()
