"""Kernels that are interpreted as long as they are not compiled."""

# Kernels are declared as plain functions, without the methods of their dispatcher.
# mypy: disable-error-code="attr-defined"

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from cornercase._common.numba.interpret import interpret
from cornercase._common.numba.kernel import kernel
from cornercase.exploration import examples_folder

NUMBERS = st.floats(allow_nan=True, allow_infinity=True)


@kernel(error_model="numpy", _nrt=False)
def part(x, y):
    return math.hypot(x, y) - (x % y if y > 0.0 else 0.0)


@kernel(error_model="numpy")
def compute(x, y, out):
    out[0], out[1], out[2] = x / y, part(x, y), (x * y) ** 2
    out[3], out[4], out[5] = math.sin(x), math.cos(y), math.sqrt(x)
    out[6], out[7] = min(x, y), max(x, y)
    out[8], out[9] = math.atan2(x, y), 1.0 / (0.0 * x)
    out[10], out[11], out[12] = x**3, x**7, x**-1 if x != 0.0 else 0.0
    out[13], out[14], out[15] = abs(x) ** 0.5, abs(x) ** 1.7, abs(x) ** y
    out[16], out[17] = int(x), max(int(x), 0)
    z = x
    z /= y
    z %= 3.0
    out[18] = z
    out[19], out[20] = math.log(x), math.exp(y)


@kernel(error_model="numpy")
def compute_with_integers(m, n, out):
    out[0], out[1], out[2], out[3] = m // n, m % n, m**2, n**3
    m //= n
    out[4] = m


@settings(deadline=None)
@given(NUMBERS, NUMBERS)
@example(0.0, 1000.0)
def test_interpreted_kernels_compute_the_bits_of_compiled_ones(x, y):
    compiled, python = np.empty(21), np.empty(21)
    compute(x, y, compiled)
    interpret(compute, (x, y, python))
    assert np.array_equal(compiled, python, equal_nan=True)
    numbers = ~np.isnan(compiled)
    assert compiled[numbers].tobytes() == python[numbers].tobytes()


@settings(deadline=None)
@given(st.integers(-1000, 1000), st.integers(-3, 3))
def test_interpreted_kernels_compute_the_integers_of_compiled_ones(m, n):
    compiled, python = np.empty(5, dtype=np.int64), np.empty(5, dtype=np.int64)
    compute_with_integers(m, n, compiled)
    interpret(compute_with_integers, (m, n, python))
    assert compiled.tolist() == python.tolist()


def test_calls_that_take_long_are_compiled():
    @kernel(interpreted_seconds=lambda seconds: seconds)
    def half(seconds):
        return 0.5 * seconds

    assert half(1e9) == 5e8
    assert half.signatures


THIRD = """
from cornercase._common.numba.interpret import compile_at_once
from cornercase._common.numba.kernel import kernel

@kernel(interpreted_seconds=lambda x: 0.0)
def third(x):
    return x / 3.0

assert third(6.0) == 2.0
assert not third.signatures
with compile_at_once():
    assert third(6.0) == 2.0
assert third.signatures
"""


def test_where_a_kernel_is_needed_often_it_is_compiled_at_once(tmp_path):
    # In a process of its own, which has not interpreted anything for as long as a process may.
    (tmp_path / "third.py").write_text(THIRD)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    ran = subprocess.run(
        [sys.executable, str(tmp_path / "third.py")], env=environment, capture_output=True, text=True, check=False
    )
    assert ran.returncode == 0, ran.stderr


PROGRAM = """
import hashlib, json, sys
from contextlib import nullcontext
from numba.core import event
from cornercase import simulators
from cornercase._common.numba.interpret import compile_at_once, interpret_always

heard = []
class Listener(event.Listener):
    def on_start(self, event):
        heard.append(event.data["dispatcher"].py_func.__name__)
    def on_end(self, event):
        pass
event.register("numba:compile", Listener())
mode, scenario, options = sys.argv[1:]
with {"compile": compile_at_once, "interpret": interpret_always, "as usual": nullcontext}[mode]():
    recording = simulators.simulate(scenario, **json.loads(options))
digest = hashlib.sha256()
for name in ("time", "x", "y", "heading", "speed", "acceleration"):
    digest.update(getattr(recording, name).tobytes())
print(json.dumps([heard, recording.x.shape, digest.hexdigest()]))
"""

X = examples_folder() / "x_intersection" / "x_intersection.xosc"
T = examples_folder() / "t_intersection" / "t_intersection.xosc"
EVERYTHING = Path(__file__).parents[1] / "data" / "everything" / "everything.xosc"
OPENSCENARIO = Path(__file__).parents[3] / "shared" / "reference" / "openscenario"
CPNCO = OPENSCENARIO / "ncap" / "OpenSCENARIO" / "NCAP" / "CA-FC_2026" / "CPNCO.xosc"
NORMAL, OWN = {"drivers": {"Ego": "normal"}}, {"drivers": {"Ego": "cruising:Cruising"}}

OWN_DRIVER = """
import numpy as np
from cornercase.drivers import Driver

class Cruising(Driver):
    def acceleration(self, situation):
        return np.clip(8.0 - situation.speed, -3.0, 2.0)
"""


def simulated(mode, scenario, options, folder, cache=None):
    """Kernels that a process compiles to simulate a scenario, the recording's shape, and the digest of its bytes."""
    (folder / "cruising.py").write_text(OWN_DRIVER)
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    if cache is not None:
        environment["NUMBA_CACHE_DIR"] = str(cache)
    command = [sys.executable, "-W", "ignore", "-c", PROGRAM, mode, str(scenario), json.dumps(options)]
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return json.loads(ran.stdout)


@pytest.mark.slow
@pytest.mark.parametrize("scenario", [X, T, CPNCO, EVERYTHING], ids=lambda path: path.stem)
@pytest.mark.parametrize("options", [{}, NORMAL, OWN], ids=["storyboard", "normal", "own"])
def test_interpreted_scenarios_have_the_same_bytes(scenario, options, tmp_path):
    if not scenario.exists():
        pytest.skip("Euro NCAP's files are not beside the checkout")
    options = {**options, "duration": 20.0}
    _, *compiled = simulated("compile", scenario, options, tmp_path)
    _, *interpreted = simulated("interpret", scenario, options, tmp_path)
    assert interpreted == compiled


@pytest.mark.slow
@pytest.mark.parametrize("options", [{}, NORMAL, OWN], ids=["storyboard", "normal", "own"])
def test_one_scenario_compiles_nothing(options, tmp_path):
    assert simulated("as usual", X, options, tmp_path, tmp_path / "empty")[0] == []
