"""Speaks CARLA's protocol, so that CARLA's own client takes it for a server: the protocol only, no physics to speak of.

Remote calls come by MessagePack on one port, snapshots and sensor events go out by a stream on the next. Vehicles follow
their controls as points with a heading; two of them collide when their boxes touch. Run it in a process of its own:

    python carla_server.py PORT ROAD.xodr [what goes wrong]
"""

from __future__ import annotations

import math
import os
import random
import socket
import struct
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgpack

# Numbers of the serializers in the registry of CARLA's clients, by their version where it matters.
COLLISION, WORLD = 0, {"0.9.13": 15, "0.9.15": 16, "0.9.16": 17}
IMU, RADAR = {"0.9.13": 4, "0.9.15": 5, "0.9.16": 5}, {"0.9.13": 8, "0.9.15": 9, "0.9.16": 9}
STATE_SIZE, HEADER_PAD = 119, 0
STEP = 0.05
VERSION = "0.9.16"
BOXES = {
    "vehicle.tesla.model3": (2.4, 1.0),
    "vehicle.carlamotors.carlacola": (2.6, 1.3),
    "vehicle.volkswagen.t2": (2.2, 1.0),
    "vehicle.kawasaki.ninja": (1.0, 0.4),
    "vehicle.diamondback.century": (0.8, 0.3),
    "walker.pedestrian.0001": (0.2, 0.2),
}


def value(content):
    return [[1, content]]


def refusal(text):
    return [[0, [text]]]


DONE = [[False]]


