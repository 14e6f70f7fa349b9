"""
Brakes on a wet road
====================

An emergency brake that prevents every collision on a dry road is run on a road with half of the friction.
"""

# %%
# The ego approaches a standing car at 10 to 80 km/h. Its emergency brake asks for 9 m/s² once the time to collision is
# below 1.6 s.

import matplotlib.pyplot as plt
import numpy as np

import cornercase as cc
from cornercase.drivers import Actuators, Driver, EquippedDriver
from cornercase.exploration import examples_folder


class Aeb(Driver):
    """Brakes if the time to collision with the car ahead is below 1.6 s."""

    def acceleration(self, situation):
        front = situation.x + situation.center_x + 0.5 * situation.length
        rear = situation.others_x[:, 0] + situation.others_center_x[0] - 0.5 * situation.others_length[0]
        return np.where(rear - front < 1.6 * situation.speed, -9.0, 0.0)


# %%
# The vehicle model ``actuators`` builds up the brakes after a dead time, and brakes no harder than the tyres can.
# Without one, the friction of the road would have no effect.

car = EquippedDriver(Aeb(), vehicle=Actuators(delay=0.1, lag=0.1, max_jerk=60.0))
scenario = cc.LogicalScenario.read(examples_folder() / "ccrs" / "ccrs.xosc", ranges=["ego_kmh=10:80"])
speeds = np.linspace(10.0, 80.0, 60)
simulator = cc.simulators.Builtin(drivers={"Ego": car})
impact_speeds = {}
for friction in (1.0, 0.5):
    rows = [{"ego_kmh": float(speed), "friction": friction} for speed in speeds]
    runs = list(
        simulator.run([cc.ConcreteScenario(scenario.scenario_file.path, row, scenario.scenario_file) for row in rows])
    )
    impact_speeds[friction] = [3.6 * run.speed[0, -1] if run.collisions else 0.0 for run in runs]
    print(f"friction {friction:g}: {sum(bool(run.collisions) for run in runs)} of {len(runs)} collide")

# %%
# On the wet road the brake comes too late for a fast ego.

figure, axes = plt.subplots(layout="constrained")
for friction, color in ((1.0, "#0072B2"), (0.5, "#D55E00")):
    axes.plot(speeds, impact_speeds[friction], color=color, label=f"friction {friction:g}")
axes.set(xlabel="speed of the ego in km/h", ylabel="impact speed in km/h", title="The same brake on two roads")
axes.legend()
plt.show()
