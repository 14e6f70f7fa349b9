"""Moves entities as a converted file says, without a behaviour tree: along its trajectories, or straight on."""

import itertools
import json
import math

import carla


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


def spawn_players(world, root, step, fault):
    """Let all entities exist where they begin, with a fault; return them with their tracks."""
    players = []
    for holder in root.iterfind("Entities/ScenarioObject"):
        walks = holder.find("Pedestrian") is not None
        blueprint = world.get_blueprint_library().find("walker.pedestrian.0001" if walks else "vehicle.tesla.model3")
        blueprint.set_attribute("role_name", holder.get("name"))
        track = Track(root, holder.get("name"), fault)
        x, y, heading, _ = track.pose(0.0)
        place = carla.Transform(carla.Location(x, -y, 0.3), carla.Rotation(yaw=-math.degrees(heading)))
        players.append((world.spawn_actor(blueprint, place), track))
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
        world.tick()
    for actor, _ in players:
        actor.destroy()


def _move(players, time, step):
    for actor, track in players:
        x, y, heading, speed = track.pose(time)
        # The server moves it by its velocity before the frame is sent.
        x, y = x - speed * step * math.cos(heading), y - speed * step * math.sin(heading)
        actor.set_transform(carla.Transform(carla.Location(x, -y, 0.3), carla.Rotation(yaw=-math.degrees(heading))))
        actor.set_target_velocity(carla.Vector3D(speed * math.cos(heading), -speed * math.sin(heading), 0.0))
