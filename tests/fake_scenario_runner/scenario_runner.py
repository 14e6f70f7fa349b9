"""Takes ScenarioRunner's options and moves the entities of a scenario straight on, as a client of CARLA.

Entities keep the speed that they have at first, for as long as the storyboard's stop trigger says. What goes wrong
is said by the environment variable FAKE_RUNNER.
"""

import argparse
import itertools
import math
import os
import sys
import time
import xml.etree.ElementTree as ElementTree

import carla

assert not [folder for folder in sys.path if os.path.exists(os.path.join(folder, "road.xodr"))]
parser = argparse.ArgumentParser()
for name in ("host", "port", "timeout", "openscenario", "trafficManagerPort", "trafficManagerSeed"):
    parser.add_argument(f"--{name}", required=True)
parser.add_argument("--frameRate", required=True)
parser.add_argument("--record", default="")
parser.add_argument("--sync", action="store_true", required=True)
options = parser.parse_args()
wrong = os.environ.get("FAKE_RUNNER", "")


def only(element, path):
    """Attributes of the element at a path."""
    found = element.find(path)
    assert found is not None, path
    return found.attrib


root = ElementTree.parse(options.openscenario).getroot()
assert only(root, "FileHeader")["revMinor"] == "0"
if wrong == "cannot load":
    print("The scenario cannot be loaded\nTraceback (most recent call last):\n  File 'x'\nKeyError: 'Ego'\nExiting")
    sys.exit(1)
client = carla.Client(options.host, int(options.port))
client.set_timeout(float(options.timeout))
world = client.get_world()
settings = world.get_settings()
settings.synchronous_mode, settings.fixed_delta_seconds = True, 1.0 / float(options.frameRate)
world.apply_settings(settings)
world.tick()


class Track:
    """Where an entity is to be: along the trajectory of its events, else straight on at its first speed."""

    def __init__(self, name, fault):
        private = root.find(f"Storyboard/Init/Actions/Private[@entityRef='{name}']")
        self.start = {key: float(one) for key, one in only(private, ".//WorldPosition").items()}
        self.speed = float(only(private, ".//AbsoluteTargetSpeed")["value"])
        self.center = float(only(root, f"Entities/ScenarioObject[@name='{name}']//BoundingBox/Center")["x"])
        self.fault = fault
        self.legs: list[tuple[float, ...]] = []
        for group in root.iter("ManeuverGroup"):
            actor = group.find("Actors/EntityRef")
            if actor is None or actor.get("entityRef") != name or fault == "speed":
                continue
            for shape in group.iterfind(".//FollowTrajectoryAction//Polyline"):
                vertices = []
                for vertex in shape.iterfind("Vertex"):
                    at = {key: float(one) for key, one in only(vertex, ".//WorldPosition").items()}
                    vertices.append((float(vertex.attrib["time"]), at["x"], at["y"], at.get("h", 0.0)))
                # A later trajectory replaces the rest of an earlier one.
                self.legs = [leg for leg in self.legs if leg[0] < vertices[0][0]] + vertices

    def reference(self, time):
        """x, y and heading of the reference point."""
        if not self.legs:
            heading, along = self.start.get("h", 0.0), self.speed * time
            return self.start["x"] + along * math.cos(heading), self.start["y"] + along * math.sin(heading), heading
        for (begin, *one), (end, *other) in itertools.pairwise(self.legs):
            if time <= end:
                part = max(time - begin, 0.0) / (end - begin)
                turned = (other[2] - one[2] + math.pi) % (2 * math.pi) - math.pi
                return (*(a + part * (b - a) for a, b in zip(one[:2], other[:2], strict=True)), one[2] + part * turned)
        return self.legs[-1][1:]

    def pose(self, time):
        """x, y and heading of the centre of the box, and the speed."""
        x, y, heading = self.reference(time)
        before, after = self.reference(max(time - 0.01, 0.0)), self.reference(time + 0.01)
        span = time + 0.01 - max(time - 0.01, 0.0)
        speed = ((after[0] - before[0]) * math.cos(heading) + (after[1] - before[1]) * math.sin(heading)) / span
        ahead = 0.0 if self.fault == "centre" else self.center
        x, y = x + ahead * math.cos(heading), y + ahead * math.sin(heading)
        if self.fault == "mirror":
            y, heading = -y, -heading
        if self.fault == "heading":
            heading = -heading
        if self.fault == "feet":
            x, y, speed = x / 0.3048, y / 0.3048, speed / 0.3048
        return x, y, heading, speed


