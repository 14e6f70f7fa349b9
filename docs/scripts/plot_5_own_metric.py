"""
A metric of your own
====================

A metric is a class with a course. This one says how fast the ego goes while the other is near.
"""

import matplotlib.pyplot as plt
import numpy as np

import cornercase as cc
from cornercase.exploration import examples_folder


class SpeedNearby(cc.Metric):
    """Speed of the ego while the other is within 20 m, in m/s."""

    name = "speed-nearby"
    unit = "m/s"
    lower_is_critical = False
    cap = 0.0

    def course(self, recording, ego, other):
        gap = np.hypot(*(recording.box_center(other) - recording.box_center(ego)).T)
        return np.where(gap <= 20.0, recording.speed[recording.entity_index(ego)], np.nan)


# %%
# Two drivers go through the same concrete scenario.

scenario = examples_folder() / "x_intersection" / "x_intersection.xosc"
figure, axes = plt.subplots(layout="constrained")
for driver, look in (("cautious", "-"), ("aggressive", "--")):
    recording = cc.simulate(scenario, {"ego_start": 40.0, "pedestrian_wait": 5.0}, drivers={"Ego": driver})
    measured = cc.measure(recording, "Ego", "Pedestrian", SpeedNearby())
    print(driver, measured.scores)
    axes.plot(recording.time, measured.courses["speed-nearby"], look, label=driver)
axes.set(xlabel="time in s", ylabel="speed of the ego in m/s", title="While the pedestrian is within 20 m")
axes.legend()
plt.show()

# %%
# ``cc.Problem(..., metrics=[SpeedNearby()])`` searches it. :doc:`/howto/own-metric` says how the command line gets to
# know it.
