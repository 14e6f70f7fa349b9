"""Machine code on disk, shared by processes that start together."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import numpy as np
import pytest

PROGRAM = """
import json, sys, time
import numpy as np
from numba.core.caching import IndexDataCacheFile
from cornercase.dtw import distance_matrix

# The others read the index in between, and who writes it first writes its machine code last.
index, data = IndexDataCacheFile._save_index, IndexDataCacheFile._save_data
delay = float(sys.argv.pop(1))
IndexDataCacheFile._save_index = lambda *all: (time.sleep(0.5), index(*all))
IndexDataCacheFile._save_data = lambda *all: (time.sleep(delay), data(*all))

rng = np.random.default_rng(0)
series = [rng.normal(size=(9, 2)) for _ in range(4)]
found = {}
for name in sys.argv[1:]:
    cost, dims = name.split("-")
    found[name] = distance_matrix([one[:, : int(dims)] for one in series], local_cost=cost, n_jobs=1).tolist()
print(json.dumps(found))
"""
VERSIONS = ["euclidean-1", "squared-1", "euclidean-2", "squared-2"]


def started(folder, delay, *names):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder)}
    return subprocess.Popen(
        [sys.executable, "-c", PROGRAM, str(delay), *names], stdout=subprocess.PIPE, text=True, env=environment
    )


def said(process):
    out, _ = process.communicate(timeout=300)
    assert process.returncode == 0
    return json.loads(out)


def test_processes_that_compile_at_once_do_not_mix_up_their_kernels(tmp_path):
    """Each begins with another version; then all of them are loaded from the disk, none is compiled."""
    folder = tmp_path / "cache"
    processes = [
        started(folder, 0.4 * (len(VERSIONS) - 1 - k), *VERSIONS[k:], *VERSIONS[:k]) for k in range(len(VERSIONS))
    ]
    results = [said(process) for process in processes]
    before = sorted(path.name for path in folder.rglob("*.nbc"))
    later = said(started(folder, 0.0, *VERSIONS))
    assert sorted(path.name for path in folder.rglob("*.nbc")) == before
    assert len(before) == len(VERSIONS)
    for result in results:
        for name in VERSIONS:
            np.testing.assert_array_equal(result[name], later[name])
    flat, square = np.array(later["euclidean-1"]), np.array(later["squared-1"])
    assert (flat >= square - 1e-12).all()
    assert not np.allclose(flat, square)


@pytest.mark.parametrize("ending", [".nbi", ".nbc"])
@pytest.mark.parametrize("left", [0, 40])
def test_machine_code_that_was_cut_is_compiled_again(tmp_path, ending, left):
    first = said(started(tmp_path, 0.0, "euclidean-1"))
    for path in tmp_path.rglob(f"*{ending}"):
        path.write_bytes(path.read_bytes()[:left])
    assert said(started(tmp_path, 0.0, "euclidean-1")) == first
    whole = {path: path.read_bytes() for path in tmp_path.rglob("*.nb?")}
    assert said(started(tmp_path, 0.0, "euclidean-1")) == first
    assert whole == {path: path.read_bytes() for path in tmp_path.rglob("*.nb?")}


def test_a_kernel_is_compiled_again_when_one_that_it_calls_has_changed(tmp_path):
    (tmp_path / "inner.py").write_text(
        "from cornercase._common.compiling import kernel\n@kernel()\ndef inner(x):\n    return x + 1\n"
    )
    (tmp_path / "outer.py").write_text(
        "from cornercase._common.compiling import kernel\nfrom inner import inner\n@kernel()\ndef outer(x):\n"
        "    return inner(x)\nprint(outer(1), sum(outer.stats.cache_hits.values()))\n"
    )

    def printed():
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
        command = [sys.executable, str(tmp_path / "outer.py")]
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout.split()

    assert [printed(), printed()] == [["2", "0"], ["2", "1"]]
    (tmp_path / "inner.py").write_text((tmp_path / "inner.py").read_text().replace("x + 1", "x + 2"))
    assert printed() == ["3", "0"]