def play(fault):
    """Move all entities as the file says, with a fault."""
    tracks, step = [], 1.0 / float(options.frameRate)
    for holder in root.iterfind("Entities/ScenarioObject"):
        walks = holder.find("Pedestrian") is not None
        blueprint = world.get_blueprint_library().find("walker.pedestrian.0001" if walks else "vehicle.tesla.model3")
        blueprint.set_attribute("role_name", holder.get("name"))
        track = Track(holder.get("name"), fault)
        x, y, heading, _ = track.pose(0.0)
        place = carla.Transform(carla.Location(x, -y, 0.3), carla.Rotation(yaw=-math.degrees(heading)))
        tracks.append((world.spawn_actor(blueprint, place), track))
    last = round(float(only(root, "Storyboard/StopTrigger//SimulationTimeCondition")["value"]) / step)
    for k in range(last + 1):
        late = max(k - 1, 0) if fault == "late" else k
        # The server tells the very last frame again when its settings change, without entities.
        if fault == "stale":
            late = min(k, last - 2)
        for actor, track in tracks:
            x, y, heading, speed = track.pose(late * step * (1.02 if fault == "drift" else 1.0))
            # The server moves it by its velocity before the frame is sent.
            back = speed * step
            x, y = x - back * math.cos(heading), y - back * math.sin(heading)
            actor.set_transform(carla.Transform(carla.Location(x, -y, 0.3), carla.Rotation(yaw=-math.degrees(heading))))
            actor.set_target_velocity(carla.Vector3D(speed * math.cos(heading), -speed * math.sin(heading), 0.0))
        world.tick()
        if k == 0:
            # Whoever watches needs time to find them.
            time.sleep(0.5)
    print("Nothing to analyze, this scenario has no criteria\nNot all scenario tests were successful")
    for actor, _ in tracks:
        actor.destroy()
    settings.synchronous_mode, settings.fixed_delta_seconds = False, None
    world.apply_settings(settings)


if wrong.startswith("plays"):
    play(wrong.partition(" ")[2])
    sys.exit()
actors = []
for holder in root.iterfind("Entities/ScenarioObject"):
    walks = holder.find("Pedestrian") is not None
    blueprint = world.get_blueprint_library().find("walker.pedestrian.0001" if walks else "vehicle.tesla.model3")
    blueprint.set_attribute("role_name", holder.get("name"))
    private = root.find(f"Storyboard/Init/Actions/Private[@entityRef='{holder.get('name')}']")
    at = {key: float(value) for key, value in only(private, ".//WorldPosition").items()}
    place = carla.Location(at["x"], -at["y"], 0.3 if walks is False else 1.0)
    turn = carla.Rotation(yaw=-math.degrees(at.get("h", 0.0)))
    speed = float(only(private, ".//AbsoluteTargetSpeed")["value"])
    actors.append((world.spawn_actor(blueprint, carla.Transform(place, turn)), turn, speed, walks))
    world.tick()
if options.record:
    client.start_recorder(os.path.join(os.environ["SCENARIO_RUNNER_ROOT"], options.record, "cornercase.log"), True)
if wrong == "hang":
    time.sleep(600)
# As long as it takes at least to build the tree of a storyboard.
time.sleep(0.2)
for actor, turn, speed, walks in actors:
    ahead = turn.get_forward_vector()
    if walks:
        actor.apply_control(carla.WalkerControl(ahead, speed))
    else:
        actor.set_target_velocity(ahead * speed)
end = float(only(root, "Storyboard/StopTrigger//SimulationTimeCondition")["value"])
for _ in range(round(end * float(options.frameRate))):
    world.tick()
    if wrong == "slow":
        time.sleep(0.05)
if wrong == "fails at the end":
    print("RuntimeError: a storyboard that is none")
    sys.exit(1)
print("Nothing to analyze, this scenario has no criteria\nNot all scenario tests were successful")
if options.record:
    client.stop_recorder()
for actor in [one[0] for one in actors]:
    actor.destroy()
settings.synchronous_mode, settings.fixed_delta_seconds = False, None
world.apply_settings(settings)
