"""
The few to keep
===============

Of 150 scenarios twelve are kept: prototypes, archetypes, and what fills the gaps.
"""

from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt

import cornercase as cc
from cornercase.exploration import examples_folder

example = examples_folder() / "x_intersection" / "x_intersection"
folder = TemporaryDirectory()
scenario = cc.LogicalScenario.read(f"{example}.xosc", f"{example}.space.xosc")
problem = cc.Problem(scenario, ego="Ego", other="Pedestrian", metrics=["wttc"], threshold=0.2)
study = cc.Study.create(Path(folder.name) / "study.db", problem)
study.explore(cc.optimizers.Sobol(), budget=150)
study.cluster()
reduced = study.reduce(Path(folder.name) / "reduced", size=12)
print(Counter(kept.role for kept in reduced.scenarios))

# %%
# Each kept scenario is a file that runs by itself. Its values and the reason why it was kept stand in the manifest.

for kept in reduced.scenarios[:3]:
    print(kept.file, kept.values, kept.why)

# %%
# Where they lie among all that ran:

table = study.table()
chosen = table.index.isin(reduced.ids)

figure, axes = plt.subplots(layout="constrained")
axes.scatter(table["ego_start"], table["pedestrian_wait"], s=12, color="#999999", label="run")
axes.scatter(
    table["ego_start"][chosen], table["pedestrian_wait"][chosen], s=70, marker="D", color="#D55E00", label="kept"
)
axes.set(xlabel="ego_start in m", ylabel="pedestrian_wait in s", title="Twelve of 150")
axes.legend(loc="upper left", bbox_to_anchor=(1, 1))
plt.show()

# %%
# What they leave out is judged by scenarios that played no part in the choice. Shown is the largest distance of one
# of them to its nearest kept one, beside the median of random choices of the same size.

for aspect, coverage in reduced.coverage.items():
    held_out = coverage.held_out
    print(f"{aspect}: {held_out.largest:.3g}, random {held_out.random_largest:.3g}")
