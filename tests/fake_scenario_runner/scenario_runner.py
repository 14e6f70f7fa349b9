"""Takes ScenarioRunner's options and moves the entities of a scenario straight on, as a client of CARLA.

Entities keep the speed that they have at first, for as long as the storyboard's stop trigger says. What goes wrong
is said by the environment variable FAKE_RUNNER, or for each scenario by a line of the file that it names after an @. As
before 0.9.16, there is no option --frameRate. Like the original's, its classes keep what a scenario has left there.
"""

import argparse
import math
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
import xml.etree.ElementTree as ElementTree
from typing import ClassVar

import carla
from playing import play, spawn_players  # type: ignore[import-not-found]
from srunner.scenariomanager.carla_data_provider import CarlaDataProvider
from srunner.scenariomanager.scenario_manager import ScenarioManager


def only(element, path):
    """Attributes of the element at a path."""
    found = element.find(path)
    assert found is not None, path
    return found.attrib


def note_start():
    """Write down that a process has imported this."""
    if "FAKE_RUNNER_STARTS" in os.environ:
        with open(os.environ["FAKE_RUNNER_STARTS"], "a") as file:
            print(os.getpid(), file=file)
    if os.environ.get("FAKE_RUNNER", "") == "thread":
        threading.Thread(target=time.sleep, args=(600,), daemon=True).start()


note_start()


def what_goes_wrong():
    """What goes wrong in this scenario."""
    wrong = os.environ.get("FAKE_RUNNER", "")
    if not wrong.startswith("@"):
        return wrong
    with open(wrong[1:], "r+") as file:
        first, *others = file.read().split("\n")
        file.seek(0)
        file.truncate()
        file.write("\n".join(others))
    return first


