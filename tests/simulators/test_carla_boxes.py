"""Boxes of vehicles in recordings of CARLA are where CARLA's own client has them.

CORNERCASE_CARLA_PYTHON names a Python with that client, of any version; without it, the client of the extra 'carla' is
taken, if it is installed.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cornercase._common.geometry.boxes import box_corners
from cornercase.recordings import Recording
from cornercase.simulators.carla._tracker import EntityTracker

PYTHON = os.environ.get("CORNERCASE_CARLA_PYTHON", "") or (sys.executable if find_spec("carla") else "")
pytestmark = pytest.mark.skipif(not PYTHON, reason="CARLA's client is not installed")
FOLDER = Path(__file__).parents[2] / "src" / "cornercase" / "simulators" / "carla"
STEP = 0.05
# In single precision, in parts of the coordinates.
PRECISION = 1e-6

# Runs where the client is, which may be Python 3.7: what the recorder and the agent send of actors, and what the client
# itself says of their boxes.
SCRIPT = """
import json, sys
from threading import Lock
from types import ModuleType, SimpleNamespace
import carla
for name in ("srunner", "srunner.autoagents", "srunner.scenariomanager"):
    sys.modules[name] = ModuleType(name)
for name, part in (("autoagents.autonomous_agent", "AutonomousAgent"),
                   ("scenariomanager.carla_data_provider", "CarlaDataProvider")):
    module = sys.modules["srunner." + name] = ModuleType(name)
    setattr(module, part, object)
sys.path.insert(0, sys.argv[1])
import cornercase_agent, cornercase_recorder
answers = []
for k, (x, y, yaw, ahead, right, half_length, half_width) in enumerate(json.load(sys.stdin)):
    transform = carla.Transform(carla.Location(x, y, 0.4), carla.Rotation(yaw=yaw))
    extent = carla.Vector3D(half_length, half_width, 0.75)
    box = carla.BoundingBox(carla.Location(ahead, right, 0.7), extent)
    corners = []
    for a, b in ((1, 1), (1, -1), (-1, -1), (-1, 1)):
        corner = transform.transform(carla.Location(ahead + a * half_length, right + b * half_width, 0.0))
        corners.append((corner.x, corner.y))
    forward = transform.get_forward_vector()
    actor = SimpleNamespace(
        id=k + 1, type_id="vehicle.a.b", attributes={"base_type": "car"}, bounding_box=box, is_alive=True,
        get_transform=lambda t=transform: t, get_velocity=lambda f=forward: carla.Vector3D(7 * f.x, 7 * f.y, 0.0))
    tracker = cornercase_recorder.Tracker.__new__(cornercase_recorder.Tracker)
    tracker._earlier_ids, tracker._ids, tracker._lock, tracker._frames = set(), [], Lock(), []
    class Snapshot(list):
        timestamp = SimpleNamespace(frame=1, delta_seconds=0.05)
    tracker._store_frame(Snapshot([actor]))
    answers.append({"corners": corners, "actor": cornercase_recorder._describe(actor), "frame": tracker._frames[0],
                    "state": cornercase_agent._state_of(actor)})
print(json.dumps(answers))
"""


def poses():
    """Random vehicles in all quadrants and directions, some with boxes that are not about their origin."""
    random = np.random.default_rng(7)
    count = 400
    x, y = random.uniform(-300.0, 300.0, (2, count))
    yaw = np.concatenate([[0.0, 90.0, 180.0, -90.0, -180.0, 359.0, 540.0], random.uniform(-360.0, 360.0, count - 7)])
    ahead, right = random.uniform(-1.5, 1.5, count), random.uniform(-0.3, 0.3, count)
    half_length, half_width = random.uniform(0.3, 6.0, count), random.uniform(0.2, 1.5, count)
    return np.stack([x, y, yaw, ahead, right, half_length, half_width], axis=1)


@pytest.fixture(scope="module")
def answers():
    """What CARLA's client says of these vehicles."""
    done = subprocess.run(
        [PYTHON, "-c", SCRIPT, FOLDER], input=json.dumps(poses().tolist()), capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


class Sent:
    """A server of which a client has sent two equal frames."""

    def __init__(self, answer):
        number, step, frame = answer["frame"]
        self.answer = {
            "frames": [(number, step, frame), (number + 1, step, frame)],
            "contacts": [],
            "missing": [],
            "entities": {"Ego": answer["actor"]},
        }

    def track(self, names, external):
        pass

    def poll(self):
        return self.answer

    def end_tracking(self):
        pass


def recorded(answer) -> Recording:
    sent: Any = Sent(answer)
    with EntityTracker(sent, ["Ego"], "Ego", STEP) as tracker:
        tracker.first_frame = 1
        tracker.update()
        return tracker.make_recording(Path("run"), 1.0, until_collision=False)


def deviation(answer, corners):
    """How far corners are from those of the client, in parts of the largest coordinate."""
    theirs = np.array(answer["corners"]) * (1.0, -1.0)
    # Whatever corner comes first.
    return min(np.abs(np.roll(corners, k, axis=0) - theirs).max() for k in range(4)) / np.abs(theirs).max()


def test_corners_in_a_recording_are_those_of_the_client(answers):
    quadrants = set()
    for answer in answers:
        recording = recorded(answer)
        heading = recording.heading[0, 0]
        x = recording.x[0, 0] + recording.center_x[0] * np.cos(heading)
        y = recording.y[0, 0] + recording.center_x[0] * np.sin(heading)
        corners = box_corners(x, y, heading, recording.length[0], recording.width[0])
        assert deviation(answer, corners) < PRECISION
        assert recording.speed[0, 0] == pytest.approx(7.0, abs=1e-5)
        quadrants.add((x > 0.0, y > 0.0))
    assert len(quadrants) == 4


def test_corners_that_a_driver_is_told_are_those_of_the_client(answers):
    for answer in answers:
        x, y, heading, speed, length, width = answer["state"]
        assert deviation(answer, box_corners(x, y, heading, length, width)) < PRECISION
        assert speed == pytest.approx(7.0, abs=1e-5)
