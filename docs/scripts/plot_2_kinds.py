"""
Kinds of scenario
=================

What ran is grouped by who was where when: by the aspect ``interaction``. Each kind gets a name that is true of its
scenarios.
"""

# %%
# A Sobol' sequence fills the space evenly, so that the sizes of the kinds mean something.

from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt

import cornercase as cc
from cornercase.exploration import examples_folder

example = examples_folder() / "t_intersection" / "t_intersection"
folder = TemporaryDirectory()
path = Path(folder.name) / "study.db"
scenario = cc.LogicalScenario.read(f"{example}.xosc", f"{example}.space.xosc")
problem = cc.Problem(scenario, ego="Ego", other="C", metrics=["ttc", "wttc"])
study = cc.Study.create(path, problem, cc.simulators.Builtin(on_collision="stop"))
study.explore(cc.optimizers.Sobol(), budget=120)
kinds = study.cluster(by="interaction")["interaction"]
kinds

# %%
# Kernel PCA gives each scenario a place, so that scenarios that are alike lie together. DBSCAN finds the dense
# regions there.

colours = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#F0E442", "#000000"]
markers = "osD^vP*X"
figure, (places, courses) = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
for number, (cluster, row) in enumerate(kinds.table().query("cluster >= 0").iterrows()):
    look = {"color": colours[number % 8], "marker": markers[number % 8]}
    places.scatter(*kinds.clustering.embedding[kinds.labels == cluster, :2].T, **look, s=18)
    recording, course = study.recording(row["example"]), study.course(row["example"], "wttc")
    courses.plot(recording.time, course, **look, markevery=20, markersize=5, label=row["name"])
noise = kinds.labels < 0
places.scatter(*kinds.clustering.embedding[noise, :2].T, color="#999999", marker="x", s=18)
places.set(xlabel="first component", ylabel="second component", title="Kernel space")
courses.set(xlabel="time in s", ylabel="WTTC in s", title="An example of each kind")
figure.legend(loc="outside lower center", fontsize=8)
plt.show()