class ScenarioRunner:
    """Runs one scenario."""

    frame_rate = 20.0
    # Those of the present scenario, and of earlier ones, which nobody removes.
    ego_vehicles: ClassVar[list[str]] = []
    aborts_at_end = False

    def __init__(self, options, wrong):
        self.options, self.wrong = options, wrong
        self.ego_vehicles.append("Ego")
        assert self.ego_vehicles == ["Ego"]
        self.root = ElementTree.parse(options.openscenario).getroot()
        assert only(self.root, "FileHeader")["revMinor"] == "0"

    def run(self):
        options, root = self.options, self.root
        client = carla.Client(options.host, int(options.port))
        client.set_timeout(float(options.timeout))
        world = CarlaDataProvider.world = client.get_world()
        settings = world.get_settings()
        settings.synchronous_mode, settings.fixed_delta_seconds = True, 1.0 / self.frame_rate
        world.apply_settings(settings)
        world.tick()

        if self.wrong == "aborts":
            os.abort()
        if self.wrong == "agent starts a program":
            subprocess.run([sys.executable, "-c", "import sys; sys.stdin.read()"], timeout=20.0, check=True)
        if self.wrong == "agent leaves programs":
            for own_session in (False, True):
                command = [sys.executable, "-c", "import time; time.sleep(600)"]
                print("LEFT", subprocess.Popen(command, start_new_session=own_session).pid, flush=True)
        if self.wrong == "leaves things":
            place = carla.Transform(carla.Location(500.0, 500.0, 0.0), carla.Rotation())
            for kind in ("static.trigger.friction", "static.prop.streetbarrier"):
                world.spawn_actor(world.get_blueprint_library().find(kind), place)
        # As the client does for its traffic manager, until the process ends.
        try:
            self.traffic_manager = socket.create_server(("", int(options.trafficManagerPort)))
        except OSError as error:
            raise RuntimeError("the system failed to create because of bind error.") from error
        actors = []
        if self.wrong.startswith("plays"):
            self.play(world)
            settings.synchronous_mode, settings.fixed_delta_seconds = False, None
            world.apply_settings(settings)
            return
        for holder in root.iterfind("Entities/ScenarioObject"):
            walks = holder.find("Pedestrian") is not None
            library = world.get_blueprint_library()
            blueprint = library.find("walker.pedestrian.0001" if walks else "vehicle.tesla.model3")
            blueprint.set_attribute("role_name", holder.get("name"))
            private = root.find(f"Storyboard/Init/Actions/Private[@entityRef='{holder.get('name')}']")
            at = {key: float(value) for key, value in only(private, ".//WorldPosition").items()}
            place = carla.Location(at["x"], -at["y"], 0.3 if walks is False else 1.0)
            turn = carla.Rotation(yaw=-math.degrees(at.get("h", 0.0)))
            speed = float(only(private, ".//AbsoluteTargetSpeed")["value"])
            if options.waitForEgo and holder.find(".//Property[@value='ego_vehicle']") is not None:
                (ego,) = (one for one in world.get_actors() if one.attributes.get("role_name") == holder.get("name"))
                ego.set_transform(carla.Transform(place, turn))
            else:
                actors.append((world.spawn_actor(blueprint, carla.Transform(place, turn)), turn, speed, walks))
                if self.wrong == "agent makes namesakes":
                    for k in range(5):
                        world.spawn_actor(blueprint, carla.Transform(carla.Location(0.0, 500.0 + 9.0 * k, 1.0), turn))
            world.tick()
        # Vehicles fall on their wheels.
        for _ in range(5):
            world.tick()
        if self.wrong == "does not end":
            signal.signal(signal.SIGTERM, signal.SIG_IGN)
        if self.wrong == "hang":
            time.sleep(600)
        manager = ScenarioManager()
        manager.drive = lambda: self.drive(world, actors)
        manager.run_scenario()
        if self.wrong == "watchdog":
            raise RuntimeError("Timeout occurred during scenario execution")
        if self.wrong == "late watchdog":
            # As 0.9.15 and 0.9.16, which have no watchdog any more when they ask it.
            print("Watchdog exception - Timeout of 6.0 seconds occured")
            raise RuntimeError("\nAttributeError: 'NoneType' object has no attribute 'get_status'")
        if self.wrong == "fails at the end":
            raise RuntimeError("a storyboard that is none")
        if self.wrong == "does not end":
            time.sleep(600)
        print("Nothing to analyze, this scenario has no criteria\nNot all scenario tests were successful")
        for actor in [one[0] for one in actors]:
            actor.destroy()
        settings.synchronous_mode, settings.fixed_delta_seconds = False, None
        world.apply_settings(settings)

    def play(self, world):
        step, fault = 1.0 / self.frame_rate, self.wrong.partition(" ")[2]
        players = spawn_players(world, self.root, step, fault)
        manager = ScenarioManager()
        manager.drive = lambda: play(world, self.root, step, fault, players)
        manager.run_scenario()
        print("Nothing to analyze, this scenario has no criteria\nNot all scenario tests were successful")

    def drive(self, world, actors):
        for actor, turn, speed, walks in actors:
            ahead = turn.get_forward_vector()
            if walks:
                actor.apply_control(carla.WalkerControl(ahead, speed))
            else:
                actor.set_target_velocity(ahead * speed)
        end = float(only(self.root, "Storyboard/StopTrigger//SimulationTimeCondition")["value"])
        for k in range(round(end * self.frame_rate)):
            if k == 5:
                self.spoil(world, actors)
            world.tick()
            if self.wrong == "slow":
                time.sleep(0.05)

    def spoil(self, world, actors):
        """Do what an agent should not."""
        if self.wrong == "agent removes the ego":
            actors[0][0].destroy()
        if self.wrong == "agent removes another":
            actors[1][0].destroy()
        if self.wrong == "agent removes the folder":
            shutil.rmtree(os.getcwd())
        if self.wrong == "agent writes files":
            for name in ("last_frame", "failure"):
                os.mkdir(name)
        if self.wrong == "agent changes the time step":
            settings = world.get_settings()
            settings.fixed_delta_seconds = 0.1
            world.apply_settings(settings)
        if self.wrong == "agent ends the process":
            print("no such weights\n======[Agent] Wallclock_time = 1", flush=True)
            os._exit(3)
        if self.wrong == "agent raises":
            raise ValueError("lost\nTimeoutError: time-out of 5000ms")
        if self.wrong == "agent raises and the client aborts":
            self.aborts_at_end = True
            raise ValueError("lost")
        if self.wrong == "agent hangs":
            time.sleep(600)
        if self.wrong == "agent prints much":
            print("words\n" * 300_000, flush=True)
            print("more words\n" * 300_000, flush=True)
        if self.wrong == "agent prints without end":
            # A gap in the file, which takes no space.
            os.ftruncate(1, (1 << 30) + 1)


def main():
    """Read the options, and run."""
    assert not [folder for folder in sys.path if os.path.exists(os.path.join(folder, "road.xodr"))]
    parser = argparse.ArgumentParser()
    for name in ("host", "port", "timeout", "openscenario", "trafficManagerPort", "trafficManagerSeed"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument("--waitForEgo", action="store_true")
    parser.add_argument("--sync", action="store_true", required=True)
    options = parser.parse_args()
    wrong = what_goes_wrong()
    if wrong == "cannot load":
        print("The scenario cannot be loaded\nTraceback (most recent call last):\n  File 'x'\nKeyError: 'Ego'\nExiting")
        return 1
    if wrong == "cannot plan":
        frames = "Traceback (most recent call last):\n  File 'x', line 3, in f\n    f()\n"
        print(f"The scenario cannot be loaded\n{frames}networkx.exception.NetworkXNoPath: 0 from 2\n0 from 2\nExiting")
        return 1
    runner = ScenarioRunner(options, wrong)
    try:
        runner.run()
    except (RuntimeError, ValueError) as error:
        print(f"{type(error).__name__}: {error}", flush=True)
        if runner.aborts_at_end:
            os.abort()
        return 1
    return 0
