"""
What a search is worth
======================

Three searches look for the critical set of the T-intersection, with 200 scenarios each. Here the score jumps wherever
one of two goes first.
"""

# %%
# ``sobol`` looks at no score, ``level-set`` follows a smooth model of it, and ``committee`` learns from what happened
# in the recordings.

from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt

import cornercase as cc
from cornercase.exploration import examples_folder

example = examples_folder() / "t_intersection" / "t_intersection"
folder = TemporaryDirectory()
found = {}
for search in ("sobol", "level-set", "committee"):
    path = Path(folder.name) / f"{search}.db"
    cc.explore(
        f"{example}.xosc", path, space=f"{example}.space.xosc", ego="Ego", other="C", metrics=["ttc"], critical=0.5,
        optimizer=search, budget=200, seed=1, on_collision="stop",
    )  # fmt: skip
    with cc.Study.open(path) as study:
        found[search] = (study.table()["ttc"] <= 0.5).cumsum()

# %%
# How many critical scenarios each has found after so many runs:

figure, axes = plt.subplots(layout="constrained")
looks = {"sobol": ("#0072B2", ":"), "level-set": ("#009E73", "--"), "committee": ("#D55E00", "-")}
for search, numbers in found.items():
    colour, dashes = looks[search]
    axes.plot(range(1, len(numbers) + 1), numbers, dashes, color=colour, label=search)
axes.set(xlabel="scenarios run", ylabel="critical scenarios found", title="TTC of at most 0.5 s")
axes.legend()
plt.show()

# %%
# Many critical scenarios are not the whole critical set. What is missed of it stands in ``cornercase show``, and how
# it was measured in :doc:`/exploration`.
