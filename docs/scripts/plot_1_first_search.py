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
logical = cc.LogicalScenario.read(f"{example}.xosc", f"{example}.space.xosc")
logical.space

# %%
# ``level-set`` looks for the boundary of the critical set: all scenarios whose worst time to collision is at most 0.2
# s.

folder = TemporaryDirectory()
study = Path(folder.name) / "study.db"
result = cc.explore(
    logical,
    study,
    ego="Ego",
    other="Pedestrian",
    metrics=["wttc"],
    critical=0.2,
    optimizer="level-set",
    budget=100,
    seed=1,
)
print(result)

# %%
# Filled points were critical. The search has put most of its scenarios where critical and uncritical ones meet.

with cc.Study.open(study) as opened:
    table = opened.table()
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

known = cc.summarize(study).estimates.critical.critical_set
print(
    f"critical share of the space: {known.critical_fraction.value:.3f}"
    f" ({known.critical_fraction.low:.3f} to {known.critical_fraction.high:.3f})"
)
print(
    f"missed of the critical set: {known.missed_fraction.value:.3f}"
    f" ({known.missed_fraction.low:.3f} to {known.missed_fraction.high:.3f})"
)
