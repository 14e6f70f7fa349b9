"""Kernels that are interpreted as long as they are not compiled."""

# What a kernel has beside its call is not declared.
# mypy: disable-error-code="attr-defined"

from __future__ import annotations

import json
import math
import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cornercase._common.numba.interpret import compile_at_once, interpret
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


@kernel(error_model="numpy")
def compute_with_integers(m, n, out):
    out[0], out[1], out[2], out[3] = m // n, m % n, m**2, n**3
    m //= n
    out[4] = m


@settings(deadline=None)
@given(NUMBERS, NUMBERS)
def test_interpreted_kernels_compute_the_bits_of_compiled_ones(x, y):
    compiled, python = np.empty(19), np.empty(19)
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


def test_where_a_kernel_is_needed_often_it_is_compiled_at_once():
    @kernel(interpreted_seconds=lambda x: 0.0)
    def third(x):
        return x / 3.0

    third._cache.flush()
    assert third(6.0) == 2.0
    assert not third.signatures
    with compile_at_once():
        assert third(6.0) == 2.0
    assert third.signatures


PROGRAM = """
import json, sys
from cornercase import simulators
from cornercase._common.numba import interpret
from cornercase._common.numba.kernel import listen_to_compilation
interpret.MAX_SECONDS = float(sys.argv[1])
heard = []
from numba.core import event
class Listener(event.Listener):
    def on_start(self, event): heard.append(1)
    def on_end(self, event): pass
event.register("numba:compile", Listener())
recording = simulators.simulate(sys.argv[2], drivers={"Ego": "normal"})
arrays = [getattr(recording, name).tobytes().hex() for name in ("x", "y", "heading", "speed", "acceleration")]
print(json.dumps([len(heard), arrays]))
"""


@pytest.mark.slow
def test_one_scenario_compiles_nothing_and_has_the_same_bytes(tmp_path):
    scenario = examples_folder() / "x_intersection" / "x_intersection.xosc"

    def simulated(name, seconds):
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / name)}
        command = [sys.executable, "-W", "ignore", "-c", PROGRAM, seconds, scenario]
        ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        return json.loads(ran.stdout)

    n_compiled, interpreted = simulated("empty", "60")
    assert n_compiled == 0
    n_compiled, compiled = simulated("other", "-1")
    assert n_compiled > 0
    assert interpreted == compiled