class Server:
    """One world with its actors."""

    def __init__(self, port, road, wrong=()):
        self.map = "OpenDriveMap"
        self.port, self.road, self.wrong = port, road, dict(one.partition("=")[::2] for one in wrong)
        self.frame, self.time, self.episode, self.next = 100, 0.0, 1, 200
        self.actors, self.subscribers, self.touching = {}, {}, set()
        self.settings: Any = [False, False, [False], True, 0.01, 10, 0.0, True, 3000.0, 2000.0, True]
        self.lock, self.log, self.versions, self.stepped = threading.RLock(), None, 0, 0
        self.late = 0.0
        if "random" in self.wrong:
            self._draw_fault(*self.wrong.pop("random").split(":"))

    def _draw_fault(self, folder, count):
        """Have one of a number of faults, which all servers with the same folder share; none if all have been."""
        for number in range(int(count)):
            try:
                handle = os.open(Path(folder) / f"fault {number}", os.O_CREAT | os.O_EXCL | os.O_WRONLY)
            except FileExistsError:
                continue
            # Whichever scenario meets it, some time after the start.
            dice = random.Random(number)
            tick = str(dice.randrange(1, 40))
            kind = ("die-at", "lose", "cut-at", "hang-at", "refuse", "late", "silent", "half")[number % 8]
            calls = ("get_map_data", "spawn_actor", "get_episode_settings")
            choices = {"refuse": "", "late": "", "silent": dice.choice(calls), "half": dice.choice(calls)}
            self.wrong[kind] = choices.get(kind, tick)
            os.write(handle, f"{kind} {self.wrong[kind]}".encode())
            os.close(handle)
            break
        if "refuse" in self.wrong:
            print("no GPU", flush=True)
            sys.exit(1)
        self.late = 0.2 if "late" in self.wrong else 0.0

    def serve(self):
        for target in (self._listen_calls, self._listen_streams, self._run_by_itself):
            threading.Thread(target=target, daemon=True).start()

    # The world

    @property
    def step(self):
        return self.settings[2][1] if len(self.settings[2]) > 1 else STEP

    def _run_by_itself(self):
        while True:
            time.sleep(STEP)
            if not self.settings[0]:
                self.tick()

    def tick(self):
        with self.lock:
            self.frame += 1
            self.time += self.step
            # Counted from where a scenario begins, however long its program takes to start.
            self.stepped += bool(self.settings[0])
            if self.stepped == int(self.wrong.get("die-at", -1)):
                os._exit(1)
            if self.stepped == int(self.wrong.get("hang-at", -1)):
                time.sleep(600)
            for actor in self.actors.values():
                actor.move(self.step)
            self._collide()
            if self.stepped != int(self.wrong.get("lose", -1)):
                self.push()
            if self.log is not None:
                self.log.frame(self.frame, self.step, self.actors)
            return self.frame

    def _collide(self):
        bodies = [actor for actor in self.actors.values() if actor.radius]
        for one in bodies:
            for other in bodies:
                pair = (one.number, other.number)
                if one is other or not touch(one, other) or "no-collisions" in self.wrong:
                    self.touching.discard(pair)
                    continue
                if pair not in self.touching and self.log is not None:
                    self.log.touch(*pair)
                self.touching.add(pair)
                for sensor in self.actors.values():
                    if sensor.parent == one.number and sensor.kind == "sensor.other.collision":
                        body = msgpack.packb([self.described(one), self.described(other), [100.0, 0.0, 0.0]])
                        self.send(sensor.number, self._header(COLLISION) + body)

    # Streams

    def token(self, stream):
        return struct.pack("<IHBB", stream, self.port + 1, 1, 1) + bytes([127, 0, 0, 1]) + bytes(12)

    def _listen_streams(self):
        for line in accepted(self.port + 1):
            with suppress(OSError, struct.error):
                (stream,) = struct.unpack("<I", line.recv(4))
                self.subscribers.setdefault(stream, []).append(line)
                if stream == 1:
                    with self.lock:
                        self.push()

    def send(self, stream, body):
        for line in self.subscribers.get(stream, ()):
            with suppress(OSError):
                line.sendall(struct.pack("<I", len(body)) + body)

    def _header(self, sensor):
        return struct.pack("<QQd6f", sensor, self.frame, self.time, *[0.0] * 6)

    def push(self):
        head = struct.pack("<Qdf3iI", self.episode, time.time(), self.step, 0, 0, 0, 0) + bytes(HEADER_PAD)
        body = b"".join(actor.state() for actor in self.actors.values())
        if self.stepped == int(self.wrong.get("cut-at", -1)):
            # Who comes later gets it whole.
            del self.wrong["cut-at"]
            body = body[:-7]
        version = self.wrong.get("version", VERSION)
        for actor in self.actors.values():
            if actor.kind == "sensor.other.imu":
                at_rest = msgpack.packb([[0.0, 0.0, 9.81], [0.0, 0.0, 0.0], 1.5])
                self.send(actor.number, self._header(IMU.get(version, 5)) + at_rest)
            elif actor.kind == "sensor.other.radar":
                self.send(actor.number, self._header(RADAR.get(version, 9)) + struct.pack("<4f", -3.0, 0.0, 0.1, 20.0))
        self.send(1, self._header(WORLD.get(version, 17)) + head + body)

    # Calls

    def _listen_calls(self):
        for line in accepted(self.port):
            threading.Thread(target=self._answer, args=(line,), daemon=True).start()

    def _answer(self, line):
        unpacker = msgpack.Unpacker(raw=False, unicode_errors="surrogateescape", strict_map_key=False)
        with suppress(OSError):
            while piece := line.recv(65536):
                unpacker.feed(piece)
                for message in unpacker:
                    number, name, arguments = message[1:] if message[0] == 0 else (None, *message[1:])
                    if self.wrong.get("silent") == name:
                        time.sleep(60)
                    if self.late and name != "tick_cue":
                        time.sleep(self.late)
                    result = self._call(name, arguments[1:])
                    if number is None:
                        continue
                    answer = msgpack.packb([1, number, None, result], use_bin_type=True)
                    if self.wrong.get("half") == name:
                        line.sendall(answer[: len(answer) // 2])
                        line.close()
                        return
                    line.sendall(answer)

    def _call(self, name, arguments):
        call = getattr(self, f"do_{name}", None)
        if call is None:
            plain = name.partition("_")[0] in ("set", "apply", "reset", "enable", "disable", "stop", "freeze", "draw")
            return DONE if plain else refusal(f"not known here: {name}")
        with self.lock:
            try:
                return call(*arguments)
            except KeyError as error:
                return refusal(f"no such actor: {error}")

    def described(self, actor):
        return [actor.number, actor.parent, actor.description, self.box(actor), bytes([10]), actor.token]

    def box(self, actor):
        half = (0.0, 0.0) if actor is None else BOXES.get(actor.kind, (0.0, 0.0))
        return [[float(self.wrong.get("box-ahead", 0.0)), 0.0, 0.7], [*half, 0.7], [0.0, 0.0, 0.0], 0]

    def do_version(self):
        self.versions += 1
        # Who waits for the server has its answer, and the next who asks gets none.
        if self.versions == 2 and "die-once" in self.wrong:
            with suppress(FileExistsError):
                Path(self.wrong["die-once"]).mkdir()
                os._exit(1)
        return value(self.wrong.get("version", VERSION))

    def do_get_episode_info(self):
        return value([self.episode, [self.token(1)]])

    def do_get_sensor_token(self, stream):
        return value([self.token(stream)])

    def do_get_episode_settings(self):
        return value(self.settings)

    def do_set_episode_settings(self, settings):
        self.settings = settings
        self.push()
        return value(self.frame)

    def do_get_map_info(self):
        return value([f"Carla/Maps/{self.map}", [[[1.0, 2.0, 3.0], [0.0, 90.0, 0.0]]]])

    def do_get_map_data(self):
        return value(self.road)

    def do_copy_opendrive_to_file(self, road, _):
        self.road = road
        return DONE

    def do_load_new_episode(self, name, *_):
        self.map = name.rpartition("/")[2]
        if self.map != "OpenDriveMap":
            self.road += f"<!-- {self.map} -->"
        self.episode += 1
        self.actors.clear()
        self.settings[0], self.settings[2] = False, [False]
        self.push()
        return DONE

    def do_tick_cue(self):
        return value(self.tick())

    def do_get_actor_definitions(self):
        def attribute(name, default, kind=3):
            return [name, kind, default, [default], True, False]

        def fixed(name, content, kind=3):
            return [name, kind, content, [], False, False]

        role = attribute("role_name", "autopilot")
        car = [role, attribute("color", "0,0,0", 4), fixed("number_of_wheels", "4", 2), fixed("base_type", "car")]
        kinds = [
            ("vehicle.tesla.model3", car),
            ("vehicle.carlamotors.carlacola", [*car[:-1], fixed("base_type", "truck")]),
            ("vehicle.volkswagen.t2", [*car[:-1], fixed("base_type", "van")]),
            ("vehicle.kawasaki.ninja", [*car[:-1], fixed("base_type", "motorcycle")]),
            ("vehicle.diamondback.century", [*car[:-1], fixed("base_type", "bicycle")]),
            ("static.prop.streetbarrier", [role]),
            ("static.prop.chainbarrier", [role]),
            ("walker.pedestrian.0001", [role]),
            ("sensor.other.collision", [role]),
            ("sensor.other.imu", [role]),
            ("sensor.other.radar", [role, attribute("horizontal_fov", "30", 2), attribute("range", "100", 2)]),
            (
                "static.trigger.friction",
                [role, *(attribute(f"extent_{a}", "1") for a in "xyz"), attribute("friction", "0")],
            ),
        ]
        return value([[k, name, name.replace(".", ","), attributes] for k, (name, attributes) in enumerate(kinds, 1)])

    def do_spawn_actor(self, description, transform):
        return value(self.described(self._spawn(description, transform)))

    def do_spawn_actor_with_parent(self, description, transform, parent, *_):
        actor = self._spawn(description, transform)
        actor.parent, actor.token = parent, self.token(actor.number)
        return value(self.described(actor))

    def _spawn(self, description, transform):
        self.next += 1
        actor = self.actors[self.next] = Actor(self.next, description, transform)
        actor.speed_limit = float(self.wrong.get("speed-limit", actor.speed_limit))
        if self.log is not None:
            self.log.added(self.actors[self.next])
        return self.actors[self.next]

    def do_get_actors_by_id(self, numbers):
        return value([self.described(self.actors[k]) for k in numbers if k in self.actors])

    def do_get_actor_bounding_box(self, number):
        return value(self.box(self.actors.get(number)))

    def do_destroy_actor(self, number):
        for gone in [number, *(k for k, actor in self.actors.items() if actor.parent == number)]:
            self.actors.pop(gone, None)
        return value(True)

    def do_apply_batch(self, commands, tick=False):
        answers = []
        for ((kind, content),) in commands:
            if kind == 0:
                answers.append(value(self._spawn(*content[:2]).number))
            else:
                if kind == 1:
                    self.do_destroy_actor(content[0])
                answers.append(value(content[0] if content else 0))
        if tick:
            self.tick()
        return answers

    def do_set_actor_location(self, number, location):
        self.actors[number].place[:3] = location
        return DONE

    def do_set_actor_transform(self, number, transform):
        self.actors[number].place = [*transform[0], *transform[1]]
        return DONE

    def do_set_actor_target_velocity(self, number, velocity):
        self.actors[number].throw(velocity)
        return DONE

    def do_set_actor_target_angular_velocity(self, number, velocity):
        self.actors[number].turning = velocity[2]
        return DONE

    def do_apply_control_to_vehicle(self, number, control):
        self.actors[number].control = control
        return DONE

    def do_apply_control_to_walker(self, number, control):
        direction, speed = control[0], control[1]
        # ScenarioRunner gives who stands no direction that is one.
        self.actors[number].throw([0.0 if math.isnan(one) else speed * one for one in direction])
        return DONE

    def do_start_recorder(self, name, *_):
        self.log = Log(Path(name))
        for actor in self.actors.values():
            self.log.added(actor)
        return value(f"Recording to file: {name}")

    def do_stop_recorder(self):
        if self.log is not None:
            self.log.close()
        self.log = None
        return DONE

    def do_get_required_files(self, *_):
        return value([])

    def do_query_lights_state(self, *_):
        return value([])

    def do_get_vehicle_light_states(self, *_):
        return value([])

    def do_get_vehicle_light_state(self, *_):
        return value([0])

    def do_get_names_of_all_objects(self):
        return value([])

    def do_get_traffic_lights(self, *_):
        return value([])

    def do_get_group_traffic_lights(self, *_):
        return value([])

    def do_get_available_maps(self):
        return value(["/Game/Carla/Maps/Town01", "/Game/Carla/Maps/Town02"])

    def do_get_weather_parameters(self, *_):
        return value([0.0] * 14)

    def do_is_traffic_manager_running(self, _):
        return value(False)

    def do_add_traffic_manager_running(self, _):
        return value(True)

    def do_destroy_traffic_manager(self, _):
        return value(True)

    def do_get_traffic_manager_running(self, _):
        return value(["", 0])


class Actor:
    """Where something is: x, y, z in m and pitch, yaw, roll in degrees, in CARLA's left-handed axes."""

    def __init__(self, number, description, transform):
        self.number, self.description, self.kind = number, description, description[1]
        self.place, self.speed, self.control = [*transform[0], *transform[1]], 0.0, [0.0] * 7
        self.parent, self.token = 0, b""
        self.radius = max(BOXES.get(self.kind, (0.0,)))
        self.free = None
        # Degrees per second, and m/s to its right, for one step.
        self.turning, self.slip = 0.0, 0.0
        # km/h, as in CARLA before a vehicle has passed a sign.
        self.speed_limit = 30.0

    @property
    def role(self):
        return next((content for name, _, content in self.description[2] if name == "role_name"), "")

    def throw(self, velocity):
        """Give it a velocity: to a vehicle for good along its heading and for one step across it, any to a walker."""
        if self.kind.startswith("vehicle."):
            yaw = math.radians(self.place[4])
            self.speed = velocity[0] * math.cos(yaw) + velocity[1] * math.sin(yaw)
            self.slip = velocity[1] * math.cos(yaw) - velocity[0] * math.sin(yaw)
        else:
            self.free = velocity

    @property
    def velocity(self):
        if self.free is not None:
            return self.free
        yaw = math.radians(self.place[4])
        ahead, right = (math.cos(yaw), math.sin(yaw)), (-math.sin(yaw), math.cos(yaw))
        return [*(self.speed * a + self.slip * r for a, r in zip(ahead, right, strict=True)), 0.0]

    def move(self, step):
        throttle, steer, brake = self.control[:3]
        turn = 0.0
        if self.kind.startswith("vehicle."):
            faster = self.speed + step * (4.0 * throttle - 8.0 * brake)
            self.speed = max(0.0, faster) if throttle or brake else faster
            turn = step * self.turning + math.degrees(step * self.speed * math.tan(math.radians(70.0 * steer)) / 3.0)
        if not self.turning:
            self.place[4] += turn
        for k, part in enumerate(self.velocity):
            self.place[k] += step * part
        if self.turning:
            # A velocity that was set is one of the world, whichever way the body turns.
            self.place[4] += turn
        self.turning = self.slip = 0.0

    def state(self):
        pitch, yaw, roll = self.place[3:]
        told = struct.pack("<IB6f3f6f", self.number, 1, *self.place[:3], pitch, yaw, roll, *self.velocity, *[0.0] * 6)
        control = struct.pack("<3f3?i", *self.control[:3], False, False, False, 1)
        told += control + struct.pack("<f", self.speed_limit)
        return told + bytes(STATE_SIZE - len(told))


class Log:
    """A file of CARLA's recorder."""

    def __init__(self, path):
        self._file, self._new, self._touched, self._boxes, self._time = path.open("wb"), [], [], [], 0.0
        self._file.write(struct.pack("<H", 1) + text("CARLA_RECORDER") + struct.pack("<q", 0) + text("OpenDriveMap"))

    def added(self, actor):
        self._new.append(actor)

    def touch(self, one, other):
        self._touched.append((one, other))

    def frame(self, number, step, actors):
        self._packet(0, struct.pack("<Qdd", number, step, self._time))
        self._time += step
        if self._new:
            bodies = [a for a in self._new if a.radius]
            self._packet(2, struct.pack("<H", len(bodies)) + b"".join(map(self._born, bodies)))
            rows = b"".join(
                struct.pack("<I6f", a.number, 0, 0, 70, *(100 * half for half in BOXES[a.kind]), 70) for a in bodies
            )
            self._packet(13, struct.pack("<H", len(bodies)) + rows)
            self._new = []
        if self._touched:
            rows = b"".join(struct.pack("<III2?", k, *pair, False, False) for k, pair in enumerate(self._touched))
            self._packet(5, struct.pack("<H", len(self._touched)) + rows)
            self._touched = []
        bodies = [a for a in actors.values() if a.radius]
        rows = b"".join(
            struct.pack("<I6f", a.number, *(100 * part for part in a.place[:3]), a.place[5], a.place[3], a.place[4])
            for a in bodies
        )
        self._packet(6, struct.pack("<H", len(bodies)) + rows)
        self._packet(1, b"")

    @staticmethod
    def _born(actor):
        sort = 1 if actor.kind.startswith("vehicle.") else 2
        attributes = struct.pack("<HB", 1, 4) + text("role_name") + text(actor.role)
        return struct.pack("<IB6fI", actor.number, sort, *[0.0] * 6, 1) + text(actor.kind) + attributes

    def _packet(self, kind, body):
        self._file.write(struct.pack("<BI", kind, len(body)) + body)

    def close(self):
        self._file.close()


def touch(one, other):
    """Whether the boxes of two actors share a point: no side of either of them is between them."""
    return not any(gap(a, b, across) > 0.0 for a, b in ((one, other), (other, one)) for across in (False, True))


def gap(one, other, across):
    """Gap in m between an actor's box and that of another along an axis of the former."""
    turn = math.radians(one.place[4]) + (math.pi / 2 if across else 0.0)
    axis = math.cos(turn), math.sin(turn)
    distance = sum(part * (b - a) for part, a, b in zip(axis, one.place[:2], other.place[:2], strict=True))
    reach = BOXES[one.kind][across]
    for half, angle in zip(BOXES[other.kind], (0.0, math.pi / 2), strict=True):
        yaw = math.radians(other.place[4]) + angle
        reach += half * abs(axis[0] * math.cos(yaw) + axis[1] * math.sin(yaw))
    return abs(distance) - reach


def text(words):
    return struct.pack("<H", len(words)) + words.encode()


def accepted(port):
    """Lines that come in on a port."""
    listener = socket.socket()
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    listener.bind(("127.0.0.1", port))
    listener.listen(8)
    while True:
        line, _ = listener.accept()
        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        yield line


if __name__ == "__main__":
    server = Server(int(sys.argv[1]), Path(sys.argv[2]).read_text(), sys.argv[3:])
    server.serve()
    print("ready", flush=True)
    # Ends with who has started it, unless that gives it no input.
    sys.stdin.read()
    if "stay" in sys.argv:
        threading.Event().wait()
