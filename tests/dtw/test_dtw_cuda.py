"""The GPU kernels in numba's simulator, which runs them in Python; never on a GPU here."""

import importlib.util
import json
import os
import subprocess
import sys

import numpy as np
import pytest

from conftest import at_night
from cornercase._common.errors import InputError
from cornercase.dtw import _in_memory as pairs
from cornercase.dtw import distance_matrix, distances_to

SIMULATED = """
import json, sys
import numpy as np
from cornercase.dtw import _cuda as cuda, distance_matrix, distances_to
cuda.THREADS = 4
cuda.ROW_BYTES = 2000  # so that one matrix takes several launches
rng = np.random.default_rng(0)
worst = 0.0
whole = sys.argv[2] == "whole"
for dims in map(int, sys.argv[1:2]):
    series = [rng.normal(size=(length, dims)) for length in ((5, 1, 9, 4, 2) if whole else (5, 1, 9))]
    for k, cost in enumerate(("euclidean", "squared")):
        for w, window in enumerate((None, 1, 3) if whole else (None, 3)):
            # Each two of cost, window and precision occur together.
            for dtype in ("float64", "float32") if whole else (("float64", "float32")[(k + w) % 2],):
                options = dict(local_cost=cost, window=window, dtype=dtype)
                for f, a in ((distance_matrix, (series,)), (distances_to, (series, series[1:3]))):
                    here, there = f(*a, **options), f(*a, **options, device="cuda")
                    assert there.dtype == here.dtype and there.shape == here.shape
                    difference = float(np.abs(there - here).max())
                    worst = max(worst, difference * (1.0 if dtype == "float64" else 1e-7))
                    if f is distance_matrix:
                        assert np.array_equal(there, there.T) and not there.diagonal().any()
print(json.dumps(worst))
"""


def run(program, *words, **environment):
    return subprocess.run(
        [sys.executable, "-c", program, *words], env={**os.environ, **environment}, capture_output=True, text=True
    )


@pytest.mark.parametrize("much", at_night(["some", "whole"], {"whole"}))
@pytest.mark.parametrize("dims", at_night(["1", "3"], {"1"}))
def test_the_simulated_gpu_gives_what_the_cpu_gives(dims, much):
    pytest.importorskip("numba.cuda")
    done = run(SIMULATED, dims, much, NUMBA_ENABLE_CUDASIM="1")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) < 1e-12


def test_says_what_is_missing(monkeypatch):
    monkeypatch.delenv("NUMBA_ENABLE_CUDASIM", raising=False)
    if importlib.util.find_spec("numba_cuda") is None:
        words = "pip install 'cornercase[gpu]'"
    else:
        from numba import cuda

        if cuda.is_available():
            pytest.skip("there is a GPU")
        words = "needs an NVIDIA GPU"
    for call in (distance_matrix, lambda series, **options: distances_to(series, series, **options)):
        with pytest.raises(InputError) as caught:
            call([[1.0], [2.0]], device="cuda")
        assert words in str(caught.value)


def test_an_extra_without_a_gpu_is_told_apart(monkeypatch):
    monkeypatch.delenv("NUMBA_ENABLE_CUDASIM", raising=False)
    numba_cuda = pytest.importorskip("numba.cuda")
    monkeypatch.setattr(pairs, "find_spec", lambda name: object())
    monkeypatch.setattr(numba_cuda, "is_available", lambda: False)
    with pytest.raises(InputError, match="needs an NVIDIA GPU and its driver"):
        distance_matrix(list(np.zeros((2, 3))), device="cuda")
