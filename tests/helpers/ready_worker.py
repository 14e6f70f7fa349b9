"""What a worker process imports and loads before it starts; see `helpers.ready_workers`."""

from __future__ import annotations

import gc

import hypothesis
import pandas
import scipy.optimize

from conftest import EXAMPLES
from cornercase import SystemUnderTest
from cornercase.drivers._resolve import check_drivers
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import Builtin
from cornercase.simulators.pool import _process
from cornercase.testing import check
from helpers import command_line

# Drivers and simulators of tests are sent by the names of their modules, which import these.
__all__ = ["_process", "check", "command_line", "hypothesis", "pandas", "scipy"]


class _Standing(SystemUnderTest):
    def step(self, view: object, dt: float) -> float:
        return 0.0


_FILE = EXAMPLES / "x_intersection" / "x_intersection.xosc"
for _driver in ("normal", _Standing()):
    for _ in Builtin(duration=0.5, drivers=check_drivers({"Ego": _driver})).run([ConcreteScenario(_FILE, {})] * 4):
        pass
gc.enable()
gc.freeze()
