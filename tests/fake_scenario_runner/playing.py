"""Moves entities as a converted file says, without a behaviour tree: along its trajectories, or straight on.

Agents drive as they do in ScenarioRunner: one in a file decides in each tick; CARLA's own are replaced by some that
stop before what stands ahead, or not.
"""

import importlib
import itertools
import json
import math
import os
import sys

import carla

# m/s, and whether it brakes.
BEHAVIORS = {"cautious": (8.0, True), "normal": (10.0, True), "aggressive": (14.0, False)}


def only(element, path):
    """Attributes of the element at a path."""
    found = element.find(path)
    assert found is not None, path
    return found.attrib


class Track:
    """Where an entity is to be: along the trajectory of its events, else straight on at its first speed."""

    def __init__(self, root, name, fault):
        private = root.find(f"Storyboard/Init/Actions/Private[@entityRef='{name}']")
        self.start = {key: float(one) for key, one in only(private, ".//WorldPosition").items()}
        self.speed = float(only(private, ".//AbsoluteTargetSpeed")["value"])
        self.center = float(only(root, f"Entities/ScenarioObject[@name='{name}']//BoundingBox/Center")["x"])
        self.fault = fault
        self.legs: list[tuple[float, ...]] = []
        parts = private.find(".//Property[@name='parts']")
        if parts is not None and fault != "speed":
            # A later part replaces the rest of an earlier one.
            for part in json.loads(parts.attrib["value"]):
                self.legs = [leg for leg in self.legs if leg[0] < part[0][0]] + [tuple(leg) for leg in part]

    def reference(self, time):
        """x, y and heading of the reference point."""
        if not self.legs:
            # The file has where the middle begins.
            heading, along = self.start.get("h", 0.0), self.speed * time - self.center
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


class Behavior:
    """Replaces a behaviour agent of CARLA on a straight lane."""

    def __init__(self, name):
        self.target, self.brakes = BEHAVIORS[name]

    def decide(self, world, actor, time):
        place, speed = actor.get_transform().location, actor.get_velocity().length()
        others = [one for one in world.get_actors().filter("vehicle.*") if one.id != actor.id]
        gaps = [one.get_transform().location.x - place.x for one in others if abs(one.get_location().y - place.y) < 2.0]
        near = any(0.0 < gap < 8.0 + speed**2 / 8.0 for gap in gaps)
        if self.brakes and near:
            return carla.VehicleControl(brake=1.0)
        return carla.VehicleControl(throttle=max(0.0, min(1.0, 0.3 * (self.target - speed))))


class FileAgent:
    """An agent in a file, with a speedometer and an IMU."""

    def __init__(self, file, config):
        sys.path.insert(0, os.path.dirname(file))
        module = importlib.import_module(os.path.splitext(os.path.basename(file))[0])
        self.agent = getattr(module, module.__name__.title().replace("_", ""))(config)

    def decide(self, world, actor, time):
        data = {"SPEED": (0, {"speed": actor.get_velocity().length()}), "IMU": (0, [0.0] * 7)}
        return self.agent.run_step(data, time)


def agent_of(root, name):
    """What drives an entity, if an agent does."""
    private = root.find(f"Storyboard/Init/Actions/Private[@entityRef='{name}']")
    given = {one.get("name"): one.get("value") for one in private.iter("Property")}
    if given.get("agent"):
        return FileAgent(given["agent"], given.get("agent_config", ""))
    return Behavior(given["behavior"]) if given.get("behavior") else None


def spawn_players(world, root, step, fault):
    """Let all entities exist where they begin, with a fault; return them with their tracks, or with their agents."""
    players = []
    for holder in root.iterfind("Entities/ScenarioObject"):
        walks = holder.find("Pedestrian") is not None
        blueprint = world.get_blueprint_library().find("walker.pedestrian.0001" if walks else "vehicle.tesla.model3")
        blueprint.set_attribute("role_name", holder.get("name"))
        track = Track(root, holder.get("name"), fault)
        agent = agent_of(root, holder.get("name"))
        x, y, heading, _ = track.pose(0.0)
        place = carla.Transform(carla.Location(x, -y, 0.3), carla.Rotation(yaw=-math.degrees(heading)))
        players.append((world.spawn_actor(blueprint, place), track, agent))
    _move(players, 0.0, step)
    world.tick()
    return players


def play(world, root, step, fault, players):
    """Move all entities as the file says, with a fault."""
    last = round(float(only(root, "Storyboard/StopTrigger//SimulationTimeCondition")["value"]) / step)
    for k in range(1, last + 1):
        late = k - 1 if fault == "late" else k
        # The server tells the very last frame again when its settings change, without entities.
        if fault == "stale":
            late = min(k, last - 2)
        _move(players, late * step * (1.02 if fault == "drift" else 1.0), step)
        _decide(world, players, k * step, step, fault)
        world.tick()
    for actor, *_ in players:
        actor.destroy()


def _decide(world, players, time, step, fault):
    """Let agents decide, with a fault."""
    for actor, track, agent in players:
        if agent is None:
            continue
        if time == step:
            actor.set_target_velocity(carla.Vector3D(track.speed, 0.0, 0.0))
        control = agent.decide(world, actor, time)
        if fault == "agent-ignored":
            actor.set_target_velocity(carla.Vector3D(track.speed, 0.0, 0.0))
        elif fault == "agent-reverses":
            actor.set_target_velocity(carla.Vector3D(-track.speed, 0.0, 0.0))
        elif fault == "agent-strays":
            actor.set_target_velocity(carla.Vector3D(track.speed, 1.0, 0.0))
        elif control.throttle or control.brake:
            actor.apply_control(control)


def _move(players, time, step):
    for actor, track, agent in players:
        if agent is not None:
            continue
        x, y, heading, speed = track.pose(time)
        # The server moves it by its velocity before the frame is sent.
        x, y = x - speed * step * math.cos(heading), y - speed * step * math.sin(heading)
        actor.set_transform(carla.Transform(carla.Location(x, -y, 0.3), carla.Rotation(yaw=-math.degrees(heading))))
        actor.set_target_velocity(carla.Vector3D(speed * math.cos(heading), -speed * math.sin(heading), 0.0))
