"""
A driver of your own
====================

A driver decides about the ego's acceleration, for all concrete scenarios of a batch at once. This one keeps its speed
and sees nobody; what does attention change?
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np

import cornercase as cc
from cornercase.drivers import Driver
from cornercase.exploration import examples_folder


class Steady(Driver):
    """Keeps the speed that the scenario asks for."""

    settings = {"driver": "steady"}

    def acceleration(self, situation):
        wanted = np.where(np.isfinite(situation.target_speed), situation.target_speed, 10.0)
        return np.clip(wanted - situation.speed, -3.0, 2.0)


# %%
# Both run the same 60 scenarios.

example = examples_folder() / "x_intersection" / "x_intersection"
folder = TemporaryDirectory()
tables = {}
for name, driver in (("steady", Steady()), ("cautious", "cautious")):
    path = Path(folder.name) / f"{name}.db"
    cc.explore(
        f"{example}.xosc", path, space=f"{example}.space.xosc", ego="Ego", other="Pedestrian", metrics=["wttc"],
        optimizer="sobol", budget=60, drivers={"Ego": driver},
    )  # fmt: skip
    with cc.Study.open(path) as study:
        tables[name] = study.table()

# %%
# Points above the diagonal went better with the attentive driver.

figure, axes = plt.subplots(layout="constrained")
axes.axline((0, 0), slope=1, color="#999999", linestyle=":")
axes.scatter(tables["steady"]["wttc"], tables["cautious"]["wttc"], color="#0072B2")
axes.set(
    xlabel="WTTC with steady in s",
    ylabel="WTTC with cautious in s",
    title="The same scenarios, two drivers",
    aspect="equal",
)
plt.show()
