"""Takes ScenarioRunner's options and moves the entities of a scenario straight on, as a client of CARLA.

Entities keep the speed that they have at first, for as long as the storyboard's stop trigger says. What goes wrong
is said by the environment variable FAKE_RUNNER.
"""

import argparse
import math
import os
import sys
import time
import xml.etree.ElementTree as ElementTree

import carla
from playing import play  # type: ignore[import-not-found]

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


if wrong == "aborts":
    os.abort()
if wrong.startswith("plays"):
    play(world, root, 1.0 / float(options.frameRate), wrong.partition(" ")[2])
    settings.synchronous_mode, settings.fixed_delta_seconds = False, None
    world.apply_settings(settings)
    print("Nothing to analyze, this scenario has no criteria\nNot all scenario tests were successful")
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
