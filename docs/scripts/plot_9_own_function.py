"""
A bug in a function of your own
===============================

An emergency brake sees one scenario, and decides one step. It brakes in time, but releases the brake at standstill.
Below 3 m/s it is not armed, so it creeps into the target. Where does that show, and is it gone in the next version?
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt

import cornercase as cc
from cornercase.exploration import examples_folder


class Aeb(cc.SystemUnderTest):
    """Keeps its speed, and brakes fully when it is time."""

    def __init__(self, margin=2.0):
        self.margin = margin

    def start(self, ego, road, rng):
        self.set_speed = None
        self.is_braking = False

    def may_go(self, view):
        return True

    def step(self, view, dt):
        speed, leader = view.ego.speed, view.leader
        if self.set_speed is None:
            self.set_speed = speed
        is_armed = speed > 3.0 and leader is not None and leader.closing > 0.0
        if is_armed and leader.gap < leader.closing**2 / 12.0 + self.margin:
            self.is_braking = True
        if speed == 0.0 and self.may_go(view):
            self.is_braking = False
        return -8.0 if self.is_braking else min(self.set_speed - speed, 1.0)


class HoldingAeb(Aeb):
    """Holds the brake while something stands ahead."""

    def may_go(self, view):
        return view.leader is None or view.leader.gap > 10.0


# %%
# A leader brakes to standstill. Three parameters vary: the speed, the gap, and how hard the leader brakes.

scenario = examples_folder() / "r157" / "deceleration.xosc"
folder = TemporaryDirectory()
tables, studies = {}, {}
for function in (Aeb(), HoldingAeb()):
    name = type(function).__name__
    path = Path(folder.name) / f"{name}.db"
    cc.explore(
        scenario, path, ranges=["ego_kmh=30:90", "gap=20:80", "deceleration=0.1:0.6"], ego="Ego", other="Other",
        metrics=["delta-v"], optimizer="sobol", budget=60, drivers={"Ego": function},
    )  # fmt: skip
    studies[name] = cc.Study.open(path)
    tables[name] = studies[name].table()
    print(name, (tables[name]["delta-v"] > 0.0).sum(), "of 60 collide")

# %%
# Left, a scenario in which only the first version collides: how fast both cars go. Right, all collisions.

gone = (tables["Aeb"]["delta-v"] > 0.0) & (tables["HoldingAeb"]["delta-v"] == 0.0)
scenario_id = int(gone[gone].index[0])
figure, (left, right) = plt.subplots(ncols=2, figsize=(10.0, 4.2), layout="constrained")
for name, color in (("Aeb", "#D55E00"), ("HoldingAeb", "#0072B2")):
    recording = studies[name].recording(scenario_id)
    ego, other = recording.entity_index("Ego"), recording.entity_index("Other")
    left.plot(recording.time, recording.speed[ego], color=color, label=f"ego with {name}")
    for collision in recording.collisions:
        speed = recording.speed[ego][recording.time <= collision.time][-1]
        left.plot(collision.time, speed, "x", color=color, markersize=10, label="collision")
left.plot(recording.time, recording.speed[other], color="#777777", linestyle="--", label="leader")
left.set(xlabel="time in s", ylabel="speed in m/s", xlim=(0.0, 15.0), title=f"Scenario {scenario_id}")
left.legend()

bins = [0.25 * k for k in range(19)]
for name, color in (("Aeb", "#D55E00"), ("HoldingAeb", "#0072B2")):
    hard = tables[name]["delta-v"]
    right.hist(hard[hard > 0.0], bins=bins, color=color, alpha=0.6, label=f"{name}: {(hard > 0.0).sum()} of 60 collide")
right.set(xlabel="change of velocity in the collision in m/s", ylabel="scenarios", title="Collisions")
right.legend()
plt.show()

# %%
# The 49 collisions at standstill are gone. Those that stay are another finding: the ego is fast, and the brake
# comes too late.
