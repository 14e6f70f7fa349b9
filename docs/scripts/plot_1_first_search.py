"""
A first search
==============

A search runs 100 concrete scenarios of the X-intersection, and the table of the study says which were critical.
"""

# %%
# The example has three parameters. Two of them decide who comes first: where the ego starts, and how long the
# pedestrian waits.

from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt

import cornercase as cc
from cornercase.exploration import examples_folder

example = examples_folder() / "x_intersection" / "x_intersection"
scenario = cc.LogicalScenario.read(f"{example}.xosc", f"{example}.space.xosc")
problem = cc.Problem(scenario, ego="Ego", other="Pedestrian", metrics=["wttc"], threshold=0.2)
problem

# %%
# ``level-set`` looks for the boundary of the critical set: all scenarios whose worst time to collision is at most 0.2
# s.

folder = TemporaryDirectory()
study = cc.Study.create(Path(folder.name) / "study.db", problem, seed=1)
study.explore(cc.optimizers.LevelSet(), budget=100)

# %%
# Filled points were critical. The search has put most of its scenarios where critical and uncritical ones meet.

table = study.table()
critical = table["wttc"] <= 0.2

figure, axes = plt.subplots(layout="constrained")
axes.scatter(table["ego_start"][critical], table["pedestrian_wait"][critical], color="#D55E00", label="critical")
axes.scatter(
    table["ego_start"][~critical],
    table["pedestrian_wait"][~critical],
    facecolors="none",
    edgecolors="#0072B2",
    label="not critical",
)
axes.set(xlabel="ego_start in m", ylabel="pedestrian_wait in s", title="WTTC of at most 0.2 s")
axes.legend(loc="upper left", bbox_to_anchor=(1, 1))
plt.show()

# %%
# How much of the space is critical is another question than how many scenarios were: the search went where it is
# critical.

study.critical_set()
