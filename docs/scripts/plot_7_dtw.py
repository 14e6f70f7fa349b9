"""
Dynamic Time Warping
====================

How alike are two series when the same thing happens a little later in one of them?
"""

import matplotlib.pyplot as plt
import numpy as np

from cornercase.dtw import distance_matrix

# %%
# Three kinds of braking, each at ten different instants.

time = np.arange(0.0, 10.0, 0.1)
speeds = []
for hardness in (1.0, 3.0, 6.0):
    for begin in np.linspace(2.0, 5.0, 10):
        speeds.append(np.clip(15.0 - hardness * np.clip(time - begin, 0.0, None), 5.0, None))

# %%
# Instant by instant, scenarios that brake later look as different as scenarios that brake otherwise. Warping aligns
# them first.

plain = np.array([[np.abs(one - other).sum() for other in speeds] for one in speeds])
warped = distance_matrix(speeds)

figure, panels = plt.subplots(1, 3, figsize=(11, 3.6), layout="constrained")
for number, colour in enumerate(("#0072B2", "#009E73", "#D55E00")):
    for speed in speeds[10 * number : 10 * number + 10]:
        panels[0].plot(time, speed, color=colour, linewidth=0.8)
panels[0].set(xlabel="time in s", ylabel="speed in m/s", title="Thirty brakings")
for panel, matrix, title in ((panels[1], plain, "instant by instant"), (panels[2], warped, "warped")):
    image = panel.imshow(matrix, cmap="viridis")
    panel.set(xlabel="scenario", ylabel="scenario", title=title)
    figure.colorbar(image, ax=panel, label="distance in m/s")
plt.show()
