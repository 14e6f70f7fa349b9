"""What is recorded of what CARLA sends, which may come in any order."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from cornercase.simulators.carla._tracker import EntityTracker

ACTOR = {"base_type": "car", "type_id": "vehicle.a", "length": 4.0, "width": 2.0, "ahead": 0.0, "left": 0.0}


class Sent:
    """A server that sends what it is given, one piece per question."""

    def __init__(self, *news):
        self.news = iter(news)

    def track(self, names, external):
        pass

    def poll(self):
        empty: dict[str, Any] = {"frames": [], "contacts": [], "missing": [], "entities": {}}
        return empty | next(self.news)

    def end_tracking(self):
        pass


def frame(number):
    return number, 0.1, {"1": (float(number), 0.0, 0.0, 10.0), "2": (9.0, 0.0, 0.0, 0.0)}


def test_a_collision_ends_the_run_when_its_frame_has_come():
    entities = {"Ego": ACTOR | {"id": 1}, "C": ACTOR | {"id": 2}}
    sent: Any = Sent(
        {"entities": entities, "frames": [frame(5), frame(6)]}, {"contacts": [(7, 1, 2)]}, {"frames": [frame(7)]}
    )
    with EntityTracker(sent, ["Ego", "C"], "Ego", 0.1) as tracker:
        tracker.first_frame = 5
        tracker.update()
        tracker.update()
        assert not tracker.has_collision
        tracker.update()
        assert tracker.has_collision
        recording = tracker.make_recording(Path("run"), 60.0, until_collision=True)
    (collision,) = recording.collisions
    assert collision.time == recording.time[-1] == pytest.approx(0.2)
