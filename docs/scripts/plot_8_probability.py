"""
How probable is it?
===================

With distributions of the parameters, a critical share becomes a probability.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt

import cornercase as cc
from cornercase.exploration import examples_folder

folder = TemporaryDirectory()
example = examples_folder() / "t_intersection"
scenario = example / "t_intersection.xosc"
study = Path(folder.name) / "study.db"
cc.explore(
    scenario, study, space=example / "t_intersection.distributions.xosc", ego="Ego", other="C", metrics=["ttc"],
    critical=0.5, optimizer="level-set", budget=100, seed=1,
)  # fmt: skip

# %%
# The search proposes where to draw; new scenarios, weighted by the distributions, give the estimate.

estimates = {
    budget: cc.estimate(study, Path(folder.name) / f"{budget}.db", budget=budget, scenario=scenario)
    for budget in (300, 600, 1200)
}
print(estimates[1200])

# %%
# More scenarios narrow the interval.

figure, axes = plt.subplots(layout="constrained")
for budget, estimate in estimates.items():
    value = estimate.critical
    axes.errorbar(
        budget,
        value.value,
        [[value.value - value.low], [value.high - value.value]],
        fmt="o",
        color="#0072B2",
        capsize=4,
    )
axes.set(xlabel="scenarios drawn", ylabel="probability of TTC ≤ 0.5 s", xscale="log", yscale="log")
axes.set_xticks(list(estimates), labels=[str(budget) for budget in estimates])
axes.minorticks_off()
plt.show()
